//! The limits that a command runs in, and the watch over what lies beside its folder.

use std::ffi::OsString;
use std::fs;
use std::io::Read as _;
use std::mem::MaybeUninit;
use std::os::fd::OwnedFd;
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use rustix::fs::inotify::{self, CreateFlags, ReadFlags, WatchFlags};

use super::material::Files;

/// Address space, bytes.
const MEMORY: u64 = 1 << 30;
/// Time of the processor, s.
const SECONDS: u64 = 20;
/// Time on the clock: a command that waits uses no processor.
const PATIENCE: Duration = Duration::from_secs(120);
/// Length of a file, bytes.
const FILE: u64 = 1 << 30;
/// How often the memory is looked at.
const LOOK: Duration = Duration::from_millis(4);

/// How a command ended.
pub(super) struct Ended {
    /// Its exit code, if it ended by itself.
    pub(super) code: Option<i32>,
    /// How, in words.
    pub(super) how: String,
    /// Its standard error.
    pub(super) said: String,
    /// Most memory that it held, bytes, as it was last seen; without that of `ffmpeg`.
    pub(super) peak: u64,
    pub(super) took: Duration,
}

pub(super) fn run(program: &Path, arguments: &[OsString], folder: &Path) -> Result<Ended> {
    let mut child = Command::new("prlimit")
        .arg(format!("--as={MEMORY}"))
        .arg(format!("--cpu={SECONDS}"))
        .arg(format!("--fsize={FILE}"))
        .arg("--core=0")
        .arg(program)
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .context("running prlimit (of util-linux)")?;
    let began = Instant::now();
    let stderr = child.stderr.take();
    let said = std::thread::spawn(move || {
        let mut said = Vec::new();
        // What cannot be read is not judged.
        let _ = stderr.map(|mut stderr| stderr.read_to_end(&mut said));
        String::from_utf8_lossy(&said).into_owned()
    });
    let (mut peak, mut late) = (0, false);
    let status = loop {
        if let Some(status) = child.try_wait().context("waiting for the program")? {
            break status;
        }
        peak = peak.max(memory_of(child.id()).unwrap_or(0));
        if began.elapsed() > PATIENCE {
            late = true;
            child.kill().context("ending the program")?;
        }
        std::thread::sleep(LOOK);
    };
    Ok(Ended {
        code: status.code().filter(|_| !late),
        how: match status.signal() {
            _ if late => format!("it did not end within {} s", PATIENCE.as_secs()),
            Some(signal) => format!("ended by signal {signal}"),
            None => status.to_string(),
        },
        said: said.join().unwrap_or_default(),
        peak,
        took: began.elapsed(),
    })
}

/// The most memory that a process has held so far, bytes.
fn memory_of(process: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes * 1024)
}

/// Watches the bait, and what lies in the folder of both.
pub(super) struct Watch(OwnedFd);

impl Watch {
    pub(super) fn new(root: &Path, files: &Files) -> Result<Self> {
        let watch = inotify::init(CreateFlags::NONBLOCK | CreateFlags::CLOEXEC)?;
        let changes = WatchFlags::CREATE | WatchFlags::DELETE | WatchFlags::MOVE;
        let touches = changes | WatchFlags::OPEN | WatchFlags::MODIFY | WatchFlags::ATTRIB;
        inotify::add_watch(&watch, &files.bait, touches)?;
        inotify::add_watch(&watch, root, changes)?;
        Ok(Self(watch))
    }

    /// What was touched, in words.
    pub(super) fn touched(&self) -> Result<Vec<String>> {
        let mut memory = [MaybeUninit::uninit(); 4096];
        let mut events = inotify::Reader::new(&self.0, &mut memory);
        let mut touched = Vec::new();
        loop {
            match events.next() {
                Ok(event) if event.events().contains(ReadFlags::IGNORED) => {}
                Ok(event) => {
                    let name = event
                        .file_name()
                        .map(|name| name.to_string_lossy().into_owned());
                    let name = name.unwrap_or_else(|| String::from("the folder"));
                    touched.push(format!("{name} ({:?})", event.events()));
                }
                Err(rustix::io::Errno::AGAIN) => return Ok(touched),
                Err(error) => return Err(error).context("reading the watch"),
            }
        }
    }
}
