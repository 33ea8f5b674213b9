//! Going on after a reset of the board: all that an extraction knows of its later runs.
//!
//! A board that is reset begins a new time, and a session that goes on puts the new
//! run on the axis of the first as well as the computer's clock knows their distance
//! (some milliseconds). The recording marks it ([`RunMark`]). The other modules see one
//! run at a time, or one axis; what joins the runs is here, in four steps:
//!
//! 1. The phone's clock is related to each run by itself. It went on meanwhile, so two
//!    relations that the gyroscopes found also say how long the board was away, far
//!    better than the session knew: [`joints`].
//! 2. Each run is moved there ([`Moves`]), and the board's recording is read again with
//!    every time in its place and the trains numbered on ([`Placing`]). Of several
//!    phones it is the one that the trigger was aligned to that says so; the clocks of
//!    the others are related to the runs as they were moved.
//! 3. Depth frames have their pulses within one run; the camera's clock leads from there
//!    to the others ([`depth`]).
//! 4. The report names each run and how well its place is known ([`reports`]).

pub(crate) mod depth;

use twist_sync::ClockCourse;

use crate::board_data::{BoardEvent, ImuRow, TimePair};
use crate::depth_clock::PulseTime;
use crate::report::BoardRunReport;
use crate::time::BoardNanos;

/// The beginning of a run of the board after a reset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RunMark {
    /// All of the run lies at or behind this time.
    pub(crate) from: BoardNanos,
    /// The last time known of the run before.
    pub(crate) last: BoardNanos,
    /// How well the two runs are related, 1-sigma in s: as a stream has it by the
    /// session.
    pub(crate) sigma_s: f64,
}

/// How much later each run (0: the first) is than it stands in the recording, ns; runs
/// beyond the list are where they stand.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Moves(Vec<i64>);

impl Moves {
    pub(crate) fn of(&self, run: usize) -> i64 {
        self.0.get(run).copied().unwrap_or_default()
    }

    /// Of the last run.
    pub(crate) fn last(&self) -> i64 {
        self.0.last().copied().unwrap_or_default()
    }

    /// Whether anything is moved.
    pub(crate) fn any(&self) -> bool {
        self.0.iter().any(|&by| by != 0)
    }
}

/// Puts what a recording says where its run lies, in the order of the recording.
pub(crate) struct Placing {
    moves: Moves,
    run: usize,
    /// Trains of all former runs, and the highest number so far.
    trains: (u32, u32),
}

impl Placing {
    pub(crate) fn new(moves: Moves) -> Self {
        Self {
            moves,
            run: 0,
            trains: (0, 0),
        }
    }

    /// A time of the run at hand.
    pub(crate) fn later(&self, at: BoardNanos) -> BoardNanos {
        BoardNanos(at.0.saturating_add(self.moves.of(self.run)))
    }

    pub(crate) fn place(&mut self, event: BoardEvent) -> BoardEvent {
        match event {
            BoardEvent::Imu(row) => BoardEvent::Imu(ImuRow {
                at: self.later(row.at),
                ..row
            }),
            BoardEvent::Pulse(pulse) => {
                let train = self.trains.0.saturating_add(pulse.train);
                self.trains.1 = self.trains.1.max(train);
                BoardEvent::Pulse(PulseTime {
                    train,
                    at: self.later(pulse.at),
                    ..pulse
                })
            }
            BoardEvent::Mark(at) => BoardEvent::Mark(self.later(at)),
            BoardEvent::Times(pair) => BoardEvent::Times(TimePair {
                stamp: self.later(pair.stamp),
                ..pair
            }),
            BoardEvent::Clock(phone, model) => {
                let seconds = self.moves.of(self.run) as f64 * 1e-9;
                BoardEvent::Clock(phone, model.with_board_later(seconds))
            }
            BoardEvent::Run(mark) => {
                let last = self.later(mark.last);
                self.trains.0 = self.trains.1;
                self.run += 1;
                let from = self.later(mark.from);
                BoardEvent::Run(RunMark { from, last, ..mark })
            }
            // Nobody is asked any more once the board was reset.
            event @ (BoardEvent::Exchange(..) | BoardEvent::Image(_)) => event,
        }
    }
}

/// Where a run lies behind the one before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Joint {
    /// How much later it is than the recording has it, ns.
    pub(crate) moved: i64,
    /// 1-sigma of its distance to the run before, s.
    pub(crate) sigma_s: f64,
    /// What that is known from.
    by: &'static str,
}

impl Joint {
    /// As the session has it.
    fn kept(moved: i64, sigma_s: f64) -> Self {
        Self {
            moved,
            sigma_s,
            by: "the computer's clock",
        }
    }
}

/// Of each run its joint, the first being where it is: by what the gyroscopes found of
/// the phone's clock in each, where they did in two that follow each other.
pub(crate) fn joints(courses: &[Option<&ClockCourse>], marks: &[RunMark]) -> Vec<Joint> {
    let mut joints = vec![Joint::kept(0, 0.0)];
    for (mark, pair) in marks.iter().zip(courses.windows(2)) {
        let before = joints.last().map_or(0, |joint| joint.moved);
        let [Some(was), Some(is)] = pair else {
            joints.push(Joint::kept(before, mark.sigma_s));
            continue;
        };
        let at = mark.from.0 as f64 * 1e-9;
        let is = is.at(at);
        let step = is.offset - was.at(at).offset;
        // The step changes what the former run's clock says by its rate.
        let was = was.at(at + step);
        let step = ((is.offset - was.offset) * 1e9).round() as i64;
        // Never into the former run.
        let least = mark.last.0.saturating_sub(mark.from.0);
        joints.push(Joint {
            moved: before.saturating_add(step.max(least)),
            sigma_s: (is.covariance[0][0] + was.covariance[0][0]).max(0.0).sqrt(),
            by: "gyroscopes",
        });
    }
    joints
}

/// How the runs are moved by their joints.
pub(crate) fn moves(joints: &[Joint]) -> Moves {
    Moves(joints.iter().map(|joint| joint.moved).collect())
}

/// What is said of each later run; the marks, which are as moved, take how well their
/// places are known. Without joints the runs are where the session has them.
pub(crate) fn reports(marks: &mut [RunMark], joints: &[Joint]) -> Vec<BoardRunReport> {
    let mut reports = Vec::new();
    for (index, mark) in marks.iter_mut().enumerate() {
        let unmoved = Joint::kept(0, mark.sigma_s);
        let joint = joints.get(index + 1).copied().unwrap_or(unmoved);
        mark.sigma_s = joint.sigma_s;
        reports.push(BoardRunReport {
            from_ns: mark.from.0,
            last_before_ns: mark.last.0,
            moved_ns: joint.moved,
            sigma_us: joint.sigma_s * 1e6,
            by: joint.by,
        });
    }
    reports
}
