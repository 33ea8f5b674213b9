//! A stand-in for the board on a pseudo-terminal, for tests of failures of the program, and
//! runs of the program whose output a failing test prints. The real firmware is tested in
//! `hil-sim`.

mod session;
pub(crate) mod synthetic;

use std::fs::{self, File, Permissions};
use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use protocol::{Answer, Decoder, DeviceToHost, Hello, HostToDevice, Pong, Reply, Ticks};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use test_support::board::{frame, hello, imu_setup};
use test_support::processes::Ran;

/// Behaviour of the stand-in: its bytes after a command, and every 10 ms.
pub(crate) trait Behaviour: Send + 'static {
    fn command(&mut self, command: HostToDevice) -> Vec<u8>;
    fn tick(&mut self) -> Vec<u8> {
        Vec::new()
    }
}

impl<F: FnMut(HostToDevice) -> Vec<u8> + Send + 'static> Behaviour for F {
    fn command(&mut self, command: HostToDevice) -> Vec<u8> {
        self(command)
    }
}

pub(crate) struct StandIn {
    pub(crate) path: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Opens a pseudo-terminal. Returns its master, and the path of the other end.
pub(crate) fn terminal() -> (File, String) {
    // Not inherited by the programs under test: the port must go with us.
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let path = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
    (File::from(master), path)
}

impl StandIn {
    pub(crate) fn new(mut behaviour: impl Behaviour) -> Self {
        let (mut master, path) = terminal();
        // Without any open end the master reads errors.
        let keep = File::options().read(true).write(true).open(&path).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        rustix::io::ioctl_fionbio(&master, true).unwrap();
        let thread = std::thread::spawn(move || {
            let _keep = keep;
            let mut decoder = Decoder::<HostToDevice>::new();
            let mut buffer = [0; 1024];
            // What the host has not taken yet; a board would drop, this waits.
            let mut pending = Vec::new();
            while !stopped.load(Ordering::Relaxed) {
                let wait = Timespec {
                    tv_sec: 0,
                    tv_nsec: 10_000_000,
                };
                let mut ready = [PollFd::new(&master, PollFlags::IN)];
                poll(&mut ready, Some(&wait)).unwrap();
                let mut input: &[u8] = match master.read(&mut buffer) {
                    Ok(count) => &buffer[..count],
                    Err(_) => &[],
                };
                while let Some(result) = decoder.next(&mut input) {
                    if let Ok(command) = result {
                        pending.extend(behaviour.command(command));
                    }
                }
                if pending.is_empty() {
                    pending = behaviour.tick();
                }
                if let Ok(count) = master.write(&pending) {
                    pending.drain(..count);
                }
            }
        });
        Self {
            path,
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for StandIn {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

/// Returns the frames with which a board answers a request for its hello.
pub(crate) fn greeting(id: u32, hello: Hello) -> Vec<u8> {
    let result = Ok(Reply::SayHello(()));
    let answer = DeviceToHost::Answer(Answer { id, result });
    [frame(&DeviceToHost::Hello(hello)), frame(&answer)].concat()
}

/// Answers requests for information as a board does.
pub(crate) fn polite(command: HostToDevice) -> Vec<u8> {
    let id = command.id;
    let answer = |reply| {
        frame(&DeviceToHost::Answer(Answer {
            id,
            result: Ok(reply),
        }))
    };
    match command.command {
        protocol::Command::SayHello(_) => greeting(id, hello()),
        protocol::Command::Ping(ping) => answer(Reply::Ping(Pong {
            host_time: ping.host_time,
            received: Ticks(48_000_000 * 91),
            sent: Ticks(48_000_000 * 91 + 900),
        })),
        protocol::Command::QueryImu(_) => answer(Reply::QueryImu(imu_setup())),
        protocol::Command::QueryBoard(_) => answer(Reply::QueryBoard(protocol::BoardSettings {
            output_start_delay: 2,
            input_delay: 11,
            crystal_ppb: Some(-12_300),
        })),
        _ => Vec::new(),
    }
}

/// Runs the program to its end.
pub(crate) fn run(args: &[&str]) -> Ran {
    Ran::new(&mut program(args))
}

/// Runs the program with the words of a line, which are separated by single spaces.
pub(crate) fn run_line(line: &str) -> Ran {
    run(&line.split(' ').collect::<Vec<_>>())
}

/// Writes a shell script that stands in for a program.
pub(crate) fn script(path: &Path, text: &str) {
    fs::write(path, text).unwrap();
    fs::set_permissions(path, Permissions::from_mode(0o755)).unwrap();
}

/// Makes a video of a moving picture.
pub(crate) fn test_video(path: &Path, frames: u32, more: &[&str]) {
    let made = Command::new("ffmpeg")
        .args("-v error -f lavfi -i testsrc2=size=64x48:rate=30 -pix_fmt yuv420p".split(' '))
        .args(["-frames:v", &frames.to_string()])
        .args(more)
        .arg(path)
        .status()
        .expect("this test needs ffmpeg: sudo apt-get install ffmpeg");
    assert!(made.success());
}

/// Returns all subcommands below a command except `help`, each with the words that call it.
pub(crate) fn commands(of: &clap::Command, words: &str) -> Vec<(String, clap::Command)> {
    let mut found = Vec::new();
    for below in of
        .get_subcommands()
        .filter(|command| command.get_name() != "help")
    {
        let words = format!("{words} {}", below.get_name());
        found.push((words.trim_start().to_owned(), below.clone()));
        found.extend(commands(below, words.trim_start()));
    }
    found
}

pub(crate) fn program(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_smartdepthsync"));
    command.args(args);
    command
}

pub(crate) fn code(output: &Output) -> i32 {
    output.status.code().unwrap_or_else(|| {
        panic!("ended by a signal: {output:?}");
    })
}

pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}
