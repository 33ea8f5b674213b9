//! The phone on a thread of its own, so that the board is listened to while a
//! request lasts.
//!
//! One request at a time, each on a connection of its own: a client that stays connected
//! keeps the app from listening again once it was in the background.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::adb;
use crate::{
    PhoneClient, PhoneError, PhoneSample, SavedVideo, ServerVersion, Settings, StopSignal,
    VideoStart, requests::Asked,
};
use clock::PhoneNanos;

/// A phone with the app. No method waits: each gives an answer that is on its way.
pub trait Phone {
    /// Is it there, and which version is its app?
    fn probe(&self) -> Pending<ServerVersion>;
    /// Records the gyroscope.
    fn gyroscope(&self, length: Duration) -> Pending<Vec<PhoneSample>>;
    /// Starts a video, at this time of the phone's clocks if it is known.
    fn start_video(&self, asked: Option<Asked>) -> Pending<VideoStart>;
    /// Stops the video.
    fn stop_video(&self) -> Pending<()>;
    /// Does it record a video?
    fn is_recording(&self) -> Pending<bool>;
    /// Waits until a video that was stopped is closed.
    fn await_closed(&self) -> Pending<()>;
    /// Downloads the last video into a folder.
    fn fetch_video(&self, folder: PathBuf) -> Pending<SavedVideo>;
    /// Copies the other files of the video with this phase into a folder, by `adb`; gives
    /// where they are.
    fn fetch_files(&self, phase: PhoneNanos, folder: PathBuf) -> Pending<Vec<PathBuf>>;
    /// Bytes of the download that are there, and in all.
    fn progress(&self) -> (u64, u64);
}

/// The thread of one phone. Dropping it ends the request under way.
pub struct PhoneTask {
    requests: Option<Sender<Request>>,
    phone: Arc<Reached>,
    thread: Option<JoinHandle<()>>,
}

/// What the thread does.
type Request = Box<dyn FnOnce(&Reached) + Send>;

/// How the thread reaches the phone, and what is seen of that from outside.
struct Reached {
    address: String,
    settings: Settings,
    cancel: Arc<AtomicBool>,
    /// Bytes of the download that are there, and in all.
    done: AtomicU64,
    whole: AtomicU64,
}

impl Reached {
    fn connect(&self) -> Result<PhoneClient, PhoneError> {
        PhoneClient::connect(&self.address, self.settings.clone())
    }
}

/// An answer of the phone that is on its way.
pub struct Pending<T> {
    poll: Box<dyn Fn() -> Option<Result<T, PhoneError>>>,
    cancel: Box<dyn Fn()>,
}

impl<T> Pending<T> {
    /// An answer that `poll` gives, once, when it is there; `cancel` asks whoever works on
    /// it to answer with [`PhoneError::Cancelled`] soon.
    pub fn new(
        poll: impl Fn() -> Option<Result<T, PhoneError>> + 'static,
        cancel: impl Fn() + 'static,
    ) -> Self {
        Self {
            poll: Box::new(poll),
            cancel: Box::new(cancel),
        }
    }

    /// The answer, once it is there; it is given once.
    #[must_use]
    pub fn answer(&self) -> Option<Result<T, PhoneError>> {
        (self.poll)()
    }

    /// Ends the request with [`PhoneError::Cancelled`], within about 100 ms.
    pub fn cancel(&self) {
        (self.cancel)();
    }
}

impl PhoneTask {
    /// Starts the thread; nothing is connected yet.
    ///
    /// # Errors
    ///
    /// The system gives no thread.
    pub fn start(address: String) -> std::io::Result<Self> {
        let (requests, inbox) = channel::<Request>();
        let cancel = Arc::new(AtomicBool::new(false));
        let cancelled = Arc::clone(&cancel);
        let phone = Arc::new(Reached {
            address,
            settings: Settings {
                stop: StopSignal::new(move || cancelled.load(Ordering::Relaxed)),
                ..Settings::default()
            },
            cancel,
            done: AtomicU64::new(0),
            whole: AtomicU64::new(0),
        });
        let asked = Arc::clone(&phone);
        let thread = std::thread::Builder::new()
            .name(String::from("phone"))
            .spawn(move || inbox.iter().for_each(|request| request(&asked)))?;
        Ok(Self {
            requests: Some(requests),
            phone,
            thread: Some(thread),
        })
    }

    fn ask<T: Send + 'static>(
        &self,
        request: impl FnOnce(&Reached) -> Result<T, PhoneError> + Send + 'static,
    ) -> Pending<T> {
        self.phone.cancel.store(false, Ordering::Relaxed);
        self.phone.done.store(0, Ordering::Relaxed);
        let (sender, answer) = channel();
        if let Some(requests) = &self.requests {
            // Fails only if the thread has died, which the answer tells.
            let _ = requests.send(Box::new(move |phone| {
                // Fails only if nobody waits for it.
                let _ = sender.send(request(phone));
            }));
        }
        let cancel = Arc::clone(&self.phone.cancel);
        Pending::new(
            move || match answer.try_recv() {
                Ok(answer) => Some(answer),
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Disconnected) => Some(Err(PhoneError::NotConnected)),
            },
            move || cancel.store(true, Ordering::Relaxed),
        )
    }
}

impl Phone for PhoneTask {
    fn probe(&self) -> Pending<ServerVersion> {
        self.ask(|phone| phone.connect()?.probe())
    }

    fn gyroscope(&self, length: Duration) -> Pending<Vec<PhoneSample>> {
        self.ask(move |phone| phone.connect()?.gyroscope(length))
    }

    fn start_video(&self, asked: Option<Asked>) -> Pending<VideoStart> {
        self.ask(move |phone| phone.connect()?.start_video(asked))
    }

    fn stop_video(&self) -> Pending<()> {
        self.ask(|phone| phone.connect()?.stop_video())
    }

    fn is_recording(&self) -> Pending<bool> {
        self.ask(|phone| phone.connect()?.is_recording())
    }

    fn await_closed(&self) -> Pending<()> {
        self.ask(|phone| phone.connect()?.wait_until_free(phone.settings.busy))
    }

    fn fetch_video(&self, folder: PathBuf) -> Pending<SavedVideo> {
        self.ask(move |phone| {
            let mut progress = |done, whole| {
                phone.done.store(done, Ordering::Relaxed);
                phone.whole.store(whole, Ordering::Relaxed);
            };
            phone.connect()?.get_video(&folder, false, &mut progress)
        })
    }

    fn fetch_files(&self, phase: PhoneNanos, folder: PathBuf) -> Pending<Vec<PathBuf>> {
        self.ask(move |phone| Ok(adb::fetch(phase, &folder, false, &phone.settings.stop)?))
    }

    fn progress(&self) -> (u64, u64) {
        (
            self.phone.done.load(Ordering::Relaxed),
            self.phone.whole.load(Ordering::Relaxed),
        )
    }
}

impl Drop for PhoneTask {
    fn drop(&mut self) {
        self.phone.cancel.store(true, Ordering::Relaxed);
        self.requests = None;
        if let Some(thread) = self.thread.take() {
            // A panic there has printed its message.
            let _ = thread.join();
        }
    }
}
