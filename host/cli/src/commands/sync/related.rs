//! The relation of two recordings: of a twist as a whole, of longer ones window by window.

use twist_sync::{
    ClockCourse, ClockRelation, Estimate, GyroTrack, Options, Refusal, course_of_tracks,
    estimate_offset,
};

use crate::commands::offset::fault_text;
use session::twist_report::report_of;

/// A recording up to this length is taken as a whole, seconds: a twist.
const LONGEST_TWIST_S: f64 = 60.0;
/// So is the other one then, up to this length, seconds: memory for some 300 MB.
const LONGEST_WITH_TWIST_S: f64 = 600.0;

/// Two recordings.
pub(super) struct Related {
    /// Which, by their places in the list.
    pub(super) of: [usize; 2],
    /// The relation with times from each recording's first sample, or why there is none.
    pub(super) course: Result<ClockCourse, String>,
    pub(super) estimates: Vec<ClockRelation>,
    pub(super) windows: usize,
    pub(super) faults: Vec<String>,
    pub(super) left_out: Vec<String>,
    /// Of a twist.
    pub(super) whole: Option<Box<Whole>>,
}

/// The estimate of a twist.
pub(super) struct Whole {
    pub(super) result: Result<Estimate, Refusal>,
    pub(super) options: Options,
}

/// Relates two of the recordings, whose low-pass filters have these delays in seconds.
pub(super) fn related(of: [usize; 2], tracks: &[GyroTrack], delays: &[f64]) -> Related {
    let length_s = |track: &GyroTrack| track.t.last().copied().unwrap_or(0.0);
    let [a, b] = of.map(|k| &tracks[k]);
    let delayed = |options: Options| Options {
        a_delay_s: delays[of[0]],
        b_delay_s: delays[of[1]],
        ..options
    };
    let (short_s, long_s) = (length_s(a).min(length_s(b)), length_s(a).max(length_s(b)));
    if short_s > LONGEST_TWIST_S || long_s > LONGEST_WITH_TWIST_S {
        return over_time(of, a, b, &delayed(Options::of_windows()));
    }
    let options = delayed(Options::default());
    let result = estimate_offset(a, b, &options);
    let report = report_of(&result);
    let estimates: Vec<ClockRelation> = result.iter().map(|estimate| estimate.clock).collect();
    let course = ClockCourse::from_estimates(&estimates, options.wander);
    let names = ["the first", "the second"];
    let faults = report.faults.iter();
    Related {
        of,
        course: course.ok_or_else(|| report.failures()),
        estimates,
        windows: 1,
        faults: faults.map(|fault| fault_text(fault, names)).collect(),
        left_out: report.left_out.iter().map(ToString::to_string).collect(),
        whole: Some(Box::new(Whole { result, options })),
    }
}

fn over_time(of: [usize; 2], a: &GyroTrack, b: &GyroTrack, options: &Options) -> Related {
    let found = course_of_tracks(a, b, None, options);
    let (course, estimates, windows) = match found {
        Ok(clock) => (Ok(clock.course), clock.estimates, clock.windows),
        Err(error) => (Err(error.to_string()), Vec::new(), 0),
    };
    Related {
        of,
        course,
        estimates,
        windows,
        faults: Vec::new(),
        left_out: Vec::new(),
        whole: None,
    }
}
