//! One clock's exchanges: the quickest of each window, their noise, and steps of the
//! round trip.

use std::collections::VecDeque;

use super::Exchange;
use crate::robust::median_in_place;

/// Length of a window, s. Those of both clocks begin and end together: so the computer's
/// clock has little time to move between what they give.
const WINDOW_S: f64 = 2.0;

/// What a round trip takes has stepped where the median of so many windows, the last ones,
const RECENT_WINDOWS: usize = 3;

/// is elsewhere than that of so many before, once there are the least of them,
const SETTLED_WINDOWS: usize = 15;
const LEAST_WINDOWS: usize = 5;

/// by so many of its sigmas.
const STEP_SIGMAS: f64 = 5.0;

/// A window whose round trip is more sigmas away counts less.
const SLOW_SIGMAS: f64 = 2.0;

/// Of the round trips of so many windows, the first ones, nothing is learnt: the rate of the
/// clock is not known yet.
const RATED_WINDOWS: u32 = 5;

/// Differences of round trips so many windows apart tell the noise of one, and how both
/// ways wander.
const LAGS: [usize; 2] = [1, 64];

/// They are averaged over about so many windows.
const MEMORY_WINDOWS: [f64; 2] = [60.0, 600.0];

/// Before anything is learnt: the noise is this part of a round trip, and what wanders so
/// many times as much (of variances), as if of so many windows.
const FIRST_NOISE: f64 = 0.005;
const FIRST_WANDER: f64 = 4.0;
const FIRST_WINDOWS: [f64; 2] = [5.0, 60.0];

/// The noise is never below this, s: what the stamps themselves are good for.
const LEAST_NOISE: f64 = 1e-6;

/// Time constant of the wander of a way's delay, s. A guess: the middle of half a minute and ten.
const WANDER_S: f64 = 150.0;

fn median<'a>(values: impl Iterator<Item = &'a f64>) -> f64 {
    let mut values: Vec<f64> = values.copied().collect();
    median_in_place(&mut values).unwrap_or(0.0)
}

/// The quickest of one way in a window.
#[derive(Clone, Copy, Debug)]
struct Quickest {
    /// The clock less the computer's, or the other way about, as it came, s.
    apart: f64,
    /// The same without what the rate of the clock made of it since the window's begin.
    least: f64,
    at: f64,
}

#[derive(Clone, Copy, Debug)]
struct Window {
    begin: f64,
    /// Rate of the clock against the computer's, less one, as it was known then.
    rate: f64,
    ways: [Quickest; 2],
}

impl Window {
    /// Begin of the window that a time lies in.
    fn begin_of(at: f64) -> f64 {
        (at / WINDOW_S).floor() * WINDOW_S
    }

    fn ways(exchange: &Exchange, base: f64, (begin, rate): (f64, f64)) -> [Quickest; 2] {
        let at = exchange.middle();
        let clock = exchange.stamp - base;
        let moved = rate * (at - begin);
        let there = clock - exchange.sent;
        let back = exchange.received - clock;
        [(there, there - moved), (back, back + moved)].map(|(apart, least)| Quickest {
            apart,
            least,
            at,
        })
    }

    fn take(&mut self, exchange: &Exchange, base: f64) {
        let ways = Self::ways(exchange, base, (self.begin, self.rate));
        for (best, way) in self.ways.iter_mut().zip(ways) {
            if way.least < best.least {
                *best = way;
            }
        }
    }
}

/// One clock's exchanges.
#[derive(Clone, Debug, Default)]
pub(super) struct Leg {
    window: Option<Window>,
    /// Round trips of the last windows since the last step, s: the quickest way there and
    /// the quickest back.
    trips: VecDeque<f64>,
    /// Variance of half the differences of half the round trips at each lag, s²; and of
    /// how many windows.
    noise: [f64; LAGS.len()],
    windows: [f64; LAGS.len()],
    /// Windows that have ended.
    ended: u32,
    pub(super) odd: u32,
    pub(super) last: Option<f64>,
}

/// Measurement that a window gives.
pub(super) struct Seen {
    pub(super) at: f64,
    /// The clock less the computer's, and half of what the way there takes longer.
    pub(super) offset: f64,
    pub(super) variance: f64,
    /// By how much the round trip has stepped, s; mostly zero.
    pub(super) stepped: f64,
}

impl Leg {
    /// Takes an exchange; gives the window that it ends, if it ends one. `rate` is asked
    /// for where a window begins.
    pub(super) fn take(
        &mut self,
        exchange: &Exchange,
        base: f64,
        rate: impl FnOnce() -> f64,
    ) -> Option<Seen> {
        let begin = Window::begin_of(exchange.sent);
        if let Some(window) = self.window.as_mut().filter(|window| window.begin >= begin) {
            window.take(exchange, base);
            return None;
        }
        let rate = rate();
        let fresh = Window {
            begin,
            rate,
            ways: Window::ways(exchange, base, (begin, rate)),
        };
        let ended = self.window.replace(fresh)?;
        self.ended = self.ended.saturating_add(1);
        // The first one began anywhere.
        (self.ended > 1).then(|| self.end(&ended))
    }

    fn end(&mut self, window: &Window) -> Seen {
        let [there, back] = window.ways;
        // Whatever the rate was thought to be, this is the offset in the middle of both.
        let at = 0.5 * (there.at + back.at);
        let offset = 0.5 * (there.apart - back.apart);
        let trip = there.apart + back.apart - window.rate * (there.at - back.at);
        self.last = Some(at);
        if self.windows[0] == 0.0 {
            self.noise[0] = (FIRST_NOISE * trip).powi(2);
            self.windows[0] = FIRST_WINDOWS[0];
        }
        let stepped = match self.ended < RATED_WINDOWS {
            true => 0.0,
            false => self.settle(trip),
        };
        let sigma = self.trip_sigma();
        let apart = trip - self.settled().unwrap_or(trip);
        let late = match apart.abs() > SLOW_SIGMAS * sigma {
            true => apart,
            false => 0.0,
        };
        Seen {
            at,
            offset,
            variance: self.noise() + late * late,
            stepped,
        }
    }

    /// Takes the round trip of a window; gives by how much they have stepped, s.
    fn settle(&mut self, trip: f64) -> f64 {
        self.trips.push_back(trip);
        if self.trips.len() > LAGS[1] + 1 {
            self.trips.pop_front();
        }
        let before = self.trips.len().saturating_sub(RECENT_WINDOWS);
        let recent = median(self.trips.range(before..));
        let apart = recent - self.settled().unwrap_or(recent);
        if before >= LEAST_WINDOWS && apart.abs() > STEP_SIGMAS * self.trip_sigma() {
            self.trips.drain(..before);
            return apart;
        }
        self.learn_noise();
        0.0
    }

    /// Usual round trip before the last ones, s; after a step, that of those since.
    pub(super) fn settled(&self) -> Option<f64> {
        let count = self.trips.len();
        let last = match count >= RECENT_WINDOWS + LEAST_WINDOWS {
            true => count - RECENT_WINDOWS,
            false => count,
        };
        let first = last.saturating_sub(SETTLED_WINDOWS);
        (count > 0).then(|| median(self.trips.range(first..last)))
    }

    fn learn_noise(&mut self) {
        let now = self.trips.len() - 1;
        if self.windows[1] == 0.0 && now >= LAGS[1] {
            self.noise[1] = self.noise[0] + self.wander() * Self::wandered();
            self.windows[1] = FIRST_WINDOWS[1];
        }
        for (place, lag) in LAGS.into_iter().enumerate() {
            let Some(before) = now.checked_sub(lag) else {
                continue;
            };
            self.windows[place] = (self.windows[place] + 1.0).min(MEMORY_WINDOWS[place]);
            let noise = &mut self.noise[place];
            let half = 0.5 * (0.5 * (self.trips[now] - self.trips[before])).powi(2);
            *noise += (half.min(9.0 * *noise) - *noise) / self.windows[place];
        }
    }

    /// Variance of the offset of a good window, s². Both ways scatter by themselves: by half
    /// of what the round trip does.
    fn noise(&self) -> f64 {
        self.noise[0].max(LEAST_NOISE * LEAST_NOISE)
    }

    /// Share of a wander's variance in half the differences at the longer lag.
    fn wandered() -> f64 {
        -(-(LAGS[1] as f64) * WINDOW_S / WANDER_S).exp_m1()
    }

    /// Variance of the slow wander of the asymmetry, s²: by half of what the round trip's
    /// is.
    pub(super) fn wander(&self) -> f64 {
        match self.windows[1] > 0.0 {
            true => (self.noise[1] - self.noise[0]).max(0.0) / Self::wandered(),
            false => FIRST_WANDER * self.noise(),
        }
    }

    /// Factor by which a wander has faded after some seconds.
    pub(super) fn fade(dt: f64) -> f64 {
        (-dt / WANDER_S).exp()
    }

    /// 1-sigma of the median of the last round trips about that of those before, s.
    fn trip_sigma(&self) -> f64 {
        2.0 * (0.6 * self.noise() + 0.25 * self.wander()).sqrt()
    }
}
