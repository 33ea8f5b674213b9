//! Messages in, the latest state out.

use session::alignment::phase_sigma_us_now;
use std::collections::VecDeque;

use protocol::{DeviceToHost, ImuState, Output, Period, TICK_HZ, Ticks, TrainState};

use super::{Clock, Losses, OtherPhone, Sensor, Snapshot, Twist, Warning, todo_for};
use crate::tracked::Tracked;
use board::imu::{Sample, Scale};
use recording::profile::Profile;
use recording::session_file::{self, Alignment};
use timebase::{BoardSeconds, ClockModel};
use twist_sync::coach::Coach;

/// How much of the gyroscope is shown, ticks.
const SHOWN: u64 = 10 * TICK_HZ as u64;

/// Distance of the points that are shown, ticks: 40 ms.
const POINT: u64 = TICK_HZ as u64 / 25;

/// Rates are those over this time, ticks.
const RATE_TIME: u64 = 2 * TICK_HZ as u64;

/// How many warnings, marks and lines are kept.
const KEPT: usize = 8;

/// Times of the messages of one stream, to count them.
#[derive(Clone, Debug, Default)]
struct Rate(VecDeque<Ticks>);

impl Rate {
    fn add(&mut self, at: Ticks) {
        self.0.push_back(at);
        while self
            .0
            .front()
            .is_some_and(|first| at.0.saturating_sub(first.0) > RATE_TIME)
        {
            self.0.pop_front();
        }
    }

    fn per_second(&self, now: Ticks) -> f64 {
        let recent = self
            .0
            .iter()
            .filter(|at| now.0.saturating_sub(at.0) <= RATE_TIME)
            .count();
        match (self.0.front(), self.0.back()) {
            (Some(first), Some(last)) if recent > 1 && last.0 > first.0 => {
                (recent - 1) as f64 * f64::from(TICK_HZ) / (last.0 - first.0) as f64
            }
            _ => 0.0,
        }
    }
}

/// The latest state of everything.
#[derive(Clone, Debug, Default)]
pub(crate) struct Gauge {
    /// What is known at once; [`Gauge::snapshot`] adds the rest.
    pub(crate) latest: Snapshot,
    gyro: VecDeque<(Ticks, [f64; 3])>,
    last_pulse: Option<Ticks>,
    imu: Rate,
    pulses: Rate,
    captures: Rate,
    /// What the board had dropped when counting began.
    dropped_before: Option<u64>,
    coach: Option<(Coach, f64, f64)>,
    /// Outputs 2 to 4, then the lidar.
    sensors: [Connected; 4],
    /// 1-sigma of a phase above which a twist is due, µs.
    enough_us: Option<f64>,
    /// The phase, where the phone's clock is followed.
    pub(crate) tracked: Option<Tracked>,
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
    /// What is shown of it, if there is anything to it.
    fn shown(&self, place: usize, now: Ticks) -> Option<Sensor> {
        let runs = self.state.is_some_and(|state| state != TrainState::Stopped);
        if self.name.is_none() && self.pulse.is_none() && !runs {
            return None;
        }
        let at = if place == LIDAR {
            String::from("gnss")
        } else {
            format!("output {}", place + 2)
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

impl Gauge {
    /// What the sensors of a rig are called, and how well clocks must be known.
    pub(crate) fn know_rig(&mut self, profile: &Profile) {
        self.enough_us = Some(profile.align.max_offset_sigma_us);
        for (place, output) in self.sensors.iter_mut().zip(Output::FURTHER) {
            let mut sensors = profile.outputs.iter();
            let sensor = sensors.find(|sensor| sensor.output == output.number());
            place.name = sensor.map(|sensor| sensor.name.clone());
        }
        let lidar = profile.lidar.as_ref();
        self.sensors[LIDAR].name = lidar.map(|lidar| lidar.name.clone());
    }

    /// What is connected to a further output.
    fn sensor(&mut self, output: Output) -> Option<&mut Connected> {
        let place = Output::FURTHER.iter().position(|&of| of == output)?;
        self.sensors.get_mut(place)
    }

    /// What a session knows of its further phones by now.
    pub(crate) fn know_phones(&mut self, phones: &[session_file::OtherPhone]) {
        let now = BoardSeconds::from(self.latest.now);
        self.latest.phones = phones
            .iter()
            .map(|phone| OtherPhone {
                name: phone.name.clone(),
                clock: phone.clock.as_ref().map(|clock| clock_at(clock, now)),
                placement_us: phone
                    .placement
                    .map(|placed| (placed.offset_us, placed.offset_sigma_us)),
            })
            .collect();
    }

    /// A message of the board.
    pub(crate) fn take(&mut self, message: &DeviceToHost, scale: Option<&Scale>) {
        match message {
            DeviceToHost::Imu(raw) => {
                self.time(raw.at);
                self.imu.add(raw.at);
                if let Some(scale) = scale {
                    self.sample(&scale.apply(raw));
                }
            }
            DeviceToHost::Pulse(pulse) if pulse.output.is_camera() => {
                self.time(pulse.at);
                self.pulses.add(pulse.at);
                self.latest.trigger.pulse = Some(pulse.number);
                self.latest.trigger.readback_ns = pulse
                    .readback
                    .map(|ticks| f64::from(ticks) * 1e9 / f64::from(TICK_HZ));
                self.last_pulse = Some(pulse.at);
            }
            DeviceToHost::Capture(capture) => {
                self.time(capture.at);
                self.captures.add(capture.at);
            }
            DeviceToHost::Status(status) => {
                self.time(status.at);
                self.latest.rates.load_percent = f64::from(status.cpu_permille) / 10.0;
                self.latest.rates.imu_running = Some(status.imu.state == ImuState::Running);
                for (sensor, status) in self.sensors.iter_mut().zip(&status.outputs) {
                    sensor.state = Some(status.state);
                    sensor.late = status.late;
                }
                let lidar = &mut self.sensors[LIDAR];
                lidar.state = Some(status.gnss.state);
                lidar.late = status.gnss.late.saturating_add(status.gnss.missed);
                let (train, trigger) = (&status.trigger, &mut self.latest.trigger);
                trigger.state = state_word(train.state).to_owned();
                trigger.fps = (train.state != TrainState::Stopped)
                    .then(|| train.period.as_secs_f64().recip());
                trigger.readback_missing = train.readback.missing;
                trigger.late = train.late;
                if train.state == TrainState::Stopped {
                    trigger.readback_ns = None;
                }
                let sum = status.dropped.total();
                let before = self.dropped_before.map_or(sum, |before| before.min(sum));
                self.dropped_before = Some(before);
                self.latest.losses.dropped = sum - before;
            }
            DeviceToHost::Hello(hello) => {
                // After a reset of the board its time is an earlier one.
                self.latest.now = hello.now;
            }
            DeviceToHost::Pulse(pulse) => {
                self.time(pulse.at);
                if let Some(sensor) = self.sensor(pulse.output) {
                    sensor.rate.add(pulse.at);
                    sensor.pulse = Some(pulse.number);
                }
            }
            DeviceToHost::Pps(pps) => {
                self.time(pps.at);
                let lidar = &mut self.sensors[LIDAR];
                lidar.rate.add(pps.at);
                lidar.pulse = Some(lidar.pulse.map_or(1, |pulses| pulses.saturating_add(1)));
                lidar.utc = Some(pps.utc);
            }
            DeviceToHost::Arrived(_) | DeviceToHost::Answer(_) | DeviceToHost::Filler(_) => {}
        }
    }

    fn time(&mut self, at: Ticks) {
        self.latest.now = self.latest.now.max(at);
    }

    fn sample(&mut self, sample: &Sample) {
        self.latest.rates.temperature = Some(sample.temperature);
        if let Some((coach, ..)) = &mut self.coach {
            coach.add(sample.at.as_secs_f64(), sample.gyro);
        }
        if self
            .gyro
            .back()
            .is_some_and(|(last, _)| sample.at.0.abs_diff(last.0) < POINT)
        {
            return;
        }
        self.gyro.push_back((sample.at, sample.gyro));
        while self
            .gyro
            .front()
            .is_some_and(|(first, _)| sample.at.0.abs_diff(first.0) > SHOWN)
        {
            self.gyro.pop_front();
        }
    }

    /// Messages that are missing.
    pub(crate) const fn lost(&mut self, count: u32) {
        let messages = &mut self.latest.losses.messages;
        *messages = messages.saturating_add(count as u64);
    }

    /// A damaged frame.
    pub(crate) const fn damaged(&mut self) {
        let damaged = &mut self.latest.losses.damaged;
        *damaged = damaged.saturating_add(1);
    }

    /// What was lost is counted from here on.
    pub(crate) fn start_counting(&mut self) {
        self.latest.losses = Losses {
            reconnects: self.latest.losses.reconnects,
            ..Losses::default()
        };
        self.dropped_before = None;
    }

    /// A mark of the user.
    pub(crate) fn marker(&mut self, at: Ticks, label: &str) {
        keep(&mut self.latest.markers, (at, label.to_owned()));
    }

    /// Something went wrong. `kind` is its stable word.
    pub(crate) fn warning(&mut self, kind: &str, text: &str) {
        let warning = Warning {
            at: self.latest.now,
            text: text.to_owned(),
            todo: todo_for(kind),
        };
        keep(&mut self.latest.warnings, warning);
    }

    /// A twist begins: so long in s, and what is enough in µs.
    pub(crate) fn begin_twist(&mut self, length_s: f64, enough_us: f64) {
        self.coach = Some((Coach::default(), length_s, enough_us));
    }

    /// It has ended.
    pub(crate) fn end_twist(&mut self) {
        self.coach = None;
    }

    /// Root mean square of each axis in the twist so far, rad/s.
    pub(crate) fn twist_rms(&self) -> [f64; 3] {
        let coach = self.coach.as_ref();
        coach.map_or([0.0; 3], |(coach, ..)| coach.rms())
    }

    /// How well the phase is known by a time: its 1-sigma, µs, and whether that is less
    /// well than a twist must know it.
    pub(crate) fn phase_known(&self, alignment: &Alignment, now: BoardSeconds) -> (f64, bool) {
        let sigma = match self.tracked {
            Some(tracked) => tracked.sigma_us,
            None => phase_sigma_us_now(alignment, now, self.latest.rates.temperature),
        };
        (sigma, self.enough_us.is_some_and(|enough| sigma > enough))
    }

    /// The latest state, with what only the session knows.
    pub(crate) fn snapshot(
        &self,
        clock: Option<&ClockModel>,
        alignment: Option<&Alignment>,
    ) -> Snapshot {
        let now = self.latest.now;
        let board_now = BoardSeconds::from(now);
        let mut snapshot = self.latest.clone();
        let trigger = &mut snapshot.trigger;
        if let (Some(alignment), Some(at)) = (alignment, self.last_pulse)
            && alignment.arrival.is_some_and(|arrival| at >= arrival)
        {
            let off = Period(alignment.period_q32)
                .phase_error(alignment.anchor, at)
                .0;
            let off_us = off as f64 * 1e6 / f64::from(TICK_HZ);
            trigger.phase_us = Some(self.tracked.map_or(off_us, |tracked| tracked.phase_us));
            trigger.tracked = self.tracked;
            let (sigma, twist_due) = self.phase_known(alignment, board_now);
            trigger.phase_sigma_us = Some(sigma);
            trigger.twist_due = twist_due;
        }
        let gyro = self.gyro.iter();
        snapshot.gyro = gyro.map(|(at, rate)| (at.as_secs_f64(), *rate)).collect();
        snapshot.clock = clock.map(|clock| clock_at(clock, board_now));
        snapshot.sensors = (0..)
            .zip(&self.sensors)
            .filter_map(|(place, sensor)| sensor.shown(place, now))
            .collect();
        snapshot.rates.imu = self.imu.per_second(now);
        snapshot.rates.pulses = self.pulses.per_second(now);
        snapshot.rates.captures = self.captures.per_second(now);
        let coach = self.coach.as_ref();
        snapshot.twist = coach.map(|(coach, length_s, enough_us)| Twist {
            elapsed_s: coach.elapsed_s(),
            length_s: *length_s,
            sigma_us: coach.sigma_s().map(|sigma| sigma * 1e6),
            enough_us: *enough_us,
            rms: coach.rms(),
        });
        snapshot
    }
}

fn clock_at(clock: &ClockModel, now: BoardSeconds) -> Clock {
    let offset = clock.offset_at(now);
    Clock {
        offset_s: offset.value,
        sigma_us: offset.sigma * 1e6,
        skew_ppm: clock.skew * 1e6,
        age_s: now.0 - clock.reference.0,
    }
}

fn keep<T>(list: &mut Vec<T>, item: T) {
    list.push(item);
    if list.len() > KEPT {
        list.remove(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_rest_the_advice_is_to_twist_faster() {
        let mut gauge = Gauge::default();
        gauge.begin_twist(7.0, 10.0);
        let twist = gauge.snapshot(None, None).twist.unwrap();
        assert_eq!(twist.advice(), "twist faster");
    }

    #[test]
    fn sensors_are_shown_by_name_once_there_is_something_to_them() {
        let mut gauge = Gauge::default();
        let pulse = |k: u64| {
            DeviceToHost::Pulse(protocol::Pulse {
                output: Output::Three,
                seq: k as u32,
                train: 1,
                number: k,
                at: Ticks(k * 9_600_000),
                aligned: true,
                readback: None,
            })
        };
        for k in 0..11 {
            gauge.take(&pulse(k), None);
        }
        let shown = |gauge: &Gauge| gauge.snapshot(None, None).sensors;
        let sensors = shown(&gauge);
        assert_eq!((sensors.len(), sensors[0].name.as_str()), (1, "output 3"));
        assert!((sensors[0].rate - 5.0).abs() < 1e-9);
        assert_eq!(sensors[0].pulse, Some(10));

        let text = "[[outputs]]\noutput = 3\nname = \"side\"\nevery = 6\n\
                    [lidar]\nname = \"VLP-16\"\n";
        gauge.know_rig(&Profile::parse(text, None).unwrap());
        gauge.take(
            &DeviceToHost::Pps(protocol::Pps {
                seq: 0,
                at: Ticks(96_000_000),
                utc: 1_795_234_567,
            }),
            None,
        );
        let sensors = shown(&gauge);
        let names: Vec<&str> = sensors.iter().map(|sensor| sensor.name.as_str()).collect();
        assert_eq!(names, ["side", "VLP-16"]);
        assert_eq!(
            (sensors[0].at.as_str(), sensors[1].at.as_str()),
            ("output 3", "gnss")
        );
        let utc = sensors[1].utc_text().unwrap();
        assert_eq!(utc, "2026-11-21 04:16:07 UTC");
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
}
