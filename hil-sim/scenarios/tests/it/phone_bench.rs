//! A simulated phone on a walk, without a board, and the program's command `phone` against it.

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

use rig::clocks::oscillator::TrueTime;
use rig::clocks::true_clock::TrueClock;
use rig::phone::{PhoneConfig, SimPhone, Surroundings};
use rig::random::Seed;

use test_support::processes::Ran;

use crate::support::tool;

/// A phone whose rig walks, in true time `speed` times as fast as real time.
pub(crate) struct PhoneBench {
    pub(crate) phone: SimPhone,
    pub(crate) clock: TrueClock,
}

impl PhoneBench {
    pub(crate) fn new(seed: u64, speed: f64, edit: impl FnOnce(&mut PhoneConfig)) -> Self {
        let mut config = PhoneConfig::draw(Seed(seed));
        edit(&mut config);
        let clock = TrueClock::new();
        let_pass(&clock, speed);
        let surroundings = Surroundings::walking(Seed(seed), clock.clone());
        Self {
            phone: SimPhone::start(config, surroundings, 0).unwrap(),
            clock,
        }
    }

    pub(crate) fn address(&self) -> String {
        self.phone.address().to_string()
    }

    /// Another client, which was answered and stays connected.
    pub(crate) fn occupy(&self) -> BufReader<TcpStream> {
        let mut other = BufReader::new(TcpStream::connect(self.phone.address()).unwrap());
        other.get_mut().write_all(b"x\n").unwrap();
        let mut line = String::new();
        other.read_line(&mut line).unwrap();
        assert_eq!(line, "ERROR\n");
        other
    }

    /// Runs `smartdepthsync phone …` against this phone.
    pub(crate) fn command(&self, arguments: &[&str], folder: &Path) -> Ran {
        let mut command = tool();
        command.arg("phone").args(arguments);
        let command = command.args(["--phone", &self.address()]);
        Ran::new(command.current_dir(folder))
    }
}

impl Drop for PhoneBench {
    fn drop(&mut self) {
        self.clock.stop();
    }
}

/// Lets true time pass at `speed` times real time until the clock is stopped. While the
/// machine pauses for more than 20 ms, so does true time.
fn let_pass(clock: &TrueClock, speed: f64) {
    const LONGEST_STEP: Duration = Duration::from_millis(20);
    let clock = clock.clone();
    std::thread::spawn(move || {
        let (mut nanos, mut last) = (0.0, Instant::now());
        while !clock.is_stopped() {
            let now = Instant::now();
            nanos += (now - last).min(LONGEST_STEP).as_nanos() as f64 * speed;
            last = now;
            clock.publish(TrueTime::from_nanos(nanos as u64));
            std::thread::sleep(Duration::from_micros(500));
        }
    });
}
