//! The board was reset while recording: a new run on the recording's axis, and the
//! board back to what it did.

use std::time::Duration;

use protocol::{Output, Period, Refusal, TICK_HZ, Ticks, TrainState, TriggerAlign, TriggerStart};

use crate::outcome::{ExitStatus, Failure};
use crate::record::link::BoardLink;
use crate::record::rig::Rig;
use crate::record::{Stop, further, phones};
use board::imu::Scale;
use board::{BoardError, reset_cause};
use recording::finding::Finding;
use recording::profile::Profile;
use recording::session_file::BoardRun;
use session::watch::{Grid, Watch};
use timebase::runs::{Joint, Pair};

/// How often the clocks are read beside each other once the board is back.
const PINGS: usize = 5;

/// How far ahead the first pulse lies at first, ticks; each try takes twice that.
const LEAD: u64 = TICK_HZ as u64 / 2;

/// The farthest ahead, ticks.
const LONGEST_LEAD: u64 = 16 * TICK_HZ as u64;

/// Without any answer of the former run: what came last had come so lately.
const UNASKED: Duration = Duration::from_millis(50);

/// What is to be done after a reset.
#[derive(Clone, Copy, Debug)]
pub(in crate::record) struct Pending {
    /// Not before this time of the link.
    not_before: Duration,
    lead: u64,
    /// The first edge of the last try, recorded: its answer may have been lost.
    tried: Option<Ticks>,
}

/// The board began anew while nothing was recorded that could go on.
pub(in crate::record) fn reset_ends_session(last: Ticks) -> Failure {
    Failure::new(
        ExitStatus::LinkLost,
        format!(
            "the board was reset {:.3} s after its last one: what was found out about its clock is \
             void, so the session ends here",
            last.as_secs_f64()
        ),
    )
    .next_step("`smartdepthsync info` says why it was reset; then record again")
}

impl BoardLink<'_> {
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
            self.set_scale(Scale::of(&setup));
        }
    }

    /// Puts the new run on the axis, behind `last`.
    fn begin_run(&mut self, last: Ticks) -> Joint {
        let fallback = Pair {
            host: self.last_sign,
            board: self.axis.of_board(last),
            within: UNASKED,
        };
        let met = self.met.take().unwrap_or(Pair {
            host: self.board.now(),
            board: self.board.hello().now,
            within: UNASKED,
        });
        self.epoch = self.board.hello().epoch;
        self.axis.begin(fallback, met, last)
    }

    /// Sets up the IMU and starts the train; gives the recorded time of the edge
    /// from which it is on its grid.
    fn start_on_grid(
        &mut self,
        grid: Grid,
        profile: &Profile,
        now: Ticks,
        pending: &mut Pending,
    ) -> board::Result<Ticks> {
        if let Ok(wanted) = profile.imu_config()
            && self.board.imu()?.config != wanted
        {
            let setup = self.board.configure_imu(wanted)?;
            self.expect_scale(Scale::of(&setup), now);
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
                    self.board.stop_trigger(Output::Camera)?;
                }
                let (now, _) = self.board.ping()?;
                let earliest = Ticks(now.0.saturating_add(pending.lead));
                next_edge(grid, self.axis.recorded(earliest))
            }
        };
        let first_edge = self.axis.of_board(anchor);
        if ours.is_none() {
            pending.tried = Some(anchor);
            let start = TriggerStart {
                period: grid.period,
                width: profile.pulse_width(),
                first_edge: Some(first_edge),
                first_fraction: 0,
            };
            self.board.start_trigger(Output::Camera, start)?;
        }
        // It is there already: this makes its pulses say so.
        let to = TriggerAlign {
            anchor: first_edge,
            anchor_fraction: 0,
            period: grid.period,
            slew: 0,
        };
        self.board.align(Output::Camera, to)?;
        Ok(anchor)
    }
}

impl Rig<'_> {
    /// All of the former run is recorded; from here on messages are of another.
    pub(in crate::record) fn begin_run(&mut self) -> Result<(), Stop> {
        let journal = &mut self.journal;
        let last = journal.now;
        let joint = self.link.begin_run(last);
        let hello = self.link.board.hello();
        let from = self.link.axis.recorded(Ticks(0));
        journal.write(|writer, _| {
            writer.board_run(from, hello, &joint, last)?;
            // Whoever reads what follows must know of it.
            writer.flush()
        })?;
        journal.file.runs.push(BoardRun {
            epoch: hello.epoch,
            reset_cause: hello.reset_cause,
            last,
            from,
            shift: joint.shift,
            shift_sigma_us: joint.sigma_s * 1e6,
            anchor: None,
        });
        journal.now = last.max(from);
        journal.problem(Finding::bad(
            "board_reset",
            format!(
                "the board was reset ({}); its time goes on {:.3} s later, by this computer's clock \
                 (± {:.0} µs, 1-sigma)",
                reset_cause(hello.reset_cause),
                joint.away_s,
                joint.sigma_s * 1e6
            ),
        ))?;
        for place in self.phones.places() {
            if let Some(mut clock) = journal.clock(place) {
                clock.covariance[0][0] += joint.sigma_s.powi(2);
                journal.set_clock(place, clock, "after a reset of the board")?;
            }
        }
        self.observers.resume(journal.now);
        self.pending = Some(Pending {
            not_before: self.link.board.now(),
            lead: LEAD,
            tried: None,
        });
        if journal.writer.is_some() {
            journal.save()?;
        }
        Ok(())
    }

    /// Brings a board that was reset back to what it did, if it is time to try.
    pub(in crate::record) fn restore(&mut self) -> Result<(), Stop> {
        let Some(mut pending) = self.pending else {
            return Ok(());
        };
        if self.closing || self.link.board.now() < pending.not_before {
            return Ok(());
        }
        let Some(grid) = self.observers.watch.as_ref().map(Watch::grid) else {
            self.pending = None;
            return Ok(());
        };
        let now = self.now();
        let started = self
            .link
            .start_on_grid(grid, self.profile, now, &mut pending);
        match started {
            Ok(anchor) => self.restored(grid, anchor),
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
                self.pending = Some(Pending {
                    not_before: self.link.board.now() + Duration::from_millis(500),
                    lead: (pending.lead * 2).min(LONGEST_LEAD),
                    ..pending
                });
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }

    /// The trigger is on its grid again from `anchor` on.
    fn restored(&mut self, grid: Grid, anchor: Ticks) -> Result<(), Stop> {
        self.pending = None;
        self.trigger_started = true;
        if let Some(run) = self.journal.file.runs.last_mut() {
            run.anchor = Some(anchor);
        }
        let grid = Grid {
            anchor,
            fraction: 0,
            period: grid.period,
        };
        self.observers.watch = Some(Watch::new(grid, anchor));
        // The period that was followed is not the alignment's.
        self.journal
            .write(|writer, _| writer.trigger_period(grid, (f64::NAN, f64::NAN)))?;
        let text = "the trigger runs on its former grid again";
        self.journal.info("trigger_restarted", text)?;
        self.journal.save()?;
        phones::place_others(&self.phones, &mut self.journal)?;
        match further::start(self) {
            Err(Stop::Failed(failure)) => self.journal.problem(Finding::bad(
                "outputs_not_restarted",
                format!("a further output could not be started again: {failure}"),
            )),
            other => other,
        }
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
        // One before tick 0 is cut to it, and is none.
        .find(|&edge| edge >= earliest && grid.period.phase_error(grid.anchor, edge).0 == 0)
        .unwrap_or(earliest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_edge_is_on_the_grid_and_not_before() {
        let grid = Grid {
            anchor: Ticks(123_456_789),
            fraction: 0,
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
