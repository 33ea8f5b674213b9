//! The end of a session, however it went.

use std::time::{Duration, Instant};

use super::further;
use super::phone_task::{Answer, Request};
use super::rig::Rig;
use super::steps::{is_repeatable, odd_answer, spinner, step};
use super::twist::second_twist;
use super::watch::Finding;
use super::{Options, Stop};
use crate::advice::phone_status;
use crate::outcome::{ExitStatus, Failure};
use board::Board;
use recording::writer::Severity;
use timebase::ClockModel;

/// How long after its first failure a phone is asked again to stop its video.
const STOP_PATIENCE: Duration = Duration::from_secs(5);

/// Pause between two of these tries.
const STOP_PAUSE: Duration = Duration::from_millis(500);

/// How long the board is listened to at a time.
const LISTEN: Duration = Duration::from_millis(20);

/// Ends a session, however it went. Gives the result on, or the first failure of
/// the closing itself if there was none before.
///
/// # Errors
///
/// As `result`; or the files cannot be finished.
pub fn close(rig: &mut Rig<'_>, options: &Options, result: Result<(), Stop>) -> Result<(), Stop> {
    rig.closing = true;
    if let Err(Stop::Failed(failure)) = &result {
        let text = failure.to_string();
        let broken = failure.status() == ExitStatus::Storage;
        if broken {
            // Nothing more can be written; what was written can be read.
            rig.writer = None;
        }
        let told = rig.problem(Finding::error("failed", text));
        if told.is_err() {
            rig.writer = None;
        }
    }
    end_of_recording(rig);
    stop_devices(rig);
    let result = match result {
        Ok(()) => after_recording(rig, options),
        failed => failed,
    };
    finish(rig, result)
}

/// Takes down what was recorded. Before the devices are stopped: what they do
/// then is not part of it.
fn end_of_recording(rig: &mut Rig<'_>) {
    if rig.watch.take().is_none() {
        return;
    }
    if let Some(span) = &mut rig.file.recorded {
        span.to = span.from.max(rig.now);
    }
    rig.file.counts = rig.board.conversation().counts();
    rig.file.damaged_frames = rig.board.conversation().damaged_frames();
}

/// Stops phone, depth recorder and trigger; what cannot be stopped is told.
fn stop_devices(rig: &mut Rig<'_>) {
    stop_videos(rig);
    if let Some(recorder) = rig.depth.take() {
        let problem = recorder.stop(|| listen(rig, LISTEN));
        if let Some(text) = problem {
            report(rig, Finding::error("depth_recorder_gone", text));
        }
    }
    if rig.trigger_started {
        rig.trigger_started = false;
        if let Err(Stop::Failed(failure)) = further::stop(rig) {
            report(
                rig,
                Finding::error(
                    "outputs_not_stopped",
                    format!("a further output could not be stopped: {failure}"),
                ),
            );
        }
        if let Err(Stop::Failed(failure)) = rig.call(Board::stop_trigger) {
            report(
                rig,
                Finding::error(
                    "trigger_not_stopped",
                    format!("the trigger could not be stopped: {failure}"),
                ),
            );
        }
    }
    // Its last messages.
    for _ in 0..5 {
        if rig.pump(Duration::from_millis(20)).is_err() {
            break;
        }
    }
}

/// Stops the videos that run. A phone that cannot be reached just then, as when Wi-Fi
/// stalls, is asked again: to stop twice does no harm, and nobody else will do it.
fn stop_videos(rig: &mut Rig<'_>) {
    let mut running = rig.take_running_videos();
    let mut failing_since = None;
    while !running.is_empty() {
        let requests = running
            .iter()
            .map(|&place| (place, Request::StopVideo))
            .collect();
        let answers = match rig.ask_phones(requests, |_| {}) {
            Ok(answers) => answers,
            Err(Stop::Failed(failure)) => {
                report(rig, Finding::error("phone_lost", failure.to_string()));
                return;
            }
            Err(Stop::Interrupted) => return,
        };
        let is_first = failing_since.is_none();
        let since = *failing_since.get_or_insert_with(Instant::now);
        running.clear();
        for (place, answer) in answers {
            let Err(error) = answer else { continue };
            if phone_status(&error) == ExitStatus::Phone && since.elapsed() < STOP_PATIENCE {
                running.push(place);
                if is_first {
                    rig.context.say(format!(
                        "the video of {} is not stopped yet: {error}; trying for {} s",
                        rig.phone_label(place),
                        STOP_PATIENCE.as_secs()
                    ));
                }
                continue;
            }
            let text = format!(
                "the video of {} could not be stopped: {error}; stop it on the phone",
                rig.phone_label(place)
            );
            report(rig, Finding::error("phone_lost", text));
        }
        if !running.is_empty() {
            listen(rig, STOP_PAUSE);
        }
    }
}

/// Listens to the board for so long; its failures are told by the next step of closing.
fn listen(rig: &mut Rig<'_>, time: Duration) {
    let begun = Instant::now();
    while begun.elapsed() < time {
        if rig.pump(LISTEN).is_err() {
            std::thread::sleep(LISTEN);
        }
    }
}

/// Tells a problem while closing, where nothing can be done about a failure.
fn report(rig: &mut Rig<'_>, finding: Finding) {
    if rig.problem(finding).is_err() {
        rig.writer = None;
    }
}

/// What follows a recording that was not broken off.
fn after_recording(rig: &mut Rig<'_>, options: &Options) -> Result<(), Stop> {
    rig.save()?;
    // From here on Ctrl-C leaves the rest out.
    rig.closing = false;
    if options.second_twist {
        let first: Vec<Option<ClockModel>> = rig
            .phone_places()
            .map(|place| rig.phone_clock(place))
            .collect();
        step(rig, "the second twist", |rig| second_twist(rig, &first))
            .or_else(|stop| lesser(rig, "second_twist", stop))?;
    }
    if options.fetch_video {
        for place in rig.phone_places() {
            step(rig, "the download", |rig| fetch_video(rig, place))
                .or_else(|stop| lesser(rig, "video_not_fetched", stop))?;
        }
    }
    Ok(())
}

/// A failure of a step after the recording: the recording is there, so it is a
/// problem, not the end.
fn lesser(rig: &mut Rig<'_>, kind: &'static str, stop: Stop) -> Result<(), Stop> {
    match stop {
        Stop::Failed(failure) if is_repeatable(&failure) => {
            rig.problem(Finding::error(kind, failure.to_string()))
        }
        stop => Err(stop),
    }
}

fn fetch_video(rig: &mut Rig<'_>, place: usize) -> Result<(), Stop> {
    let own = rig.file.phone_folder(&rig.phone_profile(place).name);
    let folder = rig.folder.join(&own);
    let label = rig.phone_label(place);
    let bar = spinner(rig);
    let answers = rig.ask_phones(vec![(place, Request::FetchVideo(folder))], |rig| {
        let (done, whole) = rig.phone_task(place).progress();
        bar.set_message(format!(
            "downloading the video of {label}: {} of {} MB",
            done / 1_000_000,
            whole / 1_000_000
        ));
    });
    bar.finish_and_clear();
    let Some((_, answer)) = answers?.pop() else {
        return Ok(());
    };
    match answer.map_err(|error| rig.phone_failure(place, error))? {
        Answer::Fetched(video) => {
            if let Some(name) = video.path.file_name() {
                let name = own.join(name).to_string_lossy().into_owned();
                rig.file.files.push(name);
            }
            rig.tell(
                Severity::Info,
                "video",
                &format!(
                    "the video is {} ({} bytes)",
                    video.path.display(),
                    video.size
                ),
            )
        }
        other => Err(odd_answer(&other).into()),
    }
}

/// Finishes the files.
fn finish(rig: &mut Rig<'_>, result: Result<(), Stop>) -> Result<(), Stop> {
    rig.closing = true;
    let finished = match rig.writer.take() {
        Some(writer) => writer.finish().map_err(|error| Failure::from(error).into()),
        None => Ok(()),
    };
    match result {
        Ok(()) => finished,
        failed => failed,
    }
}
