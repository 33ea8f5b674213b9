//! Waits for its host, answers it, and ends when it is gone.

use phone_agent::{Answer, QUESTION, read_question};

use crate::system::{self, Clock, File};

/// Serves on the abstract socket of this name until no question has come for `patience`, a
/// number of seconds; gives the exit code.
pub(crate) fn run(own_file: &[u8], name: &[u8], patience: &[u8]) -> i32 {
    let patience = str::from_utf8(patience).ok();
    let Some(patience_s) = patience.and_then(|seconds| seconds.parse().ok()) else {
        return 2;
    };
    // Started by hand from elsewhere, it may not be allowed to.
    let _ = system::remove(own_file);
    let Some(listener) = File::listen(name) else {
        return 1;
    };
    while listener.is_ready(patience_s) {
        let Some(host) = listener.accept() else {
            return 1;
        };
        if !serve(&host, patience_s) {
            return 0;
        }
    }
    0
}

/// Answers a connection; false if its host has fallen silent.
fn serve(host: &File, patience_s: u32) -> bool {
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
        };
        if !host.send(&answer.bytes()) {
            return true;
        }
    }
}
