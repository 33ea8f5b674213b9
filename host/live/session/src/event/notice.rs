//! The table of events: kind, severity, sentence and next step of each.
//!
//! The recording's log, `session.json` and the live view word every event by this table. Each
//! event has its row; no default judges, words or advises one.

use board::finding::{EventKind as Kind, Finding, FindingKind, Severity};
use board::reset_cause;
use clock::ClockRelation;
use clock::rates::{PLANNED_S, RateChange};
use protocol::Output;

use super::{Device, PhoneName, SessionEvent};

/// Next step for a problem whose cause only the whole recording shows.
const SEE_REPORT: &str = "see the recording's report";

/// Next step after a phone was lost.
const CHECK_PHONE: &str = "check the phone: app in the foreground, same network";

/// A row of the table: the notice of an event in log, session file and live view.
#[derive(Clone, Debug)]
pub struct Notice {
    /// Kind, severity, sentence, and next step for the operator.
    pub finding: Finding,
    /// True if something is missing or wrong in the recording, which makes its outcome "with
    /// loss".
    pub is_problem: bool,
    /// True if the recording's log keeps the sentence.
    pub is_logged: bool,
    /// True if the operator is shown the sentence.
    pub is_shown: bool,
}

impl Notice {
    fn new(
        severity: Severity,
        kind: impl Into<FindingKind>,
        sentence: impl Into<String>,
        next_step: Option<&str>,
    ) -> Self {
        Self {
            finding: Finding {
                next_step: next_step.map(str::to_owned),
                ..Finding::new(severity, kind, sentence)
            },
            is_problem: severity == Severity::Bad,
            is_logged: true,
            is_shown: true,
        }
    }

    /// The same for an event that is shown but not logged.
    fn unlogged(self) -> Self {
        Self {
            is_logged: false,
            ..self
        }
    }

    /// The same for an event that is logged but not shown.
    fn unshown(self) -> Self {
        Self {
            is_shown: false,
            ..self
        }
    }
}

/// Returns the row of an event that is as it should be.
fn good(kind: Kind, sentence: impl Into<String>) -> Option<Notice> {
    Some(Notice::new(Severity::Good, kind, sentence, None))
}

/// Returns the row of an event that is unusual but needs no action.
fn remark(kind: Kind, sentence: impl Into<String>) -> Option<Notice> {
    Some(Notice::new(Severity::Check, kind, sentence, None))
}

/// Returns the row of an event on which the operator should act.
fn warning(kind: Kind, sentence: impl Into<String>, next_step: &str) -> Option<Notice> {
    let next_step = Some(next_step);
    Some(Notice::new(Severity::Check, kind, sentence, next_step))
}

/// Returns the row of an event after which the recording is usable, but with loss.
fn gap(kind: Kind, sentence: impl Into<String>, next_step: &str) -> Option<Notice> {
    let mut notice = warning(kind, sentence, next_step)?;
    notice.is_problem = true;
    Some(notice)
}

/// Returns the row of an event after which a part of the recording is missing or broken.
fn bad(kind: Kind, sentence: impl Into<String>, next_step: &str) -> Option<Notice> {
    let next_step = Some(next_step);
    Some(Notice::new(Severity::Bad, kind, sentence, next_step))
}

impl SessionEvent {
    /// Returns the event's row of the table; `None` for an event that only updates a state,
    /// such as the message of a board, and for a question, which the program words.
    #[must_use]
    pub fn notice(&self) -> Option<Notice> {
        match self {
            Self::Phase { .. }
            | Self::Prompt { .. }
            | Self::StepFailed { .. }
            | Self::ScaleChanged { .. }
            | Self::Board { .. }
            | Self::Disk { .. }
            | Self::TwistFinished { .. }
            | Self::ClockKnown { .. }
            | Self::Tracked { .. }
            | Self::Downloading { .. }
            | Self::Ended { .. } => None,

            // The session.
            Self::Connected { folder, .. } => good(
                Kind::Connected,
                format!("recording into {}", folder.display()),
            ),
            Self::Checked { check } => (check.severity != Severity::Good).then(|| Notice {
                // The line of a check ends with its next step.
                is_problem: false,
                ..Notice::new(check.severity, Kind::Preflight, check.line(), None)
            }),
            Self::RecordingStarted { length_s: None } => good(Kind::Recording, "recording"),
            Self::RecordingStarted {
                length_s: Some(length),
            } => good(Kind::Recording, format!("recording for {length:.0} s")),
            Self::Marked { label, .. } => good(Kind::Marker, format!("mark: {label}")),
            Self::DiskNearlyFull { free } => {
                let megabytes = free / 1_000_000;
                let sentence = format!("the disk is nearly full: {megabytes} MB are left");
                warning(Kind::DiskNearlyFull, sentence, "free some space")
            }
            Self::Failed { error } => bad(Kind::Failed, error, SEE_REPORT),

            // The board and its link.
            Self::Lost { stream, count } => {
                let sentence = format!("{count} {stream} lost on the link");
                remark(Kind::Lost, sentence).map(Notice::unshown)
            }
            Self::Damaged { reason } => remark(Kind::Damaged, reason).map(Notice::unshown),
            Self::Hello => good(Kind::Hello, "the board said hello").map(Notice::unshown),
            Self::TimeOdd { odd } => gap(
                Kind::TimeOdd,
                format!(
                    "a message of the board has the time {:.3} s, far from all others; it is \
                     recorded as it came, and further ones are not reported",
                    odd.as_secs_f64()
                ),
                SEE_REPORT,
            ),
            Self::Found { finding } => {
                let is_problem = finding.severity != Severity::Good;
                let mut finding = finding.clone();
                if is_problem {
                    finding
                        .next_step
                        .get_or_insert_with(|| SEE_REPORT.to_owned());
                }
                Some(Notice {
                    is_problem,
                    finding,
                    is_logged: true,
                    is_shown: true,
                })
            }
            Self::BoardQuiet { seconds, damaged } => warning(
                Kind::BoardQuiet,
                format!(
                    "no message came from the board for {seconds} s; {damaged} damaged frames \
                     came so far"
                ),
                "check the USB cable",
            ),
            Self::BoardReset { cause, last } => bad(
                Kind::BoardReset,
                format!(
                    "the board was reset ({}) after {:.3} s of its time: the recording ends there",
                    reset_cause(*cause),
                    last.as_secs_f64()
                ),
                "check the board's supply and cable, then record again",
            ),
            Self::LinkLost { reason, patience_s } => {
                let wait = patience_s.map(|wait| format!("; waiting for it, {wait} s at most"));
                bad(
                    Kind::LinkLost,
                    format!("{reason}{}", wait.unwrap_or_default()),
                    "plug the USB cable in: the recording goes on by itself",
                )
            }
            Self::LinkBack { away_s } => good(
                Kind::LinkBack,
                format!("the link is back after {away_s:.3} s of board time"),
            ),

            // The twists, and the relation of the clocks.
            Self::TwistDueIn { seconds } => good(
                Kind::Twist,
                format!("the next twist begins in {seconds:.0} s"),
            ),
            Self::TwistStarted {
                number, length_s, ..
            } => good(
                Kind::Twist,
                format!("twist {number}: twist now, for {length_s} s"),
            ),
            Self::TwistRemark {
                number,
                phone,
                remark,
            } => good(
                Kind::Twist,
                format!("twist {number}{}: {remark}", phone.suffix()),
            ),
            Self::TwistAccepted(estimate) => {
                let clock = &estimate.clock;
                let [[offset, _], [_, skew]] = clock.covariance;
                good(
                    Kind::Twist,
                    format!(
                        "twist {}{}: offset {:.6} s ± {:.2} µs, skew {:+.3} ± {:.3} ppm",
                        estimate.number,
                        estimate.phone.suffix(),
                        clock.offset,
                        offset.max(0.0).sqrt() * 1e6,
                        clock.skew * 1e6,
                        skew.max(0.0).sqrt() * 1e6
                    ),
                )
            }
            Self::TwistRefused {
                number,
                phone,
                reason,
            } => remark(
                Kind::TwistRefused,
                format!("twist {number}{} refused: {reason}", phone.suffix()),
            ),
            Self::TwistsContradict { phone } => remark(
                Kind::TwistsContradict,
                format!(
                    "this twist contradicts the earlier ones{}: it alone is used",
                    phone.suffix()
                ),
            ),
            Self::TwistsJoined {
                phone,
                clock,
                change,
            } => good(Kind::Twist, twists_joined(phone, clock, change)),
            Self::LearntSkewUnfit {
                learnt_ppm,
                sigma_ppm,
                found_ppm,
            } => remark(
                Kind::LearntSkew,
                format!(
                    "the learnt skew of {learnt_ppm:+.3} ± {sigma_ppm:.3} ppm does not fit this \
                     twist's {found_ppm:+.3} ppm; it is not used"
                ),
            ),
            Self::SecondTwistLeftOut => good(Kind::Twist, "the second twist was left out"),
            Self::SecondTwistJoined { phone, clock } => good(
                Kind::Twist,
                format!("both twists{}: {}", phone.suffix(), skew(clock)),
            ),
            Self::SecondTwistFailed { error } => bad(Kind::SecondTwist, error, SEE_REPORT),
            Self::TwistDue { limit_us } => warning(
                Kind::TwistDue,
                format!(
                    "time for another twist: clocks wander and rigs warm up, and the phase is \
                     not known to {limit_us:.0} µs (1-sigma) any more; stop, and record again \
                     when it matters"
                ),
                "stop, and record again when the phase matters",
            ),
            Self::ClockFollowed { device } => good(
                Kind::Tracking,
                format!("the clock of phone {device} is followed"),
            )
            .map(Notice::unlogged),
            Self::ClockNotFollowed { reason } => good(
                Kind::Tracking,
                format!("the phone's clock is not followed: {reason}"),
            )
            .map(Notice::unlogged),
            Self::TrackLost => warning(
                Kind::TrackLost,
                "the phone's clock cannot be read any more: the trigger's period stays, and the \
                 phase drifts as without tracking; check the phone's cable and `adb devices`",
                "check the phone's cable and `adb devices`",
            ),
            Self::TrackBack => good(Kind::TrackBack, "the phone's clock is followed again"),

            // The trigger and the auxiliary outputs.
            Self::TriggerStarted { period_s } => good(
                Kind::Trigger,
                format!("the trigger runs with a period of {:.6} ms", period_s * 1e3),
            ),
            Self::AlignmentRemark { remark } => good(Kind::Align, remark),
            Self::LedFlashes { output, length_s } => good(
                Kind::Output,
                format!(
                    "hold the LED on {} to the phone's lens, a sheet of paper between: it flashes \
                     for {length_s:.0} s",
                    match output {
                        Output::Camera => "PA5, in place of the camera's cable,",
                        Output::Two => "PE11",
                        Output::Three => "PE13",
                        Output::Four => "PE14",
                    }
                ),
            ),
            Self::ExposuresSeen {
                seen,
                disagrees: false,
                ..
            } => good(Kind::Align, seen.text()),
            Self::ExposuresSeen {
                seen, profile_us, ..
            } => warning(
                Kind::Align,
                format!(
                    "{}; the profile has {profile_us:.2} µs, measured before in this mode",
                    seen.text()
                ),
                "measure it again with `smartdepthsync record --calibrate`",
            ),
            Self::Aligning {
                shift_us,
                frames,
                alignment,
            } => good(
                Kind::Align,
                format!(
                    "aligning: {shift_us:+.1} µs over {frames} frames; {}, drift ± {:.1} µs/min \
                     over {:.0} min",
                    alignment.promise(),
                    alignment.drift_sigma_us_per_min,
                    PLANNED_S / 60.0
                ),
            ),
            Self::Arrived {
                name,
                is_camera,
                pulse,
                remaining,
            } => good(
                if *is_camera {
                    Kind::Arrived
                } else {
                    Kind::OutputArrived
                },
                format!("{name} arrived at pulse {pulse}, {remaining} ticks from its grid"),
            ),
            Self::ArrivalUnconfirmed => gap(
                Kind::ArrivalUnconfirmed,
                "the board did not report the arrival, but its train runs on the grid",
                SEE_REPORT,
            ),
            Self::OutputStarted { name, output, rule } => good(
                Kind::Output,
                format!("{name} on output {output} runs: {rule} of the trigger"),
            ),
            Self::LidarStarted { name, utc_at_zero } => good(
                Kind::Gnss,
                format!("UTC for {name} is board time {utc_at_zero:+} s"),
            ),
            Self::NotStopped { what, error } => not_stopped(what, error),

            // The depth recorder.
            Self::RecorderStarted => good(Kind::DepthRecorder, "the depth recorder runs"),
            Self::RecorderGone { end } => recorder_gone(format!(
                "the depth recorder `{}` ended by itself ({}); its output is in \
                 depth_recorder.log",
                end.program, end.status
            )),
            Self::RecorderFailed { end } => recorder_gone(format!(
                "the depth recorder `{}` ended with {}",
                end.program, end.status
            )),
            Self::RecorderKilled { program, waited_s } => recorder_gone(format!(
                "the depth recorder `{program}` did not stop within {waited_s} s and was killed; \
                 its file may be incomplete"
            )),

            // The phones and their videos.
            Self::VideoStarted { phone, video } => {
                let exposure = video
                    .exposure_ns
                    .map_or(String::from("not reported"), |ns| {
                        format!("{:.3} ms", ns as f64 * 1e-6)
                    });
                good(
                    Kind::Video,
                    format!(
                        "{phone} records: frame period {:.3} ns, exposure {exposure}",
                        video.frame_duration_ns
                    ),
                )
            }
            Self::VideoUndone { phone, error: None } => {
                good(Kind::Video, format!("{phone} was asked to stop"))
            }
            Self::VideoUndone {
                phone,
                error: Some(error),
            } => good(Kind::Video, format!("a video may run on {phone}: {error}")),
            Self::VideoEnded { phone } => bad(
                Kind::VideoEnded,
                format!(
                    "the video of {phone} has ended: it was stopped by hand, or its app was in \
                     the background"
                ),
                CHECK_PHONE,
            ),
            Self::PhoneAway { phone, error } => warning(
                Kind::PhoneAway,
                format!("whether {phone} records is not known: {error}"),
                CHECK_PHONE,
            ),
            Self::PhoneBack { phone } => good(Kind::PhoneBack, format!("{phone} still records")),
            Self::PhoneLeftOut { phone } => gap(
                Kind::PhoneLeftOut,
                format!("phone {} records no video", phone.name),
                CHECK_PHONE,
            ),
            Self::Placed { phone, placement } => good(
                Kind::Placement,
                format!("phone {}: {placement}", phone.name),
            ),
            Self::StopRetried {
                phone,
                error,
                patience_s,
            } => good(
                Kind::Video,
                format!(
                    "the video of {phone} is not stopped yet: {error}; trying for {patience_s} s"
                ),
            )
            .map(Notice::unlogged),
            Self::VideoNotFetched { error } => bad(Kind::VideoNotFetched, error, SEE_REPORT),
            Self::NoVideoToFetch { phone } => bad(
                Kind::VideoNotFetched,
                format!("{phone} made no video in this session: none is asked for"),
                SEE_REPORT,
            ),
            Self::VideoFetched { path, size } => good(
                Kind::Video,
                format!("the video is {} ({size} bytes)", path.display()),
            ),
            Self::FilesFetched { phone, count } => good(
                Kind::PhoneFiles,
                format!("{count} files of {phone} were copied"),
            ),
            Self::FilesDisagree {
                phone,
                fault,
                next_step,
            } => bad(Kind::PhoneFiles, format!("{phone}: {fault}"), next_step),
            Self::FilesNotFetched {
                phone,
                error,
                commands: [usb, mtp],
            } => good(
                Kind::PhoneFiles,
                format!(
                    "timestamps and sensors of the video are on {phone} ({error}); by USB: \
                     `{usb}`, or by MTP: {mtp}"
                ),
            ),
        }
    }
}

fn recorder_gone(sentence: String) -> Option<Notice> {
    let next_step = "look at depth_recorder.log; start the recording again";
    bad(Kind::DepthRecorderGone, sentence, next_step)
}

fn not_stopped(device: &Device, error: &str) -> Option<Notice> {
    match device {
        Device::Trigger => bad(
            Kind::TriggerNotStopped,
            format!("the trigger could not be stopped: {error}"),
            "stop it: `smartdepthsync board trigger stop`",
        ),
        Device::Output => bad(
            Kind::OutputsNotStopped,
            format!("an auxiliary output could not be stopped: {error}"),
            "press the board's reset button",
        ),
        Device::Video(phone) => {
            let sentence = match phone {
                Some(phone) => format!(
                    "the video of {phone} could not be stopped: {error}; stop it on the phone"
                ),
                None => error.to_owned(),
            };
            bad(Kind::PhoneLost, sentence, "stop the video on the phone")
        }
    }
}

fn twists_joined(phone: &PhoneName, clock: &ClockRelation, change: &RateChange) -> String {
    format!(
        "twists so far{}: {}, changing by {:+.3} ± {:.3} ppm/min",
        phone.suffix(),
        skew(clock),
        change.per_s * 60e6,
        change.variance.max(0.0).sqrt() * 60e6
    )
}

/// Returns the rate of a phone's clock in words.
fn skew(clock: &ClockRelation) -> String {
    let sigma = clock.covariance[1][1].max(0.0).sqrt();
    format!("skew {:+.4} ± {:.4} ppm", clock.skew * 1e6, sigma * 1e6)
}
