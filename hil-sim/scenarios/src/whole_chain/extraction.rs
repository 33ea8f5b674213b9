//! Extraction: every timestamp of the data set against the ground truth.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use serde::Serialize;

use super::Recorded;
use crate::programs::{Programs, ask};
use recording::session_file::Span;
use rig::clocks::oscillator::Oscillator;
use rig::depth_camera::{FrameRecord, Source};
use rig::phone::VideoTruth;

/// Largest error of a phone frame's time, µs, where the profile was given the delays of the phone:
/// four stated sigmas of what a hand's twist gives.
const PHONE_LIMIT_US: f64 = 25.0;
/// The same where the LED has measured them: four of what one session's LED and twist give.
const MEASURED_LIMIT_US: f64 = 100.0;
/// Largest error of a depth frame's time, µs; its clock ticks at 11.1 µs.
pub const DEPTH_LIMIT_US: f64 = 6.0;
/// Two frames further apart than this are not pair, ns: half a frame.
const PAIR_NS: i64 = 16_665_000;
/// So near to the ends of the aligned span, ns, a pair may be inside or outside.
const SPAN_MARGIN_NS: i64 = 1_000_000;

/// Errors of many timestamps, µs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Errors {
    /// Their number.
    pub count: usize,
    /// Root mean square.
    pub rms_us: f64,
    /// Largest.
    pub largest_us: f64,
}

impl Errors {
    /// In a line.
    #[must_use]
    pub fn line(&self) -> String {
        let (count, rms, most) = (self.count, self.rms_us, self.largest_us);
        format!("{count} frames, rms {rms:.2} µs, at most {most:.2} µs from the ground truth")
    }

    pub(super) fn from_pairs(pairs: impl Iterator<Item = (i64, i64)>) -> Self {
        let mut out = Self::default();
        let mut squares = 0.0;
        for (found, truth) in pairs {
            let error = (found - truth) as f64 * 1e-3;
            out.count += 1;
            squares += error * error;
            out.largest_us = out.largest_us.max(error.abs());
        }
        out.rms_us = (squares / out.count.max(1) as f64).sqrt();
        out
    }
}

/// The figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExtractionFigures {
    /// Seconds of board time that were recorded.
    pub recorded_s: f64,
    /// Starts of exposure of the phone's frames.
    pub phone_start: Errors,
    /// Middles of exposure of their middle rows.
    pub phone_middle: Errors,
    /// Largest 1-sigma that the report states for the phone's times, µs.
    pub phone_sigma_us: f64,
    /// Largest error of a phone's time that is good, µs.
    pub phone_limit_us: f64,
    /// Centres of exposure of the depth frames.
    pub depth: Errors,
    /// Pairs, all of which were the true ones.
    pub pairs: usize,
    /// Dropped depth frames, all of which were named.
    pub dropped: usize,
    /// Frames of the camera's own clock, after the pulses had ended.
    pub free_running: usize,
}

impl ExtractionFigures {
    /// Returns true if all errors are within the limits.
    #[must_use]
    pub fn good(&self) -> bool {
        self.phone_start.largest_us <= self.phone_limit_us
            && self.phone_middle.largest_us <= self.phone_limit_us
            && self.depth.largest_us <= DEPTH_LIMIT_US
    }

    /// As text.
    #[must_use]
    pub fn table(&self) -> String {
        let row = |name: &str, e: &Errors, limit: f64| {
            format!("{name:<34} {} (limit {limit} µs)\n", e.line())
        };
        format!(
            "Simulated, whole chain, {:.0} s recorded\n{}{}{}\
             {:<34} at most {:.2} µs (1 σ)\n\
             {:<34} {}, all right\n\
             {:<34} {}, all named\n",
            self.recorded_s,
            row(
                "phone, start of exposure",
                &self.phone_start,
                self.phone_limit_us
            ),
            row(
                "phone, middle of exposure",
                &self.phone_middle,
                self.phone_limit_us
            ),
            row("depth, centre of exposure", &self.depth, DEPTH_LIMIT_US),
            "stated for the phone",
            self.phone_sigma_us,
            "pairs",
            self.pairs,
            "dropped depth frames",
            self.dropped,
        )
    }
}

/// Extracts a recording, and compares.
///
/// # Errors
///
/// The program fails; or a frame has a wrong pulse, a pair is wrong, a dropped frame
/// is not named or one is named that was not dropped.
pub fn extracted(recorded: &Recorded, programs: &Programs) -> Result<ExtractionFigures> {
    let data = recorded.folder.with_file_name("data");
    let phone = recorded.phone.to_string_lossy().into_owned();
    let data_text = data.to_string_lossy().into_owned();
    let report = ask(
        programs,
        &["extract", "--phone", &phone, "--out", &data_text],
        &[&recorded.folder],
    )?;
    judge(recorded, &data, &report)
}

/// Columns of a CSV table as integers; empty cells are `None`.
pub(crate) fn table(path: &Path, columns: &[usize]) -> Result<Vec<Vec<Option<i64>>>> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(text
        .lines()
        .skip(1)
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            let cell = |column: &usize| cells.get(*column).and_then(|c| c.parse().ok());
            columns.iter().map(cell).collect()
        })
        .collect())
}

pub(super) fn whole(cell: Option<i64>) -> Result<i64> {
    cell.context("an empty cell where a time was expected")
}

/// Compares a data set with the ground truth of its recording; `report` is what the extraction
/// printed.
///
/// # Errors
///
/// As [`extracted`].
pub(crate) fn judge(
    recorded: &Recorded,
    data: &Path,
    report: &serde_json::Value,
) -> Result<ExtractionFigures> {
    // The phone.
    let video = recorded.truth.videos.last().context("no video")?;
    let table_of_frames = data.join("phone_frames.csv");
    let (starts, middles) = phone_frames(recorded, &recorded.truth.phone, video, &table_of_frames)?;

    // The depth camera.
    if let Some(why) = report["depth"]["not_matched"].as_str() {
        bail!("extract does not say which pulse made which depth frame: {why}");
    }
    let (depth, center_of, rows, free_running) = depth_frames(recorded, data)?;
    let dropped = dropped_frames(recorded, |frame| pulse_of(recorded, frame), report)?;
    let span = recorded.session.recorded.map(|Span { from, to }| {
        [from, to].map(|at| i64::try_from(at.as_nanos()).unwrap_or(i64::MAX))
    });
    let pairs = check_pairs(data, &middles, &center_of, &rows, span)?;
    Ok(ExtractionFigures {
        recorded_s: recorded
            .session
            .recorded
            .map_or(0.0, |span| (span.to - span.from).as_secs_f64()),
        phone_start: Errors::from_pairs(starts.into_iter()),
        phone_middle: Errors::from_pairs(middles.into_iter()),
        phone_limit_us: match recorded.session.profile.phone.measured {
            Some(_) => MEASURED_LIMIT_US,
            None => PHONE_LIMIT_US,
        },
        phone_sigma_us: report["clock"]["sigma_us"][1]
            .as_f64()
            .context("the report states no uncertainty of the phone's times")?,
        free_running,
        depth: Errors::from_pairs(depth.into_iter()),
        pairs,
        dropped,
    })
}

/// Times as extracted, each with the true one, ns of board time.
pub(super) type Times = Vec<(i64, i64)>;

/// Starts of exposure of a phone's frames and middles of exposure of their middle
/// rows, as its table has them.
pub(super) fn phone_frames(
    recorded: &Recorded,
    phone: &Oscillator,
    video: &VideoTruth,
    frames: &Path,
) -> Result<(Times, Times)> {
    let rows = table(frames, &[2, 3, 4])?;
    let count = video.count.context("the video has no end")?;
    // The second timestamp of a frame that the app received twice is left out.
    let numbers = video.frames.delivered_of(count).into_iter();
    let mut recorded_frames: Vec<(i64, usize)> = (0..).zip(numbers).collect();
    recorded_frames.dedup_by_key(|(_, n)| *n);
    ensure!(
        rows.len() == recorded_frames.len(),
        "{} phone frames were extracted, {} were recorded",
        rows.len(),
        recorded_frames.len()
    );
    let (mut starts, mut middles) = (Vec::new(), Vec::new());
    for ((image, n), row) in recorded_frames.into_iter().zip(&rows) {
        ensure!(
            row[2].is_none_or(|found| found == image),
            "frame {n} of the phone is image {image} of its video, but is said to be {:?}",
            row[2]
        );
        let start = recorded.nanos_of_phone(phone, video.frames.start_ns(n))?;
        let middle = recorded.nanos_of_phone(phone, video.frames.middle_ns(n))?;
        starts.push((whole(row[0])?, start));
        middles.push((whole(row[1])?, middle));
    }
    Ok((starts, middles))
}

/// Index of the pulse that made a depth frame.
fn pulse_of(recorded: &Recorded, frame: &FrameRecord) -> Option<usize> {
    match frame.source {
        Source::Pulse { edge, .. } => recorded
            .pulses
            .binary_search(&recorded.truth.timebase.ticks(edge))
            .ok(),
        Source::FreeRun => None,
    }
}

/// Times of the depth frames with a pulse, their true centres by frame, the rows of
/// the table, and how many frames the camera made by itself; every pulse is right.
#[allow(clippy::type_complexity, reason = "taken apart at once")]
pub(super) fn depth_frames(
    recorded: &Recorded,
    data: &Path,
) -> Result<(Times, BTreeMap<usize, i64>, Vec<Vec<Option<i64>>>, usize)> {
    let delivered: Vec<&FrameRecord> = recorded
        .truth
        .depth
        .iter()
        .filter(|frame| frame.delivered)
        .collect();
    let rows = table(&data.join("depth_frames.csv"), &[2, 3])?;
    ensure!(
        rows.len() == delivered.len(),
        "{} depth frames were extracted, {} were delivered",
        rows.len(),
        delivered.len()
    );
    let mut depth = Vec::new();
    let mut center_of = BTreeMap::new();
    for (index, (row, frame)) in rows.iter().zip(&delivered).enumerate() {
        let Some(pulse) = pulse_of(recorded, frame) else {
            continue;
        };
        if row[1] != i64::try_from(pulse).ok() {
            bail!(
                "depth frame {index} was made by pulse {pulse}, but is said to be of pulse {:?}",
                row[1]
            );
        }
        let (found, truth) = (whole(row[0])?, recorded.nanos(frame.center));
        depth.push((found, truth));
        center_of.insert(index, truth);
    }

    let free_running = delivered.len() - depth.len();
    Ok((depth, center_of, rows, free_running))
}

/// Number of dropped frames, if just those are named in the report.
fn dropped_frames(
    recorded: &Recorded,
    pulse_of: impl Fn(&FrameRecord) -> Option<usize>,
    report: &serde_json::Value,
) -> Result<usize> {
    let with_pulse: Vec<(usize, bool)> = recorded
        .truth
        .depth
        .iter()
        .filter_map(|frame| Some((pulse_of(frame)?, frame.delivered)))
        .collect();
    let first = with_pulse.iter().position(|f| f.1);
    let last = with_pulse.iter().rposition(|f| f.1);
    let (Some(first), Some(last)) = (first, last) else {
        bail!("the camera delivered no frame");
    };
    let expected: Vec<u64> = with_pulse[first..=last]
        .iter()
        .filter(|frame| !frame.1)
        .map(|frame| frame.0 as u64)
        .collect();
    let named: Vec<u64> = report["depth"]["missing"]
        .as_array()
        .context("the report names no missing frames")?
        .iter()
        .filter_map(serde_json::Value::as_u64)
        .collect();
    ensure!(
        named == expected,
        "dropped frames are those of pulses {expected:?}, but {named:?} are named"
    );
    Ok(expected.len())
}

/// Number of pairs, if they are the nearest frames by the ground truth, all of them.
fn check_pairs(
    data: &Path,
    middles: &[(i64, i64)],
    center_of: &BTreeMap<usize, i64>,
    depth_rows: &[Vec<Option<i64>>],
    span: Option<[i64; 2]>,
) -> Result<usize> {
    // Pairs are taken from the span in which the trigger was aligned, and no others.
    let is_inside = |at: i64, margin: i64| {
        span.is_none_or(|[from, to]| (from - margin..=to + margin).contains(&at))
    };
    let mut expected = BTreeMap::new();
    for (&index, &center) in center_of {
        let place = middles.partition_point(|m| m.1 < center - PAIR_NS);
        if let Some(middle) = middles.get(place)
            && (middle.1 - center).abs() < PAIR_NS
        {
            expected.insert(place, (index, middle.1));
        }
    }
    let rows = table(&data.join("pairs.csv"), &[0, 2])?;
    let all = expected.len();
    let mut found = 0;
    for row in &rows {
        let (phone, depth) = (whole(row[0])? as usize, whole(row[1])? as usize);
        // Frames of the camera's own clock have no exact ground truth.
        if depth_rows.get(depth).is_some_and(|r| r[1].is_none()) {
            continue;
        }
        let truth = expected.remove(&phone);
        ensure!(
            truth.is_some_and(|(index, at)| index == depth && is_inside(at, SPAN_MARGIN_NS)),
            "phone frame {phone} is paired with depth frame {depth}, its neighbour is {truth:?}, \
             and the trigger was aligned in {span:?} ns"
        );
        found += 1;
    }
    let left_out = expected
        .iter()
        .find(|(_, (_, at))| is_inside(*at, -SPAN_MARGIN_NS));
    ensure!(
        left_out.is_none(),
        "{found} pairs of {all} were found; left out is {left_out:?}, and the trigger was aligned \
         in {span:?} ns"
    );
    Ok(found)
}
