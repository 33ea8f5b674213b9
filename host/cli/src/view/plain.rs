//! The state as one plain line: for logs, pipes, and terminals that can do no more.

use std::fmt::Write as _;

use recording::error_budget::together;
use session::event::Tracked;

use super::state::{PhaseNow, State};

/// Returns the state of the lock onto the phone's clock.
pub(super) const fn lock(tracked: &Tracked) -> &'static str {
    if tracked.holds { "locked" } else { "LOCK LOST" }
}

/// Returns the uncertainty of the phase in words.
pub(super) fn known(now: &PhaseNow) -> String {
    together(now.sigma_us, now.largest)
}

/// Returns the state as one plain line.
pub(crate) fn line(state: &State) -> String {
    let mut line = format!("{:.1} s  {}", state.now.as_secs_f64(), state.doing());
    // Writing into a String cannot fail.
    let _ = write_all(&mut line, state);
    line
}

fn write_all(line: &mut String, state: &State) -> std::fmt::Result {
    if let Some((elapsed, length)) = state.recorded_s() {
        write!(line, " {elapsed:.0} s")?;
        if let Some(length) = length {
            write!(line, " of {length:.0} s")?;
        }
    }
    if let Some(twist) = state.twist() {
        let sigma = twist.sigma_us;
        write!(
            line,
            "  {:.1} of {:.0} s, expected 1-sigma {}, {}",
            twist.elapsed_s,
            twist.length_s,
            sigma.map_or(String::from("-"), |sigma| format!("{sigma:.1} µs")),
            twist.advice()
        )?;
    }
    let trigger = &state.trigger;
    if !trigger.state.is_empty() {
        write!(line, "  trigger {}", trigger.state)?;
    }
    if let Some(fps) = trigger.fps {
        write!(line, " {fps:.3} fps")?;
    }
    if let Some(pulse) = trigger.pulse {
        write!(line, " pulse {pulse}")?;
    }
    if let Some(now) = state.phase_now() {
        write!(line, "  {}, grid {:+.2} µs", known(&now), now.phase_us)?;
        if now.is_twist_due {
            line.push_str(", time for another twist");
        }
        if let Some(tracked) = &now.tracked {
            write!(line, ", {}", lock(tracked))?;
        }
    }
    for phone in &state.phones {
        if let Some(clock) = state.clock_now(phone) {
            write!(line, "  {} ± {:.1} µs", phone.name, clock.sigma_us)?;
        }
    }
    for sensor in state.sensors() {
        write!(line, "  {} {:.2}/s", sensor.name, sensor.rate)?;
        if let Some(utc) = sensor.utc_text() {
            write!(line, " at {utc}")?;
        }
    }
    let rates = state.rates();
    write!(
        line,
        "  imu {:.0}/s  lost {}  load {:.1} %",
        rates.imu, state.losses.messages, rates.load_percent
    )?;
    if let Some(disk) = &state.disk {
        write!(line, "  disk {:.1} GB", disk.free as f64 * 1e-9)?;
    }
    if let Some(warning) = state.warnings.back() {
        write!(line, "  last warning: {}", warning.text)?;
    }
    Ok(())
}
