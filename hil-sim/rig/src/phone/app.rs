//! What the app does when it is asked: its four requests, without a socket.
//!
//! The lines that it follows are of the app's source: RRH is
//! `RemoteRpcRequestHandler.java`, EAI `ExtendedAppInterface.java`.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use super::camera::FrameTimes;
use super::config::{PhoneConfig, StorageAccess, VideoMode};
use super::files::{Names, csv_line, name_of};
use super::java;
use super::request::ImuRequest;
use super::sensors::{Kind, Sensors};
use crate::flash_log::FlashSource;
use crate::oscillator::{Oscillator, TrueTime};
use crate::true_clock::{RigStopped, TrueClock};
use stm32f4_sim::shared::lock;
use stm32f4_sim::time::UNITS_PER_SECOND;

/// How long the app waits for the phase of a video, in milliseconds (RRH:34).
const PHASE_TIMEOUT_MS: u64 = 10_000;

/// How often the phase is looked for, in milliseconds.
const PHASE_POLL_MS: u64 = 50;

/// An answer of the app.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Reply {
    /// Success with these body lines, each with its end.
    Success(String),
    /// An error with this line of text.
    Error(String),
    /// Success, followed by a file.
    File {
        /// Where it is.
        path: PathBuf,
        /// The name to announce.
        name: String,
    },
    /// None: the app's process has ended.
    Crash,
}

/// One recording of the phone, for the truth.
#[derive(Clone, Debug)]
pub struct VideoTruth {
    /// It was begun by hand, not by a request.
    pub by_hand: bool,
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

/// What the video recorder does.
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
    /// Sensors that are ticked in the settings.
    pub(super) ticked: [bool; 3],
    /// When the app went to the background; none in the foreground.
    pub(super) background: Option<TrueTime>,
    /// Files being written in the background.
    pub(super) saving: usize,
    /// What went wrong while saving.
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
pub(super) struct App {
    pub(super) config: PhoneConfig,
    pub(super) clock: TrueClock,
    pub(super) oscillator: Oscillator,
    pub(super) sensors: Sensors,
    pub(super) light: Arc<dyn FlashSource>,
    storage: PathBuf,
    state: Mutex<State>,
    pub(super) changed: Condvar,
    pub(super) render: Mutex<()>,
    /// How often the app was opened anew.
    opened: AtomicU64,
    pub(super) closing: AtomicBool,
}

impl App {
    pub(super) fn new(
        config: PhoneConfig,
        clock: TrueClock,
        oscillator: Oscillator,
        sensors: Sensors,
        light: Arc<dyn FlashSource>,
        storage: PathBuf,
    ) -> Self {
        let state = State {
            recordings: Vec::new(),
            since_opened: 0,
            recorder: Recorder::Idle,
            sensors_busy: false,
            ticked: config.app.ticked,
            background: None,
            saving: 0,
            trouble: None,
        };
        Self {
            config,
            clock,
            oscillator,
            sensors,
            light,
            storage,
            state: Mutex::new(state),
            changed: Condvar::new(),
            render: Mutex::default(),
            opened: AtomicU64::new(0),
            closing: AtomicBool::new(false),
        }
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

    /// True time in so many milliseconds from now.
    pub(super) fn in_ms(&self, ms: f64) -> TrueTime {
        let units = (ms.max(0.0) * (UNITS_PER_SECOND / 1000) as f64) as u64;
        TrueTime::from_units(self.clock.now().units().saturating_add(units))
    }

    /// Whether true time has come to `at`.
    pub(super) fn has_come(&self, at: TrueTime) -> bool {
        self.clock.now() >= at
    }

    /// The boot clock now.
    pub(super) fn now_ns(&self) -> i64 {
        self.oscillator.nanos_at(self.clock.now())
    }

    /// Answers one line of a client; lasts as long as the app would take.
    pub(super) fn handle(self: &Arc<Self>, line: &str) -> Result<Reply, RigStopped> {
        if let Some(request) = ImuRequest::find(line) {
            return self.imu(&request);
        }
        match line {
            "video_start" => self.video_start(),
            "video_stop" => {
                // Answered at once; it ends later (RRH:184).
                self.stop_recording(self.config.app.stop_ms);
                Ok(Reply::Success(String::new()))
            }
            "get_video" => self.get_video(),
            _ => Ok(Reply::Error("Invalid request".to_owned())),
        }
    }

    fn imu(&self, request: &ImuRequest) -> Result<Reply, RigStopped> {
        let Some(duration_ms) = request.duration_ms else {
            return Ok(Reply::Crash);
        };
        let ticked = {
            let mut state = self.state();
            // The sensors of a video run until its session is closed (EAI:237). Without
            // its sync recording the app does not know of them (EAI:183).
            let of_video = state.recorder != Recorder::Idle && self.config.camera.reports_frames;
            if of_video || state.sensors_busy {
                return Ok(Reply::Error("Error in IMU recording".to_owned()));
            }
            if self.config.app.imu_rewrites_ticks {
                state.ticked = request.wants;
            }
            state.sensors_busy = true;
            state.ticked
        };
        let recorded = self.record_sensors(request, duration_ms, ticked);
        self.state().sensors_busy = false;
        recorded
    }

    fn record_sensors(
        &self,
        request: &ImuRequest,
        duration_ms: i64,
        ticked: [bool; 3],
    ) -> Result<Reply, RigStopped> {
        let mut names = self.names();
        let from = self.now_ns();
        let to = from.saturating_add(duration_ms.saturating_mul(1_000_000));
        for kind in Kind::ALL {
            // A file that cannot be made is left out, as one that is not ticked is
            // (`RawSensorInfo.java`:229). A sensor that the phone lacks has one.
            if kind.one_of(ticked) {
                let _ = names.make_sensor(kind);
            }
        }
        let end = match to {
            // `Thread.sleep` of 292 million years.
            i64::MAX => TrueTime::from_units(u64::MAX),
            _ => self.oscillator.when_nanos(to).unwrap_or(TrueTime::ZERO),
        };
        self.wait_until(end)?;
        let to = self.heard_until(to);
        let mut body = String::new();
        for kind in Kind::ALL {
            let Some(path) = names.sensor(kind).filter(|_| request.wants(kind)) else {
                continue;
            };
            let samples = self.sensors.samples(kind, from, to);
            if names.save_sensor(kind, &samples).is_err() {
                return Ok(Reply::Error("Failed to open IMU file".to_owned()));
            }
            body.push_str(&name_of(path));
            body.push('\n');
            for sample in &samples {
                body.push_str(&csv_line(sample));
                body.push('\n');
            }
            body.push_str("sensor_end\n");
        }
        Ok(Reply::Success(body))
    }

    /// Until when sensors are heard that run until `to`: in the background not for long.
    fn heard_until(&self, to: i64) -> i64 {
        let background = self.state().background;
        background.map_or(to, |since| {
            let more = self.config.app.background_ms * 1e6;
            let end = self.oscillator.nanos_at(since).saturating_add(more as i64);
            to.min(end)
        })
    }

    /// The names of a recording that begins now.
    pub(super) fn names(&self) -> Names {
        Names::new(&self.storage, self.config.app.storage, self.seconds())
    }

    fn video_start(self: &Arc<Self>) -> Result<Reply, RigStopped> {
        let deadline = self.in_ms(PHASE_TIMEOUT_MS as f64);
        // The press is posted and not awaited (RRH:157): a phase that is in the queue
        // already is taken for the answer (RRH:164), whatever the press does then.
        let mut phase = self.take_phase(deadline);
        self.press_record(false);
        while phase.is_none() && !self.has_come(deadline) {
            self.wait_until(self.in_ms(PHASE_POLL_MS as f64).min(deadline))?;
            phase = self.take_phase(deadline);
        }
        let Some(phase) = phase else {
            let text = "Failed to retrieve phase info, reached poll limit";
            return Ok(Reply::Error(text.to_owned()));
        };
        let camera = &self.config.camera;
        let mut body = format!("{}\n{}\n", phase.stamp_ns, java::double(phase.period_ns));
        if self.config.version != "v.0.1" {
            let known = if camera.reports_exposure {
                phase.exposure_ns
            } else {
                0
            };
            body.push_str(&format!("{known}\n"));
        }
        Ok(Reply::Success(body))
    }

    /// The app leaves the foreground: it goes on for a moment, then ends recordings.
    pub(super) fn to_background(self: &Arc<Self>) {
        self.state().background = Some(self.clock.now());
        let end = self.in_ms(self.config.app.background_ms);
        let app = Arc::clone(self);
        std::thread::spawn(move || {
            if app.wait_until(end).is_ok() && app.state().background.is_some() {
                app.stop_recording(0.0);
            }
        });
    }

    /// The app comes back to the foreground.
    pub(super) fn to_foreground(&self) {
        self.state().background = None;
    }

    /// The process ends, as by a crash or by hand, and the app is as if just opened.
    /// A video that runs ends with it.
    pub(super) fn open_anew(self: &Arc<Self>) {
        self.opened.fetch_add(1, Ordering::SeqCst);
        self.stop_recording(0.0);
        let mut state = self.state();
        state.recorder = Recorder::Idle;
        state.since_opened = state.recordings.len();
        state.background = None;
        drop(state);
        self.changed.notify_all();
    }

    fn get_video(&self) -> Result<Reply, RigStopped> {
        let opened = self.opened.load(Ordering::SeqCst);
        let last = {
            let mut state = self.state();
            // While a video is recorded, or its session closes, the app waits for its
            // file (RRH:203), and no other client is served. Of a file in storage
            // access, nobody ever says that it is there (`Preview.java`:1072).
            let mut heard = true;
            while state.recorder != Recorder::Idle || !heard {
                heard = self.config.app.storage == StorageAccess::Files;
                let anew = self.opened.load(Ordering::SeqCst) != opened;
                if anew || self.closing.load(Ordering::SeqCst) || self.clock.is_stopped() {
                    return Err(RigStopped);
                }
                state = self
                    .changed
                    .wait_timeout(state, std::time::Duration::from_millis(50))
                    .unwrap_or_else(PoisonError::into_inner)
                    .0;
            }
            let made = state.recordings.get(state.since_opened..);
            made.and_then(<[Recording]>::last).cloned()
        };
        // Without a video since it was opened, the app asks nothing for its name
        // (RRH:208).
        let Some(recording) = last else {
            return Ok(Reply::Crash);
        };
        // A video without frames is deleted by the app itself.
        let empty = recording.truth.count.unwrap_or(0) == 0;
        if empty || self.config.video == VideoMode::Never {
            return Ok(Reply::Error("Couldn't get last video file data".to_owned()));
        }
        if let Err(trouble) = self.render(&recording) {
            self.state().trouble = Some(trouble);
            return Ok(Reply::Error("Error getting video file".to_owned()));
        }
        let path = recording.names.video();
        let name = match &self.config.video_name {
            Some(name) => name.clone(),
            None => name_of(&path),
        };
        Ok(Reply::File { path, name })
    }

    /// Waits until all that was stopped is saved.
    pub(super) fn wait_saved(&self) -> Result<(), String> {
        let mut state = self.state();
        while state.saving > 0 {
            state = self
                .changed
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
        match &state.trouble {
            Some(trouble) => Err(trouble.clone()),
            None => Ok(()),
        }
    }

    pub(super) fn is_recording(&self) -> bool {
        self.state().recorder == Recorder::Runs
    }

    pub(super) fn videos(&self) -> Vec<VideoTruth> {
        let state = self.state();
        state.recordings.iter().map(|r| r.truth.clone()).collect()
    }

    /// Whole seconds since power-on.
    fn seconds(&self) -> u64 {
        self.clock.now().units() / UNITS_PER_SECOND
    }
}
