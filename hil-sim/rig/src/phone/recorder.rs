//! The video recorder of the app: its button, its capture session, its files.

use std::panic::AssertUnwindSafe;
use std::path::PathBuf;
use std::sync::Arc;

use super::app::{App, Phase, Recorder, Recording, State, VideoTruth};
use super::camera::{FrameTimes, write_video};
use super::config::VideoMode;
use super::sensors::Kind;
use crate::clocks::oscillator::TrueTime;
use stm32f4_sim::shared::lock;
use stm32f4_sim::time::UNITS_PER_SECOND;

/// A press of the record button so soon after a start is ignored, in milliseconds
/// (`Preview.java`:5020).
const PRESS_IGNORED_MS: u64 = 500;

/// From the end of a frame's readout to the app that handles it, nanoseconds.
const PIPELINE_NS: i64 = 40_000_000;

impl App {
    /// The phase in the app's queue, by the `deadline` at the latest, however late this thread
    /// is. Frame 60 puts it there while the recorder runs; the begin and the end of a recording
    /// empty it (`VideoFrameInfo.java`:87, 145, 222).
    pub(super) fn take_phase(&self, deadline: TrueTime) -> Option<Phase> {
        let camera = &self.config.camera;
        let now = self.oscillator.nanos_at(self.clock.now().min(deadline));
        let mut state = self.state();
        let recording = state.current().filter(|r| !r.phase_taken)?;
        let frames = &recording.truth.frames;
        let queued = frames
            .end_ns(frames.phase_frame())
            .saturating_add(PIPELINE_NS);
        let until = recording.truth.stop_ns.unwrap_or(now);
        if !camera.reports_frames || queued > until.min(now) {
            return None;
        }
        let (stamp_ns, period_ns) = frames.phase();
        let stamp_ns = stamp_ns - self.config.frames_behind_ns();
        let exposure_ns = frames.exposure_ns();
        recording.phase_taken = true;
        Some(Phase {
            stamp_ns,
            period_ns,
            exposure_ns,
        })
    }

    /// The record button on the phone itself: starts a recording, or stops the one that runs.
    /// Too soon after a start, and while one still closes, it does nothing.
    pub fn press_record(self: &Arc<Self>) {
        let since = {
            let mut state = self.state();
            match state.recorder {
                Recorder::Idle => return self.start_recording(&mut state),
                Recorder::Closes => return,
                Recorder::Runs => state.current().map(|recording| recording.started),
            }
        };
        let ignored = PRESS_IGNORED_MS * (UNITS_PER_SECOND / 1000);
        let until = since.map_or(0, |since| since.units().saturating_add(ignored));
        if self.has_come(TrueTime::from_units(until)) {
            self.stop_recording(self.config.app.stop_ms);
        }
    }

    fn start_recording(&self, state: &mut State) {
        let start_ns = self.now_ns();
        let number = u32::try_from(state.recordings.len()).unwrap_or(u32::MAX);
        let frames = FrameTimes::new(&self.config, number, start_ns);
        let taken: Vec<PathBuf> = state.recordings.iter().map(|r| r.names.video()).collect();
        let mut names = self.names();
        let made = names.make_video(&taken);
        // All that are ticked, the magnetometer too (EAI:187).
        let app = &self.config.app;
        let sensors = app
            .ticked
            .map(|ticked| ticked && self.config.camera.reports_frames);
        let made = Kind::ALL
            .into_iter()
            .filter(|kind| kind.one_of(sensors))
            .fold(made, |made, kind| made.and(names.make_sensor(kind)));
        if let Err(error) = made {
            state.trouble = Some(format!("cannot make the recording's files: {error}"));
        }
        let (path, timestamps) = (names.video(), names.timestamps());
        state.recordings.push(Recording {
            names,
            truth: VideoTruth {
                frames,
                count: None,
                start_ns,
                stop_ns: None,
                path,
                timestamps,
            },
            sensors,
            started: self.clock.now(),
            phase_taken: false,
        });
        state.recorder = Recorder::Runs;
    }

    /// Stops the recording, if any. It ends when the capture session is closed, `close_ms`
    /// later, and its files are saved after that.
    pub(super) fn stop_recording(self: &Arc<Self>, close_ms: f64) {
        let mut state = self.state();
        if state.recorder != Recorder::Runs {
            return;
        }
        state.recorder = Recorder::Closes;
        let stop_ns = self.now_ns();
        if let Some(recording) = state.recordings.last_mut() {
            recording.truth.count = Some(recording.truth.frames.complete_at(stop_ns));
            recording.truth.stop_ns = Some(stop_ns);
        }
        state.saving += 1;
        let number = state.recordings.len();
        drop(state);
        let closed = self.in_ms(close_ms);
        if self.has_come(closed) {
            self.close_session(number);
        }
        self.close_at(closed, number);
    }

    /// The `number`th recording ends at a time, and is saved.
    pub(super) fn end_recording(&self, number: usize, at: TrueTime) {
        self.close_session(number);
        // A panic while saving must not leave others waiting for its end.
        let until = self.oscillator.nanos_at(at);
        let saved = std::panic::catch_unwind(AssertUnwindSafe(|| self.save(number, until)));
        let saved = saved.unwrap_or_else(|_| Err("saving failed, see the panic".to_owned()));
        let mut state = self.state();
        state.saving -= 1;
        if let Err(trouble) = saved {
            state.trouble = Some(trouble);
        }
        drop(state);
        self.changed.notify_all();
    }

    /// The capture session of the `number`th recording is closed: nothing runs.
    fn close_session(&self, number: usize) {
        let mut state = self.state();
        if state.recorder == Recorder::Closes && state.recordings.len() == number {
            state.recorder = Recorder::Idle;
        }
        drop(state);
        self.changed.notify_all();
    }

    /// Writes what the app writes beside the `number`th video, whose sensors ran until
    /// then, and the video if it is to be there by itself.
    fn save(&self, number: usize, sensors_until: i64) -> Result<(), String> {
        let recording = self.state().recordings.get(number.wrapping_sub(1)).cloned();
        let Some(recording) = recording else {
            return Ok(());
        };
        let truth = &recording.truth;
        let to = sensors_until.max(truth.start_ns);
        let names = &recording.names;
        let files = || -> std::io::Result<()> {
            for kind in Kind::ALL
                .into_iter()
                .filter(|k| k.one_of(recording.sensors))
            {
                names.save_sensor(kind, &self.sensors.samples(kind, truth.start_ns, to))?;
            }
            let behind = self.config.frames_behind_ns();
            let stamps = truth.frames.stamps(truth.count.unwrap_or(0)).into_iter();
            names.save_timestamps(&stamps.map(|stamp| stamp - behind).collect::<Vec<_>>())
        };
        files().map_err(|e| format!("cannot save the recording's files: {e}"))?;
        if self.config.video == VideoMode::OnStop && truth.count.unwrap_or(0) > 0 {
            self.render(&recording)?;
        }
        Ok(())
    }

    /// Makes the video's file unless it is there.
    pub(super) fn render(&self, recording: &Recording) -> Result<(), String> {
        let _one_at_a_time = lock(&self.render);
        let path = recording.names.video();
        if path.exists() {
            return Ok(());
        }
        // Encoded under another name first, so that no reader finds half a video.
        let part = path.with_extension("part.mp4");
        let truth = &recording.truth;
        let count = truth.count.unwrap_or(0);
        write_video(&part, self, &truth.frames, count).map_err(|e| format!("{e:#}"))?;
        std::fs::rename(&part, &path).map_err(|e| format!("cannot save {}: {e}", path.display()))
    }
}
