//! The phone on a thread of its own, so that the board is listened to while a
//! request lasts.
//!
//! One request at a time, each on a connection of its own: a client that stays connected
//! keeps the app from listening again once it was in the background.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::adb;
use crate::{
    ImuRequest, PhoneClient, PhoneError, PhoneSample, SavedVideo, Sensor, Settings, StopSignal,
    VideoStart, VideoTarget,
};
use timebase::PhoneNanos;

/// What the phone is asked.
#[derive(Clone, Debug)]
pub enum Request {
    /// Is it there, and which version is it?
    Probe,
    /// Record the gyroscope.
    Gyroscope(Duration),
    /// Start a video, at this time of the phone's clock if it is known.
    StartVideo(Option<PhoneNanos>),
    /// Stop the video.
    StopVideo,
    /// Does it record a video?
    IsRecording,
    /// Wait until a video that was stopped is closed.
    AwaitClosed,
    /// Download the last video into a folder.
    FetchVideo(PathBuf),
    /// Copy the other files of the video with this phase into a folder, by `adb`.
    FetchFiles(PhoneNanos, PathBuf),
}

/// What it answered.
#[derive(Clone, Debug)]
pub enum Answer {
    /// To [`Request::Probe`]: the version.
    Version(String),
    /// To [`Request::Gyroscope`].
    Gyroscope(Vec<PhoneSample>),
    /// To [`Request::StartVideo`].
    Started(VideoStart),
    /// To [`Request::StopVideo`].
    Stopped,
    /// To [`Request::IsRecording`].
    Recording(bool),
    /// To [`Request::AwaitClosed`].
    Closed,
    /// To [`Request::FetchVideo`].
    Fetched(SavedVideo),
    /// To [`Request::FetchFiles`]: where they are.
    Files(Vec<PathBuf>),
}

/// The thread and its mail boxes.
pub struct PhoneTask {
    requests: Option<Sender<Request>>,
    answers: Receiver<Result<Answer, PhoneError>>,
    cancel: Arc<AtomicBool>,
    progress: Arc<Progress>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Progress {
    done: AtomicU64,
    whole: AtomicU64,
}

impl PhoneTask {
    /// Starts the thread; nothing is connected yet.
    ///
    /// # Errors
    ///
    /// The system gives no thread.
    pub fn start(address: String) -> std::io::Result<Self> {
        let (requests, inbox) = channel::<Request>();
        let (outbox, answers) = channel();
        let cancel = Arc::new(AtomicBool::new(false));
        let progress = Arc::new(Progress::default());
        let cancelled = Arc::clone(&cancel);
        let shown = Arc::clone(&progress);
        let thread = std::thread::Builder::new()
            .name(String::from("phone"))
            .spawn(move || {
                let phone = Phone {
                    address,
                    cancel: cancelled,
                    progress: shown,
                };
                while let Ok(request) = inbox.recv() {
                    if outbox.send(phone.answer(&request)).is_err() {
                        return;
                    }
                }
            })?;
        Ok(Self {
            requests: Some(requests),
            answers,
            cancel,
            progress,
            thread: Some(thread),
        })
    }

    /// Asks; the answer is to be taken by [`PhoneTask::answer`].
    pub fn ask(&self, request: Request) {
        self.cancel.store(false, Ordering::Relaxed);
        self.progress.done.store(0, Ordering::Relaxed);
        if let Some(requests) = &self.requests {
            // Fails only if the thread has died, which `answer` tells.
            let _ = requests.send(request);
        }
    }

    /// The answer, once it is there.
    #[must_use]
    pub fn answer(&self) -> Option<Result<Answer, PhoneError>> {
        match self.answers.try_recv() {
            Ok(answer) => Some(answer),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err(PhoneError::NotConnected)),
        }
    }

    /// Ends the request under way with [`PhoneError::Cancelled`], within about
    /// 100 ms.
    pub fn cancel(&self) {
        self.cancel.store(true, Ordering::Relaxed);
    }

    /// Bytes of the download that are there, and in all.
    #[must_use]
    pub fn progress(&self) -> (u64, u64) {
        (
            self.progress.done.load(Ordering::Relaxed),
            self.progress.whole.load(Ordering::Relaxed),
        )
    }
}

impl Drop for PhoneTask {
    fn drop(&mut self) {
        self.cancel();
        self.requests = None;
        if let Some(thread) = self.thread.take() {
            // A panic there has been told by its message.
            let _ = thread.join();
        }
    }
}

struct Phone {
    address: String,
    cancel: Arc<AtomicBool>,
    progress: Arc<Progress>,
}

impl Phone {
    fn answer(&self, request: &Request) -> Result<Answer, PhoneError> {
        let cancel = Arc::clone(&self.cancel);
        let settings = Settings {
            stop: StopSignal::new(move || cancel.load(Ordering::Relaxed)),
            ..Settings::default()
        };
        let connect = || PhoneClient::connect(&self.address, settings.clone());
        match request {
            Request::Probe => {
                let version = connect()?.probe()?;
                Ok(Answer::Version(version.to_string()))
            }
            Request::Gyroscope(duration) => {
                let recording = connect()?.imu(ImuRequest::gyroscope(*duration))?;
                recording.take(Sensor::Gyroscope).map(Answer::Gyroscope)
            }
            Request::StartVideo(asked) => connect()?.start_video(*asked).map(Answer::Started),
            Request::StopVideo => connect()?.stop_video().map(|()| Answer::Stopped),
            Request::IsRecording => connect()?.is_recording().map(Answer::Recording),
            Request::AwaitClosed => {
                connect()?.wait_until_free(settings.busy)?;
                Ok(Answer::Closed)
            }
            Request::FetchFiles(phase, folder) => {
                let files = adb::fetch(*phase, folder, false, &settings.stop)?;
                Ok(Answer::Files(files))
            }
            Request::FetchVideo(folder) => {
                let target = VideoTarget::Folder(folder.clone());
                let mut progress = |done, whole| {
                    self.progress.done.store(done, Ordering::Relaxed);
                    self.progress.whole.store(whole, Ordering::Relaxed);
                };
                let saved = connect()?.get_video(&target, false, &mut progress);
                saved.map(Answer::Fetched)
            }
        }
    }
}
