//! The client of a phone on a thread, so that the caller is not blocked during a request.
//!
//! Requests are carried out one at a time, each on a connection of its own: a client that stays
//! connected keeps the app from listening again after it was in the background.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::adb;
use crate::{
    PhoneClient, PhoneError, PhoneSample, SavedVideo, ServerVersion, Settings, VideoStart,
    requests::Asked,
};
use clock::PhoneNanos;
use system::Cancel;

/// A phone with the app. No method blocks: each returns a [`Pending`] answer.
pub trait Phone {
    /// Requests the version of the app.
    fn probe(&self) -> Pending<ServerVersion>;
    /// Records the gyroscope.
    fn gyroscope(&self, length: Duration) -> Pending<Vec<PhoneSample>>;
    /// Starts a video. `asked` holds the phone's clocks now, if they are known.
    fn start_video(&self, asked: Option<Asked>) -> Pending<VideoStart>;
    /// Stops the video.
    fn stop_video(&self) -> Pending<()>;
    /// Requests whether the app records a video.
    fn is_recording(&self) -> Pending<bool>;
    /// Waits until the file of a stopped video is closed.
    fn await_closed(&self) -> Pending<()>;
    /// Downloads the last video into a folder.
    fn fetch_video(&self, folder: PathBuf) -> Pending<SavedVideo>;
    /// Copies the other files of the video with this phase into a folder, by `adb`. The answer
    /// holds their paths.
    fn fetch_files(&self, phase: PhoneNanos, folder: PathBuf) -> Pending<Vec<PathBuf>>;
    /// Returns the bytes of the last download that have arrived, and the size of its file.
    fn progress(&self) -> (u64, u64);
}

/// A phone that a thread of its own talks to. Requests are carried out in the order in which they
/// are made, each with a cancellation of its own. Dropping this ends the request under way and
/// drops those that wait.
pub struct PhoneTask {
    requests: Option<Sender<Request>>,
    state: Arc<State>,
    thread: Option<JoinHandle<()>>,
}

/// A request as the thread carries it out.
type Request = Box<dyn FnOnce(&State) + Send>;

/// State that the thread shares with its owner.
struct State {
    address: String,
    /// Set once the task is dropped.
    closing: AtomicBool,
    /// Bytes of the last download that have arrived, and of the whole file.
    received: AtomicU64,
    length: AtomicU64,
}

/// The thread's way to the phone for one request.
struct Access<'a> {
    state: &'a State,
    cancel: Cancel,
}

impl Access<'_> {
    fn connect(&self) -> Result<PhoneClient, PhoneError> {
        let settings = Settings {
            cancel: self.cancel.clone(),
            ..Settings::default()
        };
        PhoneClient::connect(&self.state.address, settings)
    }
}

/// The answer of a phone to a request that is still being carried out.
pub struct Pending<T> {
    poll: Box<dyn Fn() -> Option<Result<T, PhoneError>>>,
    cancel: Box<dyn Fn()>,
}

impl<T> Pending<T> {
    /// Creates an answer from two functions: `poll` returns the answer once, after it has arrived;
    /// `cancel` makes it [`PhoneError::Cancelled`] soon.
    pub fn new(
        poll: impl Fn() -> Option<Result<T, PhoneError>> + 'static,
        cancel: impl Fn() + 'static,
    ) -> Self {
        Self {
            poll: Box::new(poll),
            cancel: Box::new(cancel),
        }
    }

    /// Returns the answer once, after it has arrived.
    #[must_use]
    pub fn answer(&self) -> Option<Result<T, PhoneError>> {
        (self.poll)()
    }

    /// Ends the request with [`PhoneError::Cancelled`] within about 100 ms. Other requests are not
    /// affected.
    pub fn cancel(&self) {
        (self.cancel)();
    }
}

impl PhoneTask {
    /// Starts the thread. Connects nothing yet.
    ///
    /// # Errors
    ///
    /// The thread cannot be started.
    pub fn start(address: String) -> std::io::Result<Self> {
        let (requests, inbox) = channel::<Request>();
        let state = Arc::new(State {
            address,
            closing: AtomicBool::new(false),
            received: AtomicU64::new(0),
            length: AtomicU64::new(0),
        });
        let shared = Arc::clone(&state);
        let carry_out = move || {
            let is_open = |_: &Request| !shared.closing.load(Ordering::Relaxed);
            let requests = inbox.iter().take_while(is_open);
            requests.for_each(|request| request(&shared));
        };
        let thread = std::thread::Builder::new().name(String::from("phone"));
        Ok(Self {
            requests: Some(requests),
            state,
            thread: Some(thread.spawn(carry_out)?),
        })
    }

    /// Hands a request to the thread.
    fn ask<T: Send + 'static>(
        &self,
        request: impl FnOnce(&Access<'_>) -> Result<T, PhoneError> + Send + 'static,
    ) -> Pending<T> {
        let (sender, answer) = channel();
        let cancelled = Arc::new(AtomicBool::new(false));
        let cancel = {
            let (cancelled, state) = (Arc::clone(&cancelled), Arc::clone(&self.state));
            Cancel::when(move || {
                cancelled.load(Ordering::Relaxed) || state.closing.load(Ordering::Relaxed)
            })
        };
        if let Some(requests) = &self.requests {
            // Fails only if the thread has died, which the answer reports.
            let _ = requests.send(Box::new(move |state| {
                // Fails only if nobody waits for the answer.
                let _ = sender.send(request(&Access { state, cancel }));
            }));
        }
        Pending::new(
            move || match answer.try_recv() {
                Ok(answer) => Some(answer),
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Disconnected) => Some(Err(PhoneError::NotConnected)),
            },
            move || cancelled.store(true, Ordering::Relaxed),
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
        self.ask(|phone| phone.connect()?.wait_until_free(Settings::default().busy))
    }

    fn fetch_video(&self, folder: PathBuf) -> Pending<SavedVideo> {
        self.state.received.store(0, Ordering::Relaxed);
        self.ask(move |phone| {
            let mut progress = |received, length| {
                phone.state.received.store(received, Ordering::Relaxed);
                phone.state.length.store(length, Ordering::Relaxed);
            };
            phone.connect()?.get_video(&folder, false, &mut progress)
        })
    }

    fn fetch_files(&self, phase: PhoneNanos, folder: PathBuf) -> Pending<Vec<PathBuf>> {
        self.ask(move |phone| Ok(adb::fetch(phase, &folder, false, &phone.cancel)?))
    }

    fn progress(&self) -> (u64, u64) {
        (
            self.state.received.load(Ordering::Relaxed),
            self.state.length.load(Ordering::Relaxed),
        )
    }
}

impl Drop for PhoneTask {
    fn drop(&mut self) {
        self.state.closing.store(true, Ordering::Relaxed);
        self.requests = None;
        if let Some(thread) = self.thread.take() {
            // A panic there has printed its message.
            let _ = thread.join();
        }
    }
}
