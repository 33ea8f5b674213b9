//! The measurement with the board's LED on rendered frames with a ground truth. All figures are
//! simulated.

use evaluate::EvaluateError;
use evaluate::footage::{FrameSource, FrameTimes, GreyView, SourceInfo};
use evaluate::led::film::Film;
use evaluate::led::{Expected, LedFlash, LedRefusal, MeasuredRows, measure};
use protocol::{EdgeGrid, EdgeTime, Period, TICK_HZ, Ticks};
use recording::profile::Direction;
use rig::picture::rolling_shutter::{
    Flash, FlashTrain, Flicker, GreyImage, Readout, RollingShutter,
};
use rig::picture::video_writer::{Mp4Writer, Quality, VideoSettings};
use rig::random::{Random, Seed, Stream};
use system::ReadMonitor;

/// Length of a pulse, ns.
const LENGTH_NS: i64 = 2_000_000;

/// Periods of the LED, parts of a whole number of frames.
const PERIODS: [f64; 2] = [1.0734, 0.9266];

/// Encoders and settings of videos: what phones use, faster and slower ones, and coarser.
const ENCODERS: [Quality; 9] = [
    Quality::RateFactor(18),
    Quality::RateFactor(23),
    Quality::RateFactor(28),
    Quality::BitRate(600_000),
    Quality::With(&["-preset", "ultrafast", "-crf", "23"]),
    Quality::With(&["-preset", "medium", "-bf", "2", "-crf", "23"]),
    Quality::With(&[
        "-c:v",
        "libx265",
        "-preset",
        "ultrafast",
        "-crf",
        "23",
        "-x265-params",
        QUIET,
    ]),
    Quality::With(&[
        "-c:v",
        "libx265",
        "-preset",
        "veryfast",
        "-crf",
        "20",
        "-x265-params",
        QUIET,
    ]),
    Quality::With(&[
        "-c:v",
        "libx265",
        "-preset",
        "veryfast",
        "-crf",
        "28",
        "-x265-params",
        QUIET,
    ]),
];
const QUIET: &str = "log-level=error";

/// Part of the picture that the LED lights: a tilted ellipse, in parts of the picture's sides.
#[derive(Clone, Debug)]
struct Blob {
    center: [f64; 2],
    radii: [f64; 2],
    tilt_rad: f64,
}

impl Blob {
    fn drawn(random: &mut Random) -> Self {
        Self {
            center: [random.uniform(0.3, 0.7), random.uniform(0.3, 0.7)],
            radii: [random.uniform(0.25, 0.8), random.uniform(0.25, 0.8)],
            tilt_rad: random.uniform(0.0, std::f64::consts::PI),
        }
    }

    fn is_lit(&self, x: f64, y: f64) -> bool {
        let (sin, cos) = self.tilt_rad.sin_cos();
        let (x, y) = (x - self.center[0], y - self.center[1]);
        let along = (cos * x + sin * y) / self.radii[0];
        let across = (cos * y - sin * x) / self.radii[1];
        along * along + across * across < 1.0
    }
}

/// A phone before the board's LED.
#[derive(Clone, Debug)]
struct LedScene {
    camera: RollingShutter,
    /// Frame period, ns.
    period_ns: f64,
    /// From a frame's timestamp to the start of exposure of its first row, ns.
    stamp_ns: i64,
    /// White noise of the timestamps, 1-sigma, ns.
    jitter_ns: f64,
    /// Share of the frames that are lost.
    lost: f64,
    /// Lateness of the light when the pin rises and when it falls, ns.
    late_ns: [i64; 2],
    seconds: f64,
    /// Other light.
    others: Vec<Flash>,
    /// True if the LED is lit.
    is_lit: bool,
    /// Part of the picture that its light reaches; all of it if there is none.
    blob: Option<Blob>,
    seed: u64,
}

impl LedScene {
    /// A phone with everything from its range: exposure from 0.1 to 16 ms, readout, rate, direction,
    /// brightness to saturation, tone curve. The picture has this many rows and columns.
    fn drawn(seed: u64, [rows, columns]: [usize; 2], seconds: f64) -> Self {
        let mut random = Seed(seed).stream(Stream::ModelRanges);
        let mut log = |from: f64, to: f64| (random.uniform(from.ln(), to.ln())).exp();
        let exposure_ns = log(1e5, 16e6);
        // A longer exposure than the period allows is none.
        let period_ns = (1e9 / log(24.0, 60.0)).max(1.02 * exposure_ns);
        let readout_ns = log(5e6, 33e6).min(0.98 * period_ns);
        let (amplitude, jitter_ns) = (log(20.0, 400.0), log(100.0, 20_000.0));
        let late_ns = [log(20.0, 500.0) as i64, log(20.0, 1_000.0) as i64];
        Self {
            camera: RollingShutter {
                columns,
                rows,
                row_time_ns: readout_ns / (rows as f64 - 1.0),
                exposure_ns,
                amplitude,
                texture: 0.05,
                readout: [
                    Readout::TopToBottom,
                    Readout::BottomToTop,
                    Readout::LeftToRight,
                    Readout::RightToLeft,
                ][seed as usize % 4],
                gamma: [1.0, 1.8, 2.2][seed as usize % 3],
                seed,
                ..RollingShutter::default()
            },
            period_ns,
            stamp_ns: random.uniform(-5e6, 5e6) as i64,
            jitter_ns,
            lost: 0.01,
            late_ns,
            seconds,
            others: Vec::new(),
            is_lit: true,
            blob: None,
            seed,
        }
    }

    /// Another of a few columns, which is rendered and measured in a second.
    fn small(seed: u64) -> Self {
        Self::drawn(seed, [240, 16], 20.0)
    }

    /// With a part of the picture lit, in as many columns as blocks of an encoder need.
    fn filmed(seed: u64, columns: usize, seconds: f64) -> Self {
        let mut random = Seed(seed).stream(Stream::Motion);
        Self {
            blob: Some(Blob::drawn(&mut random)),
            ..Self::drawn(seed, [1_080, columns], seconds)
        }
    }

    fn truth_us(&self) -> f64 {
        1e-3 * (self.stamp_ns as f64 + self.camera.middle_offset_ns())
    }

    fn direction(&self) -> Direction {
        match self.camera.readout {
            Readout::TopToBottom => Direction::Down,
            Readout::BottomToTop => Direction::Up,
            Readout::LeftToRight => Direction::Right,
            Readout::RightToLeft => Direction::Left,
        }
    }

    /// Periods of the LED, ns.
    fn periods_ns(&self) -> [f64; 2] {
        let frames = (28e6 / self.period_ns).ceil();
        PERIODS.map(|part| part * frames * self.period_ns)
    }

    /// Edges of the pin, ns: runs of two periods with pauses.
    fn pulses(&self) -> Vec<i64> {
        let ticks_per_ns = f64::from(TICK_HZ) * 1e-9;
        let mut pulses = Vec::new();
        let mut at = Ticks(0);
        let end = self.seconds * f64::from(TICK_HZ);
        let mut random = Seed(self.seed).stream(Stream::Rig);
        for run in 0.. {
            let period = Period::from_ticks_f64(self.periods_ns()[run % 2] * ticks_per_ns);
            let grid = EdgeGrid::new(EdgeTime::from_ticks(at), period);
            let count = (5.0 / period.as_secs_f64()) as i64;
            let ticks = (0..count).map(|k| grid.edge(k).ticks);
            pulses.extend(ticks.map(|ticks| (i128::from(ticks.0) * 125 / 6) as i64));
            at = grid.edge(count).ticks;
            at.0 += (f64::from(TICK_HZ) * random.uniform(0.4, 1.0)) as u64;
            if at.0 as f64 > end {
                break;
            }
        }
        pulses
    }

    /// Times of the frames that are not lost, µs, and their pictures.
    fn frames(&self) -> (Vec<f64>, Vec<GreyImage>) {
        let mut light: Vec<Flash> = self.others.clone();
        if self.is_lit {
            let [rise, fall] = self.late_ns;
            light.extend(self.pulses().iter().map(|&pulse| Flash {
                start_ns: pulse + rise,
                duration_ns: LENGTH_NS + fall - rise,
            }));
        }
        light.sort_by_key(|flash| flash.start_ns);
        // The longest that a card or a hand lights the picture is 2 s.
        let near = |start_ns: i64| {
            let at = |ns: i64| light.partition_point(|flash| flash.start_ns < start_ns + ns);
            &light[at(-2_000_000_000)..at(100_000_000)]
        };
        let mut random = Seed(self.seed).stream(Stream::PhoneCamera);
        let count = (self.seconds * 1e9 / self.period_ns) as u64;
        let (mut times_us, mut images) = (Vec::new(), Vec::new());
        for frame in 0..count {
            let stamp = (frame as f64 * self.period_ns).round() as i64;
            let jitter = self.jitter_ns * random.normal();
            if random.chance(self.lost) {
                continue;
            }
            times_us.push(1e-3 * (stamp as f64 + jitter));
            let start_ns = stamp + self.stamp_ns;
            let mut image = self.camera.render(start_ns, frame, near(start_ns));
            if let Some(blob) = &self.blob {
                let dark = self.camera.render(start_ns, frame, &[]);
                let part = |place: usize, side: usize| (place as f64 + 0.5) / side as f64;
                let (width, height) = (image.width, image.height);
                for (place, pixel) in image.pixels.iter_mut().enumerate() {
                    if !blob.is_lit(part(place % width, width), part(place / width, height)) {
                        *pixel = dark.pixels[place];
                    }
                }
            }
            images.push(image);
        }
        (times_us, images)
    }

    /// Measures frames, which go through an encoder if one is given.
    fn measure_in(
        &self,
        (times_us, images): &(Vec<f64>, Vec<GreyImage>),
        quality: Option<Quality>,
    ) -> Result<MeasuredRows, LedRefusal> {
        let (width, height) = self.camera.image_size();
        let film = if let Some(quality) = quality {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("video.mp4");
            let settings = VideoSettings {
                width,
                height,
                frame_rate: 1e9 / self.period_ns,
                quality,
            };
            let mut writer = Mp4Writer::create(&path, settings).unwrap();
            for image in images {
                writer.write(image).unwrap();
            }
            writer.finish().unwrap();
            Film::read_file(&path, times_us, None, &ReadMonitor::default())
        } else {
            let info = SourceInfo {
                path: "rendered".into(),
                width,
                height,
                white: 253,
                frames: None,
                times: FrameTimes::Rate(30.0),
                encoded: false,
                notes: Vec::new(),
            };
            let images = images.iter();
            Film::read(&mut Rendered { images, info }, times_us, None)
        };
        let flash = |pulse: i64| LedFlash {
            middle_us: 1e-3 * (pulse + LENGTH_NS / 2) as f64,
            length_us: 1e-3 * LENGTH_NS as f64,
        };
        let flashes: Vec<LedFlash> = self.pulses().into_iter().map(flash).collect();
        let expected = Expected {
            middle_us: 10_000.0,
            within_us: 25_000.0,
        };
        measure(&film.unwrap(), &flashes, &expected)
    }

    fn measure(&self, quality: Option<Quality>) -> Result<MeasuredRows, LedRefusal> {
        self.measure_in(&self.frames(), quality)
    }

    /// Error of a result.
    fn error(&self, found: &MeasuredRows) -> Error {
        let row_time_us = self.camera.row_time_ns * 1e-3;
        let error = Error {
            middle_us: found.middle_us - self.truth_us(),
            sigma_us: found.middle_sigma_us,
            lines: (found.middle_us - self.truth_us()) / row_time_us,
            row_time_ppm: 1e6 * (found.row_time_us / row_time_us - 1.0),
            row_time_sigma_ppm: 1e6 * found.row_time_sigma_us / row_time_us,
        };
        println!(
            "{:4} {:5} exposure {:6.0} row {row_time_us:5.1} grey {:3.0} fps {:2.0} | {:7.2} ± {:5.2} µs, \
             {:5.2} lines, {:6.1} ± {:5.1} ppm, periods {:6.2} ± {:5.2}, score {:.0} of others {:.0}",
            self.seed,
            self.direction().name(),
            self.camera.exposure_ns * 1e-3,
            self.camera.amplitude,
            1e9 / self.period_ns,
            error.middle_us,
            error.sigma_us,
            error.lines,
            error.row_time_ppm,
            error.row_time_sigma_ppm,
            found.disagreement_us[0],
            found.disagreement_us[1],
            found.score,
            found.score_of_others,
        );
        assert_eq!(found.direction, self.direction());
        error
    }
}

#[derive(Debug)]
struct Error {
    middle_us: f64,
    sigma_us: f64,
    /// The error of the middle toward later lines of the readout.
    lines: f64,
    row_time_ppm: f64,
    row_time_sigma_ppm: f64,
}

/// Error over 1-sigma, rms; 95 % of the errors of middle (µs) and row time (ppm) are below.
fn figures(errors: &[Error]) -> [f64; 3] {
    let below = |of: fn(&Error) -> f64| {
        let mut sizes: Vec<f64> = errors.iter().map(|error| of(error).abs()).collect();
        sizes.sort_by(f64::total_cmp);
        sizes[(0.95 * (sizes.len() - 1) as f64).round() as usize]
    };
    let over_sigma = rms(errors.iter().map(|error| error.middle_us / error.sigma_us));
    let figures = [
        over_sigma,
        below(|e| e.middle_us),
        below(|e| e.row_time_ppm),
    ];
    let row_times = errors.iter().map(|e| e.row_time_ppm / e.row_time_sigma_ppm);
    println!(
        "{}: error over sigma {:.2}, of row times {:.2}; 95 % below {:.1} µs, row time {:.0} ppm",
        errors.len(),
        figures[0],
        rms(row_times),
        figures[1],
        figures[2]
    );
    figures
}

fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    (values.map(|value| value * value).sum::<f64>() / count).sqrt()
}

struct Rendered<'a> {
    images: std::slice::Iter<'a, GreyImage>,
    info: SourceInfo,
}

impl FrameSource for Rendered<'_> {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Result<Option<GreyView<'_>>, EvaluateError> {
        Ok(self.images.next().map(|image| GreyView {
            width: image.width,
            height: image.height,
            pixels: &image.pixels,
        }))
    }
}

/// Number of drawn cases of a long run.
fn drawn(default: u64) -> u64 {
    let given = std::env::var("SMARTDEPTHSYNC_DRAWN").ok();
    given.and_then(|text| text.parse().ok()).unwrap_or(default)
}

/// Bands cut off at the edges, saturation and a tone curve, in all directions.
#[test]
fn the_rows_of_many_phones_are_measured() {
    let errors = (0..4).map(|seed| {
        let scene = LedScene::small(seed);
        let error = scene.error(&scene.measure(None).unwrap());
        assert!(error.middle_us.abs() < 5.0 * error.sigma_us, "{error:?}");
        assert!(error.sigma_us < 12.0, "{error:?}");
        error
    });
    figures(&errors.collect::<Vec<_>>());
}

/// Light that is not the LED's.
fn with_other_light(mut scene: LedScene, kind: u64) -> LedScene {
    let seed = scene.seed;
    let mut random = Seed(40 + seed).stream(Stream::Motion);
    let period_ns = scene.periods_ns()[usize::from(random.chance(0.5))];
    let mut lamp = |hz: f64, duty: f64| {
        let period = 1e9 / hz;
        let count = (scene.seconds * hz) as u64;
        scene.others.extend((0..count).map(|k| Flash {
            start_ns: (k as f64 * period) as i64,
            duration_ns: (duty * period) as i64,
        }));
    };
    match kind {
        // The mains.
        0 => {
            scene.camera.flicker = Some(Flicker {
                frequency_hz: if random.chance(0.5) { 100.0 } else { 120.0 },
                depth: random.uniform(0.1, 1.0),
                phase_rad: random.uniform(0.0, 6.0),
            });
        }
        // A dimmed lamp.
        1 => lamp(random.uniform(100.0, 1_500.0), random.uniform(0.1, 0.9)),
        // A screen.
        2 => lamp([50.0, 59.94, 60.0, 90.0, 120.0][seed as usize % 5], 0.7),
        // A light that flashes about as often as the LED.
        3 => lamp(random.uniform(20.0, 40.0), random.uniform(0.02, 0.2)),
        // One that flashes as often as the LED does for half of the time.
        4 => lamp(1e9 / period_ns, random.uniform(0.02, 0.2)),
        // The depth camera's own flashes, on the phone's frames.
        5 => {
            let middle = scene.stamp_ns + scene.camera.middle_offset_ns() as i64;
            let frames = (scene.seconds * 1e9 / scene.period_ns) as u64;
            for frame in 0..frames {
                let at = (frame as f64 * scene.period_ns) as i64 + middle;
                scene.others.extend(FlashTrain::NFOV.centered_at(at));
            }
        }
        // A hand that comes and goes.
        _ => {
            let mut at = 0.0;
            while at < scene.seconds * 1e9 {
                let length = random.uniform(2e7, 2e9);
                scene.others.push(Flash {
                    start_ns: at as i64,
                    duration_ns: length as i64,
                });
                at += length + random.uniform(2e7, 2e9);
            }
        }
    }
    scene
}

const LIGHTS: u64 = 7;

/// Measures in other light: a result without the LED is wrong. Returns the results beside it, and
/// those that are off by more than 5 sigma.
fn no_other_light_is_taken_for_the_led(seeds: impl Iterator<Item = u64>) -> [usize; 2] {
    let mut beside = [0, 0];
    for seed in seeds {
        let scene = with_other_light(LedScene::small(seed), seed % LIGHTS);
        let dark = LedScene {
            is_lit: false,
            ..scene.clone()
        };
        let found = dark.measure(None);
        assert!(found.is_err(), "{seed}, light {}: {found:?}", seed % LIGHTS);
        match scene.measure(None) {
            Ok(found) => {
                let error = scene.error(&found);
                beside[0] += 1;
                beside[1] += usize::from(error.middle_us.abs() > 5.0 * error.sigma_us);
            }
            Err(refusal) => println!("{seed}, light {}: {refusal}", seed % LIGHTS),
        }
    }
    beside
}

#[test]
fn a_few_other_lights_are_not_taken_for_the_led() {
    // The depth camera's own flashes, a dimmed lamp, one of the LED's periods.
    let beside = no_other_light_is_taken_for_the_led([2_000, 2_003, 2_006].into_iter());
    assert_eq!(beside, [3, 0]);
}

/// `cargo test --release -p hil-sim --test it other_lights -- --ignored --nocapture`
#[test]
#[ignore = "minutes; 200 lights, or SMARTDEPTHSYNC_DRAWN"]
fn many_other_lights_are_not_taken_for_the_led() {
    let [measured, off] = no_other_light_is_taken_for_the_led(3_000..3_000 + drawn(200));
    println!("beside other light: {measured} measured, {off} of them off by more than 5 sigma");
}

/// A part of the picture is lit, and the video is encoded.
#[test]
fn a_video_of_a_partly_lit_picture_is_measured() {
    let scene = LedScene::filmed(4_002, 64, 20.0);
    let error = scene.error(&scene.measure(Some(ENCODERS[1])).unwrap());
    assert!(error.middle_us.abs() < 4.0 * error.sigma_us, "{error:?}");
    assert!(
        error.sigma_us < 25.0 && error.row_time_ppm.abs() < 2e3,
        "{error:?}"
    );
}

/// Phones, lights and encoders over their ranges: errors against their 1-sigmas.
///
/// `cargo test --release -p hil-sim --test it drawn_videos -- --ignored --nocapture`
#[test]
#[ignore = "an hour; prints the figures of the book for 100 videos, or SMARTDEPTHSYNC_DRAWN"]
fn drawn_videos_are_measured_within_their_sigma() {
    let mut errors = Vec::new();
    for seed in 5_000..5_000 + drawn(100) {
        let scene = LedScene::filmed(seed, 64, 30.0);
        match scene.measure(Some(ENCODERS[seed as usize % ENCODERS.len()])) {
            Ok(found) => errors.push(scene.error(&found)),
            Err(refusal) => println!("{seed:4} refused: {refusal}"),
        }
    }
    let [over_sigma, ..] = figures(&errors);
    assert!((0.8..1.25).contains(&over_sigma), "{over_sigma}");
}

/// Shift of the bands by each encoder, beyond that on the rendered frames: the figure of the
/// measurement's `ENCODER_SIGMA_LINES`.
///
/// `cargo test --release -p hil-sim --test it shift_of_encoders -- --ignored --nocapture`
#[test]
#[ignore = "minutes; prints a figure of ranges.md"]
fn shift_of_encoders() {
    let mut all = Vec::new();
    let mut of_each = vec![Vec::new(); ENCODERS.len()];
    for seed in 7_000..7_000 + drawn(12) {
        let scene = LedScene::filmed(seed, 48, 20.0);
        let frames = scene.frames();
        let raw = match scene.measure_in(&frames, None) {
            Ok(found) => scene.error(&found).lines,
            Err(refusal) => {
                println!("{seed:4} refused: {refusal} {scene:?}");
                continue;
            }
        };
        for (quality, shifts) in ENCODERS.into_iter().zip(&mut of_each) {
            let Ok(found) = scene.measure_in(&frames, Some(quality)) else {
                println!("{seed:4} refused {quality:?}");
                continue;
            };
            shifts.push(scene.error(&found).lines - raw);
        }
    }
    for (quality, shifts) in ENCODERS.into_iter().zip(of_each) {
        println!(
            "{quality:?}: {:.2} lines rms, {shifts:.2?}",
            rms(shifts.iter().copied())
        );
        all.extend(shifts);
    }
    println!("all: {:.2} lines rms", rms(all.into_iter()));
}
