//! Between the phone and the program: whole answers are taken up to their last line,
//! changed as text, and passed on.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use super::Turn;
use rig::random::Random;

/// Requests whose answers are texts.
const REQUESTS: [&str; 3] = ["imu?", "video_start", "video_stop"];

/// Pause when nothing comes.
const PAUSE: Duration = Duration::from_millis(1);

/// What a number may become.
const NUMBERS: [&str; 16] = [
    "0",
    "-1",
    "1",
    "1e308",
    "-1e308",
    "1e-320",
    "NaN",
    "inf",
    "9223372036854775807",
    "-9223372036854775808",
    "18446744073709551616",
    "1000000",
    "33330652.5",
    "",
    "\u{1b}[2J",
    "999999999999999999999999999999999999999999",
];

/// A lie of the phone.
#[derive(Clone, Debug)]
pub(super) struct Lie {
    request: &'static str,
    turn: Turn,
    what: What,
}

#[derive(Clone, Debug)]
enum What {
    /// One number, by its place among all.
    Number(usize, &'static str),
    /// Every so many numbers.
    Numbers(usize, &'static str),
    /// One line, by its place, so many times: 0 takes it away.
    Line(usize, usize),
    /// The first line.
    Verdict(&'static str),
}

pub(super) fn draw(random: &mut Random) -> Vec<Lie> {
    let count = random.below(4) + 1;
    (0..count)
        .map(|_| {
            let number = *random.one_of(&NUMBERS);
            let what = match random.below(8) {
                0..=3 => What::Number(random.below(10_000), number),
                4 | 5 => What::Numbers(*random.one_of(&[1, 2, 4, 7]), number),
                6 => What::Line(random.below(3_000), *random.one_of(&[0, 2, 5_000])),
                _ => {
                    let instead = *random.one_of(&["ERROR", "SUCCESS", ""]);
                    What::Verdict(instead)
                }
            };
            let request = *random.one_of(&REQUESTS);
            let turn = Turn::draw(random, &[0, 0, 1, 2]);
            Lie {
                request,
                turn,
                what,
            }
        })
        .collect()
}

impl What {
    fn apply(&self, answer: &str) -> String {
        match *self {
            Self::Number(which, instead) => {
                let count = pieces(answer).filter(|(is_number, _)| *is_number).count();
                replaced(answer, instead, |place| place == which % count.max(1))
            }
            Self::Numbers(every, instead) => {
                replaced(answer, instead, |place| place.is_multiple_of(every))
            }
            Self::Line(which, times) => {
                let count = answer.lines().count();
                let lines = answer.lines().enumerate();
                let all = lines.flat_map(|(place, line)| {
                    let times = if place == which % count.max(1) {
                        times
                    } else {
                        1
                    };
                    std::iter::repeat_n(format!("{line}\n"), times)
                });
                all.collect()
            }
            Self::Verdict(instead) => {
                let rest = answer.split_once('\n').map_or("", |(_, rest)| rest);
                format!("{instead}\n{rest}")
            }
        }
    }
}

/// A text in pieces that are numbers, and others.
fn pieces(text: &str) -> impl Iterator<Item = (bool, &str)> {
    let is_part = |c: char| c.is_ascii_digit() || "+-.E".contains(c);
    let mut rest = text;
    std::iter::from_fn(move || {
        let first = rest.chars().next()?;
        let end = rest
            .find(|c| is_part(c) != is_part(first))
            .unwrap_or(rest.len());
        let (piece, after) = rest.split_at(end);
        rest = after;
        Some((piece.contains(|c: char| c.is_ascii_digit()), piece))
    })
}

/// With the numbers replaced whose place among the numbers is `chosen`.
fn replaced(text: &str, instead: &str, chosen: impl Fn(usize) -> bool) -> String {
    let mut place = 0;
    let all = pieces(text).map(|(is_number, piece)| {
        let this = is_number && chosen(place);
        place += usize::from(is_number);
        if this { instead } else { piece }
    });
    all.collect()
}

/// Whoever stands between.
pub(super) struct Liar {
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    told: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl Liar {
    /// Takes the place of a phone.
    pub(super) fn before(phone: SocketAddr, lies: Vec<Lie>) -> Result<Self, String> {
        let failed = |error: std::io::Error| error.to_string();
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let (stop, told) = (
            Arc::new(AtomicBool::new(false)),
            Arc::new(AtomicU64::new(0)),
        );
        let between = Between {
            lies,
            seen: [0; REQUESTS.len()],
            told: Arc::clone(&told),
        };
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || between.serve(&listener, phone, &stopped));
        Ok(Self {
            address,
            stop,
            told,
            thread: Some(thread),
        })
    }

    pub(super) const fn address(&self) -> SocketAddr {
        self.address
    }

    /// How many answers were changed so far.
    pub(super) fn told(&self) -> u64 {
        self.told.load(Ordering::Relaxed)
    }
}

impl Drop for Liar {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Between {
    lies: Vec<Lie>,
    /// Answers so far, by the place of their requests.
    seen: [u64; REQUESTS.len()],
    told: Arc<AtomicU64>,
}

impl Between {
    /// One client after the other, as the app.
    fn serve(mut self, listener: &TcpListener, phone: SocketAddr, stop: &AtomicBool) {
        while !stop.load(Ordering::Relaxed) {
            match listener.accept() {
                // Whoever hangs up, and a phone that is not there, end this connection.
                Ok((client, _)) => drop(self.pass(client, phone, stop)),
                Err(_) => std::thread::sleep(PAUSE),
            }
        }
    }

    fn pass(
        &mut self,
        mut client: TcpStream,
        phone: SocketAddr,
        stop: &AtomicBool,
    ) -> std::io::Result<()> {
        let mut server = TcpStream::connect(phone)?;
        client.set_nonblocking(true)?;
        server.set_nonblocking(true)?;
        let (mut requests, mut answer) = (String::new(), Vec::new());
        let mut buffer = vec![0; 64 << 10];
        let mut read = |from: &mut TcpStream| match from.read(&mut buffer) {
            Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
            Ok(count) => Ok(buffer[..count].to_vec()),
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(Vec::new()),
            Err(error) => Err(error),
        };
        while !stop.load(Ordering::Relaxed) {
            let asked = read(&mut client)?;
            requests.push_str(&String::from_utf8_lossy(&asked));
            write(&mut server, &asked, stop)?;
            let came = read(&mut server)?;
            answer.extend_from_slice(&came);
            if answer.ends_with(b"\nend\n") {
                let text = String::from_utf8_lossy(&answer).into_owned();
                let request = requests.lines().rfind(|line| !line.is_empty());
                let changed = self.changed(request.unwrap_or_default(), text);
                write(&mut client, changed.as_bytes(), stop)?;
                answer.clear();
            }
            if asked.is_empty() && came.is_empty() {
                std::thread::sleep(PAUSE);
            }
        }
        Ok(())
    }

    fn changed(&mut self, request: &str, answer: String) -> String {
        let Some(place) = REQUESTS.iter().position(|known| request.starts_with(known)) else {
            return answer;
        };
        let number = self.seen[place];
        self.seen[place] += 1;
        let mut changed = answer.clone();
        for lie in &self.lies {
            if lie.request == REQUESTS[place] && lie.turn.has(number) {
                changed = lie.what.apply(&changed);
            }
        }
        if changed != answer {
            self.told.fetch_add(1, Ordering::Relaxed);
        }
        changed
    }
}

fn write(to: &mut TcpStream, mut bytes: &[u8], stop: &AtomicBool) -> std::io::Result<()> {
    while !bytes.is_empty() && !stop.load(Ordering::Relaxed) {
        match to.write(bytes) {
            Ok(count) => bytes = &bytes[count..],
            Err(error) if error.kind() == ErrorKind::WouldBlock => std::thread::sleep(PAUSE),
            Err(error) => return Err(error),
        }
    }
    Ok(())
}
