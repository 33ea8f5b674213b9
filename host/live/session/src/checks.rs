//! The checks before a recording: board, IMU, link, trigger read-back and phone.
//!
//! A session makes them in its first step, while somebody holds the rig, so the noise of the
//! IMU is also judged in motion ([`ImuLook`]). The read-back of the trigger is judged on the
//! train that the session starts anyway: a depth camera that already waits for its first pulse
//! must not receive one that is not recorded. The program adds the checks of the computer, and
//! makes the same checks in `doctor`.

use board::Board;
use board::BoardInfo;
use board::finding::{Finding, Severity};
use board::imu::{ImuLook, describe, last_fault};
use protocol::{BoardModel, ImuClock, ImuSetup, ImuState, TICK_HZ, TriggerStatus};
use recording::profile::Profile;
use recording::session_file::CHECK_READBACK;
use serde::Serialize;

use crate::error::{Fault, SessionError};

/// Length of a look at the IMU, ticks.
pub const IMU_TIME: u64 = TICK_HZ as u64;

/// Largest number of looks while the board still sets the IMU up, as after power-on.
const IMU_LOOKS: usize = 3;

/// Length of a look at the trigger's read-back, ticks.
pub const TRIGGER_TIME: u64 = TICK_HZ as u64 / 2;

/// Noise above which the sensor or its supply is bad, rad/s. The data sheet states
/// 0.06 °/s rms = 0.001 rad/s at 100 Hz.
const GYRO_NOISE_LIMIT: f64 = 0.01;

/// Largest deviation of the acceleration at rest from gravity, as a fraction of it. The data
/// sheet states ±3 % of scale and ±80 mg of zero offset.
const GRAVITY_TOLERANCE: f64 = 0.15;

/// Next step for an IMU that sends no samples.
pub const IMU_WIRING: &str =
    "check its wiring: PB6/PB7 I2C, PA1 data-ready, PA8 or PB0 clock, 3.3 V";

/// Next step for a profile with more outputs than the board has.
pub const NO_OUTPUTS: &str =
    "leave `[[outputs]]` and `[lidar]` out of the rig profile, or use an STM32F4DISCOVERY";

/// The results of checks, in order.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Checks {
    /// One result per check.
    pub checks: Vec<Finding>,
    /// The part at fault in the first bad one.
    #[serde(skip)]
    fault: Option<Fault>,
}

impl Checks {
    /// Adds a check that passed.
    pub fn good(&mut self, name: &str, found: impl Into<String>) {
        self.checks.push(Finding::good(name, found));
    }

    /// Adds a check that could be better; `next` is the next step.
    pub fn warn(&mut self, name: &str, found: impl Into<String>, next: &str) {
        self.checks
            .push(Finding::check(name, found).next_step(next));
    }

    /// Adds a check with which a recording will not work; `next` is the next step.
    pub fn bad(&mut self, fault: Fault, name: &str, found: impl Into<String>, next: &str) {
        self.fault.get_or_insert(fault);
        self.checks.push(Finding::bad(name, found).next_step(next));
    }

    /// Returns the first bad check as an error.
    ///
    /// # Errors
    ///
    /// A check is bad.
    pub fn result(&self) -> Result<(), SessionError> {
        let bad = self.checks.iter().find(|c| c.severity == Severity::Bad);
        match (bad, self.fault) {
            (Some(bad), Some(fault)) => Err(SessionError::Check {
                name: bad.kind.to_string(),
                found: bad.text.clone(),
                next_step: bad.next_step.clone(),
                fault,
            }),
            _ => Ok(()),
        }
    }

    /// Adds the board and its firmware, from its hello, and checks that it has the outputs that
    /// the profile names.
    pub fn firmware(&mut self, board: &Board, profile: Option<&Profile>) {
        let hello = board.hello();
        let BoardInfo { id, firmware, .. } = BoardInfo::new(hello);
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

    /// Checks that the board has outputs for the auxiliary sensors of the profile.
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

    /// Checks the IMU by `look`, which collects samples for [`IMU_TIME`] and returns them with
    /// the state of the IMU. Repeats the look while the board still sets the IMU up. Returns
    /// the last state.
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

    /// Judges the IMU from a look at its samples and from its state after that.
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

    /// Checks that the accelerometer at rest measures gravity alone: `mean` is its average, m/s².
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

    /// Judges the link from the messages that were lost and damaged during the look at the IMU.
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

    /// Judges the trigger's read-back from the state of a train.
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

    /// Adds a phone that has answered: the version of its app, and its address.
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
