//! The checks before a recording: board, IMU, link, trigger read-back and phone.
//!
//! A session makes them in its first step, with the rig in somebody's hands: so the noise
//! of the IMU is judged in motion too ([`ImuLook`]). The read-back of the trigger is judged
//! on the train that the session starts anyway, so that a depth camera which waits
//! already for its first pulse gets none that is not recorded. The program adds the checks
//! of the computer, and makes the same ones in `doctor`.

use board::Board;
use board::BoardInfo;
use board::finding::{Finding, Severity};
use board::imu::{ImuLook, describe, last_fault};
use protocol::{BoardModel, ImuClock, ImuSetup, ImuState, TICK_HZ, TriggerStatus};
use recording::profile::Profile;
use recording::session_file::CHECK_READBACK;
use serde::Serialize;

use crate::error::SessionError;

/// How long the IMU is looked at, ticks.
pub const IMU_TIME: u64 = TICK_HZ as u64;

/// How often it is looked at, at most, while the board still sets it up, as after power-on.
const IMU_LOOKS: usize = 3;

/// For how long the trigger's read-back is looked at, ticks.
pub const TRIGGER_TIME: u64 = TICK_HZ as u64 / 2;

/// More noise than this is a bad sensor or supply, rad/s. The data sheet gives
/// 0.06 °/s rms = 0.001 rad/s at 100 Hz.
const GYRO_NOISE_LIMIT: f64 = 0.01;

/// How far the acceleration of a rig at rest may be from gravity: a part of it.
/// The data sheet gives ±3 % of scale and ±80 mg of zero offset.
const GRAVITY_TOLERANCE: f64 = 0.15;

/// The remedy for an IMU from which nothing comes.
pub const IMU_WIRING: &str =
    "check its wiring: PB6/PB7 I2C, PA1 data-ready, PA8 or PB0 clock, 3.3 V";

/// The remedy for a profile that names more than the board has.
pub const NO_OUTPUTS: &str =
    "leave `[[outputs]]` and `[lidar]` out of the rig profile, or use an STM32F4DISCOVERY";

/// Where that lies which a check found bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// The rig, its wiring or its profile.
    Rig,
    /// The program that records the depth camera.
    Recorder,
    /// The disk.
    Disk,
}

/// Checks, in the order in which they were made.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Checks {
    /// All of them.
    pub checks: Vec<Finding>,
    /// Where the first bad one lies.
    #[serde(skip)]
    fault: Option<Fault>,
}

impl Checks {
    /// Adds one that is as it should be.
    pub fn good(&mut self, name: &str, found: impl Into<String>) {
        self.checks.push(Finding::good(name, found));
    }

    /// Adds one that could be better; `next` says what to do.
    pub fn warn(&mut self, name: &str, found: impl Into<String>, next: &str) {
        self.checks
            .push(Finding::check(name, found).next_step(next));
    }

    /// Adds one with which a recording will not work; `next` says what to do.
    pub fn bad(&mut self, fault: Fault, name: &str, found: impl Into<String>, next: &str) {
        self.fault.get_or_insert(fault);
        self.checks.push(Finding::bad(name, found).next_step(next));
    }

    /// The first bad one as an error.
    ///
    /// # Errors
    ///
    /// There is one.
    pub fn result(&self) -> Result<(), SessionError> {
        let bad = self.checks.iter().find(|c| c.severity == Severity::Bad);
        match (bad, self.fault) {
            (Some(bad), Some(fault)) => Err(SessionError::Check {
                name: bad.kind.clone(),
                found: bad.text.clone(),
                next_step: bad.next_step.clone(),
                fault,
            }),
            _ => Ok(()),
        }
    }

    /// The board and its firmware, as it said when it was connected, and whether it has what
    /// the profile names.
    pub fn firmware(&mut self, board: &Board, profile: Option<&Profile>) {
        let hello = board.hello();
        let BoardInfo { id, firmware, .. } = BoardInfo::of(hello);
        let up = hello.now.as_secs_f64();
        self.good("board", format!("{id}, firmware {firmware}, up {up:.1} s"));
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

    /// Auxiliary sensors of the profile that this board has no output for.
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
        self.bad(Fault::Rig, "outputs", found, NO_OUTPUTS);
    }

    /// Looks at the IMU's samples for [`IMU_TIME`] by `look`, which returns what the board
    /// says of it then; again while that sets it up.
    ///
    /// # Errors
    ///
    /// That of `look`.
    pub fn look_at_imu<E>(
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
            let found = format!(
                "no samples ({:?}, {})",
                setup.status.state,
                last_fault(setup)
            );
            self.bad(Fault::Rig, "IMU", found, IMU_WIRING);
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
                "its own: samples are up to 1.5 % off their nominal period",
                &format!(
                    "wire {pin} to the sensor's CLKIN; the samples' times are exact all the same"
                ),
            ),
            (_, None) => self.good(
                "IMU clock",
                "its own, as this sensor takes no other: the period of samples is up to 1 % off, \
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
    pub fn link(&mut self, lost: u64, damaged: u32) {
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
    pub fn readback(&mut self, status: &TriggerStatus) {
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
                Fault::Rig,
                CHECK_READBACK,
                format!(
                    "{missing} of {} pulses missing",
                    seen.saturating_add(missing)
                ),
                "check the buffer and the wire from PA5 to PA3",
            ),
        }
    }

    /// The phone, after it has answered.
    pub fn phone(&mut self, version: &str, address: &str) {
        self.good("phone", format!("app {version} at {address}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_bad_check_is_the_error() {
        let mut checks = Checks::default();
        checks.good("a", "b");
        checks.warn("c", "d", "e");
        assert!(checks.result().is_ok());
        assert_eq!(checks.checks[1].line(), "c: d -> e");
        checks.bad(Fault::Recorder, "f", "first", "do this");
        checks.bad(Fault::Rig, "g", "second", "do that");
        let Err(SessionError::Check { found, fault, .. }) = checks.result() else {
            panic!("no error");
        };
        assert_eq!((found.as_str(), fault), ("first", Fault::Recorder));
    }

    #[test]
    fn sensors_that_the_board_has_no_output_for_are_found_before_a_session() {
        let named =
            "[[outputs]]\noutput = 2\nname = \"left\"\nevery = 1\n[lidar]\nname = \"top\"\n";
        let found = |board, profile: &str| {
            let mut checks = Checks::default();
            checks.outputs(board, &Profile::parse(profile, None).unwrap());
            checks.result()
        };
        assert!(found(BoardModel::Discovery, named).is_ok());
        assert!(found(BoardModel::BlackPill, "").is_ok());
        let error = found(BoardModel::BlackPill, named).unwrap_err();
        assert!(error.to_string().contains("left, top"), "{error}");
    }

    #[test]
    fn an_accelerometer_without_gravity_is_found() {
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
