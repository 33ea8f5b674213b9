//! The phone's clock while it records, and the trigger's period that follows it.
//!
//! A program of ours on the phone ([`phone::agent`]) and the board are asked for their time
//! many times a second. What they answer goes into the recording and to the tracker
//! ([`twist_sync::tracker`]), which knows the clocks' offset from the twist and follows its
//! change. While the recording runs, the trigger's period follows ([`session::steering`]).
//!
//! Where the phone is not heard any more, or the board is reset, the period stays as it is:
//! what a session without all this does. That is told, and stands in the recording's log.

use std::time::Duration;

use phone::agent::Agent;
use protocol::{Output, Period, Ticks};
use twist_sync::tracker::{Asked, Exchange, Tracker};

use super::Stop;
use super::journal::Journal;
use super::link::BoardLink;
use super::rig::Rig;
use crate::context::Context;
use crate::outcome::Failure;
use crate::tracked::Tracked;
use board::BoardError;
use board::transport::serial::program_time;
use recording::finding::Severity;
use recording::messages::{ClockExchange, Header};
use recording::profile::Profile;
use recording::session_file::TrackInfo;
use session::steering::{Link, STEP_EVERY_S, Steering, has_lock};
use timebase::ClockModel;
use timebase::runs::Asking;

/// The board is asked so often.
const ASK_EVERY: Duration = Duration::from_millis(40);

/// Whether the phone's clock is to be followed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Track {
    /// Where an `adb` server runs and has a phone.
    #[default]
    IfThere,
    /// It is an error if it cannot be.
    Always,
    /// Never.
    Never,
}

/// The clocks as they are followed.
pub(super) struct Tracking {
    agent: Agent,
    link: Link,
    phone: String,
    tracker: Tracker,
    /// The questions to the board.
    asking: Asking,
    /// What the tracker was told of the clocks.
    known: Option<ClockModel>,
    temperature: Option<f64>,
    following: Option<Following>,
}

/// The trigger on the phone's frames.
struct Following {
    steering: Steering,
    stepped: Duration,
    is_lost: bool,
    /// The board was asked for it, and may have taken it.
    unanswered: Option<Step>,
}

/// Another period.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Step {
    period: Period,
    /// The phase before it, and its 1-sigma, µs.
    phase_us: f64,
    sigma_us: f64,
}

impl Following {
    /// The step that the board is to be asked for. One without an answer comes before any other,
    /// whatever is known of the clocks by now: to ask for it again does nothing more, and its
    /// answer says which grid the trigger is on.
    fn due(&mut self, clock: Option<&ClockModel>, now: Duration, at: Ticks) -> Option<Step> {
        if self.unanswered.is_none() {
            let since_s = now.saturating_sub(self.stepped).as_secs_f64();
            let clock = clock.filter(|_| since_s >= STEP_EVERY_S)?;
            self.stepped = now;
            let steering = &self.steering;
            let period = steering.wanted(clock, at, since_s)?;
            self.unanswered = Some(Step {
                period,
                phase_us: steering.phase_s(clock, at) * 1e6,
                sigma_us: steering.phase_sigma_us(clock, at.into()),
            });
        }
        self.unanswered
    }
}

/// Starts the program on the phone, if that is wanted and can be.
///
/// # Errors
///
/// It is wanted in any case, and cannot be.
pub(super) fn start(
    track: Track,
    profile: &Profile,
    context: &Context,
) -> Result<Option<Tracking>, Failure> {
    let is_wanted = match track {
        Track::Never => false,
        Track::Always => true,
        Track::IfThere => profile.phones.is_empty() && phone::adb::server_runs(),
    };
    if !is_wanted {
        return Ok(None);
    }
    let stop = context.interrupt.stop_signal();
    let agent = match Agent::start(program_time, &stop) {
        Ok(agent) => agent,
        Err(error) if track == Track::IfThere => {
            context.say(format!("the phone's clock is not followed: {error}"));
            return Ok(None);
        }
        Err(error) => return Err(phone::PhoneError::from(error).into()),
    };
    let link = match agent.is_by_network() {
        true => Link::Network,
        false => Link::Usb,
    };
    context.say(format!("the clock of phone {} is followed", agent.device()));
    Ok(Some(Tracking {
        agent,
        link,
        phone: profile.phone.name.clone(),
        tracker: Tracker::new(),
        asking: Asking::default(),
        known: None,
        temperature: None,
        following: None,
    }))
}

impl Tracking {
    /// Takes what the phone has answered, asks the board if it is time to, and learns what
    /// twists say. Never waits.
    pub(super) fn look(
        &mut self,
        board: &mut BoardLink<'_>,
        journal: &mut Journal<'_>,
    ) -> Result<(), Stop> {
        let exchanges: Vec<_> = self.agent.exchanges().collect();
        for exchange in exchanges {
            let answer = exchange.answer;
            let tenths = answer.temperature.map(f64::from);
            self.temperature = tenths.map(|tenths| tenths / 10.0);
            self.take(
                journal,
                Asked::B,
                (exchange.sent, exchange.received),
                (answer.boot_ns, answer.monotonic_ns),
            )?;
        }
        let now = board.board.now();
        if self.asking.is_due(now, ASK_EVERY) {
            self.asking.asked(board.board.ask_time(), now);
        }
        if let Some(clock) = journal
            .file
            .clock
            .filter(|clock| self.known != Some(*clock))
            && self.tracker.take_relation(&clock.into())
        {
            self.known = Some(clock);
        }
        journal.live.gauge.tracked = self.tracked(now, journal.now);
        Ok(())
    }

    /// The board has answered; its time is a recorded one.
    pub(super) fn answered(
        &mut self,
        journal: &mut Journal<'_>,
        id: u32,
        now: Duration,
        at: Ticks,
    ) -> Result<(), Stop> {
        let Some(sent) = self.asking.ended(id) else {
            return Ok(());
        };
        let nanos = i64::try_from(at.as_nanos()).unwrap_or(i64::MAX);
        self.take(journal, Asked::A, (sent, now), (nanos, 0))
    }

    /// No answer to this question will come.
    pub(super) fn expired(&mut self, id: u32) {
        self.asking.ended(id);
    }

    fn take(
        &mut self,
        journal: &mut Journal<'_>,
        asked: Asked,
        (sent, received): (Duration, Duration),
        (clock_ns, monotonic_ns): (i64, i64),
    ) -> Result<(), Stop> {
        self.tracker.take(
            asked,
            Exchange {
                sent: sent.as_secs_f64(),
                received: received.as_secs_f64(),
                stamp: timebase::PhoneNanos(clock_ns).seconds().0,
            },
        );
        let nanos = |time: Duration| i64::try_from(time.as_nanos()).unwrap_or(i64::MAX);
        let (name, temperature) = match asked {
            Asked::A => ("board", None),
            Asked::B => (self.phone.as_str(), self.temperature),
        };
        journal.write(|writer, at| {
            let exchange = ClockExchange {
                header: Header::default(),
                sent_ns: nanos(sent),
                received_ns: nanos(received),
                clock_ns,
                monotonic_ns,
                temperature: temperature.unwrap_or(f64::NAN),
            };
            writer.exchange(at, name, exchange)
        })
    }

    /// The relation of the clocks now, once a twist has been told.
    fn relation(&self, now: Duration) -> Option<ClockModel> {
        self.known?;
        let relation = self.tracker.relation_at(now.as_secs_f64())?;
        Some(relation.into())
    }

    fn tracked(&self, now: Duration, board_now: Ticks) -> Option<Tracked> {
        let following = self.following.as_ref()?;
        let relation = self.relation(now)?;
        let steering = &following.steering;
        Some(Tracked {
            phase_us: steering.phase_s(&relation, board_now) * 1e6,
            sigma_us: steering.phase_sigma_us(&relation, board_now.into()),
            temperature: self.temperature,
            holds: !following.is_lost,
        })
    }
}

/// From here on the period follows: the trigger is on its grid.
pub(super) fn follow(rig: &mut Rig<'_>) {
    let now = rig.link.board.now();
    let ratio = rig.profile.frame_ratio();
    if let (Some(tracking), Some(alignment)) = (&mut rig.tracking, &rig.journal.file.alignment) {
        rig.journal.file.tracking = Some(TrackInfo {
            device: tracking.agent.device().to_owned(),
            steps: 0,
            lost: 0,
        });
        tracking.following = Some(Following {
            steering: Steering::new(alignment, ratio),
            stepped: now,
            is_lost: false,
            unanswered: None,
        });
    }
}

/// Sets another period, if it is time to and the clocks are known; tells if they are not any
/// more, and if they are again.
pub(super) fn steer(rig: &mut Rig<'_>) -> Result<(), Stop> {
    let now = rig.link.board.now();
    let board_now = rig.now();
    let Some(tracking) = &mut rig.tracking else {
        return Ok(());
    };
    let relation = tracking.relation(now);
    let holds = has_lock(&tracking.tracker, tracking.link, now.as_secs_f64()) && relation.is_some();
    let Some(following) = &mut tracking.following else {
        return Ok(());
    };
    if holds == following.is_lost {
        following.is_lost = !holds;
        tell_lock(rig, holds)?;
        return Ok(());
    }
    let relation = relation.filter(|_| holds);
    let Some(step) = following.due(relation.as_ref(), now, board_now) else {
        return Ok(());
    };
    // A link that breaks is taken up here: what came meanwhile waits in the board's queue
    // until it is known on which grid it is.
    let answer = rig.try_call(|board| board.set_period(Output::Camera, step.period))?;
    let tracking = rig.tracking.as_mut();
    let Some(following) = tracking.and_then(|tracking| tracking.following.as_mut()) else {
        // The board was reset meanwhile.
        return Ok(());
    };
    let status = match answer {
        Ok(status) => status,
        Err(BoardError::Link(_) | BoardError::NoAnswer { .. } | BoardError::Silent) => {
            return Ok(());
        }
        // Of a board that was reset, which its messages will say.
        Err(BoardError::Refused { .. }) => {
            following.unanswered = None;
            return Ok(());
        }
        Err(error) => return Err(error.into()),
    };
    following.unanswered = None;
    let next = rig.link.axis.recorded(status.next_edge);
    let steering = &mut following.steering;
    let grid = steering.follow(next, status.next_fraction, step.period);
    if let Some(watch) = &mut rig.observers.watch {
        watch.follow(grid);
    }
    if let Some(info) = &mut rig.journal.file.tracking {
        info.steps += 1;
    }
    rig.journal
        .write(|writer, _| writer.trigger_period(grid, (step.phase_us, step.sigma_us)))
}

/// The lock was lost, or is there again. Both stand in the recording's log with their times;
/// they are no marks, which would divide the data set.
fn tell_lock(rig: &mut Rig<'_>, holds: bool) -> Result<(), Stop> {
    if holds {
        return rig
            .journal
            .info("track_back", "the phone's clock is followed again");
    }
    if let Some(info) = &mut rig.journal.file.tracking {
        info.lost += 1;
    }
    let text = "the phone's clock is not heard any more: the trigger's period stays, and the \
                phase drifts as without tracking; check the phone's cable and `adb devices`";
    rig.journal.warn("track_lost", text)
}

/// The board was reset: its time goes on by the computer's clock, which the tracker's
/// offset does not.
pub(super) fn give_up(rig: &mut Rig<'_>) -> Result<(), Stop> {
    rig.journal.live.gauge.tracked = None;
    match rig.tracking.take() {
        None => Ok(()),
        Some(_) => rig.journal.tell(
            Severity::Check,
            "track_ended",
            "the board was reset: the phone's clock is not followed from here on",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::session_file::Video;
    use session::alignment::plan;
    use session::twists::Twists;
    use timebase::{BoardSeconds, PhoneNanos, Wander};

    #[test]
    fn a_step_without_an_answer_is_asked_for_again_before_any_other() {
        let clock = ClockModel {
            reference: BoardSeconds(100.0),
            offset: 5.0,
            skew: 1e-5,
            covariance: [[1e-12, 0.0], [0.0, 1e-14]],
            wander: Wander::default(),
        };
        let video = Video {
            phase: PhoneNanos(106_000_000_000),
            frame_duration_ns: 1e9 / 30.0,
            exposure_ns: Some(1_000_000),
        };
        let profile = Profile::published().unwrap();
        let planned = plan(&profile, &Twists::of(clock).course(), &video).unwrap();
        let mut following = Following {
            steering: Steering::new(&planned.alignment, profile.frame_ratio()),
            stepped: Duration::ZERO,
            is_lost: false,
            unanswered: None,
        };
        let warmer = ClockModel {
            skew: 1.1e-5,
            ..clock
        };
        let at = |seconds| {
            (
                Duration::from_secs(seconds),
                BoardSeconds(100.0 + seconds as f64).ticks(),
            )
        };
        let (now, board) = at(10);
        let step = following.due(Some(&warmer), now, board).unwrap();
        // No answer; and then the phone is not heard any more.
        let (now, board) = at(16);
        assert_eq!(following.due(Some(&clock), now, board), Some(step));
        assert_eq!(following.due(None, now, board), Some(step));
        following.unanswered = None;
        assert_eq!(following.due(None, now, board), None);
        let other = following.due(Some(&clock), now, board).unwrap();
        assert_ne!(other.period, step.period);
    }
}
