//! The app's TCP server: one client at a time, one request after the other.
//!
//! Lines end as in the app's language: by `\n`, `\r` or `\r\n`. An empty line is
//! a request like any other, and is answered with an error. The last line of a client
//! that leaves is one too, even without its end, and so is all that a client has left
//! after which nobody served before. (`RemoteRpcServer.java`:153: `readLine` until
//! there is no more; what cannot be sent is dropped in silence by its `PrintStream`.)
//!
//! In the background the server ends: within a second, or after the next line of the
//! client that it serves. Until then it has the port, and a new one does not get it
//! (lines 134, 137, 153 and 169).
//!
//! # When answers leave
//!
//! The app writes an answer in pieces, the end of its last line apart, on a
//! socket with Nagle's algorithm. So what is left of an answer when its last
//! full segment has gone waits for the acknowledgement, and if the next request
//! is there already (the published client sends an empty line after each
//! `imu?…`), its answer joins it. That client depends on it: it reads in
//! blocks, takes the stray answer with the end of the one it wants, and throws
//! it away. With [`gathers`](super::AppConfig::gathers) the same is made certain:
//! while another request is waiting, the last [`TAIL`] bytes of an answer are held back for [`GATHER`], which
//! gives the client time to take what came before, and leave in one piece with
//! the next answer.

use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::app::{App, Reply};
use crate::oscillator::TrueTime;
use stm32f4_sim::shared::lock;

/// Bytes of an answer that wait for the next one: less than a segment.
const TAIL: usize = 1_024;

/// Least time that they wait.
const GATHER: Duration = Duration::from_millis(50);

/// Time in which the server sees that it shall stop.
const POLL: Duration = Duration::from_millis(20);

/// Time in which a server in the background sees that it is to end, in milliseconds of true
/// time (`RemoteRpcServer.java`:41).
const ACCEPT_MS: f64 = 1_000.0;

/// Longest request that is kept, in bytes; a longer one ends the connection.
const MAX_REQUEST: usize = 64 * 1024;

/// Bytes of a file sent at once, as in the app.
const FILE_BLOCK: usize = 1_024;

/// Fault on the way of the answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkFault {
    /// The connection is closed after so many bytes of an answer.
    CutAfter(u64),
    /// No more than so many bytes a second.
    Slow(u32),
    /// The answer's body never ends.
    Endless,
    /// Nothing is answered at all.
    Silent,
    /// So many bytes are missing at the end of a video, then the connection is closed.
    ShortVideo(u64),
    /// So many bytes too many come after a video.
    LongVideo(u64),
}

/// State that the phone's owner may change while the server runs.
#[derive(Debug)]
pub(super) struct Link {
    address: SocketAddr,
    /// Nothing while the phone is off the network.
    listener: Mutex<Option<TcpListener>>,
    fault: Mutex<Option<LinkFault>>,
    client: Mutex<Option<TcpStream>>,
    /// In the background: when the server looks at it at last.
    ending: Mutex<Option<TrueTime>>,
}

impl Link {
    /// The app is in the background: its server is to end, at the latest then unless it
    /// serves a client.
    pub(super) fn pause(&self, app: &App) {
        *lock(&self.ending) = Some(app.in_ms(ACCEPT_MS));
    }

    /// The app's process has ended, or is opened again.
    pub(super) fn forget_background(&self) {
        *lock(&self.ending) = None;
    }

    pub(super) fn set_fault(&self, fault: Option<LinkFault>) {
        *lock(&self.fault) = fault;
    }

    fn fault(&self) -> Option<LinkFault> {
        *lock(&self.fault)
    }

    /// Listens on `port` of the loopback interface; 0 takes a free one.
    pub(super) fn open(port: u16) -> std::io::Result<Self> {
        let listener = listen(SocketAddr::from((Ipv4Addr::LOCALHOST, port)))?;
        Ok(Self {
            address: listener.local_addr()?,
            listener: Mutex::new(Some(listener)),
            fault: Mutex::default(),
            client: Mutex::default(),
            ending: Mutex::default(),
        })
    }

    /// Address of the phone, when it is on the network.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Leaves the network: connections end, new ones are refused.
    pub(super) fn leave(&self) {
        lock(&self.listener).take();
        self.cut();
    }

    /// Comes back to the network, under the same address.
    pub(super) fn join(&self) -> std::io::Result<()> {
        let mut listener = lock(&self.listener);
        if listener.is_none() {
            *listener = Some(listen(self.address)?);
        }
        Ok(())
    }

    /// Ends the connection with the client, if there is one.
    pub(super) fn cut(&self) {
        if let Some(client) = lock(&self.client).take() {
            let _ = client.shutdown(Shutdown::Both);
        }
    }
}

/// A listener that does not block.
fn listen(address: SocketAddr) -> std::io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Serves clients until the app closes.
pub(super) fn serve(app: &Arc<App>, link: &Link) {
    while !app.closing.load(Ordering::SeqCst) {
        let ending = *lock(&link.ending);
        if ending.is_some_and(|at| app.has_come(at)) {
            lock(&link.listener).take();
        }
        let accepted = lock(&link.listener).as_ref().map(TcpListener::accept);
        match accepted {
            // Accepted by a server that is to end: closed at once.
            Some(Ok(_)) if ending.is_some() => drop(lock(&link.listener).take()),
            Some(Ok((stream, _))) => {
                if stream.set_nonblocking(false).is_ok() {
                    *lock(&link.client) = stream.try_clone().ok();
                    Client::new(stream, app, link).serve();
                    lock(&link.client).take();
                }
            }
            _ => std::thread::sleep(POLL),
        }
    }
}

/// One client's connection.
struct Client<'a> {
    stream: TcpStream,
    app: &'a Arc<App>,
    link: &'a Link,
    input: Vec<u8>,
    /// The last request ended with `\r`: a `\n` that follows belongs to it.
    after_return: bool,
    held: Vec<u8>,
    /// The client will send no more.
    ended: bool,
    /// The client does not listen any more.
    deaf: bool,
}

/// The connection has ended, for whatever reason.
struct Gone;

impl From<std::io::Error> for Gone {
    fn from(_: std::io::Error) -> Self {
        Self
    }
}

impl<'a> Client<'a> {
    fn new(stream: TcpStream, app: &'a Arc<App>, link: &'a Link) -> Self {
        Self {
            stream,
            app,
            link,
            input: Vec::new(),
            after_return: false,
            held: Vec::new(),
            ended: false,
            deaf: false,
        }
    }

    fn serve(mut self) {
        while let Ok(line) = self.next_request() {
            if self.answer(&line).is_err() {
                break;
            }
            if lock(&self.link.ending).is_some() {
                lock(&self.link.listener).take();
                break;
            }
        }
    }

    /// The next line of the client.
    fn next_request(&mut self) -> Result<String, Gone> {
        loop {
            if let Some(line) = self.take_line() {
                return Ok(line);
            }
            self.flush()?;
            let too_long = self.input.len() > MAX_REQUEST;
            if self.ended && !self.input.is_empty() {
                let line = std::mem::take(&mut self.input);
                return Ok(String::from_utf8_lossy(&line).into_owned());
            }
            if self.ended || too_long || self.app.closing.load(Ordering::SeqCst) {
                return Err(Gone);
            }
            self.receive(POLL)?;
        }
    }

    /// Reads what has come, waiting for at most `patience`.
    fn receive(&mut self, patience: Duration) -> Result<(), Gone> {
        self.stream.set_read_timeout(Some(patience))?;
        let mut buffer = [0u8; 4096];
        match self.stream.read(&mut buffer) {
            Ok(0) => {
                self.ended = true;
                Ok(())
            }
            Ok(n) => {
                self.input
                    .extend_from_slice(buffer.get(..n).unwrap_or_default());
                Ok(())
            }
            Err(e) => match e.kind() {
                ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => Ok(()),
                _ => Err(Gone),
            },
        }
    }

    /// A whole line of the input, without its end.
    fn take_line(&mut self) -> Option<String> {
        if self.after_return && self.input.first() == Some(&b'\n') {
            self.input.remove(0);
            self.after_return = false;
        }
        let end = self.input.iter().position(|b| matches!(b, b'\n' | b'\r'))?;
        self.after_return = self.input.get(end) == Some(&b'\r');
        let rest = self.input.split_off(end + 1);
        let mut line = std::mem::replace(&mut self.input, rest);
        line.truncate(end);
        Some(String::from_utf8_lossy(&line).into_owned())
    }

    /// True if another request is waiting, one that is answered at once.
    fn has_quick_request(&self) -> bool {
        let skip = usize::from(self.after_return && self.input.first() == Some(&b'\n'));
        let rest = self.input.get(skip..).unwrap_or_default();
        let Some(end) = rest.iter().position(|b| matches!(b, b'\n' | b'\r')) else {
            return false;
        };
        let line = rest.get(..end).unwrap_or_default();
        !line.starts_with(b"imu?") && line != b"video_start" && line != b"get_video"
    }

    fn answer(&mut self, line: &str) -> Result<(), Gone> {
        let reply = self.app.handle(line).map_err(|_| Gone)?;
        let fault = self.link.fault();
        if fault == Some(LinkFault::Silent) {
            return Ok(());
        }
        if reply == Reply::Crash {
            self.app.reopen();
            self.link.leave();
        }
        let (head, file) = reply.written(&self.app.config.version).ok_or(Gone)?;
        if fault == Some(LinkFault::Endless) {
            let body = head.strip_suffix("end\n").unwrap_or(&head);
            self.send(body.as_bytes())?;
            while !self.deaf {
                self.send("1.0,2.0,3.0,4\n".repeat(64).as_bytes())?;
            }
            return Ok(());
        }
        match file {
            None => self.send_and_hold(head.as_bytes()),
            Some((path, size)) => {
                self.send(head.as_bytes())?;
                self.send_file(&path, size, fault)
            }
        }
    }

    fn send_file(&mut self, path: &Path, size: u64, fault: Option<LinkFault>) -> Result<(), Gone> {
        let mut file = std::fs::File::open(path)?;
        let mut left = match fault {
            Some(LinkFault::ShortVideo(missing)) => size.saturating_sub(missing),
            _ => size,
        };
        let mut block = [0u8; FILE_BLOCK];
        while left > 0 && !self.deaf {
            let want = FILE_BLOCK.min(usize::try_from(left).unwrap_or(FILE_BLOCK));
            let n = file.read(block.get_mut(..want).unwrap_or_default())?;
            if n == 0 {
                break;
            }
            self.send(block.get(..n).unwrap_or_default())?;
            left -= n as u64;
        }
        match fault {
            Some(LinkFault::ShortVideo(_)) => Err(Gone),
            Some(LinkFault::LongVideo(extra)) => {
                for _ in 0..extra {
                    self.send(b"x")?;
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Sends an answer; holds its end back if another request is waiting.
    fn send_and_hold(&mut self, bytes: &[u8]) -> Result<(), Gone> {
        if !self.app.config.app.gathers {
            return self.send(bytes);
        }
        // The next request may be on its way.
        self.receive(Duration::from_millis(1))?;
        if !self.has_quick_request() {
            return self.send(bytes);
        }
        let (head, tail) = bytes.split_at(bytes.len().saturating_sub(TAIL));
        if !head.is_empty() {
            self.send(head)?;
        }
        std::thread::sleep(GATHER);
        self.held.extend_from_slice(tail);
        Ok(())
    }

    /// Sends what was held back.
    fn flush(&mut self) -> Result<(), Gone> {
        if self.held.is_empty() {
            return Ok(());
        }
        self.send(&[])
    }

    /// Sends what was held back and `bytes`, in one piece.
    fn send(&mut self, bytes: &[u8]) -> Result<(), Gone> {
        let mut all = std::mem::take(&mut self.held);
        all.extend_from_slice(bytes);
        match self.link.fault() {
            Some(LinkFault::CutAfter(most)) if (all.len() as u64) > most => {
                let part = all.get(..most as usize).unwrap_or(&all);
                self.stream.write_all(part)?;
                Err(Gone)
            }
            Some(LinkFault::CutAfter(most)) => {
                let left = most - all.len() as u64;
                self.link.set_fault(Some(LinkFault::CutAfter(left)));
                self.put(&all);
                Ok(())
            }
            Some(LinkFault::Slow(rate)) => {
                // Ten pieces a second.
                let piece = (rate as usize / 10).max(1);
                for piece in all.chunks(piece) {
                    self.put(piece);
                    if self.deaf {
                        break;
                    }
                    std::thread::sleep(Duration::from_millis(100));
                    if self.app.closing.load(Ordering::SeqCst) {
                        return Err(Gone);
                    }
                }
                Ok(())
            }
            _ => {
                self.put(&all);
                Ok(())
            }
        }
    }

    /// Writes; to a client that has gone, nothing.
    fn put(&mut self, bytes: &[u8]) {
        if !self.deaf && self.stream.write_all(bytes).is_err() {
            self.deaf = true;
        }
    }
}
