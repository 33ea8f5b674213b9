//! The depth camera as a subordinate of the trigger.
//!
//! It listens to the trigger pin (PA5), takes depth frames on a clock of its
//! own, and its infrared flashes come back on the strobe input (PA2) through a
//! photodiode. It keeps the ground truth of every frame.
//!
//! # What is modelled, and from where
//!
//! The vendor documents the electrical side and the nominal timing; the rest is
//! from reports of users, or not known and therefore a setting. What follows is the Azure
//! Kinect's; what other cameras ([`Family`]) do otherwise is in their settings: the pulse, the
//! delay, a shutter, and whether they go on when the pulses stop.
//!
//! - A pulse counts if it is high for *longer* than 8 µs (vendor). It is known
//!   to be one at the moment it exceeds that.
//! - The first frame comes on pulse 2 or 3 ([`DepthCameraConfig::first_frame`]).
//! - A frame's first flash follows its pulse by
//!   [`DepthCameraConfig::flash_delay`]: not documented, a setting.
//! - Flashes are those of the depth mode ([`DepthMode::flashes`]); the device timestamp is
//!   the middle of the middle flash, in whole ticks of 90 kHz of the camera's
//!   clock, which is hundreds of ppm off.
//! - When the pulses stop it goes on streaming, one frame a nominal period of
//!   its own clock ([`Source::FreeRun`]).
//! - A pulse that is off its expected place by more than
//!   `TOLERANCE` disturbs it: frames of that time are marked
//!   bad (black or purple images were reported). It takes up the new phase at
//!   once; pulses closer than half a period to a frame make no frame of their
//!   own. How a real camera behaves there is not known.
//! - Frames can get lost on their way to the computer
//!   ([`DepthCameraConfig::drop_probability`]): exposed and stamped, but not
//!   delivered; or spoilt at random ([`DepthCameraConfig::spoil_probability`]).
//! - The photodiode's output follows the light late, by another time when it comes than
//!   when it goes ([`DepthCameraConfig::photodiode_delay`]).
//!
//! Limits: an edge of the photodiode is one edge; images are not made here.

pub mod cable;
mod config;
mod family;
pub mod flash_log;
pub mod k4a_mkv;

use std::collections::VecDeque;
use std::sync::mpsc::Sender;

use serde::{Deserialize, Serialize};

use config::{BAD_FRAMES, TOLERANCE};
pub use config::{DepthCameraConfig, DepthMode};
pub use family::Family;
pub(crate) use family::micros;

use crate::clocks::oscillator::{BoardTime, Oscillator, TrueTime};
use crate::depth_camera::flash_log::{FlashLog, TrueFlash};
use crate::random::{Random, Seed, Stream};
use crate::wiring;
use stm32f4_sim::clock::Rate;
use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Drive, Level, Pin};
use stm32f4_sim::time::{SimDuration, SimTime, UNITS_PER_NANO, UNITS_PER_SECOND};

/// Device timestamps count at this rate, in the camera's time.
pub const TIMESTAMP_HZ: u64 = 90_000;

/// Cause of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Source {
    /// A pulse of the trigger.
    Pulse {
        /// Pulses that the camera accepted so far; the first is 1.
        number: u64,
        /// Its rising edge, in board time.
        edge: SimTime,
    },
    /// The camera's own clock, because no pulse came.
    FreeRun,
}

/// Ground truth of one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Counted from zero, lost frames included.
    pub number: u64,
    /// Its cause.
    pub source: Source,
    /// Start of its first flash, in board time.
    pub first_flash: SimTime,
    /// Centre of exposure, in board time.
    pub center: SimTime,
    /// Centre of exposure, in true time.
    pub center_true: TrueTime,
    /// Device timestamp: ticks of [`TIMESTAMP_HZ`] of the camera's clock at the
    /// centre of exposure, rounded down.
    pub device_ticks: u64,
    /// True if a disturbance spoilt its image.
    pub bad: bool,
    /// True if it reached the computer.
    pub delivered: bool,
}

/// A pulse that may still turn out to be too short.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    edge: SimTime,
    counts_from: SimTime,
}

/// Position of the camera in its stream; times are elapsed units of its own clock.
#[derive(Clone, Copy, Debug)]
enum State {
    /// Switched off.
    Off,
    /// Waiting for its first pulses, with the number of pulses so far.
    Waiting(u32),
    /// Streaming, with the time of the last pulse or of its replacement.
    Streaming { base: u64 },
}

/// The depth camera.
#[derive(Debug)]
pub struct DepthCamera {
    config: DepthCameraConfig,
    board: BoardTime,
    clock: Oscillator,
    state: State,
    candidate: Option<Candidate>,
    /// Time at which it stops waiting for the next pulse.
    deadline: Option<SimTime>,
    /// Count of its clock at the first pulse.
    first_pulse: Option<u64>,
    flash_log: Option<FlashLog>,
    /// Pending changes of the light.
    light: VecDeque<(SimTime, Level)>,
    /// Number of accepted pulses.
    pub pulses: u64,
    /// Number of pulses that were too short.
    pub short_pulses: u64,
    /// Number of pulses at an unexpected time.
    pub disturbances: u64,
    bad_left: u32,
    frames: VecDeque<FrameRecord>,
    /// Frames taken since power-on.
    pub frame_count: u64,
    /// Number of frames still to be lost.
    dropping: u32,
    random: Random,
    recorder: Option<Sender<FrameRecord>>,
}

impl DepthCamera {
    /// Creates a camera that waits for pulses from power-on.
    #[must_use]
    pub fn new(config: DepthCameraConfig, board: BoardTime, seed: Seed) -> Self {
        Self {
            clock: Oscillator::new(config.clock, seed.stream(Stream::CameraClock)),
            config,
            board,
            state: State::Waiting(0),
            candidate: None,
            deadline: None,
            first_pulse: None,
            flash_log: None,
            light: VecDeque::new(),
            pulses: 0,
            short_pulses: 0,
            disturbances: 0,
            bad_left: 0,
            frames: VecDeque::new(),
            frame_count: 0,
            dropping: 0,
            random: seed.stream(Stream::DepthCamera),
            recorder: None,
        }
    }

    /// Also sends each delivered frame to a recorder.
    pub(crate) fn record_into(&mut self, recorder: Sender<FrameRecord>) {
        self.recorder = Some(recorder);
    }

    /// Also writes every flash into `log` when it is planned, at least 9 µs before it happens, for
    /// the other cameras that see the light.
    #[must_use]
    pub(crate) fn with_flash_log(mut self, log: FlashLog) -> Self {
        self.flash_log = Some(log);
        self
    }

    /// Ends the stream. Frames and light already under way are finished.
    pub fn stop(&mut self) {
        self.state = State::Off;
        self.candidate = None;
        self.deadline = None;
    }

    /// Starts waiting for pulses, as when a recorder opens the camera.
    pub fn wait_for_pulses(&mut self) {
        self.stop();
        self.bad_left = 0;
        self.first_pulse = None;
        self.state = State::Waiting(0);
    }

    /// Returns the frames that were taken and not drained yet, oldest first.
    #[must_use]
    pub fn frames(&self) -> &VecDeque<FrameRecord> {
        &self.frames
    }

    /// Removes and returns the frames so far.
    pub fn take_frames(&mut self) -> Vec<FrameRecord> {
        self.frames.drain(..).collect()
    }

    /// Returns the camera's clock.
    #[must_use]
    pub fn clock(&self) -> &Oscillator {
        &self.clock
    }

    /// Returns the configuration.
    #[must_use]
    pub fn config(&self) -> &DepthCameraConfig {
        &self.config
    }

    /// Returns the nominal frame period, in units of the camera's clock.
    fn period(&self) -> u64 {
        UNITS_PER_SECOND / u64::from(DepthCameraConfig::FPS)
    }

    /// Returns the board time at which the camera's clock has counted `own` units.
    fn board_at(&self, own: u64) -> SimTime {
        self.board.board_at(self.clock.when_elapsed(own))
    }

    /// Returns the units that the camera's clock has counted at a board time.
    fn own_at(&self, at: SimTime) -> u64 {
        self.clock.elapsed_at(self.board.true_at(at))
    }

    /// Handles a rising edge that has stayed high for long enough.
    fn accept(&mut self, edge: SimTime) {
        self.pulses += 1;
        let own = self.own_at(edge);
        self.first_pulse.get_or_insert(own);
        let source = Source::Pulse {
            number: self.pulses,
            edge,
        };
        match self.state {
            State::Off => {}
            State::Waiting(before) => {
                let pulse = before + 1;
                if pulse >= self.config.first_frame {
                    self.expose(own, source);
                    self.follow(own);
                } else {
                    self.state = State::Waiting(pulse);
                }
            }
            State::Streaming { base } => {
                let since = own.saturating_sub(base);
                if since.abs_diff(self.period()) > TOLERANCE.units() {
                    self.disturbances += 1;
                    self.bad_left = BAD_FRAMES;
                    self.spoil_last_if_exposing(edge);
                }
                if since >= self.period() / 2 {
                    self.expose(own, source);
                }
                self.follow(own);
            }
        }
    }

    /// The next pulse is expected a period after `base`.
    fn follow(&mut self, base: u64) {
        self.state = State::Streaming { base };
        let patience = self.period() + TOLERANCE.units();
        let deadline = self.board_at(base + patience + 1);
        self.deadline = self.config.free_runs.then_some(deadline);
    }

    /// A disturbance within a frame spoils that frame.
    fn spoil_last_if_exposing(&mut self, at: SimTime) {
        let still_flashing = self.light.back().is_some_and(|(t, _)| *t > at);
        if let Some(frame) = self.frames.back_mut()
            && still_flashing
        {
            frame.bad = true;
        }
    }

    /// Returns the time at which the camera continues on its own clock: not while a pulse that may
    /// count is still high.
    fn patience_ends(&self) -> Option<SimTime> {
        self.deadline
            .filter(|deadline| self.candidate.is_none_or(|c| c.edge >= *deadline))
    }

    /// Continues on the camera's own clock, because no pulse came in time.
    fn free_run(&mut self) {
        if let State::Streaming { base } = self.state {
            let base = base + self.period();
            self.expose(base, Source::FreeRun);
            self.follow(base);
        }
    }

    /// Plans the flashes of a frame whose pulse is, or would be, at `base`.
    fn expose(&mut self, base: u64, source: Source) {
        let train = self.config.mode.flashes();
        let first = base + self.flash_delay();
        let units = |ns: i64| ns.unsigned_abs() * UNITS_PER_NANO;
        let (rise, fall) = self.config.photodiode_delay;
        for flash in train.starting_at(0) {
            let on = first + units(flash.start_ns);
            let off = on + units(flash.duration_ns);
            if let Some(log) = &self.flash_log {
                log.push(TrueFlash {
                    start: self.clock.when_elapsed(on),
                    end: self.clock.when_elapsed(off),
                });
            }
            let at = |local| self.board_at(local);
            let edges = [
                (at(on + rise.units()), Level::High),
                (at(off + fall.units()), Level::Low),
            ];
            self.light.extend(edges);
        }
        let center = first + units(train.center_offset_ns());
        let center_true = self.clock.when_elapsed(center);
        // No random number is drawn without a random effect, so that a seed keeps its frames.
        let spoilt = self.config.spoil_probability;
        let spoilt = spoilt > 0.0 && self.random.chance(spoilt);
        let bad = self.bad_left > 0 || spoilt;
        self.bad_left = self.bad_left.saturating_sub(1);
        let record = FrameRecord {
            number: self.frame_count,
            source,
            first_flash: self.board_at(first),
            center: self.board.board_at(center_true),
            center_true,
            device_ticks: self.device_ticks(center_true),
            bad,
            delivered: !self.is_dropped(),
        };
        self.frames.push_back(record);
        if let Some(recorder) = &self.recorder {
            // Without a recorder there is nothing to deliver.
            let _ = recorder.send(record);
        }
        self.frame_count += 1;
    }

    fn is_dropped(&mut self) -> bool {
        let at_once = self.config.dropped_at_once.max(1);
        let begins = self.config.drop_probability / f64::from(at_once);
        if self.random.chance(begins) && self.dropping == 0 {
            self.dropping = at_once;
        }
        let is_dropped = self.dropping > 0;
        self.dropping = self.dropping.saturating_sub(1);
        is_dropped
    }

    /// Returns the time from a pulse to the first flash of its frame, in units of the camera's
    /// clock.
    fn flash_delay(&mut self) -> u64 {
        let (delay, jitter) = (self.config.flash_delay, self.config.flash_jitter);
        if jitter == SimDuration::ZERO {
            return delay.units();
        }
        let sigmas = self.random.normal().clamp(-3.0, 3.0);
        let late = (sigmas * jitter.units() as f64) as i64;
        let earliest = self.config.earliest_flash().units();
        delay.units().saturating_add_signed(late).max(earliest)
    }

    /// Returns the camera's timestamp counter at a true time.
    fn device_ticks(&self, at: TrueTime) -> u64 {
        if let Some(first) = self
            .first_pulse
            .filter(|_| self.config.zeroed_at_first_pulse)
        {
            let since = u128::from(self.clock.elapsed_at(at).saturating_sub(first));
            let ticks = since * u128::from(TIMESTAMP_HZ) / u128::from(UNITS_PER_SECOND);
            return u64::try_from(ticks).unwrap_or(u64::MAX);
        }
        let offset = u128::from(self.config.clock.offset_ns.max(0).unsigned_abs());
        let offset = (offset * u128::from(TIMESTAMP_HZ) / 1_000_000_000) as u64;
        offset + self.clock.ticks_at(at, Rate::hz(TIMESTAMP_HZ))
    }
}

impl PinModel for DepthCamera {
    fn name(&self) -> String {
        "depth camera".to_owned()
    }

    fn watched_pins(&self) -> Vec<Pin> {
        vec![wiring::TRIGGER]
    }

    fn inputs(&self) -> Vec<(Pin, f64)> {
        vec![(wiring::TRIGGER, self.config.input_high)]
    }

    fn outputs(&self) -> Vec<(Pin, f64)> {
        vec![(wiring::STROBE, wiring::DIVIDED_HIGH)]
    }

    fn power_on(&mut self, io: &mut PinIo<'_>) {
        if self.config.photodiode {
            io.drive(wiring::STROBE, Drive::Low);
        }
    }

    fn on_pin_edge(&mut self, pin: Pin, level: Level, io: &mut PinIo<'_>) {
        if pin != wiring::TRIGGER {
            return;
        }
        if level.is_high() {
            let counts_from = io.now() + self.config.shortest_pulse + SimDuration::from_units(1);
            self.candidate = Some(Candidate {
                edge: io.now(),
                counts_from,
            });
        } else if self.candidate.take().is_some() {
            // The pulse fell before it counted.
            self.short_pulses += 1;
        }
    }

    fn next_event(&self) -> Option<SimTime> {
        [
            self.candidate.map(|c| c.counts_from),
            self.patience_ends(),
            self.light.front().map(|(t, _)| *t),
        ]
        .into_iter()
        .flatten()
        .min()
    }

    fn advance(&mut self, io: &mut PinIo<'_>) {
        let now = io.now();
        if let Some(candidate) = self.candidate.take_if(|c| c.counts_from <= now) {
            self.accept(candidate.edge);
        }
        if self.patience_ends().is_some_and(|t| t <= now) {
            self.free_run();
        }
        while self.light.front().is_some_and(|(t, _)| *t <= now) {
            if let Some((_, level)) = self.light.pop_front()
                && self.config.photodiode
            {
                io.drive(wiring::STROBE, level.into());
            }
        }
    }
}

#[cfg(test)]
mod tests;
