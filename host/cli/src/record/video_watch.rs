//! Whether the phones still record, asked now and then while the board is recorded.
//!
//! The app ends its video when it goes to the background, and says nothing. While it
//! records, it refuses to record sensors, which costs it nothing; so it is asked for that
//! ([`phone::PhoneClient::is_recording`]).

use phone::PhoneError;
use phone::task::{Pending, PhoneTask};
use protocol::Ticks;
use recording::finding::Finding;
use recording::finding::Severity;

use super::rig::Rig;
use super::steps::mark;
use super::{Stop, seconds};

/// How often a phone is asked, ticks.
const EVERY: u64 = seconds(5);

/// What is known of one phone's video.
#[derive(Default)]
pub(super) struct VideoCheck {
    next: Ticks,
    asked: Option<Pending<bool>>,
    away: bool,
    ended: bool,
}

impl VideoCheck {
    /// What was asked and not answered; it is not waited for any more.
    pub(super) const fn call_off(&mut self) -> Option<Pending<bool>> {
        self.asked.take()
    }

    /// An answer, if there is one; asks if it is time to.
    fn look(&mut self, task: &PhoneTask, now: Ticks) -> Option<Result<bool, PhoneError>> {
        if let Some(asked) = &self.asked {
            let answer = asked.answer()?;
            self.asked = None;
            return Some(answer);
        }
        if !self.ended && now >= self.next {
            self.next = Ticks(now.0.saturating_add(EVERY));
            self.asked = Some(task.is_recording());
        }
        None
    }
}

impl Rig<'_> {
    /// Looks whether the phones' videos run. One that has ended is a problem and a mark;
    /// a phone that cannot be reached is told, since it may come back.
    pub(super) fn watch_videos(&mut self) -> Result<(), Stop> {
        let now = self.now();
        for place in self.phones.places() {
            let label = self.phones.label(place);
            let Some((check, task)) = self.phones.video_check(place) else {
                continue;
            };
            match check.look(task, now) {
                Some(Ok(false)) => {
                    check.ended = true;
                    let text = format!(
                        "the video of {label} has ended: it was stopped by hand, or its app was \
                         in the background"
                    );
                    self.journal.problem(Finding::bad("video_ended", text))?;
                    mark(
                        &mut self.journal,
                        now,
                        Some(format!("{label}: video ended")),
                    )?;
                }
                Some(Ok(true)) if check.away => {
                    check.away = false;
                    self.journal
                        .info("phone_back", &format!("{label} records on"))?;
                }
                Some(Err(error)) if !check.away => {
                    check.away = true;
                    let text = format!("whether {label} records is not known: {error}");
                    self.journal.tell(Severity::Check, "phone_away", &text)?;
                }
                _ => {}
            }
        }
        Ok(())
    }
}
