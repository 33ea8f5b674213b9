//! A look at the phone's clocks while it records, by a small program of ours on the phone.
//!
//! [`Agent::start`] finds the phone by `adb`, copies the program there (`/data/local/tmp`),
//! starts it, and asks it again and again through a port that `adb` forwards to it; a
//! thread does nothing else. What is exchanged, and how the program ends by itself, is in
//! [`phone_agent`].
//!
//! A phone whose cable is pulled ends the agent by its silence, and `adb` forgets the port.
//! So where nothing answers any more, the program is copied and started again until it does.
//!
//! Whatever ends this program, nothing is left running on the phone: the agent removes its
//! own file when it starts, and ends once nobody has asked it for
//! [`PATIENCE_S`] seconds. The forwarded port, which is the computer's, is
//! given back by [`Agent`]'s end; after a SIGKILL the `adb` server keeps it until it ends.

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

/// Where a program may lie on a phone that is not rooted.
const FOLDER: &str = "/data/local/tmp";

/// What the program and its socket are called, before a number of their own.
const NAME: &str = "smartdepthsync-phone-agent";

/// How often the phone is asked.
const EVERY: Duration = Duration::from_millis(20);

/// An answer that is later than this is of no use, and its connection is given up.
const LATE: Duration = Duration::from_secs(2);

/// The longest single wait for an answer: how soon a request to stop is seen.
const SLICE: Duration = Duration::from_millis(100);

/// How long the program may take to start.
const START: Duration = Duration::from_secs(5);

/// Between two tries to reach it again.
const PAUSE: Duration = Duration::from_millis(500);

/// One question and its answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhoneExchange {
    /// When it was asked, on the clock that [`Agent::start`] was given.
    pub sent: Duration,
    /// When the answer came.
    pub received: Duration,
    /// What the phone's clocks read in between.
    pub answer: Answer,
}

/// A program on the phone that reads its clocks. It is started again where it has ended
/// meanwhile, and ends by itself soon after this is dropped ([`PATIENCE_S`]).
pub struct Agent {
    device: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    exchanges: Receiver<PhoneExchange>,
}

/// The program as it was started once, and the port to it, which is given back at its end.
struct Running {
    adb: Adb,
    device: String,
    port: u16,
    /// `adb shell`, which lasts as long as the agent does.
    _shell: Process,
}

/// The program's file for a processor, by Android's name of it: beside this program, or
/// where a package puts it.
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
    /// Copies it to the phone, starts it there, and asks it until it answers. Where it does
    /// not, its file is removed.
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
            adb.tidy_up(device, &["shell", &format!("rm -f {file}")]);
        }
        started
    }

    /// Starts what was copied, and finds a port to it.
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
        self.adb.tidy_up(&self.device, &remove);
    }
}

impl Agent {
    /// Starts it on the one phone that `adb` finds, and asks it from now on. `now` is the
    /// clock of [`PhoneExchange`]'s times.
    ///
    /// # Errors
    ///
    /// There is no `adb` or not one phone, none of our programs runs on it, or it does not
    /// answer.
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
        let thread = asking.spawn(move || ask(running, stream, now, &ended, &sender));
        Ok(Self {
            device,
            stop: ends,
            thread: Some(thread.map_err(|source| adb.cannot_run(source))?),
            exchanges,
        })
    }

    /// Whether it is reached through a network: `adb` names such a phone by its address.
    #[must_use]
    pub fn is_by_network(&self) -> bool {
        self.device.contains(':')
    }

    /// The phone, as `adb` names it.
    #[must_use]
    pub fn device(&self) -> &str {
        &self.device
    }

    /// What was exchanged since this was called last.
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

/// A connection to an agent that has answered: it needs a moment to start, and until then
/// `adb` accepts and closes.
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

/// Asks once. What is no answer of our program is [`ErrorKind::InvalidData`].
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
        // One to an earlier question was given up.
        if answer.nonce == nonce {
            return Ok(PhoneExchange {
                sent,
                received,
                answer,
            });
        }
    }
}

/// The next answer's bytes, unless it is late, or nobody wants it any more.
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

/// Asks until it is to stop; what cannot be asked is silence. Where the program does not
/// answer any more, it has ended or the cable was pulled: it is started again until it does.
fn ask(
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
        // Not in step with anything on the way, such as the frames of USB.
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
            // A connection that was cut or late, or one to a program that has ended.
            Err(_) => match first_answer(running.port, now, cancel) {
                Ok(fresh) => *stream = fresh,
                Err(_) => open = None,
            },
        }
    }
}

/// Starts the program again, if the phone is there.
fn restart(device: &str, now: fn() -> Duration, cancel: &Cancel) -> Option<(Running, TcpStream)> {
    let adb = Adb::find(cancel).ok()?;
    Running::start(&adb, device, now).ok()
}
