//! One axis of time for a recording in which the board is reset.
//!
//! A board that is reset counts its ticks from 0 again. The recording goes on
//! counting: what the board says of a later run is put behind the former run by
//! adding a whole number of ticks, the *shift*. So time never goes back in a
//! recording, and the board's own ticks are the recorded ones less the shift, to
//! the tick.
//!
//! How long the board was away is known from this computer's clock, which is
//! read beside the board's by pings once a second while recording, and again as
//! soon as the board is back. Half a round trip on either side and the rates of
//! two crystals over the gap are what the shift may be wrong by ([`Joint::sigma_s`]):
//! some tenths of a millisecond for a gap of a few seconds. Within a run
//! nothing is uncertain by it. The extraction finds the relation of each run to
//! the phone from the gyroscopes and takes the error of the shift out again.
//!
//! Limit: a computer that sleeps meanwhile does not know for how long.

use std::time::Duration;

use protocol::{DeviceToHost, TICK_HZ, Ticks};

/// What the rates of the board's and this computer's clocks differ by at most,
/// unless more was seen: two cheap crystals.
const RATES: f64 = 50e-6;

/// Over less than this a rate says nothing, s.
const RATE_SPAN: f64 = 5.0;

/// How often the clocks are compared.
const ASK_EVERY: Duration = Duration::from_secs(1);

/// One instant on this computer's clock and on the board's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pair {
    /// This computer's, which is the link's.
    pub host: Duration,
    /// The board's, in its own run.
    pub board: Ticks,
    /// The two are at most this far apart.
    pub within: Duration,
}

impl Pair {
    /// From a round trip that began at `asked` and ended at `answered`.
    #[must_use]
    pub fn of_round_trip(asked: Duration, answered: Duration, board: Ticks) -> Self {
        let within = answered.saturating_sub(asked) / 2;
        Self {
            host: asked + within,
            board,
            within,
        }
    }

    /// How far the board may have moved against it by `now`, s.
    fn uncertainty(&self, now: Duration) -> f64 {
        let age = now.abs_diff(self.host).as_secs_f64();
        self.within.as_secs_f64() + RATES * age
    }
}

/// A question that is asked again and again, one at a time.
#[derive(Clone, Copy, Debug, Default)]
pub struct Asking {
    /// The one that is out, and when it was asked.
    out: Option<(u32, Duration)>,
    last: Duration,
}

impl Asking {
    /// Whether it is time to ask again.
    #[must_use]
    pub fn is_due(&self, now: Duration, every: Duration) -> bool {
        self.out.is_none() && now.saturating_sub(self.last) >= every
    }

    /// It was asked by this command.
    pub const fn asked(&mut self, id: u32, now: Duration) {
        self.out = Some((id, now));
        self.last = now;
    }

    /// This command has its answer, or none will come: when it was asked, if it was this
    /// question.
    pub fn ended(&mut self, id: u32) -> Option<Duration> {
        let (_, asked) = self.out.take_if(|(out, _)| *out == id)?;
        Some(asked)
    }
}

/// How a run joins the one before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Recorded ticks less the board's.
    pub shift: u64,
    /// 1-sigma of it, s.
    pub sigma_s: f64,
    /// From the last thing known of the former run to the first of this one, s.
    pub away_s: f64,
}

/// The axis of a recording's time, with the board's runs on it.
#[derive(Clone, Debug, Default)]
pub struct Axis {
    shift: u64,
    first: Option<Pair>,
    best: Option<Pair>,
    asking: Asking,
}

impl Axis {
    /// The recorded time of a time of the board.
    #[must_use]
    pub const fn recorded(&self, board: Ticks) -> Ticks {
        Ticks(board.0.saturating_add(self.shift))
    }

    /// The board's time of a recorded time; 0 if that was before its run.
    #[must_use]
    pub const fn of_board(&self, recorded: Ticks) -> Ticks {
        Ticks(recorded.0.saturating_sub(self.shift))
    }

    /// Whether it is time to ask the board for its time.
    #[must_use]
    pub fn wants_to_ask(&self, now: Duration) -> bool {
        self.asking.is_due(now, ASK_EVERY)
    }

    /// It was asked by this command.
    pub const fn asked(&mut self, id: u32, now: Duration) {
        self.asking.asked(id, now);
    }

    /// No answer to this command will come.
    pub fn expired(&mut self, id: u32) {
        self.asking.ended(id);
    }

    /// The board has answered.
    pub fn answered(&mut self, id: u32, now: Duration, board: Ticks) {
        if let Some(asked) = self.asking.ended(id) {
            self.heard(Pair::of_round_trip(asked, now, board));
        }
    }

    /// Both clocks were read.
    pub fn heard(&mut self, pair: Pair) {
        self.first.get_or_insert(pair);
        let better = self
            .best
            .is_none_or(|best| pair.within.as_secs_f64() <= best.uncertainty(pair.host));
        if better {
            self.best = Some(pair);
        }
    }

    /// How far the rates of the two clocks differ.
    fn rates(&self) -> f64 {
        let (Some(first), Some(best)) = (self.first, self.best) else {
            return RATES;
        };
        let host = best.host.saturating_sub(first.host).as_secs_f64();
        if host < RATE_SPAN {
            return RATES;
        }
        let board = best.board.0.saturating_sub(first.board.0) as f64 / f64::from(TICK_HZ);
        let known = (first.within + best.within).as_secs_f64() / host;
        ((board / host - 1.0).abs() - known).max(RATES)
    }

    /// The board began anew. `fallback` stands for what was known of the former
    /// run if it was never asked; `last` is the last recorded time of it, behind
    /// which the new run must lie.
    pub fn begin(&mut self, fallback: Pair, now: Pair, last: Ticks) -> Joint {
        let rates = self.rates();
        let before = self.best.take().unwrap_or(fallback);
        let gap = now.host.saturating_sub(before.host);
        let ticks = gap.as_nanos() * u128::from(TICK_HZ) / 1_000_000_000;
        let ticks = u64::try_from(ticks).unwrap_or(u64::MAX);
        let there = self.recorded(before.board).0.saturating_add(ticks);
        // Tick 0 of the run lies behind all of the former one.
        let shift = there.saturating_sub(now.board.0);
        let late = last.0.saturating_add(1).saturating_sub(shift);
        self.shift = shift.saturating_add(late);
        self.first = Some(now);
        self.best = Some(now);
        self.asking.out = None;
        let uniform = |within: Duration| within.as_secs_f64().powi(2) / 3.0;
        let drift = rates * gap.as_secs_f64();
        let forced = late as f64 / f64::from(TICK_HZ);
        let variance = uniform(before.within) + uniform(now.within) + drift.powi(2);
        Joint {
            shift: self.shift,
            sigma_s: (variance + forced.powi(2)).sqrt(),
            away_s: self.recorded(now.board).0.saturating_sub(last.0) as f64 / f64::from(TICK_HZ),
        }
    }

    /// A message with its times on the axis. Answers stay as they are: they are
    /// the board's own.
    #[must_use]
    pub fn message(&self, mut message: DeviceToHost) -> DeviceToHost {
        match &mut message {
            DeviceToHost::Hello(hello) => hello.now = self.recorded(hello.now),
            DeviceToHost::Status(status) => status.at = self.recorded(status.at),
            DeviceToHost::Pulse(pulse) => pulse.at = self.recorded(pulse.at),
            DeviceToHost::Arrived(arrived) => arrived.at = self.recorded(arrived.at),
            DeviceToHost::Capture(capture) => capture.at = self.recorded(capture.at),
            DeviceToHost::Imu(sample) => sample.at = self.recorded(sample.at),
            DeviceToHost::Pps(pps) => pps.at = self.recorded(pps.at),
            DeviceToHost::Answer(_) | DeviceToHost::Filler(_) => {}
        }
        message
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HZ: u64 = TICK_HZ as u64;

    fn pair(host_ms: u64, board: u64, within_us: u64) -> Pair {
        Pair {
            host: Duration::from_millis(host_ms),
            board: Ticks(board),
            within: Duration::from_micros(within_us),
        }
    }

    #[test]
    fn a_second_run_lies_where_the_hosts_clock_has_it() {
        let mut axis = Axis::default();
        axis.heard(pair(10_000, 3 * HZ, 400));
        axis.heard(pair(11_000, 4 * HZ, 300));
        // A slow round trip teaches nothing.
        axis.heard(pair(11_500, 9 * HZ, 90_000));
        let last = Ticks(4 * HZ + HZ / 2);
        let joint = axis.begin(pair(0, 0, 1), pair(13_000, HZ / 4, 300), last);
        // Tick HZ/4 of the new run was two seconds after tick 4·HZ of the old.
        assert_eq!(axis.recorded(Ticks(HZ / 4)), Ticks(6 * HZ));
        assert_eq!(axis.of_board(Ticks(6 * HZ)), Ticks(HZ / 4));
        assert_eq!(joint.shift, 6 * HZ - HZ / 4);
        assert!((joint.away_s - 1.5).abs() < 1e-9, "{joint:?}");
        // √(300² + 300²)/√3 µs and 50 ppm of 2 s.
        assert!((joint.sigma_s - 264.6e-6).abs() < 1e-6, "{joint:?}");

        // And a third behind it.
        let third = axis.begin(pair(0, 0, 1), pair(15_000, 0, 300), Ticks(6 * HZ));
        assert_eq!(axis.recorded(Ticks(0)), Ticks(8 * HZ));
        assert_eq!(third.shift, 8 * HZ);
    }

    #[test]
    fn time_never_goes_back() {
        let mut axis = Axis::default();
        axis.heard(pair(1_000, HZ, 300));
        let joint = axis.begin(pair(0, 0, 1), pair(1_500, HZ, 300), Ticks(20 * HZ));
        assert_eq!(axis.recorded(Ticks(0)), Ticks(20 * HZ + 1));
        // And the sigma says that this is not to be believed.
        assert!(joint.sigma_s > 15.0, "{joint:?}");
    }

    #[test]
    fn clocks_of_different_speed_are_seen() {
        let mut axis = Axis::default();
        axis.heard(pair(0, 0, 300));
        axis.heard(pair(10_000, 30 * HZ, 300));
        let joint = axis.begin(pair(0, 0, 1), pair(11_000, 0, 300), Ticks(30 * HZ));
        assert!((joint.sigma_s - 2.0).abs() < 0.01, "{joint:?}");
    }

    #[test]
    fn an_answer_is_a_pair_once() {
        let mut axis = Axis::default();
        let second = Duration::from_secs(1);
        assert!(axis.wants_to_ask(second));
        axis.asked(7, second);
        assert!(!axis.wants_to_ask(second * 5));
        axis.answered(8, second, Ticks(1));
        assert_eq!(axis.best, None);
        axis.answered(7, second + Duration::from_millis(2), Ticks(5));
        let expected = pair(1_001, 5, 1_000);
        assert_eq!(axis.best, Some(expected));
        axis.asked(9, second * 2);
        axis.expired(9);
        assert!(axis.wants_to_ask(second * 3));
    }
}
