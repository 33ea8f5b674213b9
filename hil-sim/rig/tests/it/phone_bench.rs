//! A simulated phone on a walk, asked without a socket: true time passes only as a test lets
//! it.

use rig::clocks::oscillator::TrueTime;
use rig::clocks::true_clock::TrueClock;
use rig::phone::{Answer, AskedPhone, PhoneConfig, RequestId, Surroundings};
use rig::random::Seed;

pub(crate) struct PhoneBench {
    pub(crate) phone: AskedPhone,
    pub(crate) clock: TrueClock,
}

impl PhoneBench {
    pub(crate) fn new(seed: u64, edit: impl FnOnce(&mut PhoneConfig)) -> Self {
        let clock = TrueClock::new();
        let mut config = PhoneConfig::draw(Seed(seed));
        edit(&mut config);
        let surroundings = Surroundings::walking(Seed(seed), clock.clone());
        let phone = AskedPhone::start(config, surroundings).unwrap();
        Self { phone, clock }
    }

    /// Lets some seconds of true time pass at once.
    pub(crate) fn pass(&mut self, seconds: f64) {
        let until = self.clock.now().as_secs_f64() + seconds;
        self.clock
            .publish(TrueTime::from_nanos((until * 1e9) as u64));
        self.phone.advance();
    }

    /// The lines of an answer without `end`, if it is there: of a video those before its
    /// bytes, and none where the connection was closed.
    pub(crate) fn take(&mut self, id: RequestId) -> Option<Vec<String>> {
        let text = match self.phone.take_answer(id)? {
            Answer::Bytes(bytes) | Answer::File { head: bytes, .. } => bytes,
            Answer::Unreachable | Answer::Closed => return Some(Vec::new()),
        };
        let text = String::from_utf8(text).unwrap();
        let lines = text.strip_suffix("end\n").expect("an answer has an end");
        Some(lines.lines().map(str::to_owned).collect())
    }

    /// Lets true time pass until there is an answer.
    pub(crate) fn answer(&mut self, id: RequestId) -> Vec<String> {
        for _ in 0..2_000 {
            if let Some(lines) = self.take(id) {
                return lines;
            }
            self.pass(0.05);
        }
        panic!("no answer within 100 s");
    }

    pub(crate) fn ask(&mut self, request: &str) -> Vec<String> {
        let id = self.phone.ask(request);
        self.answer(id)
    }
}
