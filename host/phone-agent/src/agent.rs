//! Waits for its host, answers it, and ends when it is gone.

use phone_agent::{Answer, QUESTION, read_question};

use crate::system::{self, Clock, File};

/// The battery is asked so often, ns: reading it may take milliseconds.
const BATTERY_EVERY_NS: i64 = 5_000_000_000;

/// Serves on the abstract socket of this name until no question has come for `patience`, a
/// number of seconds; gives the exit code.
pub(crate) fn run(own_file: &[u8], name: &[u8], patience: &[u8]) -> i32 {
    let Some(patience_s) = number(patience).and_then(|seconds| u32::try_from(seconds).ok()) else {
        return 2;
    };
    // Started by hand from elsewhere, it may not be allowed to.
    let _ = system::remove(own_file);
    let Some(listener) = File::listen(name) else {
        return 1;
    };
    let mut battery = Battery::default();
    while listener.is_ready(patience_s) {
        let Some(host) = listener.accept() else {
            return 1;
        };
        if !serve(&host, patience_s, &mut battery) {
            return 0;
        }
    }
    0
}

/// Answers a connection; false if its host has fallen silent.
fn serve(host: &File, patience_s: u32, battery: &mut Battery) -> bool {
    loop {
        let mut question = [0; QUESTION];
        let mut come = 0;
        while come < QUESTION {
            if !host.is_ready(patience_s) {
                return false;
            }
            match host.read(&mut question[come..]) {
                Some(more) if more > 0 => come += more,
                _ => return true,
            }
        }
        let Some(nonce) = read_question(&question) else {
            return true;
        };
        let answer = Answer {
            nonce,
            boot_ns: system::now(Clock::Boot),
            monotonic_ns: system::now(Clock::Monotonic),
            temperature: battery.temperature,
        };
        if !host.send(&answer.bytes()) {
            return true;
        }
        // Only now: the answer does not wait for it.
        battery.look(answer.monotonic_ns);
    }
}

/// The battery's temperature, 0.1 °C, as it was read last.
#[derive(Default)]
struct Battery {
    temperature: Option<i32>,
    looked_ns: Option<i64>,
}

impl Battery {
    fn look(&mut self, now_ns: i64) {
        if self
            .looked_ns
            .is_some_and(|at| now_ns - at < BATTERY_EVERY_NS)
        {
            return;
        }
        self.looked_ns = Some(now_ns);
        let mut text = [0; 16];
        let file = File::open(c"/sys/class/power_supply/battery/temp");
        let length = file.and_then(|file| file.read(&mut text)).unwrap_or(0);
        self.temperature = number(text.get(..length).unwrap_or_default());
    }
}

/// A whole number at the begin of a line.
fn number(text: &[u8]) -> Option<i32> {
    let (sign, digits) = match text {
        [b'-', digits @ ..] => (-1, digits),
        digits => (1, digits),
    };
    let mut value = None;
    for digit in digits
        .iter()
        .take_while(|byte| byte.is_ascii_digit())
        .take(6)
    {
        value = Some(value.unwrap_or(0) * 10 + i32::from(digit - b'0'));
    }
    value.map(|value| sign * value)
}
