//! The sections of a recording's report: clocks, alignment, auxiliary sensors, trigger, motion,
//! losses and marks.

use protocol::Ticks;

use super::curves::Curves;
use super::measured::TwistRates;
use super::{MAX_LISTED, seconds};
use crate::chart::{self, Data, Envelope};
use crate::page::Page;
use board::finding::Severity;
use clock::BoardSeconds;
use recording::error_budget::{ErrorPart, micros_text};
use recording::session_file::{Alignment, SessionFile, Span};

pub(super) fn clocks(page: &mut Page, session: &SessionFile, curves: &Curves) {
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
    for twist in &curves.twists {
        overlay(page, twist);
    }
}

/// Draws both gyroscopes in a twist, and the residual between them.
fn overlay(page: &mut Page, twist: &TwistRates) {
    let number = twist.number;
    let Some(curves) = twist.curves() else {
        let text = format!("Twist {number} is not drawn: the phone's samples of it are missing.");
        return page.text(&text);
    };
    let rms = curves.rms;
    let all = ["board", "phone"].into_iter().zip(curves.magnitudes);
    let all = all.map(|(name, rates)| (name, Data::Line(rates))).collect();
    let svg = chart::series("time of the twist, s", "rad/s", 0.0..1.0, all);
    page.figure(
        &svg,
        &format!(
            "Twist {number}: magnitude of the angular rates of board and phone; the phone's \
             samples are in board time by this twist."
        ),
    );
    let all = ["x", "y", "z"].into_iter().zip(curves.residual);
    let all = all
        .map(|(name, rates)| (name, Data::Points(rates)))
        .collect();
    let label = "phone − board, rad/s";
    let svg = chart::series("time of the twist, s", label, -0.01..0.01, all);
    page.figure(
        &svg,
        &format!(
            "What is left between the two: {rms:.3} rad/s rms, about each axis of the phone, after \
             rotation, scale and bias. It is noise if they are rigidly joined and correctly timed; a \
             copy of the motion in it is due to a wrong time, or to a part that moves by itself."
        ),
    );
}

pub(super) fn alignment(page: &mut Page, session: &SessionFile, curves: &Curves) {
    let Some(alignment) = session.alignment else {
        return;
    };
    page.section("How the trigger was aligned");
    page.facts(&[
        (
            "phone's frame period",
            format!(
                "{:.3} ns, {}",
                alignment.plan.frames.period_ns,
                match alignment.plan.frames.source {
                    clock::frames::FramePeriodSource::Learnt => "learnt from earlier recordings",
                    clock::frames::FramePeriodSource::VideoStart =>
                        "as the phone reported it at the start",
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
    let mut all: Vec<_> = band(session, curves).into_iter().collect();
    let measured = range("measured", &curves.phase);
    let has_measured = measured.is_some();
    all.extend(measured);
    let measured = if has_measured {
        "Measured is each pulse against the phone's nearest frame, by the app's file of frame \
             timestamps and the last clock relation: an error of that relation moves both and does \
             not show. An extraction and the command evaluate see it."
    } else {
        "Nothing is measured yet: the phone's file of frame timestamps is not in the folder."
    };
    let svg = chart::series("board time, s", "depth − phone, µs", -1.0..1.0, all);
    if !svg.is_empty() {
        page.figure(
            &svg,
            &format!(
                "Distance of the two exposures' middles over the recording, predicted from the \
                 uncertainty of clocks and frame period, without that of the constant and of the \
                 board's warming. {measured}"
            ),
        );
    }
}

/// Returns the predicted distance of the exposures' middles over the recording (depth minus
/// phone, µs), with its 1-sigma, as it was known while it was recorded.
fn band(session: &SessionFile, curves: &Curves) -> Option<(&'static str, Data)> {
    if session.tracking.is_none() {
        return predicted(session);
    }
    let (span, alignment) = (session.recorded?, session.alignment?);
    let start_us = alignment.plan.phase_sigma_us_at(span.from.into());
    let steps = &curves.tracked_us;
    let sigma_us = |step: Option<&(f64, f64)>| step.map_or(start_us, |(_, sigma_us)| *sigma_us);
    let begin = (span.from.as_secs_f64(), sigma_us(steps.first()));
    let end = (span.to.as_secs_f64(), sigma_us(steps.last()));
    let all = [&[begin], &steps[..], &[end]].concat();
    let all = all.into_iter();
    let band = all.map(|(at, sigma_us)| (at, -alignment.shift_us, sigma_us));
    Some(("as followed, 1-sigma", Data::Band(band.collect())))
}

/// Returns the predicted distance of the exposures' middles over the recording (depth minus
/// phone, µs), with its 1-sigma; `None` if the phone's clock was followed instead.
pub(crate) fn predicted(session: &SessionFile) -> Option<(&'static str, Data)> {
    let (span, alignment) = (session.recorded?, session.alignment?);
    if session.tracking.is_some() {
        return None;
    }
    let sigma_us = |at| alignment.plan.phase_sigma_us_at(at);
    let band = times(span).map(|at| (at.0, -alignment.shift_us, sigma_us(at)));
    Some(("predicted, 1-sigma", Data::Band(band.collect())))
}

/// Draws the parts of the total uncertainty, and the total, as bars.
fn budget(page: &mut Page, session: &SessionFile, alignment: &Alignment) {
    let total = alignment.stated_sigma_us();
    let mut parts = vec![(ErrorPart::Clocks.text(), alignment.clocks_sigma_us())];
    let constants = session.profile.constant_parts(alignment.exposure_us);
    parts.extend(
        constants
            .iter()
            .map(|(part, sigma_us)| (part.text(), *sigma_us)),
    );
    parts.push(("all together", total));
    page.figure(
        &chart::bars(&parts, micros_text),
        "Error budget: how far the middles of the two exposures may be from each other (1-sigma, \
         the largest of the recording), part by part; all together is the root of the sum of \
         squares.",
    );
}

/// Lists the sensors on the auxiliary outputs and the lidar, by name.
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
            let utc =
                jiff::Timestamp::from_second(utc).map_or(utc.to_string(), |time| time.to_string());
            page.text(&format!(
                "{name} received {} seconds; the last, {utc}, began at {:.9} s of board time.",
                gnss.seconds,
                gnss.last.as_secs_f64()
            ));
            if gnss.changed {
                page.note(
                    Severity::Check,
                    "The relation of its seconds to board time changed within the recording.",
                );
            }
        }
        None if profile.lidar.is_some() => page.note(
            Severity::Check,
            &format!("{name} is in the profile, but received no second."),
        ),
        None => {}
    }
}

pub(super) fn trigger(page: &mut Page, session: &SessionFile, curves: &Curves) {
    let has_readback = curves.readback.extremes().is_some();
    if !has_readback && session.counts.pulses.received == 0 {
        return;
    }
    page.section("The trigger");
    if has_readback {
        course(
            page,
            "time from the trigger's edge to the same edge after the buffer",
            ("ticks", &curves.readback, 1.5),
        );
    } else {
        page.note(
            Severity::Check,
            "The read-back input saw no pulses: nothing proves that they reached the camera. Wire \
             PA3 after the buffer.",
        );
    }
}

pub(super) fn motion(page: &mut Page, curves: &Curves) {
    let Some(gyro) = range("", &curves.gyro) else {
        return;
    };
    page.section("Motion and board");
    let svg = chart::series("board time, s", "rad/s", 0.0..0.1, vec![gyro]);
    page.figure(
        &svg,
        "Magnitude of the rig's angular rate: smallest and largest value in each stretch of time.",
    );
    for (name, what) in [
        (
            "time from sample to sample of the IMU",
            ("µs", &curves.imu_intervals, 0.1),
        ),
        (
            "time from pulse to pulse",
            ("µs", &curves.pulse_intervals, 0.1),
        ),
        ("temperature of the IMU", ("°C", &curves.temperature, 1.0)),
    ] {
        course(page, name, what);
    }
}

/// Draws a quantity over the recording, or writes its range if that is below `steady`.
fn course(page: &mut Page, name: &str, (unit, values, steady): (&str, &Envelope, f64)) {
    let Some((low, high)) = values.extremes() else {
        return;
    };
    if high - low < steady {
        return page.text(&format!("The {name}: always {low:.2} to {high:.2} {unit}."));
    }
    let all = range(name, values).into_iter().collect();
    let svg = chart::series("board time, s", unit, low..low + steady, all);
    page.figure(
        &svg,
        &format!("The {name}, in {unit}: smallest and largest in each stretch of time."),
    );
}

/// Draws the gaps in the numbers of the board's messages.
pub(super) fn losses(page: &mut Page, curves: &Curves) {
    page.section("Losses");
    if curves.losses.is_empty() {
        return page.text("No message of any stream is missing by the board's numbers.");
    }
    let streams = curves.losses.iter().map(|&(.., stream, _)| stream.name());
    let mut streams: Vec<&str> = streams.collect();
    streams.sort_unstable();
    streams.dedup();
    let all = streams.iter().map(|&name| {
        let own = curves.losses.iter();
        let own = own.filter(|(_, stream, _)| stream.name() == name);
        let points = own.map(|&(at, _, count)| (at.as_secs_f64(), f64::from(count)));
        (name, Data::Points(points.collect()))
    });
    let labels = ["board time, s", "messages"];
    let svg = chart::counted(labels, [false, true], 0.0..1.0, all.collect());
    let caption = format!(
        "Messages of {} missing by the board's numbers: dropped by the board, or lost on the link.",
        streams.join(", ")
    );
    page.figure(&svg, &caption);
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

/// Returns the times of a hundred steps over a span.
fn times(span: Span) -> impl Iterator<Item = BoardSeconds> {
    let (from, to) = (span.from.as_secs_f64(), span.to.as_secs_f64());
    (0..=100).map(move |step| BoardSeconds(from + (to - from) * f64::from(step) / 100.0))
}
