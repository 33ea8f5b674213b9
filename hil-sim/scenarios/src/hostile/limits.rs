//! The limits that a command runs in, and what it opens.

use std::ffi::OsString;
use std::fs;
use std::io::Read as _;
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};

use super::opens::{self, CALLS};

/// Address space, bytes.
const MEMORY: u64 = 1 << 30;
/// Time of the processor, s.
const SECONDS: u64 = 20;
/// Time in which all of it sleeps: a command that waits uses no processor, and on a busy
/// machine one that does not wait may get none.
const PATIENCE: Duration = Duration::from_secs(120);
/// Length of a file, bytes.
const FILE: u64 = 1 << 30;
/// How often the memory is looked at, and at each how many of these looks whether it waits.
const LOOK: Duration = Duration::from_millis(4);
const LOOKS: u32 = 25;

/// How a command ended.
#[derive(Debug)]
pub struct Ended {
    /// Its exit code, if it ended by itself.
    pub code: Option<i32>,
    /// How, in words.
    pub how: String,
    /// Its standard error.
    pub said: String,
    /// Most memory that it held, bytes, as it was last seen; without that of `ffmpeg`.
    pub peak: u64,
    /// How long it took.
    pub took: Duration,
    /// What it and its children opened, made, changed or removed outside of its folder.
    pub strays: Vec<String>,
}

/// Runs the program in its limits in a folder, which it may not leave; `root` is where the
/// log of its system calls may lie, outside of the folder.
///
/// # Errors
///
/// `prlimit` or `strace` is missing, or does not work here.
pub fn run(program: &Path, arguments: &[OsString], folder: &Path, root: &Path) -> Result<Ended> {
    let log = root.join("opens.log");
    // The tracer is beside the program, not above it: its number is the child's.
    let mut child = Command::new("strace")
        .args(["-D", "-f", "-q", "-y", "--seccomp-bpf", "-s", "4096"])
        .args(["-e", "signal=none", "-e"])
        .arg(format!("trace={CALLS}"))
        .arg("-o")
        .arg(&log)
        .arg("prlimit")
        .arg(format!("--as={MEMORY}"))
        .arg(format!("--cpu={SECONDS}"))
        .arg(format!("--fsize={FILE}"))
        .arg("--core=0")
        .arg(program)
        .args(arguments)
        .current_dir(folder)
        // Under cargo it leads the loader through the compiler's own folders.
        .env_remove("LD_LIBRARY_PATH")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .context("running strace: `sudo apt-get install strace`")?;
    let began = Instant::now();
    let stderr = child.stderr.take();
    let said = std::thread::spawn(move || {
        let mut said = Vec::new();
        // What cannot be read is not judged.
        let _ = stderr.map(|mut stderr| stderr.read_to_end(&mut said));
        String::from_utf8_lossy(&said).into_owned()
    });
    let (mut peak, mut late, mut looks) = (0, false, 0_u32);
    let (mut waited, mut looked) = (Duration::ZERO, Instant::now());
    let status = loop {
        if let Some(status) = child.try_wait().context("waiting for the program")? {
            break status;
        }
        peak = peak.max(memory_of(child.id()).unwrap_or(0));
        looks += 1;
        if looks.is_multiple_of(LOOKS) {
            let since = std::mem::replace(&mut looked, Instant::now());
            if sleeps(child.id()) {
                waited += since.elapsed();
            }
        }
        if waited > PATIENCE {
            late = true;
            child.kill().context("ending the program")?;
        }
        std::thread::sleep(LOOK);
    };
    let took = began.elapsed();
    // The tracer holds the same pipe, and ends behind all that it traces.
    let said = said.join().unwrap_or_default();
    let calls = fs::read(&log).context("strace wrote no log: may processes be traced here?")?;
    let calls = String::from_utf8_lossy(&calls);
    ensure!(
        calls.contains("execve("),
        "strace saw nothing: may processes be traced here? It said: {said}"
    );
    Ok(Ended {
        code: status.code().filter(|_| !late),
        how: match status.signal() {
            _ if late => format!("it waited for {} s", PATIENCE.as_secs()),
            Some(signal) => format!("ended by signal {signal}"),
            None => status.to_string(),
        },
        said,
        peak,
        took,
        strays: opens::strays(&calls, folder, program),
    })
}

/// Whether all threads of a process and of what it started sleep.
fn sleeps(process: u32) -> bool {
    let Ok(tasks) = fs::read_dir(format!("/proc/{process}/task")) else {
        return true;
    };
    tasks.flatten().all(|task| {
        let read = |name: &str| fs::read_to_string(task.path().join(name)).unwrap_or_default();
        // proc(5): the state stands behind the name, which is in brackets.
        let stat = read("stat");
        let state = stat.rsplit_once(") ").map_or("S", |(_, rest)| rest);
        let children = read("children");
        let mut children = children
            .split_whitespace()
            .filter_map(|pid| pid.parse().ok());
        state.starts_with(['S', 'Z']) && children.all(sleeps)
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
