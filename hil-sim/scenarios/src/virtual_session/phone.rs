//! A phone that is asked by calls: the requests of [`phone::PhoneClient`], each as a
//! question whose answer is looked for when the session looks.

use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Duration;

use ::phone::adb::AdbError;
use ::phone::answer::{self, Lines, MalformedAnswer};
use ::phone::error::Refusal;
use ::phone::file_name::safe_file_name;
use ::phone::requests::{ImuBody, VideoHeader};
use ::phone::task::Pending;
use ::phone::video_files::of_video;
use ::phone::{Asked, ImuRequest, PhoneError, PhoneSample, SavedVideo, ServerVersion, VideoStart};
use ::session::devices::Phone;
use clock::PhoneNanos;
use rig::phone::{Answer, RequestId};

use super::SharedRig;

/// Longest wait for an answer, beyond the time that a request takes by its nature.
const MARGIN: Duration = Duration::from_secs(15);

/// Time for which the app itself waits for frames before it gives up on `video_start`.
const FRAMES: Duration = Duration::from_secs(10);

/// Time for which sensors that are busy are tried again, and the same before a download.
const BUSY: Duration = Duration::from_secs(6);
const BUSY_WITH_VIDEO: Duration = Duration::from_secs(120);

/// Pause between two tries.
const PAUSE: Duration = Duration::from_millis(250);

/// The most bytes of an answer.
const MOST: u64 = 1 << 30;

/// The question whether the app's sensors are free.
const SHORTEST_IMU: ImuRequest = ImuRequest {
    duration: Duration::from_millis(1),
    accelerometer: true,
};

/// A phone of the rig.
pub(super) struct VirtualPhone {
    rig: SharedRig,
    place: usize,
    copies_files: bool,
}

/// A request to the app.
struct Question {
    request: &'static str,
    line: String,
    patience: Duration,
}

/// A success.
struct Reply {
    version: ServerVersion,
    body: Vec<String>,
    file: Option<PathBuf>,
}

/// The step after an answer.
enum Next<T> {
    Done(Result<T, PhoneError>),
    Ask(Question),
}

/// A request under way.
struct Asking {
    question: Question,
    /// It is sent from then on.
    due: Duration,
    /// It was sent, and is waited for until then.
    sent: Option<(RequestId, Duration)>,
}

impl VirtualPhone {
    pub(super) const fn new(rig: SharedRig, place: usize, copies_files: bool) -> Self {
        Self {
            rig,
            place,
            copies_files,
        }
    }

    /// Asks; `decide` says what follows each answer, which came at this time.
    fn ask<T: 'static>(
        &self,
        question: Question,
        decide: impl FnMut(Result<Reply, PhoneError>, Duration) -> Next<T> + 'static,
    ) -> Pending<T> {
        let asking = RefCell::new(Asking {
            question,
            due: self.rig.now(),
            sent: None,
        });
        let decide = RefCell::new(decide);
        let (rig, place) = (self.rig.clone(), self.place);
        let cancelled = Rc::new(Cell::new(false));
        let cancel = Rc::clone(&cancelled);
        let poll = move || {
            let asking = &mut *asking.borrow_mut();
            let request = asking.question.request;
            if cancelled.get() {
                return Some(Err(PhoneError::Cancelled { request }));
            }
            let now = rig.now();
            let Some((id, until)) = asking.sent else {
                if now >= asking.due {
                    let id = rig.with(|rig| rig.phones[place].ask(&asking.question.line));
                    asking.sent = Some((id, now + asking.question.patience));
                }
                return None;
            };
            let reply = match rig.with(|rig| rig.phones[place].take_answer(id)) {
                Some(answer) => read(request, answer),
                None if now < until => return None,
                None => Err(PhoneError::Timeout {
                    request,
                    waited: asking.question.patience,
                }),
            };
            match (decide.borrow_mut())(reply, now) {
                Next::Done(result) => Some(result),
                Next::Ask(question) => {
                    *asking = Asking {
                        question,
                        due: now + PAUSE,
                        sent: None,
                    };
                    None
                }
            }
        };
        Pending::new(poll, move || cancel.set(true))
    }

    /// Asks once.
    fn ask_once<T: 'static>(
        &self,
        question: Question,
        mut read: impl FnMut(Result<Reply, PhoneError>, Duration) -> Result<T, PhoneError> + 'static,
    ) -> Pending<T> {
        self.ask(question, move |reply, now| Next::Done(read(reply, now)))
    }

    /// Records sensors, again while they are busy.
    fn imu<T: 'static>(
        &self,
        request: ImuRequest,
        patience: Duration,
        mut then: impl FnMut(Result<Reply, PhoneError>) -> Next<T> + 'static,
    ) -> Pending<T> {
        let until = self.rig.now() + patience;
        self.ask(imu(request), move |reply, now| match reply {
            Err(error) if is_busy(&error) && now < until => Next::Ask(imu(request)),
            reply => then(reply),
        })
    }
}

fn imu(request: ImuRequest) -> Question {
    Question {
        request: "imu",
        line: request.line().unwrap_or_default(),
        patience: request.duration + MARGIN,
    }
}

fn simple(request: &'static str) -> Question {
    Question {
        request,
        line: request.to_owned(),
        patience: MARGIN,
    }
}

fn is_busy(error: &PhoneError) -> bool {
    error.refusal() == Some(Refusal::SensorsBusy)
}

/// Returns true if the sensors are free, by the answer to [`SHORTEST_IMU`].
fn is_free(reply: Result<Reply, PhoneError>) -> Result<(), PhoneError> {
    match reply {
        Ok(_) => Ok(()),
        // The app looks whether it is busy before it looks for sensors.
        Err(error @ PhoneError::Refused { .. }) if !is_busy(&error) => Ok(()),
        Err(error) => Err(error),
    }
}

/// The answer that came over a connection.
fn read(request: &'static str, answer: Answer) -> Result<Reply, PhoneError> {
    let (bytes, file) = match answer {
        Answer::Bytes(bytes) => (bytes, None),
        Answer::File { head, path } => (head, Some(path)),
        Answer::Unreachable => {
            return Err(PhoneError::Connect {
                address: String::from("the simulated phone"),
                source: std::io::ErrorKind::HostUnreachable.into(),
            });
        }
        Answer::Closed => {
            let received = 0;
            return Err(PhoneError::Closed { request, received });
        }
    };
    let malformed = |source| PhoneError::Malformed { request, source };
    let expected = "its end";
    let mut lines = Lines::new(MOST);
    let mut rest = bytes.as_slice();
    let next = || {
        let line = lines.next(&mut rest).map_err(malformed)?;
        line.ok_or_else(|| malformed(MalformedAnswer::Missing { expected }))
    };
    let mut body = Vec::new();
    let take = |_, line: &str| {
        body.push(line.to_owned());
        Ok(())
    };
    let answer = answer::read(next, take, malformed)?;
    let version = answer.version;
    match answer.refused {
        None => Ok(Reply {
            version,
            body,
            file,
        }),
        Some(text) => Err(PhoneError::Refused {
            request,
            text,
            version,
        }),
    }
}

/// The gyroscope's samples in an answer.
fn gyroscope(reply: &Reply) -> Result<Vec<PhoneSample>, PhoneError> {
    let malformed = |source| PhoneError::Malformed {
        request: "imu",
        source,
    };
    let mut body = ImuBody::default();
    for (number, line) in (1..).zip(&reply.body) {
        body.line(number, line).map_err(malformed)?;
    }
    let samples = body.finish().map_err(malformed)?;
    samples.ok_or(PhoneError::NoGyroscope)
}

/// Saves the video of an answer.
fn save(reply: &Reply, folder: &Path) -> Result<SavedVideo, PhoneError> {
    let request = "get_video";
    let header = VideoHeader::parse(&reply.body)
        .map_err(|source| PhoneError::Malformed { request, source })?;
    let from = reply.file.as_deref().unwrap_or(Path::new(""));
    let path = folder.join(safe_file_name(&header.file_name));
    let copied = std::fs::create_dir_all(folder).and_then(|()| std::fs::copy(from, &path));
    match copied {
        Ok(size) => Ok(SavedVideo {
            path,
            size,
            phone_name: header.file_name,
        }),
        Err(source) => Err(PhoneError::File {
            action: "write to",
            path,
            source,
        }),
    }
}

impl Phone for VirtualPhone {
    fn probe(&self) -> Pending<ServerVersion> {
        let question = Question {
            line: String::new(),
            ..simple("an empty request")
        };
        self.ask_once(question, |reply, _| match reply {
            Ok(Reply { version, .. }) | Err(PhoneError::Refused { version, .. }) => Ok(version),
            Err(error) => Err(error),
        })
    }

    fn gyroscope(&self, length: Duration) -> Pending<Vec<PhoneSample>> {
        let request = ImuRequest::gyroscope(length);
        self.imu(request, BUSY, move |reply| {
            Next::Done(reply.and_then(|reply| gyroscope(&reply)))
        })
    }

    fn start_video(&self, asked: Option<Asked>) -> Pending<VideoStart> {
        let begun = self.rig.now();
        let question = Question {
            patience: FRAMES + MARGIN,
            ..simple("video_start")
        };
        self.ask_once(question, move |reply, now| {
            let request = "video_start";
            let start = VideoStart::parse(&reply?.body)
                .map_err(|source| PhoneError::Malformed { request, source })?;
            start.checked(asked, now - begun, FRAMES + MARGIN)
        })
    }

    fn stop_video(&self) -> Pending<()> {
        self.ask_once(simple("video_stop"), |reply, _| reply.map(drop))
    }

    fn is_recording(&self) -> Pending<bool> {
        self.ask_once(imu(SHORTEST_IMU), |reply, _| match is_free(reply) {
            Ok(()) => Ok(false),
            Err(error) if is_busy(&error) => Ok(true),
            Err(error) => Err(error),
        })
    }

    fn await_closed(&self) -> Pending<()> {
        self.imu(SHORTEST_IMU, BUSY, |reply| Next::Done(is_free(reply)))
    }

    fn fetch_video(&self, folder: PathBuf) -> Pending<SavedVideo> {
        let mut is_asked = false;
        self.imu(SHORTEST_IMU, BUSY_WITH_VIDEO, move |reply| {
            if is_asked {
                return Next::Done(reply.and_then(|reply| save(&reply, &folder)));
            }
            is_asked = true;
            match is_free(reply) {
                Ok(()) => Next::Ask(Question {
                    patience: BUSY_WITH_VIDEO,
                    ..simple("get_video")
                }),
                Err(error) => Next::Done(Err(error)),
            }
        })
    }

    /// Copies the tables of the last video, where a cable reaches them.
    fn fetch_files(&self, _: PhoneNanos, folder: PathBuf) -> Pending<Vec<PathBuf>> {
        if !self.copies_files {
            return Pending::new(|| Some(Err(AdbError::NoProgram.into())), || {});
        }
        let (rig, place) = (self.rig.clone(), self.place);
        let copy = move || {
            let video = rig.with(|rig| rig.phones[place].app.videos().pop())?;
            let saved = rig.with(|rig| rig.phones[place].app.saved())?;
            let io = |source| PhoneError::File {
                action: "copy to",
                path: folder.clone(),
                source,
            };
            let copied = saved.map_err(std::io::Error::other).and_then(|()| {
                let files = of_video(&video.path)?.unwrap_or_default();
                let tables = [files.frames, files.gyro, files.accel]
                    .into_iter()
                    .flatten();
                let copies = tables.map(|file| {
                    let to = folder.join(file.file_name().unwrap_or_default());
                    std::fs::copy(file, &to).map(|_| to)
                });
                copies.collect()
            });
            Some(copied.map_err(io))
        };
        Pending::new(copy, || {})
    }

    fn progress(&self) -> (u64, u64) {
        (0, 0)
    }
}
