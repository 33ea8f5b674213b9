//! Why frames of a run of the board have no pulses.

use crate::depth_clock::MatchError;

/// Why a run's frames have no pulses.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum RunError {
    /// Too few to work with.
    #[error("{frames} frames and {pulses} pulses are too few")]
    TooFew {
        /// Frames.
        frames: usize,
        /// Pulses.
        pulses: usize,
    },
    /// Pulses cannot be told apart.
    #[error(
        "its place in time is known to ± {sigma_us:.0} µs only (1-sigma, with the camera's clock); below \
         {limit_us:.0} µs pulses can be told apart"
    )]
    TooCoarse {
        /// 1-sigma, µs.
        sigma_us: f64,
        /// What would do, µs.
        limit_us: f64,
    },
    /// They are not where the camera's clock says.
    #[error(
        "by the camera's clock its frames lie {off_us:+.0} µs beside the pulses, which is more than the \
         uncertainty of {sigma_us:.0} µs (1-sigma) explains"
    )]
    Beside {
        /// Frame less pulse, µs.
        off_us: f64,
        /// 1-sigma, µs.
        sigma_us: f64,
    },
    /// Too many frames have no pulse.
    #[error("only {matched} of its {frames} frames follow its pulses")]
    NotFollowing {
        /// With a pulse.
        matched: usize,
        /// All.
        frames: usize,
    },
    /// The camera's clock seems to go at another rate.
    #[error(
        "the camera's clock is {ppm:+.1} ppm off its rate in the run that was matched; that is no crystal's"
    )]
    OtherRate {
        /// Difference of the rates, ppm.
        ppm: f64,
    },
    /// The pattern of its pulses says otherwise.
    #[error(
        "the pattern of its pulses puts its frames {by:+} pulses from where the camera's clock has them"
    )]
    OtherPulse {
        /// Pulses.
        by: i64,
    },
    /// The camera follows the pulses from another one on than the first.
    #[error(
        "the camera follows its pulses {by:+} frames from where the first of them should be, so that \
         frames and pulses are off by whole periods"
    )]
    TakenUp {
        /// Frames.
        by: i64,
    },
    /// As for any recording.
    #[error(transparent)]
    Match(MatchError),
}

impl RunError {
    /// Whether it says that the match of the other run is wrong, too.
    pub(super) fn contradicts(&self) -> bool {
        matches!(
            self,
            Self::Beside { .. }
                | Self::OtherRate { .. }
                | Self::OtherPulse { .. }
                | Self::TakenUp { .. }
        )
    }

    pub(super) fn of_run(self, index: usize) -> MatchError {
        match self {
            Self::Match(error) => error,
            why => MatchError::OverReset {
                run: index + 1,
                why: Box::new(why),
            },
        }
    }
}
