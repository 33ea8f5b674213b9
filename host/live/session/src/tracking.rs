//! Tracking of the phone's clock while it records, and of the trigger's period by it.
//!
//! A program on the phone ([`PhoneClock`]) and the board are asked for their time many times
//! a second. The answers go into the recording and to the tracker
//! ([`clock::tracker`]), which takes the clocks' offset from the twist and follows its
//! change. While the recording runs, the trigger's period follows ([`clock::steering`]).
//!
//! When the phone's clock can no longer be read, the period stays as it is, as in a
//! session without tracking. This is reported, and noted in the recording's log.

use std::time::Duration;

use board::BoardError;
use clock::ClockRelation;
use clock::steering::{Link, STEP_EVERY_S, Steering, has_lock};
use clock::tracker::{Asked, Exchange, Tracker};
use protocol::{Period, Ticks};
use recording::messages::{ClockExchange, Header};
use recording::session_file::{SessionFile, TrackInfo};

use crate::devices::{PhoneClock, PhoneClockStarter};
use crate::error::{SessionError, Stop};
use crate::event::{SessionEvent, Tracked};
use crate::link::BoardLink;
use crate::link::watch::Watch;
use crate::log::Log;
use crate::options::Track;

/// Time between two questions to the board.
const ASK_EVERY: Duration = Duration::from_millis(40);

/// Time between two reports of the phase.
const REPORT_EVERY: Duration = Duration::from_millis(200);

/// A question that is asked repeatedly, one at a time.
#[derive(Clone, Copy, Debug, Default)]
struct Asking {
    /// Number of the unanswered question, and the time at which it was asked.
    out: Option<(u32, Duration)>,
    last: Duration,
}

impl Asking {
    /// Returns true if it is time to ask again.
    fn is_due(&self, now: Duration) -> bool {
        self.out.is_none() && now.saturating_sub(self.last) >= ASK_EVERY
    }

    /// Notes that the question was asked by this command.
    const fn asked(&mut self, id: u32, now: Duration) {
        self.out = Some((id, now));
        self.last = now;
    }

    /// Notes that this command was answered, or never will be. Returns the time at which it was asked,
    /// if it was this question.
    fn ended(&mut self, id: u32) -> Option<Duration> {
        let (_, asked) = self.out.take_if(|(out, _)| *out == id)?;
        Some(asked)
    }
}

/// The tracked clocks.
pub(crate) struct Tracking {
    phone_clock: Box<dyn PhoneClock>,
    link: Link,
    phone: String,
    tracker: Tracker,
    /// Questions to the board.
    asking: Asking,
    /// Relation that the tracker starts from.
    known: Option<ClockRelation>,
    /// Delay of the phone's `CLOCK_MONOTONIC` behind its `CLOCK_BOOTTIME`, ns.
    slept_ns: Option<i64>,
    following: Option<Following>,
    reported: Duration,
    /// Phase reported last.
    tracked: Option<Tracked>,
}

/// The trigger while its period follows the phone's clock.
struct Following {
    steering: Steering,
    stepped: Duration,
    is_lost: bool,
    /// Step that the board was asked for, and may have carried out.
    unanswered: Option<Step>,
}

/// A change of the period.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Step {
    period: Period,
    /// Phase before the step, and its 1-sigma, µs.
    phase_us: f64,
    sigma_us: f64,
}

impl Following {
    /// Returns the step that the board is to be asked for. An unanswered one comes before any other,
    /// whatever is known of the clocks by now: a repetition changes nothing, and its
    /// answer tells which grid the trigger is on.
    fn due(&mut self, clock: Option<&ClockRelation>, now: Duration, at: Ticks) -> Option<Step> {
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

/// Starts to read the phone's clock, if that is wanted and possible. `is_only_phone` is true if the
/// rig has one phone.
///
/// # Errors
///
/// Tracking is required ([`Track::Always`]) and not possible.
pub(crate) fn start(
    track: Track,
    is_only_phone: bool,
    phone: &str,
    starter: &mut dyn PhoneClockStarter,
    publish: &mut dyn FnMut(SessionEvent),
) -> Result<Option<Tracking>, SessionError> {
    let is_wanted = match track {
        Track::Never => false,
        Track::Always => true,
        Track::IfThere => is_only_phone && starter.is_possible(),
    };
    if !is_wanted {
        return Ok(None);
    }
    let phone_clock = match starter.start() {
        Ok(phone_clock) => phone_clock,
        Err(error) if track == Track::IfThere => {
            publish(SessionEvent::ClockNotFollowed {
                reason: error.to_string(),
            });
            return Ok(None);
        }
        Err(error) => return Err(SessionError::PhoneClock(error)),
    };
    publish(SessionEvent::ClockFollowed {
        device: phone_clock.device().to_owned(),
    });
    Ok(Some(Tracking {
        link: if phone_clock.is_by_network() {
            Link::Network
        } else {
            Link::Usb
        },
        phone_clock,
        phone: phone.to_owned(),
        tracker: Tracker::default(),
        asking: Asking::default(),
        known: None,
        slept_ns: None,
        following: None,
        reported: Duration::ZERO,
        tracked: None,
    }))
}

impl Tracking {
    /// Receives the phone's answers, asks the board if it is time to, and adopts new relations from
    /// twists. Never waits.
    pub(crate) fn look(
        &mut self,
        board: &mut BoardLink<'_>,
        file: &SessionFile,
        log: &mut Log<'_>,
    ) -> Result<(), Stop> {
        for exchange in self.phone_clock.exchanges() {
            let answer = exchange.answer;
            // The second clock is read after the first: the closest of all pairs counts.
            let slept_ns = answer.boot_ns.saturating_sub(answer.monotonic_ns);
            self.slept_ns = self.slept_ns.max(Some(slept_ns));
            let between = (exchange.sent, exchange.received);
            self.receive(log, Asked::B, between, answer.boot_ns, answer.monotonic_ns)?;
        }
        let now = board.board.now();
        if self.asking.is_due(now) {
            self.asking.asked(board.board.ask_time(), now);
        }
        if let Some(clock) = file.clock().filter(|clock| self.known != Some(*clock))
            && self.tracker.add_relation(&clock)
        {
            self.known = Some(clock);
        }
        if self.following.is_some() && now.saturating_sub(self.reported) >= REPORT_EVERY {
            self.reported = now;
            self.tracked = self.tracked(now, log.now);
            log.publish(SessionEvent::Tracked {
                tracked: self.tracked,
            });
        }
        Ok(())
    }

    /// Returns the time that the phone has slept since its start, ns, once both of its clocks were read.
    pub(crate) const fn slept_ns(&self) -> Option<i64> {
        self.slept_ns
    }

    /// Returns the 1-sigma of the phase reported last, µs.
    pub(crate) fn sigma_us(&self) -> Option<f64> {
        self.tracked.map(|tracked| tracked.sigma_us)
    }

    /// Receives the board's answer to a question for its time.
    pub(crate) fn answered(
        &mut self,
        log: &mut Log<'_>,
        id: u32,
        now: Duration,
        at: Ticks,
    ) -> Result<(), Stop> {
        let Some(sent) = self.asking.ended(id) else {
            return Ok(());
        };
        let nanos = i64::try_from(at.as_nanos()).unwrap_or(i64::MAX);
        self.receive(log, Asked::A, (sent, now), nanos, 0)
    }

    /// Notes that this question will not be answered.
    pub(crate) fn expired(&mut self, id: u32) {
        self.asking.ended(id);
    }

    fn receive(
        &mut self,
        log: &mut Log<'_>,
        asked: Asked,
        (sent, received): (Duration, Duration),
        clock_ns: i64,
        monotonic_ns: i64,
    ) -> Result<(), Stop> {
        self.tracker.add(
            asked,
            Exchange {
                sent: sent.as_secs_f64(),
                received: received.as_secs_f64(),
                stamp: clock::PhoneNanos(clock_ns).seconds().0,
            },
        );
        let nanos = |time: Duration| i64::try_from(time.as_nanos()).unwrap_or(i64::MAX);
        let name = match asked {
            Asked::A => "board",
            Asked::B => self.phone.as_str(),
        };
        log.write(|writer, at| {
            let exchange = ClockExchange {
                header: Header::default(),
                sent_ns: nanos(sent),
                received_ns: nanos(received),
                clock_ns,
                monotonic_ns,
            };
            writer.exchange(at, name, exchange)
        })
    }

    /// Returns the present relation of the clocks, once there was a twist.
    fn relation(&self, now: Duration) -> Option<ClockRelation> {
        self.known?;
        self.tracker.relation_at(now.as_secs_f64())
    }

    fn tracked(&self, now: Duration, board_now: Ticks) -> Option<Tracked> {
        let following = self.following.as_ref()?;
        let relation = self.relation(now)?;
        let steering = &following.steering;
        Some(Tracked {
            phase_us: steering.phase_s(&relation, board_now) * 1e6,
            sigma_us: steering.phase_sigma_us(&relation, board_now.into()),
            holds: !following.is_lost,
        })
    }

    /// Lets the period follow from now on. The trigger must be on its grid.
    pub(crate) fn follow(&mut self, file: &mut SessionFile, now: Duration) {
        let Some(alignment) = &file.alignment else {
            return;
        };
        let ratio = file.profile.frame_ratio();
        self.following = Some(Following {
            steering: Steering::new(&alignment.plan, ratio),
            stepped: now,
            is_lost: false,
            unanswered: None,
        });
        file.tracking = Some(TrackInfo {
            device: self.phone_clock.device().to_owned(),
            steps: 0,
            lost: 0,
        });
    }

    /// Returns the period that the board is to be asked for now, if it differs from the present one.
    /// Reports when the phone's clock can no longer be read, and when it can again.
    pub(crate) fn due(
        &mut self,
        file: &mut SessionFile,
        log: &mut Log<'_>,
        now: Duration,
    ) -> Result<Option<Period>, Stop> {
        let relation = self.relation(now);
        let holds = has_lock(&self.tracker, self.link, now.as_secs_f64()) && relation.is_some();
        let Some(following) = &mut self.following else {
            return Ok(None);
        };
        if holds == following.is_lost {
            following.is_lost = !holds;
            report_lock(file, log, holds)?;
            return Ok(None);
        }
        let relation = relation.filter(|_| holds);
        let step = following.due(relation.as_ref(), now, log.now);
        Ok(step.map(|step| step.period))
    }

    /// Receives the board's answer to the period that was [due](Self::due).
    pub(crate) fn stepped(
        &mut self,
        answer: board::Result<protocol::TriggerStatus>,
        watch: Option<&mut Watch>,
        file: &mut SessionFile,
        log: &mut Log<'_>,
    ) -> Result<(), Stop> {
        let Some(following) = &mut self.following else {
            return Ok(());
        };
        let status = match answer {
            Ok(status) => status,
            Err(BoardError::Link(_) | BoardError::NoAnswer { .. } | BoardError::Silent) => {
                return Ok(());
            }
            // The board was reset, as its messages will show.
            Err(BoardError::Refused { .. }) => {
                following.unanswered = None;
                return Ok(());
            }
            Err(error) => return Err(error.into()),
        };
        let Some(step) = following.unanswered.take() else {
            return Ok(());
        };
        let steering = &mut following.steering;
        let grid = steering.follow(status.next_edge, step.period);
        if let Some(watch) = watch {
            watch.follow(grid);
        }
        if let Some(info) = &mut file.tracking {
            info.steps += 1;
        }
        log.write(|writer, _| writer.trigger_period(grid, (step.phase_us, step.sigma_us)))
    }
}

/// Reports that the phone's clock can no longer be read, or is followed again. The recording's log
/// has both with their times; marks would divide the data set.
fn report_lock(file: &mut SessionFile, log: &mut Log<'_>, holds: bool) -> Result<(), Stop> {
    if holds {
        return log.report(SessionEvent::TrackBack);
    }
    if let Some(info) = &mut file.tracking {
        info.lost += 1;
    }
    log.report(SessionEvent::TrackLost)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clock::BoardSeconds;
    use clock::alignment::GridPlan;
    use clock::frames::Frames;

    #[test]
    fn a_step_without_an_answer_is_asked_for_again_before_any_other() {
        let clock = |skew| ClockRelation {
            skew,
            ..ClockRelation::default()
        };
        let plan = GridPlan {
            frames: Frames {
                period_ns: 1e9 / 30.0,
                ..Frames::default()
            },
            clock: clock(1e-5),
            anchor: BoardSeconds(100.0).ticks(),
            period: Period::from_ticks_f64(1.6e6 / (1.0 + 1e-5)),
            ..GridPlan::default()
        };
        let mut following = Following {
            steering: Steering::new(&plan, 1),
            stepped: Duration::ZERO,
            is_lost: false,
            unanswered: None,
        };
        let (clock, warmer) = (plan.clock, clock(1.1e-5));
        let at = |seconds| {
            (
                Duration::from_secs(seconds),
                BoardSeconds(100.0 + seconds as f64).ticks(),
            )
        };
        let (now, board) = at(10);
        let step = following.due(Some(&warmer), now, board).unwrap();
        // No answer; and then the phone falls silent.
        let (now, board) = at(16);
        assert_eq!(following.due(Some(&clock), now, board), Some(step));
        assert_eq!(following.due(None, now, board), Some(step));
        following.unanswered = None;
        assert_eq!(following.due(None, now, board), None);
        let other = following.due(Some(&clock), now, board).unwrap();
        assert_ne!(other.period, step.period);
    }
}
