//! Programs that a session expects beside a rig: a recorder of the depth camera, and `adb` with
//! the phone's files.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::clocks::link_delay::LinkRanges;
use crate::depth_camera::cable::Cable;
use crate::phone::{ClockServer, SimPhone};
use crate::whole_rig::config::RigParts;

/// The programs, the depth camera's cable and the phone's clock. They end when it is dropped.
#[derive(Debug)]
pub(super) struct Table {
    /// The command of the depth recorder.
    pub(super) recorder: Vec<String>,
    programs: PathBuf,
    _clock: ClockServer,
    _cable: Cable,
    _folder: tempfile::TempDir,
}

impl Table {
    /// Sets the programs up for a phone. `hil_sim` is the program with the depth recorder.
    ///
    /// # Errors
    ///
    /// The rig has no depth camera, or a file cannot be made.
    pub(super) fn new(parts: &RigParts, phone: &SimPhone, hil_sim: &Path) -> Result<Self> {
        let folder = tempfile::Builder::new()
            .prefix("simulated-rig-")
            .tempdir()
            .context("no folder for the rig's programs")?;
        let camera = parts
            .depth_camera
            .as_ref()
            .context("the rig has no depth camera")?;
        let socket = folder.path().join("depth-camera");
        let cable = Cable::new(camera, &socket)?;
        let recorder = [
            &hil_sim.to_string_lossy(),
            "record-depth",
            "--camera",
            &socket.to_string_lossy(),
            "--fps",
            "{fps}",
            "{folder}/depth.mkv",
        ];
        let recorder = recorder.map(str::to_owned).to_vec();
        let programs = folder.path().join("bin");
        std::fs::create_dir(&programs).context("no folder for the rig's programs")?;
        let tool = hil_sim.with_file_name("smartdepthsync");
        if tool.is_file() {
            std::os::unix::fs::symlink(tool, programs.join("smartdepthsync"))
                .context("cannot link the host tool")?;
        }
        // Shells and TOML take it from wherever they are.
        let storage =
            std::path::absolute(phone.app.storage()).context("where is the phone's storage?")?;
        let clock = phone.serve_clock(&LinkRanges::PHONE_USB);
        let clock = clock.context("no port for the phone's clock")?;
        write_adb(&programs.join("adb"), &storage, clock.port())?;
        Ok(Self {
            recorder,
            programs,
            _clock: clock,
            _cable: cable,
            _folder: folder,
        })
    }

    /// The table of a rig profile that names the depth recorder.
    ///
    /// # Errors
    ///
    /// None: its words are text.
    pub(super) fn of_recorder(&self) -> Result<String> {
        // JSON's strings are TOML's too.
        let command = serde_json::to_string(&self.recorder)?;
        Ok(format!("\n[depth.recorder]\ncommand = {command}\n"))
    }

    /// The first commands, to be pasted.
    pub(crate) fn commands(&self, profile: &Path) -> String {
        let profile = if profile.as_os_str() == "rig.toml" {
            String::new()
        } else {
            format!(" --profile {}", profile.display())
        };
        format!(
            "\nIn a second terminal, in this folder, or in another with these answers for \
             `smartdepthsync setup`:\n\n\
             export PATH={}:$PATH\n\
             smartdepthsync doctor{profile}\n\n\
             Each command ends with the next one.\n\n",
            self.programs.display()
        )
    }
}

/// Writes a program that stands in for `adb` as far as the host tool uses it: with the
/// simulated phone's storage, and its clock at a port. Nothing is started on the phone, as the
/// port is always open.
fn write_adb(path: &Path, storage: &Path, clock_port: u16) -> Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    let script = format!(
        r#"#!/bin/sh
# The simulated phone's storage, as adb shows a phone's.
here() {{ printf %s "$1" | sed 's#/sdcard/DCIM/OpenCamera#{storage}#g'; }}
case "$1" in
devices) printf 'List of devices attached\nSIMULATED\tdevice\n' ;;
-s) case "$3" in
    shell) case "$4" in
        'getprop ro.product.cpu.abilist') echo arm64-v8a ;;
        'chmod 755 /data/local/tmp/'*) ;;
        /data/local/tmp/*) exec sleep 20 ;;
        *) sh -c "$(here "$4")" | sed 's#{storage}#/sdcard/DCIM/OpenCamera#g' ;;
        esac ;;
    push) ;;
    forward) [ "$4" = --remove ] || echo {clock_port} ;;
    pull) cp "$(here "$4")" "$5" ;;
    esac ;;
esac
"#,
        storage = storage.display()
    );
    std::fs::write(path, script)
        .and_then(|()| std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)))
        .with_context(|| format!("cannot write {}", path.display()))
}
