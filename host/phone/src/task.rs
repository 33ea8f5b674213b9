//! The phone on a thread of its own, so that the board is listened to while a
//! request lasts.
//!
//! One request at a time. A connection that broke, also between two requests, is
//! opened anew by the next request: nothing was asked on it, so nothing is asked
//! twice.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::{
    ImuRecording, ImuRequest, PhoneClient, PhoneError, SavedVideo, Settings, StopSignal,
    VideoStart, VideoTarget,
};

/// What the phone is asked.
#[derive(Clone, Debug)]
pub enum Request {
    /// Is it there, and which version is it?
    Probe,
    /// Record the gyroscope.
    Gyroscope(Duration),
    /// Start a video.
    StartVideo,
    /// Stop the video.
    StopVideo,
    /// Download the last video into a folder.
    FetchVideo(PathBuf),
}

/// What it answered.
#[derive(Clone, Debug)]
pub enum Answer {
    /// To [`Request::Probe`]: the version.
    Version(String),
    /// To [`Request::Gyroscope`].
    Gyroscope(ImuRecording),
    /// To [`Request::StartVideo`].
    Started(VideoStart),
    /// To [`Request::StopVideo`].
    Stopped,
    /// To [`Request::FetchVideo`].
    Fetched(SavedVideo),
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
                let mut phone = Phone {
                    address,
                    cancel: cancelled,
                    progress: shown,
                    client: None,
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
    client: Option<PhoneClient>,
}

impl Phone {
    fn answer(&mut self, request: &Request) -> Result<Answer, PhoneError> {
        let progress = Arc::clone(&self.progress);
        let client = self.connected()?;
        match request {
            Request::Probe => client
                .probe()
                .map(|version| Answer::Version(version.to_string())),
            Request::Gyroscope(duration) => client
                .imu(ImuRequest {
                    duration: *duration,
                    accelerometer: false,
                    gyroscope: true,
                    magnetometer: false,
                })
                .map(Answer::Gyroscope),
            Request::StartVideo => client.start_video().map(Answer::Started),
            Request::StopVideo => client.stop_video().map(|()| Answer::Stopped),
            Request::FetchVideo(folder) => client
                .get_video(
                    &VideoTarget::Folder(folder.clone()),
                    false,
                    &mut |done, whole| {
                        progress.done.store(done, Ordering::Relaxed);
                        progress.whole.store(whole, Ordering::Relaxed);
                    },
                )
                .map(Answer::Fetched),
        }
    }

    fn connected(&mut self) -> Result<&mut PhoneClient, PhoneError> {
        let client = match self.client.take() {
            Some(client) if client.is_alive() => client,
            Some(mut client) => {
                client.reconnect()?;
                client
            }
            None => {
                let cancel = Arc::clone(&self.cancel);
                let settings = Settings {
                    stop: StopSignal::new(move || cancel.load(Ordering::Relaxed)),
                    ..Settings::default()
                };
                PhoneClient::connect(&self.address, settings)?
            }
        };
        Ok(self.client.insert(client))
    }
}
