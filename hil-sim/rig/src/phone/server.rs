//! The app's TCP server: one client at a time, one request after the other.
//!
//! Lines end as in the app's language: by `\n`, `\r` or `\r\n`. An empty line is
//! a request like any other, and is answered with an error. The last line of a client
//! that leaves is one too, even without its end, and so is all that a client has left
//! after which nobody served before. (`RemoteRpcServer.java`:153: `readLine` until
//! there is no more; what cannot be sent is dropped in silence by its `PrintStream`.)

use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::app::{App, Reply};
use stm32f4_sim::shared::lock;

/// Time in which the server sees that it shall stop.
const POLL: Duration = Duration::from_millis(20);

/// Longest request that is kept, in bytes; a longer one ends the connection.
const MAX_REQUEST: usize = 64 * 1024;

/// Bytes of a file sent at once, as in the app.
const FILE_BLOCK: usize = 1_024;

/// Fault on the way of the answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkFault {
    /// The connection is closed after this number of bytes of an answer.
    CutAfter(u64),
    /// Most bytes a second.
    Slow(u32),
    /// Answers wait until the fault is over.
    Held,
}

/// State that the phone's owner may change while the server runs.
#[derive(Debug)]
pub(super) struct Link {
    address: SocketAddr,
    /// Nothing while the phone is off the network.
    listener: Mutex<Option<TcpListener>>,
    fault: Mutex<Option<LinkFault>>,
    client: Mutex<Option<TcpStream>>,
}

impl Link {
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

/// Returns a non-blocking listener.
fn listen(address: SocketAddr) -> std::io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Serves clients until the app closes.
pub(super) fn serve(app: &Arc<App>, link: &Link) {
    while !app.closing.load(Ordering::SeqCst) {
        let accepted = lock(&link.listener).as_ref().map(TcpListener::accept);
        match accepted {
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
    /// The client will send no more.
    ended: bool,
    /// The client no longer listens.
    deaf: bool,
}

/// The connection has ended.
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
            ended: false,
            deaf: false,
        }
    }

    fn serve(mut self) {
        while let Ok(line) = self.next_request() {
            if self.answer(&line).is_err() {
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
            let too_long = self.input.len() > MAX_REQUEST;
            if self.ended && !self.input.is_empty() {
                let line = std::mem::take(&mut self.input);
                return Ok(String::from_utf8_lossy(&line).into_owned());
            }
            if self.ended || too_long || self.app.closing.load(Ordering::SeqCst) {
                return Err(Gone);
            }
            self.receive()?;
        }
    }

    /// Reads what has come, waiting for a moment.
    fn receive(&mut self) -> Result<(), Gone> {
        self.stream.set_read_timeout(Some(POLL))?;
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

    fn answer(&mut self, line: &str) -> Result<(), Gone> {
        let reply = self.app.handle(line).map_err(|_| Gone)?;
        if reply == Reply::Crash {
            self.app.reopen();
            self.link.leave();
        }
        let (head, file) = reply.written(&self.app.config.version).ok_or(Gone)?;
        match file {
            None => self.send(head.as_bytes()),
            Some((path, size)) => {
                self.send(head.as_bytes())?;
                self.send_file(&path, size)
            }
        }
    }

    fn send_file(&mut self, path: &Path, size: u64) -> Result<(), Gone> {
        let mut file = std::fs::File::open(path)?;
        let mut left = size;
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
        Ok(())
    }

    /// Sends bytes, subject to the fault.
    fn send(&mut self, bytes: &[u8]) -> Result<(), Gone> {
        while self.link.fault() == Some(LinkFault::Held) && !self.app.closing.load(Ordering::SeqCst)
        {
            std::thread::sleep(POLL);
        }
        match self.link.fault() {
            Some(LinkFault::CutAfter(most)) if (bytes.len() as u64) > most => {
                let part = bytes.get(..most as usize).unwrap_or(bytes);
                self.stream.write_all(part)?;
                Err(Gone)
            }
            Some(LinkFault::CutAfter(most)) => {
                let left = most - bytes.len() as u64;
                self.link.set_fault(Some(LinkFault::CutAfter(left)));
                self.put(bytes);
                Ok(())
            }
            Some(LinkFault::Slow(rate)) => {
                // Ten pieces a second.
                let piece = (rate as usize / 10).max(1);
                for piece in bytes.chunks(piece) {
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
                self.put(bytes);
                Ok(())
            }
        }
    }

    /// Writes to the client; does nothing if it has gone.
    fn put(&mut self, bytes: &[u8]) {
        if !self.deaf && self.stream.write_all(bytes).is_err() {
            self.deaf = true;
        }
    }
}
