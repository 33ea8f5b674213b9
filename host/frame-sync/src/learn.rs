//! What a recording teaches about the phone's clocks: the distance of its
//! frames in its own time, and the rate of its clock against the board's.
//!
//! `video_start` reports the mean of 59 intervals; a whole recording has
//! thousands of timestamps, and a straight line through them knows the slope
//! with a 1-sigma of `σ·√12 / N^1.5` intervals: 1 µs of jitter over 5 min is
//! 0.004 ns a frame. Two twists minutes apart know the skew as well as that.

use std::path::Path;

use jiff::civil::Date;

use recording::profile::{Learnt, Profile, ProfileError};
use recording::session_file::Twist;
use timebase::ClockModel;
use timebase::PhoneNanos;

/// What crystals do from one recording to the next (temperature), relative: a
/// floor under the stated sigmas, which are those within one recording.
pub const REPEATABILITY: f64 = 2e-8;

/// The least number of frames.
const MIN_FRAMES: usize = 300;

/// The least time between two twists, s.
const MIN_BASELINE_S: f64 = 60.0;

/// Why nothing can be learnt.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LearnError {
    /// Too few frames.
    #[error("{found} timestamps are too few to learn from, expected {MIN_FRAMES} or more")]
    TooFew {
        /// How many there are.
        found: usize,
    },
    /// The timestamps are no train of frames.
    #[error("the timestamps are not those of frames: {reason}")]
    NoTrain {
        /// What is odd.
        reason: String,
    },
}

/// A frame period and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FramePeriod {
    /// ns of the phone's time.
    pub period_ns: f64,
    /// 1-sigma within this recording, ns.
    pub sigma_ns: f64,
    /// Spread of the timestamps about the line, ns.
    pub jitter_ns: f64,
    /// Frames used.
    pub frames: usize,
    /// Frames that are missing between the first and the last.
    pub missing: u64,
}

/// Fits a straight line through the timestamps of frames. Missing frames are
/// recognised by their distance; single timestamps far off the line are left out.
///
/// # Errors
///
/// Too few, or no train.
pub fn frame_period(times: &[PhoneNanos]) -> Result<FramePeriod, LearnError> {
    let odd = |reason: &str| LearnError::NoTrain {
        reason: reason.to_owned(),
    };
    if times.len() < MIN_FRAMES {
        return Err(LearnError::TooFew { found: times.len() });
    }
    let first = times.first().copied().unwrap_or_default();
    let relative: Vec<f64> = times
        .iter()
        .map(|time| (i128::from(time.0) - i128::from(first.0)) as f64)
        .collect();
    let mut steps: Vec<f64> = relative.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    let rough = steps[steps.len() / 2];
    if !(1e6..=1e9).contains(&rough) {
        return Err(odd("their distance is not within 1 ms and 1 s"));
    }
    if steps.first().is_some_and(|&least| least <= 0.0) {
        return Err(odd("they do not grow"));
    }
    // Number the frames step by step: each step is a whole number of periods.
    let mut points = vec![(0.0, 0.0)];
    let mut number = 0.0;
    for pair in relative.windows(2) {
        let step = (pair[1] - pair[0]) / rough;
        let whole = step.round().max(1.0);
        if (step - whole).abs() > 0.3 {
            return Err(odd("a distance is no multiple of the frame period"));
        }
        number += whole;
        points.push((number, pair[1]));
    }
    let missing = number as u64 + 1 - points.len() as u64;
    let mut line = fit(&points);
    for _ in 0..3 {
        let limit = 5.0 * line.spread.max(1.0);
        let kept: Vec<(f64, f64)> = points
            .iter()
            .copied()
            .filter(|&(k, t)| (t - line.at(k)).abs() <= limit)
            .collect();
        if kept.len() == points.len() {
            break;
        }
        if kept.len() < MIN_FRAMES {
            return Err(odd("they scatter too much"));
        }
        points = kept;
        line = fit(&points);
    }
    Ok(FramePeriod {
        period_ns: line.slope,
        sigma_ns: line.slope_sigma,
        jitter_ns: line.spread,
        frames: points.len(),
        missing,
    })
}

struct Line {
    slope: f64,
    slope_sigma: f64,
    mean_x: f64,
    mean_y: f64,
    spread: f64,
}

impl Line {
    fn at(&self, x: f64) -> f64 {
        self.mean_y + self.slope * (x - self.mean_x)
    }
}

/// Least squares about the means, so that large times cost no precision.
fn fit(points: &[(f64, f64)]) -> Line {
    let count = points.len() as f64;
    let mean_x = points.iter().map(|p| p.0).sum::<f64>() / count;
    let mean_y = points.iter().map(|p| p.1).sum::<f64>() / count;
    let xx: f64 = points.iter().map(|p| (p.0 - mean_x).powi(2)).sum();
    let xy: f64 = points.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum();
    let slope = xy / xx;
    let mut line = Line {
        slope,
        slope_sigma: 0.0,
        mean_x,
        mean_y,
        spread: 0.0,
    };
    let squares: f64 = points.iter().map(|p| (p.1 - line.at(p.0)).powi(2)).sum();
    line.spread = (squares / (count - 2.0)).sqrt();
    line.slope_sigma = line.spread / xx.sqrt();
    line
}

/// What a session teaches, with the floor for what changes between recordings.
/// The skew only from two twists that are at least a minute apart, and within one
/// run of the board: `resets` is how often it was reset within the recording.
#[must_use]
pub fn learnt(
    (twists, clock): (&[Twist], Option<ClockModel>),
    resets: usize,
    board_id: Option<&str>,
    period: &FramePeriod,
    date: Date,
) -> Learnt {
    let accepted: Vec<f64> = twists
        .iter()
        .filter_map(|twist| twist.clock.map(|clock| clock.reference.0))
        .collect();
    let baseline = match (accepted.first(), accepted.last()) {
        (Some(first), Some(last)) => last - first,
        _ => 0.0,
    };
    // Over a reset the two twists are of different runs.
    let clock = clock.filter(|_| resets == 0 && baseline >= MIN_BASELINE_S);
    let floor_ns = REPEATABILITY * period.period_ns;
    Learnt {
        frame_period_ns: period.period_ns,
        frame_period_sigma_ns: period.sigma_ns.hypot(floor_ns),
        skew: clock.map(|clock| clock.skew),
        skew_sigma: clock.map(|clock| clock.covariance[1][1].max(0.0).sqrt().hypot(REPEATABILITY)),
        learnt: date,
        board_id: board_id.map(str::to_owned),
    }
}

/// Puts what was learnt into a profile's text; comments and order stay. `name` is
/// that of the phone; without it, it is `[phone]`.
///
/// # Errors
///
/// The text is no valid profile, or would not be one any more.
pub fn into_profile(
    text: &str,
    path: &Path,
    name: Option<&str>,
    learnt: &Learnt,
) -> Result<String, ProfileError> {
    let syntax = |reason: String| ProfileError::Syntax {
        path: Some(path.to_owned()),
        reason,
    };
    let profile = Profile::parse(text, Some(path))?;
    let mut document: toml_edit::DocumentMut = text
        .parse()
        .map_err(|error: toml_edit::TomlError| syntax(error.to_string()))?;
    // One phone is meant whatever it was called at the time.
    let name = name.filter(|_| !profile.phones.is_empty());
    let is_it = |table: &toml_edit::Table| table.get("name").and_then(|name| name.as_str()) == name;
    let further = document
        .get_mut("phones")
        .and_then(|phones| phones.as_array_of_tables_mut())
        .filter(|_| name.is_some())
        .and_then(|phones| phones.iter_mut().find(|table| is_it(table)));
    let phone = match further {
        Some(table) => table,
        None => document
            .entry("phone")
            .or_insert(toml_edit::table())
            .as_table_mut()
            .ok_or_else(|| syntax(String::from("`phone` is no table")))?,
    };
    let mut table = toml_edit::Table::new();
    table.insert("frame_period_ns", toml_edit::value(learnt.frame_period_ns));
    table.insert(
        "frame_period_sigma_ns",
        toml_edit::value(learnt.frame_period_sigma_ns),
    );
    if let (Some(skew), Some(sigma)) = (learnt.skew, learnt.skew_sigma) {
        table.insert("skew", toml_edit::value(skew));
        table.insert("skew_sigma", toml_edit::value(sigma));
    }
    table.insert("learnt", toml_edit::value(learnt.learnt.to_string()));
    if let Some(id) = &learnt.board_id {
        table.insert("board_id", toml_edit::value(id.as_str()));
    }
    phone.insert("learnt", toml_edit::Item::Table(table));
    let text = document.to_string();
    Profile::parse(&text, Some(path))?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;

    use super::*;
    use recording::profile::DEFAULT;
    use timebase::BoardSeconds;
    use timebase::Wander;

    /// Frames of 33,330,652.54 ns with a deterministic jitter of about 1 µs.
    fn frames(count: usize) -> Vec<PhoneNanos> {
        let mut state = 1_u64;
        (0..count)
            .map(|k| {
                // Sum of four uniforms: nearly normal, sigma 1.15 · 0.866 µs.
                let mut jitter = 0.0;
                for _ in 0..4 {
                    state = state
                        .wrapping_mul(6_364_136_223_846_793_005)
                        .wrapping_add(1);
                    jitter += (state >> 40) as f64 / 16_777_216.0 - 0.5;
                }
                let time = 900_000e9 + k as f64 * 33_330_652.54 + jitter * 1_732.0;
                PhoneNanos(time.round() as i64)
            })
            .collect()
    }

    #[test]
    fn five_minutes_know_the_period_to_a_hundredth_of_a_nanosecond() {
        let learnt = frame_period(&frames(9_000)).unwrap();
        let error = learnt.period_ns - 33_330_652.54;
        assert!(learnt.sigma_ns < 0.006, "{learnt:?}");
        assert!(error.abs() < 4.0 * learnt.sigma_ns, "{error} {learnt:?}");
        assert!((learnt.jitter_ns - 1_000.0).abs() < 50.0, "{learnt:?}");
    }

    #[test]
    fn missing_frames_and_single_wrong_timestamps_do_no_harm() {
        let mut times = frames(3_000);
        times[700].0 += 4_000_000;
        times.drain(1_000..1_007);
        times.remove(2_000);
        let learnt = frame_period(&times).unwrap();
        assert_eq!(learnt.missing, 8);
        assert_eq!(learnt.frames, times.len() - 1);
        assert!(
            (learnt.period_ns - 33_330_652.54).abs() < 0.15,
            "{learnt:?}"
        );
    }

    #[test]
    fn what_is_no_train_is_told() {
        assert_eq!(
            frame_period(&frames(10)),
            Err(LearnError::TooFew { found: 10 })
        );
        let mut backwards = frames(400);
        backwards.reverse();
        assert!(matches!(
            frame_period(&backwards),
            Err(LearnError::NoTrain { .. })
        ));
        let mut shifted = frames(400);
        for time in &mut shifted[200..] {
            time.0 += 15_000_000;
        }
        assert!(matches!(
            frame_period(&shifted),
            Err(LearnError::NoTrain { .. })
        ));
    }

    #[test]
    fn a_profile_keeps_its_comments_and_can_be_read_again() {
        let clock = |reference| ClockModel {
            reference: BoardSeconds(reference),
            offset: 1.0,
            skew: 3e-6,
            covariance: [[1e-12, 0.0], [0.0, 1e-18]],
            wander: Wander(1e-8),
        };
        let twist = |reference| Twist {
            phone_gyro: None,
            span: recording::session_file::Span {
                from: Default::default(),
                to: Default::default(),
            },
            accepted: true,
            clock: Some(clock(reference)),
            offset_sigma_us: None,
            skew_sigma_ppm: None,
            report: serde_json::Value::Null,
        };
        let mut twists = vec![twist(10.0)];
        let period = frame_period(&frames(9_000)).unwrap();
        let last = Some(clock(300.0));
        let learnt_over = |twists: &[Twist], resets| {
            learnt((twists, last), resets, None, &period, date(2026, 1, 31))
        };
        let learnt = |twists: &[Twist]| learnt_over(twists, 0);
        let one_twist = learnt(&twists);
        assert_eq!(one_twist.skew, None);
        twists.push(twist(300.0));
        let two_twists = learnt(&twists);
        assert_eq!(two_twists.skew, Some(3e-6));
        assert!(two_twists.skew_sigma.unwrap() >= REPEATABILITY);
        // The board was reset between them.
        assert_eq!(learnt_over(&twists, 1).skew, None);

        let path = Path::new("rig.toml");
        let text = into_profile(DEFAULT, path, None, &two_twists).unwrap();
        assert!(text.contains("# Where the app (OpenCamera Sensors) listens"));
        let profile = Profile::parse(&text, None).unwrap();
        assert_eq!(profile.phone.learnt, Some(two_twists));
        // A second time replaces the first.
        let again = into_profile(&text, path, Some("phone"), &one_twist).unwrap();
        assert_eq!(
            Profile::parse(&again, None).unwrap().phone.learnt,
            Some(one_twist.clone())
        );
        // Of several phones the one of that name learns.
        let several = format!("{text}\n[[phones]]\nname = \"right\"\naddress = \"x\"\n");
        let taught = into_profile(&several, path, Some("right"), &one_twist).unwrap();
        let profile = Profile::parse(&taught, None).unwrap();
        assert_eq!(profile.phones[0].learnt, Some(one_twist));
        assert!(profile.phone.learnt.unwrap().skew.is_some());
    }
}
