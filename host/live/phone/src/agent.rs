//! Reads the phone's clocks while it records, by a small program of ours on the phone.
//!
//! [`Agent::start`] finds the phone by `adb`, copies the program to it (`/data/local/tmp`), starts
//! it, and queries it repeatedly from a thread, through a port that `adb` forwards to it.
//! [`phone_agent`] documents the messages and how the program ends by itself.
//!
//! When the phone's cable is pulled, the program ends for lack of queries, and `adb` drops the
//! port. So once queries fail, the program is copied and started again until it answers.
//!
//! Nothing is left running on the phone, however this program ends: the program there removes its
//! own file when it starts, and exits after [`PATIENCE_S`] seconds without a query. Dropping the
//! [`Agent`] releases the forwarded port on this computer; after a SIGKILL the `adb` server keeps
//! the port until the server ends.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use phone_agent::{ANSWER, Answer, PATIENCE_S, question};
use system::{Cancel, Process};

use crate::adb::{Adb, AdbError, PATIENCE};

/// Folder on the phone from which programs can be run without root access.
const FOLDER: &str = "/data/local/tmp";

/// Beginning of the names of the program's file and its socket.
const NAME: &str = "smartdepthsync-phone-agent";

/// Mean interval between queries.
const EVERY: Duration = Duration::from_millis(20);

/// Longest wait for an answer. A later one is of no use, and its connection is closed.
const LATE: Duration = Duration::from_secs(2);

/// Longest single wait between two checks for cancellation.
const SLICE: Duration = Duration::from_millis(100);

/// Longest start of the program.
const START: Duration = Duration::from_secs(5);

/// Pause between two attempts to start the program again.
const PAUSE: Duration = Duration::from_millis(500);

/// A query of the phone's clocks and its answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhoneExchange {
    /// Time of the query, on the clock that [`Agent::start`] was given.
    pub sent: Duration,
    /// Time of the answer's arrival, on the same clock.
    pub received: Duration,
    /// Readings of the phone's clocks in between.
    pub answer: Answer,
}

/// A program on the phone that reads its clocks. It is started again if it ends early, and exits by
/// itself within [`PATIENCE_S`] seconds after this is dropped.
pub struct Agent {
    device: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    exchanges: Receiver<PhoneExchange>,
}

/// One start of the program, and the port to it. Dropping this releases the port.
struct Running {
    adb: Adb,
    device: String,
    port: u16,
    /// `adb shell`, which lasts as long as the agent does.
    _shell: Process,
}

/// Finds the program's file for an instruction set, by Android's name: beside this executable, or
/// where a package installs it.
fn program_for(processor: &str) -> Option<PathBuf> {
    let name = format!("{NAME}-{processor}");
    let own = std::env::current_exe().ok()?;
    let folder = own.parent()?;
    let places = [
        folder.join(&name),
        folder
            .join("../share/smartdepthsync/phone-agent")
            .join(&name),
    ];
    places.into_iter().find(|place| place.is_file())
}

impl Running {
    /// Copies the program to the phone, starts it there, and waits until it answers. Removes its
    /// file if it does not.
    fn start(
        adb: &Adb,
        device: &str,
        now: fn() -> Duration,
    ) -> Result<(Self, TcpStream), AdbError> {
        let said = adb.shell(device, "getprop ro.product.cpu.abilist")?;
        let programs = said.trim().split(',').find_map(program_for);
        let Some(program) = programs else {
            return Err(AdbError::NoAgent {
                processors: said.trim().to_owned(),
            });
        };
        let number = u64::from(std::process::id()) << 32
            | std::time::SystemTime::now()
                .duration_since(std::time::UNIX_EPOCH)
                .map_or(0, |since| u64::from(since.subsec_nanos()));
        let socket = format!("{NAME}-{number:x}");
        let file = format!("{FOLDER}/{socket}");
        let pushed = adb.run_for(device, &["push", &program.to_string_lossy(), &file]);
        let started = pushed.and_then(|_| {
            let running = Self::launch(adb, device, &file, &socket)?;
            let stream = first_answer(running.port, now, adb.cancel())?;
            Ok((running, stream))
        });
        if started.is_err() {
            adb.clean_up(device, &["shell", &format!("rm -f {file}")]);
        }
        started
    }

    /// Starts the copied file, and has a port forwarded to it.
    fn launch(adb: &Adb, device: &str, file: &str, socket: &str) -> Result<Self, AdbError> {
        adb.shell(device, &format!("chmod 755 {file}"))?;
        let line = format!("{file} {socket} {PATIENCE_S}");
        let mut command = Command::new(adb.program());
        command
            .args(["-s", device, "shell", &line])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let shell = Process::spawn(&mut command).map_err(|source| adb.cannot_run(source))?;
        let forward = ["forward", "tcp:0", &format!("localabstract:{socket}")];
        let forwarded = adb.run_to_end(device, &forward, PATIENCE);
        let said = forwarded?;
        let port = said.trim().parse().map_err(|_| AdbError::Failed {
            command: String::from("forward tcp:0"),
            reason: format!("expected a port, found {:?}", said.trim()),
        })?;
        Ok(Self {
            adb: adb.clone(),
            device: device.to_owned(),
            port,
            _shell: shell,
        })
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let port = format!("tcp:{}", self.port);
        let remove = ["forward", "--remove", &port];
        self.adb.clean_up(&self.device, &remove);
    }
}

impl Agent {
    /// Starts the program on the only phone that `adb` finds, and queries it from now on. `now` is
    /// the clock of the times in [`PhoneExchange`].
    ///
    /// # Errors
    ///
    /// There is no `adb` or not exactly one phone, there is no program for its processor, or the
    /// program does not answer.
    pub fn start(now: fn() -> Duration, cancel: &Cancel) -> Result<Self, AdbError> {
        let adb = Adb::find(cancel)?;
        let device = adb.only_device()?;
        let (running, stream) = Running::start(&adb, &device, now)?;
        let ends = Arc::new(AtomicBool::new(false));
        let ended = {
            let (ends, cancel) = (Arc::clone(&ends), cancel.clone());
            Cancel::when(move || ends.load(Ordering::Relaxed) || cancel.is_requested())
        };
        let (sender, exchanges) = channel();
        let asking = std::thread::Builder::new().name(String::from("phone's clock"));
        let thread = asking.spawn(move || query(running, stream, now, &ended, &sender));
        Ok(Self {
            device,
            stop: ends,
            thread: Some(thread.map_err(|source| adb.cannot_run(source))?),
            exchanges,
        })
    }

    /// Returns true if the phone is reached through a network: `adb` names such a phone by its
    /// address.
    #[must_use]
    pub fn is_by_network(&self) -> bool {
        self.device.contains(':')
    }

    /// Returns the phone's name in `adb`, which is a serial number or an address.
    #[must_use]
    pub fn device(&self) -> &str {
        &self.device
    }

    /// Returns the exchanges since the last call.
    pub fn exchanges(&self) -> impl Iterator<Item = PhoneExchange> {
        self.exchanges.try_iter()
    }
}

impl Drop for Agent {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn connect(port: u16) -> std::io::Result<TcpStream> {
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    let stream = TcpStream::connect_timeout(&address, LATE)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(SLICE))?;
    stream.set_write_timeout(Some(LATE))?;
    Ok(stream)
}

/// Connects and waits for the first answer. Until the program has started, `adb` accepts
/// connections and closes them.
fn first_answer(port: u16, now: fn() -> Duration, cancel: &Cancel) -> Result<TcpStream, AdbError> {
    let begun = Instant::now();
    loop {
        let tried = connect(port).and_then(|mut stream| {
            exchange(&mut stream, 0, now, cancel)?;
            Ok(stream)
        });
        match tried {
            Ok(stream) => return Ok(stream),
            Err(_) if cancel.is_requested() => return Err(AdbError::Cancelled),
            Err(error) if begun.elapsed() > START => {
                return Err(AdbError::Failed {
                    command: String::from("shell (the agent)"),
                    reason: format!("no answer within {START:?}: {error}"),
                });
            }
            Err(_) => std::thread::sleep(Duration::from_millis(50)),
        }
    }
}

/// Queries the program once. An answer of another program is [`ErrorKind::InvalidData`].
fn exchange(
    stream: &mut TcpStream,
    nonce: u64,
    now: fn() -> Duration,
    cancel: &Cancel,
) -> std::io::Result<PhoneExchange> {
    let sent = now();
    stream.write_all(&question(nonce))?;
    loop {
        let bytes = read_answer(stream, cancel)?;
        let received = now();
        let answer = Answer::read(&bytes).ok_or(ErrorKind::InvalidData)?;
        // Any other answer is to an earlier query that took too long.
        if answer.nonce == nonce {
            return Ok(PhoneExchange {
                sent,
                received,
                answer,
            });
        }
    }
}

/// Reads the next answer, unless it is late or the query is cancelled.
fn read_answer(stream: &mut TcpStream, cancel: &Cancel) -> std::io::Result<[u8; ANSWER]> {
    let begun = Instant::now();
    let mut bytes = [0; ANSWER];
    let mut rest = bytes.as_mut_slice();
    while !rest.is_empty() {
        match stream.read(rest) {
            Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
            Ok(count) => rest = rest.get_mut(count..).unwrap_or_default(),
            Err(error) => {
                use ErrorKind::{Interrupted, TimedOut, WouldBlock};
                let waits = matches!(error.kind(), Interrupted | TimedOut | WouldBlock);
                if !waits || cancel.is_requested() || begun.elapsed() >= LATE {
                    return Err(error);
                }
            }
        }
    }
    Ok(bytes)
}

/// Queries the program until it is cancelled. A program that no longer answers has ended, or the
/// cable was pulled: it is started again until it answers.
fn query(
    first: Running,
    stream: TcpStream,
    now: fn() -> Duration,
    cancel: &Cancel,
    sender: &Sender<PhoneExchange>,
) {
    let device = first.device.clone();
    let mut open = Some((first, stream));
    let mut nonce = 0_u64;
    while !cancel.is_requested() {
        nonce = nonce.wrapping_add(1);
        // Avoids beats with periodic events on the way, such as the frames of USB.
        let scatter = nonce.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 54;
        std::thread::sleep(EVERY / 2 + EVERY.mul_f64(scatter as f64 / 1024.0));
        let Some((running, stream)) = &mut open else {
            std::thread::sleep(PAUSE);
            open = restart(&device, now, cancel);
            continue;
        };
        match exchange(stream, nonce, now, cancel) {
            Ok(exchange) => {
                if sender.send(exchange).is_err() {
                    return;
                }
            }
            // The connection was cut or late, or the program has ended.
            Err(_) => match first_answer(running.port, now, cancel) {
                Ok(fresh) => *stream = fresh,
                Err(_) => open = None,
            },
        }
    }
}

/// Starts the program again, if the phone is connected.
fn restart(device: &str, now: fn() -> Duration, cancel: &Cancel) -> Option<(Running, TcpStream)> {
    let adb = Adb::find(cancel).ok()?;
    Running::start(&adb, device, now).ok()
}
