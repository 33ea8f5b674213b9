//! A video's files from the phone's storage to this computer, by Android's `adb`.
//!
//! The app's remote control sends the video alone. The frame timestamps and the sensors
//! stay on the phone, in a folder named by the video's date. Which one that is, the phase
//! tells: it is the timestamp of frame 60, so it is a line of one file of frame timestamps
//! and of no other. So neither a clock nor a name needs to be known, and of several phones
//! the right one is found.
//!
//! Limits: `adb` must be on the `PATH`, and the phone have USB debugging switched on (or be
//! reached by `adb connect`); the files lie in [`FOLDER`], where the app saves unless told
//! otherwise. For phones that only MTP reaches there is a [`copy_command`].

use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use clock::PhoneNanos;
use system::{Cancel, Limits, RunError};

use super::video_files::{Part, classify};

/// Where the app saves, on the phone (`StorageUtils.java`:323).
const FOLDER: &str = "/sdcard/DCIM/OpenCamera";

/// The files of frame timestamps below it, also the numbered ones, as a shell's pattern.
const FRAMES: &str = "*/*_timestamps*.csv";

/// How long `adb` may take to answer; a copy may take longer.
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

/// How long tidying up may take.
const MOMENT: Duration = Duration::from_secs(2);

/// Most bytes of an answer of `adb`: a list of some 100,000 files.
const MAX_OUTPUT: usize = 16 << 20;

/// Why files did not come by `adb`.
#[derive(Debug, thiserror::Error)]
pub enum AdbError {
    /// There is no such program.
    #[error("`adb` is not on the PATH")]
    NoProgram,
    /// It knows no phone that it may talk to.
    #[error("`adb devices` lists no phone that is ready{}", others(states))]
    NoDevice {
        /// The states of those that are not.
        states: Vec<String>,
    },
    /// It knows several, and nobody has said which one is meant.
    #[error("`adb devices` lists several phones: {}", devices.join(", "))]
    SeveralDevices {
        /// Those that are ready.
        devices: Vec<String>,
    },
    /// There is no agent for the phone's processor.
    #[error(
        "there is no smartdepthsync-phone-agent for a phone of {processors:?} beside this program"
    )]
    NoAgent {
        /// As the phone says.
        processors: String,
    },
    /// No phone has the video.
    #[error("no file of frame timestamps in {FOLDER} of {} has the phase {}", devices.join(", "), phase.0)]
    NotFound {
        /// The phones that were looked at.
        devices: Vec<String>,
        /// The timestamp that was looked for.
        phase: PhoneNanos,
    },
    /// It failed, or a file came otherwise than it is on the phone.
    #[error("`adb {command}` failed: {reason}")]
    Failed {
        /// What it was to do.
        command: String,
        /// What it said.
        reason: String,
    },
    /// The disk, or the program itself.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// With which file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The caller asked to stop.
    #[error("stopped on request")]
    Cancelled,
}

fn others(states: &[String]) -> String {
    match states {
        [] => String::new(),
        states => format!(" ({})", states.join(", ")),
    }
}

/// A shell's line that copies the files of the video with this phase into `folder`, from a
/// phone that GNOME's files or another gvfs has mounted by MTP. `extract` finds them there.
#[must_use]
pub fn copy_command(phase: PhoneNanos, folder: &Path) -> String {
    format!(
        "cp -r \"$(dirname \"$(grep -lx {} \"$XDG_RUNTIME_DIR\"/gvfs/mtp*/*/DCIM/OpenCamera/{FRAMES})\")\" {}",
        phase.0,
        system::shell_word(folder)
    )
}

/// The command of this program that copies them through `adb`, the video too if
/// `with_video`.
#[must_use]
pub fn get_files_command(phase: PhoneNanos, folder: &Path, with_video: bool) -> String {
    let video = if with_video { " --video" } else { "" };
    format!(
        "smartdepthsync phone get-files --phase {}{video} --out {}",
        phase.0,
        system::shell_word(folder)
    )
}

/// Whether an `adb` server runs on this computer; it is not started by asking.
#[must_use]
pub fn server_runs() -> bool {
    let port = std::env::var("ANDROID_ADB_SERVER_PORT").ok();
    let port = port.and_then(|port| port.parse().ok()).unwrap_or(5037);
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    TcpStream::connect_timeout(&address, Duration::from_millis(200)).is_ok()
}

/// One file on the phone.
#[derive(Debug, PartialEq, Eq)]
struct Remote {
    size: u64,
    path: String,
}

/// The program, and when to give up.
#[derive(Clone)]
pub(crate) struct Adb {
    program: PathBuf,
    cancel: Cancel,
}

/// Copies the files of the video with this phase into `folder`: frame timestamps and
/// sensors, and the video too if `with_video`. A file that is there with the same size is
/// left. Gives where they are.
///
/// # Errors
///
/// No program, no phone, no such video; or a file did not come whole, and is not there.
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

/// The address of the one phone that is connected, in its Wi-Fi; nothing if it has none, or
/// if several phones are connected.
///
/// # Errors
///
/// There is no program or no phone, or it does not answer.
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

/// The address in a line of `ip -o addr`: `7: wlan0    inet 192.168.1.23/24 brd ...`.
fn address_in(list: &str) -> Option<String> {
    let mut words = list.split_whitespace().skip_while(|word| *word != "inet");
    let address = words.nth(1)?.split('/').next()?;
    let address: std::net::Ipv4Addr = address.parse().ok()?;
    Some(address.to_string())
}

/// The phones of `adb devices` that are ready.
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
    /// The program on the search path.
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

    /// The phones that are ready.
    fn devices(&self) -> Result<Vec<String>, AdbError> {
        ready(&self.run(&["devices"], Some(PATIENCE))?)
    }

    /// The one phone that is ready.
    pub(crate) fn only_device(&self) -> Result<String, AdbError> {
        match <[String; 1]>::try_from(self.devices()?) {
            Ok([device]) => Ok(device),
            Err(devices) => Err(AdbError::SeveralDevices { devices }),
        }
    }

    /// Runs a line in the phone's shell; gives what it prints.
    pub(crate) fn shell(&self, device: &str, line: &str) -> Result<String, AdbError> {
        self.run_for(device, &["shell", line])
    }

    /// Runs the program for a phone; gives what it prints.
    pub(crate) fn run_for(&self, device: &str, what: &[&str]) -> Result<String, AdbError> {
        self.run(&[&["-s", device], what].concat(), Some(PATIENCE))
    }

    /// Runs the program for a phone to its end, also where the caller is to stop meanwhile: what
    /// is ended halfway may be done all the same, and nobody knows of it.
    pub(crate) fn run_to_end(
        &self,
        device: &str,
        what: &[&str],
        patience: Duration,
    ) -> Result<String, AdbError> {
        let adb = Self {
            cancel: Cancel::default(),
            ..self.clone()
        };
        adb.run(&[&["-s", device], what].concat(), Some(patience))
    }

    /// Runs the program to tidy up behind what was done with a phone, as far as that can be
    /// done in a moment.
    pub(crate) fn tidy_up(&self, device: &str, what: &[&str]) {
        // A phone that is gone has lost more than this.
        let _ = self.run_to_end(device, what, MOMENT);
    }

    pub(crate) fn cannot_run(&self, source: std::io::Error) -> AdbError {
        AdbError::Io {
            action: "run",
            path: self.program.clone(),
            source,
        }
    }

    /// The files of the video with this phase on a phone; none if it does not have it.
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
            Some((Part::Video, of)) => with_video && of == video,
            Some((_, of)) => of == video,
            None => false,
        };
        Ok(remotes(&list)
            .into_iter()
            .filter(|file| file.path.rsplit('/').next().is_some_and(wanted))
            .collect())
    }

    /// Copies a file; it appears only when it is whole.
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
                reason: format!("it is {} bytes there, but {found} bytes came", file.size),
            });
        }
        system::put_in_place(part, &path, false).map_err(io("write"))?;
        Ok(path)
    }

    /// Runs `adb` and returns what it prints.
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

/// The lines `size path` of a listing. Other paths than the app writes are left out: they
/// come from the phone and go into its shell.
fn remotes(list: &str) -> Vec<Remote> {
    let line = |line: &str| {
        let (size, path) = line.trim().split_once(' ')?;
        let size = size.parse().ok()?;
        let path = is_plain(path).then(|| path.to_owned())?;
        Some(Remote { size, path })
    };
    list.lines().filter_map(line).collect()
}

/// Whether a path lies where the app saves and has only characters of its names.
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
    fn only_ready_phones_are_asked() {
        let list =
            "List of devices attached\nA1\tdevice\nB2\tunauthorized\n192.168.1.5:5555\tdevice\n";
        assert_eq!(ready(list).unwrap(), ["A1", "192.168.1.5:5555"]);
        let error = ready("List of devices attached\nB2\tunauthorized\n").unwrap_err();
        assert!(error.to_string().contains("B2: unauthorized"), "{error}");
    }

    #[test]
    fn an_address_is_read_or_there_is_none() {
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
