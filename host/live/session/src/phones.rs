//! The phones of a session, by their index in the profile, called `place`: 0 is the reference,
//! to whose frames the trigger is aligned.
//!
//! All receive requests at the same time: one twist relates every clock, and videos begin and
//! end together. The trigger follows the reference alone; the position of the other phones'
//! frames is computed ([`placement`]).
//!
//! [`placement`]: crate::alignment::placement

pub(crate) mod videos;

use std::time::Duration;

use clock::ClockRelation;
use clock::rates::RateChange;
use phone::PhoneError;
use phone::task::Pending;
use protocol::Ticks;
use recording::profile::{Phone as PhoneProfile, Profile};

use crate::devices::{Clock, Phone};
use crate::error::{SessionError, Stop};
use crate::event::PhoneName;
use crate::options::seconds;
use clock::rates::Course;

/// Index of the phone to whose frames the trigger is aligned.
pub(crate) const REFERENCE: usize = 0;

/// Interval of the checks that a phone still records, ticks.
const ASK_EVERY: u64 = seconds(5);

/// Pause between two looks for a phone's answer.
const PAUSE: Duration = Duration::from_millis(10);

/// The phones of a session.
pub struct Phones<'a> {
    clock: &'a dyn Clock,
    seats: Vec<Seat<'a>>,
}

struct Seat<'a> {
    profile: &'a PhoneProfile,
    device: Box<dyn Phone>,
    change: RateChange,
    video_may_run: bool,
    check: VideoCheck,
}

/// The answers of phones, each with the phone's index.
pub(crate) type Answers<T> = Vec<(usize, Result<T, PhoneError>)>;

impl<'a> Phones<'a> {
    /// Takes the devices in the order of the profile's phones.
    #[must_use]
    pub fn new(profile: &'a Profile, devices: Vec<Box<dyn Phone>>, clock: &'a dyn Clock) -> Self {
        let seat = |(profile, device)| Seat {
            profile,
            device,
            change: RateChange::default(),
            video_may_run: false,
            check: VideoCheck::default(),
        };
        Self {
            clock,
            seats: profile.all_phones().zip(devices).map(seat).collect(),
        }
    }

    /// Requests the versions of the apps of all phones; stops if `is_interrupted`.
    pub(crate) fn probe(&self, is_interrupted: &dyn Fn() -> bool) -> Result<Vec<String>, Stop> {
        let probe = |place: usize| {
            let asked = self.device(place).probe();
            loop {
                match asked.answer() {
                    Some(Ok(version)) => return Ok(version.to_string()),
                    Some(Err(error)) => return Err(self.failure(place, error).into()),
                    None if is_interrupted() => {
                        cancel(self.clock, [asked]);
                        return Err(Stop::Interrupted);
                    }
                    None => self.clock.wait(PAUSE),
                }
            }
        };
        self.places().map(probe).collect()
    }

    /// Returns the profile of a phone.
    pub(crate) fn profile(&self, place: usize) -> &'a PhoneProfile {
        self.seats[place].profile
    }

    /// Sets the change of rate of a phone's clock.
    pub(crate) fn set_change(&mut self, place: usize, change: RateChange) {
        self.seats[place].change = change;
    }

    /// Combines a relation of a phone's clock with its change of rate.
    pub(crate) fn course(&self, place: usize, clock: ClockRelation) -> Course {
        let change = self.seats[place].change;
        Course { clock, change }
    }

    /// Returns the indices of all phones.
    pub(crate) const fn places(&self) -> std::ops::Range<usize> {
        0..self.seats.len()
    }

    /// Returns the name of a phone for events.
    pub(crate) fn name(&self, place: usize) -> PhoneName {
        PhoneName {
            name: self.profile(place).name.clone(),
            is_only: self.seats.len() == 1,
        }
    }

    /// Converts an error of a phone's request to one of the session.
    pub(crate) fn failure(&self, place: usize, error: PhoneError) -> SessionError {
        let phone = self.profile(place);
        SessionError::Phone {
            name: (self.seats.len() > 1).then(|| phone.name.clone()),
            address: phone.address.clone(),
            error,
        }
    }

    /// Returns a phone.
    pub(crate) fn device(&self, place: usize) -> &dyn Phone {
        self.seats[place].device.as_ref()
    }

    /// Notes that a phone may be recording a video from here on.
    pub(crate) fn set_video_may_run(&mut self, place: usize) {
        self.seats[place].video_may_run = true;
    }

    /// Returns the phones that may be recording a video, and forgets that they may.
    pub(crate) fn take_running_videos(&mut self) -> Vec<usize> {
        let seats = self.seats.iter_mut().enumerate();
        seats
            .filter_map(|(place, seat)| std::mem::take(&mut seat.video_may_run).then_some(place))
            .collect()
    }

    /// Checks that a phone still records, if it is time to. Returns a change of state once the
    /// phone has answered.
    pub(crate) fn video_news(&mut self, place: usize, now: Ticks) -> Option<VideoNews> {
        let seat = &mut self.seats[place];
        if !seat.video_may_run {
            return None;
        }
        seat.check.poll(seat.device.as_ref(), now)
    }

    /// Cancels pending checks, because the next requests need the phones.
    pub(crate) fn cancel_checks(&mut self) {
        let seats = self.seats.iter_mut();
        let asked: Vec<_> = seats.filter_map(|seat| seat.check.asked.take()).collect();
        cancel(self.clock, asked);
    }
}

/// Cancels requests to phones, and waits until they have ended.
pub(crate) fn cancel<T>(clock: &dyn Clock, asked: impl IntoIterator<Item = Pending<T>>) {
    let asked: Vec<_> = asked.into_iter().inspect(Pending::cancel).collect();
    for request in asked {
        while request.answer().is_none() {
            clock.wait(PAUSE);
        }
    }
}

/// A change of state of a phone's video.
pub(crate) enum VideoNews {
    /// The video has ended.
    Ended,
    /// The phone answers again, and still records.
    Back,
    /// The phone does not answer whether it records.
    Away(PhoneError),
}

/// The repeated check that a phone still records.
///
/// The app ends its video when it goes to the background, without notice. While it records, it
/// refuses requests to record sensors, which does not disturb the video; the check is such a
/// request ([`phone::PhoneClient::is_recording`]).
#[derive(Default)]
struct VideoCheck {
    next: Ticks,
    asked: Option<Pending<bool>>,
    is_away: bool,
    has_ended: bool,
}

impl VideoCheck {
    fn poll(&mut self, phone: &dyn Phone, now: Ticks) -> Option<VideoNews> {
        let Some(asked) = &self.asked else {
            if !self.has_ended && now >= self.next {
                self.next = Ticks(now.0.saturating_add(ASK_EVERY));
                self.asked = Some(phone.is_recording());
            }
            return None;
        };
        let answer = asked.answer()?;
        self.asked = None;
        match answer {
            Ok(false) => {
                self.has_ended = true;
                Some(VideoNews::Ended)
            }
            Ok(true) => std::mem::take(&mut self.is_away).then_some(VideoNews::Back),
            Err(error) => {
                (!std::mem::replace(&mut self.is_away, true)).then_some(VideoNews::Away(error))
            }
        }
    }
}
