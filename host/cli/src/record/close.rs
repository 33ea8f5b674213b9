//! The end of a session, however it went.

use std::time::{Duration, Instant};

use super::further;
use super::journal::Journal;
use super::observers::Observers;
use super::rig::Rig;
use super::steps::{is_repeatable, step};
use super::twist::second_twist;
use super::{Options, Stop};
use crate::advice::phone_status;
use crate::outcome::ExitStatus;
use board::Conversation;
use phone::adb::{copy_command, get_files_command};
use phone::task::PhoneTask;
use protocol::Output;
use recording::finding::Finding;

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
            rig.journal.writer = None;
        }
        rig.journal.last_problem("failed", text);
    }
    let session = rig.link.board.conversation();
    end_of_recording(&mut rig.journal, &mut rig.observers, session);
    stop_devices(rig);
    let result = match result {
        Ok(()) => after_recording(rig, options),
        failed => failed,
    };
    finish(rig, result)
}

/// Takes down what was recorded. Before the devices are stopped: what they do
/// then is not part of it.
fn end_of_recording(journal: &mut Journal<'_>, observers: &mut Observers, link: &Conversation) {
    if observers.watch.take().is_none() {
        return;
    }
    if let Some(span) = &mut journal.file.recorded {
        span.to = span.from.max(journal.now);
    }
    journal.file.counts = link.counts();
    journal.file.damaged_frames = link.damaged_frames();
}

/// Stops phone, depth recorder and trigger; what cannot be stopped is told.
fn stop_devices(rig: &mut Rig<'_>) {
    stop_videos(rig);
    if let Some(recorder) = rig.rounds.depth.take() {
        let problem = recorder.stop(|| listen(rig, LISTEN));
        if let Some(text) = problem {
            rig.journal.last_problem("depth_recorder_gone", text);
        }
    }
    if rig.trigger_started {
        rig.trigger_started = false;
        if let Err(Stop::Failed(failure)) = further::stop(rig) {
            let text = format!("a further output could not be stopped: {failure}");
            rig.journal.last_problem("outputs_not_stopped", text);
        }
        if let Err(Stop::Failed(failure)) = rig.call(|board| board.stop_trigger(Output::Camera)) {
            let text = format!("the trigger could not be stopped: {failure}");
            rig.journal.last_problem("trigger_not_stopped", text);
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
    let mut running = rig.phones.take_running_videos();
    let mut failing_since = None;
    while !running.is_empty() {
        let stop = |_, task: &PhoneTask| task.stop_video();
        let answers = match rig.ask_phones(std::mem::take(&mut running), stop, |_| {}) {
            Ok(answers) => answers,
            Err(Stop::Failed(failure)) => {
                rig.journal.last_problem("phone_lost", failure.to_string());
                return;
            }
            Err(Stop::Interrupted) => return,
        };
        let is_first = failing_since.is_none();
        let since = *failing_since.get_or_insert_with(Instant::now);
        for (place, answer) in answers {
            let Err(error) = answer else { continue };
            if phone_status(&error) == ExitStatus::Phone && since.elapsed() < STOP_PATIENCE {
                running.push(place);
                if is_first {
                    rig.context.say(format!(
                        "the video of {} is not stopped yet: {error}; trying for {} s",
                        rig.phones.label(place),
                        STOP_PATIENCE.as_secs()
                    ));
                }
                continue;
            }
            let text = format!(
                "the video of {} could not be stopped: {error}; stop it on the phone",
                rig.phones.label(place)
            );
            rig.journal.last_problem("phone_lost", text);
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

/// What follows a recording that was not broken off.
fn after_recording(rig: &mut Rig<'_>, options: &Options) -> Result<(), Stop> {
    rig.journal.save()?;
    // From here on Ctrl-C leaves the rest out.
    rig.closing = false;
    if options.second_twist {
        let places = rig.phones.places();
        let first: Vec<_> = places.map(|place| rig.journal.clock(place)).collect();
        step(rig, "the second twist", |rig| second_twist(rig, &first))
            .or_else(|stop| lesser(&mut rig.journal, "second_twist", stop))?;
    }
    if options.fetch_video {
        for place in rig.phones.places() {
            // The app ends when it is asked for a video and has made none.
            if rig.journal.video(place).is_none() {
                let label = rig.phones.label(place);
                let text = format!("{label} made no video in this session: none is asked for");
                rig.journal
                    .problem(Finding::bad("video_not_fetched", text))?;
                continue;
            }
            step(rig, "the download", |rig| fetch_video(rig, place))
                .or_else(|stop| lesser(&mut rig.journal, "video_not_fetched", stop))?;
        }
    }
    for place in rig.phones.places() {
        fetch_files(rig, place)?;
    }
    Ok(())
}

/// Copies what the app does not send, the frames' timestamps and the sensors, by `adb`;
/// where that does not work, says what does.
fn fetch_files(rig: &mut Rig<'_>, place: usize) -> Result<(), Stop> {
    let Some(video) = rig.journal.video(place) else {
        return Ok(());
    };
    let own = rig.phones.profile(place);
    let own = rig.journal.file.phone_folder(&own.name);
    let folder = rig.journal.folder.join(&own);
    let fetch = |_, task: &PhoneTask| task.fetch_files(video.phase, folder.clone());
    let answer = rig.ask_phones([place], fetch, |_| {})?.pop();
    let label = rig.phones.label(place);
    let text = match answer {
        Some((_, Ok(files))) => {
            for name in files.iter().filter_map(|path| path.file_name()) {
                let name = own.join(name).to_string_lossy().into_owned();
                rig.journal.file.files.push(name);
            }
            format!("{} files of {label} were copied", files.len())
        }
        Some((_, Err(error))) => format!(
            "timestamps and sensors of the video are on {label} ({error}); by USB: \
             `{}`, or by MTP: {}",
            get_files_command(video.phase, &folder, false),
            copy_command(video.phase, &folder)
        ),
        None => return Ok(()),
    };
    rig.journal.info("phone_files", &text)
}

/// A failure of a step after the recording: the recording is there, so it is a
/// problem, not the end.
fn lesser(journal: &mut Journal<'_>, kind: &'static str, stop: Stop) -> Result<(), Stop> {
    match stop {
        Stop::Failed(failure) if is_repeatable(&failure) => {
            journal.problem(Finding::bad(kind, failure.to_string()))
        }
        stop => Err(stop),
    }
}

fn fetch_video(rig: &mut Rig<'_>, place: usize) -> Result<(), Stop> {
    let own = rig
        .journal
        .file
        .phone_folder(&rig.phones.profile(place).name);
    let folder = rig.journal.folder.join(&own);
    let label = rig.phones.label(place);
    let bar = rig.context.spinner();
    let fetch = |_, task: &PhoneTask| task.fetch_video(folder.clone());
    let answers = rig.ask_phones([place], fetch, |rig| {
        let (done, whole) = rig.phones.task(place).progress();
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
    let video = answer.map_err(|error| rig.phones.failure(place, error))?;
    if let Some(name) = video.path.file_name() {
        let name = own.join(name).to_string_lossy().into_owned();
        rig.journal.file.files.push(name);
    }
    let (path, size) = (video.path.display(), video.size);
    rig.journal
        .info("video", &format!("the video is {path} ({size} bytes)"))
}

/// Finishes the files.
fn finish(rig: &mut Rig<'_>, result: Result<(), Stop>) -> Result<(), Stop> {
    rig.closing = true;
    let writer = rig.journal.writer.take();
    rig.journal.file.outcome = Some(rig.journal.outcome_of(&result));
    let session = &rig.journal.file;
    let finished = writer.map_or(Ok(()), |writer| writer.finish_with(session));
    result.and(finished.map_err(Stop::from))
}
