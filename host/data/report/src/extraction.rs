//! The report of an extraction: `report.html` for people, with the content of its
//! `report.json`, and the summary of it.

use std::fmt::Write as _;
use std::io;
use std::path::Path;

use extract::report::{
    ClockReport, ClockSource, DepthReport, ExtractReport, OtherReport, PairsReport, SAMPLES_FILE,
    TriggerOffset, WindowResult,
};
use serde_json::json;

use crate::REPORT_FILE;
use crate::chart::{self, Data};
use crate::page::Page;
use crate::session::{self, ALIGNMENT, is_lossy, link_to, predicted, rig_of};
use crate::summary::{Facts, Summary, titled};
use board::finding::{Finding, Severity};
use recording::error_budget::COARSE_US;
use recording::session_file::SessionFile;

/// Caption of the sample pairs.
const SAMPLES: &str = "Some pairs from the middle, the phone's image above the depth image of the same instant. \
    Depth: near is light, far is dark, none is black.";

/// Writes the report of an extraction into its output folder `out`; `recording` is the folder of
/// the recording, and `session` its session file, which has the predicted time difference.
///
/// # Errors
///
/// Fails if the file cannot be written.
pub fn write(
    out: &Path,
    report: &ExtractReport,
    recording: &Path,
    session: Option<&SessionFile>,
) -> io::Result<()> {
    let samples = std::fs::read_to_string(out.join(SAMPLES_FILE)).ok();
    let link = link_to(recording, out);
    let summary = summary(report, recording, session);
    let html = page(report, summary, samples.as_deref(), session, link);
    crate::put(&out.join(REPORT_FILE), &html)
}

/// Assembles the page; `samples` is a drawing of sample pairs.
fn page(
    report: &ExtractReport,
    mut summary: Summary,
    samples: Option<&str>,
    session: Option<&SessionFile>,
    recording: Option<(String, String)>,
) -> String {
    if let Some(session) = session {
        summary.title += &format!(" of {}", rig_of(session));
    }
    summary.title = titled(summary.title, report.board.id.as_deref());
    let mut page = Page::new(&summary);
    page.links(recording.as_slice());
    if let Some(pairs) = &report.pairs {
        page.section("Time difference of the pairs");
        let histogram = &pairs.central;
        let [first, bin] = [histogram.first_ns, histogram.bin_ns].map(|ns| ns as f64 / 1000.0);
        let labels = ["depth − phone, µs", "pairs"];
        page.histogram(
            labels,
            (first, bin),
            &histogram.counts,
            &pairs_caption(pairs),
        );
        page.figure(
            &pairs_svg(&pairs.course, session),
            "The same over time, as measured; with 1-sigma of what was predicted while recording \
             from clocks and frame period, unless the phone's clock was followed. A slope is a drift of the trigger against the phone's \
             frames.",
        );
        if let Some(samples) = samples {
            page.picture(samples, SAMPLES);
        }
    }
    let course = |clock: &Option<ClockReport>| {
        let course = clock.as_ref().map(|clock| clock.course.as_slice());
        course.filter(|course| course.len() > 1).map(course_svg)
    };
    if let Some(svg) = course(&report.clock) {
        page.section("Clock of the phone");
        page.figure(
            &svg,
            "Result of the two gyroscopes in each window relative to the smoothed course, with \
             1-sigma of both.",
        );
    }
    for other in &report.phones {
        if let Some(svg) = course(&other.clock) {
            page.section(&format!("Clock of phone {}", other.name));
            page.figure(
                &svg,
                "As above, for this phone. The trigger does not follow its frames.",
            );
        }
    }
    if report.sequences.len() > 1 {
        page.section("Sequences");
        let rows = report.sequences.iter().map(|part| {
            let [color, depth, pairs] = [part.color, part.depth, part.pairs].map(|n| n.to_string());
            [part.folder.clone(), color, depth, pairs]
        });
        page.table(["folder", "phone", "depth", "pairs"], rows);
    }
    page.settings(
        "Settings: constants that went into the times, ns",
        &json!(report.constants),
    );
    page.html()
}

/// Draws the difference of each pair over time, with its prediction.
fn pairs_svg(course: &[(i64, i64)], session: Option<&SessionFile>) -> String {
    let points = course
        .iter()
        .map(|&(at, difference)| (at as f64 * 1e-9, difference as f64 / 1000.0));
    let points = Data::Points(points.collect());
    let mut all: Vec<_> = session.and_then(predicted).into_iter().collect();
    all.push(("pairs", points));
    chart::series("board time, s", "depth − phone, µs", -1.0..1.0, all)
}

/// Draws the windows relative to the course, with the course's 1-sigma.
fn course_svg(course: &[WindowResult]) -> String {
    let band = course.iter();
    let band = band.map(|w| (w.board_s, 0.0, w.course_sigma_s * 1e6));
    let windows = course.iter();
    let windows = windows.map(|w| (w.board_s, w.residual_s * 1e6, w.sigma_s * 1e6));
    let all = vec![
        ("course, 1-sigma", Data::Band(band.collect())),
        ("windows", Data::Bars(windows.collect())),
    ];
    chart::series("board time, s", "window − course, µs", -1.0..1.0, all)
}

/// Returns the summary of an extraction: losses, remarks and the most important figures. It is no
/// better than the verdict on the recording in the folder `recording`, apart from files that the
/// extraction has from elsewhere.
#[must_use]
pub fn summary(report: &ExtractReport, recording: &Path, session: Option<&SessionFile>) -> Summary {
    let losses = report.losses.iter();
    let losses = losses.map(|loss| Finding::check(loss.part.name(), loss.what.as_str()));
    let remarks = report.remarks.iter();
    let remarks = remarks.map(|remark| Finding::good("note", remark.as_str()));
    let (own, mut text) = verdict(report);
    let judged = session.map_or_else(Vec::new, |session| doubts(recording, session));
    let severity = judged
        .iter()
        .map(|doubt| doubt.severity)
        .fold(own, Severity::max);
    if !judged.is_empty() {
        let kinds: Vec<String> = judged.iter().map(|doubt| doubt.kind.to_string()).collect();
        let _ = write!(
            text,
            " Of the recording itself something is missing or unknown: {}.",
            kinds.join(", ")
        );
    }
    Summary {
        title: format!("Extraction of {}", report.recording),
        severity,
        text,
        parts: judged.into_iter().chain(losses).chain(remarks).collect(),
        facts: facts(report),
    }
}

/// Returns the parts of the verdict on a recording that bear on every data set of it: what the session
/// lost, and what is not known of the alignment.
fn doubts(recording: &Path, session: &SessionFile) -> Vec<Finding> {
    let is_lossy = is_lossy(session, None);
    let parts = session::summary(recording, session, None).parts;
    let is_doubt =
        |part: &Finding| part.severity != Severity::Good && (is_lossy || part.kind == ALIGNMENT);
    parts.into_iter().filter(is_doubt).collect()
}

fn facts(report: &ExtractReport) -> Facts {
    let mut facts = vec![
        ("recording", report.recording.clone()),
        ("format", report.format.name().into()),
        ("trigger pulses", report.board.pulses.to_string()),
        ("board IMU samples", report.board.imu.samples.to_string()),
    ];
    if let Some(reference) = report
        .reference
        .as_ref()
        .filter(|_| !report.phones.is_empty())
    {
        facts.push(("trigger follows", reference.clone()));
    }
    if let Some(phone) = &report.phone {
        facts.push(("phone timestamps", phone.timestamps.to_string()));
        facts.push(("phone images", phone.images.to_string()));
        facts.push(("phone IMU rows", phone.imu_rows.to_string()));
    }
    if let Some(clock) = &report.clock {
        facts.push(("clock relation", clock_line(clock)));
    }
    if let Some(grid) = &report.grid {
        facts.push(("phone against trigger", drift_line(grid)));
    }
    if let Some(depth) = &report.depth {
        facts.push(("depth frames", depth_line(depth)));
        facts.push(("depth images", depth.images.to_string()));
        if depth.color > 0 {
            facts.push(("depth camera's colour", depth.color.to_string()));
        }
        if let (Some((rate, sigma)), Some(residual), Some(decision)) =
            (depth.rate_ppm, depth.residual_us, depth.decided_by)
        {
            facts.push((
                "depth clock",
                format!(
                    "{rate:.3} ppm ± {sigma:.3}, scatter {residual:.1} µs, decided by {decision}"
                ),
            ));
        }
        facts.push(("pulses without a frame", depth.missing.len().to_string()));
    }
    if let Some(pairs) = &report.pairs {
        let us = |ns: i64| format!("{:.1}", ns as f64 / 1000.0);
        let spread = &pairs.spread;
        facts.push((
            "pairs",
            format!(
                "{}, depth − phone: median {} µs, quartiles {} to {} µs",
                spread.count,
                us(spread.median_ns),
                us(spread.quartiles_ns[0]),
                us(spread.quartiles_ns[1])
            ),
        ));
    }
    for other in &report.phones {
        facts.push(("other phone", other_phone_line(other)));
    }
    for sensor in &report.sensors {
        let line = format!("{}: {} pulses", sensor.name, sensor.pulses);
        facts.push(("auxiliary sensor", line));
    }
    let compared = report.verification.compared.iter();
    facts.extend(compared.map(|compared| ("compared", compared.clone())));
    facts
}

/// Returns the verdict on an extraction, and its sentence.
fn verdict(report: &ExtractReport) -> (Severity, String) {
    let pairs = report.pairs.as_ref().map_or(String::new(), |pairs| {
        format!(" {} pairs of frames, {}.", pairs.spread.count, apart(pairs))
    });
    // Nothing is good if its accuracy is unknown.
    let sigma_us = report.pairs.as_ref().map(|pairs| pairs.sigma_us);
    let is_open = sigma_us.is_some_and(|sigma| sigma.is_none_or(|sigma| sigma >= COARSE_US));
    let complete = if report.verification.is_bare {
        "All that is there was read; nothing says what it should hold."
    } else {
        "Complete: nothing is missing or changed since the recording was closed, and the phone's files \
         cover its frames."
    };
    match report.losses.len() {
        0 => (
            if is_open {
                Severity::Check
            } else {
                Severity::Good
            },
            format!("{complete} All times are in board time.{pairs}"),
        ),
        count => (
            Severity::Check,
            format!(
                "Missing or damaged: {count}, listed below. All other times are in board \
                 time.{pairs}"
            ),
        ),
    }
}

/// Describes depth − phone, and how well it is known.
fn apart(pairs: &PairsReport) -> String {
    let median_us = pairs.spread.median_ns as f64 / 1000.0;
    let Some(sigma_us) = pairs.sigma_us else {
        return format!("{median_us:.1} µs apart in the median, the accuracy not known");
    };
    let of = pairs.largest.map_or(String::new(), |part| {
        format!("; most of the ± is from {}", part.text())
    });
    let (apart, unit) = if sigma_us < 1_000.0 {
        (format!("{median_us:.1} ± {sigma_us:.1}"), "µs")
    } else {
        // In steps of what is shown: no zero has a sign.
        let [median, sigma] = [median_us, sigma_us].map(|us| (us * 1e-2).round() * 1e-1 + 0.0);
        (format!("{median:.1} ± {sigma:.1}"), "ms")
    };
    format!("{apart} {unit} apart (depth − phone: median, largest 1-sigma{of})")
}

fn clock_line(clock: &ClockReport) -> String {
    let from = match clock.source {
        ClockSource::Gyroscopes => "gyroscopes",
        ClockSource::Session => "the session's twists alone",
        ClockSource::Bag => "the one offset in the bag",
    };
    let mut line = format!("from {from}");
    // An offset alone has no rate.
    if clock.source != ClockSource::Bag {
        let _ = write!(
            line,
            ": {:.3} ppm ± {:.3}",
            clock.skew_ppm, clock.skew_sigma_ppm
        );
    }
    match clock.sigma_us {
        Some([least, most]) => {
            let _ = write!(line, ", 1-sigma {least:.1} to {most:.1} µs");
        }
        None => line.push_str(", 1-sigma not known"),
    }
    if let Some(residual) = clock.residual_us {
        let (used, windows) = (clock.used, clock.windows);
        let _ = write!(
            line,
            ", residual {residual:.1} µs, {used} of {windows} windows"
        );
    }
    if let Some(exchanges) = clock.exchanges {
        let _ = write!(line, "; {exchanges} exchanges with its clock");
    }
    line
}

/// Describes all depth frames of the file: the number on a pulse, and the numbers of others.
fn depth_line(depth: &DepthReport) -> String {
    let mut line = format!("{}: {} on a pulse", depth.frames, depth.matched);
    let others = [
        (depth.before_first_pulse, "before the first pulse"),
        (
            depth.after_last_pulse,
            "after the last pulse, by the camera's own clock",
        ),
        (depth.doubled.len(), "doubled"),
        (depth.off_pulse.len(), "off any pulse"),
        (unassigned(depth), "not matched"),
    ];
    for (count, what) in others.into_iter().filter(|&(count, _)| count > 0) {
        let _ = write!(line, ", {count} {what}");
    }
    line
}

/// Describes the histogram, and the number of pairs outside of it.
fn pairs_caption(pairs: &PairsReport) -> String {
    let mut caption = String::from(
        "Middle of exposure of the depth image minus that of the phone's frame it is paired \
         with, both in board time.",
    );
    let shown: u64 = pairs.central.counts.iter().sum();
    let outside = (pairs.spread.count as u64).saturating_sub(shown);
    if outside > 0 {
        let [least, most] = pairs.spread.range_ns.map(|ns| ns as f64 / 1e6);
        let _ = write!(
            caption,
            " {outside} of {} pairs are further off than is shown ({least:.3} to {most:.3} ms \
             in all), as pairs are before the trigger has arrived on the phone's frames.",
            pairs.spread.count
        );
    }
    caption
}

/// Returns the number of depth frames in no class.
fn unassigned(depth: &DepthReport) -> usize {
    let known = depth.matched
        + depth.before_first_pulse
        + depth.after_last_pulse
        + depth.doubled.len()
        + depth.off_pulse.len();
    depth.frames.saturating_sub(known)
}

/// Describes the course of depth − phone, whose median is that of the pairs.
fn drift_line(grid: &TriggerOffset) -> String {
    format!(
        "drifting by {:+.1} µs/min, scatter {:.1} µs, {} pulses",
        grid.drift_us_per_min, grid.residual_us, grid.pulses
    )
}

fn other_phone_line(other: &OtherReport) -> String {
    let mut line = other.name.clone();
    if let Some(phone) = &other.phone {
        let _ = write!(
            line,
            ": {} timestamps, {} images, {} IMU rows",
            phone.timestamps, phone.images, phone.imu_rows
        );
    }
    if let Some(clock) = &other.clock {
        let _ = write!(line, "; clock {}", clock_line(clock));
    }
    if let Some(grid) = &other.grid {
        let (offset, drift) = (grid.offset_us, drift_line(grid));
        let _ = write!(
            line,
            "; depth − phone {offset:+.1} µs at the first pulse, {drift}"
        );
    }
    line
}
