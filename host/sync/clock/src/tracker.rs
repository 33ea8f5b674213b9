//! The offset of two clocks, followed by exchanges after it was measured.
//!
//! A computer asks both clocks, a and b, for their time, again and again. For each exchange
//! it knows when it asked and when the answer came, by its own clock h, and the clock's
//! reading in between. The way there and the way back take unequal times, so that one exchange
//! is wrong by half of their difference: a constant, plus the random delays of the two ways.
//! A twist gives the offset itself; the exchanges give its *change*, in which the constant
//! cancels.
//!
//! **Windows.** Delays are one-sided and heavy-tailed. So of each two seconds only the
//! quickest way there and the quickest way back count, even if they belong to different
//! exchanges ([`Leg`]): a single way is often quick, both ways of one exchange rarely. Their
//! sum is nearly always the same; the farther it is from its usual value, the less
//! their offset counts.
//!
//! **Filter.** A Kalman filter is updated with one such offset of either clock at a time:
//!
//! ```text
//! state        x = a − h, its rate, A = asymmetry of a's exchanges: a constant, and what wanders,
//!              d = b − a, its rate, the change of the rate, B = asymmetry of b's exchanges
//! exchange, a  x + A
//! exchange, b  x + d + B
//! known        d, and its rate
//! ```
//!
//! `d` is the result. The computer's clock affects `x` alone, whose rate may move by ppm
//! within seconds; so the computer needs no good clock. The constants of A and B may
//! step: if the usual round trip of a window steps, or offsets jump (a crystal cannot), only
//! their variance grows; `d` is then predicted from its rate, with the uncertainty of that.
//! In addition A and B wander, with half the variance of the round trip's wander, because the
//! two ways wander independently.
//!
//! **Warming.** The rate of `d` walks, and its change decays, as with crystals that warm
//! up. The size of both is unknown: there are three hypotheses, weighted by their
//! predictions ([`MOVES`]).
//!
//! Limits: an asymmetry that moves slowly, without any change of the round trip, counts as a
//! change of the clocks. A jump of the computer's rate by tens of ppm looks like a step of
//! both asymmetries: the 1-sigma grows with it. Temperatures are not used: a rate is measured
//! within seconds to minutes, which is faster than a crystal follows a sensor beside it.

mod followed;
mod leg;

use nalgebra::{SMatrix, SVector};
use twist_sync::mixture::{Supposed, mixed};

pub use self::followed::followed;
use self::leg::{Leg, Seen};
use crate::{ClockRelation, Wander, WithSigma};

/// One exchange with a clock: a question for its time, and the answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exchange {
    /// Time of the question, in seconds of the computer's clock.
    pub sent: f64,
    /// Arrival of the answer, in seconds of the computer's clock.
    pub received: f64,
    /// Reading of the clock between the two, in seconds of that clock.
    pub stamp: f64,
}

impl Exchange {
    fn middle(&self) -> f64 {
        0.5 * (self.sent + self.received)
    }

    fn is_valid(&self) -> bool {
        let all = [self.sent, self.received, self.stamp];
        all.iter().all(|time| time.is_finite()) && self.received >= self.sent
    }
}

/// The clock of an exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// Clock a.
    A,
    /// Clock b.
    B,
}

/// Innovation from which an offset is odd, in sigmas.
const ODD_SIGMAS: f64 = 5.0;

/// Odd offsets in a row that count as a step.
const ODD_WINDOWS: u32 = 3;

/// Prior 1-sigma of the asymmetry of the ways there and back, s.
const ASYMMETRY: f64 = 0.05;

/// Prior 1-sigma of the difference in rate of two clocks.
const RATES: f64 = 1e-4;

/// Walk of the rate of the computer's clock in one second: time servers steer it by
/// some ppm at a time.
const COMPUTER_WALK: f64 = 3e-6;

/// Time constant with which a rig warms up, in seconds. A guess.
pub const WARMING_S: f64 = 300.0;

/// Hypotheses of the rate between the two clocks: its walk in one second, and the 1-sigma of
/// its change, 1/s; equally likely at first. Plain crystals at rest, a rig that warms up by
/// 0.1 to 1 ppm in ten minutes, and by 5 ppm.
const MOVES: [(f64, f64); 3] = [(1e-9, 3e-10), (3e-9, 4e-9), (1e-8, 3e-8)];

/// Memory of the likelihoods, windows: a rig may begin to warm up.
const MEMORY_WINDOWS: f64 = 600.0;

const STATES: usize = 9;
/// Places in the state.
const X: usize = 0;
const X_RATE: usize = 1;
const D: usize = 2;
const D_RATE: usize = 3;
const D_CHANGE: usize = 4;
/// The constant of each clock; its wander comes next.
const ASYMMETRIES: [usize; 2] = [5, 7];

type State = SVector<f64, STATES>;
type Covariance = SMatrix<f64, STATES, STATES>;

/// The filter of one hypothesis.
#[derive(Clone, Debug)]
struct Filter {
    walk: f64,
    change: f64,
    mean: State,
    covariance: Covariance,
    likelihood_ln: f64,
}

impl Filter {
    /// Predicts the state `dt` seconds later; `wanders` are the variances of the two
    /// asymmetries' wander.
    fn predict(&mut self, dt: f64, wanders: [f64; 2]) {
        let mut step = Covariance::identity();
        step[(X, X_RATE)] = dt;
        step[(D, D_RATE)] = dt;
        let fade = (-dt / WARMING_S).exp();
        let of_rate = WARMING_S * (1.0 - fade);
        step[(D, D_CHANGE)] = WARMING_S * (dt - of_rate);
        step[(D_RATE, D_CHANGE)] = of_rate;
        step[(D_CHANGE, D_CHANGE)] = fade;
        let stays = Leg::fade(dt);
        for asymmetry in ASYMMETRIES {
            step[(asymmetry + 1, asymmetry + 1)] = stays;
        }
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
        for (asymmetry, wander) in ASYMMETRIES.into_iter().zip(wanders) {
            let place = asymmetry + 1;
            self.covariance[(place, place)] += wander * (1.0 - stays * stays);
        }
    }

    /// Returns the measurement minus its prediction, and the variance of that difference.
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

/// Filter that follows the offset of clock b against clock a. It does no I/O: the caller adds
/// exchanges and relations.
#[derive(Clone, Debug, Default)]
pub struct Tracker {
    filters: Option<Filters>,
    legs: [Leg; 2],
    /// First offset of each clock from the computer's, s, so that no digits are lost.
    base: [Option<f64>; 2],
}

#[derive(Clone, Debug)]
struct Filters {
    /// Computer's time of the states, s.
    at: f64,
    each: [Filter; MOVES.len()],
}

impl Tracker {
    /// Adds an exchange with the clock `asked`. Returns true if it has ended a window, so that
    /// the estimates have changed.
    ///
    /// The exchanges of one clock must be in the order in which they were asked for. Exchanges
    /// with values that are not finite, or that end before they begin, are ignored.
    pub fn add(&mut self, asked: Asked, exchange: Exchange) -> bool {
        if !exchange.is_valid() {
            return false;
        }
        let place = asked as usize;
        let base = *self.base[place].get_or_insert(exchange.stamp - exchange.middle());
        let filters = self.filters.as_ref();
        let rate = || filters.map_or(0.0, |filters| filters.rate_of(asked));
        let seen = self.legs[place].add(&exchange, base, rate);
        if let Some(seen) = &seen {
            self.update(asked, seen);
        }
        seen.is_some()
    }

    fn update(&mut self, asked: Asked, seen: &Seen) {
        let wanders = self.wanders();
        let filters = self.filters.get_or_insert_with(|| Filters::new(seen.at));
        filters.predict(seen.at, wanders);
        // The other clock's window may have ended before.
        let (of, asymmetry) = observed(asked, filters.at - seen.at);
        let leg = &mut self.legs[asked as usize];
        // One way alone may have become another.
        for filter in &mut filters.each {
            filter.covariance[(asymmetry, asymmetry)] += 0.25 * seen.stepped * seen.stepped;
        }
        let nearest = filters.each.iter().map(|filter| {
            let (apart, spread) = filter.innovation(&of, seen.offset, seen.variance);
            (apart * apart / spread, apart)
        });
        let nearest = nearest.fold((f64::INFINITY, 0.0), |a, b| if b.0 < a.0 { b } else { a });
        if nearest.0 > ODD_SIGMAS * ODD_SIGMAS {
            leg.odd += 1;
            if leg.odd < ODD_WINDOWS {
                return;
            }
            for filter in &mut filters.each {
                filter.covariance[(asymmetry, asymmetry)] += nearest.1 * nearest.1;
            }
        }
        leg.odd = 0;
        for filter in &mut filters.each {
            filter.update(&of, seen.offset, seen.variance);
            filter.likelihood_ln *= 1.0 - 1.0 / MEMORY_WINDOWS;
        }
    }

    /// Adds an independent measurement of the relation of the two clocks, such as a twist,
    /// which may be some seconds old.
    ///
    /// Returns false, and ignores the relation, before the first window of each clock has ended.
    pub fn add_relation(&mut self, relation: &ClockRelation) -> bool {
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
        // The skew without the part of its error that goes with the offset's.
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

    /// Returns clock b minus clock a at a time of the computer's clock (all in seconds), with
    /// its 1-sigma, or `None` before both clocks have a complete window.
    #[must_use]
    pub fn offset_at(&self, computer: f64) -> Option<WithSigma> {
        let relation = self.relation_at(computer)?;
        Some(relation.offset_at(relation.reference))
    }

    /// Returns the relation of the clocks, referenced at a time of the computer's clock in
    /// seconds, or `None` before both clocks have a complete window.
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

    /// Returns the time of the latest complete window of a clock, in seconds of the computer's
    /// clock.
    #[must_use]
    pub fn last_window(&self, asked: Asked) -> Option<f64> {
        self.legs[asked as usize].last
    }

    fn at(&self, computer: f64) -> Option<(State, Covariance)> {
        let mut filters = self.filters.clone()?;
        self.legs
            .iter()
            .all(|leg| leg.last.is_some())
            .then_some(())?;
        filters.predict(computer, self.wanders());
        Some(filters.mixed())
    }

    fn wanders(&self) -> [f64; 2] {
        self.legs.each_ref().map(Leg::wander)
    }
}

/// Returns the observation vector of a window's offset, for the state `late` seconds later, and
/// the index of its asymmetry in the state.
fn observed(asked: Asked, late: f64) -> (State, usize) {
    let mut of = State::zeros();
    of[X] = 1.0;
    of[X_RATE] = -late;
    if asked == Asked::B {
        of[D] = 1.0;
        of[D_RATE] = -late;
        of[D_CHANGE] = 0.5 * late * late;
    }
    let asymmetry = ASYMMETRIES[asked as usize];
    of[asymmetry] = 1.0;
    of[asymmetry + 1] = 1.0;
    (of, asymmetry)
}

impl Filters {
    /// Creates the filters with the prior of each hypothesis.
    fn new(at: f64) -> Self {
        let each = MOVES.map(|(walk, change)| {
            let mut covariance = Covariance::zeros();
            let mut set = |place: usize, sigma: f64| covariance[(place, place)] = sigma * sigma;
            set(X, 1.0);
            set(X_RATE, RATES);
            set(D, 1.0);
            set(D_RATE, RATES);
            set(D_CHANGE, change);
            for asymmetry in ASYMMETRIES {
                set(asymmetry, ASYMMETRY);
            }
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

    /// Predicts all filters to a time, unless they are there already: windows of the two
    /// clocks overlap.
    fn predict(&mut self, at: f64, wanders: [f64; 2]) {
        let dt = at - self.at;
        if dt > 0.0 {
            self.at = at;
            for filter in &mut self.each {
                filter.predict(dt, wanders);
            }
        }
    }

    /// Returns the rate of a clock against the computer's, minus one.
    fn rate_of(&self, asked: Asked) -> f64 {
        let (mean, _) = self.mixed();
        match asked {
            Asked::A => mean[X_RATE],
            Asked::B => mean[X_RATE] + mean[D_RATE],
        }
    }

    /// Returns mean and covariance of the mixture of all hypotheses.
    fn mixed(&self) -> (State, Covariance) {
        mixed(&self.each.each_ref().map(|filter| Supposed {
            prior: 1.0,
            likelihood_ln: filter.likelihood_ln,
            mean: filter.mean,
            covariance: filter.covariance,
        }))
    }
}

#[cfg(test)]
mod tests;
