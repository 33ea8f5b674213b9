//! Processes that are to take Ctrl-C for a request.

use std::time::{Duration, Instant};

/// The longest that is waited, on a machine however slow.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Waits until a process catches SIGINT: before, one ends it at once.
pub fn wait_until_caught(process: u32) {
    let begun = Instant::now();
    loop {
        let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
        let mask = status
            .lines()
            .find_map(|line| line.strip_prefix("SigCgt:\t"));
        // proc(5): bit 0 is signal 1.
        if u64::from_str_radix(mask.unwrap(), 16).unwrap() & (1 << (2 - 1)) != 0 {
            return;
        }
        assert!(begun.elapsed() < PATIENCE, "it does not catch SIGINT");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Processor time that a process has used so far, s; nothing once it is gone.
pub fn worked_s(process: u32) -> Option<f64> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    // proc(5): the name is in brackets; from its state on, user and system time are the
    // 12th and the 13th, in hundredths.
    let (_, rest) = stat.rsplit_once(") ")?;
    let times = rest.split(' ').skip(11).take(2);
    Some(times.map(|time| time.parse::<f64>().unwrap()).sum::<f64>() / 100.0)
}
