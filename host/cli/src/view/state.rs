//! The state of a session or of a board: events are folded into it, in order. Pure.
//!
//! - `shown`: the shown form of the state. `rate`: message rates, and sensors by output.

mod rate;
mod shown;
#[cfg(test)]
pub(super) mod tests;

use std::collections::VecDeque;
use std::time::Instant;

use board::finding::{EventKind, Finding, FindingKind, Severity};
use board::imu::Sample;
use clock::coach::Coach;
use protocol::{DeviceToHost, ImuState, Output, Status, TICK_HZ, Ticks, TrainState};
use recording::profile::Profile;
use recording::session_file::Alignment;
use session::event::{Notice, Phase, SessionEvent, Stamped, Tracked};

use super::sentences::sentence;
use crate::outcome::Failure;
use rate::{Connected, LIDAR, Rate, drop_before, state_word};
pub(crate) use shown::{Disk, Keys, Losses, PhaseNow, Phone, Rates, Sensor, Trigger, Twist};

/// Length of the gyroscope that is shown, ticks.
const SHOWN: u64 = 10 * TICK_HZ as u64;

/// Interval of the points that are shown, ticks: 40 ms.
const POINT: u64 = TICK_HZ as u64 / 25;

/// Kind of the warning about a step that has failed and may be repeated.
const STEP_FAILED: &str = "step_failed";

/// The most warnings and sentences that are kept.
const KEPT: usize = 8;

/// Time after which the growth of a recording is judged, ticks.
const SIZE_TICKS: u64 = 5 * TICK_HZ as u64;

/// The latest state of everything.
#[derive(Clone, Debug, Default)]
pub(crate) struct State {
    /// The board's ID.
    pub(crate) board: String,
    /// Latest board time.
    pub(crate) now: Ticks,
    /// True if the operator is asked questions.
    pub(crate) asks: bool,
    pub(crate) trigger: Trigger,
    pub(crate) losses: Losses,
    pub(crate) phones: Vec<Phone>,
    pub(crate) disk: Option<Disk>,
    /// Board time and label of the last mark.
    pub(crate) mark: Option<(Ticks, String)>,
    /// The newest last.
    pub(crate) warnings: VecDeque<Finding>,
    /// Sentences, the newest last.
    pub(crate) said: VecDeque<String>,
    /// The board's gyroscope over the last seconds.
    pub(crate) gyro: VecDeque<(Ticks, [f64; 3])>,
    /// True if the board says that its IMU gives samples.
    pub(crate) imu_runs: Option<bool>,
    /// The part of a session that runs; none where the board is only monitored.
    phase: Option<Phase>,
    /// Time of the loss of the link, and the longest wait for its return, s. The board's time does
    /// not advance meanwhile.
    link_lost: Option<(Instant, Option<u64>)>,
    /// Received bytes of a download, and its size.
    download: Option<(u64, u64)>,
    /// Length of the recording, s; `None` records until it is stopped.
    length_s: Option<f64>,
    twist: Option<(Coach, u32, f64)>,
    alignment: Option<Alignment>,
    tracked: Option<Tracked>,
    is_twist_due: bool,
    temperature: Option<f64>,
    load_percent: f64,
    last_pulse: Option<Ticks>,
    imu: Rate,
    pulses: Rate,
    captures: Rate,
    /// Time and size of the recording when its growth was first seen.
    growth_from: Option<(Ticks, u64)>,
    /// Outputs 2 to 4, then the lidar.
    sensors: [Connected; 4],
}

/// Adds an item, and drops the oldest one beyond [`KEPT`].
fn push_bounded<T>(list: &mut VecDeque<T>, item: T) {
    list.push_back(item);
    if list.len() > KEPT {
        list.pop_front();
    }
}

impl State {
    /// Returns the state of a session that begins on this rig. `asks` is true if the operator is
    /// asked questions.
    pub(crate) fn of_session(profile: &Profile, asks: bool) -> Self {
        let phone = |name: &String| Phone {
            name: name.clone(),
            clock: None,
            placement: None,
        };
        let mut state = Self::of_board(String::new(), Some(profile));
        state.phones = profile.all_phones().map(|p| phone(&p.name)).collect();
        state.phase = Some(Phase::Connecting);
        state.asks = asks;
        state
    }

    /// Returns the state of a monitored board. The profile contains the names of its sensors.
    pub(crate) fn of_board(board: String, profile: Option<&Profile>) -> Self {
        let mut state = Self {
            board,
            ..Self::default()
        };
        let Some(profile) = profile else {
            return state;
        };
        for (place, output) in state.sensors.iter_mut().zip(Output::AUXILIARY) {
            let mut sensors = profile.outputs.iter();
            let sensor = sensors.find(|sensor| sensor.output == output.number());
            place.name = sensor.map(|sensor| sensor.name.clone());
        }
        let lidar = profile.lidar.as_ref();
        state.sensors[LIDAR].name = lidar.map(|lidar| lidar.name.clone());
        state
    }

    /// Folds an event into the state.
    pub(crate) fn take(&mut self, Stamped { at, event }: &Stamped) {
        self.now = *at;
        let notice = event.notice();
        let text = sentence(event, notice.as_ref());
        match (event, notice.filter(is_warning), text) {
            (SessionEvent::StepFailed { error, .. }, ..) => {
                self.forget_warnings(STEP_FAILED);
                let failure = Failure::from(error.as_ref());
                let failed = Finding::bad(STEP_FAILED, failure.to_string());
                let failed = failed.next_step(failure.what_to_do());
                push_bounded(&mut self.warnings, failed.at(*at));
            }
            (_, Some(notice), _) => push_bounded(&mut self.warnings, notice.finding.at(*at)),
            (.., Some(text)) => push_bounded(&mut self.said, text),
            (.., None) => {}
        }
        match event {
            SessionEvent::Board { message, sample } => self.message(message, sample.as_ref()),
            SessionEvent::Phase { phase } => self.enter(*phase),
            SessionEvent::Connected { board, .. } => {
                self.forget_warnings(STEP_FAILED);
                self.board.clone_from(board);
            }
            SessionEvent::TwistStarted {
                length_s,
                enough_us,
                ..
            } => self.twist = Some((Coach::default(), *length_s, *enough_us)),
            SessionEvent::TwistFinished { .. } => self.twist = None,
            SessionEvent::ClockKnown { place, clock, .. } => {
                self.forget_warnings(EventKind::TwistRefused);
                if let Some(phone) = self.phones.get_mut(*place) {
                    phone.clock = Some(*clock);
                }
            }
            SessionEvent::Placed { phone, placement } => {
                let mut phones = self.phones.iter_mut();
                if let Some(phone) = phones.find(|known| known.name == phone.name) {
                    phone.placement = Some(*placement);
                }
            }
            SessionEvent::Aligning { alignment, .. } => self.alignment = Some(*alignment),
            SessionEvent::RecordingStarted { length_s } => self.length_s = *length_s,
            SessionEvent::Marked { marked_at, label } => {
                self.mark = Some((*marked_at, label.clone()));
            }
            SessionEvent::TwistDue { .. } => self.is_twist_due = true,
            SessionEvent::Tracked { tracked } => self.tracked = *tracked,
            SessionEvent::Disk { free, recorded } => self.disk(*free, *recorded),
            SessionEvent::Lost { count, .. } => self.losses.messages += u64::from(*count),
            SessionEvent::Damaged { .. } => self.losses.damaged += 1,
            SessionEvent::LinkLost { patience_s, .. } => {
                self.link_lost = Some((Instant::now(), *patience_s));
                self.losses.reconnects += 1;
            }
            SessionEvent::LinkBack { .. } => self.link_lost = None,
            SessionEvent::Downloading { done, whole, .. } => {
                self.download = Some((*done, *whole));
            }
            SessionEvent::VideoFetched { .. } => self.download = None,
            _ => {}
        }
    }

    /// Drops the warnings of a kind, whose cause is gone.
    fn forget_warnings(&mut self, kind: impl Into<FindingKind>) {
        let kind = kind.into();
        self.warnings.retain(|warning| warning.kind != kind);
    }

    fn enter(&mut self, phase: Phase) {
        self.forget_warnings(STEP_FAILED);
        self.phase = Some(phase);
        self.twist = None;
        self.download = None;
        if let Phase::Recording { .. } = phase {
            // As the session file counts.
            self.losses = Losses {
                reconnects: self.losses.reconnects,
                ..Losses::default()
            };
        }
    }

    fn message(&mut self, message: &DeviceToHost, sample: Option<&Sample>) {
        match message {
            DeviceToHost::Imu(raw) => {
                self.imu.add(raw.at);
                if let Some(sample) = sample {
                    self.sample(sample);
                }
            }
            DeviceToHost::Pulse(pulse) if pulse.output.is_camera() => {
                self.pulses.add(pulse.at);
                self.trigger.pulse = Some(pulse.number);
                let ns = |ticks: i32| f64::from(ticks) * 1e9 / f64::from(TICK_HZ);
                self.trigger.readback_ns = pulse.readback.map(ns);
                self.last_pulse = Some(pulse.at);
            }
            DeviceToHost::Pulse(pulse) => {
                let place = Output::AUXILIARY.iter().position(|&of| of == pulse.output);
                if let Some(sensor) = place.and_then(|place| self.sensors.get_mut(place)) {
                    sensor.rate.add(pulse.at);
                    sensor.pulse = Some(pulse.number);
                }
            }
            DeviceToHost::Pps(pps) => {
                let lidar = &mut self.sensors[LIDAR];
                lidar.rate.add(pps.at);
                lidar.pulse = Some(lidar.pulse.map_or(1, |pulses| pulses.saturating_add(1)));
                lidar.utc = Some(pps.utc);
            }
            DeviceToHost::Capture(capture) => self.captures.add(capture.at),
            DeviceToHost::Status(status) => self.status(status),
            DeviceToHost::Hello(_)
            | DeviceToHost::Arrived(_)
            | DeviceToHost::Answer(_)
            | DeviceToHost::Filler(_) => {}
        }
    }

    fn sample(&mut self, sample: &Sample) {
        self.temperature = Some(sample.temperature);
        if let Some((coach, ..)) = &mut self.twist {
            coach.add(sample.at.as_secs_f64(), sample.gyro);
        }
        let last = self.gyro.back();
        if last.is_none_or(|(last, _)| sample.at.0.abs_diff(last.0) >= POINT) {
            self.gyro.push_back((sample.at, sample.gyro));
            drop_before(&mut self.gyro, sample.at, SHOWN, |(at, _)| *at);
        }
    }

    fn status(&mut self, status: &Status) {
        self.load_percent = f64::from(status.cpu_permille) / 10.0;
        self.imu_runs = Some(status.imu.state == ImuState::Running);
        for (sensor, status) in self.sensors.iter_mut().zip(&status.outputs) {
            sensor.state = Some(status.state);
            sensor.late = status.late;
        }
        let lidar = &mut self.sensors[LIDAR];
        lidar.state = Some(status.gnss.state);
        lidar.late = status.gnss.late.saturating_add(status.gnss.missed);
        let (train, trigger) = (&status.trigger, &mut self.trigger);
        let runs = train.state != TrainState::Stopped;
        trigger.state = state_word(train.state).to_owned();
        trigger.fps = runs.then(|| train.period.as_secs_f64().recip());
        trigger.readback_ns = trigger.readback_ns.filter(|_| runs);
        trigger.readback_missing = train.readback.missing;
        trigger.late = train.late;
    }

    /// Updates the free space, and the time for which it lasts while the recording grows.
    fn disk(&mut self, free: u64, recorded: u64) {
        let (since, first) = *self.growth_from.get_or_insert((self.now, recorded));
        let time = self.now.0.saturating_sub(since.0);
        let grown = recorded.saturating_sub(first);
        let per_second = grown as f64 * f64::from(TICK_HZ) / time as f64;
        let left_s = (time > SIZE_TICKS && grown > 0).then(|| free as f64 / per_second);
        self.disk = Some(Disk { free, left_s });
    }
}

/// Returns true if the screen shows an event as a warning: if something is wrong in the
/// recording, or the operator is shown that something is not as it should be.
fn is_warning(notice: &Notice) -> bool {
    let finding = &notice.finding;
    let is_doubtful = notice.is_shown && finding.severity != Severity::Good;
    notice.is_problem || finding.next_step.is_some() || is_doubtful
}
