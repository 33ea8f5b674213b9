//! Queries of the program on the phone and their answers.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use phone_agent::{ANSWER, Answer, question};
use system::Cancel;

use crate::adb::AdbError;

/// Longest wait for an answer. A later one is of no use, and its connection is closed.
const LATE: Duration = Duration::from_secs(2);

/// Longest single wait between two checks for cancellation.
const SLICE: Duration = Duration::from_millis(100);

/// Longest start of the program.
const START: Duration = Duration::from_secs(5);

/// A query of the phone's clocks and its answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhoneExchange {
    /// Time of the query, on the clock that [`Agent::start`](super::Agent::start) was given.
    pub sent: Duration,
    /// Time of the answer's arrival, on the same clock.
    pub received: Duration,
    /// Readings of the phone's clocks in between.
    pub answer: Answer,
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
pub(super) fn first_answer(
    port: u16,
    now: fn() -> Duration,
    cancel: &Cancel,
) -> Result<TcpStream, AdbError> {
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
pub(super) fn exchange(
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
