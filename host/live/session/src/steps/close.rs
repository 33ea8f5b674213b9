//! The end of a session, whatever its result.

use std::time::Duration;

use protocol::{Output, StopTrigger};

use crate::auxiliary;
use crate::error::{SessionError, Stop};
use crate::event::{Device, Phase, SessionEvent, Step};
use crate::log::Log;
use crate::options::Options;
use crate::phones::videos::{fetch_files, fetch_video, stop_videos};
use crate::session::Session;
use crate::twist::second_twist;

/// Longest pump while the board's last messages are awaited.
const LISTEN: Duration = Duration::from_millis(20);

/// Closes a session with this result. Returns the same result, or the first failure of closing
/// if there was none before.
///
/// # Errors
///
/// As `result`; or the files cannot be finished.
pub fn close(
    session: &mut Session<'_>,
    options: &Options,
    result: Result<(), Stop>,
) -> Result<(), Stop> {
    session.closing = true;
    if let Err(Stop::Failed(error)) = &result {
        if error.is_storage() {
            // Nothing more can be written; the file can be read up to here.
            session.log.writer = None;
        }
        session.log.report_at_end(SessionEvent::Failed {
            error: error.to_string(),
        });
    }
    let was_recording = end_of_recording(session);
    session.enter(Phase::Stopping);
    stop_devices(session);
    let result = match result {
        Ok(()) | Err(Stop::BoardReset) => after_recording(session, options, options.second_twist),
        Err(Stop::Interrupted) if was_recording && session.operator.heed_interrupt() => {
            after_recording(session, options, false).and(Err(Stop::Interrupted))
        }
        failed => failed,
    };
    session.enter(Phase::Closing);
    finish(session, result)
}

/// Ends the recorded span and notes its counts. The devices are stopped after that, so that
/// their last messages are not part of it. Returns false if there was none.
fn end_of_recording(session: &mut Session<'_>) -> bool {
    if session.monitors.watch.take().is_none() {
        return false;
    }
    let exposures = session.monitors.exposures.take();
    let seen = exposures.and_then(|finder| finder.finish().ok());
    session.file.exposures = seen.map(|(statistics, _)| statistics);
    let now = session.now();
    if let Some(span) = &mut session.file.recorded {
        span.to = span.from.max(now);
    }
    let conversation = session.link.board.conversation();
    session.file.counts = session
        .counts_at_reset
        .unwrap_or_else(|| conversation.counts());
    session.file.damaged_frames = conversation.damaged_frames();
    true
}

/// Stops phone, depth recorder and trigger, and reports those that cannot be stopped.
fn stop_devices(session: &mut Session<'_>) {
    stop_videos(session);
    stop_recorder(session);
    if session.trigger_started {
        session.trigger_started = false;
        let led = session.file.led.filter(|led| !led.output.is_camera());
        let led = led.map(|led| session.call(|board| board.call(StopTrigger(led.output))));
        let stopped = auxiliary::stop(session).and(led.transpose());
        if let Err(Stop::Failed(error)) = stopped {
            report_not_stopped(&mut session.log, Device::Output, &error);
        }
        let stopped = session.call(|board| board.call(StopTrigger(Output::Camera)));
        if let Err(Stop::Failed(error)) = stopped {
            report_not_stopped(&mut session.log, Device::Trigger, &error);
        }
    }
    // The board's last messages.
    for _ in 0..5 {
        if session.pump(LISTEN).is_err() {
            break;
        }
    }
}

fn report_not_stopped(log: &mut Log<'_>, what: Device, error: &SessionError) {
    log.report_at_end(SessionEvent::NotStopped {
        what,
        error: error.to_string(),
    });
}

/// Asks the depth recorder to stop, and kills it if it does not stop in time.
fn stop_recorder(session: &mut Session<'_>) {
    if !std::mem::take(&mut session.housekeeping.recorder_runs) {
        return;
    }
    session.housekeeping.recorder.ask_to_stop();
    let asked = session.clock.now();
    let recorder = &session.profile.depth.recorder;
    let patience = Duration::from_secs(recorder.stop_timeout_s.into());
    loop {
        if let Some(end) = session.housekeeping.recorder.poll() {
            if !end.is_as_asked {
                let failed = SessionEvent::RecorderFailed { end };
                session.log.report_at_end(failed);
            }
            return;
        }
        if session.clock.now().saturating_sub(asked) >= patience {
            break;
        }
        session.listen_for(LISTEN);
    }
    session.housekeeping.recorder.kill();
    let program = recorder.command.first().cloned().unwrap_or_default();
    session.log.report_at_end(SessionEvent::RecorderKilled {
        program,
        waited_s: recorder.stop_timeout_s,
    });
}

impl Session<'_> {
    /// Pumps for a time of the computer's clock. Failures are left to the next step of closing.
    pub(crate) fn listen_for(&mut self, time: Duration) {
        let begun = self.clock.now();
        while self.clock.now().saturating_sub(begun) < time {
            if self.pump(LISTEN).is_err() {
                self.clock.wait(LISTEN);
            }
        }
    }
}

/// Runs the steps after a completed recording.
fn after_recording(
    session: &mut Session<'_>,
    options: &Options,
    wants_twist: bool,
) -> Result<(), Stop> {
    session.save()?;
    // From here on Ctrl-C skips the rest.
    session.closing = false;
    if wants_twist && !session.was_reset {
        let places = session.phones.places();
        let first: Vec<_> = places
            .map(|place| session.file.phones[place].clock)
            .collect();
        let twisted = session.step(Step::SecondTwist, |session| second_twist(session, &first));
        report_failure(session, twisted, |error| SessionEvent::SecondTwistFailed {
            error,
        })?;
    } else if wants_twist {
        // The reset has restarted the board's clock.
        session.log.report(SessionEvent::SecondTwistLeftOut)?;
    }
    session.enter(Phase::Fetching);
    if options.fetch_video {
        for place in session.phones.places() {
            // The app ends when it is asked for a video and has made none.
            if session.file.phones[place].video.is_none() {
                let phone = session.phones.name(place);
                session.log.report(SessionEvent::NoVideoToFetch { phone })?;
                continue;
            }
            let fetched = session.step(Step::Download, |session| fetch_video(session, place));
            report_failure(session, fetched, |error| SessionEvent::VideoNotFetched {
                error,
            })?;
        }
    }
    if options.fetch_files {
        for place in session.phones.places() {
            fetch_files(session, place)?;
        }
    }
    Ok(())
}

/// Turns a failure after the recording into a problem, since the recording itself is complete.
fn report_failure(
    session: &mut Session<'_>,
    result: Result<(), Stop>,
    event: impl FnOnce(String) -> SessionEvent,
) -> Result<(), Stop> {
    match result {
        Err(Stop::Failed(error)) if error.is_repeatable() => {
            session.log.report(event(error.to_string()))
        }
        other => other,
    }
}

/// Finishes `recording.mcap`.
fn finish(session: &mut Session<'_>, result: Result<(), Stop>) -> Result<(), Stop> {
    session.closing = true;
    let writer = session.log.writer.take();
    let finished = writer.map(recording::writer::Writer::finish).transpose();
    let (topics, finished) = match finished {
        Ok(topics) => (topics, Ok(())),
        Err(error) => (None, Err(Stop::from(error))),
    };
    let result = result.and(finished);
    session.file.close(session.outcome_of(&result), topics);
    result
}
