//! The sections of a report on clocks, frames, trigger and motion.

use protocol::Ticks;

use super::curves::Curves;
use super::{MAX_LISTED, seconds};
use crate::chart::{self, Data, Envelope};
use crate::page::Page;
use recording::error_budget::{ErrorPart, micros_text};
use recording::finding::Severity;
use recording::session_file::{Alignment, FramePeriodSource, SessionFile, Span};
use session::alignment::phase_sigma_us_at;
use timebase::BoardSeconds;

pub(super) fn clocks(page: &mut Page, session: &SessionFile) {
    let Some(phone) = session.reference() else {
        return;
    };
    if phone.twists.is_empty() && phone.clock.is_none() {
        return;
    }
    page.section("The clocks of phone and board");
    let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:.3}"));
    let rows = phone.twists.iter().enumerate().map(|(index, twist)| {
        [
            (index + 1).to_string(),
            format!("{:.1}", twist.span.from.as_secs_f64()),
            format!("{:.1}", seconds(twist.span.from, twist.span.to)),
            String::from(if twist.accepted { "used" } else { "refused" }),
            number(twist.offset_sigma_us),
            number(twist.clock.map(|clock| clock.skew * 1e6)),
            number(twist.skew_sigma_ppm),
        ]
    });
    page.table(
        [
            "twist",
            "at, s",
            "length, s",
            "result",
            "offset 1σ, µs",
            "rate, ppm",
            "rate 1σ, ppm",
        ],
        rows,
    );
    if let (Some(clock), Some(span)) = (phone.clock, session.recorded) {
        let sigma_us = |at| clock.offset_at(at).sigma * 1e6;
        let svg = curve("offset", "1-sigma of the offset, µs", span, sigma_us);
        if !svg.is_empty() {
            page.figure(
                &svg,
                "How well a time of the phone is known in board time, over the recording (1-sigma \
                 of the last clock relation). It grows away from the twists; a second twist at \
                 the end keeps it low at both ends.",
            );
        }
    }
}

pub(super) fn alignment(page: &mut Page, session: &SessionFile) {
    let Some(alignment) = session.alignment else {
        return;
    };
    page.section("How the trigger was aligned");
    page.facts(&[
        (
            "phone's frame period",
            format!(
                "{:.3} ns, {}",
                alignment.frame_period_ns,
                match alignment.frame_period_source {
                    FramePeriodSource::Learnt => "learnt from earlier recordings",
                    FramePeriodSource::VideoStart => "as the phone reported it at the start",
                }
            ),
        ),
        ("exposure used", format!("{:.1} µs", alignment.exposure_us)),
        (
            "start of the middle row",
            format!("{:.1} µs after the first", alignment.middle_row_us),
        ),
        (
            "centre of depth exposure",
            format!(
                "{:.1} µs after the trigger's edge",
                alignment.center_offset_us
            ),
        ),
        ("bias taken out", format!("{:+.1} µs", alignment.bias_us)),
        (
            "shifted on purpose",
            format!("{:+.1} µs", alignment.shift_us),
        ),
        (
            "arrived",
            match (alignment.arrival_pulse, alignment.arrival) {
                (Some(pulse), Some(at)) => format!("at pulse {pulse}, {:.3} s", at.as_secs_f64()),
                _ => String::from("not confirmed"),
            },
        ),
    ]);
    budget(page, session, &alignment);
    if let Some(span) = session.recorded {
        let sigma_us = |at| phase_sigma_us_at(&alignment, at);
        let svg = curve("phase", "1-sigma of the phase, µs", span, sigma_us);
        if !svg.is_empty() {
            page.figure(
                &svg,
                "Predicted distance of the two exposures' middles over the recording (1-sigma), \
                 from the uncertainty of clocks and frame period, without that of the constant. \
                 The command evaluate measures it.",
            );
        }
    }
}

/// The parts of the total uncertainty as bars, and what comes of them.
fn budget(page: &mut Page, session: &SessionFile, alignment: &Alignment) {
    let total = alignment.phase_sigma_us;
    let constant = alignment.constant_sigma_us.unwrap_or_default();
    let clocks = (total * total - constant * constant).max(0.0).sqrt();
    let mut parts = vec![(ErrorPart::Clocks.text(), clocks)];
    match alignment.bias_is_measured {
        true => parts.push((ErrorPart::Bias.text(), constant)),
        false => {
            let constants = session.profile.constant_parts();
            parts.extend(constants.map(|(part, sigma_us)| (part.text(), sigma_us)));
        }
    }
    parts.push(("all together", total));
    page.figure(
        &chart::bars(&parts, micros_text),
        "Error budget: how far the middles of the two exposures may be from each other (1-sigma), \
         part by part; all together is the root of the sum of squares.",
    );
}

/// The sensors on the auxiliary outputs and the lidar, by name.
pub(super) fn auxiliary(page: &mut Page, session: &SessionFile, curves: &Curves) {
    let profile = &session.profile;
    if curves.outputs.is_empty()
        && curves.gnss.is_none()
        && profile.outputs.is_empty()
        && profile.lidar.is_none()
    {
        return;
    }
    page.section("Auxiliary sensors");
    let known = profile.outputs.iter().map(|sensor| sensor.name.as_str());
    let others = curves.outputs.keys().map(String::as_str);
    let others = others.filter(|name| !known.clone().any(|known| known == *name));
    let rows = known.clone().chain(others).map(|name| {
        let set = profile.outputs.iter().find(|sensor| sensor.name == name);
        let rule = set.map(|set| format!("output {}, {}", set.output, set.rule()));
        let seen = curves.outputs.get(name);
        let span = seen.map(|&(_, first, last)| {
            format!("{:.3} to {:.3}", first.as_secs_f64(), last.as_secs_f64())
        });
        let unknown = || String::from("-");
        [
            name.to_owned(),
            rule.unwrap_or_else(unknown),
            seen.map_or(0, |seen| seen.0).to_string(),
            span.unwrap_or_else(unknown),
        ]
    });
    page.table(["sensor", "trigger", "pulses", "board time, s"], rows);
    let name = profile
        .lidar
        .as_ref()
        .map_or("the lidar", |lidar| lidar.name.as_str());
    match curves.gnss {
        Some(gnss) => {
            let utc = gnss.utc_ns.div_euclid(1_000_000_000);
            let told =
                jiff::Timestamp::from_second(utc).map_or(utc.to_string(), |time| time.to_string());
            page.text(&format!(
                "{name} was told {} seconds; the last, {told}, began at {:.9} s of board time.",
                gnss.seconds,
                gnss.last.as_secs_f64()
            ));
            if gnss.changed {
                page.note(
                    Severity::Check,
                    "The relation of what was told to board time changed within the recording.",
                );
            }
        }
        None if profile.lidar.is_some() => page.note(
            Severity::Check,
            &format!("{name} is in the profile, but no second was told."),
        ),
        None => {}
    }
}

pub(super) fn trigger(page: &mut Page, session: &SessionFile, curves: &Curves) {
    let off_grid = range("off the grid", &curves.off_grid);
    let readback = range("read-back", &curves.readback);
    if off_grid.is_none() && readback.is_none() {
        return;
    }
    page.section("The trigger");
    if curves.off_grid.extremes() == Some((0.0, 0.0)) {
        page.text("Every pulse was where it should be on its grid, to the tick of 20.83 ns.");
    } else if let Some(series) = off_grid {
        let svg = chart::series(
            "board time, s",
            "off the grid, ticks",
            -2.0..2.0,
            vec![series],
        );
        page.figure(
            &svg,
            "Each pulse against the grid it was sent to, in ticks of 20.83 ns.",
        );
    }
    match readback {
        Some(series) => {
            let svg = chart::series(
                "board time, s",
                "edge to wire, ticks",
                0.0..10.0,
                vec![series],
            );
            page.figure(
                &svg,
                "From the trigger's edge to the same edge behind the buffer, as the board measured \
                 it. Steady: the wire is good.",
            );
        }
        None if session.counts.pulses.received > 0 => page.note(
            Severity::Check,
            "The read-back input saw no pulses: nothing proves that they reached the camera. Wire \
             PA3 behind the buffer.",
        ),
        None => {}
    }
}

pub(super) fn motion(page: &mut Page, curves: &Curves) {
    let gyro: Vec<(&str, Data)> = ["x", "y", "z"]
        .into_iter()
        .zip(&curves.gyro)
        .filter_map(|(name, envelope)| range(name, envelope))
        .collect();
    if gyro.is_empty() {
        return;
    }
    page.section("Motion and board");
    let svg = chart::series("board time, s", "rad/s", -0.1..0.1, gyro);
    page.figure(
        &svg,
        "Gyroscope of the board: smallest and largest value in each stretch of time. The twist \
         stands out at the beginning.",
    );
    for (name, unit, envelope, least) in [
        ("load of the processor", "%", &curves.load, 0.0..10.0),
        (
            "temperature of the IMU",
            "°C",
            &curves.temperature,
            20.0..30.0,
        ),
    ] {
        if let Some((low, high)) = envelope.extremes().filter(|(low, high)| high - low < 1.0) {
            page.text(&format!(
                "The {name}: {low:.1} to {high:.1} {unit} all the time."
            ));
        } else if let Some(series) = range(name, envelope) {
            let svg = chart::series("board time, s", unit, least, vec![series]);
            page.figure(&svg, &format!("The {name}, in {unit}."));
        }
    }
}

pub(super) fn marks(page: &mut Page, session: &SessionFile) {
    if session.markers.is_empty() {
        return;
    }
    page.section("Marks");
    let from = session.recorded.map_or(Ticks::ZERO, |span| span.from);
    let markers = session.markers.iter().take(MAX_LISTED);
    page.table(
        ["board time, s", "into the recording, s", "mark"],
        markers.map(|marker| {
            let at = format!("{:.3}", marker.at.as_secs_f64());
            let into = format!("{:.3}", seconds(from, marker.at));
            [at, into, marker.label.clone()]
        }),
    );
}

fn range<'a>(name: &'a str, envelope: &Envelope) -> Option<(&'a str, Data)> {
    let columns = envelope.columns();
    (!columns.is_empty()).then(|| (name, Data::Range(columns, envelope.width())))
}

/// A curve over a span, of a hundred points.
fn curve(name: &str, unit: &str, span: Span, value: impl Fn(BoardSeconds) -> f64) -> String {
    let (from, to) = (span.from.as_secs_f64(), span.to.as_secs_f64());
    let points = (0..=100).map(|step| {
        let at = from + (to - from) * f64::from(step) / 100.0;
        (at, value(BoardSeconds(at)))
    });
    let all = vec![(name, Data::Line(points.collect()))];
    chart::series("board time, s", unit, 0.0..1.0, all)
}
