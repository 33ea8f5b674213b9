//! A simulated phone on a walk, and a raw connection to its app.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::Duration;

use rig::flash_log::{Dark, FlashSource};
use rig::motion::MotionSpec;
use rig::oscillator::TrueTime;
use rig::phone::{PhoneConfig, SimPhone, Surroundings};
use rig::random::{Seed, Stream};
use rig::true_clock::TrueClock;

/// A phone whose rig walks, in true time `speed` times as fast as real time.
pub(crate) struct Bench {
    pub(crate) phone: SimPhone,
    pub(crate) clock: TrueClock,
}

impl Bench {
    pub(crate) fn new(seed: u64, speed: f64, edit: impl FnOnce(&mut PhoneConfig)) -> Self {
        Self::with(seed, TrueClock::run_at(speed), Arc::new(Dark), edit)
    }

    /// In true time that passes only as [`Bench::pass`] lets it, however slow the machine is.
    pub(crate) fn held(seed: u64, edit: impl FnOnce(&mut PhoneConfig)) -> Self {
        Self::with(seed, TrueClock::new(), Arc::new(Dark), edit)
    }

    pub(crate) fn with(
        seed: u64,
        clock: TrueClock,
        light: Arc<dyn FlashSource>,
        edit: impl FnOnce(&mut PhoneConfig),
    ) -> Self {
        let mut config = PhoneConfig::draw(Seed(seed));
        edit(&mut config);
        let spec: MotionSpec = "walk".parse().unwrap();
        let motion = spec.build(Seed(seed).stream(Stream::Motion)).unwrap();
        let surroundings = Surroundings {
            clock: clock.clone(),
            motion,
            light,
        };
        Self {
            phone: SimPhone::start(config, surroundings, 0).unwrap(),
            clock,
        }
    }

    /// So many seconds of true time pass, at once.
    pub(crate) fn pass(&self, seconds: f64) {
        let until = self.clock.now().as_secs_f64() + seconds;
        self.clock
            .publish(TrueTime::from_nanos((until * 1e9) as u64));
    }

    /// Waits until the phone waits for a time: it has taken a request.
    pub(crate) fn wait_for_waiter(&self) {
        while self.clock.waiters() == 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Asks, and lets true time pass until there is an answer.
    pub(crate) fn ask(&self, phone: &mut Raw, request: &str) -> Vec<String> {
        phone.send(&format!("{request}\n"));
        self.answer(phone)
    }

    /// Lets true time pass until there is an answer.
    pub(crate) fn answer(&self, phone: &mut Raw) -> Vec<String> {
        while phone.is_silent(Duration::from_millis(1)) {
            self.pass(0.05);
        }
        phone.answer()
    }

    pub(crate) fn connect(&self) -> Raw {
        Raw::new(TcpStream::connect(self.phone.address()).unwrap())
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.clock.stop();
    }
}

/// A connection that is read and written as it is.
pub(crate) struct Raw {
    reader: BufReader<TcpStream>,
}

impl Raw {
    fn new(stream: TcpStream) -> Self {
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        Self {
            reader: BufReader::new(stream),
        }
    }

    pub(crate) fn send(&mut self, text: &str) {
        self.reader.get_mut().write_all(text.as_bytes()).unwrap();
    }

    pub(crate) fn line(&mut self) -> String {
        let mut line = String::new();
        self.reader.read_line(&mut line).unwrap();
        assert!(line.ends_with('\n'), "the phone left: {line:?}");
        line.pop();
        line
    }

    /// The lines of one answer, without `end`.
    pub(crate) fn answer(&mut self) -> Vec<String> {
        let mut lines = Vec::new();
        loop {
            let line = self.line();
            if line == "end" {
                return lines;
            }
            lines.push(line);
        }
    }

    pub(crate) fn ask(&mut self, request: &str) -> Vec<String> {
        self.send(&format!("{request}\n"));
        self.answer()
    }

    pub(crate) fn bytes(&mut self, count: usize) -> Vec<u8> {
        let mut bytes = vec![0; count];
        self.reader.read_exact(&mut bytes).unwrap();
        bytes
    }

    /// Whether nothing comes for a while.
    pub(crate) fn is_silent(&mut self, time: Duration) -> bool {
        let stream = self.reader.get_ref();
        stream.set_read_timeout(Some(time)).unwrap();
        let silent = self.reader.buffer().is_empty() && stream.peek(&mut [0]).is_err();
        let stream = self.reader.get_ref();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        silent
    }
}
