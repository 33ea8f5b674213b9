//! The shown form of the state at a moment.

use clock::alignment::Placement;
use clock::{BoardSeconds, ClockRelation};
use protocol::{TICK_HZ, Ticks, TrainState};
use recording::error_budget::{COARSE_US, ErrorPart};
use serde::Serialize;
use session::event::{Phase, Tracked};

use super::State;
use super::rate::state_word;

/// The camera's train.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Trigger {
    /// State of the train in words; empty before the first status.
    pub(crate) state: String,
    /// Pulses a second, from the period.
    pub(crate) fps: Option<f64>,
    /// Number of the last pulse.
    pub(crate) pulse: Option<u64>,
    /// From the edge to the wire, ns; nothing if it was not seen.
    pub(crate) readback_ns: Option<f64>,
    /// Pulses that the wire did not show.
    pub(crate) readback_missing: u32,
    /// Edges that came late.
    pub(crate) late: u32,
}

/// The trigger against its grid on the phone's frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PhaseNow {
    /// The last pulse against the grid, µs; where the phone's clock is followed, how late
    /// the trigger is on its frames.
    pub(crate) phase_us: f64,
    /// 1-sigma of the phase now, µs: of the grid against the phone's frames, and of the
    /// constant between the cameras.
    pub(crate) sigma_us: f64,
    /// The largest part of that.
    pub(crate) largest: Option<ErrorPart>,
    /// True if it is measured, and below a millisecond.
    pub(crate) is_sure: bool,
    /// True if that is more than a twist may have.
    pub(crate) is_twist_due: bool,
    /// Where the phone's clock is followed.
    pub(crate) tracked: Option<Tracked>,
}

/// A phone of a session; the first is the reference.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Phone {
    pub(crate) name: String,
    /// The relation of its clock, once there is one.
    pub(crate) clock: Option<ClockRelation>,
    /// Its frames against the depth images, if the trigger is aligned to another.
    pub(crate) placement: Option<Placement>,
}

/// The relation of a phone's clock at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClockNow {
    /// Phone minus board, s.
    pub(crate) offset_s: f64,
    /// 1-sigma of it, µs.
    pub(crate) sigma_us: f64,
    /// Rate of the phone, ppm.
    pub(crate) skew_ppm: f64,
    /// Time since its data, s.
    pub(crate) age_s: f64,
}

/// A sensor on an auxiliary output, or a lidar.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Sensor {
    /// Its name; where it is connected if that is not known.
    pub(crate) name: String,
    /// Where it is connected: `output 2`, `gnss`.
    pub(crate) at: String,
    /// State of the train in words; empty before the first status.
    pub(crate) state: String,
    /// Pulses a second.
    pub(crate) rate: f64,
    /// Number of its last pulse, or of the pulses per second so far.
    pub(crate) pulse: Option<u64>,
    /// Edges that came late, and sentences that were left out.
    pub(crate) late: u32,
    /// The UTC that a lidar got last, in seconds since 1970.
    pub(crate) utc: Option<i64>,
}

impl Sensor {
    /// The UTC as text.
    pub(crate) fn utc_text(&self) -> Option<String> {
        let time = jiff::Timestamp::from_second(self.utc?).ok()?;
        Some(time.strftime("%Y-%m-%d %H:%M:%S UTC").to_string())
    }
}

/// Messages a second, over the last two.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Rates {
    /// IMU samples.
    pub(crate) imu: f64,
    /// Pulses.
    pub(crate) pulses: f64,
    /// Edges on the strobe input.
    pub(crate) captures: f64,
    /// Load of the board's processor, %.
    pub(crate) load_percent: f64,
    /// Temperature of the IMU, °C.
    pub(crate) temperature: Option<f64>,
}

/// Losses since counting began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Losses {
    /// Messages by the board's numbers.
    pub(crate) messages: u64,
    /// Damaged frames.
    pub(crate) damaged: u64,
    /// Losses of the link.
    pub(crate) reconnects: u32,
}

/// The disk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Disk {
    /// Free, bytes.
    pub(crate) free: u64,
    /// Time for which it lasts at the rate so far, s.
    pub(crate) left_s: Option<f64>,
}

/// A twist that runs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Twist {
    /// Time that it has run, s.
    pub(crate) elapsed_s: f64,
    /// Its length, s.
    pub(crate) length_s: f64,
    /// Expected 1-sigma of the offset from the motion so far, µs.
    pub(crate) sigma_us: Option<f64>,
    /// A 1-sigma that is enough, µs.
    pub(crate) enough_us: f64,
    /// Root mean square of each axis, rad/s.
    pub(crate) rms: [f64; 3],
}

impl Twist {
    /// Returns true if the motion so far is sufficient.
    pub(crate) fn is_enough(&self) -> bool {
        self.sigma_us.is_some_and(|sigma| sigma <= self.enough_us)
    }

    /// Returns advice for the operator.
    pub(crate) fn advice(&self) -> &'static str {
        let mut sorted = self.rms;
        sorted.sort_by(f64::total_cmp);
        match sorted {
            [_, _, most] if most < 0.5 => "twist faster",
            [_, middle, _] if middle < 0.3 => "twist about another axis too",
            _ if self.is_enough() => "enough: hold still when the time is up",
            _ => "go on",
        }
    }
}

/// The meaning of the keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Keys {
    /// Stop, help.
    Look,
    /// Go on, repeat, leave out, quit.
    Answer,
    /// Mark, stop.
    Record,
}

impl State {
    /// Returns the current activity in a word or two.
    pub(crate) fn doing(&self) -> String {
        if let Some((since, patience_s)) = self.link_lost {
            let left = patience_s.map(|whole| whole.saturating_sub(since.elapsed().as_secs()));
            let left = left.map_or(String::new(), |left| format!(", {left} s left"));
            return format!("link lost{left}");
        }
        let word = match (self.phase, self.download) {
            (_, Some((done, whole))) => {
                let (done, whole) = (done / 1_000_000, whole / 1_000_000);
                return format!("downloading {done} of {whole} MB");
            }
            (Some(Phase::Twisting { number }), _) => return format!("twist {number}"),
            (None, _) => "monitor",
            (Some(Phase::Connecting), _) => "connecting",
            (Some(Phase::Checking), _) => "checking",
            (Some(Phase::BetweenTwists), _) => "before the next twist",
            (Some(Phase::StartingRecorder | Phase::StartingTrigger), _) => "starting",
            (Some(Phase::StartingVideos), _) => "starting videos",
            (Some(Phase::Aligning), _) => "aligning",
            (Some(Phase::Recording { .. }), _) => "recording",
            (Some(Phase::Stopping), _) => "stopping",
            (Some(Phase::Fetching), _) => "fetching files",
            (Some(Phase::Closing | Phase::Ended), _) => "closing",
        };
        word.to_owned()
    }

    /// Time that the recording has run, and its length, s.
    pub(crate) fn recorded_s(&self) -> Option<(f64, Option<f64>)> {
        let Some(Phase::Recording { since }) = self.phase else {
            return None;
        };
        let elapsed = Ticks(self.now.0.saturating_sub(since.0));
        Some((elapsed.as_secs_f64(), self.length_s))
    }

    /// The meaning of the keys now.
    pub(crate) const fn keys(&self) -> Keys {
        match self.phase {
            Some(Phase::Recording { .. }) => Keys::Record,
            // A twist that runs asks nothing.
            Some(
                Phase::Twisting { .. }
                | Phase::Connecting
                | Phase::Checking
                | Phase::BetweenTwists
                | Phase::StartingRecorder
                | Phase::StartingTrigger
                | Phase::StartingVideos
                | Phase::Aligning,
            ) if self.asks && self.twist.is_none() => Keys::Answer,
            _ => Keys::Look,
        }
    }

    /// The twist, while it runs.
    pub(crate) fn twist(&self) -> Option<Twist> {
        let (coach, length_s, enough_us) = self.twist.as_ref()?;
        Some(Twist {
            elapsed_s: coach.elapsed_s(),
            length_s: f64::from(*length_s),
            sigma_us: coach.sigma_s().map(|sigma| sigma * 1e6),
            enough_us: *enough_us,
            rms: coach.rms(),
        })
    }

    /// The trigger against its grid, once it has arrived there.
    pub(crate) fn phase_now(&self) -> Option<PhaseNow> {
        let alignment = self.alignment.as_ref()?;
        let at = self.last_pulse?;
        // Nothing drifts once the train has stopped.
        if self.trigger.state == state_word(TrainState::Stopped) {
            return None;
        }
        if alignment.arrival.is_none_or(|arrival| at < arrival) {
            return None;
        }
        let off = alignment.plan.grid().phase_error(at);
        let off_us = off.0 as f64 * 1e6 / f64::from(TICK_HZ);
        let now = BoardSeconds::from(self.now);
        let untracked_us = || alignment.plan.phase_sigma_us_now(now, self.temperature);
        let tracked_us = self.tracked.map(|tracked| tracked.sigma_us);
        let constant_us = alignment.constant_sigma_us.unwrap_or_default();
        let sigma_us = tracked_us.unwrap_or_else(untracked_us).hypot(constant_us);
        Some(PhaseNow {
            phase_us: self.tracked.map_or(off_us, |tracked| tracked.phase_us),
            sigma_us,
            largest: Some(alignment.largest_part(sigma_us)),
            is_sure: alignment.bias_is_measured && sigma_us < COARSE_US,
            is_twist_due: self.is_twist_due,
            tracked: self.tracked,
        })
    }

    /// The relation of a phone's clock now.
    pub(crate) fn clock_now(&self, phone: &Phone) -> Option<ClockNow> {
        let clock = phone.clock?;
        let now = BoardSeconds::from(self.now);
        let offset = clock.offset_at(now.0);
        Some(ClockNow {
            offset_s: offset.value,
            sigma_us: offset.sigma * 1e6,
            skew_ppm: clock.skew * 1e6,
            age_s: now.0 - clock.reference,
        })
    }

    /// Returns the state of the auxiliary outputs and the lidar.
    pub(crate) fn sensors(&self) -> Vec<Sensor> {
        let sensors = (0..).zip(&self.sensors);
        sensors
            .filter_map(|(place, sensor)| sensor.shown(place, self.now))
            .collect()
    }

    /// Messages a second.
    pub(crate) fn rates(&self) -> Rates {
        Rates {
            imu: self.imu.per_second(self.now),
            pulses: self.pulses.per_second(self.now),
            captures: self.captures.per_second(self.now),
            load_percent: self.load_percent,
            temperature: self.temperature,
        }
    }
}
