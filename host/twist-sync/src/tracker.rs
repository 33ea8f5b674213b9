//! How the offset of two clocks goes on after it was measured, from exchanges.
//!
//! A computer asks both clocks, a and b, for their time, again and again. Of an exchange
//! it knows when it asked and when the answer came, by its own clock h, and what the clock
//! read in between. The way there and the way back take unequal times, so that one exchange
//! is wrong by half of their difference: by some constant, and by what each way took longer
//! than it can. A twist knows the offset; here only its *change* is wanted, and the constant
//! cancels.
//!
//! **Windows.** Delays are one-sided and heavy-tailed, so of each two seconds only the
//! exchange with the shortest round trip counts ([`Leg`]). What that takes is nearly always
//! the same; the farther it is from its usual value, the less its offset counts.
//!
//! **Filter.** A Kalman filter takes one such offset of either clock at a time:
//!
//! ```text
//! state        x = a − h, its rate, A = asymmetry of a's exchanges,
//!              d = b − a, its rate, the change of the rate, B = asymmetry of b's exchanges
//! exchange, a  x + A
//! exchange, b  x + d + B
//! known        d, and its rate
//! ```
//!
//! `d` is what is wanted. The computer's clock is in `x` alone, whose rate may move by ppm
//! within seconds; so the chain needs no good clock in the computer. A and B are constants that may
//! step: where the usual round trip of a window steps, or offsets jump (a crystal cannot), only
//! their variance grows; `d` goes on by its rate meanwhile, and is as certain as that.
//!
//! **Warming.** The rate of `d` walks, and its change dies away, as crystals do that warm
//! up. By how much is not known: there are three suppositions, weighed by how well
//! each foretold what came ([`MOVES`]).
//!
//! Limits: an asymmetry that moves slowly, without any change of the shortest round trip, is
//! taken for the clocks'. A jump of the computer's rate by tens of ppm looks like a step of
//! both asymmetries: the 1-sigma grows with it. Temperatures are not used: a rate is measured within seconds to
//! minutes, which is faster than a crystal follows a sensor beside it.

use std::collections::VecDeque;

use nalgebra::{SMatrix, SVector};

use crate::clock::{ClockRelation, Wander, WithSigma};
use crate::robust::median_in_place;

/// One exchange with a clock, s. `sent` and `received` are of the computer's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exchange {
    /// When it was asked.
    pub sent: f64,
    /// When its answer came.
    pub received: f64,
    /// What the clock read in between.
    pub stamp: f64,
}

impl Exchange {
    fn round_trip(&self) -> f64 {
        self.received - self.sent
    }

    fn middle(&self) -> f64 {
        0.5 * (self.sent + self.received)
    }

    fn is_one(&self) -> bool {
        let all = [self.sent, self.received, self.stamp];
        all.iter().all(|time| time.is_finite()) && self.received >= self.sent
    }
}

/// Which clock was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// The first.
    A,
    /// The second.
    B,
}

/// What became of the exchanges of a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// The window goes on.
    Kept,
    /// Its best exchange was taken.
    Used,
    /// Its best exchange is far from what was expected, and was left.
    Odd,
    /// The asymmetry of the exchanges has stepped; the offset goes on by its rate.
    Stepped,
}

/// Length of a window, s.
const WINDOW_S: f64 = 2.0;

/// The usual shortest round trip of a window is the median of so many, the first ones.
const SETTLED_WINDOWS: usize = 30;

/// And has stepped where the median of so many, the last ones, is elsewhere,
const RECENT_WINDOWS: usize = 5;

/// by so many times their spread (1-sigma of one; that of the median of five is 0.56).
const STEP_SPREADS: f64 = 3.0;

/// How far from what was expected an offset is odd, in sigmas of both.
const ODD_SIGMAS: f64 = 5.0;

/// So many odd offsets in a row are a step.
const ODD_WINDOWS: u32 = 3;

/// The noise of a window's offset is estimated over about so many of them.
const NOISE_WINDOWS: f64 = 60.0;

/// From one that is later than so many of its sigmas nothing is learnt.
const SLOW_SIGMAS: f64 = 2.0;

/// Before anything is learnt it is this part of a round trip, as if of so many windows.
const FIRST_NOISE: f64 = 0.05;
const FIRST_WINDOWS: f64 = 10.0;

/// Asymmetries wander slowly, by this part of the noise: it is left in what is stated.
const SLOW_NOISE: f64 = 0.25;

/// And is never below this, s: what the stamps themselves are good for.
const LEAST_NOISE: f64 = 1e-6;

/// Differences of offsets so many windows apart tell their noise: errors of neighbours may
/// be alike.
const NOISE_LAGS: [usize; 2] = [1, 8];

/// Rates of the clocks differ by so much, 1-sigma, before anything is known.
const RATES: f64 = 1e-4;

/// How the rate of the computer's clock walks, in one second: time servers steer it by
/// some ppm at a time.
const COMPUTER_WALK: f64 = 1e-6;

/// Time in which a rig warms up, s. A guess.
pub const WARMING_S: f64 = 300.0;

/// How the rate between the two clocks moves: its walk in one second, and the 1-sigma of
/// its change, 1/s; equally likely at first. Plain crystals at rest, a rig that warms up by
/// 0.1 to 1 ppm in ten minutes, and by 5 ppm.
const MOVES: [(f64, f64); 3] = [(1e-9, 3e-10), (3e-9, 4e-9), (1e-8, 3e-8)];

/// How slowly likelihoods are forgotten, windows: a rig may begin to warm up.
const MEMORY_WINDOWS: f64 = 600.0;

const STATES: usize = 7;
/// Places in the state.
const X: usize = 0;
const X_RATE: usize = 1;
const ASYMMETRY_A: usize = 2;
const D: usize = 3;
const D_RATE: usize = 4;
const D_CHANGE: usize = 5;
const ASYMMETRY_B: usize = 6;

type State = SVector<f64, STATES>;
type Covariance = SMatrix<f64, STATES, STATES>;

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    median_in_place(&mut values).unwrap_or(0.0)
}

/// One way to a clock: its windows.
#[derive(Clone, Debug, Default)]
struct Leg {
    /// End of the window, and its best exchange so far.
    window: Option<(f64, Exchange)>,
    /// Shortest round trips of the last windows, s.
    shortest: VecDeque<f64>,
    /// Of the first since the last step; their median and spread.
    first: Vec<f64>,
    settled: Option<f64>,
    spread: f64,
    /// Times and offsets of the last windows, s.
    offsets: VecDeque<(f64, f64)>,
    /// Variance of half the differences at each lag, s².
    noise: [f64; NOISE_LAGS.len()],
    windows: f64,
    odd: u32,
    last: Option<f64>,
}

/// What a window gives.
struct Seen {
    at: f64,
    offset: f64,
    variance: f64,
    /// By how much the shortest round trip has moved, s.
    moved: f64,
}

impl Leg {
    /// Takes an exchange; gives the best one of the window that it ends, if it ends one.
    fn take(&mut self, exchange: Exchange) -> Option<Exchange> {
        match &mut self.window {
            Some((end, best)) if exchange.sent < *end => {
                if exchange.round_trip() < best.round_trip() {
                    *best = exchange;
                }
                None
            }
            window => {
                let ended = window.replace((exchange.sent + WINDOW_S, exchange));
                ended.map(|(_, best)| best)
            }
        }
    }

    fn end(&mut self, best: Exchange, base: f64, rate: f64) -> Seen {
        let shortest = best.round_trip();
        let moved = self.settle(shortest);
        let (at, offset) = (best.middle(), best.stamp - base - best.middle());
        self.last = Some(at);
        if self.windows == 0.0 {
            self.noise = [(FIRST_NOISE * shortest).powi(2); NOISE_LAGS.len()];
            self.windows = FIRST_WINDOWS;
        }
        let apart = shortest - self.settled.unwrap_or(shortest);
        if moved.abs() > 3.0 * self.sigma() {
            self.offsets.clear();
        }
        // A slow window is no measure of a good one.
        if apart.abs() < SLOW_SIGMAS * self.sigma() {
            self.learn_noise(at, offset, rate);
        }
        Seen {
            at,
            offset,
            variance: self.sigma().powi(2) + apart * apart,
            moved,
        }
    }

    /// Takes the shortest round trip of a window; gives by how much its usual value has
    /// stepped, s.
    fn settle(&mut self, shortest: f64) -> f64 {
        self.shortest.push_back(shortest);
        if self.shortest.len() > RECENT_WINDOWS {
            self.shortest.pop_front();
        }
        let recent = median(self.shortest.iter().copied());
        let before = self.settled.unwrap_or(shortest);
        if self.first.len() < SETTLED_WINDOWS {
            self.first.push(shortest);
            let settled = median(self.first.iter().copied());
            let spread = median(self.first.iter().map(|each| (each - settled).abs()));
            self.spread = 1.48 * spread;
            self.settled = Some(settled);
        }
        let apart = recent - self.settled.unwrap_or(recent);
        let is_full = self.first.len() > 2 * RECENT_WINDOWS;
        if is_full && apart.abs() > STEP_SPREADS * self.spread {
            self.first = self.shortest.iter().copied().collect();
            self.settled = Some(recent);
        }
        self.settled.unwrap_or(before) - before
    }

    /// 1-sigma of the offset of a good window, s.
    fn sigma(&self) -> f64 {
        let most = self.noise.iter().copied().fold(0.0, f64::max);
        most.sqrt().max(LEAST_NOISE)
    }

    fn learn_noise(&mut self, at: f64, offset: f64, rate: f64) {
        self.windows = (self.windows + 1.0).min(NOISE_WINDOWS);
        for (noise, lag) in self.noise.iter_mut().zip(NOISE_LAGS) {
            let Some(&(then, other)) = self.offsets.iter().rev().nth(lag - 1) else {
                continue;
            };
            if at - then > 3.0 * lag as f64 * WINDOW_S {
                continue;
            }
            let half = 0.5 * (offset - other - rate * (at - then)).powi(2);
            let half = half.min(9.0 * *noise);
            *noise += (half - *noise) / self.windows;
        }
        self.offsets.push_back((at, offset));
        if self.offsets.len() > NOISE_LAGS[NOISE_LAGS.len() - 1] {
            self.offsets.pop_front();
        }
    }
}

/// One supposition of how the rate moves.
#[derive(Clone, Debug)]
struct Filter {
    walk: f64,
    change: f64,
    mean: State,
    covariance: Covariance,
    likelihood_ln: f64,
}

impl Filter {
    /// To `dt` seconds later.
    fn predict(&mut self, dt: f64) {
        let mut step = Covariance::identity();
        step[(X, X_RATE)] = dt;
        step[(D, D_RATE)] = dt;
        let fade = (-dt / WARMING_S).exp();
        let of_rate = WARMING_S * (1.0 - fade);
        step[(D, D_CHANGE)] = WARMING_S * (dt - of_rate);
        step[(D_RATE, D_CHANGE)] = of_rate;
        step[(D_CHANGE, D_CHANGE)] = fade;
        self.mean = step * self.mean;
        self.covariance = step * self.covariance * step.transpose();
        for (place, walk) in [(X, COMPUTER_WALK), (D, self.walk)] {
            let q = walk * walk;
            self.covariance[(place, place)] += q * dt.powi(3) / 3.0;
            self.covariance[(place, place + 1)] += q * dt * dt / 2.0;
            self.covariance[(place + 1, place)] += q * dt * dt / 2.0;
            self.covariance[(place + 1, place + 1)] += q * dt;
        }
        self.covariance[(D_CHANGE, D_CHANGE)] += self.change.powi(2) * (1.0 - fade * fade);
    }

    /// How far a measurement is from what is expected, and the variance of that.
    fn innovation(&self, of: &State, value: f64, variance: f64) -> (f64, f64) {
        let expected = of.dot(&self.mean);
        (value - expected, of.dot(&(self.covariance * of)) + variance)
    }

    fn update(&mut self, of: &State, value: f64, variance: f64) {
        let (apart, spread) = self.innovation(of, value, variance);
        let gain = self.covariance * of / spread;
        self.mean += gain * apart;
        // Joseph form: stays positive.
        let keep = Covariance::identity() - gain * of.transpose();
        self.covariance =
            keep * self.covariance * keep.transpose() + gain * gain.transpose() * variance;
        self.covariance = 0.5 * (self.covariance + self.covariance.transpose());
        self.likelihood_ln -= 0.5 * (apart * apart / spread + spread.ln());
    }
}

/// Follows the offset of clock b against clock a. Pure: it is told what was exchanged.
#[derive(Clone, Debug, Default)]
pub struct Tracker {
    filters: Option<Filters>,
    legs: [Leg; 2],
    /// First stamps, s: no digits are lost.
    base: [Option<f64>; 2],
}

#[derive(Clone, Debug)]
struct Filters {
    /// Computer's time of the states, s.
    at: f64,
    each: [Filter; MOVES.len()],
}

impl Tracker {
    /// A tracker that knows nothing.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes an exchange. Those of one clock come in the order in which they were asked;
    /// what is not a number is left.
    pub fn take(&mut self, asked: Asked, exchange: Exchange) -> Taken {
        if !exchange.is_one() {
            return Taken::Odd;
        }
        let place = asked as usize;
        let base = *self.base[place].get_or_insert(exchange.stamp - exchange.middle());
        let Some(best) = self.legs[place].take(exchange) else {
            return Taken::Kept;
        };
        let rate = self.rate_of(asked);
        let seen = self.legs[place].end(best, base, rate);
        self.see(asked, &seen)
    }

    /// Rate of a clock against the computer's, less one.
    fn rate_of(&self, asked: Asked) -> f64 {
        let Some(filters) = &self.filters else {
            return 0.0;
        };
        let (mean, _) = filters.mixed();
        match asked {
            Asked::A => mean[X_RATE],
            Asked::B => mean[X_RATE] + mean[D_RATE],
        }
    }

    fn see(&mut self, asked: Asked, seen: &Seen) -> Taken {
        let floors = [0, 1].map(|leg| self.legs[leg].settled.unwrap_or(0.1));
        let filters = self
            .filters
            .get_or_insert_with(|| Filters::new(seen.at, floors));
        filters.predict(seen.at);
        // The other clock's window may have ended before.
        let (of, asymmetry) = observed(asked, filters.at - seen.at);
        let leg = &mut self.legs[asked as usize];
        // One way alone may have become another.
        let stepped = seen.moved.abs() > 3.0 * leg.sigma();
        for filter in &mut filters.each {
            filter.covariance[(asymmetry, asymmetry)] += 0.25 * seen.moved * seen.moved;
        }
        let nearest = filters.each.iter().map(|filter| {
            let (apart, spread) = filter.innovation(&of, seen.offset, seen.variance);
            (apart * apart / spread, apart)
        });
        let nearest = nearest.fold((f64::INFINITY, 0.0), |a, b| if b.0 < a.0 { b } else { a });
        if nearest.0 > ODD_SIGMAS * ODD_SIGMAS {
            leg.odd += 1;
            if leg.odd < ODD_WINDOWS {
                return Taken::Odd;
            }
            for filter in &mut filters.each {
                filter.covariance[(asymmetry, asymmetry)] += nearest.1 * nearest.1;
            }
        }
        let jumped = leg.odd >= ODD_WINDOWS;
        leg.odd = 0;
        for filter in &mut filters.each {
            filter.update(&of, seen.offset, seen.variance);
            filter.likelihood_ln *= 1.0 - 1.0 / MEMORY_WINDOWS;
        }
        match stepped || jumped {
            true => Taken::Stepped,
            false => Taken::Used,
        }
    }

    /// Takes what is known of the two clocks from elsewhere: a twist.
    ///
    /// It may be some seconds old. Before the first window of either clock nothing comes
    /// of it, and `false` is given.
    pub fn know(&mut self, relation: &ClockRelation) -> bool {
        let ([Some(base_a), Some(base_b)], Some(filters)) = (self.base, &mut self.filters) else {
            return false;
        };
        let (mean, _) = filters.mixed();
        let now = filters.at + mean[X] + base_a;
        let since = now - relation.reference;
        let [[offset, both], [_, skew]] = relation.covariance;
        let old = since * since / 2.0;
        let mut of_offset = State::zeros();
        of_offset[D] = 1.0;
        of_offset[D_RATE] = -since;
        of_offset[D_CHANGE] = old;
        let mut of_rate = State::zeros();
        of_rate[D_RATE] = 1.0;
        of_rate[D_CHANGE] = -since;
        let value = relation.offset - (base_b - base_a);
        let wandered = relation.wander.diffusion() * since.abs().powi(3) / 3.0;
        // What the skew says beside the offset, with which its error goes.
        let with_offset = both / offset;
        let alone = of_rate - with_offset * of_offset;
        let skew_alone = (skew - both * both / offset).max(0.0);
        for filter in &mut filters.each {
            filter.update(&of_offset, value, offset + wandered);
            let skew = relation.skew - with_offset * value;
            filter.update(&alone, skew, skew_alone);
        }
        true
    }

    /// Clock b minus clock a at a time of the computer, and the 1-sigma; nothing before
    /// both clocks have answered.
    #[must_use]
    pub fn offset_at(&self, computer: f64) -> Option<WithSigma> {
        let (mean, covariance) = self.at(computer)?;
        let [base_a, base_b] = self.base;
        Some(WithSigma {
            value: base_b? - base_a? + mean[D],
            sigma: covariance[(D, D)].max(0.0).sqrt(),
        })
    }

    /// The relation of the clocks at a time of the computer, to go on from there.
    #[must_use]
    pub fn relation_at(&self, computer: f64) -> Option<ClockRelation> {
        let (mean, p) = self.at(computer)?;
        let [base_a, base_b] = [self.base[0]?, self.base[1]?];
        Some(ClockRelation {
            reference: computer + mean[X] + base_a,
            offset: base_b - base_a + mean[D],
            skew: mean[D_RATE],
            covariance: [
                [p[(D, D)], p[(D, D_RATE)]],
                [p[(D, D_RATE)], p[(D_RATE, D_RATE)]],
            ],
            wander: Wander::default(),
        })
    }

    /// When a window of the clock was last taken, by the computer's clock.
    #[must_use]
    pub fn last_of(&self, asked: Asked) -> Option<f64> {
        self.legs[asked as usize].last
    }

    fn at(&self, computer: f64) -> Option<(State, Covariance)> {
        let mut filters = self.filters.clone()?;
        self.legs
            .iter()
            .all(|leg| leg.last.is_some())
            .then_some(())?;
        filters.predict(computer);
        let (mean, mut covariance) = filters.mixed();
        for leg in &self.legs {
            covariance[(D, D)] += (SLOW_NOISE * leg.sigma()).powi(2);
        }
        Some((mean, covariance))
    }
}

/// What an offset of a window is of the state that is `late` seconds later, and the place
/// of its asymmetry.
fn observed(asked: Asked, late: f64) -> (State, usize) {
    let mut of = State::zeros();
    of[X] = 1.0;
    of[X_RATE] = -late;
    let asymmetry = match asked {
        Asked::A => ASYMMETRY_A,
        Asked::B => {
            of[D] = 1.0;
            of[D_RATE] = -late;
            of[D_CHANGE] = 0.5 * late * late;
            ASYMMETRY_B
        }
    };
    of[asymmetry] = 1.0;
    (of, asymmetry)
}

impl Filters {
    /// Knowing nothing but that an asymmetry is no more than half of a round trip.
    fn new(at: f64, round_trips: [f64; 2]) -> Self {
        let each = MOVES.map(|(walk, change)| {
            let mut covariance = Covariance::zeros();
            let mut set = |place: usize, sigma: f64| covariance[(place, place)] = sigma * sigma;
            set(X, 1.0);
            set(X_RATE, RATES);
            set(D, 1.0);
            set(D_RATE, RATES);
            set(D_CHANGE, change);
            set(ASYMMETRY_A, round_trips[0] / 2.0);
            set(ASYMMETRY_B, round_trips[1] / 2.0);
            Filter {
                walk,
                change,
                mean: State::zeros(),
                covariance,
                likelihood_ln: 0.0,
            }
        });
        Self { at, each }
    }

    /// To a time that is not before theirs; windows of the two clocks overlap.
    fn predict(&mut self, at: f64) {
        let dt = at - self.at;
        if dt > 0.0 {
            self.at = at;
            for filter in &mut self.each {
                filter.predict(dt);
            }
        }
    }

    /// All suppositions together: mean and covariance by their weights.
    fn mixed(&self) -> (State, Covariance) {
        let best = self.each.iter().map(|filter| filter.likelihood_ln);
        let best = best.fold(f64::NEG_INFINITY, f64::max);
        let weights = self.each.each_ref().map(|f| (f.likelihood_ln - best).exp());
        let sum: f64 = weights.iter().sum();
        let weighed = || self.each.iter().zip(weights.map(|weight| weight / sum));
        let mean: State = weighed().map(|(filter, weight)| filter.mean * weight).sum();
        let covariance = weighed()
            .map(|(filter, weight)| {
                let apart = filter.mean - mean;
                (filter.covariance + apart * apart.transpose()) * weight
            })
            .sum();
        (mean, covariance)
    }
}

#[cfg(test)]
mod tests;
