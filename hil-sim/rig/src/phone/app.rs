//! What the app does when it is asked: its four requests, without a socket.

use std::panic::AssertUnwindSafe;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use super::camera::{FrameTimes, PHASE_FRAME, write_video};
use super::config::{PhoneConfig, VideoMode};
use super::files::{Names, csv_line};
use super::java;
use super::sensors::{Kind, Sensors};
use crate::flash_log::FlashSource;
use crate::oscillator::{Oscillator, TrueTime};
use crate::true_clock::{RigStopped, TrueClock};
use stm32f4_sim::time::UNITS_PER_SECOND;

/// How long the app waits for the phase of a video, in milliseconds.
const PHASE_TIMEOUT_MS: u64 = 10_000;

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
}

/// One recording of the phone, for the truth.
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
    /// The file of its frames' timestamps; it is there once the recording was
    /// saved.
    pub timestamps: PathBuf,
}

/// A recording on the phone.
#[derive(Clone, Debug)]
struct Recording {
    names: Names,
    truth: VideoTruth,
}

#[derive(Debug, Default)]
struct State {
    /// Recordings in order; the last one may be under way.
    recordings: Vec<Recording>,
    recording: bool,
    sensors_busy: bool,
    /// Files being written in the background.
    saving: usize,
    /// What went wrong while saving.
    trouble: Option<String>,
}

/// The app on the phone.
pub(super) struct App {
    pub(super) config: PhoneConfig,
    clock: TrueClock,
    oscillator: Oscillator,
    sensors: Sensors,
    light: Arc<dyn FlashSource>,
    storage: PathBuf,
    state: Mutex<State>,
    changed: Condvar,
    render: Mutex<()>,
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
        Self {
            config,
            clock,
            oscillator,
            sensors,
            light,
            storage,
            state: Mutex::default(),
            changed: Condvar::new(),
            render: Mutex::default(),
            closing: AtomicBool::new(false),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends all waiting.
    pub(super) fn close(&self) {
        self.closing.store(true, Ordering::SeqCst);
        self.clock.wake();
        drop(self.state());
        self.changed.notify_all();
    }

    fn wait_until(&self, at: TrueTime) -> Result<(), RigStopped> {
        self.clock.wait_unless(at, &self.closing)
    }

    fn wait_until_ns(&self, ns: i64) -> Result<(), RigStopped> {
        let at = self.oscillator.when_nanos(ns);
        self.wait_until(at.unwrap_or(TrueTime::ZERO))
    }

    /// The boot clock now.
    fn now_ns(&self) -> i64 {
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
                self.stop_recording();
                Ok(Reply::Success(String::new()))
            }
            "get_video" => self.get_video(),
            _ => Ok(Reply::Error("Invalid request".to_owned())),
        }
    }

    fn imu(&self, request: &ImuRequest) -> Result<Reply, RigStopped> {
        let busy = Reply::Error("Error in IMU recording".to_owned());
        {
            let mut state = self.state();
            if state.recording || state.sensors_busy {
                return Ok(busy);
            }
            state.sensors_busy = true;
        }
        let recorded = self.record_sensors(request);
        self.state().sensors_busy = false;
        recorded
    }

    fn record_sensors(&self, request: &ImuRequest) -> Result<Reply, RigStopped> {
        let names = Names::free(&self.storage, self.seconds());
        let from = self.now_ns();
        let length = i64::try_from(request.duration_ms.saturating_mul(1_000_000));
        let to = from.saturating_add(length.unwrap_or(i64::MAX));
        self.wait_until_ns(to)?;
        let mut body = String::new();
        for kind in Kind::ALL {
            // A sensor that the phone lacks leaves no file.
            if !request.wants(kind) || !self.sensors.has(kind) {
                continue;
            }
            let samples = self.sensors.samples(kind, from, to);
            if let Err(error) = names.save_sensor(kind, &samples) {
                return Ok(Reply::Error(format!("Failed to open IMU file: {error}")));
            }
            body.push_str(&names.sensor_name(kind));
            body.push('\n');
            for sample in &samples {
                body.push_str(&csv_line(sample));
                body.push('\n');
            }
            body.push_str("sensor_end\n");
        }
        Ok(Reply::Success(body))
    }

    fn video_start(self: &Arc<Self>) -> Result<Reply, RigStopped> {
        let asked = self.clock.now();
        // The request presses the record button, and that toggles.
        let started = self.press_record();
        let camera = &self.config.camera;
        match started {
            Some(frames) if camera.reports_frames => {
                let pipeline = (camera.pipeline_ms * 1e6).max(0.0) as i64;
                self.wait_until_ns(frames.end_ns(PHASE_FRAME).saturating_add(pipeline))?;
                let (phase, duration) = frames.phase();
                let mut body = format!("{phase}\n{}\n", java::double(duration));
                if self.config.version != "v.0.1" {
                    let known = if camera.reports_exposure {
                        camera.exposure_ns
                    } else {
                        0
                    };
                    body.push_str(&format!("{known}\n"));
                }
                Ok(Reply::Success(body))
            }
            _ => {
                let timeout = PHASE_TIMEOUT_MS * (UNITS_PER_SECOND / 1000);
                let until = asked.units().saturating_add(timeout);
                self.wait_until(TrueTime::from_units(until))?;
                let text = "Failed to retrieve phase info, reached poll limit";
                Ok(Reply::Error(text.to_owned()))
            }
        }
    }

    /// The record button: starts a recording, or stops the one that runs.
    /// Returns the frames of a started one.
    pub(super) fn press_record(self: &Arc<Self>) -> Option<FrameTimes> {
        {
            let mut state = self.state();
            if !state.recording {
                let names = Names::free(&self.storage, self.seconds());
                let start_ns = self.now_ns();
                let number = u32::try_from(state.recordings.len()).unwrap_or(u32::MAX);
                let frames = FrameTimes::new(&self.config, number, start_ns);
                let (path, timestamps) = (names.video(), names.timestamps());
                state.recordings.push(Recording {
                    names,
                    truth: VideoTruth {
                        frames: frames.clone(),
                        count: None,
                        start_ns,
                        stop_ns: None,
                        path,
                        timestamps,
                    },
                });
                state.recording = true;
                return Some(frames);
            }
        }
        self.stop_recording();
        None
    }

    /// Stops the recording, if any, and saves its files in the background.
    fn stop_recording(self: &Arc<Self>) {
        let mut state = self.state();
        if !state.recording {
            return;
        }
        state.recording = false;
        let stop_ns = self.now_ns();
        let Some(recording) = state.recordings.last_mut() else {
            return;
        };
        recording.truth.count = Some(recording.truth.frames.complete_at(stop_ns));
        recording.truth.stop_ns = Some(stop_ns);
        let recording = recording.clone();
        state.saving += 1;
        drop(state);
        self.changed.notify_all();
        let app = Arc::clone(self);
        std::thread::spawn(move || {
            // A panic while saving must not leave others waiting for its end.
            let saved = std::panic::catch_unwind(AssertUnwindSafe(|| app.save(&recording)));
            let saved = saved.unwrap_or_else(|_| Err("saving failed, see the panic".to_owned()));
            let mut state = app.state();
            state.saving -= 1;
            if let Err(trouble) = saved {
                state.trouble = Some(trouble);
            }
            drop(state);
            app.changed.notify_all();
        });
    }

    /// Writes what the app writes beside a video, and the video if it is to be
    /// there by itself.
    fn save(&self, recording: &Recording) -> Result<(), String> {
        let truth = &recording.truth;
        let (from, to) = (truth.start_ns, truth.stop_ns.unwrap_or(truth.start_ns));
        let names = &recording.names;
        let files = || -> std::io::Result<()> {
            for kind in [Kind::Gyroscope, Kind::Accelerometer] {
                names.save_sensor(kind, &self.sensors.samples(kind, from, to))?;
            }
            names.save_timestamps(&truth.frames.stamps(truth.count.unwrap_or(0)))
        };
        files().map_err(|e| format!("cannot save the recording's files: {e}"))?;
        if self.config.video == VideoMode::OnStop {
            self.render(recording)?;
        }
        Ok(())
    }

    /// Makes the video's file unless it is there.
    fn render(&self, recording: &Recording) -> Result<(), String> {
        let _one_at_a_time = self.render.lock().unwrap_or_else(PoisonError::into_inner);
        let path = recording.names.video();
        if path.exists() {
            return Ok(());
        }
        // Encoded beside it first, so that nobody finds half a video.
        let part = path.with_extension("part.mp4");
        let truth = &recording.truth;
        let count = truth.count.unwrap_or(0);
        if count == 0 {
            return Err("the recording has no frames".to_owned());
        }
        write_video(
            &part,
            &self.config,
            &truth.frames,
            count,
            &self.oscillator,
            &*self.light,
        )
        .map_err(|e| e.to_string())?;
        std::fs::rename(&part, &path).map_err(|e| format!("cannot save {}: {e}", path.display()))
    }

    fn get_video(&self) -> Result<Reply, RigStopped> {
        // While a video is recorded, the app waits for its file: until someone
        // stops it at the phone itself, since no other client is served.
        let last = {
            let mut state = self.state();
            while state.recording {
                if self.closing.load(Ordering::SeqCst) || self.clock.is_stopped() {
                    return Err(RigStopped);
                }
                state = self
                    .changed
                    .wait_timeout(state, std::time::Duration::from_millis(50))
                    .unwrap_or_else(PoisonError::into_inner)
                    .0;
            }
            state.recordings.last().cloned()
        };
        let Some(recording) = last.filter(|_| self.config.video != VideoMode::Never) else {
            return Ok(Reply::Error("Couldn't get last video file data".to_owned()));
        };
        if let Err(trouble) = self.render(&recording) {
            // One line: that is all that an error's body has.
            let trouble = trouble.replace(['\n', '\r'], " ");
            return Ok(Reply::Error(format!("Error getting video file: {trouble}")));
        }
        let name = match &self.config.video_name {
            Some(name) => name.clone(),
            None => recording.names.video_name(),
        };
        Ok(Reply::File {
            path: recording.names.video(),
            name,
        })
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
        self.state().recording
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

/// An IMU request as the app finds it in a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ImuRequest {
    duration_ms: u64,
    wants: [bool; 3],
}

impl ImuRequest {
    /// Looks for the request anywhere in the line, as the app does.
    fn find(line: &str) -> Option<Self> {
        line.match_indices("imu?duration=")
            .find_map(|(at, found)| Self::read(line.get(at + found.len()..)?))
    }

    fn read(rest: &str) -> Option<Self> {
        let digits = rest.find(|c: char| !c.is_ascii_digit())?;
        let duration_ms = rest.get(..digits)?.parse().ok()?;
        let mut rest = rest.get(digits..)?;
        let mut wants = [false; 3];
        for (name, wants) in ["&accel=", "&gyro=", "&magnetic="].iter().zip(&mut wants) {
            rest = rest.strip_prefix(name)?;
            let digit = rest.chars().next().filter(char::is_ascii_digit)?;
            *wants = digit == '1';
            rest = rest.get(1..)?;
        }
        Some(Self { duration_ms, wants })
    }

    fn wants(&self, kind: Kind) -> bool {
        let [accelerometer, gyroscope, magnetometer] = self.wants;
        match kind {
            Kind::Accelerometer => accelerometer,
            Kind::Gyroscope => gyroscope,
            Kind::Magnetometer => magnetometer,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_imu_requests() {
        let found = ImuRequest::find("imu?duration=1000&accel=0&gyro=1&magnetic=0");
        assert_eq!(
            found,
            Some(ImuRequest {
                duration_ms: 1000,
                wants: [false, true, false]
            })
        );
        // Found anywhere, as a regular expression does.
        let within = "GET /imu?duration=5&accel=1&gyro=1&magnetic=1&gravity=0 HTTP/1.1";
        assert_eq!(ImuRequest::find(within).map(|r| r.duration_ms), Some(5));
        for line in [
            "",
            "imu",
            "imu?duration=&accel=0&gyro=1&magnetic=0",
            "imu?duration=-1&accel=0&gyro=1&magnetic=0",
            "imu?duration=1000&accel=0&gyro=1",
            "imu?duration=99999999999999999999&accel=0&gyro=1&magnetic=0",
            "imu?duration=1000",
        ] {
            assert_eq!(ImuRequest::find(line), None, "{line}");
        }
    }
}
