//! Serves the readings of the phone's clocks on a port, as our program on a phone does, with the
//! delays of a link.
//!
//! It stands for the program, for `adb`'s forwarding and for the cable: the delays there and
//! back are drawn from the ranges of links, in true time.

use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use phone_agent::{Answer, QUESTION, read_question};

use super::app::App;
use crate::clocks::link_delay::{Link, LinkRanges};
use crate::clocks::oscillator::TrueTime;
use crate::random::Stream;
use stm32f4_sim::shared::lock;

/// A server of the clocks' readings, until it is dropped.
#[derive(Debug)]
pub struct ClockServer {
    port: u16,
    stop: Arc<AtomicBool>,
    open: Arc<Mutex<Option<TcpStream>>>,
    thread: Option<JoinHandle<()>>,
}

impl ClockServer {
    pub(super) fn start(app: Arc<App>, ranges: &LinkRanges) -> std::io::Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
        let port = listener.local_addr()?.port();
        let stop = Arc::new(AtomicBool::new(false));
        let open = Arc::new(Mutex::new(None));
        let link = Link::drawn(ranges, app.config.seed.stream(Stream::PhoneLink));
        let thread = {
            let (stop, open) = (Arc::clone(&stop), Arc::clone(&open));
            std::thread::spawn(move || serve(&listener, &app, link, &stop, &open))
        };
        Ok(Self {
            port,
            stop,
            open,
            thread: Some(thread),
        })
    }

    /// Its port of 127.0.0.1.
    #[must_use]
    pub const fn port(&self) -> u16 {
        self.port
    }
}

impl Drop for ClockServer {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        if let Some(stream) = &*lock(&self.open) {
            let _ = stream.shutdown(Shutdown::Both);
        }
        // A thread that waits for a connection gets one.
        let _ = TcpStream::connect((Ipv4Addr::LOCALHOST, self.port));
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn serve(
    listener: &TcpListener,
    app: &App,
    mut link: Link,
    stop: &AtomicBool,
    open: &Mutex<Option<TcpStream>>,
) {
    for stream in listener.incoming() {
        if let Ok(stream) = &stream {
            *lock(open) = stream.try_clone().ok();
        }
        // The order matters: the thread that stops it closes what is open by then.
        if stop.load(Ordering::SeqCst) {
            return;
        }
        let Ok(stream) = stream else { continue };
        // A host that has disconnected does not end the server.
        let _ = answer(stream, app, &mut link);
    }
}

impl App {
    /// Returns the answer of the clock program on the phone to a question at a time.
    #[must_use]
    pub fn clock_answer(&self, nonce: u64, at: TrueTime) -> Answer {
        let boot_ns = self.oscillator.nanos_at(at);
        Answer {
            nonce,
            boot_ns,
            monotonic_ns: boot_ns - self.config.slept_ns,
        }
    }
}

/// Answers until the host is gone, or the rig has stopped.
fn answer(mut stream: TcpStream, app: &App, link: &mut Link) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let clock = &app.clock;
    loop {
        let mut question = [0; QUESTION];
        stream.read_exact(&mut question)?;
        let Some(nonce) = read_question(&question) else {
            return Ok(());
        };
        let Some([read, back]) = link.exchange(clock.now()) else {
            continue;
        };
        if clock.wait_until(back).is_err() {
            return Ok(());
        }
        stream.write_all(&app.clock_answer(nonce, read).bytes())?;
    }
}
