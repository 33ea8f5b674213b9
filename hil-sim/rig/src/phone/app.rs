//! Requests to the app, of which there are four, without a socket.
//!
//! The lines that it follows are of the app's source: RRH is
//! `RemoteRpcRequestHandler.java`, EAI `ExtendedAppInterface.java`.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use anyhow::{Context as _, Result};

use super::Surroundings;
use super::camera::FrameTimes;
use super::config::{PhoneConfig, StorageAccess, VideoMode};
use super::files::{Names, csv_line, name_of};
use super::java;
use super::request::ImuRequest;
use super::sensors::{Kind, Sensors};
use crate::clocks::oscillator::{Oscillator, TrueTime};
use crate::clocks::true_clock::{RigStopped, TrueClock};
use crate::depth_camera::flash_log::FlashLog;
use crate::random::Stream;
use stm32f4_sim::shared::lock;
use stm32f4_sim::time::UNITS_PER_SECOND;

/// Time that the app waits for the phase of a video, in milliseconds (RRH:34).
const PHASE_TIMEOUT_MS: u64 = 10_000;

/// Interval between looks for the phase, in milliseconds.
const PHASE_POLL_MS: u64 = 50;

/// Interval between looks at whether a requested video is closed, in milliseconds.
const CLOSED_POLL_MS: f64 = 50.0;

/// An answer of the app.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Reply {
    /// Success with these body lines, each with its end.
    Success(String),
    /// An error with this line of text.
    Error(String),
    /// Success, followed by a file.
    File {
        /// Its path.
        path: PathBuf,
        /// The name to announce.
        name: String,
    },
    /// No answer: the app's process has ended.
    Crash,
    /// No answer: the app was opened again, and has lost the request.
    Forgotten,
}

impl Reply {
    /// The answer as the app writes it, and the file that follows it with its length; `None`
    /// where the connection ends without an answer.
    pub(super) fn written(self, version: &str) -> Option<(String, Option<(PathBuf, u64)>)> {
        match self {
            Self::Success(body) => Some((format!("SUCCESS\n{version}\n{body}end\n"), None)),
            Self::Error(text) => Some((format!("ERROR\n{version}\n{text}\nend\n"), None)),
            Self::File { path, name } => {
                let size = std::fs::metadata(&path).ok()?.len();
                let head = format!("SUCCESS\n{version}\n{size}\n{name}\nend\n");
                Some((head, Some((path, size))))
            }
            Self::Crash | Self::Forgotten => None,
        }
    }
}

/// Progress of a request.
pub(super) enum Progress {
    /// It has been answered.
    Done(Reply),
    /// It continues at a time.
    Waits {
        /// The time.
        until: TrueTime,
        /// The request that continues then.
        request: Request,
    },
}

/// A request that takes some time.
pub(super) enum Request {
    /// The sensors run.
    Sensors(SensorRecording),
    /// A video was started, and its phase is awaited.
    Phase {
        /// Until when.
        deadline: TrueTime,
    },
    /// The last video was requested, and is not closed yet.
    Video {
        /// Number of times that the app had been opened.
        opened: u64,
        /// True if it has waited before.
        waited: bool,
    },
}

/// Report of the app about its frames when a recording has begun.
pub(super) struct Phase {
    /// Timestamp of frame 60.
    pub(super) stamp_ns: i64,
    /// Mean duration of the frames before it.
    pub(super) period_ns: f64,
    /// Exposure of a row.
    pub(super) exposure_ns: u64,
}

/// A recording of the sensors alone.
pub(super) struct SensorRecording {
    request: ImuRequest,
    names: Names,
    from: i64,
    to: i64,
}

/// One recording of the phone, for the ground truth.
#[derive(Clone, Debug)]
pub struct VideoTruth {
    /// Its frames.
    pub frames: FrameTimes,
    /// Number of frames in the video; `None` while it is being recorded.
    pub count: Option<usize>,
    /// Boot clock at the start of the recording.
    pub start_ns: i64,
    /// Boot clock at its end; `None` while it is being recorded.
    pub stop_ns: Option<i64>,
    /// The video's file; it is there once it was rendered.
    pub path: PathBuf,
    /// The file of its frames' timestamps; it is empty until the recording was
    /// saved.
    pub timestamps: PathBuf,
}

/// A recording on the phone.
#[derive(Clone, Debug)]
pub(super) struct Recording {
    pub(super) names: Names,
    pub(super) truth: VideoTruth,
    /// Sensors with a file of their own.
    pub(super) sensors: [bool; 3],
    /// When the recorder was started.
    pub(super) started: TrueTime,
    /// The phase was taken out of its queue.
    pub(super) phase_taken: bool,
}

/// State of the video recorder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Recorder {
    #[default]
    Idle,
    Runs,
    /// Stopped, but the capture session is not closed yet.
    Closes,
}

#[derive(Debug)]
pub(super) struct State {
    /// Recordings in order; the last one may be under way.
    pub(super) recordings: Vec<Recording>,
    /// The first of them since the app was opened.
    since_opened: usize,
    pub(super) recorder: Recorder,
    sensors_busy: bool,
    /// Files being written in the background.
    pub(super) saving: usize,
    /// Error while saving.
    pub(super) trouble: Option<String>,
}

impl State {
    /// The recording under way, the sensors of a closing one included.
    pub(super) fn current(&mut self) -> Option<&mut Recording> {
        match self.recorder {
            Recorder::Idle => None,
            Recorder::Runs | Recorder::Closes => self.recordings.last_mut(),
        }
    }
}

/// The app on the phone.
pub struct App {
    /// The phone's configuration.
    pub config: PhoneConfig,
    pub(super) clock: TrueClock,
    /// The ground truth about the phone's clock.
    pub oscillator: Oscillator,
    pub(super) sensors: Sensors,
    pub(super) light: [FlashLog; 2],
    storage: PathBuf,
    /// Removed with the phone.
    _folder: Option<tempfile::TempDir>,
    state: Mutex<State>,
    pub(super) changed: Condvar,
    pub(super) render: Mutex<()>,
    /// True if the lamp that repeats the depth camera's strobes is in view, in place of the ball.
    lamp: AtomicBool,
    /// Number of times that the app was opened again.
    opened: AtomicU64,
    pub(super) closing: AtomicBool,
    /// Times at which recordings close, where the app has no threads.
    agenda: Mutex<Option<Vec<(TrueTime, usize)>>>,
}

impl App {
    /// The app of a phone that is switched on.
    pub(super) fn new(config: PhoneConfig, surroundings: Surroundings) -> Result<Self> {
        let oscillator = Oscillator::new(config.clock, config.seed.stream(Stream::PhoneClock));
        let (storage, _folder) = match &config.storage {
            Some(path) => {
                std::fs::create_dir_all(path).with_context(|| {
                    format!(
                        "the simulated phone has no folder for its files at {}",
                        path.display()
                    )
                })?;
                (path.clone(), None)
            }
            None => {
                let folder = tempfile::Builder::new()
                    .prefix("simulated-phone-")
                    .tempdir()
                    .context("the simulated phone has no folder for its files")?;
                (folder.path().to_owned(), Some(folder))
            }
        };
        let state = State {
            recordings: Vec::new(),
            since_opened: 0,
            recorder: Recorder::Idle,
            sensors_busy: false,
            saving: 0,
            trouble: None,
        };
        Ok(Self {
            sensors: Sensors::new(&config, oscillator.clone(), surroundings.motion),
            config,
            clock: surroundings.clock,
            oscillator,
            light: surroundings.light,
            storage,
            _folder,
            state: Mutex::new(state),
            changed: Condvar::new(),
            render: Mutex::default(),
            lamp: AtomicBool::new(false),
            opened: AtomicU64::new(0),
            closing: AtomicBool::new(false),
            agenda: Mutex::default(),
        })
    }

    /// Creates an app without threads: pending work is done when it is [caught up](App::catch_up).
    pub(super) fn without_threads(self) -> Self {
        *lock(&self.agenda) = Some(Vec::new());
        self
    }

    /// Closes the capture session of the `number`th recording at a time.
    pub(super) fn close_at(self: &Arc<Self>, at: TrueTime, number: usize) {
        if let Some(agenda) = &mut *lock(&self.agenda) {
            agenda.push((at, number));
            return;
        }
        let app = Arc::clone(self);
        std::thread::spawn(move || {
            // If the rig is stopped before, it is closed all the same.
            let _ = app.wait_until(at);
            app.end_recording(number, at);
        });
    }

    /// Does the work that is due by now, where the app has no threads.
    pub(super) fn catch_up(self: &Arc<Self>) {
        loop {
            let next = lock(&self.agenda).as_mut().and_then(|agenda| {
                let at = |index: &usize| agenda.get(*index).map(|(at, _)| *at);
                let first = (0..agenda.len()).min_by_key(at)?;
                at(&first)
                    .is_some_and(|at| self.has_come(at))
                    .then(|| agenda.swap_remove(first))
            });
            match next {
                Some((at, number)) => self.end_recording(number, at),
                None => return,
            }
        }
    }

    /// Puts the lamp that repeats the depth camera's strobes before the camera, or takes it away: in
    /// videos that are saved from now on.
    pub fn set_lamp(&self, is_on: bool) {
        self.lamp.store(is_on, Ordering::Relaxed);
    }

    /// Returns true if a [`ball`](crate::picture::ball) is in the picture.
    pub(super) fn shows_ball(&self) -> bool {
        self.config.camera.ball && !self.lamp.load(Ordering::Relaxed)
    }

    /// The folder of its files.
    #[must_use]
    pub fn storage(&self) -> &Path {
        &self.storage
    }

    pub(super) fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    /// Ends all waiting.
    pub(super) fn close(&self) {
        self.closing.store(true, Ordering::SeqCst);
        self.clock.wake();
        drop(self.state());
        self.changed.notify_all();
    }

    pub(super) fn wait_until(&self, at: TrueTime) -> Result<(), RigStopped> {
        self.clock.wait_unless(at, &self.closing)
    }

    /// Returns the true time `ms` milliseconds from now.
    pub(super) fn in_ms(&self, ms: f64) -> TrueTime {
        let units = (ms.max(0.0) * (UNITS_PER_SECOND / 1000) as f64) as u64;
        TrueTime::from_units(self.clock.now().units().saturating_add(units))
    }

    /// Returns true if true time has reached `at`.
    pub(super) fn has_come(&self, at: TrueTime) -> bool {
        self.clock.now() >= at
    }

    /// Returns the boot clock now.
    pub(super) fn now_ns(&self) -> i64 {
        self.oscillator.nanos_at(self.clock.now())
    }

    /// Answers one line of a client; lasts as long as the app would take.
    pub(super) fn handle(self: &Arc<Self>, line: &str) -> Result<Reply, RigStopped> {
        let mut progress = self.begin(line);
        loop {
            match progress {
                Progress::Done(reply) => return Ok(reply),
                Progress::Waits { until, request } => {
                    self.wait_until(until)?;
                    if self.closing.load(Ordering::SeqCst) || self.clock.is_stopped() {
                        return Err(RigStopped);
                    }
                    progress = self.go_on(request);
                }
            }
        }
    }

    /// Takes one line of a client.
    pub(super) fn begin(self: &Arc<Self>, line: &str) -> Progress {
        if let Some(request) = ImuRequest::find(line) {
            return self.imu(request);
        }
        match line {
            "video_start" => self.video_start(),
            "video_stop" => {
                // Answered at once; it ends later (RRH:184).
                self.stop_recording(self.config.app.stop_ms);
                Progress::Done(Reply::Success(String::new()))
            }
            "get_video" => {
                let opened = self.opened.load(Ordering::SeqCst);
                self.get_video(opened, false)
            }
            _ => Progress::Done(Reply::Error("Invalid request".to_owned())),
        }
    }

    /// Continues a request whose time has come.
    pub(super) fn go_on(&self, request: Request) -> Progress {
        match request {
            Request::Sensors(recording) => Progress::Done(self.end_sensors(recording)),
            Request::Phase { deadline } => self.look_for_phase(deadline),
            Request::Video { opened, waited } => self.get_video(opened, waited),
        }
    }

    fn imu(&self, request: ImuRequest) -> Progress {
        let Some(duration_ms) = request.duration_ms else {
            return Progress::Done(Reply::Crash);
        };
        {
            let mut state = self.state();
            // The sensors of a video run until its session is closed (EAI:237). Without
            // its sync recording the app does not know of them (EAI:183).
            let of_video = state.recorder != Recorder::Idle && self.config.camera.reports_frames;
            if of_video || state.sensors_busy {
                return Progress::Done(Reply::Error("Error in IMU recording".to_owned()));
            }
            state.sensors_busy = true;
        }
        let mut names = self.names();
        let from = self.now_ns();
        let to = from.saturating_add(duration_ms.saturating_mul(1_000_000));
        for kind in Kind::ALL {
            // A file that cannot be made is left out, as one that is not ticked is
            // (`RawSensorInfo.java`:229). A sensor that the phone lacks has one.
            if kind.one_of(self.config.app.ticked) {
                let _ = names.make_sensor(kind);
            }
        }
        let until = match to {
            // `Thread.sleep` of 292 million years.
            i64::MAX => TrueTime::from_units(u64::MAX),
            _ => self.oscillator.when_nanos(to).unwrap_or(TrueTime::ZERO),
        };
        let request = Request::Sensors(SensorRecording {
            request,
            names,
            from,
            to,
        });
        Progress::Waits { until, request }
    }

    fn end_sensors(&self, recording: SensorRecording) -> Reply {
        let SensorRecording {
            request,
            names,
            from,
            to,
        } = recording;
        self.state().sensors_busy = false;
        let mut body = String::new();
        for kind in Kind::ALL {
            let Some(path) = names.sensor(kind).filter(|_| request.wants(kind)) else {
                continue;
            };
            let samples = self.sensors.samples(kind, from, to);
            if names.save_sensor(kind, &samples).is_err() {
                return Reply::Error("Failed to open IMU file".to_owned());
            }
            body.push_str(&name_of(path));
            body.push('\n');
            for sample in &samples {
                body.push_str(&csv_line(sample));
                body.push('\n');
            }
            body.push_str("sensor_end\n");
        }
        Reply::Success(body)
    }

    /// The names of a recording that begins now.
    pub(super) fn names(&self) -> Names {
        Names::new(&self.storage, self.config.app.storage, self.seconds())
    }

    fn video_start(self: &Arc<Self>) -> Progress {
        let deadline = self.in_ms(PHASE_TIMEOUT_MS as f64);
        // The press is posted and not awaited (RRH:157): a phase that is in the queue
        // already is taken for the answer (RRH:164), whatever the press does then.
        let phase = self.take_phase(deadline);
        self.press_record();
        match phase {
            Some(phase) => Progress::Done(self.phase_reply(&phase)),
            None => self.wait_for_phase(deadline),
        }
    }

    fn wait_for_phase(&self, deadline: TrueTime) -> Progress {
        Progress::Waits {
            until: self.in_ms(PHASE_POLL_MS as f64).min(deadline),
            request: Request::Phase { deadline },
        }
    }

    fn look_for_phase(&self, deadline: TrueTime) -> Progress {
        match self.take_phase(deadline) {
            Some(phase) => Progress::Done(self.phase_reply(&phase)),
            None if self.has_come(deadline) => {
                let text = "Failed to retrieve phase info, reached poll limit";
                Progress::Done(Reply::Error(text.to_owned()))
            }
            None => self.wait_for_phase(deadline),
        }
    }

    fn phase_reply(&self, phase: &Phase) -> Reply {
        let mut body = format!("{}\n{}\n", phase.stamp_ns, java::double(phase.period_ns));
        if self.config.version != "v.0.1" {
            body.push_str(&format!("{}\n", phase.exposure_ns));
        }
        Reply::Success(body)
    }

    /// The process ends, as by a crash or by hand, and the app is as if just opened.
    /// A video that runs ends with it.
    pub(super) fn reopen(self: &Arc<Self>) {
        self.opened.fetch_add(1, Ordering::SeqCst);
        self.stop_recording(0.0);
        let mut state = self.state();
        state.recorder = Recorder::Idle;
        state.since_opened = state.recordings.len();
        drop(state);
        self.changed.notify_all();
    }

    fn get_video(&self, opened: u64, waited: bool) -> Progress {
        if self.opened.load(Ordering::SeqCst) != opened {
            return Progress::Done(Reply::Forgotten);
        }
        let last = {
            let state = self.state();
            // While a video is recorded, or its session closes, the app waits for its
            // file (RRH:203), and no other client is served. Of a file in storage
            // access, nobody ever says that it is there (`Preview.java`:1072).
            let unheard = waited && self.config.app.storage != StorageAccess::Files;
            if state.recorder != Recorder::Idle || unheard {
                return Progress::Waits {
                    until: self.in_ms(CLOSED_POLL_MS),
                    request: Request::Video {
                        opened,
                        waited: true,
                    },
                };
            }
            let made = state.recordings.get(state.since_opened..);
            made.and_then(<[Recording]>::last).cloned()
        };
        Progress::Done(self.video_reply(last))
    }

    fn video_reply(&self, last: Option<Recording>) -> Reply {
        // Without a video since it was opened, the app asks nothing for its name
        // (RRH:208).
        let Some(recording) = last else {
            return Reply::Crash;
        };
        // A video without frames is deleted by the app itself.
        let empty = recording.truth.count.unwrap_or(0) == 0;
        if empty || self.config.video == VideoMode::Never {
            return Reply::Error("Couldn't get last video file data".to_owned());
        }
        if let Err(trouble) = self.render(&recording) {
            self.state().trouble = Some(trouble);
            return Reply::Error("Error getting video file".to_owned());
        }
        let path = recording.names.video();
        let name = match &self.config.video_name {
            Some(name) => name.clone(),
            None => name_of(&path),
        };
        Reply::File { path, name }
    }

    /// Waits until the files of stopped recordings are saved.
    ///
    /// # Errors
    ///
    /// Error while saving.
    pub fn wait_saved(&self) -> Result<(), String> {
        let mut state = self.state();
        while state.saving > 0 {
            state = self
                .changed
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
        state.trouble.clone().map_or(Ok(()), Err)
    }

    /// Does the same without waiting; `None` while some are being saved, which takes virtual time.
    #[must_use]
    pub fn saved(&self) -> Option<Result<(), String>> {
        let state = self.state();
        let trouble = state.trouble.clone();
        (state.saving == 0).then(|| trouble.map_or(Ok(()), Err))
    }

    /// True if it records a video.
    #[must_use]
    pub fn is_recording(&self) -> bool {
        self.state().recorder == Recorder::Runs
    }

    /// The ground truth about its videos so far, in order.
    #[must_use]
    pub fn videos(&self) -> Vec<VideoTruth> {
        let state = self.state();
        state.recordings.iter().map(|r| r.truth.clone()).collect()
    }

    /// Whole seconds since power-on.
    fn seconds(&self) -> u64 {
        self.clock.now().units() / UNITS_PER_SECOND
    }
}
