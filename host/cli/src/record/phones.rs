//! The phones of a session, by their place in the profile: 0 is the one that the
//! trigger is aligned to, further ones follow in order.
//!
//! All are asked at the same time, each on its own thread: one twist relates every
//! clock, and videos begin and end together. The trigger follows the first alone;
//! of the others it is stated where their frames lie ([`placement`]).
//!
//! [`placement`]: frame_sync::alignment::placement

use std::time::Duration;

use super::Stop;
use super::phone_task::{Answer, PhoneTask, Request};
use super::rig::Rig;
use super::watch::Finding;
use crate::cli::Context;
use crate::outcome::{ExitStatus, Failure};
use frame_sync::alignment::placement;
use phone::{PhoneError, VideoStart};
use recording::profile::{Phone, Profile};
use recording::session_file::{OtherPhone, PhoneInfo, Twist, Video};
use recording::writer::Severity;
use timebase::ClockModel;

/// A phone beside the one that the trigger is aligned to.
pub struct Other {
    task: PhoneTask,
    video_may_run: bool,
}

/// What each phone answered, by its place.
pub type Answers = Vec<(usize, Result<Answer, PhoneError>)>;

/// Starts the thread of a phone and asks it for its version.
///
/// # Errors
///
/// It does not answer, or the user wants to stop.
pub fn connect(
    profile: &Profile,
    phone: &Phone,
    context: &Context,
) -> Result<(PhoneTask, PhoneInfo), Stop> {
    let task = PhoneTask::start(phone.address.clone()).map_err(|error| {
        Failure::new(ExitStatus::Error, format!("no thread: {error}"))
            .next_step("close other programs: the system gives no more threads")
    })?;
    task.ask(Request::Probe);
    let version = loop {
        match task.answer() {
            Some(Ok(Answer::Version(version))) => break Some(version),
            Some(Ok(_)) => break None,
            Some(Err(error)) => return Err(named(profile, phone, error).into()),
            None if context.interrupt.requested() => return Err(Stop::Interrupted),
            None => std::thread::sleep(Duration::from_millis(10)),
        }
    };
    let address = phone.address.clone();
    Ok((task, PhoneInfo { address, version }))
}

/// Connects to the further phones.
///
/// # Errors
///
/// As [`connect`].
pub fn connect_others(
    profile: &Profile,
    context: &Context,
) -> Result<(Vec<Other>, Vec<OtherPhone>), Stop> {
    let mut others = Vec::new();
    let mut kept = Vec::new();
    for phone in &profile.phones {
        let (task, info) = connect(profile, phone, context)?;
        others.push(Other {
            task,
            video_may_run: false,
        });
        kept.push(OtherPhone {
            name: phone.name.clone(),
            info,
            twists: Vec::new(),
            clock: None,
            video: None,
            placement: None,
        });
    }
    Ok((others, kept))
}

/// A failure of a phone, with its name where there are several.
fn named(profile: &Profile, phone: &Phone, error: PhoneError) -> Failure {
    let failure = Failure::from(error);
    if profile.phones.is_empty() {
        failure
    } else {
        failure.about(&format!("phone {}", phone.name))
    }
}

impl Rig<'_> {
    /// The phone at a place in the profile.
    ///
    /// # Panics
    ///
    /// Never: a place that there is not is the first.
    #[must_use]
    pub fn phone_profile(&self, place: usize) -> &Phone {
        self.profile
            .all_phones()
            .nth(place)
            .unwrap_or(&self.profile.phone)
    }

    /// The places of all phones.
    #[must_use]
    pub fn phone_places(&self) -> std::ops::RangeInclusive<usize> {
        0..=self.others.len()
    }

    /// What a phone is called in what is said: its name where there are several.
    #[must_use]
    pub fn phone_label(&self, place: usize) -> String {
        if self.others.is_empty() {
            String::from("the phone")
        } else {
            format!("phone {}", self.phone_profile(place).name)
        }
    }

    /// Whose something is, behind what it is: its name where there are several.
    #[must_use]
    pub fn of_phone(&self, place: usize) -> String {
        if self.others.is_empty() {
            String::new()
        } else {
            format!(", {}", self.phone_profile(place).name)
        }
    }

    /// A failure of the phone at a place.
    #[must_use]
    pub fn phone_failure(&self, place: usize, error: PhoneError) -> Failure {
        named(self.profile, self.phone_profile(place), error)
    }

    /// The thread of the phone at a place.
    #[must_use]
    pub fn phone_task(&self, place: usize) -> &PhoneTask {
        place
            .checked_sub(1)
            .and_then(|index| self.others.get(index))
            .map_or(&self.phone, |other| &other.task)
    }

    /// What is kept of a further phone.
    fn kept(&mut self, place: usize) -> Option<&mut OtherPhone> {
        self.file.phones.get_mut(place.checked_sub(1)?)
    }

    /// Whether the phone at a place may be recording a video.
    fn video_may_run(&mut self, place: usize) -> &mut bool {
        match place.checked_sub(1) {
            Some(index) if index < self.others.len() => &mut self.others[index].video_may_run,
            _ => &mut self.video_may_run,
        }
    }

    /// The phones that may be recording a video; they are taken to be stopped
    /// from here on.
    #[must_use]
    pub fn take_running_videos(&mut self) -> Vec<usize> {
        self.phone_places()
            .filter(|&place| std::mem::take(self.video_may_run(place)))
            .collect()
    }

    /// The relation of the clock of the phone at a place.
    #[must_use]
    pub fn phone_clock(&self, place: usize) -> Option<ClockModel> {
        match place.checked_sub(1) {
            None => self.clock,
            Some(index) => self.file.phones.get(index)?.clock,
        }
    }

    /// A new relation of the clock of the phone at a place.
    ///
    /// # Errors
    ///
    /// The recording cannot be written.
    pub fn set_phone_clock(
        &mut self,
        place: usize,
        clock: ClockModel,
        source: &str,
    ) -> Result<(), Stop> {
        let now = self.now;
        let Some(kept) = self.kept(place) else {
            return self.set_clock(clock, source);
        };
        kept.clock = Some(clock);
        let name = kept.name.clone();
        match &mut self.writer {
            Some(writer) => writer
                .phone_clock_model(now, &name, &clock, source)
                .map_err(|error| Failure::from(error).into()),
            None => Ok(()),
        }
    }

    /// Keeps a twist of the phone at a place.
    pub fn keep_twist(&mut self, place: usize, twist: Twist) {
        match self.kept(place) {
            Some(kept) => kept.twists.push(twist),
            None => self.file.twists.push(twist),
        }
    }

    /// Asks phones at the same time and pumps until all have answered.
    ///
    /// # Errors
    ///
    /// As [`Rig::pump`]. What the phones say is in the result.
    pub fn ask_phones(
        &mut self,
        requests: Vec<(usize, Request)>,
        mut meanwhile: impl FnMut(&mut Self),
    ) -> Result<Answers, Stop> {
        let mut waiting: Vec<usize> = Vec::new();
        for (place, request) in requests {
            self.phone_task(place).ask(request);
            waiting.push(place);
        }
        let mut answers = Answers::new();
        let result = self.pump_until(|rig| {
            meanwhile(rig);
            waiting.retain(|&place| match rig.phone_task(place).answer() {
                Some(answer) => {
                    answers.push((place, answer));
                    false
                }
                None => true,
            });
            waiting.is_empty().then_some(())
        });
        if result.is_err() {
            // Do not leave requests hanging: the next ones need the threads.
            for &place in &waiting {
                self.phone_task(place).cancel();
            }
            for &place in &waiting {
                while self.phone_task(place).answer().is_none() {
                    std::thread::sleep(Duration::from_millis(10));
                }
            }
        }
        answers.sort_by_key(|&(place, _)| place);
        result.map(|()| answers)
    }
}

/// Starts the videos of all phones that have not yet begun one.
///
/// # Errors
///
/// A phone does not; the others do all the same.
pub fn start_videos(rig: &mut Rig<'_>) -> Result<(), Stop> {
    let missing: Vec<usize> = rig
        .phone_places()
        .filter(|&place| video_of(rig, place).is_none())
        .collect();
    for &place in &missing {
        *rig.video_may_run(place) = true;
    }
    let requests = missing
        .iter()
        .map(|&place| (place, Request::StartVideo))
        .collect();
    let mut failed = None;
    for (place, answer) in rig.ask_phones(requests, |_| {})? {
        match answer {
            Ok(Answer::Started(start)) => began(rig, place, start)?,
            Ok(other) => {
                failed.get_or_insert(super::steps::odd_answer(&other));
            }
            Err(error) => {
                let failure = rig.phone_failure(place, error);
                failed.get_or_insert(failure);
            }
        }
    }
    failed.map_or(Ok(()), |failure| Err(failure.into()))
}

fn video_of(rig: &Rig<'_>, place: usize) -> Option<Video> {
    match place.checked_sub(1) {
        None => rig.file.video,
        Some(index) => rig.file.phones.get(index)?.video,
    }
}

fn began(rig: &mut Rig<'_>, place: usize, start: VideoStart) -> Result<(), Stop> {
    let VideoStart {
        phase,
        frame_duration_ns,
        exposure_ns,
    } = start;
    let video = Video {
        phase,
        frame_duration_ns,
        exposure_ns,
    };
    match rig.kept(place) {
        Some(kept) => kept.video = Some(video),
        None => rig.file.video = Some(video),
    }
    rig.save()?;
    let text = format!(
        "{} records: frame period {frame_duration_ns:.3} ns, exposure {}",
        rig.phone_label(place),
        exposure_ns.map_or(String::from("not reported"), |ns| format!(
            "{:.3} ms",
            ns as f64 * 1e-6
        ))
    );
    rig.tell(Severity::Info, "video", &text)
}

/// States where the frames of the further phones lie against the trigger's grid.
///
/// # Errors
///
/// The session file cannot be written.
pub fn place_others(rig: &mut Rig<'_>) -> Result<(), Stop> {
    for place in rig.phone_places().skip(1) {
        if !place_other(rig, place)? && rig.file.alignment.is_some() {
            let name = rig.phone_profile(place).name.clone();
            rig.problem(Finding::warning(
                "phone_left_out",
                format!("phone {name} records no video"),
            ))?;
        }
    }
    Ok(())
}

/// The same once the board was reset and its trigger is on the grid again. The grid
/// goes on as it was, but it is against the phones only as well as their clocks are
/// known in the new run. A phone that was left out still is.
///
/// # Errors
///
/// As [`place_others`].
pub(super) fn place_others_again(rig: &mut Rig<'_>) -> Result<(), Stop> {
    for place in rig.phone_places().skip(1) {
        place_other(rig, place)?;
    }
    Ok(())
}

/// States it of one phone; false if too little is known of it.
fn place_other(rig: &mut Rig<'_>, place: usize) -> Result<bool, Stop> {
    let known = (
        rig.file.alignment,
        rig.phone_clock(place),
        video_of(rig, place),
    );
    let (Some(alignment), Some(clock), Some(video)) = known else {
        return Ok(false);
    };
    let phone = rig.phone_profile(place);
    let name = phone.name.clone();
    let placed = placement(rig.profile, phone, &clock, &video, &alignment);
    if let Some(kept) = rig.kept(place) {
        kept.placement = Some(placed);
    }
    rig.save()?;
    let text = format!(
        "phone {name}: its frames are {:+.1} ± {:.1} µs from the depth images, moving by \
         {:+.1} ± {:.1} µs/min (1-sigma); it cannot be shifted",
        placed.offset_us,
        placed.offset_sigma_us,
        placed.drift_us_per_min,
        placed.drift_sigma_us_per_min
    );
    rig.tell(Severity::Info, "placement", &text)?;
    Ok(true)
}
