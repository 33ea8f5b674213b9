//! Delays of a question to a clock, and of the answer back.
//!
//! Each direction has a shortest delay with microseconds of scatter, often further waiting, and
//! now and then a tail of milliseconds. The shortest delay differs between the two directions,
//! wanders slowly, and steps: a screen goes off, a governor changes the clock of a processor, a
//! hub wakes. Sometimes there is no answer for seconds. All of this is drawn from ranges, as
//! nobody has measured it with a rig like this one; the page of model ranges has a row for each.

use crate::clocks::oscillator::TrueTime;
use crate::random::{Random, log_uniform};
use stm32f4_sim::time::SimDuration;

/// Ranges of a link's properties.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkRanges {
    /// Median of the round trip, s.
    pub median: (f64, f64),
    /// Scatter of the shortest ways, s.
    pub jitter: (f64, f64),
    /// Shortest round trip as a share of the median.
    pub least: (f64, f64),
    /// Share of it that is the way there.
    pub there: (f64, f64),
    /// Share of ways that have a tail.
    pub tailed: (f64, f64),
    /// Length of a tail: where it begins, s; it ends at [`LinkRanges::LONGEST_TAIL`].
    pub tail: (f64, f64),
    /// Steps an hour.
    pub steps: (f64, f64),
    /// Largest factor by which a step changes the shortest round trip.
    pub step: (f64, f64),
    /// Silences an hour.
    pub silences: (f64, f64),
    /// Length of one, s.
    pub silence: (f64, f64),
    /// Wander of the shortest delay of a direction, in units of its scatter.
    pub wander: (f64, f64),
}

/// One of the ranges of a link.
pub type Range = fn(&mut LinkRanges) -> &mut (f64, f64);

impl LinkRanges {
    /// All ranges, by name.
    pub const RANGES: [(&'static str, Range); 11] = [
        ("median of a round trip", |link| &mut link.median),
        ("scatter of the shortest ways", |link| &mut link.jitter),
        ("shortest round trip", |link| &mut link.least),
        ("share of the way there", |link| &mut link.there),
        ("share of ways with a tail", |link| &mut link.tailed),
        ("length of tails", |link| &mut link.tail),
        ("steps an hour", |link| &mut link.steps),
        ("size of steps", |link| &mut link.step),
        ("silences an hour", |link| &mut link.silences),
        ("length of silences", |link| &mut link.silence),
        ("slow wander of a way", |link| &mut link.wander),
    ];

    /// The longest tail, s.
    pub const LONGEST_TAIL: f64 = 0.08;

    /// An agent on the phone by `adb` over USB.
    pub const PHONE_USB: Self = Self {
        median: (0.5e-3, 2e-3),
        jitter: (5e-6, 50e-6),
        least: (0.4, 0.9),
        there: (0.3, 0.7),
        tailed: (0.002, 0.03),
        tail: (1e-3, 1e-2),
        steps: (0.0, 8.0),
        step: (1.05, 1.8),
        silences: (0.0, 4.0),
        silence: (1.0, 40.0),
        wander: (0.0, 0.3),
    };

    /// The same over Wi-Fi.
    pub const PHONE_WIFI: Self = Self {
        median: (2e-3, 10e-3),
        jitter: (50e-6, 250e-6),
        tailed: (0.01, 0.1),
        tail: (3e-3, 3e-2),
        ..Self::PHONE_USB
    };

    /// The board by its serial port over USB: a link of full speed, whose pings share it
    /// with its streams.
    pub const BOARD_USB: Self = Self {
        median: (0.3e-3, 1.5e-3),
        steps: (0.0, 2.0),
        silences: (0.0, 1.0),
        silence: (0.5, 10.0),
        ..Self::PHONE_USB
    };
}

/// One link, drawn from the ranges.
#[derive(Clone, Debug)]
pub struct Link {
    random: Random,
    /// Least time there and back, s.
    least: [f64; 2],
    jitter: f64,
    /// Median and spread of the body of one way, s and of its logarithm.
    body: (f64, f64),
    waits: f64,
    tailed: f64,
    tail: f64,
    /// Slow wander of each way: where it is, its 1-sigma, s, and its time, s.
    wander: ([f64; 2], f64, f64),
    /// Mean time between steps, and between silences, s.
    between: (f64, f64),
    step: (f64, f64),
    silence: (f64, f64),
    next_step: f64,
    silent: (f64, f64),
    at: f64,
}

fn even(random: &mut Random, (from, to): (f64, f64)) -> f64 {
    random.uniform(from, to)
}

/// Draws the time until the next event, given the mean time between two.
fn waiting(random: &mut Random, between: f64) -> f64 {
    -between * (1.0 - random.uniform(0.0, 1.0)).ln()
}

impl Link {
    /// A link by its own stream of random numbers; time begins at 0.
    #[must_use]
    pub fn drawn(ranges: &LinkRanges, mut random: Random) -> Self {
        let r = &mut random;
        let median = log_uniform(r, ranges.median);
        let least = median * even(r, ranges.least);
        let there = even(r, ranges.there);
        let jitter = log_uniform(r, ranges.jitter);
        let between = |per_hour: f64| 3_600.0 / per_hour.max(1e-6);
        let between = (
            between(even(r, ranges.steps)),
            between(even(r, ranges.silences)),
        );
        let wander = jitter * even(r, ranges.wander);
        let mut link = Self {
            least: [least * there, least * (1.0 - there)],
            jitter,
            body: ((median - least) / 2.0, even(r, (0.4, 1.0))),
            waits: even(r, (0.5, 0.9)),
            tailed: log_uniform(r, ranges.tailed),
            tail: log_uniform(r, ranges.tail),
            wander: ([0.0; 2], wander, log_uniform(r, (30.0, 600.0))),
            between,
            step: ranges.step,
            silence: ranges.silence,
            next_step: waiting(r, between.0),
            silent: (0.0, 0.0),
            at: 0.0,
            random,
        };
        link.silent = link.next_silence(0.0);
        link
    }

    fn next_silence(&mut self, after: f64) -> (f64, f64) {
        let from = after + waiting(&mut self.random, self.between.1);
        (from, from + log_uniform(&mut self.random, self.silence))
    }

    /// Returns when a question asked at a time is read, and when its answer is back; `None` if
    /// it is not answered. Times must not go back.
    pub fn exchange(&mut self, asked: TrueTime) -> Option<[TrueTime; 2]> {
        let [there, back] = self.ways(asked.as_secs_f64())?;
        let later = |from: TrueTime, by: f64| {
            let by = SimDuration::from_secs_f64(by).units();
            TrueTime::from_units(from.units().saturating_add(by))
        };
        let read = later(asked, there);
        Some([read, later(read, back)])
    }

    /// Returns the delays there and back of a question asked at a time, s; `None` if it is not
    /// answered. Times must not go back.
    pub fn ways(&mut self, at: f64) -> Option<[f64; 2]> {
        while at >= self.next_step {
            self.step();
        }
        while at >= self.silent.1 {
            self.silent = self.next_silence(self.silent.1);
        }
        self.move_slowly(at);
        let ways = [self.way(0), self.way(1)];
        (at < self.silent.0).then_some(ways)
    }

    /// Changes the shortest delay of one direction, of the other or of both.
    fn step(&mut self) {
        let factor = log_uniform(&mut self.random, self.step);
        let round = self.least[0] + self.least[1];
        let longer = if self.random.chance(0.5) {
            round * (factor - 1.0)
        } else {
            round * (1.0 / factor - 1.0)
        };
        let there = self.random.uniform(0.0, 1.0);
        let by = [longer * there, longer * (1.0 - there)];
        for (least, by) in self.least.iter_mut().zip(by) {
            *least = (*least + by).max(2e-5);
        }
        self.next_step += waiting(&mut self.random, self.between.0);
    }

    fn move_slowly(&mut self, at: f64) {
        let keep = (-(at - self.at).max(0.0) / self.wander.2).exp();
        self.at = at;
        for place in &mut self.wander.0 {
            let fresh = (1.0 - keep * keep).sqrt() * self.random.normal();
            *place = *place * keep + self.wander.1 * fresh;
        }
    }

    fn way(&mut self, place: usize) -> f64 {
        let r = &mut self.random;
        let mut way = self.least[place] + self.wander.0[place] + self.jitter * r.normal().abs();
        if r.chance(self.waits) {
            way += self.body.0 * (self.body.1 * r.normal()).exp();
        }
        if r.chance(self.tailed) {
            // Heavy: of Pareto's kind, α = 1.5.
            let tail = self.tail * (1.0 - r.uniform(0.0, 1.0)).powf(-1.0 / 1.5);
            way += tail.min(LinkRanges::LONGEST_TAIL);
        }
        way.max(1e-5)
    }
}
