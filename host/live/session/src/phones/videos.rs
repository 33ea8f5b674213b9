//! The phones' videos: start, watch, stop, and download.

use std::path::Path;
use std::time::Duration;

use clock::BoardToPhone;
use phone::adb::{copy_command, get_files_command};
use phone::{Asked, VideoStart, coverage, video_files};
use recording::session_file::Video;
use recording::verify::assumed_frames;
use system::ReadMonitor;

use crate::alignment::placement;
use crate::error::{Stop, is_phone_fault};
use crate::event::{Device, SessionEvent};
use crate::log::Log;
use crate::phones::{Phones, REFERENCE, VideoNews};
use crate::session::Session;

/// Time for which the request to stop a video is repeated after its first failure.
const STOP_PATIENCE: Duration = Duration::from_secs(5);

/// Pause between two of these requests.
const STOP_PAUSE: Duration = Duration::from_millis(500);

/// Pause between two reports of a download.
const REPORT_EVERY: Duration = Duration::from_millis(300);

/// Starts the videos of all phones that have not begun one. A phone that fails does not keep the
/// others from starting.
pub(crate) fn start_videos(session: &mut Session<'_>) -> Result<(), Stop> {
    let mut without_video = Vec::new();
    for place in session.phones.places() {
        if session.file.phones[place].video.is_none() {
            session.phones.set_video_may_run(place);
            without_video.push(place);
        }
    }
    let now = session.now();
    let clocks = session
        .phones
        .places()
        .map(|place| session.file.phones[place].clock);
    // Only the clocks of the reference are read.
    let slept_ns = |place| {
        let tracking = session.tracking.as_ref();
        tracking.filter(|_| place == REFERENCE)?.slept_ns()
    };
    let times: Vec<Option<Asked>> = (0..)
        .zip(clocks)
        .map(|(place, clock)| {
            Some(Asked {
                boot: clock?.ticks_to_phone(now),
                slept_ns: slept_ns(place),
            })
        })
        .collect();
    let answers = session.ask_phones(
        without_video,
        |place, phone| phone.start_video(times[place]),
        |_| {},
    )?;
    let mut failed = None;
    let mut unknown = Vec::new();
    for (place, answer) in answers {
        match answer {
            Ok(start) => video_began(session, place, start)?,
            Err(error) => {
                let error = session.phones.failure(place, error);
                failed.get_or_insert(error);
                unknown.push(place);
            }
        }
    }
    stop_after_failure(session, &unknown)?;
    failed.map_or(Ok(()), |error| Err(error.into()))
}

/// Stops the videos that these phones may have begun although their start failed. Otherwise
/// another start would end a video instead, since the request only presses a button.
fn stop_after_failure(session: &mut Session<'_>, places: &[usize]) -> Result<(), Stop> {
    if places.is_empty() {
        return Ok(());
    }
    let places = places.iter().copied();
    let answers = session.ask_phones(places.clone(), |_, phone| phone.stop_video(), |_| {})?;
    for (place, answer) in answers {
        session.log.report(SessionEvent::VideoUndone {
            phone: session.phones.name(place),
            error: answer.err().map(|error| error.to_string()),
        })?;
    }
    // The next request reports a video that does not end in time.
    session
        .ask_phones(places, |_, phone| phone.await_closed(), |_| {})
        .map(drop)
}

fn video_began(session: &mut Session<'_>, place: usize, start: VideoStart) -> Result<(), Stop> {
    let video = Video {
        phase: start.phase,
        frame_duration_ns: start.frame_duration_ns,
        exposure_ns: start.exposure_ns,
        boot_minus_frames_ns: start.boot_minus_frames_ns,
    };
    session.file.phones[place].video = Some(video);
    session.save()?;
    if video.boot_minus_frames_ns != 0 {
        let remark = format!(
            "{} stamps its frames with CLOCK_MONOTONIC, which is {:.6} s behind its sensors' \
             clock: corrected",
            session.phones.name(place),
            video.boot_minus_frames_ns as f64 * 1e-9
        );
        session
            .log
            .report(SessionEvent::AlignmentRemark { remark })?;
    }
    session.log.report(SessionEvent::VideoStarted {
        phone: session.phones.name(place),
        video,
    })
}

/// Computes the position of the other phones' frames relative to the trigger's grid.
pub(crate) fn place_others(session: &mut Session<'_>) -> Result<(), Stop> {
    for place in session.phones.places().skip(1) {
        let phone = session.phones.name(place);
        let record = &session.file.phones[place];
        let known = (session.file.alignment, record.clock, record.video);
        let (Some(alignment), Some(clock), Some(video)) = known else {
            session.log.report(SessionEvent::PhoneLeftOut { phone })?;
            continue;
        };
        let course = session.phones.course(place, clock);
        let profile = session.phones.profile(place);
        let placement = placement(session.profile, profile, &course, &video, &alignment);
        session.file.phones[place].placement = Some(placement);
        session.save()?;
        session
            .log
            .report(SessionEvent::Placed { phone, placement })?;
    }
    Ok(())
}

/// Checks that the phones' videos run. Returns the indices of those that have ended; a phone that
/// cannot be reached is only reported, since it may return.
pub(crate) fn watch_videos(phones: &mut Phones<'_>, log: &mut Log<'_>) -> Result<Vec<usize>, Stop> {
    let mut ended = Vec::new();
    for place in phones.places() {
        let Some(news) = phones.video_news(place, log.now) else {
            continue;
        };
        let phone = phones.name(place);
        log.report(match news {
            VideoNews::Ended => {
                ended.push(place);
                SessionEvent::VideoEnded { phone }
            }
            VideoNews::Back => SessionEvent::PhoneBack { phone },
            VideoNews::Away(error) => SessionEvent::PhoneAway {
                phone,
                error: error.to_string(),
            },
        })?;
    }
    Ok(ended)
}

/// Stops the videos that run. The request is repeated if a phone cannot be reached for a moment,
/// as when Wi-Fi stalls: stopping twice is harmless.
pub(crate) fn stop_videos(session: &mut Session<'_>) {
    let mut running = session.phones.take_running_videos();
    let mut failing_since = None;
    while !running.is_empty() {
        let places = std::mem::take(&mut running);
        let answers = match session.ask_phones(places, |_, phone| phone.stop_video(), |_| {}) {
            Ok(answers) => answers,
            Err(Stop::Failed(error)) => {
                session.log.report_at_end(SessionEvent::NotStopped {
                    what: Device::Video(None),
                    error: error.to_string(),
                });
                return;
            }
            Err(Stop::Interrupted | Stop::BoardReset) => return,
        };
        let is_first = failing_since.is_none();
        let now = session.clock.now();
        let since = *failing_since.get_or_insert(now);
        for (place, answer) in answers {
            let Err(error) = answer else { continue };
            let phone = session.phones.name(place);
            if is_phone_fault(&error) && now.saturating_sub(since) < STOP_PATIENCE {
                running.push(place);
                if is_first {
                    session.log.publish(SessionEvent::StopRetried {
                        phone,
                        error: error.to_string(),
                        patience_s: STOP_PATIENCE.as_secs(),
                    });
                }
                continue;
            }
            session.log.report_at_end(SessionEvent::NotStopped {
                what: Device::Video(Some(phone)),
                error: error.to_string(),
            });
        }
        if !running.is_empty() {
            session.listen_for(STOP_PAUSE);
        }
    }
}

/// Downloads the last video of a phone.
pub(crate) fn fetch_video(session: &mut Session<'_>, place: usize) -> Result<(), Stop> {
    let own = session
        .file
        .phone_folder(&session.phones.profile(place).name);
    let folder = session.log.folder.join(&own);
    let mut reported = session.clock.now();
    let answers = session.ask_phones(
        [place],
        |_, phone| phone.fetch_video(folder.clone()),
        |session| {
            let now = session.clock.now();
            if now.saturating_sub(reported) > REPORT_EVERY {
                reported = now;
                let (done, whole) = session.phones.device(place).progress();
                session.log.publish(SessionEvent::Downloading {
                    phone: session.phones.name(place),
                    done,
                    whole,
                });
            }
        },
    );
    let Some((_, answer)) = answers?.pop() else {
        return Ok(());
    };
    let video = answer.map_err(|error| session.phones.failure(place, error))?;
    if let Some(name) = video.path.file_name() {
        let name = own.join(name).to_string_lossy().into_owned();
        session.file.files.push(name);
    }
    session.log.report(SessionEvent::VideoFetched {
        path: video.path,
        size: video.size,
    })
}

/// Copies the files that the app does not send: the frames' timestamps and the sensors. If that
/// fails, reports commands that copy them.
pub(crate) fn fetch_files(session: &mut Session<'_>, place: usize) -> Result<(), Stop> {
    let Some(video) = session.file.phones[place].video else {
        return Ok(());
    };
    let own = &session.phones.profile(place).name;
    let own = session.file.phone_folder(own);
    let folder = session.log.folder.join(&own);
    let answer = session
        .ask_phones(
            [place],
            |_, phone| phone.fetch_files(video.phase, folder.clone()),
            |_| {},
        )?
        .pop();
    let phone = session.phones.name(place);
    let event = match answer {
        Some((_, Ok(files))) => {
            for name in files.iter().filter_map(|path| path.file_name()) {
                let name = own.join(name).to_string_lossy().into_owned();
                session.file.files.push(name);
            }
            SessionEvent::FilesFetched {
                phone,
                count: files.len(),
            }
        }
        Some((_, Err(error))) => SessionEvent::FilesNotFetched {
            phone,
            error: error.to_string(),
            commands: [
                get_files_command(video.phase, &folder, false),
                copy_command(video.phase, &folder),
            ],
        },
        None => return Ok(()),
    };
    let is_fetched = matches!(event, SessionEvent::FilesFetched { .. });
    session.log.report(event)?;
    if is_fetched {
        compare_files(session, place, &folder)?;
    }
    Ok(())
}

/// Compares a phone's files with each other, and with the frames that the trigger was aligned to.
fn compare_files(session: &mut Session<'_>, place: usize, folder: &Path) -> Result<(), Stop> {
    let Ok(Some(files)) = video_files::find(folder, None) else {
        return Ok(());
    };
    let assumed = assumed_frames(&session.file, &session.file.phones[place]);
    // A file that cannot be read is found by those who need it.
    let faults = coverage::check(&files, assumed.as_ref(), &ReadMonitor::default());
    for fault in faults.unwrap_or_default() {
        let phone = session.phones.name(place);
        session.log.report(SessionEvent::FilesDisagree {
            phone,
            fault: fault.to_string(),
            next_step: fault.next_step(),
        })?;
    }
    Ok(())
}
