//! Reads the phone's clocks while it records, by a small program of ours on the phone.
//!
//! [`Agent::start`] finds the phone by `adb`, copies the program to it (`/data/local/tmp`), starts
//! it, and queries it repeatedly from a thread, through a port that `adb` forwards to it.
//! [`phone_agent`] documents the messages and how the program ends by itself.
//!
//! When the phone's cable is pulled, the program ends for lack of queries, and `adb` drops the
//! port. So once queries fail, the program is copied and started again until it answers.
//!
//! Nothing is left running on the phone, however this program ends: the program there removes its
//! own file when it starts, and exits after [`PATIENCE_S`](phone_agent::PATIENCE_S) seconds without
//! a query. Dropping the [`Agent`] releases the forwarded port on this computer; after a SIGKILL
//! the `adb` server keeps the port until the server ends.

mod exchange;
mod program;

use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use system::Cancel;

pub use self::exchange::PhoneExchange;
use self::exchange::{exchange, first_answer};
use self::program::Program;
use crate::adb::{Adb, AdbError};

/// Mean interval between queries.
const EVERY: Duration = Duration::from_millis(20);

/// Pause between two attempts to start the program again.
const PAUSE: Duration = Duration::from_millis(500);

/// A program on the phone that reads its clocks. It is started again if it ends early, and exits by
/// itself within [`PATIENCE_S`](phone_agent::PATIENCE_S) seconds after this is dropped.
pub struct Agent {
    device: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    exchanges: Receiver<PhoneExchange>,
}

impl Agent {
    /// Starts the program on the only phone that `adb` finds, and queries it from now on. `now` is
    /// the clock of the times in [`PhoneExchange`].
    ///
    /// # Errors
    ///
    /// There is no `adb` or not exactly one phone, there is no program for its processor, or the
    /// program does not answer.
    pub fn start(now: fn() -> Duration, cancel: &Cancel) -> Result<Self, AdbError> {
        let adb = Adb::find(cancel)?;
        let device = adb.only_device()?;
        let (program, stream) = Program::start(&adb, &device, now)?;
        let ends = Arc::new(AtomicBool::new(false));
        let ended = {
            let (ends, cancel) = (Arc::clone(&ends), cancel.clone());
            Cancel::when(move || ends.load(Ordering::Relaxed) || cancel.is_requested())
        };
        let (sender, exchanges) = channel();
        let querying = std::thread::Builder::new().name(String::from("phone's clock"));
        let thread = querying.spawn(move || query(program, stream, now, &ended, &sender));
        Ok(Self {
            device,
            stop: ends,
            thread: Some(thread.map_err(|source| adb.cannot_run(source))?),
            exchanges,
        })
    }

    /// Returns true if the phone is reached through a network: `adb` names such a phone by its
    /// address.
    #[must_use]
    pub fn is_by_network(&self) -> bool {
        self.device.contains(':')
    }

    /// Returns the phone's name in `adb`, which is a serial number or an address.
    #[must_use]
    pub fn device(&self) -> &str {
        &self.device
    }

    /// Returns the exchanges since the last call.
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

/// Queries the program until it is cancelled. A program that no longer answers has ended, or the
/// cable was pulled: it is started again until it answers.
fn query(
    first: Program,
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
        // Avoids beats with periodic events on the way, such as the frames of USB.
        let scatter = nonce.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 54;
        std::thread::sleep(EVERY / 2 + EVERY.mul_f64(scatter as f64 / 1024.0));
        let Some((program, stream)) = &mut open else {
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
            // The connection was cut or late, or the program has ended.
            Err(_) => match first_answer(program.port, now, cancel) {
                Ok(fresh) => *stream = fresh,
                Err(_) => open = None,
            },
        }
    }
}

/// Starts the program again, if the phone is connected.
fn restart(device: &str, now: fn() -> Duration, cancel: &Cancel) -> Option<(Program, TcpStream)> {
    let adb = Adb::find(cancel).ok()?;
    Program::start(&adb, device, now).ok()
}
