//! Copies the files of a video from the phone's storage to this computer, by Android's `adb`.
//!
//! The app's remote control sends the video alone. The files of the frame timestamps and the
//! sensors stay on the phone, in a folder named by the video's date. They are found by the video's
//! phase, which is the timestamp of frame 60: it is a line of one file of frame timestamps and of
//! no other. So neither a clock nor a name needs to be known, and among several phones the right
//! one is found.
//!
//! Limits: `adb` must be on the `PATH`, and USB debugging enabled on the phone (or `adb connect`
//! used); the files are in [`FOLDER`], where the app saves by default. For phones that only MTP
//! reaches there is a [`copy_command`].

use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use clock::PhoneNanos;
use system::{Cancel, Limits, RunError};

use super::video_files::{Part, classify};

/// Folder on the phone in which the app saves (`StorageUtils.java`:323).
const FOLDER: &str = "/sdcard/DCIM/OpenCamera";

/// Shell pattern of the files of frame timestamps below [`FOLDER`], numbered ones included.
const FRAMES: &str = "*/*_timestamps*.csv";

/// Longest run of `adb`, except for copies.
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

/// Longest run of `adb` when cleaning up.
const MOMENT: Duration = Duration::from_secs(2);

/// Most bytes that `adb` may print: a list of some 100,000 files.
const MAX_OUTPUT: usize = 16 << 20;

/// Failure of a use of `adb`.
#[derive(Debug, thiserror::Error)]
pub enum AdbError {
    /// There is no `adb` on the `PATH`.
    #[error("`adb` is not on the PATH")]
    NoProgram,
    /// No phone is connected and authorized.
    #[error("`adb devices` lists no phone that is ready{}", others(states))]
    NoDevice {
        /// Serial number and state of each phone that is not ready.
        states: Vec<String>,
    },
    /// Several phones are connected where one is needed.
    #[error("`adb devices` lists several phones: {}", devices.join(", "))]
    SeveralDevices {
        /// Serial numbers of the phones that are ready.
        devices: Vec<String>,
    },
    /// There is no agent for the phone's processor.
    #[error(
        "there is no smartdepthsync-phone-agent for a phone of {processors:?} beside this program"
    )]
    NoAgent {
        /// Instruction sets of the phone, by Android's names.
        processors: String,
    },
    /// No phone has a video with the phase.
    #[error("no file of frame timestamps in {FOLDER} of {} has the phase {}", devices.join(", "), phase.0)]
    NotFound {
        /// Serial numbers of the phones that were searched.
        devices: Vec<String>,
        /// The timestamp that was searched for.
        phase: PhoneNanos,
    },
    /// `adb` failed, or a copy differs in size from the file on the phone.
    #[error("`adb {command}` failed: {reason}")]
    Failed {
        /// Arguments of `adb`.
        command: String,
        /// Output of `adb`, or the difference.
        reason: String,
    },
    /// A file on this computer, or `adb` itself, cannot be used.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// The attempted action, as a verb phrase that the path follows.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// The caller cancelled it.
    #[error("stopped on request")]
    Cancelled,
}

fn others(states: &[String]) -> String {
    match states {
        [] => String::new(),
        states => format!(" ({})", states.join(", ")),
    }
}

/// Returns a shell command that copies the files of the video with this phase into `folder`, from
/// a phone that GNOME Files or another user of gvfs has mounted by MTP. `extract` finds them there.
#[must_use]
pub fn copy_command(phase: PhoneNanos, folder: &Path) -> String {
    format!(
        "cp -r \"$(dirname \"$(grep -lx {} \"$XDG_RUNTIME_DIR\"/gvfs/mtp*/*/DCIM/OpenCamera/{FRAMES})\")\" {}",
        phase.0,
        system::shell_word(folder)
    )
}

/// Returns the command of this project that copies the files of the video with this phase through
/// `adb`, and also the video itself if `with_video`.
#[must_use]
pub fn get_files_command(phase: PhoneNanos, folder: &Path, with_video: bool) -> String {
    let video = if with_video { " --video" } else { "" };
    format!(
        "smartdepthsync phone get-files --phase {}{video} --out {}",
        phase.0,
        system::shell_word(folder)
    )
}

/// Returns true if an `adb` server runs on this computer. Does not start one.
#[must_use]
pub fn server_runs() -> bool {
    let port = std::env::var("ANDROID_ADB_SERVER_PORT").ok();
    let port = port.and_then(|port| port.parse().ok()).unwrap_or(5037);
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    TcpStream::connect_timeout(&address, Duration::from_millis(200)).is_ok()
}

/// A file on the phone.
#[derive(Debug, PartialEq, Eq)]
struct Remote {
    size: u64,
    path: String,
}

/// The program `adb`, with the cancellation of its runs.
#[derive(Clone)]
pub(crate) struct Adb {
    program: PathBuf,
    cancel: Cancel,
}

/// Copies the files of the video with this phase into `folder`: frame timestamps and sensors, and
/// also the video if `with_video`. Returns the paths of the files. A file that exists with the
/// right size is not copied again.
///
/// # Errors
///
/// There is no `adb`, no phone or no such video, or a file cannot be copied completely. An
/// incomplete copy is removed.
pub fn fetch(
    phase: PhoneNanos,
    folder: &Path,
    with_video: bool,
    cancel: &Cancel,
) -> Result<Vec<PathBuf>, AdbError> {
    let adb = Adb::find(cancel)?;
    let devices = adb.devices()?;
    for device in &devices {
        let files = adb.files_of(device, phase, with_video)?;
        if !files.is_empty() {
            let copied = files.iter().map(|file| adb.pull(device, file, folder));
            return copied.collect();
        }
    }
    Err(AdbError::NotFound { devices, phase })
}

/// Returns the IPv4 address of the connected phone in its Wi-Fi, or `None` if it has none or
/// several phones are connected.
///
/// # Errors
///
/// There is no `adb` or no phone, or `adb` fails.
pub fn wifi_address(cancel: &Cancel) -> Result<Option<String>, AdbError> {
    let adb = Adb::find(cancel)?;
    let devices = adb.devices()?;
    let [device] = devices.as_slice() else {
        return Ok(None);
    };
    let ask = "ip -4 -o addr show wlan0 2>/dev/null || true";
    let list = adb.shell(device, ask)?;
    Ok(address_in(&list))
}

/// Parses the address in a line of `ip -o addr`: `7: wlan0    inet 192.168.1.23/24 brd ...`.
fn address_in(list: &str) -> Option<String> {
    let mut words = list.split_whitespace().skip_while(|word| *word != "inet");
    let address = words.nth(1)?.split('/').next()?;
    let address: std::net::Ipv4Addr = address.parse().ok()?;
    Some(address.to_string())
}

/// Parses the output of `adb devices` into the serial numbers of the phones that are ready.
fn ready(list: &str) -> Result<Vec<String>, AdbError> {
    let lines = list.lines().filter_map(|line| line.split_once('\t'));
    let (ready, others): (Vec<_>, Vec<_>) = lines.partition(|(_, state)| state.trim() == "device");
    if ready.is_empty() {
        let states = others.iter();
        let states = states.map(|(serial, state)| format!("{serial}: {}", state.trim()));
        return Err(AdbError::NoDevice {
            states: states.collect(),
        });
    }
    Ok(ready
        .iter()
        .map(|(serial, _)| (*serial).to_owned())
        .collect())
}

impl Adb {
    /// Finds the program on the `PATH`.
    pub(crate) fn find(cancel: &Cancel) -> Result<Self, AdbError> {
        let program = system::find_program("adb").ok_or(AdbError::NoProgram)?;
        let cancel = cancel.clone();
        Ok(Self { program, cancel })
    }

    pub(crate) fn program(&self) -> &Path {
        &self.program
    }

    pub(crate) const fn cancel(&self) -> &Cancel {
        &self.cancel
    }

    /// Returns the serial numbers of the phones that are ready, at least one.
    fn devices(&self) -> Result<Vec<String>, AdbError> {
        ready(&self.run(&["devices"], Some(PATIENCE))?)
    }

    /// Returns the serial number of the only phone that is ready.
    pub(crate) fn only_device(&self) -> Result<String, AdbError> {
        match <[String; 1]>::try_from(self.devices()?) {
            Ok([device]) => Ok(device),
            Err(devices) => Err(AdbError::SeveralDevices { devices }),
        }
    }

    /// Runs a command line in the phone's shell and returns its output.
    pub(crate) fn shell(&self, device: &str, line: &str) -> Result<String, AdbError> {
        self.run_for(device, &["shell", line])
    }

    /// Runs `adb` for a phone and returns its output.
    pub(crate) fn run_for(&self, device: &str, arguments: &[&str]) -> Result<String, AdbError> {
        self.run(&[&["-s", device], arguments].concat(), Some(PATIENCE))
    }

    /// Runs `adb` for a phone without cancellation: a cancelled run may have taken effect, and its
    /// result would be lost.
    pub(crate) fn run_to_end(
        &self,
        device: &str,
        arguments: &[&str],
        patience: Duration,
    ) -> Result<String, AdbError> {
        let adb = Self {
            cancel: Cancel::default(),
            ..self.clone()
        };
        adb.run(&[&["-s", device], arguments].concat(), Some(patience))
    }

    /// Runs `adb` to clean up after earlier runs. Ignores failures, as the phone may be gone.
    pub(crate) fn clean_up(&self, device: &str, arguments: &[&str]) {
        let _ = self.run_to_end(device, arguments, MOMENT);
    }

    pub(crate) fn cannot_run(&self, source: std::io::Error) -> AdbError {
        AdbError::Io {
            action: "run",
            path: self.program.clone(),
            source,
        }
    }

    /// Lists the files of the video with this phase on a phone. Returns none if it has no such
    /// video.
    fn files_of(
        &self,
        device: &str,
        phase: PhoneNanos,
        with_video: bool,
    ) -> Result<Vec<Remote>, AdbError> {
        let find = format!("grep -lx {} {FOLDER}/{FRAMES} 2>/dev/null || true", phase.0);
        let found = self.shell(device, &find)?;
        let Some(frames) = found.lines().map(str::trim).find(|line| is_plain(line)) else {
            return Ok(Vec::new());
        };
        let Some((folder, video)) = frames
            .rsplit_once('/')
            .and_then(|(folder, name)| Some((folder, classify(name)?.1)))
        else {
            return Ok(Vec::new());
        };
        let list = format!("stat -c '%s %n' '{folder}'/* {FOLDER}/*.mp4 2>/dev/null || true");
        let list = self.shell(device, &list)?;
        let wanted = |name: &str| match classify(name) {
            Some((Part::Video, name)) => with_video && name == video,
            Some((_, name)) => name == video,
            None => false,
        };
        Ok(remotes(&list)
            .into_iter()
            .filter(|file| file.path.rsplit('/').next().is_some_and(wanted))
            .collect())
    }

    /// Copies a file into `folder`. It appears there only once it is complete.
    fn pull(&self, device: &str, file: &Remote, folder: &Path) -> Result<PathBuf, AdbError> {
        let name = file.path.rsplit('/').next().unwrap_or_default();
        let path = folder.join(name);
        let size = |path: &Path| path.metadata().map(|metadata| metadata.len());
        if size(&path).is_ok_and(|size| size == file.size) {
            return Ok(path);
        }
        let io = |action| {
            let path = path.clone();
            move |source| AdbError::Io {
                action,
                path,
                source,
            }
        };
        std::fs::create_dir_all(folder).map_err(io("make the folder of"))?;
        let part = system::new_file_in(folder).map_err(io("write"))?;
        let target = part.path().to_string_lossy().into_owned();
        self.run(&["-s", device, "pull", &file.path, &target], None)?;
        let found = size(part.path()).map_err(io("read"))?;
        if found != file.size {
            return Err(AdbError::Failed {
                command: format!("pull {name}"),
                reason: format!(
                    "the file has {} bytes on the phone, and {found} bytes were copied",
                    file.size
                ),
            });
        }
        system::put_in_place(part, &path, false).map_err(io("write"))?;
        Ok(path)
    }

    /// Runs `adb` and returns its output.
    fn run(&self, arguments: &[&str], patience: Option<Duration>) -> Result<String, AdbError> {
        let failed = |reason: String| AdbError::Failed {
            command: arguments.join(" "),
            reason,
        };
        let limits = Limits {
            run: patience,
            cancel: self.cancel.clone(),
            ..Limits::default()
        };
        let mut command = Command::new(&self.program);
        let output = system::run(command.args(arguments), limits, MAX_OUTPUT);
        let output = output.map_err(|error| match error {
            RunError::Start(source) | RunError::Read(source) => self.cannot_run(source),
            RunError::Cancelled => AdbError::Cancelled,
            error => failed(error.to_string()),
        })?;
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        if !output.status.success() {
            let said = format!("{text}{}", output.messages);
            return Err(failed(super::answer::shorten(said.trim())));
        }
        Ok(text)
    }
}

/// Parses a list of lines `size path`. Leaves out paths that the app does not write, because they
/// come from the phone and are passed to its shell.
fn remotes(list: &str) -> Vec<Remote> {
    let line = |line: &str| {
        let (size, path) = line.trim().split_once(' ')?;
        let size = size.parse().ok()?;
        let path = is_plain(path).then(|| path.to_owned())?;
        Some(Remote { size, path })
    };
    list.lines().filter_map(line).collect()
}

/// Returns true if a path is below [`FOLDER`] and has only characters that the app uses.
fn is_plain(path: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || "/_-. ()".contains(c);
    path.strip_prefix(FOLDER)
        .is_some_and(|rest| rest.starts_with('/') && rest.chars().all(plain))
        && !path.contains("/..")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_ready_phones_are_listed() {
        let list =
            "List of devices attached\nA1\tdevice\nB2\tunauthorized\n192.168.1.5:5555\tdevice\n";
        assert_eq!(ready(list).unwrap(), ["A1", "192.168.1.5:5555"]);
        let error = ready("List of devices attached\nB2\tunauthorized\n").unwrap_err();
        assert!(error.to_string().contains("B2: unauthorized"), "{error}");
    }

    #[test]
    fn an_address_is_parsed_or_absent() {
        let line = "31: wlan0    inet 192.168.1.23/24 brd 192.168.1.255 scope global wlan0\n";
        assert_eq!(address_in(line).as_deref(), Some("192.168.1.23"));
        for other in ["", "inet", "inet x/24", "31: wlan0 inet6 fe80::1/64"] {
            assert_eq!(address_in(other), None, "{other}");
        }
    }

    #[test]
    fn hostile_paths_are_left_out() {
        let list = "12 /sdcard/DCIM/OpenCamera/x/VID_1gyro.csv\n\
                    12 /sdcard/DCIM/OpenCamera/x/$(reboot).csv\n\
                    12 /sdcard/DCIM/OpenCamera/../../etc/passwd\n\
                    12 /data/VID_1gyro.csv\n\
                    stat: nothing\n\n";
        let paths: Vec<_> = remotes(list).into_iter().map(|file| file.path).collect();
        assert_eq!(paths, ["/sdcard/DCIM/OpenCamera/x/VID_1gyro.csv"]);
    }
}
