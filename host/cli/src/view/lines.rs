//! A snapshot as one plain line: for logs, pipes, and terminals that can do no
//! more.

use std::fmt::Write as _;

use super::Snapshot;

/// The line.
pub(crate) fn line(snapshot: &Snapshot) -> String {
    let mut line = format!("{:.1} s  {}", snapshot.now.as_secs_f64(), snapshot.state);
    if let Some(recording) = &snapshot.recording {
        let _ = write!(line, " {:.0} s", recording.elapsed_s);
        if let Some(length) = recording.length_s {
            let _ = write!(line, " of {length:.0} s");
        }
    }
    if let Some(twist) = &snapshot.twist {
        let _ = write!(
            line,
            "  twist {:.1} of {:.0} s, expected 1-sigma {}, {}",
            twist.elapsed_s,
            twist.length_s,
            twist
                .sigma_us
                .map_or(String::from("-"), |sigma| format!("{sigma:.1} µs")),
            twist.advice()
        );
    }
    let trigger = &snapshot.trigger;
    if !trigger.state.is_empty() {
        let _ = write!(line, "  trigger {}", trigger.state);
    }
    if let Some(fps) = trigger.fps {
        let _ = write!(line, " {fps:.3} fps");
    }
    if let Some(pulse) = trigger.pulse {
        let _ = write!(line, " pulse {pulse}");
    }
    if let (Some(phase), Some(sigma)) = (trigger.phase_us, trigger.phase_sigma_us) {
        let due = if trigger.twist_due {
            ", time for another twist"
        } else {
            ""
        };
        let _ = write!(line, " phase {phase:+.2} ± {sigma:.1} µs{due}");
        if let Some(tracked) = &trigger.tracked {
            let _ = write!(line, ", {}", tracked.text());
        }
    }
    if let Some(clock) = &snapshot.clock {
        let _ = write!(line, "  clocks ± {:.1} µs", clock.sigma_us);
    }
    for sensor in &snapshot.sensors {
        let _ = write!(line, "  {} {:.2}/s", sensor.name, sensor.rate);
        if let Some(utc) = sensor.utc_text() {
            let _ = write!(line, " told {utc}");
        }
    }
    for phone in &snapshot.phones {
        if let Some(clock) = &phone.clock {
            let _ = write!(line, "  {} ± {:.1} µs", phone.name, clock.sigma_us);
        }
    }
    let _ = write!(
        line,
        "  imu {:.0}/s  lost {}  load {:.1} %",
        snapshot.rates.imu, snapshot.losses.messages, snapshot.rates.load_percent
    );
    if let Some(disk) = &snapshot.disk {
        let _ = write!(line, "  disk {:.1} GB", disk.free as f64 * 1e-9);
    }
    if let Some(warning) = snapshot.warnings.last() {
        let _ = write!(line, "  last warning: {}", warning.text);
    }
    line
}
