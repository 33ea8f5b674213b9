//! The board's link and the computer's clocks on a rig that is stepped.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, SystemTime};

use ::session::devices::{Clock, Connector};
use board::BoardError;
use board::transport::serial::OpenError;
use board::transport::{Link, LinkError};
use jiff::tz::TimeZone;
use jiff::{Timestamp, Zoned};
use protocol::{Decoder, HostToDevice};
use recording::writer::WallClock;
use stm32f4_sim::time::SimDuration;

use super::{POWER_ON_S, SharedRig};

impl Connector for SharedRig {
    fn connect(&mut self, _: Option<&str>) -> board::Result<Box<dyn Link>> {
        let path = String::from("the simulated board");
        match self.with(|rig| rig.connect()) {
            Some(connection) => Ok(Box::new(VirtualLink {
                rig: self.clone(),
                connection,
                sent: Decoder::new(),
            })),
            None => Err(BoardError::Open(OpenError::NotFound { path })),
        }
    }
}

/// One connection to the board, closed when dropped.
struct VirtualLink {
    rig: SharedRig,
    connection: u64,
    sent: Decoder<HostToDevice>,
}

impl VirtualLink {
    fn still_there(&self) -> Result<(), LinkError> {
        let unplugged = || LinkError::Gone {
            reason: String::from("unplugged"),
        };
        let is_there = self.rig.with(|rig| rig.has(self.connection));
        is_there.then_some(()).ok_or_else(unplugged)
    }
}

impl Link for VirtualLink {
    fn now(&self) -> Duration {
        self.rig.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.rig.with(|rig| rig.send(self.connection, bytes));
        let mut rest = bytes;
        while let Some(command) = self.sent.next(&mut rest) {
            self.rig.commands.borrow_mut().extend(command);
        }
        self.still_there()
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        let bytes = self.rig.with(|rig| rig.receive(self.connection, wait));
        into.extend_from_slice(&bytes);
        if bytes.is_empty() {
            self.still_there()
        } else {
            Ok(())
        }
    }

    fn pause(&mut self, time: Duration) {
        self.rig.with(|rig| rig.pass_unread(duration(time)));
    }
}

impl Drop for VirtualLink {
    fn drop(&mut self) {
        self.rig.with(|rig| rig.close(self.connection));
    }
}

fn duration(time: Duration) -> SimDuration {
    SimDuration::from_secs_f64(time.as_secs_f64())
}

impl Clock for SharedRig {
    fn now(&self) -> Duration {
        Self::now(self)
    }

    fn wall_clock(&self) -> Zoned {
        let now = Timestamp::try_from(self.time_of_day()());
        Zoned::new(now.unwrap_or_default(), TimeZone::UTC)
    }

    fn time_of_day(&self) -> WallClock {
        let (now_ns, step_s) = (
            Arc::clone(&self.now_ns),
            Arc::clone(&self.hands.clock_step_s),
        );
        Box::new(move || {
            let seconds = POWER_ON_S + step_s.load(Ordering::Relaxed);
            let seconds = Duration::from_secs(seconds.unsigned_abs());
            let since = Duration::from_nanos(now_ns.load(Ordering::Relaxed).unsigned_abs());
            SystemTime::UNIX_EPOCH + seconds + since
        })
    }

    fn wait(&self, time: Duration) {
        self.with(|rig| rig.pass(duration(time)));
    }
}
