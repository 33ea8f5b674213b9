//! A phone behind Debian's `adb`: the device's end of the ADB protocol, with a folder as its
//! files and this computer's shell as its own, and a server of `adb` that has no other phone.
//!
//! As AOSP's `packages/modules/adb` documents it: `protocol.txt` (messages), `SERVICES.TXT`
//! (`shell:`, `localabstract:`, and `host:emulator:`, by which the phone announces itself;
//! a serial without a colon counts as USB) and `SYNC.TXT` (`adb push` and `pull`). It asks for
//! no key and offers no feature, so that `adb` takes the first form of each. Nobody ends a
//! program whose `adb shell` has gone. Programs for a phone's processor run under
//! `qemu-aarch64`.

use std::collections::{HashMap, VecDeque};
use std::io::{self, BufReader, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::os::unix::net::{SocketAddr, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use test_support::processes;

/// The longest that anything is waited for.
const PATIENCE: Duration = Duration::from_secs(60);

/// The first version of the protocol, and the most bytes of its messages.
const VERSION: u32 = 0x0100_0000;
const MOST: usize = 4096;

const CNXN: u32 = word(*b"CNXN");
const OPEN: u32 = word(*b"OPEN");
const OKAY: u32 = word(*b"OKAY");
const WRTE: u32 = word(*b"WRTE");
const CLSE: u32 = word(*b"CLSE");

const fn word(name: [u8; 4]) -> u32 {
    u32::from_le_bytes(name)
}

/// The phone, its cable, and the server of `adb`, which ends with it.
pub(crate) struct AdbPhone {
    phone: Arc<Phone>,
    /// Where it listens for the server.
    port: u16,
    server: Server,
    _folder: tempfile::TempDir,
}

/// State of the phone's side.
struct Phone {
    /// Its files.
    root: PathBuf,
    /// Emulator of its processor's programs.
    emulator: &'static str,
    /// The cable, while it is in.
    cable: Mutex<Option<TcpStream>>,
    /// Programs that were started, and those that run.
    started: AtomicUsize,
    running: AtomicUsize,
}

impl AdbPhone {
    /// A phone that is plugged in, with `storage` as the app's folder. Its processor's
    /// programs are run with `emulator`.
    pub(crate) fn new(storage: &Path, emulator: &'static str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("phone");
        std::fs::create_dir_all(root.join("data/local/tmp")).unwrap();
        std::fs::create_dir_all(root.join("sdcard/DCIM")).unwrap();
        std::os::unix::fs::symlink(storage, root.join("sdcard/DCIM/OpenCamera")).unwrap();
        let phone = Arc::new(Phone {
            root,
            emulator,
            cable: Mutex::default(),
            started: AtomicUsize::new(0),
            running: AtomicUsize::new(0),
        });
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let port = listener.local_addr().unwrap().port();
        let serving = Arc::clone(&phone);
        // Until the tests end: nobody announces it any more.
        std::thread::spawn(move || {
            for cable in listener.incoming().map_while(Result::ok) {
                *serving.cable.lock().unwrap() = cable.try_clone().ok();
                let phone = Arc::clone(&serving);
                // An end of the cable is an end of all that went through it.
                std::thread::spawn(move || phone.serve(cable));
            }
        });
        let phone = Self {
            phone,
            port,
            server: Server::start(folder.path()),
            _folder: folder,
        };
        phone.plug();
        phone
    }

    /// As `adb` names it.
    pub(crate) fn serial(&self) -> String {
        format!("emulator-{}", self.port - 1)
    }

    /// Lets a program find the phone: its `adb` finds the server, and starts none by itself.
    pub(crate) fn show<'a>(&self, command: &'a mut Command) -> &'a mut Command {
        command
            .env(
                "ANDROID_ADB_SERVER_ADDRESS",
                Ipv4Addr::LOCALHOST.to_string(),
            )
            .env("ANDROID_ADB_SERVER_PORT", self.server.port.to_string())
    }

    /// Output of `adb`.
    pub(crate) fn adb(&self, arguments: &[&str]) -> String {
        let output = self.show(Command::new("adb").args(arguments)).output();
        let output = output.unwrap();
        assert!(output.status.success(), "adb {arguments:?}: {output:?}");
        String::from_utf8(output.stdout).unwrap()
    }

    /// State of the phone by `adb`.
    fn state(&self) -> Option<String> {
        let list = self.adb(&["devices"]);
        let mut lines = list.lines().filter_map(|line| line.split_once('\t'));
        let (_, state) = lines.find(|(serial, _)| *serial == self.serial())?;
        Some(state.to_owned())
    }

    /// Puts the cable in, and waits until `adb` has the phone.
    pub(crate) fn plug(&self) {
        wait_until("adb has the phone", || {
            let state = self.state();
            if state.is_none() {
                let announced = format!("host:emulator:{}", self.port);
                let mut server =
                    TcpStream::connect((Ipv4Addr::LOCALHOST, self.server.port)).unwrap();
                write!(server, "{:04x}{announced}", announced.len()).unwrap();
            }
            state.as_deref() == Some("device")
        });
    }

    /// Pulls it, and waits until `adb` has missed the phone.
    pub(crate) fn pull(&self) {
        if let Some(cable) = self.phone.cable.lock().unwrap().take() {
            cable.shutdown(Shutdown::Both).unwrap();
        }
        wait_until("adb misses the phone", || self.state().is_none());
    }

    /// Waits until a number of programs for its processor were started.
    pub(crate) fn wait_for_programs(&self, count: usize) {
        wait_until("programs were started", || {
            self.phone.started.load(Ordering::SeqCst) >= count
        });
    }

    /// Waits until none of them runs, and looks that nothing is left: no file on the phone, no port
    /// on the computer.
    pub(crate) fn wait_until_clean(&self) {
        wait_until("programs have ended", || {
            self.phone.running.load(Ordering::SeqCst) == 0
        });
        let files = std::fs::read_dir(self.phone.root.join("data/local/tmp")).unwrap();
        let left: Vec<_> = files.map(|file| file.unwrap().file_name()).collect();
        assert!(left.is_empty(), "{left:?}");
        assert_eq!(self.adb(&["forward", "--list"]).trim(), "");
    }
}

fn wait_until(what: &str, mut done: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !done() {
        assert!(begun.elapsed() < PATIENCE, "{what}: never");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A server of `adb` with nothing of this computer: no phone, no emulator, no key.
struct Server {
    process: Child,
    port: u16,
}

impl Server {
    /// Starts it, with what it writes in a folder.
    fn start(folder: &Path) -> Self {
        loop {
            let free = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
            let port = free.local_addr().unwrap().port();
            drop(free);
            let process = processes::bound("adb")
                .args(["nodaemon", "server"])
                .env("HOME", folder)
                .env("TMPDIR", folder)
                .envs([("ADB_USB", "0"), ("ADB_EMU", "0"), ("ADB_MDNS", "0")])
                .env("ANDROID_ADB_SERVER_PORT", port.to_string())
                .env_remove("ANDROID_ADB_SERVER_ADDRESS")
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .expect("this test needs adb: sudo apt-get install adb");
            let mut server = Self { process, port };
            let mut ended = false;
            wait_until("adb's server serves", || {
                ended = server.process.try_wait().unwrap().is_some();
                ended || TcpStream::connect((Ipv4Addr::LOCALHOST, port)).is_ok()
            });
            // Otherwise another process has taken the port.
            if !ended {
                return server;
            }
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Phone {
    /// Answers the server until the cable is pulled.
    fn serve(self: Arc<Self>, cable: TcpStream) -> io::Result<()> {
        let mut from = BufReader::new(cable.try_clone()?);
        let cable = Arc::new(Mutex::new(cable));
        let mut streams: HashMap<u32, (Sender<Vec<u8>>, Sender<()>)> = HashMap::new();
        let mut last = 0;
        loop {
            let [command, theirs, ours, length, _, _] = words(&mut from)?;
            let data = bytes(&mut from, length)?;
            match command {
                CNXN => send(&cable, CNXN, (VERSION, MOST as u32), b"device::\0")?,
                OPEN => {
                    last += 1;
                    let ((come, coming), (take, taken)) = (channel(), channel());
                    streams.insert(last, (come, take));
                    let end = End {
                        cable: Arc::clone(&cable),
                        ours: last,
                        theirs,
                    };
                    let input = Input {
                        end: end.clone(),
                        coming,
                        rest: VecDeque::new(),
                    };
                    let output = Output { end, taken };
                    let phone = Arc::clone(&self);
                    std::thread::spawn(move || phone.open(&data, input, output));
                }
                // A service that has ended has no use for them.
                OKAY => {
                    let _ = streams.get(&ours).map(|(_, take)| take.send(()));
                }
                WRTE => {
                    let _ = streams.get(&ours).map(|(come, _)| come.send(data));
                }
                CLSE => drop(streams.remove(&ours)),
                _ => return Err(ErrorKind::InvalidData.into()),
            }
        }
    }

    /// A service, from its begin to its end.
    fn open(&self, service: &[u8], mut input: Input, mut output: Output) -> io::Result<()> {
        let service = String::from_utf8_lossy(service);
        let service = service.trim_end_matches('\0');
        let end = output.end.clone();
        if let Some(name) = service.strip_prefix("localabstract:") {
            let address = SocketAddr::from_abstract_name(name)?;
            let Ok(mut program) = UnixStream::connect_addr(&address) else {
                return send(&end.cable, CLSE, (0, end.theirs), b"");
            };
            end.send(OKAY, b"")?;
            let mut there = program.try_clone()?;
            std::thread::spawn(move || {
                let _ = io::copy(&mut input, &mut there);
                there.shutdown(Shutdown::Both)
            });
            let _ = io::copy(&mut program, &mut output);
        } else {
            end.send(OKAY, b"")?;
            if let Some(line) = service.strip_prefix("shell:") {
                output.write_all(&self.shell(line)?)?;
            } else {
                self.sync(&mut input, &mut output)?;
            }
        }
        end.send(CLSE, b"")
    }

    /// A file of the phone's.
    fn file(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }

    /// Output of a line, in the folder that stands for the phone's root.
    fn shell(&self, line: &str) -> io::Result<Vec<u8>> {
        let line = line
            .replace("/data/", "data/")
            .replace("/sdcard/", "sdcard/");
        let first = line.split(' ').next().unwrap_or_default();
        let is_program =
            std::fs::read(self.file(first)).is_ok_and(|file| file.starts_with(b"\x7fELF"));
        let emulator = if is_program { self.emulator } else { "" };
        self.started.fetch_add(is_program.into(), Ordering::SeqCst);
        self.running.fetch_add(is_program.into(), Ordering::SeqCst);
        let line = format!("getprop() {{ echo arm64-v8a,armeabi-v7a; }}; {emulator} {line}");
        let ran = Command::new("sh")
            .args(["-c", &line])
            .current_dir(&self.root)
            .output();
        self.running.fetch_sub(is_program.into(), Ordering::SeqCst);
        let said = String::from_utf8_lossy(&ran?.stdout).replace("sdcard/", "/sdcard/");
        Ok(said.into_bytes())
    }

    /// Takes and gives files.
    fn sync(&self, input: &mut Input, output: &mut Output) -> io::Result<()> {
        loop {
            let [request, length] = words(input)?;
            let said = String::from_utf8_lossy(&bytes(input, length)?).into_owned();
            match &request.to_le_bytes() {
                b"STAT" => {
                    let there = std::fs::metadata(self.file(&said)).ok();
                    let facts = there.map_or([0; 3], |there| {
                        [there.mode(), there.size() as u32, there.mtime() as u32]
                    });
                    output.write_all(&packed(&[request, facts[0], facts[1], facts[2]]))?;
                }
                b"SEND" => {
                    let (path, mode) = said.rsplit_once(',').ok_or(ErrorKind::InvalidData)?;
                    let mode = mode.parse().map_err(|_| ErrorKind::InvalidData)?;
                    let mut file = Vec::new();
                    loop {
                        let [part, length] = words(input)?;
                        if part != word(*b"DATA") {
                            break;
                        }
                        file.extend(bytes(input, length)?);
                    }
                    let path = self.file(path);
                    std::fs::write(&path, file)?;
                    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode))?;
                    output.write_all(&packed(&[OKAY, 0]))?;
                }
                b"RECV" => {
                    for part in std::fs::read(self.file(&said))?.chunks(64 * 1024) {
                        output.write_all(&packed(&[word(*b"DATA"), part.len() as u32]))?;
                        output.write_all(part)?;
                    }
                    output.write_all(&packed(&[word(*b"DONE"), 0]))?;
                }
                _ => return Ok(()),
            }
        }
    }
}

/// Our end of a stream.
#[derive(Clone)]
struct End {
    cable: Arc<Mutex<TcpStream>>,
    ours: u32,
    theirs: u32,
}

impl End {
    fn send(&self, command: u32, data: &[u8]) -> io::Result<()> {
        send(&self.cable, command, (self.ours, self.theirs), data)
    }
}

/// Our side of a stream that comes.
struct Input {
    end: End,
    coming: Receiver<Vec<u8>>,
    rest: VecDeque<u8>,
}

impl Read for Input {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        if self.rest.is_empty()
            && let Ok(data) = self.coming.recv()
        {
            self.end.send(OKAY, b"")?;
            self.rest = data.into();
        }
        self.rest.read(to)
    }
}

/// Our side of a stream that goes: a message at a time.
struct Output {
    end: End,
    taken: Receiver<()>,
}

impl Write for Output {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        let part = data.get(..MOST).unwrap_or(data);
        self.end.send(WRTE, part)?;
        let taken = self.taken.recv();
        taken.map_err(|_| ErrorKind::BrokenPipe)?;
        Ok(part.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn words<const N: usize>(from: &mut impl Read) -> io::Result<[u32; N]> {
    let mut words = [0; N];
    for word in &mut words {
        let mut bytes = [0; 4];
        from.read_exact(&mut bytes)?;
        *word = u32::from_le_bytes(bytes);
    }
    Ok(words)
}

fn bytes(from: &mut impl Read, length: u32) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; length as usize];
    from.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn packed(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// Sends a message, in one piece.
fn send(
    cable: &Mutex<TcpStream>,
    command: u32,
    (from, to): (u32, u32),
    data: &[u8],
) -> io::Result<()> {
    let sum = data.iter().map(|&byte| u32::from(byte)).sum();
    let head = [command, from, to, data.len() as u32, sum, !command];
    let message = [packed(&head), data.to_vec()].concat();
    cable.lock().unwrap().write_all(&message)
}
