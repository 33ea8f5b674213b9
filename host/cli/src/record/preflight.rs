//! The checks before a recording: profile, disk, programs, board, IMU, trigger
//! read-back and phone. Each problem is listed with its fix.
//!
//! `smartdepthsync doctor` prints all of them. A session makes the same checks in its
//! connect step, with the rig in somebody's hands: so the noise of the IMU is
//! judged in motion too ([`ImuLook`]). The read-back of the trigger is judged on
//! the train that the session starts anyway, so that a depth camera which waits
//! already for its first pulse gets none that is not recorded.

use std::path::Path;
use std::process::{Command, Stdio};

use protocol::{BoardModel, Hello, ImuClock, ImuSetup, ImuState, Refusal, TICK_HZ, TriggerStatus};
use serde::Serialize;

use super::depth_recorder::left_over;
use super::rounds::free_space;
use crate::advice::refusal_step;
use crate::new_profile::summary;
use crate::outcome::{ExitStatus, Failure};
use crate::rig_profile::Place;
use board::Board;
use board::imu::{ImuLook, describe, last_fault};
use recording::finding::{Finding, Severity};
use recording::profile::Profile;
use recording::session_file::{CHECK_BIAS, CHECK_LEARNT, CHECK_READBACK};

/// How long the IMU is looked at, ticks.
pub(crate) const IMU_TIME: u64 = TICK_HZ as u64;

/// How often it is looked at, at most, while the board still sets it up, as after power-on.
const IMU_LOOKS: usize = 3;

/// For how long the trigger's read-back is looked at, ticks.
pub(crate) const TRIGGER_TIME: u64 = TICK_HZ as u64 / 2;

/// More noise than this is a bad sensor or supply, rad/s. The data sheet gives
/// 0.06 °/s rms = 0.001 rad/s at 100 Hz.
const GYRO_NOISE_LIMIT: f64 = 0.01;

/// How far the acceleration of a rig at rest may be from gravity: a part of it.
/// The data sheet gives ±3 % of scale and ±80 mg of zero offset.
const GRAVITY_TOLERANCE: f64 = 0.15;

/// Free space below which a recording may not fit, bytes.
const DISK_LOW: u64 = 2_000_000_000;

/// A learnt skew or a measured bias older than this should be measured again, days.
const OLD_DAYS: i32 = 90;

/// Name of the check of the depth camera's settings.
const CHECK_CAMERA: &str = "depth camera";

/// What to do about an IMU from which nothing comes.
pub(crate) const IMU_WIRING: &str =
    "check its wiring: PB6/PB7 I2C, PA1 data-ready, PA8 or PB0 clock, 3.3 V";

/// The version of a board's firmware, as people write it.
pub(crate) fn firmware_version(hello: &Hello) -> String {
    let (major, minor, patch) = hello.firmware_version;
    format!("{major}.{minor}.{patch}")
}

/// Checks, in the order in which they were made.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Checks {
    /// All of them.
    pub(crate) checks: Vec<Finding>,
    #[serde(skip)]
    failed: Option<ExitStatus>,
}

impl Checks {
    /// How a command ends that prints them: as the first bad one says.
    pub(crate) fn outcome(&self) -> ExitStatus {
        self.failed.unwrap_or(ExitStatus::Good)
    }

    /// The first bad one as an error.
    pub(crate) fn failure(&self) -> Option<Failure> {
        let bad = self.checks.iter().find(|c| c.severity == Severity::Bad)?;
        let status = self.failed.unwrap_or(ExitStatus::Error);
        let failure = Failure::new(status, format!("{}: {}", bad.kind, bad.text));
        Some(match &bad.next_step {
            Some(next) => failure.next_step(next),
            None => failure,
        })
    }

    /// It is as it should be.
    pub(crate) fn good(&mut self, name: &str, found: impl Into<String>) {
        self.checks.push(Finding::good(name, found));
    }

    /// It could be better.
    pub(crate) fn warn(&mut self, name: &str, found: impl Into<String>, next: &str) {
        self.checks
            .push(Finding::check(name, found).next_step(next));
    }

    /// A recording will not work.
    pub(crate) fn bad(&mut self, name: &str, failure: impl Into<Failure>) {
        let failure = failure.into();
        self.failed.get_or_insert(failure.status());
        let step = failure.what_to_do().to_owned();
        self.checks
            .push(Finding::bad(name, failure.to_string()).next_step(step));
    }

    /// What does not need the board: profile, disk, ffmpeg, depth recorder.
    /// `place` says where the profile is from, `out` where recordings are to go.
    pub(crate) fn host(&mut self, profile: &Profile, place: &Place, out: &Path) {
        self.profile(profile, place);
        self.camera(profile);
        self.disk(out);
        self.ffmpeg();
        self.recorder(profile);
    }

    fn profile(&mut self, profile: &Profile, place: &Place) {
        let today = jiff::Zoned::now().date();
        let age = |date: jiff::civil::Date| today.since(date).map_or(0, |span| span.get_days());
        if place.path.is_some() {
            self.good("profile", format!("{} ({place})", profile.name));
        } else {
            self.warn(
                "profile",
                place.to_string(),
                "make your own: `smartdepthsync setup`",
            );
        }
        match &profile.phone.learnt {
            None => self.warn(
                CHECK_LEARNT,
                "none: the phase may drift by tens of µs a minute",
                "`smartdepthsync record --calibrate` learns them in 2 minutes",
            ),
            Some(learnt) if age(learnt.learnt) > OLD_DAYS => self.warn(
                CHECK_LEARNT,
                format!("from {}", learnt.learnt),
                "crystals age: learn again",
            ),
            Some(learnt) => self.good(
                CHECK_LEARNT,
                format!(
                    "frame period {:.3} ns, skew {}, from {}",
                    learnt.frame_period_ns,
                    learnt
                        .skew
                        .map_or(String::from("not learnt"), |skew| format!(
                            "{:+.3} ppm",
                            skew * 1e6
                        )),
                    learnt.learnt
                ),
            ),
        }
        match profile.frame_sync.bias_measured {
            None => self.warn(
                CHECK_BIAS,
                format!(
                    "not measured: there may be ms between the cameras (± {} µs of that from the \
                     trigger to the middle of the depth exposure)",
                    profile.depth.center_offset_sigma_us
                ),
                "measure it: `smartdepthsync evaluate precision ... --calibrate`",
            ),
            Some(date) if age(date) > OLD_DAYS => self.warn(
                CHECK_BIAS,
                format!("measured on {date}"),
                "measure it again after changes of the rig",
            ),
            Some(date) => self.good(
                CHECK_BIAS,
                format!("{:+.1} µs, measured on {date}", profile.frame_sync.bias_us),
            ),
        }
    }

    fn camera(&mut self, profile: &Profile) {
        let Some(model) = profile.depth.model() else {
            return;
        };
        let objections = model.objections(profile);
        for objection in &objections {
            self.warn(CHECK_CAMERA, objection.found.clone(), &objection.next_step);
        }
        if objections.is_empty() {
            self.good(CHECK_CAMERA, summary(model, profile));
        }
    }

    fn disk(&mut self, out: &Path) {
        // The folder may not be there yet: the nearest one above it is.
        let place = out
            .ancestors()
            .find(|folder| folder.exists())
            .unwrap_or_else(|| Path::new("."));
        match free_space(place) {
            Some(free) if free < DISK_LOW => self.warn(
                "disk",
                format!("{} MB are free", free / 1_000_000),
                "free some space: an hour takes about 150 MB, videos several GB",
            ),
            Some(free) => self.good("disk", format!("{} GB are free", free / 1_000_000_000)),
            None => self.warn(
                "disk",
                "free space is not known",
                "make sure that there is enough",
            ),
        }
    }

    fn ffmpeg(&mut self) {
        let version = Command::new("ffmpeg")
            .arg("-version")
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .output();
        match version {
            Ok(output) if output.status.success() => {
                let text = String::from_utf8_lossy(&output.stdout);
                let first = text.lines().next().unwrap_or_default();
                let short: Vec<&str> = first.split_whitespace().take(3).collect();
                self.good("ffmpeg", short.join(" "));
            }
            _ => self.warn(
                "ffmpeg",
                "not found",
                "extract and evaluate need it: install ffmpeg",
            ),
        }
    }

    fn recorder(&mut self, profile: &Profile) {
        let Some(program) = profile.depth.recorder.command.first() else {
            self.good("depth recorder", "none in the profile: start it yourself");
            return;
        };
        if files::program(program).is_some() {
            self.good("depth recorder", program.clone());
            for group in left_over() {
                self.warn(
                    "depth recorder",
                    format!("one of a `record` that was killed still runs (process {group})"),
                    &format!("it holds the camera: stop it with `kill -s INT -- -{group}`"),
                );
            }
        } else {
            self.bad(
                "depth recorder",
                Failure::new(
                    ExitStatus::DepthRecorder,
                    format!("the program `{program}` is not found"),
                )
                .next_step("install it, or change `command` in `[depth.recorder]`"),
            );
        }
    }

    /// The board and its firmware, as it said when it was connected, and whether it has what
    /// the profile names.
    pub(crate) fn firmware(&mut self, board: &Board, profile: Option<&Profile>) {
        let hello = board.hello();
        self.good(
            "board",
            format!(
                "{}, firmware {}, up {:.1} s",
                protocol::usb::serial_number(&hello.board_id),
                firmware_version(hello),
                hello.now.as_secs_f64()
            ),
        );
        if let Some(panic) = &hello.last_panic {
            self.warn(
                "last panic",
                panic.to_string(),
                "report it; the board has restarted since",
            );
        }
        if let Some(profile) = profile {
            self.outputs(hello.board, profile);
        }
    }

    /// Further sensors of the profile that this board has no output for.
    fn outputs(&mut self, board: BoardModel, profile: &Profile) {
        let outputs = profile.outputs.iter().map(|sensor| sensor.name.as_str());
        let lidar = profile.lidar.iter().map(|lidar| lidar.name.as_str());
        let named: Vec<&str> = outputs.chain(lidar).collect();
        if named.is_empty() || board.has_outputs() {
            return;
        }
        let found = format!(
            "the profile names {}, but {} has no outputs 2 to 4 and nothing for a lidar",
            named.join(", "),
            board.name()
        );
        let failure = Failure::new(ExitStatus::Refused, found);
        self.bad(
            "outputs",
            failure.next_step(refusal_step(&Refusal::NotOnThisBoard)),
        );
    }

    /// Looks at the IMU's samples for [`IMU_TIME`] by `look`, which returns what the board
    /// says of it then; again while that sets it up.
    ///
    /// # Errors
    ///
    /// That of `look`.
    pub(crate) fn look_at_imu<E>(
        &mut self,
        mut look: impl FnMut() -> Result<(ImuLook, ImuSetup), E>,
    ) -> Result<ImuSetup, E> {
        let (mut seen, mut setup) = look()?;
        for _ in 1..IMU_LOOKS {
            if setup.status.state == ImuState::Starting {
                (seen, setup) = look()?;
            }
        }
        self.imu(&seen, &setup);
        Ok(setup)
    }

    /// The IMU, after a look at its samples. `setup` is what the board says then.
    fn imu(&mut self, look: &ImuLook, setup: &ImuSetup) {
        let report = look.report();
        if setup.status.state != ImuState::Running || report.samples == 0 {
            self.bad(
                "IMU",
                Failure::new(
                    ExitStatus::Refused,
                    format!(
                        "no samples ({:?}, {})",
                        setup.status.state,
                        last_fault(setup)
                    ),
                )
                .next_step(IMU_WIRING),
            );
            return;
        }
        self.good(
            "IMU",
            format!(
                "{}: {} samples, {:.3} Hz, jitter {:.2} ticks",
                describe(setup),
                report.samples,
                report.rate_hz.unwrap_or_default(),
                report.interval_jitter_ticks.unwrap_or_default()
            ),
        );
        match (setup.status.clock, setup.sensor.model.clock_input()) {
            (ImuClock::External, Some((_, rate))) => {
                self.good("IMU clock", format!("{rate} from the board"));
            }
            (ImuClock::Internal, Some((pin, _))) => self.warn(
                "IMU clock",
                "its own: samples are up to 1.5 % off their nominal distance",
                &format!(
                    "wire {pin} to the sensor's CLKIN; the samples' times are exact all the same"
                ),
            ),
            (_, None) => self.good(
                "IMU clock",
                "its own, as this sensor takes no other: the distance of samples is up to 1 % off, \
                 their times are exact",
            ),
            (ImuClock::Unknown, _) => self.warn("IMU clock", "not known yet", IMU_WIRING),
        }
        let axes = report.gyro_noise_rad_s.into_iter().flatten();
        let noise = axes.fold(0.0, f64::max);
        if noise <= GYRO_NOISE_LIMIT {
            self.good("IMU noise", format!("{noise:.5} rad/s"));
            self.gravity(report.accel_mean_m_s2);
            return;
        }
        match look.noise_in_motion() {
            Some(noise) if noise <= GYRO_NOISE_LIMIT => self.good(
                "IMU noise",
                format!("about {noise:.4} rad/s (the rig moves)"),
            ),
            noise => self.warn(
                "IMU noise",
                noise.map_or(String::from("not measured: the rig moves"), |noise| {
                    format!("{noise:.4} rad/s")
                }),
                "keep the rig still during this check; if it was still, the sensor or its supply is bad",
            ),
        }
    }

    /// The accelerometer at rest feels gravity, and nothing else.
    fn gravity(&mut self, mean: [Option<f64>; 3]) {
        let norm = mean
            .iter()
            .flatten()
            .map(|axis| axis * axis)
            .sum::<f64>()
            .sqrt();
        let found = format!("{norm:.2} m/s² at rest");
        let off = (norm / board::imu::STANDARD_GRAVITY - 1.0).abs();
        if off > GRAVITY_TOLERANCE {
            self.warn(
                "accelerometer",
                found,
                "expected about 9.81: the sensor is damaged, or not the expected one",
            );
        } else {
            self.good("accelerometer", found);
        }
    }

    /// The link, after so much was lost and damaged while the IMU was looked at.
    pub(crate) fn link(&mut self, lost: u64, damaged: u32) {
        if lost > 0 || damaged > 0 {
            self.warn(
                "link",
                format!("{lost} messages lost, {damaged} frames damaged"),
                "use another USB port or cable, without a hub",
            );
        } else {
            self.good("link", "nothing lost");
        }
    }

    /// The trigger's read-back, from the state of a train.
    pub(crate) fn readback(&mut self, status: &TriggerStatus) {
        let readback = &status.readback;
        match (readback.seen, readback.missing, readback.delay) {
            (0, 0, _) => self.warn(
                CHECK_READBACK,
                format!("not wired ({} pulses made)", status.pulses),
                "wire the buffered trigger to PA3, so that every pulse is verified",
            ),
            (seen, 0, delay) => self.good(
                CHECK_READBACK,
                format!(
                    "{seen} pulses seen, delay {} ticks",
                    delay.unwrap_or_default()
                ),
            ),
            (seen, missing, _) => self.bad(
                CHECK_READBACK,
                Failure::new(
                    ExitStatus::Refused,
                    format!(
                        "{missing} of {} pulses missing",
                        seen.saturating_add(missing)
                    ),
                )
                .next_step("check the buffer and the wire from PA5 to PA3"),
            ),
        }
    }

    /// The phone, after it has answered.
    pub(crate) fn phone(&mut self, version: &str, address: &str) {
        self.good("phone", format!("app {version} at {address}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_bad_check_is_the_failure() {
        let mut checks = Checks::default();
        assert!(checks.failure().is_none());
        checks.good("a", "b");
        checks.warn("c", "d", "e");
        assert!(checks.failure().is_none());
        assert_eq!(checks.checks[1].line(), "c: d -> e");
        let bad = |text| Failure::new(ExitStatus::DepthRecorder, text).next_step("do this");
        checks.bad("f", bad("first"));
        checks.bad("g", Failure::new(ExitStatus::Refused, "second"));
        let failure = checks.failure().unwrap();
        assert_eq!(failure.status(), ExitStatus::DepthRecorder);
        assert_eq!(failure.to_string(), "f: first");
        assert!(failure.has_next_step());
    }

    #[test]
    fn sensors_that_the_board_has_no_output_for_are_told_before_a_session() {
        let named =
            "[[outputs]]\noutput = 2\nname = \"left\"\nevery = 1\n[lidar]\nname = \"top\"\n";
        let told = |board, profile: &str| {
            let mut checks = Checks::default();
            checks.outputs(board, &Profile::parse(profile, None).unwrap());
            checks.failure()
        };
        assert!(told(BoardModel::Discovery, named).is_none());
        assert!(told(BoardModel::BlackPill, "").is_none());
        let failure = told(BoardModel::BlackPill, named).unwrap();
        assert_eq!(failure.status(), ExitStatus::Refused);
        assert!(failure.to_string().contains("left, top"), "{failure}");
        assert!(failure.what_to_do().contains("[[outputs]]"));
    }

    #[test]
    fn an_accelerometer_without_gravity_is_told() {
        let verdict = |norm: f64| {
            let mut checks = Checks::default();
            checks.gravity([Some(norm), Some(0.0), Some(0.0)]);
            checks.checks[0].severity
        };
        assert_eq!(verdict(9.6), Severity::Good);
        assert_eq!(verdict(4.9), Severity::Check);
        assert_eq!(verdict(0.0), Severity::Check);
    }
}
