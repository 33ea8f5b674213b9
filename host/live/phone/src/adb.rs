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

mod error;
mod program;

use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::time::Duration;

use clock::PhoneNanos;
use system::Cancel;

pub use self::error::AdbError;
use self::error::FOLDER;
pub(crate) use self::program::{Adb, PATIENCE};
use crate::video_files::{Part, classify};

/// Shell pattern of the files of frame timestamps below [`FOLDER`], numbered ones included.
const FRAMES: &str = "*/*_timestamps*.csv";

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
        let files = files_of(&adb, device, phase, with_video)?;
        if !files.is_empty() {
            let copied = files.iter().map(|file| pull(&adb, device, file, folder));
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

/// Lists the files of the video with this phase on a phone. Returns none if it has no such
/// video.
fn files_of(
    adb: &Adb,
    device: &str,
    phase: PhoneNanos,
    with_video: bool,
) -> Result<Vec<Remote>, AdbError> {
    let find = format!("grep -lx {} {FOLDER}/{FRAMES} 2>/dev/null || true", phase.0);
    let found = adb.shell(device, &find)?;
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
    let list = adb.shell(device, &list)?;
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
fn pull(adb: &Adb, device: &str, file: &Remote, folder: &Path) -> Result<PathBuf, AdbError> {
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
    adb.run(&["-s", device, "pull", &file.path, &target], None)?;
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
