//! Pictures of other things than strobes: none gives a figure.

use std::path::PathBuf;
use std::process::Command;

use crate::strobes::Scene;
use evaluate::evidence::Evidence;
use evaluate::footage::Footage;
use evaluate::frame::GreyView;
use evaluate::precision::{self, evaluate_recording};
use evaluate::source::{FrameSource, FrameTimes, SourceInfo};
use evaluate::{EvaluateError, Settings, drift};
use recording::profile::Profile;
use recording::session_file::SessionFile;
use rig::rolling_shutter::{Flash, GreyImage, RollingShutter};
use rig::video_writer::Quality;

/// Frames at 30 a second, drawn one after the other.
struct Drawn<F> {
    info: SourceInfo,
    frames: u64,
    next: u64,
    image: GreyImage,
    draw: F,
}

impl<F: Fn(u64, &mut GreyImage)> Drawn<F> {
    fn new(size: (usize, usize), frame_s: f64, draw: F) -> Self {
        let frames = 40;
        let start_ns = |frame: u64| (frame as f64 * frame_s * 1e9).round() as i64;
        Self {
            info: SourceInfo {
                encoded: false,
                path: PathBuf::from("drawn"),
                width: size.0,
                height: size.1,
                white: 255,
                frames: Some(frames),
                times: FrameTimes::Listed((0..frames).map(start_ns).collect()),
                notes: Vec::new(),
            },
            frames,
            next: 0,
            image: GreyImage::default(),
            draw,
        }
    }
}

impl<F: Fn(u64, &mut GreyImage)> FrameSource for Drawn<F> {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Result<Option<GreyView<'_>>, EvaluateError> {
        if self.next == self.frames {
            return Ok(None);
        }
        (self.draw)(self.next, &mut self.image);
        self.next += 1;
        Ok(Some(GreyView {
            width: self.image.width,
            height: self.image.height,
            pixels: &self.image.pixels,
        }))
    }
}

/// What a recording is said to show, if it is said to show strobes at all.
fn figure(
    read: impl Fn(&Settings) -> Result<Footage, EvaluateError>,
    drifts: bool,
) -> Option<String> {
    let settings = Settings::default();
    let footage = read(&settings).unwrap();
    let found = if drifts {
        drift::evaluate(footage, &settings).map(|found| format!("{:?}", found.result))
    } else {
        evaluate_recording(footage, &settings, 16).map(|found| format!("{:?}", found.result))
    };
    found.inspect_err(|refusal| println!("{refusal}")).ok()
}

/// A lamp that is dimmed by switching it on and off.
#[derive(Clone, Copy, Debug)]
struct Lamp {
    frequency_hz: f64,
    /// Share of the time that it is on.
    duty: f64,
    exposure_us: f64,
    row_time_us: f64,
    frame_s: f64,
    texture: f64,
}

impl Lamp {
    fn footage(self, settings: &Settings) -> Result<Footage, EvaluateError> {
        let camera = RollingShutter {
            columns: 48,
            exposure_ns: 1e3 * self.exposure_us,
            row_time_ns: 1e3 * self.row_time_us,
            amplitude: 60.0,
            texture: self.texture,
            ..RollingShutter::default()
        };
        let readout_s = camera.rows as f64 * camera.row_time_ns * 1e-9;
        let draw = |frame: u64, image: &mut GreyImage| {
            let start_s = 1.0 + frame as f64 * self.frame_s;
            let first = ((start_s - 0.02) * self.frequency_hz).floor() as i64;
            let last = ((start_s + readout_s + 0.02) * self.frequency_hz).ceil() as i64;
            let pulses: Vec<Flash> = (first..=last)
                .map(|k| Flash {
                    start_ns: (k as f64 / self.frequency_hz * 1e9).round() as i64,
                    duration_ns: (self.duty / self.frequency_hz * 1e9).round() as i64,
                })
                .collect();
            camera.render_into((start_s * 1e9).round() as i64, frame, &pulses, image);
        };
        let mut source = Drawn::new(camera.image_size(), self.frame_s, draw);
        Footage::from_source(&mut source, settings, None)
    }
}

/// Room light dimmed at 480 to 900 Hz, at random and at whole multiples of the frame rate
/// (then it stands still in the picture, like strobes in step).
#[test]
fn a_dimmed_lamp_is_no_strobe() {
    for (i, frequency_hz) in [480.0, 540.9, 613.7, 634.92, 660.02, 810.0, 888.8]
        .into_iter()
        .enumerate()
    {
        let lamp = Lamp {
            frequency_hz,
            duty: [0.08, 0.3, 0.5, 0.15, 0.7][i % 5],
            exposure_us: [125.0, 400.0, 900.0][i % 3],
            row_time_us: [10.2, 8.0, 14.0, 20.0][i % 4],
            frame_s: [1.0 / 30.0, 1.0 / 29.97][i % 2],
            texture: [0.0, 0.02][i % 2],
        };
        let figure = figure(|settings| lamp.footage(settings), i % 2 == 1);
        assert_eq!(figure, None, "{lamp:?}");
    }
}

/// With a known row time the rate is told.
#[test]
fn the_rate_of_a_lamp_is_told() {
    let lamp = Lamp {
        frequency_hz: 613.7,
        duty: 0.5,
        exposure_us: 400.0,
        row_time_us: 10.2,
        frame_s: 1.0 / 30.0,
        texture: 0.0,
    };
    let settings = Settings {
        row_time_us: Some(10.2),
        ..Settings::default()
    };
    let refusal = evaluate_recording(lamp.footage(&settings).unwrap(), &settings, 16).unwrap_err();
    assert!(refusal.to_string().contains("613.7 Hz"), "{refusal}");
}

/// Bars across the picture: place of the first, period, width and number, in rows, and
/// rows by which they move from frame to frame.
#[test]
fn bars_are_no_strobes() {
    for (i, (first, period, width, count, speed)) in [
        (-1000.0, 120.0, 12.0, 99, 0.0),
        (-1000.0, 154.4, 40.0, 99, 2.0),
        (200.0, 154.4, 12.3, 5, 0.0),
        (200.0, 90.0, 20.0, 6, 11.0),
        (-1000.0, 154.4, 12.3, 99, 1.0),
        (200.0, 200.0, 30.0, 4, 3.0),
    ]
    .into_iter()
    .enumerate()
    {
        let draw = |frame: u64, image: &mut GreyImage| {
            (image.width, image.height) = (48, 1080);
            let shade = |pixel: usize| {
                let place = (pixel / 48) as f64 - first - speed * frame as f64;
                let of = (place / period).floor();
                let bright = (0.0..f64::from(count)).contains(&of) && place - of * period < width;
                let grain = (pixel as u64 ^ frame).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 62;
                (if bright { 140 } else { 40 }) + grain as u8
            };
            image.pixels = (0..48 * 1080).map(shade).collect();
        };
        let read = |settings: &Settings| {
            let mut source = Drawn::new((48, 1080), 1.0 / 30.0, draw);
            Footage::from_source(&mut source, settings, None)
        };
        let figure = figure(read, i % 2 == 1);
        assert_eq!(
            figure, None,
            "{count} bars every {period} rows, {speed} a frame"
        );
    }
}

/// Pictures that ffmpeg makes by itself.
#[test]
fn test_pictures_are_no_strobes() {
    let dir = tempfile::tempdir().unwrap();
    let video = dir.path().join("video.mp4");
    for (i, picture) in ["testsrc", "testsrc2", "smptebars", "mandelbrot", "cellauto"]
        .into_iter()
        .enumerate()
    {
        let status = Command::new("ffmpeg")
            .args(["-v", "error", "-y", "-f", "lavfi", "-i"])
            .arg(format!("{picture}=s=320x540"))
            .args(["-frames:v", "40", "-r", "30", "-pix_fmt", "yuv420p"])
            .arg(&video)
            .status()
            .unwrap();
        assert!(status.success(), "{picture}");
        let read = |settings: &Settings| Footage::read(&video, settings, None);
        assert_eq!(figure(read, i % 2 == 1), None, "{picture}");
    }
}

/// A recording of which nothing shows that its bands are flashes, until a second one was
/// made with the trigger moved.
#[test]
fn a_second_recording_with_the_trigger_moved_shows_that_they_are_flashes() {
    let dir = tempfile::tempdir().unwrap();
    let recording = |name: &str, bias_us: f64, applied_us: f64| {
        let folder = dir.path().join(name);
        std::fs::create_dir_all(&folder).unwrap();
        let scene = Scene {
            camera: RollingShutter {
                columns: 96,
                exposure_ns: 250e3,
                ..RollingShutter::default()
            },
            bias_us,
            lit_from: 0,
            ..Scene::default()
        };
        scene.write_mp4(&folder.join("video.mp4"), Quality::RateFactor(18));
        let mut session = SessionFile::new(name.to_owned(), Profile::published().unwrap());
        let alignment = serde_json::json!({
            "exposure_us": 250.0, "middle_row_us": 0.0, "center_offset_us": 0.0,
            "bias_us": applied_us, "frame_period_ns": 33e6, "frame_period_sigma_ns": null,
            "frame_period_source": "learnt",
            "clock": {"reference": 0.0, "offset": 0.0, "skew": 0.0,
                "covariance": [[0.0, 0.0], [0.0, 0.0]], "wander": 0.0},
            "anchor": 0, "period_q32": 1_u64 << 32, "phase_sigma_us": 1.0,
            "drift_sigma_us_per_min": 1.0, "arrival_pulse": null, "arrival": null,
        });
        session.alignment = Some(serde_json::from_value(alignment).unwrap());
        session.save(&folder).unwrap();
        folder
    };
    let first = recording("first", 30.0, 0.0);
    let moved = recording("moved", -370.0, 400.0);
    // Said to be moved, but the bands were not: a lamp.
    let lamp = recording("lamp", 31.0, 400.0);
    let evaluate = |inputs: &[&PathBuf]| {
        let inputs: Vec<PathBuf> = inputs.iter().map(|&path| path.clone()).collect();
        let settings = Settings::default();
        precision::evaluate(&inputs, &settings, 16, &mut |_, _, _| ())
    };
    let alone = evaluate(&[&first]).unwrap_err();
    assert!(matches!(alone, EvaluateError::Unproven { .. }), "{alone}");
    let (both, _) = evaluate(&[&first, &lamp]).unwrap();
    assert_eq!((both.recordings.len(), both.left_out.len()), (0, 2));
    let (both, _) = evaluate(&[&first, &moved]).unwrap();
    assert_eq!((both.recordings.len(), both.left_out.len()), (2, 0));
    for (result, bias_us) in both.recordings.iter().zip([30.0, -370.0]) {
        assert_eq!(result.evidence, Some(Evidence::Shift));
        assert!((result.bias_us - bias_us).abs() < 2.0, "{result:?}");
    }
}
