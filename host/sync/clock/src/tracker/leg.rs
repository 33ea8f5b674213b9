//! The exchanges with one clock: the quickest of each window, their noise, and steps of the
//! round trip.

use std::collections::VecDeque;

use twist_sync::robust::median_in_place;

use super::Exchange;

/// Length of a window, s. Windows of both clocks begin and end together, so that the
/// computer's clock has little time to move between their measurements.
const WINDOW_S: f64 = 2.0;

/// Latest windows whose median round trip is compared with that of earlier ones.
const RECENT_WINDOWS: usize = 3;

/// Most and fewest earlier windows for that comparison.
const SETTLED_WINDOWS: usize = 15;
const LEAST_WINDOWS: usize = 5;

/// Difference of the two medians that is a step of the round trip, in sigmas.
const STEP_SIGMAS: f64 = 5.0;

/// Distance of a window's round trip from the usual one beyond which the window counts less, in
/// sigmas.
const SLOW_SIGMAS: f64 = 2.0;

/// First windows whose round trips are ignored, because the rate of the clock is not known yet.
const RATED_WINDOWS: u32 = 5;

/// Lags, in windows, of the differences of round trips that give the noise of one window, and
/// the wander of both ways.
const LAGS: [usize; 2] = [1, 64];

/// Windows over which those differences are averaged, for each lag.
const MEMORY_WINDOWS: [f64; 2] = [60.0, 600.0];

/// Values before any round trip was seen: noise as a part of a round trip, variance of the
/// wander as a multiple of that of the noise, and the number of windows that each counts for.
const FIRST_NOISE: f64 = 0.005;
const FIRST_WANDER: f64 = 4.0;
const FIRST_WINDOWS: [f64; 2] = [5.0, 60.0];

/// Least noise, s: that of the stamps themselves.
const LEAST_NOISE: f64 = 1e-6;

/// Time constant of the wander of a way's delay, s. A guess: the middle of half a minute and ten.
const WANDER_S: f64 = 150.0;

fn median<'a>(values: impl Iterator<Item = &'a f64>) -> f64 {
    let mut values: Vec<f64> = values.copied().collect();
    median_in_place(&mut values).unwrap_or(0.0)
}

/// The quickest passage one way in a window.
#[derive(Clone, Copy, Debug)]
struct Quickest {
    /// Time stamped at the end of the way minus time stamped at its start, each by its own
    /// clock, s.
    apart: f64,
    /// The same without the clock's drift since the begin of the window.
    least: f64,
    at: f64,
}

#[derive(Clone, Copy, Debug)]
struct Window {
    begin: f64,
    /// Rate of the clock against the computer's, minus one, as known when the window began.
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

    fn add(&mut self, exchange: &Exchange, base: f64) {
        let ways = Self::ways(exchange, base, (self.begin, self.rate));
        for (best, way) in self.ways.iter_mut().zip(ways) {
            if way.least < best.least {
                *best = way;
            }
        }
    }
}

/// State of the exchanges with one clock.
#[derive(Clone, Debug, Default)]
pub(super) struct Leg {
    window: Option<Window>,
    /// Round trips of the latest windows since the last step, s: the quickest way there plus
    /// the quickest way back.
    trips: VecDeque<f64>,
    /// Half the variance of the differences of half the round trips at each lag, s², and the
    /// number of windows in each.
    noise: [f64; LAGS.len()],
    windows: [f64; LAGS.len()],
    /// Number of windows that have ended.
    ended: u32,
    pub(super) odd: u32,
    pub(super) last: Option<f64>,
}

/// Measurement from one window.
pub(super) struct Seen {
    pub(super) at: f64,
    /// The clock minus the computer's, plus half the difference of the ways there and back, s.
    pub(super) offset: f64,
    pub(super) variance: f64,
    /// Step of the round trip, s; mostly zero.
    pub(super) stepped: f64,
}

impl Leg {
    /// Adds an exchange and returns the measurement of the window that it ends, if it ends one.
    /// `rate` is called if a window begins.
    pub(super) fn add(
        &mut self,
        exchange: &Exchange,
        base: f64,
        rate: impl FnOnce() -> f64,
    ) -> Option<Seen> {
        let begin = Window::begin_of(exchange.sent);
        if let Some(window) = self.window.as_mut().filter(|window| window.begin >= begin) {
            window.add(exchange, base);
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
        // The first window is incomplete.
        (self.ended > 1).then(|| self.end(&ended))
    }

    fn end(&mut self, window: &Window) -> Seen {
        let [there, back] = window.ways;
        // An error of the rate does not matter: this is the offset midway between both.
        let at = 0.5 * (there.at + back.at);
        let offset = 0.5 * (there.apart - back.apart);
        let trip = there.apart + back.apart - window.rate * (there.at - back.at);
        self.last = Some(at);
        if self.windows[0] == 0.0 {
            self.noise[0] = (FIRST_NOISE * trip).powi(2);
            self.windows[0] = FIRST_WINDOWS[0];
        }
        let stepped = if self.ended < RATED_WINDOWS {
            0.0
        } else {
            self.settle(trip)
        };
        let sigma = self.trip_sigma();
        let apart = trip - self.settled().unwrap_or(trip);
        let late = if apart.abs() > SLOW_SIGMAS * sigma {
            apart
        } else {
            0.0
        };
        Seen {
            at,
            offset,
            variance: self.noise() + late * late,
            stepped,
        }
    }

    /// Adds the round trip of a window; returns the step of the round trips, s.
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

    /// Returns the usual round trip before the latest windows, s, since the last step.
    pub(super) fn settled(&self) -> Option<f64> {
        let count = self.trips.len();
        let last = if count >= RECENT_WINDOWS + LEAST_WINDOWS {
            count - RECENT_WINDOWS
        } else {
            count
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

    /// Returns the variance of the offset of a good window, s². The two ways scatter
    /// independently, each with half the variance of the round trip.
    fn noise(&self) -> f64 {
        self.noise[0].max(LEAST_NOISE * LEAST_NOISE)
    }

    /// Share of a wander's variance in half the differences at the longer lag.
    fn wandered() -> f64 {
        -(-(LAGS[1] as f64) * WINDOW_S / WANDER_S).exp_m1()
    }

    /// Returns the variance of the slow wander of the asymmetry, s²: half that of the round
    /// trip.
    pub(super) fn wander(&self) -> f64 {
        if self.windows[1] > 0.0 {
            (self.noise[1] - self.noise[0]).max(0.0) / Self::wandered()
        } else {
            FIRST_WANDER * self.noise()
        }
    }

    /// Returns the factor by which a wander fades within `dt` seconds.
    pub(super) fn fade(dt: f64) -> f64 {
        (-dt / WANDER_S).exp()
    }

    /// Returns the 1-sigma of the difference between the medians of the latest and of earlier
    /// round trips, s.
    fn trip_sigma(&self) -> f64 {
        2.0 * (0.6 * self.noise() + 0.25 * self.wander()).sqrt()
    }
}
