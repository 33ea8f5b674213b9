//! A terminal device as a link.
//!
//! A thread does nothing but read the port, into a long queue: a consumer that is busy
//! (a slow disk, a person at a prompt) does not stall the board for 18 minutes at the
//! rig's usual load of 30 kB/s. Then the port is left unread; the board drops and counts.
//!
//! The port is opened exclusively (TIOCEXCL and an advisory `flock`), because a
//! second reader would steal bytes. Root passes TIOCEXCL, but not the lock.

use std::io::{self, Read, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serialport::{ErrorKind, SerialPort};

use super::{Link, LinkError};

/// CDC-ACM ignores the rate, and so does a pseudo-terminal; but a rate of 0
/// means "hang up" to a terminal.
const BAUD: u32 = 115_200;

/// Interval at which the reading thread checks for its end.
const POLL: Duration = Duration::from_millis(50);

/// Most bytes that wait in the queue, except for one reading of the port.
const MOST_WAITING: usize = 32 << 20;

/// Most bytes that are returned at a time, except for one reading of the port: the caller looks at
/// the clock in between.
const MOST_AT_ONCE: usize = 1 << 20;

/// Wait of the reading thread while the queue is full or it is asked to pause.
const PAUSE: Duration = Duration::from_millis(5);

/// Longest time of a write.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// Reason for which a port cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// There is no such file.
    #[error("there is no port {path}")]
    NotFound {
        /// Path of the port, as given.
        path: String,
    },
    /// The user may not open it.
    #[error("no permission to open {path}")]
    Permission {
        /// Path of the port, as given.
        path: String,
    },
    /// Another program has it.
    #[error("{path} is in use by another program")]
    Busy {
        /// Path of the port, as given.
        path: String,
    },
    /// It is a file, a folder, or some other device.
    #[error("{path} is not a serial port")]
    NotAPort {
        /// Path of the port, as given.
        path: String,
    },
    /// It is the terminal of a person. A link to a pseudo-terminal outlives the simulated board that
    /// was killed, and the system gives its number to the next terminal.
    #[error("{path} is the terminal of process {process}, not a board's port")]
    Terminal {
        /// Path of the port, as given.
        path: String,
        /// A process that the terminal controls.
        process: u32,
    },
    /// Anything else.
    #[error("cannot open {path}: {reason}")]
    Other {
        /// Path of the port, as given.
        path: String,
        /// The system's error message.
        reason: String,
    },
}

/// A serial port or pseudo-terminal, read by a thread of its own.
pub struct SerialLink {
    port: Box<dyn SerialPort>,
    received: Receiver<io::Result<Vec<u8>>>,
    /// Bytes in the queue.
    waiting: Arc<AtomicUsize>,
    gone: Option<LinkError>,
    /// Requests to the reading thread.
    asked: Arc<Asked>,
    reader: Option<JoinHandle<()>>,
}

/// Requests to the reading thread.
#[derive(Default)]
struct Asked {
    stop: AtomicBool,
    pause: AtomicBool,
}

impl SerialLink {
    /// Opens a port exclusively and starts to read it. Raises DTR, which tells a CDC-ACM device that
    /// a program listens.
    ///
    /// # Errors
    ///
    /// It is not there, not a port, in use, or not permitted.
    pub fn open(path: &str) -> Result<Self, OpenError> {
        #[cfg(target_os = "linux")]
        if let Some(process) = controlled_by(Path::new(path)) {
            let path = path.to_owned();
            return Err(OpenError::Terminal { path, process });
        }
        let port = serialport::new(path, BAUD)
            .timeout(POLL)
            .dtr_on_open(true)
            .open()
            .map_err(|error| why(path, &error))?;
        let other = |error: String| OpenError::Other {
            path: path.to_owned(),
            reason: error,
        };
        let reading = port.try_clone().map_err(|error| other(error.to_string()))?;
        let asked = Arc::new(Asked::default());
        let (sender, received) = channel();
        let waiting = Arc::new(AtomicUsize::new(0));
        let (orders, queued) = (Arc::clone(&asked), Arc::clone(&waiting));
        let reader = std::thread::Builder::new()
            .name(String::from("link reader"))
            .spawn(move || read_until_stopped(reading, &orders, &queued, &sender))
            .map_err(|error| other(error.to_string()))?;
        Ok(Self {
            port,
            received,
            waiting,
            gone: None,
            asked,
            reader: Some(reader),
        })
    }

    /// Appends received bytes, or notes why the port is gone.
    fn accept(&mut self, chunk: io::Result<Vec<u8>>, into: &mut Vec<u8>) {
        match chunk {
            Ok(bytes) => {
                self.waiting.fetch_sub(bytes.len(), Ordering::Relaxed);
                into.extend_from_slice(&bytes);
            }
            Err(error) => {
                self.gone = Some(LinkError::Gone {
                    reason: error.to_string(),
                });
            }
        }
    }
}

/// Returns the time since the first call in this program: one clock for all links.
#[must_use]
pub fn program_time() -> Duration {
    static BEGAN: OnceLock<Instant> = OnceLock::new();
    BEGAN.get_or_init(Instant::now).elapsed()
}

impl Link for SerialLink {
    fn now(&self) -> Duration {
        program_time()
    }

    /// The system's steering may be 500 ppm (adjtimex).
    #[cfg(target_os = "linux")]
    fn steady(&self) -> Duration {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::MonotonicRaw);
        Duration::new(
            time.tv_sec.try_into().unwrap_or(0),
            time.tv_nsec.try_into().unwrap_or(0),
        )
    }

    fn send(&mut self, mut bytes: &[u8]) -> Result<(), LinkError> {
        let started = Instant::now();
        while !bytes.is_empty() {
            match self.port.write(bytes) {
                Ok(count) => bytes = bytes.get(count..).unwrap_or_default(),
                Err(error) if is_passing(&error) => {
                    if started.elapsed() > WRITE_TIMEOUT {
                        return Err(LinkError::Stuck);
                    }
                }
                Err(error) => {
                    return Err(LinkError::Gone {
                        reason: error.to_string(),
                    });
                }
            }
        }
        Ok(())
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        let before = into.len();
        if self.gone.is_none() {
            match self.received.recv_timeout(wait) {
                Ok(chunk) => self.accept(chunk, into),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    self.gone = Some(LinkError::Gone {
                        reason: String::from("the reading thread has ended"),
                    });
                }
            }
            while self.gone.is_none()
                && into.len() - before < MOST_AT_ONCE
                && let Ok(chunk) = self.received.try_recv()
            {
                self.accept(chunk, into);
            }
        }
        match &self.gone {
            Some(error) if into.len() == before => Err(error.clone()),
            _ => Ok(()),
        }
    }

    fn pause(&mut self, time: Duration) {
        self.asked.pause.store(true, Ordering::Relaxed);
        std::thread::sleep(time);
        self.asked.pause.store(false, Ordering::Relaxed);
    }
}

impl Drop for SerialLink {
    fn drop(&mut self) {
        self.asked.stop.store(true, Ordering::Relaxed);
        if let Some(reader) = self.reader.take() {
            // It ends within one POLL; a panic in it has nothing to say here.
            let _ = reader.join();
        }
    }
}

fn read_until_stopped(
    mut port: Box<dyn SerialPort>,
    asked: &Asked,
    waiting: &AtomicUsize,
    sender: &Sender<io::Result<Vec<u8>>>,
) {
    let mut buffer = vec![0; 16 * 1024];
    while !asked.stop.load(Ordering::Relaxed) {
        let is_full = waiting.load(Ordering::Relaxed) >= MOST_WAITING;
        if is_full || asked.pause.load(Ordering::Relaxed) {
            std::thread::sleep(PAUSE);
            continue;
        }
        let chunk = match port.read(&mut buffer) {
            // A terminal that has hung up reads as its end.
            Ok(0) => Err(io::Error::from(io::ErrorKind::UnexpectedEof)),
            Ok(count) => {
                waiting.fetch_add(count, Ordering::Relaxed);
                Ok(buffer.get(..count).unwrap_or_default().to_vec())
            }
            Err(error) if is_passing(&error) => continue,
            Err(error) => Err(error),
        };
        let ends = chunk.is_err();
        if sender.send(chunk).is_err() || ends {
            return;
        }
    }
}

fn is_passing(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
    )
}

fn why(path: &str, error: &serialport::Error) -> OpenError {
    let owned = path.to_owned();
    match error.kind() {
        // The serialport crate gives NoDevice for a port that is locked too.
        ErrorKind::NoDevice if Path::new(path).exists() => OpenError::Busy { path: owned },
        ErrorKind::NoDevice | ErrorKind::Io(io::ErrorKind::NotFound) => {
            OpenError::NotFound { path: owned }
        }
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => OpenError::Permission { path: owned },
        _ if is_plain_file(path) => OpenError::NotAPort { path: owned },
        _ => OpenError::Other {
            path: owned,
            reason: error.to_string(),
        },
    }
}

/// Returns a process whose controlling terminal is the pseudo-terminal at a path. No program makes
/// the port of a board its own.
#[cfg(target_os = "linux")]
fn controlled_by(path: &Path) -> Option<u32> {
    use std::os::unix::fs::MetadataExt as _;
    if !path.canonicalize().ok()?.starts_with("/dev/pts") {
        return None;
    }
    let device = std::fs::metadata(path).ok()?.rdev();
    let (major, minor) = (rustix::fs::major(device), rustix::fs::minor(device));
    // As the kernel writes it into `stat` (new_encode_dev in kdev_t.h).
    let number = (minor & 0xff) | (major << 8) | ((minor & !0xff) << 12);
    let processes = std::fs::read_dir("/proc").ok()?;
    processes.filter_map(Result::ok).find_map(|entry| {
        let process: u32 = entry.file_name().to_str()?.parse().ok()?;
        let stat = std::fs::read_to_string(entry.path().join("stat")).ok()?;
        // The name before it may hold anything (proc_pid_stat(5), field 7).
        let (_, fields) = stat.rsplit_once(')')?;
        let terminal: i64 = fields.split_whitespace().nth(4)?.parse().ok()?;
        (terminal == i64::from(number)).then_some(process)
    })
}

/// Returns true if the path exists and cannot be a port. A device that is not a terminal
/// (`/dev/null`) counts: it fails with ENOTTY, which the serialport crate does not distinguish
/// from other errors.
fn is_plain_file(path: &str) -> bool {
    let name = Path::new(path)
        .file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default();
    std::fs::metadata(path).is_ok() && !name.starts_with("tty") && !path.starts_with("/dev/pts/")
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use serialport::TTYPort;

    use super::*;

    fn pair() -> (TTYPort, String) {
        let (master, slave) = TTYPort::pair().unwrap();
        let path = slave.name().unwrap();
        // The pair opens the slave exclusively; hand it over.
        drop(slave);
        (master, path)
    }

    #[test]
    fn bytes_go_both_ways_through_a_pseudo_terminal() {
        let (mut master, path) = pair();
        let mut link = SerialLink::open(&path).unwrap();
        // Every byte value, untouched by any line discipline.
        let all: Vec<u8> = (0..=255).collect();
        link.send(&all).unwrap();
        let mut there = vec![0; 256];
        master.read_exact(&mut there).unwrap();
        assert_eq!(there, all);
        master.write_all(&all).unwrap();
        let mut back = Vec::new();
        while back.len() < 256 {
            link.receive(&mut back, Duration::from_secs(5)).unwrap();
        }
        assert_eq!(back, all);
        link.receive(&mut back, Duration::from_millis(10)).unwrap();
        assert_eq!(back.len(), 256);
    }

    /// A person's shell neither gets the bytes for a board nor loses its keys.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_terminal_that_controls_processes_is_no_port() {
        let (_master, path) = pair();
        let terminal = std::fs::File::options().read(true).write(true).open(&path);
        let mut shell = std::process::Command::new("setsid")
            .args(["--ctty", "sleep", "60"])
            .stdin(terminal.unwrap())
            .spawn()
            .unwrap();
        // It takes the terminal before it becomes the other program.
        let name = format!("/proc/{}/comm", shell.id());
        while std::fs::read_to_string(&name).unwrap().trim() != "sleep" {
            std::thread::yield_now();
        }
        let refused = SerialLink::open(&path).map(drop);
        assert!(
            matches!(refused, Err(OpenError::Terminal { process, .. }) if process == shell.id()),
            "{refused:?}"
        );
        shell.kill().unwrap();
        shell.wait().unwrap();
        assert!(SerialLink::open(&path).is_ok());
    }

    #[test]
    fn a_second_opener_is_told_that_the_port_is_busy() {
        let (_master, path) = pair();
        let first = SerialLink::open(&path).unwrap();
        assert!(matches!(
            SerialLink::open(&path),
            Err(OpenError::Busy { .. })
        ));
        drop(first);
        // A process that another test starts holds the lock until it runs its program.
        let until = Instant::now() + Duration::from_secs(5);
        while SerialLink::open(&path).is_err() {
            assert!(Instant::now() < until);
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn an_end_that_goes_away_is_told_after_its_last_bytes() {
        let (mut master, path) = pair();
        let mut link = SerialLink::open(&path).unwrap();
        master.write_all(b"last").unwrap();
        let mut bytes = Vec::new();
        link.receive(&mut bytes, Duration::from_secs(5)).unwrap();
        assert_eq!(bytes, b"last");
        drop(master);
        let error = loop {
            let mut none = Vec::new();
            if let Err(error) = link.receive(&mut none, Duration::from_secs(5)) {
                break error;
            }
        };
        assert!(matches!(error, LinkError::Gone { .. }));
        assert!(matches!(link.send(b"x"), Err(LinkError::Gone { .. })));
    }

    #[test]
    fn paths_that_are_no_port_say_so() {
        assert!(matches!(
            SerialLink::open("/dev/smartdepthsync-not-there"),
            Err(OpenError::NotFound { .. })
        ));
        assert!(matches!(
            SerialLink::open("/dev/null"),
            Err(OpenError::NotAPort { .. })
        ));
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(matches!(
            SerialLink::open(&file.path().to_string_lossy()),
            Err(OpenError::NotAPort { .. })
        ));
    }
}
