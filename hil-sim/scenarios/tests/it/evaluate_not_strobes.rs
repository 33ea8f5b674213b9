//! Recordings of other things than strobes give no figure; recordings of strobes do. All are
//! drawn by a seed, encoded, and lie in the folder of a session that aligned its trigger.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::Command;

use evaluate::footage::Footage;
use evaluate::precision::{self, Evaluated, evaluate_recording};
use evaluate::track::Evidence;
use evaluate::{EvaluateError, Settings, drift};
use recording::profile::Profile;
use recording::session_file::{Alignment, SessionFile};
use rig::picture::rolling_shutter::{Flash, FlashTrain, Flicker, GreyImage, RollingShutter};
use rig::picture::video_writer::{Mp4Writer, Quality, VideoSettings};
use rig::random::{Random, Seed, Stream};
use test_support::processes::run;

/// Any; each draws other videos.
const SEEDS: Range<u64> = 7100..7101;

fn camera(random: &mut Random) -> RollingShutter {
    RollingShutter {
        columns: 48,
        exposure_ns: random.uniform(90e3, 1000e3),
        row_time_ns: random.uniform(7e3, 22e3),
        amplitude: random.uniform(25.0, 90.0),
        texture: *random.one_of(&[0.0, 0.01]),
        seed: random.bits(),
        ..RollingShutter::default()
    }
}

/// Paints a frame: when it begins, and its number.
type Paint<'a> = dyn Fn(&RollingShutter, i64, u64, &mut GreyImage) + 'a;

/// A video, in the folder of a session that aligned its trigger with a bias.
struct Drawn<'a> {
    rate: f64,
    frames: u64,
    applied_us: f64,
    camera: RollingShutter,
    draw: Box<Paint<'a>>,
}

impl Drawn<'_> {
    fn record(&self, folder: &Path) {
        let mut image = GreyImage::default();
        let start_ns = |frame: u64| 1_000_000_000 + (frame as f64 * 1e9 / self.rate) as i64;
        (self.draw)(&self.camera, start_ns(0), 0, &mut image);
        let video = VideoSettings {
            width: image.width,
            height: image.height,
            frame_rate: self.rate,
            quality: Quality::RateFactor(18),
        };
        session(folder, self.applied_us);
        let mut writer = Mp4Writer::create(&folder.join("video.mp4"), video).unwrap();
        for frame in 0..self.frames {
            (self.draw)(&self.camera, start_ns(frame), frame, &mut image);
            writer.write(&image).unwrap();
        }
        writer.finish().unwrap();
    }

    /// Evaluates it.
    fn figure(&self, settings: &Settings) -> Result<Evaluated, EvaluateError> {
        let dir = tempfile::tempdir().unwrap();
        self.record(dir.path());
        figure(dir.path(), settings)
    }
}

fn figure(folder: &Path, settings: &Settings) -> Result<Evaluated, EvaluateError> {
    let footage = Footage::read(folder, settings, None)?;
    evaluate_recording(footage, settings, 16)
}

fn session(folder: &Path, applied_us: f64) {
    std::fs::create_dir_all(folder).unwrap();
    let mut session = SessionFile::new(String::from("drawn"), Profile::published().unwrap());
    session.alignment = Some(Alignment {
        exposure_us: 250.0,
        bias_us: applied_us,
        ..Alignment::default()
    });
    session.save(folder).unwrap();
}

/// Something bright that wanders through a picture.
fn pass_by(image: &mut GreyImage, place: f64) {
    for (row, line) in image.pixels.chunks_mut(image.width).enumerate() {
        let light = 50.0 * (-((row as f64 - place) / 120.0).powi(2)).exp();
        for pixel in line {
            *pixel = pixel.saturating_add(light as u8);
        }
    }
}

/// Room light dimmed by switching it at 480 to 900 Hz: at a whole multiple of the frame rate
/// (then it stands still in the picture, like strobes in step), near one, or anywhere.
fn lamp(random: &mut Random, kind: usize) -> (String, Drawn<'static>) {
    let rate = *random.one_of(&[24.0, 25.0, 30.0, 30_000.0 / 1001.0, 60.0]);
    let still = (random.uniform(480.0, 900.0) / rate).round() * rate;
    let hz = match kind % 3 {
        0 => still,
        1 => still + random.uniform(-0.4, 0.4),
        _ => random.uniform(480.0, 900.0),
    };
    let duty = random.uniform(0.05, 0.8);
    let moves = *random.one_of(&[0.0, 9.0]);
    let camera = camera(random);
    let name = format!("lamp {hz:.2} Hz at {rate:.2}, on {duty:.2}, scene {moves}, {camera:?}");
    let paint = move |camera: &RollingShutter, start: i64, frame: u64, image: &mut GreyImage| {
        *image = lit_by(camera, start, frame, [hz, duty]);
        if moves > 0.0 {
            pass_by(image, moves * frame as f64);
        }
    };
    (name, drawn(random, rate, camera, paint))
}

/// Renders a frame in the light of a lamp of a frequency and duty cycle.
fn lit_by(camera: &RollingShutter, start: i64, frame: u64, [hz, duty]: [f64; 2]) -> GreyImage {
    let turn = 1e9 / hz;
    let end = start as f64 + camera.rows as f64 * camera.row_time_ns + 20e6;
    let pulses = ((start as f64 - 20e6) / turn) as i64..(end / turn) as i64;
    let pulse = |k: i64| Flash {
        start_ns: (k as f64 * turn) as i64,
        duration_ns: (duty * turn) as i64,
    };
    camera.render(start, frame, &pulses.map(pulse).collect::<Vec<_>>())
}

/// Bars across the picture, still or moving by some rows a frame.
fn bars(random: &mut Random, kind: usize) -> (String, Drawn<'static>) {
    let period = random.uniform(40.0, 240.0);
    let width = random.uniform(0.1, 0.6) * period;
    // Once in four as many as a train has, all in view.
    let (period, count) = match kind % 4 {
        0 => (random.uniform(60.0, 105.0), 9.0),
        _ => (period, *random.one_of(&[3.0, 5.0, 7.0, 9.0, 99.0])),
    };
    let first = if count > 50.0 {
        -1000.0
    } else {
        random.uniform(0.0, 200.0)
    };
    let speed = match kind % 3 {
        0 => 0.0,
        1 => random.uniform(0.02, 1.0),
        _ => random.uniform(1.0, 20.0),
    };
    let name = format!("{count} bars of {width:.1} every {period:.1} from {first:.1}, {speed:.2}");
    let paint = move |_: &RollingShutter, _: i64, frame: u64, image: &mut GreyImage| {
        (image.width, image.height) = (48, 1080);
        let shade = |pixel: usize| {
            let place = (pixel / 48) as f64 - first - speed * frame as f64;
            let bar = (place / period).floor();
            let bright = (0.0..count).contains(&bar) && place - bar * period < width;
            let grain = (pixel as u64 ^ frame).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 62;
            (if bright { 140 } else { 40 }) + grain as u8
        };
        image.pixels = (0..48 * 1080).map(shade).collect();
    };
    (name, drawn(random, 30.0, RollingShutter::default(), paint))
}

/// Flicker of the mains, or nothing but noise and rows of a scene.
fn mains(random: &mut Random, kind: usize) -> (String, Drawn<'static>) {
    let rate = *random.one_of(&[25.0, 30.0, 50.0]);
    let depth = random.uniform(0.1, 0.9);
    let flicker = Flicker {
        frequency_hz: *random.one_of(&[100.0, 120.0, 240.0]),
        depth,
        phase_rad: random.uniform(0.0, 6.0),
    };
    let camera = RollingShutter {
        flicker: kind.is_multiple_of(2).then_some(flicker),
        ambient: 110.0,
        texture: random.uniform(0.0, 0.2),
        ..camera(random)
    };
    let name = format!("mains {:?}, texture {:.2}", camera.flicker, camera.texture);
    let paint = |camera: &RollingShutter, start: i64, frame: u64, image: &mut GreyImage| {
        *image = camera.render(start, frame, &[]);
    };
    (name, drawn(random, rate, camera, paint))
}

fn drawn<'a>(
    random: &mut Random,
    rate: f64,
    camera: RollingShutter,
    paint: impl Fn(&RollingShutter, i64, u64, &mut GreyImage) + 'a,
) -> Drawn<'a> {
    Drawn {
        rate,
        frames: *random.one_of(&[40, 40, 80]),
        applied_us: 0.0,
        camera,
        draw: Box::new(paint),
    }
}

/// Every other one with a row time stated, as it is: then a lamp is named by its frequency.
#[test]
fn nothing_but_strobes_gives_a_figure() {
    let (mut videos, mut accepted) = (0, Vec::new());
    for seed in SEEDS {
        let mut random = Seed(seed).stream(Stream::Test);
        for kind in 0..16 {
            let (name, video) = match kind {
                0..7 => lamp(&mut random, kind),
                7..14 => bars(&mut random, kind),
                _ => mains(&mut random, kind),
            };
            let settings = Settings {
                row_time_us: (kind % 2 == 0).then_some(1e-3 * video.camera.row_time_ns),
                ..Settings::default()
            };
            videos += 1;
            let dir = tempfile::tempdir().unwrap();
            video.record(dir.path());
            let found = if kind / 2 % 2 == 0 {
                figure(dir.path(), &settings).map(|drift| format!("{:?}", drift.result))
            } else {
                let footage = Footage::read(dir.path(), &settings, None);
                let found = footage.and_then(|footage| drift::evaluate(footage, &settings));
                found.map(|drift| format!("{:?}", drift.result))
            };
            match found {
                Ok(found) => accepted.push(format!("{name}: {found}")),
                Err(refusal) => println!("{name}: {refusal}"),
            }
        }
    }
    assert!(
        accepted.is_empty(),
        "{} of {videos}: {accepted:#?}",
        accepted.len()
    );
}

/// Pictures that ffmpeg makes by itself, the same in every run.
#[test]
fn test_pictures_are_no_strobes() {
    let dir = tempfile::tempdir().unwrap();
    session(dir.path(), 0.0);
    let video = dir.path().join("video.mp4");
    for picture in [
        "testsrc2=",
        "smptehdbars=",
        "rgbtestsrc=",
        "mandelbrot=",
        "cellauto=seed=7:",
        "life=seed=7:",
        "gradients=seed=7:c0=red:c1=blue:x0=10:y0=20:x1=300:y1=500:",
    ] {
        let mut ffmpeg = Command::new("ffmpeg");
        ffmpeg
            .args(["-v", "error", "-y", "-f", "lavfi", "-i"])
            .arg(format!("{picture}s=320x540"))
            .args(["-frames:v", "40", "-r", "30", "-pix_fmt", "yuv420p"]);
        run(ffmpeg.arg(&video));
        let found = figure(dir.path(), &Settings::default()).ok();
        assert_eq!(found.map(|drift| drift.result), None, "{picture}");
    }
}

/// With a known row time the rate is reported.
#[test]
fn the_rate_of_a_lamp_is_reported() {
    let camera = RollingShutter {
        columns: 48,
        exposure_ns: 400e3,
        ..RollingShutter::default()
    };
    let paint = |camera: &RollingShutter, start: i64, frame: u64, image: &mut GreyImage| {
        *image = lit_by(camera, start, frame, [613.7, 0.5]);
    };
    let settings = Settings {
        row_time_us: Some(10.2),
        ..Settings::default()
    };
    let video = drawn(&mut Seed(1).stream(Stream::Test), 30.0, camera, paint);
    let refusal = video.figure(&settings).unwrap_err();
    assert!(refusal.to_string().contains("613.7 Hz"), "{refusal}");
}

/// Flashes of a depth camera at a bias in each frame, if the trigger reached it.
fn strobes<'a>(
    camera: RollingShutter,
    rate: f64,
    bias_us: impl Fn(u64) -> Option<f64> + 'a,
) -> Drawn<'a> {
    let paint = move |camera: &RollingShutter, start: i64, frame: u64, image: &mut GreyImage| {
        let centred = |bias: f64| start + (camera.middle_offset_ns() + 1e3 * bias) as i64;
        let flashes = bias_us(frame).map(|bias| FlashTrain::NFOV.centered_at(centred(bias)));
        let flashes: Vec<Flash> = flashes.into_iter().flatten().collect();
        *image = camera.render(start, frame, &flashes);
    };
    drawn(&mut Seed(3).stream(Stream::Test), rate, camera, paint)
}

/// Strobes that begin after some frames, that come on some frames only, that the trigger
/// brings from elsewhere at 60 to 100 µs a frame, or of a camera with a known row time.
#[test]
fn strobes_give_a_figure() {
    let mut refused = Vec::new();
    for seed in SEEDS {
        let mut random = Seed(seed ^ 0x5EED).stream(Stream::Test);
        for kind in 0..8 {
            let camera = camera(&mut random);
            let rate = *random.one_of(&[24.0, 30.0, 60.0]);
            let bias_us = random.uniform(-700.0, 700.0);
            let slew_us = random.uniform(60.0, 100.0);
            let some = *random.one_of(&[3, 5, 11]);
            let bias = move |frame: u64| match kind % 4 {
                0 => (frame >= some).then_some(bias_us),
                1 => frame.is_multiple_of(some.min(3)).then_some(bias_us),
                2 => Some(bias_us + slew_us * (5 + some).saturating_sub(frame) as f64),
                _ => Some(bias_us),
            };
            let settings = Settings {
                row_time_us: (kind % 4 == 3).then_some(1e-3 * camera.row_time_ns),
                ..Settings::default()
            };
            let name =
                format!("{kind}: {bias_us:.1} µs, {slew_us:.0} {some} at {rate}, {camera:?}");
            let pitch = 1575.0 / 2.0;
            match strobes(camera, rate, bias).figure(&settings) {
                // Which flash is which is not asked here.
                Ok(Evaluated { result, .. }) => {
                    let off = (result.bias_us - bias_us) / pitch;
                    let off_us = (off - off.round()) * pitch;
                    assert!(
                        off_us.abs() < 3.0 + result.uncertainty_99_us,
                        "{name}: {result:?}"
                    );
                }
                Err(refusal) => refused.push(format!("{name}: {refusal}")),
            }
        }
    }
    assert!(
        refused.is_empty(),
        "{} refused: {refused:#?}",
        refused.len()
    );
}

/// A recording of which nothing shows that its bands are flashes, until a second one was
/// made with the trigger moved.
#[test]
fn a_second_recording_with_the_trigger_moved_shows_that_they_are_flashes() {
    let dir = tempfile::tempdir().unwrap();
    let recording = |name: &str, bias_us: f64, applied_us: f64| {
        let camera = RollingShutter {
            columns: 96,
            exposure_ns: 250e3,
            ..RollingShutter::default()
        };
        let video = Drawn {
            frames: 20,
            applied_us,
            ..strobes(camera, 30.0, move |_| Some(bias_us))
        };
        let folder = dir.path().join(name);
        video.record(&folder);
        folder
    };
    let first = recording("first", 30.0, 0.0);
    let moved = recording("moved", -370.0, 400.0);
    // Said to be moved, but the bands were not: a lamp.
    let lamp = recording("lamp", 31.0, 400.0);
    let evaluate = |inputs: &[&PathBuf]| {
        let inputs: Vec<PathBuf> = inputs.iter().map(|&path| path.clone()).collect();
        let settings = Settings::default();
        precision::evaluate(&inputs, &settings, 16, &mut |_, _| ())
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
