//! One TCP connection with a deadline on every read and write.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use super::answer::{AnswerDecoder, AnswerEvent, MalformedAnswer, ServerVersion};
use super::client::StopSignal;
use super::error::PhoneError;

/// Bytes read at once.
const BUFFER: usize = 64 * 1024;

/// Longest single wait: how soon a request to stop is seen.
const SLICE: Duration = Duration::from_millis(100);

/// Least number of bytes that must come within a window: slower is a crawl.
pub(super) const CRAWL_FLOOR: u64 = 32 * 1024;

/// How long an answer is waited for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patience {
    /// For all of it, if little comes.
    pub(super) first: Duration,
    /// For each [`CRAWL_FLOOR`] bytes of it.
    pub(super) margin: Duration,
}

/// A connection to the app with what has been read from it but not yet used.
#[derive(Debug)]
pub(super) struct Connection {
    stream: TcpStream,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    stop: StopSignal,
}

impl Connection {
    /// Connects to `address`, trying each of its addresses in turn within `timeout` in all.
    pub(super) fn open(
        address: &str,
        timeout: Duration,
        stop: StopSignal,
    ) -> Result<Self, PhoneError> {
        let deadline = Instant::now() + timeout;
        let targets: Vec<SocketAddr> = address
            .to_socket_addrs()
            .map_err(|source| PhoneError::Connect {
                address: address.to_owned(),
                source,
            })?
            .collect();
        let mut last = std::io::Error::from(ErrorKind::AddrNotAvailable);
        for target in targets {
            let left = deadline.saturating_duration_since(Instant::now());
            match TcpStream::connect_timeout(&target, left.max(Duration::from_millis(1))) {
                Ok(stream) => {
                    // Requests are single short writes that must not wait.
                    let _ = stream.set_nodelay(true);
                    return Ok(Self {
                        stream,
                        buffer: vec![0; BUFFER],
                        start: 0,
                        end: 0,
                        stop,
                    });
                }
                Err(e) => last = e,
            }
        }
        Err(PhoneError::Connect {
            address: address.to_owned(),
            source: last,
        })
    }

    /// Sends the line of a request, after making sure that nothing is left over
    /// that could be taken for its answer.
    pub(super) fn send(
        &mut self,
        request: &'static str,
        line: &str,
        timeout: Duration,
    ) -> Result<(), PhoneError> {
        let broken = |source| PhoneError::Connection { request, source };
        self.stream.set_nonblocking(true).map_err(broken)?;
        let pending = self.read_once();
        self.stream.set_nonblocking(false).map_err(broken)?;
        match pending {
            Ok(0) => {
                return Err(PhoneError::Closed {
                    request,
                    received: 0,
                });
            }
            Err(e) if e.kind() != ErrorKind::WouldBlock => return Err(broken(e)),
            _ => {}
        }
        if self.end > self.start {
            let count = self.end - self.start;
            return Err(PhoneError::Unrequested { count });
        }
        self.stream
            .set_write_timeout(Some(timeout.max(Duration::from_millis(1))))
            .map_err(broken)?;
        self.stream
            .write_all(line.as_bytes())
            .map_err(|source| match source.kind() {
                ErrorKind::WouldBlock | ErrorKind::TimedOut => PhoneError::SendTimeout {
                    request,
                    waited: timeout,
                },
                _ => PhoneError::Connection { request, source },
            })
    }

    /// Reads one whole answer; `body` gets each body line with its number. It is waited
    /// for `first`, and for another `margin` whenever [`CRAWL_FLOOR`] more bytes came.
    pub(super) fn answer(
        &mut self,
        request: &'static str,
        limit: u64,
        Patience { first, margin }: Patience,
        mut body: impl FnMut(u64, &str) -> Result<(), MalformedAnswer>,
    ) -> Result<ServerVersion, PhoneError> {
        let malformed = |source| match source {
            MalformedAnswer::UnknownVersion { found } => PhoneError::UnsupportedVersion { found },
            source => PhoneError::Malformed { request, source },
        };
        let begun = Instant::now();
        let mut deadline = begun + first;
        let mut renewed_at = 0;
        let mut decoder = AnswerDecoder::new(limit);
        let mut version = None;
        loop {
            let mut input = self.buffer.get(self.start..self.end).unwrap_or_default();
            let mut finished = None;
            loop {
                let number = decoder.line_number().saturating_add(1);
                match decoder.next(&mut input).map_err(malformed)? {
                    None => break,
                    Some(AnswerEvent::Success(v)) => version = Some(v),
                    Some(AnswerEvent::Line(line)) => body(number, line).map_err(malformed)?,
                    Some(AnswerEvent::End) => {
                        finished = Some(version.ok_or(PhoneError::Malformed {
                            request,
                            source: MalformedAnswer::Missing {
                                expected: "a version",
                            },
                        }));
                        break;
                    }
                    Some(AnswerEvent::Refused { version, text }) => {
                        finished = Some(Err(PhoneError::Refused {
                            request,
                            text,
                            version,
                        }));
                        break;
                    }
                }
            }
            self.start = self.end - input.len();
            if let Some(result) = finished {
                return result;
            }
            if decoder.bytes() >= renewed_at + CRAWL_FLOOR {
                renewed_at = decoder.bytes();
                deadline = deadline.max(Instant::now() + margin);
            }
            if self.fill(request, deadline, deadline - begun)? == 0 {
                return Err(PhoneError::Closed {
                    request,
                    received: decoder.bytes(),
                });
            }
        }
    }

    /// Bytes that were read but not used yet; at least one unless the phone has
    /// closed the connection.
    pub(super) fn bytes(
        &mut self,
        request: &'static str,
        patience: Duration,
    ) -> Result<&[u8], PhoneError> {
        if self.start == self.end {
            self.fill(request, Instant::now() + patience, patience)?;
        }
        Ok(self.buffer.get(self.start..self.end).unwrap_or_default())
    }

    /// Marks `count` of [`Self::bytes`] as used.
    pub(super) fn consume(&mut self, count: usize) {
        self.start = (self.start + count).min(self.end);
    }

    /// Whether any byte comes within `patience`.
    pub(super) fn more_comes(&mut self, patience: Duration) -> bool {
        if self.end > self.start {
            return true;
        }
        let timeout = patience.max(Duration::from_millis(1));
        self.stream.set_read_timeout(Some(timeout)).is_ok()
            && matches!(self.read_once(), Ok(n) if n > 0)
    }

    /// Reads some bytes into the empty buffer; 0 at the end of the stream.
    fn fill(
        &mut self,
        request: &'static str,
        deadline: Instant,
        patience: Duration,
    ) -> Result<usize, PhoneError> {
        loop {
            if self.stop.is_set() {
                return Err(PhoneError::Cancelled { request });
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(PhoneError::Timeout {
                    request,
                    waited: patience,
                });
            }
            let wait = left.min(SLICE).max(Duration::from_millis(1));
            self.stream
                .set_read_timeout(Some(wait))
                .map_err(|source| PhoneError::Connection { request, source })?;
            match self.read_once() {
                Ok(n) => return Ok(n),
                Err(e) => match e.kind() {
                    ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => {}
                    ErrorKind::ConnectionReset | ErrorKind::ConnectionAborted => return Ok(0),
                    _ => return Err(PhoneError::Connection { request, source: e }),
                },
            }
        }
    }

    /// One read behind what is in the buffer; an empty buffer starts over.
    fn read_once(&mut self) -> std::io::Result<usize> {
        if self.start == self.end {
            self.start = 0;
            self.end = 0;
        }
        let room = self.buffer.get_mut(self.end..).unwrap_or_default();
        if room.is_empty() {
            return Err(ErrorKind::WouldBlock.into());
        }
        let n = self.stream.read(room)?;
        self.end += n;
        Ok(n)
    }
}
