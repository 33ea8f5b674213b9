//! The phones of a session, by their place in the profile: 0 is the one that the
//! trigger is aligned to, further ones follow in order.
//!
//! All are asked at the same time, each on its own thread: one twist relates every
//! clock, and videos begin and end together. The trigger follows the first alone;
//! of the others it is stated where their frames lie ([`placement`]).
//!
//! [`placement`]: session::alignment::placement

use std::time::Duration;

use super::Stop;
use super::journal::Journal;
use super::rig::Rig;
use super::video_watch::VideoCheck;
use crate::advice::at_phone;
use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};
use phone::task::{Pending, PhoneTask};
use phone::{PhoneError, VideoStart};
use recording::finding::Finding;
use recording::profile::{Phone, Profile};
use recording::session_file::{PhoneInfo, RateChange, Video};
use session::alignment::placement;
use session::rates::Course;
use timebase::ClockModel;

/// The phones, each on its own thread.
pub struct Phones<'a> {
    profile: &'a Profile,
    seats: Vec<Seat<'a>>,
}

struct Seat<'a> {
    phone: &'a Phone,
    task: PhoneTask,
    change: RateChange,
    video_may_run: bool,
    check: VideoCheck,
}

/// What each phone answered, by its place.
pub(super) type Answers<T> = Vec<(usize, Result<T, PhoneError>)>;

/// Starts the thread of a phone and asks it for its version.
fn connect_one(
    profile: &Profile,
    phone: &Phone,
    context: &Context,
) -> Result<(PhoneTask, PhoneInfo), Stop> {
    let task = PhoneTask::start(phone.address.clone()).map_err(|error| {
        Failure::new(ExitStatus::Error, format!("no thread: {error}"))
            .next_step("close other programs: the system gives no more threads")
    })?;
    let asked = task.probe();
    let version = loop {
        match asked.answer() {
            Some(Ok(version)) => break version.to_string(),
            Some(Err(error)) => return Err(named(profile, phone, error).into()),
            None if context.interrupt.requested() => return Err(Stop::Interrupted),
            None => std::thread::sleep(Duration::from_millis(10)),
        }
    };
    let address = phone.address.clone();
    let version = Some(version);
    Ok((task, PhoneInfo { address, version }))
}

/// Connects to all phones. Gives what is kept of each app too, by its place.
pub(super) fn connect<'a>(
    profile: &'a Profile,
    context: &Context,
) -> Result<(Phones<'a>, Vec<PhoneInfo>), Stop> {
    has_address(profile)?;
    let phones = profile.all_phones();
    let connected = phones.map(|phone| connect_one(profile, phone, context));
    let (tasks, infos) = connected.collect::<Result<_, _>>()?;
    Ok((Phones::new(profile, tasks), infos))
}

/// Whether the profile says where its phones are.
pub(crate) fn has_address(profile: &Profile) -> Result<(), Failure> {
    let mut phones = profile.all_phones();
    let Some(phone) = phones.find(|phone| phone.address.trim().is_empty()) else {
        return Ok(());
    };
    let message = format!("the profile has no address of {:?}", phone.name);
    Err(Failure::new(ExitStatus::Usage, message).next_step(
        "set `address` in `[phone]` of the rig profile (`smartdepthsync setup` asks for it), or \
         give --phone HOST, as the app's dialog shows it",
    ))
}

/// A failure of a phone, with its name where there are several.
fn named(profile: &Profile, phone: &Phone, error: PhoneError) -> Failure {
    let failure = at_phone(error, &phone.address);
    if profile.phones.is_empty() {
        failure
    } else {
        failure.about(&format!("phone {}", phone.name))
    }
}

impl<'a> Phones<'a> {
    /// The phones with these threads, in the profile's order.
    #[must_use]
    pub fn new(profile: &'a Profile, tasks: Vec<PhoneTask>) -> Self {
        let seat = |(phone, task)| Seat {
            phone,
            task,
            change: RateChange::default(),
            video_may_run: false,
            check: VideoCheck::default(),
        };
        Self {
            profile,
            seats: profile.all_phones().zip(tasks).map(seat).collect(),
        }
    }

    /// The profile of the phone at a place.
    pub(super) fn profile(&self, place: usize) -> &'a Phone {
        self.seats[place].phone
    }

    /// Keeps how the rate of the clock at a place changes.
    pub(super) fn set_change(&mut self, place: usize, change: RateChange) {
        self.seats[place].change = change;
    }

    /// A relation of the clock at a place, with how its rate changes.
    pub(super) fn course(&self, place: usize, clock: ClockModel) -> Course {
        let change = self.seats[place].change;
        Course { clock, change }
    }

    /// The places of all phones.
    pub(super) const fn places(&self) -> std::ops::Range<usize> {
        0..self.seats.len()
    }

    const fn are_several(&self) -> bool {
        self.seats.len() > 1
    }

    /// What a phone is called in what is said: its name where there are several.
    pub(super) fn label(&self, place: usize) -> String {
        if self.are_several() {
            format!("phone {}", self.profile(place).name)
        } else {
            String::from("the phone")
        }
    }

    /// Whose something is, behind what it is: its name where there are several.
    pub(super) fn whose(&self, place: usize) -> String {
        if self.are_several() {
            format!(", {}", self.profile(place).name)
        } else {
            String::new()
        }
    }

    /// A failure of the phone at a place.
    pub(super) fn failure(&self, place: usize, error: PhoneError) -> Failure {
        named(self.profile, self.profile(place), error)
    }

    /// The thread of the phone at a place.
    pub(super) fn task(&self, place: usize) -> &PhoneTask {
        &self.seats[place].task
    }

    /// The phones that may be recording a video; they are taken to be stopped
    /// from here on.
    pub(super) fn take_running_videos(&mut self) -> Vec<usize> {
        let running = |(place, seat): (usize, &mut Seat<'_>)| {
            std::mem::take(&mut seat.video_may_run).then_some(place)
        };
        self.seats
            .iter_mut()
            .enumerate()
            .filter_map(running)
            .collect()
    }

    /// What is known of the video of the phone at a place, and its thread; none if it may
    /// not be recording one.
    pub(super) fn video_check(&mut self, place: usize) -> Option<(&mut VideoCheck, &PhoneTask)> {
        let seat = &mut self.seats[place];
        seat.video_may_run.then_some((&mut seat.check, &seat.task))
    }

    /// Calls off what asks whether videos run.
    fn call_off_checks(&mut self) {
        let seats = self.seats.iter_mut();
        call_off(seats.filter_map(|seat| seat.check.call_off()));
    }
}

/// Calls off what phones were asked: the next requests need their threads.
fn call_off<T>(asked: impl Iterator<Item = Pending<T>>) {
    let asked: Vec<_> = asked.inspect(Pending::cancel).collect();
    for request in asked {
        while request.answer().is_none() {
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Rig<'_> {
    /// Asks phones at the same time and pumps until all have answered. What they say is
    /// in the result, by their places.
    pub(super) fn ask_phones<T>(
        &mut self,
        places: impl IntoIterator<Item = usize>,
        ask: impl Fn(usize, &PhoneTask) -> Pending<T>,
        mut meanwhile: impl FnMut(&mut Self),
    ) -> Result<Answers<T>, Stop> {
        self.phones.call_off_checks();
        let asked = |place| (place, ask(place, self.phones.task(place)));
        let mut waiting: Vec<_> = places.into_iter().map(asked).collect();
        let mut answers = Answers::new();
        let result = self.pump_until(|rig| {
            meanwhile(rig);
            waiting.retain(|(place, request)| match request.answer() {
                Some(answer) => {
                    answers.push((*place, answer));
                    false
                }
                None => true,
            });
            waiting.is_empty().then_some(())
        });
        if result.is_err() {
            call_off(waiting.into_iter().map(|(_, request)| request));
        }
        answers.sort_by_key(|&(place, _)| place);
        result.map(|()| answers)
    }
}

/// Starts the videos of all phones that have not yet begun one. If a phone does not,
/// the others do all the same.
pub(super) fn start_videos(rig: &mut Rig<'_>) -> Result<(), Stop> {
    let mut without_video = Vec::new();
    for (place, seat) in rig.phones.seats.iter_mut().enumerate() {
        if rig.journal.video(place).is_none() {
            seat.video_may_run = true;
            without_video.push(place);
        }
    }
    let now = rig.now();
    let clocks = rig.phones.places().map(|place| rig.journal.clock(place));
    let times: Vec<_> = clocks
        .map(|clock| Some(clock?.ticks_to_phone(now)))
        .collect();
    let start = |place: usize, task: &PhoneTask| task.start_video(times[place]);
    let mut failed = None;
    let mut unknown = Vec::new();
    for (place, answer) in rig.ask_phones(without_video, start, |_| {})? {
        match answer {
            Ok(start) => began(&rig.phones, &mut rig.journal, place, start)?,
            Err(error) => {
                let failure = rig.phones.failure(place, error);
                failed.get_or_insert(failure);
                unknown.push(place);
            }
        }
    }
    stop_after_failure(rig, &unknown)?;
    failed.map_or(Ok(()), |failure| Err(failure.into()))
}

/// Stops what these phones may have begun in a start that failed, so that another start
/// begins a video: the request only presses a button.
fn stop_after_failure(rig: &mut Rig<'_>, places: &[usize]) -> Result<(), Stop> {
    if places.is_empty() {
        return Ok(());
    }
    let places = places.iter().copied();
    let stop = |_, task: &PhoneTask| task.stop_video();
    for (place, answer) in rig.ask_phones(places.clone(), stop, |_| {})? {
        let label = rig.phones.label(place);
        let text = match answer {
            Ok(_) => format!("{label} was told to stop"),
            Err(error) => format!("a video may run on {label}: {error}"),
        };
        rig.journal.info("video", &text)?;
    }
    // A video that does not end in time is told by the next request.
    rig.ask_phones(places, |_, task| task.await_closed(), |_| {})
        .map(drop)
}

fn began(
    phones: &Phones<'_>,
    journal: &mut Journal<'_>,
    place: usize,
    start: VideoStart,
) -> Result<(), Stop> {
    let video = Video {
        phase: start.phase,
        frame_duration_ns: start.frame_duration_ns,
        exposure_ns: start.exposure_ns,
    };
    journal.set_video(place, video);
    journal.save()?;
    let exposure = video
        .exposure_ns
        .map_or(String::from("not reported"), |ns| {
            format!("{:.3} ms", ns as f64 * 1e-6)
        });
    let text = format!(
        "{} records: frame period {:.3} ns, exposure {exposure}",
        phones.label(place),
        video.frame_duration_ns
    );
    journal.info("video", &text)
}

/// States where the frames of the further phones lie against the trigger's grid.
///
/// Once the board was reset and its trigger is on the grid again, it does so anew: the
/// grid goes on as it was, but it is against the phones only as well as their clocks are
/// known in the new run. A phone that was left out still is, and is not told again.
pub(super) fn place_others(phones: &Phones<'_>, journal: &mut Journal<'_>) -> Result<(), Stop> {
    for place in phones.places().skip(1) {
        if !place_other(phones, journal, place)? && journal.file.runs.is_empty() {
            let name = &phones.profile(place).name;
            journal.problem(Finding::check(
                "phone_left_out",
                format!("phone {name} records no video"),
            ))?;
        }
    }
    Ok(())
}

/// States it of one phone; false if too little is known of it.
fn place_other(phones: &Phones<'_>, journal: &mut Journal<'_>, place: usize) -> Result<bool, Stop> {
    let known = (
        journal.file.alignment,
        journal.clock(place),
        journal.video(place),
    );
    let (Some(alignment), Some(clock), Some(video)) = known else {
        return Ok(false);
    };
    let phone = phones.profile(place);
    let course = phones.course(place, clock);
    let placed = placement(phones.profile, phone, &course, &video, &alignment);
    if let Some(kept) = journal.other_phone(place) {
        kept.placement = Some(placed);
    }
    journal.save()?;
    let text = format!(
        "phone {}: its frames are {:+.1} ± {:.1} µs from the depth images, moving by \
         {:+.1} ± {:.1} µs/min (1-sigma); it cannot be shifted",
        phone.name,
        placed.offset_us,
        placed.offset_sigma_us,
        placed.drift_us_per_min,
        placed.drift_sigma_us_per_min
    );
    journal.info("placement", &text)?;
    Ok(true)
}
