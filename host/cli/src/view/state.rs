//! The state of a session or of a board: events are folded into it, in order. Pure.

use std::collections::VecDeque;

use board::imu::Sample;
use protocol::{DeviceToHost, ImuState, Output, Period, Status, TICK_HZ, Ticks, TrainState};
use recording::finding::Finding;
use recording::profile::Profile;
use recording::session_file::{Alignment, Placement};
use serde::Serialize;
use session::alignment::phase_sigma_us_now;
use session::event::{Phase, SessionEvent, Stamped, Tracked};
use timebase::{BoardSeconds, ClockModel};
use twist_sync::coach::Coach;

use super::sentences::sentence;
use crate::advice::remedy;

/// Length of the gyroscope that is shown, ticks.
const SHOWN: u64 = 10 * TICK_HZ as u64;

/// Interval of the points that are shown, ticks: 40 ms.
const POINT: u64 = TICK_HZ as u64 / 25;

/// Rates are those over this time, ticks.
const RATE_TIME: u64 = 2 * TICK_HZ as u64;

/// The most warnings and sentences that are kept.
const KEPT: usize = 8;

/// The growth of a recording is judged after so much of it, ticks.
const SIZE_TICKS: u64 = 5 * TICK_HZ as u64;

/// The latest state of everything.
#[derive(Clone, Debug, Default)]
pub(crate) struct State {
    /// The board's ID.
    pub(crate) board: String,
    /// Latest board time.
    pub(crate) now: Ticks,
    /// True if somebody is asked.
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
    is_link_lost: bool,
    /// Bytes of a download that are there, and in all.
    download: Option<(u64, u64)>,
    /// Length of the recording, s; until stopped if there is none.
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
    /// Messages that the board had dropped when counting began.
    dropped_before: Option<u64>,
    /// Time and size of the recording when its growth was first seen.
    growth_from: Option<(Ticks, u64)>,
    /// Outputs 2 to 4, then the lidar.
    sensors: [Connected; 4],
}

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
    /// 1-sigma of the grid against the phone's frames now, µs, without that of the constant
    /// between the cameras.
    pub(crate) sigma_us: f64,
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
    pub(crate) clock: Option<ClockModel>,
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

/// A sensor on a further trigger output, or a lidar.
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
    /// Of these, dropped by the board itself.
    pub(crate) dropped: u64,
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
    /// Tells whether the motion so far suffices.
    pub(crate) fn is_enough(&self) -> bool {
        self.sigma_us.is_some_and(|sigma| sigma <= self.enough_us)
    }

    /// Advice to the person, in words.
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

/// Times of the messages of one stream, to count them.
#[derive(Clone, Debug, Default)]
struct Rate(VecDeque<Ticks>);

impl Rate {
    fn add(&mut self, at: Ticks) {
        self.0.push_back(at);
        drop_before(&mut self.0, at, RATE_TIME, |at| *at);
    }

    fn per_second(&self, now: Ticks) -> f64 {
        let is_recent = |at: &&Ticks| now.0.saturating_sub(at.0) <= RATE_TIME;
        let recent = self.0.iter().filter(is_recent).count();
        match (self.0.front(), self.0.back()) {
            (Some(first), Some(last)) if recent > 1 && last.0 > first.0 => {
                (recent - 1) as f64 * f64::from(TICK_HZ) / (last.0 - first.0) as f64
            }
            _ => 0.0,
        }
    }
}

/// Drops the items from the front that are farther than `most` ticks from the latest.
fn drop_before<T>(items: &mut VecDeque<T>, latest: Ticks, most: u64, time: fn(&T) -> Ticks) {
    while items
        .front()
        .is_some_and(|first| latest.0.abs_diff(time(first).0) > most)
    {
        items.pop_front();
    }
}

fn keep<T>(list: &mut VecDeque<T>, item: T) {
    list.push_back(item);
    if list.len() > KEPT {
        list.pop_front();
    }
}

/// Place of the lidar among the sensors.
const LIDAR: usize = 3;

/// Something on a further output.
#[derive(Clone, Debug, Default)]
struct Connected {
    name: Option<String>,
    rate: Rate,
    state: Option<TrainState>,
    pulse: Option<u64>,
    late: u32,
    utc: Option<i64>,
}

impl Connected {
    /// Gives its picture, if there is anything to it.
    fn shown(&self, place: usize, now: Ticks) -> Option<Sensor> {
        let runs = self.state.is_some_and(|state| state != TrainState::Stopped);
        if self.name.is_none() && self.pulse.is_none() && !runs {
            return None;
        }
        let at = match place {
            LIDAR => String::from("gnss"),
            _ => format!("output {}", place + 2),
        };
        Some(Sensor {
            name: self.name.clone().unwrap_or_else(|| at.clone()),
            at,
            state: self.state.map_or("", state_word).to_owned(),
            rate: self.rate.per_second(now),
            pulse: self.pulse,
            late: self.late,
            utc: self.utc,
        })
    }
}

const fn state_word(state: TrainState) -> &'static str {
    match state {
        TrainState::Stopped => "stopped",
        TrainState::Running => "running",
        TrainState::Slewing => "aligning",
        TrainState::Waiting => "waiting",
    }
}

impl State {
    /// A session on this rig that begins; `asks` says whether somebody is asked.
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

    /// A board with this ID that is monitored; the profile has its sensors' names.
    pub(crate) fn of_board(board: String, profile: Option<&Profile>) -> Self {
        let mut state = Self {
            board,
            ..Self::default()
        };
        let Some(profile) = profile else {
            return state;
        };
        for (place, output) in state.sensors.iter_mut().zip(Output::FURTHER) {
            let mut sensors = profile.outputs.iter();
            let sensor = sensors.find(|sensor| sensor.output == output.number());
            place.name = sensor.map(|sensor| sensor.name.clone());
        }
        let lidar = profile.lidar.as_ref();
        state.sensors[LIDAR].name = lidar.map(|lidar| lidar.name.clone());
        state
    }

    /// Takes an event.
    pub(crate) fn take(&mut self, Stamped { at, event }: &Stamped) {
        self.now = *at;
        if let Some(text) = sentence(event) {
            keep(&mut self.said, text);
        }
        if is_warned_of(event) {
            let kind = event.kind().unwrap_or_default();
            let warning = Finding::new(event.severity(), kind, event.to_string());
            keep(&mut self.warnings, warning.at(*at).next_step(remedy(kind)));
        }
        match event {
            SessionEvent::Board { message, sample } => self.message(message, sample.as_ref()),
            SessionEvent::Phase { phase } => self.enter(*phase),
            SessionEvent::Connected { board, .. } => self.board.clone_from(board),
            SessionEvent::TwistStarted {
                length_s,
                enough_us,
                ..
            } => self.twist = Some((Coach::default(), *length_s, *enough_us)),
            SessionEvent::TwistFinished { .. } => self.twist = None,
            SessionEvent::ClockKnown { place, clock, .. } => {
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
            SessionEvent::LinkLost { .. } => {
                self.is_link_lost = true;
                self.losses.reconnects += 1;
            }
            SessionEvent::LinkBack { .. } => self.is_link_lost = false,
            SessionEvent::Downloading { done, whole, .. } => {
                self.download = Some((*done, *whole));
            }
            SessionEvent::VideoFetched { .. } => self.download = None,
            _ => {}
        }
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = Some(phase);
        self.twist = None;
        self.download = None;
        if let Phase::Recording { .. } = phase {
            // As the session file counts.
            self.losses = Losses {
                reconnects: self.losses.reconnects,
                ..Losses::default()
            };
            self.dropped_before = None;
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
                let place = Output::FURTHER.iter().position(|&of| of == pulse.output);
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
        let sum = status.dropped.total();
        let before = self.dropped_before.map_or(sum, |before| before.min(sum));
        self.dropped_before = Some(before);
        self.losses.dropped = sum - before;
    }

    /// Free space, and how long it lasts at the rate at which the recording grows.
    fn disk(&mut self, free: u64, recorded: u64) {
        let (since, first) = *self.growth_from.get_or_insert((self.now, recorded));
        let time = self.now.0.saturating_sub(since.0);
        let grown = recorded.saturating_sub(first);
        let per_second = grown as f64 * f64::from(TICK_HZ) / time as f64;
        let left_s = (time > SIZE_TICKS && grown > 0).then(|| free as f64 / per_second);
        self.disk = Some(Disk { free, left_s });
    }

    /// Names what is done, in a word or two.
    pub(crate) fn doing(&self) -> String {
        if self.is_link_lost {
            return String::from("link lost");
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
            _ if self.asks => Keys::Answer,
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
        if alignment.arrival.is_none_or(|arrival| at < arrival) {
            return None;
        }
        let off = Period(alignment.period_q32).phase_error(alignment.anchor, at);
        let off_us = off.0 as f64 * 1e6 / f64::from(TICK_HZ);
        let now = BoardSeconds::from(self.now);
        let untracked_us = || phase_sigma_us_now(alignment, now, self.temperature);
        Some(PhaseNow {
            phase_us: self.tracked.map_or(off_us, |tracked| tracked.phase_us),
            sigma_us: self
                .tracked
                .map_or_else(untracked_us, |tracked| tracked.sigma_us),
            is_twist_due: self.is_twist_due,
            tracked: self.tracked,
        })
    }

    /// The relation of a phone's clock now.
    pub(crate) fn clock_now(&self, phone: &Phone) -> Option<ClockNow> {
        let clock = phone.clock?;
        let now = BoardSeconds::from(self.now);
        let offset = clock.offset_at(now);
        Some(ClockNow {
            offset_s: offset.value,
            sigma_us: offset.sigma * 1e6,
            skew_ppm: clock.skew * 1e6,
            age_s: now.0 - clock.reference.0,
        })
    }

    /// Gives what the further trigger outputs and the lidar do.
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

/// Tells whether the person is warned of an event until the end: of what is wrong in the
/// recording, and of what they can do something about.
fn is_warned_of(event: &SessionEvent) -> bool {
    event.is_problem()
        || matches!(
            event,
            SessionEvent::BoardQuiet { .. }
                | SessionEvent::DiskNearlyFull { .. }
                | SessionEvent::PhoneAway { .. }
                | SessionEvent::TrackLost
                | SessionEvent::TwistDue { .. }
        )
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::sync::Arc;

    use recording::session_file::{FramePeriodSource, RateChange};
    use session::error::SessionError;
    use session::event::{PhoneName, Step};
    use timebase::Wander;

    fn at(seconds: f64, event: SessionEvent) -> Stamped {
        let at = BoardSeconds(seconds).ticks();
        Stamped { at, event }
    }

    fn message(at: Ticks, message: DeviceToHost) -> Stamped {
        let event = SessionEvent::Board {
            message,
            sample: None,
        };
        Stamped { at, event }
    }

    fn pulse(output: Output, k: u64, at: Ticks) -> Stamped {
        let pulse = protocol::Pulse {
            output,
            seq: k as u32,
            train: 1,
            number: k,
            at,
            aligned: true,
            readback: None,
        };
        message(at, DeviceToHost::Pulse(pulse))
    }

    fn clock_since(reference: f64) -> ClockModel {
        ClockModel {
            reference: BoardSeconds(reference),
            offset: 94_000.25,
            skew: -15.2e-6,
            covariance: [[3.1e-6 * 3.1e-6, 0.0], [0.0, 0.0]],
            wander: Wander::default(),
        }
    }

    /// A train of 30 fps whose grid has an edge at so many seconds, and arrives there.
    fn aligned(clock: ClockModel, seconds: f64) -> Alignment {
        let anchor = BoardSeconds(seconds).ticks();
        Alignment {
            exposure_us: 0.0,
            middle_row_us: 0.0,
            center_offset_us: 0.0,
            bias_us: 0.0,
            constant_sigma_us: None,
            frame_period_ns: 1e9 / 30.0,
            frame_period_sigma_ns: None,
            frame_jitter_ns: None,
            frame_period_source: FramePeriodSource::Learnt,
            clock,
            change: RateChange::default(),
            board_temperature_c: None,
            anchor,
            period_q32: Period::from_ticks(1_600_000).0,
            phase_sigma_us: 3.0,
            drift_sigma_us_per_min: 1.0,
            arrival_pulse: Some(100),
            arrival: Some(anchor),
        }
    }

    /// A state in which there is something in every place.
    pub(in crate::view) fn busy() -> State {
        let text = "[[outputs]]\noutput = 3\nname = \"side\"\nevery = 6\n\
                    [lidar]\nname = \"VLP-16\"\n\
                    [[phones]]\nname = \"right phone\"\naddress = \"x\"\n";
        let profile = Profile::parse(text, None).unwrap();
        let mut state = State::of_session(&profile, true);
        state.board = String::from("0123456789ABCDEF01234567");
        state.now = BoardSeconds(123.0).ticks();
        state.phase = Some(Phase::Recording {
            since: BoardSeconds(62.0).ticks(),
        });
        state.length_s = Some(300.0);
        for k in 0..250 {
            let at = 113.0 + f64::from(k) * 0.04;
            let rate = [at.sin(), at.cos(), 0.3];
            state.gyro.push_back((BoardSeconds(at).ticks(), rate));
        }
        state.trigger = Trigger {
            state: String::from("running"),
            fps: Some(30.0024),
            pulse: Some(3_456),
            readback_ns: Some(83.0),
            readback_missing: 0,
            late: 0,
        };
        state.alignment = Some(aligned(clock_since(23.0), 60.0));
        state.last_pulse = Some(BoardSeconds(122.0).ticks());
        state.phones[0].clock = Some(clock_since(23.0));
        state.phones[1].placement = Some(Placement {
            offset_us: 1_234.0,
            offset_sigma_us: 5.0,
            drift_us_per_min: 0.0,
            drift_sigma_us_per_min: 0.0,
        });
        state.disk = Some(Disk {
            free: 40_000_000_000,
            left_s: Some(3_600_000.0),
        });
        state.mark = Some((BoardSeconds(90.0).ticks(), String::from("door")));
        let lost = Finding::check("imu_gap", "2 IMU samples lost").next_step("nothing to do");
        let lost = lost.at(BoardSeconds(99.0).ticks());
        state.warnings.push_back(lost);
        state.said.push_back(String::from("mark: door"));
        let side = &mut state.sensors[1];
        side.state = Some(TrainState::Running);
        side.pulse = Some(77);
        (0..11).for_each(|k| {
            side.rate
                .add(BoardSeconds(121.0 + 0.2 * f64::from(k)).ticks())
        });
        let lidar = &mut state.sensors[LIDAR];
        lidar.utc = Some(1_795_234_567);
        (0..3).for_each(|k| lidar.rate.add(BoardSeconds(121.0 + f64::from(k)).ticks()));
        state
    }

    pub(in crate::view) fn begin_twist(state: &mut State) {
        state.twist = Some((Coach::default(), 9, 10.0));
    }

    #[test]
    fn at_rest_the_advice_is_to_twist_faster() {
        let mut state = State::default();
        state.take(&at(
            1.0,
            SessionEvent::TwistStarted {
                number: 1,
                length_s: 7,
                enough_us: 10.0,
            },
        ));
        assert_eq!(state.twist().unwrap().advice(), "twist faster");
        state.take(&at(8.0, SessionEvent::TwistFinished { number: 1 }));
        assert_eq!(state.twist(), None);
    }

    #[test]
    fn sensors_are_shown_by_name_once_there_is_something_to_them() {
        let text = "[[outputs]]\noutput = 3\nname = \"side\"\nevery = 6\n\
                    [lidar]\nname = \"VLP-16\"\n";
        let profile = Profile::parse(text, None).unwrap();
        for (profile, names) in [
            (None, &["output 3", "gnss"]),
            (Some(&profile), &["side", "VLP-16"]),
        ] {
            let mut state = State::of_board(String::new(), profile);
            for k in 0..11 {
                state.take(&pulse(Output::Three, k, Ticks(k * 9_600_000)));
            }
            let pps = protocol::Pps {
                seq: 0,
                at: Ticks(96_000_000),
                utc: 1_795_234_567,
            };
            state.take(&message(pps.at, DeviceToHost::Pps(pps)));
            let sensors = state.sensors();
            let shown: Vec<&str> = sensors.iter().map(|sensor| sensor.name.as_str()).collect();
            assert_eq!(shown, names);
            assert!((sensors[0].rate - 5.0).abs() < 1e-9);
            assert_eq!(sensors[0].pulse, Some(10));
            assert_eq!(
                (sensors[0].at.as_str(), sensors[1].at.as_str()),
                ("output 3", "gnss")
            );
            let utc = sensors[1].utc_text().unwrap();
            assert_eq!(utc, "2026-11-21 04:16:07 UTC");
        }
    }

    #[test]
    fn rates_are_those_of_the_last_seconds() {
        let mut rate = Rate::default();
        for k in 0..3_000_u64 {
            rate.add(Ticks(k * 96_000));
        }
        let now = Ticks(2_999 * 96_000);
        assert!((rate.per_second(now) - 500.0).abs() < 0.01);
        assert_eq!(rate.per_second(Ticks(now.0 + 10 * 48_000_000)), 0.0);
    }

    #[test]
    fn a_session_is_followed_from_its_first_question_to_its_grid() {
        let profile = Profile::published().unwrap();
        let mut state = State::of_session(&profile, true);
        let error = Arc::new(SessionError::NoScale);
        let step = Step::Connect;
        state.take(&at(0.0, SessionEvent::StepFailed { step, error }));
        assert!(state.said[0].contains("docs/flash.md"), "{:?}", state.said);
        assert_eq!(
            (state.doing().as_str(), state.keys()),
            ("connecting", Keys::Answer)
        );

        let clock = clock_since(10.0);
        let phone = PhoneName {
            name: profile.phone.name.clone(),
            is_only: true,
        };
        let place = 0;
        state.take(&at(
            10.0,
            SessionEvent::ClockKnown {
                place,
                phone,
                clock,
            },
        ));
        let now = state.clock_now(&state.phones[0]).unwrap();
        assert_eq!((now.offset_s, now.age_s), (94_000.25, 0.0));

        let alignment = aligned(clock, 20.0);
        let anchor = alignment.anchor;
        state.take(&at(
            19.0,
            SessionEvent::Aligning {
                shift_us: 5.0,
                frames: 10,
                alignment,
            },
        ));
        state.take(&pulse(Output::Camera, 99, Ticks(anchor.0 - 1_600_000)));
        assert_eq!(state.phase_now(), None);
        state.take(&pulse(Output::Camera, 100, Ticks(anchor.0 + 1_600_048)));
        let phase = state.phase_now().unwrap();
        assert!((phase.phase_us - 1.0).abs() < 1e-9, "{phase:?}");

        let lost = |count| SessionEvent::Lost {
            stream: String::from("pulses"),
            count,
        };
        state.take(&at(20.1, lost(3)));
        let since = BoardSeconds(20.5).ticks();
        let phase = Phase::Recording { since };
        state.take(&at(20.5, SessionEvent::Phase { phase }));
        let length_s = Some(60.0);
        state.take(&at(20.5, SessionEvent::RecordingStarted { length_s }));
        state.take(&at(22.5, lost(2)));
        assert_eq!(state.losses.messages, 2);
        assert_eq!(state.recorded_s(), Some((2.0, Some(60.0))));
        let reason = String::from("unplugged");
        state.take(&at(23.0, SessionEvent::LinkLost { reason }));
        assert_eq!(state.doing(), "link lost");
        assert!(
            state.warnings[0]
                .next_step
                .as_ref()
                .unwrap()
                .contains("USB")
        );
        state.take(&at(24.0, SessionEvent::LinkBack { away_s: 1.0 }));
        assert_eq!(
            (state.doing().as_str(), state.losses.reconnects),
            ("recording", 1)
        );
    }
}
