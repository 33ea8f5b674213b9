//! The phones of a session, by their place in the profile: 0 is the reference, to whose
//! frames the trigger is aligned; the others follow in order.
//!
//! All are asked at the same time: one twist relates every clock, and videos begin and end
//! together. The trigger follows the first alone; of the others it is stated where their
//! frames lie ([`placement`]).
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

/// The place of the phone to whose frames the trigger is aligned.
pub(crate) const REFERENCE: usize = 0;

/// How often a phone that records is asked whether it does, ticks.
const ASK_EVERY: u64 = seconds(5);

/// Pause while a phone is waited for and nothing else is to be done.
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

/// The answers of phones, by their places.
pub(crate) type Answers<T> = Vec<(usize, Result<T, PhoneError>)>;

impl<'a> Phones<'a> {
    /// These phones, in the profile's order.
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

    /// Asks all for the versions of their apps; ends when `is_interrupted`.
    pub(crate) fn probe(&self, is_interrupted: &dyn Fn() -> bool) -> Result<Vec<String>, Stop> {
        let probe = |place: usize| {
            let asked = self.device(place).probe();
            loop {
                match asked.answer() {
                    Some(Ok(version)) => return Ok(version.to_string()),
                    Some(Err(error)) => return Err(self.failure(place, error).into()),
                    None if is_interrupted() => {
                        call_off(self.clock, [asked]);
                        return Err(Stop::Interrupted);
                    }
                    None => self.clock.wait(PAUSE),
                }
            }
        };
        self.places().map(probe).collect()
    }

    /// The profile of the phone at a place.
    pub(crate) fn profile(&self, place: usize) -> &'a PhoneProfile {
        self.seats[place].profile
    }

    /// Keeps how the rate of the clock at a place changes.
    pub(crate) fn set_change(&mut self, place: usize, change: RateChange) {
        self.seats[place].change = change;
    }

    /// A relation of the clock at a place, with how its rate changes.
    pub(crate) fn course(&self, place: usize, clock: ClockRelation) -> Course {
        let change = self.seats[place].change;
        Course { clock, change }
    }

    /// The places of all phones.
    pub(crate) const fn places(&self) -> std::ops::Range<usize> {
        0..self.seats.len()
    }

    /// The phone at a place, as events name it.
    pub(crate) fn name(&self, place: usize) -> PhoneName {
        PhoneName {
            name: self.profile(place).name.clone(),
            is_only: self.seats.len() == 1,
        }
    }

    /// A failure of the phone at a place.
    pub(crate) fn failure(&self, place: usize, error: PhoneError) -> SessionError {
        let phone = self.profile(place);
        SessionError::Phone {
            name: (self.seats.len() > 1).then(|| phone.name.clone()),
            address: phone.address.clone(),
            error,
        }
    }

    /// The phone at a place.
    pub(crate) fn device(&self, place: usize) -> &dyn Phone {
        self.seats[place].device.as_ref()
    }

    /// From here on the phone at a place may be recording a video.
    pub(crate) fn set_video_may_run(&mut self, place: usize) {
        self.seats[place].video_may_run = true;
    }

    /// The phones that may be recording a video; they are taken to be stopped
    /// from here on.
    pub(crate) fn take_running_videos(&mut self) -> Vec<usize> {
        let seats = self.seats.iter_mut().enumerate();
        seats
            .filter_map(|(place, seat)| std::mem::take(&mut seat.video_may_run).then_some(place))
            .collect()
    }

    /// News of the video of the phone at a place, if it is time to ask and an answer is
    /// there.
    pub(crate) fn video_news(&mut self, place: usize, now: Ticks) -> Option<VideoNews> {
        let seat = &mut self.seats[place];
        if !seat.video_may_run {
            return None;
        }
        seat.check.look(seat.device.as_ref(), now)
    }

    /// Calls off the questions whether videos run: the next requests need the phones.
    pub(crate) fn call_off_checks(&mut self) {
        let seats = self.seats.iter_mut();
        let asked: Vec<_> = seats.filter_map(|seat| seat.check.asked.take()).collect();
        call_off(self.clock, asked);
    }
}

/// Calls off requests to phones, and waits until they have ended.
pub(crate) fn call_off<T>(clock: &dyn Clock, asked: impl IntoIterator<Item = Pending<T>>) {
    let asked: Vec<_> = asked.into_iter().inspect(Pending::cancel).collect();
    for request in asked {
        while request.answer().is_none() {
            clock.wait(PAUSE);
        }
    }
}

/// News of a phone's video.
pub(crate) enum VideoNews {
    /// It has ended.
    Ended,
    /// The phone answers again, and records.
    Back,
    /// The phone does not say whether it records.
    Away(PhoneError),
}

/// The question whether a phone still records.
///
/// The app ends its video when it goes to the background, and says nothing. While it
/// records, it refuses to record sensors, which costs it nothing; so it is asked for that
/// ([`phone::PhoneClient::is_recording`]).
#[derive(Default)]
struct VideoCheck {
    next: Ticks,
    asked: Option<Pending<bool>>,
    is_away: bool,
    has_ended: bool,
}

impl VideoCheck {
    fn look(&mut self, phone: &dyn Phone, now: Ticks) -> Option<VideoNews> {
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
