//! Serves the host, and ends after its silence.

use phone_agent::{Answer, QUESTION, read_question};

use crate::syscalls::{self, Clock, File};

/// Serves on the abstract socket `name` until no question has arrived for `patience`, a decimal
/// number of seconds. Removes `own_file`, a path that ends with a zero. Returns the exit code.
pub(crate) fn run(own_file: &[u8], name: &[u8], patience: &[u8]) -> i32 {
    let patience = str::from_utf8(patience).ok();
    let Some(patience_s) = patience.and_then(|seconds| seconds.parse().ok()) else {
        return 2;
    };
    // Fails if it was started by hand from a folder that it may not change.
    let _ = syscalls::remove(own_file);
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

/// Serves a connection. Returns false if its host was silent for `patience_s` seconds.
fn serve(host: &File, patience_s: u32) -> bool {
    loop {
        let mut question = [0; QUESTION];
        let mut received = 0;
        while received < QUESTION {
            if !host.is_ready(patience_s) {
                return false;
            }
            match host.read(&mut question[received..]) {
                Some(more) if more > 0 => received += more,
                _ => return true,
            }
        }
        let Some(nonce) = read_question(&question) else {
            return true;
        };
        let answer = Answer {
            nonce,
            boot_ns: syscalls::now(Clock::Boot),
            monotonic_ns: syscalls::now(Clock::Monotonic),
        };
        if !host.send(&answer.bytes()) {
            return true;
        }
    }
}
