//! One TCP connection with a deadline on every read and write.

use std::io::{BufRead as _, BufReader, ErrorKind, Write as _};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use super::answer::{self, Lines, MalformedAnswer, ServerVersion};
use super::error::PhoneError;
use super::settings::Settings;
use system::Cancel;

/// Bytes read at once.
const BUFFER: usize = 64 * 1024;

/// Longest single wait between two checks for cancellation.
const SLICE: Duration = Duration::from_millis(100);

/// Fewest bytes that must arrive within a window of time for a transfer to go on.
pub(super) const CRAWL_FLOOR: u64 = 32 * 1024;

/// A connection to the app, with the bytes that were read but not consumed yet.
#[derive(Debug)]
pub(super) struct Connection {
    reader: BufReader<TcpStream>,
    /// [`Settings::margin`].
    pub(super) margin: Duration,
    cancel: Cancel,
}

impl Connection {
    /// Connects to `address`, trying each of its IP addresses in turn, all within
    /// [`Settings::connect`].
    pub(super) fn open(address: &str, settings: &Settings) -> Result<Self, PhoneError> {
        let deadline = Instant::now() + settings.connect;
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
                        reader: BufReader::with_capacity(BUFFER, stream),
                        margin: settings.margin,
                        cancel: settings.cancel.clone(),
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

    /// Sends the line of a request, after checking that no earlier bytes are pending that could
    /// be mistaken for its answer.
    pub(super) fn send(&mut self, request: &'static str, line: &str) -> Result<(), PhoneError> {
        let broken = |source| PhoneError::Connection { request, source };
        self.stream().set_nonblocking(true).map_err(broken)?;
        let pending = self.reader.fill_buf().map(<[u8]>::len);
        self.stream().set_nonblocking(false).map_err(broken)?;
        match pending {
            Ok(0) => {
                return Err(PhoneError::Closed {
                    request,
                    received: 0,
                });
            }
            Ok(count) => return Err(PhoneError::Unrequested { count }),
            Err(e) if e.kind() != ErrorKind::WouldBlock => return Err(broken(e)),
            Err(_) => {}
        }
        let waited = self.margin;
        self.stream()
            .set_write_timeout(Some(waited.max(Duration::from_millis(1))))
            .map_err(broken)?;
        self.stream()
            .write_all(line.as_bytes())
            .map_err(|source| match source.kind() {
                ErrorKind::WouldBlock | ErrorKind::TimedOut => {
                    PhoneError::Timeout { request, waited }
                }
                _ => PhoneError::Connection { request, source },
            })
    }

    /// Reads one whole answer. `body` receives each body line with its number. The deadline is
    /// `first`, extended by [`Settings::margin`] whenever [`CRAWL_FLOOR`] more bytes have arrived.
    pub(super) fn answer(
        &mut self,
        request: &'static str,
        limit: u64,
        first: Duration,
        body: impl FnMut(u64, &str) -> Result<(), MalformedAnswer>,
    ) -> Result<ServerVersion, PhoneError> {
        let wrong = |source| match source {
            MalformedAnswer::UnknownVersion { found } => PhoneError::UnsupportedVersion { found },
            source => PhoneError::Malformed { request, source },
        };
        let begun = Instant::now();
        let mut deadline = begun + first;
        let mut renewed_at = 0;
        let mut lines = Lines::new(limit);
        let next = || {
            loop {
                let mut input = self.reader.buffer();
                let unread = input.len();
                let line = lines.next(&mut input).map_err(wrong)?;
                let used = unread - input.len();
                self.reader.consume(used);
                if let Some(line) = line {
                    return Ok(line);
                }
                if lines.bytes() >= renewed_at + CRAWL_FLOOR {
                    renewed_at = lines.bytes();
                    deadline = deadline.max(Instant::now() + self.margin);
                }
                let received = lines.bytes();
                if self.fill(request, deadline, deadline - begun)? == 0 {
                    return Err(PhoneError::Closed { request, received });
                }
            }
        };
        let answer = answer::read(next, body, wrong)?;
        let version = answer.version;
        match answer.refused {
            None => Ok(version),
            Some(text) => Err(PhoneError::Refused {
                request,
                text,
                version,
            }),
        }
    }

    /// Returns the bytes that were read but not consumed yet: at least one unless the phone has
    /// closed the connection.
    pub(super) fn bytes(&mut self, request: &'static str) -> Result<&[u8], PhoneError> {
        if self.reader.buffer().is_empty() {
            self.fill(request, Instant::now() + self.margin, self.margin)?;
        }
        Ok(self.reader.buffer())
    }

    /// Marks `count` of [`Self::bytes`] as consumed.
    pub(super) fn consume(&mut self, count: usize) {
        self.reader.consume(count);
    }

    /// Returns true if a byte arrives within `patience`.
    pub(super) fn more_comes(&mut self, patience: Duration) -> bool {
        self.stream().set_read_timeout(Some(patience)).is_ok()
            && matches!(self.reader.fill_buf(), Ok(bytes) if !bytes.is_empty())
    }

    /// Reads into the empty buffer and returns the number of bytes, 0 at the end of the stream.
    fn fill(
        &mut self,
        request: &'static str,
        deadline: Instant,
        patience: Duration,
    ) -> Result<usize, PhoneError> {
        loop {
            if self.cancel.is_requested() {
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
            self.stream()
                .set_read_timeout(Some(wait))
                .map_err(|source| PhoneError::Connection { request, source })?;
            match self.reader.fill_buf() {
                Ok(bytes) => return Ok(bytes.len()),
                Err(e) => match e.kind() {
                    ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => {}
                    ErrorKind::ConnectionReset | ErrorKind::ConnectionAborted => return Ok(0),
                    _ => return Err(PhoneError::Connection { request, source: e }),
                },
            }
        }
    }

    fn stream(&self) -> &TcpStream {
        self.reader.get_ref()
    }
}
