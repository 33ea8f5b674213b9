//! The board was reset while recording: what the session does about it.
//!
//! 1. As soon as the board answers again, its clock and this computer's are read
//!    beside each other: the new run's place on the recording's axis
//!    ([`super::runs`]).
//! 2. Before the first message of the new run is recorded, a mark is
//!    (`/session/board_run`), and the run is in the session file.
//! 3. The IMU is set up as the profile wants it, the trigger is started on the
//!    grid that it was on, the further outputs join it.
//!
//! The phase against the phone's frames then is as good as the shift is known
//! ([`super::runs::Joint::sigma_s`]), not as good as a twist makes it; the relation of
//! each phone and the board is recorded anew with that uncertainty, and so is where
//! the frames of further phones lie against the depth images. A second twist at the
//! end belongs to the last run.

use protocol::{
    ImuFlags, ImuSample, Period, Refusal, TICK_HZ, Ticks, TrainState, TriggerAlign, TriggerStart,
};

use super::rig::Rig;
use super::runs::Pair;
use super::watch::{Finding, Grid, Watch};
use super::{Stop, further, phones};
use crate::outcome::Failure;
use board::imu::Scale;
use board::{self, BoardError, reset_cause};
use recording::session_file::BoardRun;
use recording::writer::Severity;

/// How often the clocks are read beside each other once the board is back.
const PINGS: usize = 5;

/// How far ahead the first pulse lies at first, ticks; each try takes twice that.
const LEAD: u64 = TICK_HZ as u64 / 2;

/// The farthest ahead, ticks.
const LONGEST_LEAD: u64 = 16 * TICK_HZ as u64;

/// Without any answer of the former run: what came last had come so lately.
const UNASKED: std::time::Duration = std::time::Duration::from_millis(50);

/// What is to be done after a reset.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pending {
    /// Not before this time of the link.
    not_before: std::time::Duration,
    lead: u64,
    /// The first edge of the last try, recorded: its answer may have been lost.
    tried: Option<Ticks>,
}

/// Another scale that holds from the IMU's next set-up on.
#[derive(Clone, Copy, Debug)]
pub(super) struct NextScale {
    scale: Scale,
    /// By this recorded time it was set up, whether its first sample came or not.
    latest: Ticks,
}

impl NextScale {
    /// The scale, if it holds for this sample.
    pub(super) fn of(self, sample: &ImuSample) -> Option<Scale> {
        (sample.flags.has(ImuFlags::FIRST) || sample.at > self.latest).then_some(self.scale)
    }
}

impl Rig<'_> {
    /// Asks the board for its time, where that is due. Never waits.
    pub(super) fn compare_clocks(&mut self) {
        let now = self.board.now();
        if self.watch.is_some() && self.axis.wants_to_ask(now) {
            let id = self.board.ask_time();
            self.axis.asked(id, now);
        }
    }

    /// The link is back and the board is in another run: reads the clocks, before
    /// anything of the run is recorded.
    pub(super) fn meet_new_run(&mut self) {
        let mut best: Option<Pair> = None;
        for _ in 0..PINGS {
            let Ok((board, round_trip)) = self.board.ping() else {
                break;
            };
            let now = self.board.now();
            let pair = Pair::of_round_trip(now.saturating_sub(round_trip), now, board);
            if best.is_none_or(|best| pair.within < best.within) {
                best = Some(pair);
            }
        }
        self.met = best.or(self.met);
        if let Ok(setup) = self.board.imu() {
            self.next_scale = None;
            if let Some(scale) = Scale::of(&setup) {
                self.scale = scale;
            }
        }
    }

    /// All of the former run is recorded; from here on messages are of another.
    pub(super) fn begin_run(&mut self) -> Result<(), Stop> {
        let hello = self.board.hello().clone();
        let fallback = Pair {
            host: self.last_sign,
            board: self.axis.of_board(self.now),
            within: UNASKED,
        };
        let met = self.met.take().unwrap_or(Pair {
            host: self.board.now(),
            board: hello.now,
            within: UNASKED,
        });
        let last = self.now;
        let joint = self.axis.begin(fallback, met, last);
        let from = self.axis.recorded(Ticks(0));
        self.epoch = hello.epoch;
        if let Some(writer) = &mut self.writer {
            writer
                .board_run(from, &hello, &joint, last)
                // Whoever reads what follows must know of it.
                .and_then(|()| writer.flush())
                .map_err(Failure::from)?;
        }
        self.file.runs.push(BoardRun {
            epoch: hello.epoch,
            reset_cause: hello.reset_cause,
            last,
            from,
            shift: joint.shift,
            shift_sigma_us: joint.sigma_s * 1e6,
            anchor: None,
        });
        self.now = self.now.max(from);
        self.problem(Finding::error(
            "board_reset",
            format!(
                "the board was reset ({}); its time goes on {:.3} s later, by this computer's clock \
                 (± {:.0} µs, 1-sigma)",
                reset_cause(hello.reset_cause),
                joint.away_s,
                joint.sigma_s * 1e6
            ),
        ))?;
        for place in self.phone_places() {
            if let Some(mut clock) = self.phone_clock(place) {
                clock.covariance[0][0] += joint.sigma_s.powi(2);
                self.set_phone_clock(place, clock, "after a reset of the board")?;
            }
        }
        if let Some(watch) = &mut self.watch {
            watch.resume(self.now);
        }
        self.pending = Some(Pending {
            not_before: self.board.now(),
            lead: LEAD,
            tried: None,
        });
        if self.writer.is_some() {
            self.save()?;
        }
        Ok(())
    }

    /// Brings a board that was reset back to what it did, if it is time to try.
    pub(super) fn restore(&mut self) -> Result<(), Stop> {
        let Some(mut pending) = self.pending else {
            return Ok(());
        };
        if self.closing || self.board.now() < pending.not_before {
            return Ok(());
        }
        let Some(grid) = self.watch.as_ref().map(Watch::grid) else {
            self.pending = None;
            return Ok(());
        };
        match self.start_on_grid(grid, &mut pending) {
            Ok(anchor) => {
                self.pending = None;
                self.trigger_started = true;
                if let Some(run) = self.file.runs.last_mut() {
                    run.anchor = Some(anchor);
                }
                let period = grid.period;
                self.watch = Some(Watch::new(Grid { anchor, period }, anchor));
                self.tell(
                    Severity::Info,
                    "trigger_restarted",
                    "the trigger runs on its former grid again",
                )?;
                self.save()?;
                phones::place_others_again(self)?;
                match further::start(self) {
                    Err(Stop::Failed(failure)) => self.problem(Finding::error(
                        "outputs_not_restarted",
                        format!("a further output could not be started again: {failure}"),
                    )),
                    other => other,
                }
            }
            // The link is taken up again by whoever pumps; a slow one may have let
            // the first pulse's time pass.
            Err(
                BoardError::Link(_)
                | BoardError::NoAnswer { .. }
                | BoardError::Silent
                | BoardError::Refused {
                    refusal: Refusal::TimeOutOfRange { .. },
                    ..
                },
            ) => {
                self.try_later(pending);
                Ok(())
            }
            Err(error) => Err(Failure::from(error).into()),
        }
    }

    fn try_later(&mut self, pending: Pending) {
        self.pending = Some(Pending {
            not_before: self.board.now() + std::time::Duration::from_millis(500),
            lead: (pending.lead * 2).min(LONGEST_LEAD),
            ..pending
        });
    }

    /// Sets up the IMU and starts the train; gives the recorded time of the edge
    /// from which it is on its grid.
    fn start_on_grid(&mut self, grid: Grid, pending: &mut Pending) -> board::Result<Ticks> {
        if let Ok(wanted) = self.profile.imu_config() {
            let setup = self.board.imu()?;
            if setup.config != wanted {
                let setup = self.board.configure_imu(wanted)?;
                self.next_scale = Scale::of(&setup).map(|scale| NextScale {
                    scale,
                    latest: Ticks(self.now.0.saturating_add(u64::from(TICK_HZ))),
                });
            }
        }
        let running = self.board.trigger()?;
        let next = self.axis.recorded(running.next_edge);
        let runs = running.state != TrainState::Stopped;
        let ours = pending
            .tried
            .filter(|&tried| runs && grid.period.phase_error(tried, next).0 == 0);
        let anchor = match ours {
            Some(tried) => tried,
            None => {
                if runs {
                    self.board.stop_trigger()?;
                }
                let (now, _) = self.board.ping()?;
                let earliest = self
                    .axis
                    .recorded(Ticks(now.0.saturating_add(pending.lead)));
                next_edge(grid, earliest)
            }
        };
        let first_edge = self.axis.of_board(anchor);
        if ours.is_none() {
            pending.tried = Some(anchor);
            self.board.start_trigger(TriggerStart {
                period: grid.period,
                width: self.profile.pulse_width(),
                first_edge: Some(first_edge),
            })?;
        }
        // It is there already: this makes its pulses say so.
        self.board.align(TriggerAlign {
            anchor: first_edge,
            period: grid.period,
            slew: 0,
        })?;
        Ok(anchor)
    }
}

/// The first edge of a grid at or behind a time.
fn next_edge(grid: Grid, earliest: Ticks) -> Ticks {
    let distance = i128::from(earliest.0) - i128::from(grid.anchor.0);
    let raw = i128::from(grid.period.0.max(1));
    let near = (distance << 32).div_euclid(raw);
    (0..=2)
        .filter_map(|step| i64::try_from(near + step).ok())
        .map(|k| Period::edge(grid.period, grid.anchor, k))
        .find(|edge| *edge >= earliest)
        .unwrap_or(earliest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_edge_is_on_the_grid_and_not_before() {
        let grid = Grid {
            anchor: Ticks(123_456_789),
            period: Period::from_picos(33_330_652_540).unwrap_or(Period::MIN),
        };
        for earliest in [0, 1_000, 123_456_789, 123_456_790, 9_876_543_210_123] {
            let edge = next_edge(grid, Ticks(earliest));
            assert!(edge.0 >= earliest);
            assert!(edge.0 - earliest <= u64::from(grid.period.ticks()) + 1);
            assert_eq!(grid.period.phase_error(grid.anchor, edge).0, 0);
        }
    }
}
