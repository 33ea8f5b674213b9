//! The sentence of an event, as the recording's log and `session.json` keep it.

use clock::rates::PLANNED_S;
use std::fmt::{self, Display, Formatter};

use board::reset_cause;

use super::{Device, PhoneName, SessionEvent};

impl Display for PhoneName {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self.is_only {
            true => f.write_str("the phone"),
            false => write!(f, "phone {}", self.name),
        }
    }
}

impl Display for SessionEvent {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Phase { phase } => write!(f, "{phase:?}"),
            Self::Prompt { prompt } => write!(f, "{prompt:?}"),
            Self::StepFailed { error, .. } => write!(f, "{error}"),
            Self::Connected { folder, .. } => write!(f, "recording into {}", folder.display()),
            Self::ScaleChanged { .. } => f.write_str("the IMU was set up"),
            Self::ClockFollowed { device } => write!(f, "the clock of phone {device} is followed"),
            Self::ClockNotFollowed { reason } => {
                write!(f, "the phone's clock is not followed: {reason}")
            }
            Self::Checked { check } => f.write_str(&check.line()),
            Self::Board { message, .. } => write!(f, "{message:?}"),
            Self::Disk { free, .. } => write!(f, "{} MB are free", free / 1_000_000),
            Self::Lost { stream, count } => write!(f, "{count} {stream} lost on the link"),
            Self::Damaged { reason } => f.write_str(reason),
            Self::Hello => f.write_str("the board said hello"),
            Self::TimeOdd { odd } => write!(
                f,
                "a message of the board has the time {:.3} s, far from all others; it is recorded \
                 as it came, and further ones are not reported",
                odd.as_secs_f64()
            ),
            Self::Found { finding } => f.write_str(&finding.text),
            Self::DiskNearlyFull { free } => {
                write!(
                    f,
                    "the disk is nearly full: {} MB are left",
                    free / 1_000_000
                )
            }
            Self::Failed { error }
            | Self::SecondTwistFailed { error }
            | Self::VideoNotFetched { error } => f.write_str(error),
            Self::Ended { outcome, .. } => write!(f, "{outcome:?}"),
            Self::BoardReset { cause, last } => write!(
                f,
                "the board was reset ({}) after {:.3} s of its time: the recording ends there",
                reset_cause(*cause),
                last.as_secs_f64()
            ),
            Self::LinkLost { reason, patience_s } => {
                f.write_str(reason)?;
                patience_s.map_or(Ok(()), |wait| {
                    write!(f, "; waiting for it, {wait} s at most")
                })
            }
            Self::LinkBack { away_s } => {
                write!(f, "the link is back after {away_s:.3} s of board time")
            }
            Self::BoardQuiet { seconds, damaged } => write!(
                f,
                "no message came from the board for {seconds} s; {damaged} damaged frames came so \
                 far"
            ),
            Self::TwistDueIn { .. }
            | Self::TwistStarted { .. }
            | Self::TwistFinished { .. }
            | Self::TwistRemark { .. }
            | Self::TwistAccepted(_)
            | Self::TwistRefused { .. }
            | Self::TwistsContradict { .. }
            | Self::TwistsJoined { .. }
            | Self::LearntSkewUnfit { .. }
            | Self::SecondTwistLeftOut
            | Self::SecondTwistJoined { .. }
            | Self::ClockKnown { .. }
            | Self::TwistDue { .. }
            | Self::Tracked { .. }
            | Self::TrackLost
            | Self::TrackBack => self.write_of_clocks(f),
            _ => self.write_of_devices(f),
        }
    }
}

impl SessionEvent {
    fn write_of_clocks(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::TwistDueIn { seconds } => {
                write!(f, "the next twist begins in {seconds:.0} s")
            }
            Self::TwistStarted {
                number, length_s, ..
            } => write!(f, "twist {number}: twist now, for {length_s} s"),
            Self::TwistFinished { number } => write!(f, "twist {number} is complete"),
            Self::TwistRemark {
                number,
                phone,
                remark,
            } => write!(f, "twist {number}{}: {remark}", phone.suffix()),
            Self::TwistAccepted(estimate) => {
                let clock = &estimate.clock;
                write!(
                    f,
                    "twist {}{}: offset {:.6} s ± {:.2} µs, skew {:+.3} ± {:.3} ppm",
                    estimate.number,
                    estimate.phone.suffix(),
                    clock.offset,
                    clock.covariance[0][0].max(0.0).sqrt() * 1e6,
                    clock.skew * 1e6,
                    clock.covariance[1][1].max(0.0).sqrt() * 1e6
                )
            }
            Self::TwistRefused {
                number,
                phone,
                reason,
            } => write!(f, "twist {number}{} refused: {reason}", phone.suffix()),
            Self::TwistsContradict { phone } => write!(
                f,
                "this twist contradicts the earlier ones{}: it alone is used",
                phone.suffix()
            ),
            Self::TwistsJoined {
                phone,
                clock,
                change,
            } => write!(
                f,
                "twists so far{}: skew {:+.4} ± {:.4} ppm, changing by {:+.3} ± {:.3} ppm/min",
                phone.suffix(),
                clock.skew * 1e6,
                clock.covariance[1][1].max(0.0).sqrt() * 1e6,
                change.per_s * 60e6,
                change.variance.max(0.0).sqrt() * 60e6
            ),
            Self::LearntSkewUnfit {
                learnt_ppm,
                sigma_ppm,
                found_ppm,
            } => write!(
                f,
                "the learnt skew of {learnt_ppm:+.3} ± {sigma_ppm:.3} ppm does not fit this \
                 twist's {found_ppm:+.3} ppm; it is not used"
            ),
            Self::SecondTwistLeftOut => f.write_str("the second twist was left out"),
            Self::SecondTwistJoined { phone, clock } => write!(
                f,
                "both twists{}: skew {:+.4} ± {:.4} ppm",
                phone.suffix(),
                clock.skew * 1e6,
                clock.covariance[1][1].max(0.0).sqrt() * 1e6
            ),
            Self::ClockKnown { phone, clock, .. } => {
                write!(f, "{phone}: offset {:.6} s", clock.offset)
            }
            Self::TwistDue { limit_us } => write!(
                f,
                "time for another twist: clocks wander and rigs warm up, and the phase is not \
                 known to {limit_us:.0} µs (1-sigma) any more; stop, and record again when it \
                 matters"
            ),
            Self::TrackLost => f.write_str(
                "the phone's clock cannot be read any more: the trigger's period stays, and the \
                 phase drifts as without tracking; check the phone's cable and `adb devices`",
            ),
            Self::TrackBack => f.write_str("the phone's clock is followed again"),
            other => write!(f, "{other:?}"),
        }
    }

    fn write_of_devices(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::RecorderStarted => f.write_str("the depth recorder runs"),
            Self::RecorderGone { end } => write!(
                f,
                "the depth recorder `{}` ended by itself ({}); its output is in \
                 depth_recorder.log",
                end.program, end.status
            ),
            Self::RecorderFailed { end } => {
                write!(
                    f,
                    "the depth recorder `{}` ended with {}",
                    end.program, end.status
                )
            }
            Self::RecorderKilled { program, waited_s } => write!(
                f,
                "the depth recorder `{program}` did not stop within {waited_s} s and was killed; \
                 its file may be incomplete"
            ),
            Self::TriggerStarted { period_s } => {
                write!(
                    f,
                    "the trigger runs with a period of {:.6} ms",
                    period_s * 1e3
                )
            }
            Self::VideoStarted { phone, video } => {
                let exposure = video
                    .exposure_ns
                    .map_or(String::from("not reported"), |ns| {
                        format!("{:.3} ms", ns as f64 * 1e-6)
                    });
                write!(
                    f,
                    "{phone} records: frame period {:.3} ns, exposure {exposure}",
                    video.frame_duration_ns
                )
            }
            Self::VideoUndone { phone, error: None } => write!(f, "{phone} was asked to stop"),
            Self::VideoUndone {
                phone,
                error: Some(error),
            } => write!(f, "a video may run on {phone}: {error}"),
            Self::VideoEnded { phone } => write!(
                f,
                "the video of {phone} has ended: it was stopped by hand, or its app was in the \
                 background"
            ),
            Self::PhoneAway { phone, error } => {
                write!(f, "whether {phone} records is not known: {error}")
            }
            Self::PhoneBack { phone } => write!(f, "{phone} still records"),
            Self::PhoneLeftOut { phone } => write!(f, "phone {} records no video", phone.name),
            Self::AlignmentRemark { remark } => f.write_str(remark),
            Self::Aligning {
                shift_us,
                frames,
                alignment,
            } => write!(
                f,
                "aligning: {shift_us:+.1} µs over {frames} frames; {}, drift ± {:.1} µs/min over \
                 {:.0} min",
                alignment.promise(),
                alignment.drift_sigma_us_per_min,
                PLANNED_S / 60.0
            ),
            Self::Arrived {
                name,
                pulse,
                remaining,
                ..
            } => write!(
                f,
                "{name} arrived at pulse {pulse}, {remaining} ticks from its grid"
            ),
            Self::ArrivalUnconfirmed => {
                f.write_str("the board did not report the arrival, but its train runs on the grid")
            }
            Self::Placed { phone, placement } => write!(f, "phone {}: {placement}", phone.name),
            Self::OutputStarted { name, output, rule } => {
                write!(f, "{name} on output {output} runs: {rule} of the trigger")
            }
            Self::LidarStarted { name, utc_at_zero } => {
                write!(f, "UTC for {name} is board time {utc_at_zero:+} s")
            }
            Self::RecordingStarted { length_s } => match length_s {
                Some(length) => write!(f, "recording for {length:.0} s"),
                None => f.write_str("recording"),
            },
            Self::Marked { label, .. } => write!(f, "mark: {label}"),
            Self::StopRetried {
                phone,
                error,
                patience_s,
            } => write!(
                f,
                "the video of {phone} is not stopped yet: {error}; trying for {patience_s} s"
            ),
            Self::NotStopped { what, error } => match what {
                Device::Trigger => write!(f, "the trigger could not be stopped: {error}"),
                Device::Output => write!(f, "an auxiliary output could not be stopped: {error}"),
                Device::Video(Some(phone)) => write!(
                    f,
                    "the video of {phone} could not be stopped: {error}; stop it on the phone"
                ),
                Device::Video(None) => f.write_str(error),
            },
            Self::NoVideoToFetch { phone } => {
                write!(
                    f,
                    "{phone} made no video in this session: none is asked for"
                )
            }
            Self::Downloading { phone, done, whole } => write!(
                f,
                "downloading the video of {phone}: {} of {} MB",
                done / 1_000_000,
                whole / 1_000_000
            ),
            Self::VideoFetched { path, size } => {
                write!(f, "the video is {} ({size} bytes)", path.display())
            }
            Self::FilesFetched { phone, count } => {
                write!(f, "{count} files of {phone} were copied")
            }
            Self::FilesNotFetched {
                phone,
                error,
                commands: [usb, mtp],
            } => write!(
                f,
                "timestamps and sensors of the video are on {phone} ({error}); by USB: `{usb}`, \
                 or by MTP: {mtp}"
            ),
            other => write!(f, "{other:?}"),
        }
    }
}
