//! The facts of a snapshot as lines of a screen.

use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::Snapshot;
use super::draw::{BAD, BOLD, DIM, GOOD, WARN};

fn fact<'a>(name: &'static str, value: String, style: Style) -> Line<'a> {
    Line::from(vec![
        Span::styled(format!("{name:<10}"), DIM),
        Span::styled(value, style),
    ])
}

/// One line each of the further outputs, the lidar, and the further phones.
pub(super) fn sensor_lines(snapshot: &Snapshot) -> Vec<Line<'_>> {
    let row = |name: &str, text: String, style: Style| {
        let name: String = name.chars().take(16).collect();
        Line::from(vec![
            Span::styled(format!(" {name:<17}"), DIM),
            Span::styled(text, style),
        ])
    };
    let sensors = snapshot.sensors.iter().map(|sensor| {
        let mut text = format!("{}, {:.2}/s", sensor.at, sensor.rate);
        if !sensor.state.is_empty() {
            text.push_str(&format!(", {}", sensor.state));
        }
        match (sensor.utc_text(), sensor.pulse) {
            (Some(utc), _) => text.push_str(&format!(", told {utc}")),
            (None, Some(pulse)) => text.push_str(&format!(", pulse {pulse}")),
            (None, None) => {}
        }
        if sensor.late > 0 {
            text.push_str(&format!(", {} LATE", sensor.late));
        }
        let style = if sensor.late > 0 { BAD } else { Style::new() };
        row(&sensor.name, text, style)
    });
    let phones = snapshot.phones.iter().map(|phone| {
        let mut text = match &phone.clock {
            Some(known) => format!("clocks +-{:.1} us now", known.sigma_us),
            None => String::from("no twist yet"),
        };
        if let Some((offset, sigma)) = phone.placement_us {
            text.push_str(&format!(", frames {offset:+.0} +-{sigma:.0} us off grid"));
        }
        row(&phone.name, text, Style::new())
    });
    sensors.chain(phones).collect()
}

pub(super) fn trigger_lines(snapshot: &Snapshot) -> Vec<Line<'_>> {
    let trigger = &snapshot.trigger;
    let dash = || String::from("-");
    let phase = match (trigger.phase_us, trigger.phase_sigma_us) {
        (Some(_), Some(sigma)) if trigger.twist_due => {
            (format!("+-{sigma:.0} us: time for a TWIST"), WARN)
        }
        (Some(phase), Some(sigma)) => match &trigger.tracked {
            Some(tracked) => (
                format!("{phase:+.1} us +-{sigma:.1} us, {}", tracked.text()),
                if tracked.holds { GOOD } else { WARN },
            ),
            None => (
                format!("{phase:+.2} us off grid, +-{sigma:.1} us"),
                if phase == 0.0 { GOOD } else { BAD },
            ),
        },
        _ => (String::from("not aligned yet"), Style::new()),
    };
    let readback = match (trigger.readback_ns, trigger.readback_missing) {
        (Some(ns), 0) => (format!("seen, {ns:.0} ns after the edge"), GOOD),
        (Some(ns), missing) => (format!("{ns:.0} ns, {missing} NOT SEEN"), BAD),
        (None, _) if trigger.fps.is_some() => (String::from("not wired or not seen"), WARN),
        (None, _) => (dash(), Style::new()),
    };
    let mut lines = vec![
        fact(
            "train",
            format!(
                "{}{}",
                if trigger.state.is_empty() {
                    "?"
                } else {
                    &trigger.state
                },
                trigger
                    .fps
                    .map_or(String::new(), |fps| format!(", {fps:.4} fps"))
            ),
            BOLD,
        ),
        fact(
            "pulse",
            match trigger.pulse {
                Some(pulse) if trigger.late > 0 => format!("{pulse}, {} LATE", trigger.late),
                Some(pulse) => pulse.to_string(),
                None => dash(),
            },
            if trigger.late > 0 { BAD } else { Style::new() },
        ),
        fact("phase", phase.0, phase.1),
        fact("read-back", readback.0, readback.1),
    ];
    match &snapshot.clock {
        Some(known) => {
            lines.push(fact(
                "clocks",
                format!("+-{:.1} us now, {} old", known.sigma_us, clock(known.age_s)),
                if known.sigma_us < 100.0 { GOOD } else { WARN },
            ));
            lines.push(fact(
                "",
                format!("{:.6} s, {:+.3} ppm", known.offset_s, known.skew_ppm),
                Style::new(),
            ));
        }
        None => lines.push(fact("clocks", String::from("no twist yet"), Style::new())),
    }
    lines
}

pub(super) fn state_lines(snapshot: &Snapshot) -> Vec<Line<'_>> {
    let rates = &snapshot.rates;
    let losses = &snapshot.losses;
    let imu = match rates.imu_running {
        Some(false) => (String::from("DOES NOT ANSWER"), BAD),
        _ => (
            format!(
                "{:.1}/s{}",
                rates.imu,
                rates
                    .temperature
                    .map_or(String::new(), |celsius| format!(", {celsius:.1} C"))
            ),
            Style::new(),
        ),
    };
    let lost = losses.messages + losses.damaged;
    let mut lines = vec![
        fact("IMU", imu.0, imu.1),
        fact(
            "pulses",
            format!("{:.2}/s, strobe {:.2}/s", rates.pulses, rates.captures),
            Style::new(),
        ),
        fact(
            "lost",
            format!(
                "{} messages, {} damaged{}",
                losses.messages,
                losses.damaged,
                match losses.reconnects {
                    0 => String::new(),
                    n => format!(", {n} relinks"),
                }
            ),
            if lost == 0 && losses.reconnects == 0 {
                GOOD
            } else {
                BAD
            },
        ),
        fact("load", format!("{:.1} %", rates.load_percent), Style::new()),
    ];
    lines.push(match &snapshot.disk {
        Some(disk) => fact(
            "disk",
            format!(
                "{:.1} GB free{}",
                disk.free as f64 * 1e-9,
                disk.left_s
                    .map_or(String::new(), |left| format!(", for {}", clock(left)))
            ),
            if disk.free < 1_000_000_000 {
                WARN
            } else {
                Style::new()
            },
        ),
        None => fact("disk", String::from("nothing is recorded"), DIM),
    });
    if let Some((at, label)) = snapshot.markers.last() {
        lines.push(fact(
            "last mark",
            format!("{label} at {:.1} s", at.as_secs_f64()),
            Style::new(),
        ));
    }
    lines
}

/// Seconds as `1:02:03`.
pub(super) fn clock(seconds: f64) -> String {
    let sign = if seconds < 0.0 { "-" } else { "" };
    let whole = seconds.abs().min(1e9) as u64;
    let (hours, minutes, seconds) = (whole / 3_600, whole / 60 % 60, whole % 60);
    if hours > 0 {
        format!("{sign}{hours}:{minutes:02}:{seconds:02}")
    } else {
        format!("{sign}{minutes}:{seconds:02}")
    }
}
