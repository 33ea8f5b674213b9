//! Period of a phone's frames in its own time, from what earlier recordings have shown and what
//! the app reports of the current video.

mod period;

pub use period::{FramePeriod, TrainError, frame_period};

use serde::{Deserialize, Serialize};

use crate::rates::CONSISTENT_SIGMAS;

/// 1-sigma of the timestamp of one of the phone's frames, ns, until a recording has measured it.
/// Qualcomm's older drivers read the clock in an interrupt handler (`msm_isp_get_timestamp`), the
/// newer ones latch it in hardware to 52 ns (`cam_ife_csid`), and the app does not report which. A
/// handler of Linux on ARM runs some 10 µs after its edge; half of that is assumed to be scatter.
const FRAME_JITTER_NS: f64 = 5_000.0;

/// Number of intervals whose mean `video_start` reports.
const INTERVALS: f64 = 59.0;

/// 1-sigma of the change of a frame's duration per ms of exposure, ns: some phones lengthen
/// their frames. A guess.
const PERIOD_OF_EXPOSURE_NS_PER_MS: f64 = 100.0;

/// Drift caused by a changed exposure from which on the user is warned, µs/min.
const WARNED_DRIFT_US_PER_MIN: f64 = 5.0;

/// Largest relative difference of the trigger's period from that of the depth camera's mode.
/// Phones are off by some 0.1 %; a camera that is driven at another rate makes no
/// frames, and at a thousand a second may come to harm.
pub(crate) const NEAR_MODE: f64 = 0.1;

/// Largest number of lost or doubled frames among the first 60. With more, the phone is probably in
/// another mode, which is refused.
const MOST_ODD_FRAMES: f64 = NEAR_MODE * INTERVALS;

/// Largest distance of the span of the first frames from a whole number of periods, in periods:
/// phones are off by less than half a percent.
const WHOLE: f64 = 0.35;

/// Frame period of a phone as measured in an earlier recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearntFrames {
    /// Distance of frames in the phone's time, ns.
    pub period_ns: f64,
    /// 1-sigma of the period, ns.
    pub sigma_ns: f64,
    /// 1-sigma of the timestamps of single frames, ns, if it was measured.
    pub jitter_ns: Option<f64>,
    /// Exposure of that recording, µs, if it was reported.
    pub exposure_us: Option<f64>,
}

/// The phone's frames as far as they are known when the trigger is aligned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Frames {
    /// Distance of phone frames in the phone's time, ns.
    pub period_ns: f64,
    /// 1-sigma of the period, ns, if it is known.
    pub sigma_ns: Option<f64>,
    /// Assumed 1-sigma of the timestamp of one frame, ns, if one was assumed.
    pub jitter_ns: Option<f64>,
    /// Source of the period: `learnt` or `video_start`.
    pub source: FramePeriodSource,
}

/// Source of a frame period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FramePeriodSource {
    /// An earlier recording, by way of the profile.
    #[default]
    Learnt,
    /// The answer to `video_start`.
    VideoStart,
}

/// Remark on a frame period, for the user.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FramesRemark {
    /// No earlier recording has measured the period.
    #[error(
        "no frame period learnt yet: the phase may drift by hundreds of µs a minute \
         (`smartdepthsync profile learn`)"
    )]
    NotLearnt,
    /// The learnt period contradicts the report.
    #[error(
        "the learnt frame period of {learnt_ns} ns does not fit the {reported_ns} ns that the \
         phone reports now (another mode?); the reported one is used"
    )]
    Contradicted {
        /// Learnt period, ns.
        learnt_ns: f64,
        /// Reported period, ns.
        reported_ns: f64,
    },
    /// The exposure is not that with which the period was learnt.
    #[error(
        "the exposure is {:.1} ms, the frame period was learnt with {:.1} ms and may follow it: the \
         phase may drift by {drift_us_per_min:.0} µs a minute; lock the exposure in the app's \
         settings",
        now_us * 1e-3,
        learnt_us * 1e-3
    )]
    OtherExposure {
        /// Exposure at present, µs.
        now_us: f64,
        /// Exposure of the recording that measured the period, µs.
        learnt_us: f64,
        /// 1-sigma of the drift that may follow, µs/min.
        drift_us_per_min: f64,
    },
    /// Frames were lost or doubled among the first 60, and the reported mean is corrected for it.
    #[error(
        "{} of the phone's first 60 frames were {}: the {reported_ns} ns that it reports are the \
         mean of {periods} periods over {INTERVALS}",
        (periods - INTERVALS).abs(),
        if *periods > INTERVALS { "lost" } else { "doubled" }
    )]
    OddFrames {
        /// Reported mean, ns.
        reported_ns: f64,
        /// Number of periods in the span of the 60 frames.
        periods: f64,
    },
}

/// 1-sigma of the mean frame duration that `video_start` reports, ns: the mean of 59
/// intervals whose ends have that jitter.
fn reported_sigma_ns(jitter_ns: f64) -> f64 {
    std::f64::consts::SQRT_2 * jitter_ns / INTERVALS
}

impl Frames {
    /// Combines a learnt frame period with the mean duration that `video_start` reports, by their
    /// variances. Without a learnt period, or with one that contradicts the report, the report is
    /// used alone. `exposure_us` is the exposure of the current video, if the app reports it.
    #[must_use]
    pub fn known(
        learnt: Option<&LearntFrames>,
        reported_ns: f64,
        exposure_us: Option<f64>,
    ) -> (Self, Vec<FramesRemark>) {
        let (reported, odd_frames) = corrected(learnt, reported_ns);
        let mut remarks = Vec::from_iter(odd_frames);
        let jitter_ns = learnt.and_then(|learnt| learnt.jitter_ns);
        let jitter_ns = jitter_ns.unwrap_or(FRAME_JITTER_NS);
        let reported_sigma = reported_sigma_ns(jitter_ns);
        let as_reported = Self {
            period_ns: reported,
            sigma_ns: Some(reported_sigma),
            jitter_ns: Some(jitter_ns),
            source: FramePeriodSource::VideoStart,
        };
        let Some(learnt) = learnt else {
            remarks.push(FramesRemark::NotLearnt);
            return (as_reported, remarks);
        };
        let exposures = learnt.exposure_us.zip(exposure_us);
        let by_exposure = exposures.map_or(0.0, |(then, now)| {
            PERIOD_OF_EXPOSURE_NS_PER_MS * 1e-3 * (now - then)
        });
        let learnt_sigma = learnt.sigma_ns.hypot(by_exposure);
        let sigma = learnt_sigma.hypot(reported_sigma);
        if (learnt.period_ns - reported).abs() > CONSISTENT_SIGMAS * sigma {
            remarks.push(FramesRemark::Contradicted {
                learnt_ns: learnt.period_ns,
                reported_ns: reported,
            });
            return (as_reported, remarks);
        }
        let of_reported = (learnt_sigma / sigma).powi(2);
        let sigma_ns = learnt_sigma * reported_sigma / sigma;
        let drift_us_per_min = sigma_ns / learnt.period_ns * 60e6;
        if let Some((learnt_us, now_us)) = exposures
            && drift_us_per_min > WARNED_DRIFT_US_PER_MIN
            && by_exposure.abs() > learnt.sigma_ns
        {
            remarks.push(FramesRemark::OtherExposure {
                now_us,
                learnt_us,
                drift_us_per_min,
            });
        }
        let combined = Self {
            period_ns: learnt.period_ns + of_reported * (reported - learnt.period_ns),
            sigma_ns: Some(sigma_ns),
            jitter_ns: Some(jitter_ns),
            source: FramePeriodSource::Learnt,
        };
        (combined, remarks)
    }

    /// 1-sigma of the timestamp of one frame, ns.
    pub(crate) fn jitter_ns(&self) -> f64 {
        self.jitter_ns.unwrap_or(FRAME_JITTER_NS)
    }

    /// 1-sigma of the frame period as a part of it.
    pub(crate) fn relative_sigma(&self) -> f64 {
        let reported_ns = || reported_sigma_ns(self.jitter_ns());
        self.sigma_ns.unwrap_or_else(reported_ns) / self.period_ns
    }
}

/// The mean frame duration that the phone reports, corrected for frames that were lost or
/// doubled among the first 60: their span still is a whole number of periods.
fn corrected(learnt: Option<&LearntFrames>, reported: f64) -> (f64, Option<FramesRemark>) {
    let about = learnt.map_or(1e9 / 30.0, |learnt| learnt.period_ns);
    let periods = reported * INTERVALS / about;
    let whole = periods.round();
    let odd = (whole - INTERVALS).abs();
    if odd == 0.0 || odd > MOST_ODD_FRAMES || (periods - whole).abs() > WHOLE {
        return (reported, None);
    }
    let remark = FramesRemark::OddFrames {
        reported_ns: reported,
        periods: whole,
    };
    (reported * INTERVALS / whole, Some(remark))
}
