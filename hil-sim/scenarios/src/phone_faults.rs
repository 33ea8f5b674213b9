//! Runs of the phone's client against the simulated phone alone, without board and
//! firmware, while things go wrong: the client never leaves a video running that it began.
//!
//! Everything of a run is drawn from its seed: the phone and its settings, what goes wrong,
//! when, and when somebody presses Ctrl-C. What goes wrong ends sooner than the client
//! gives up; so at the end of a run nothing is left to be told. When a request meets a
//! fault depends on the machine's scheduler: a seed repeats the plan, not each byte.

use std::path::Path;
use std::str::FromStr as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Result;
use phone::{ImuRequest, PhoneClient, PhoneError, Settings, StopSignal, VideoTarget};
use rig::flash_log::Dark;
use rig::motion::MotionSpec;
use rig::oscillator::TrueTime;
use rig::phone::{LinkFault, PhoneConfig, SimPhone, StorageAccess, Surroundings, VideoMode};
use rig::random::{Random, Seed, Stream};
use rig::true_clock::TrueClock;

use crate::workers;

/// True time against real time.
const SPEED: f64 = 20.0;

/// Runs beside each other: they wait nearly all the time.
const BESIDE: usize = 16;

/// Patience of the client: 40 s of the phone's.
const MARGIN: Duration = Duration::from_secs(2);

/// How long the client tries to stop its video: more than a fault lasts and another
/// client's requests keep the phone busy.
const STOP_PATIENCE: Duration = Duration::from_secs(12);

/// When the last fault has begun at the latest, ms as [`pass`] counts them: a session
/// without faults lasts about as long.
const LATEST_MS: f64 = 600.0;

/// What goes wrong once in a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    /// Somebody presses the record button on the phone.
    Press,
    /// Another client stays connected, or wants to be.
    OtherClient,
    /// The phone is off the network.
    Away,
    /// The connection breaks within an answer.
    Cut,
    /// Nothing is answered.
    Silent,
    /// The answers trickle.
    Slow,
    /// The app is in the background.
    Background,
    /// The app ends, and is opened again.
    Crash,
    /// Somebody presses Ctrl-C.
    Cancel,
}

const FAULTS: [Fault; 9] = [
    Fault::Press,
    Fault::OtherClient,
    Fault::Away,
    Fault::Cut,
    Fault::Silent,
    Fault::Slow,
    Fault::Background,
    Fault::Crash,
    Fault::Cancel,
];

/// What happened in a run.
#[derive(Clone, Debug)]
pub struct Run {
    /// Its seed.
    pub seed: u64,
    /// What went wrong, and how the client's requests ended, in words.
    pub story: String,
    /// A video of the client has begun on the phone at all.
    pub began: bool,
    /// One runs at the end.
    pub left_running: bool,
}

/// Runs all seeds, some beside each other; `told` gets each as it ends.
///
/// # Errors
///
/// A simulated phone cannot be started.
pub fn campaign(seeds: &[u64], told: &(dyn Fn(&Run) + Sync)) -> Result<Vec<Run>> {
    let runs = workers::each(seeds, BESIDE, |&seed| {
        let run = run(seed)?;
        told(&run);
        Ok(run)
    });
    runs.into_iter().collect()
}

fn run(seed: u64) -> Result<Run> {
    let mut random = Seed(seed).stream(Stream::Test);
    let mut config = PhoneConfig::draw(Seed(seed));
    config.camera.rows = 32;
    config.camera.columns = 16;
    config.video = VideoMode::Never;
    if random.chance(0.3) {
        config.app.storage = StorageAccess::Documents;
    }
    if random.chance(0.1) {
        // The phase comes after the app's own timeout.
        config.camera.frame_period_ns = 200e6;
    }
    let clock = TrueClock::run_at(SPEED);
    let phone = start(config, &clock, seed)?;
    let folder = tempfile::tempdir()?;
    let plan: Vec<(Fault, f64, f64)> = (0..1 + pick(&mut random, 2))
        .map(|_| {
            let fault = FAULTS[pick(&mut random, FAULTS.len())];
            let begin = random.uniform(0.0, LATEST_MS);
            (fault, begin, random.uniform(50.0, 2_000.0))
        })
        .collect();
    let cancelled = Arc::new(AtomicBool::new(false));
    let story = std::thread::scope(|scope| {
        for &happening in &plan {
            let (phone, clock, cancelled) = (&phone, &clock, &*cancelled);
            scope.spawn(move || happen(phone, clock, cancelled, happening));
        }
        session(&phone, &clock, &cancelled, folder.path())
    });
    phone.set_fault(None);
    // Whoever waits in the socket is heard now; a start takes at most 10 s.
    pass(&clock, 15_000.0 / SPEED);
    let videos = phone.videos();
    let run = Run {
        seed,
        story: format!("{plan:?}: {story}"),
        began: videos.iter().any(|video| !video.by_hand),
        left_running: phone.is_recording() && videos.last().is_some_and(|video| !video.by_hand),
    };
    clock.stop();
    Ok(run)
}

fn start(config: PhoneConfig, clock: &TrueClock, seed: u64) -> Result<SimPhone> {
    let rest = MotionSpec::from_str("rest").map_err(anyhow::Error::msg)?;
    let surroundings = Surroundings {
        clock: clock.clone(),
        motion: rest.build(Seed(seed).stream(Stream::Motion))?,
        light: Arc::new(Dark),
    };
    SimPhone::start(config, surroundings, 0)
}

fn pick(random: &mut Random, count: usize) -> usize {
    (random.uniform(0.0, count as f64) as usize).min(count.saturating_sub(1))
}

/// Waits for so many milliseconds of real time, or, on a machine that does not keep
/// [`SPEED`], for as much of true time.
fn pass(clock: &TrueClock, ms: f64) {
    let nanos = clock.now().as_nanos() + (ms * 1e6 * SPEED) as u64;
    // Nobody stops it before.
    let _ = clock.wait_until(TrueTime::from_nanos(nanos));
}

/// One fault, from its begin to its end.
fn happen(
    phone: &SimPhone,
    clock: &TrueClock,
    cancelled: &AtomicBool,
    (fault, begin, length): (Fault, f64, f64),
) {
    pass(clock, begin);
    match fault {
        Fault::Press => phone.press_record(),
        Fault::Cancel => cancelled.store(true, Ordering::Relaxed),
        Fault::OtherClient => {
            let other = std::net::TcpStream::connect(phone.address());
            pass(clock, length);
            drop(other);
        }
        Fault::Away => {
            phone.leave_network();
            pass(clock, length);
            // Another fault may have brought it back.
            let _ = phone.join_network();
        }
        Fault::Cut => phone.set_fault(Some(LinkFault::CutAfter(length as u64 % 60))),
        Fault::Silent => phone.set_fault(Some(LinkFault::Silent)),
        Fault::Slow => phone.set_fault(Some(LinkFault::Slow(200))),
        Fault::Background => {
            phone.send_to_background();
            pass(clock, length);
            if !phone.bring_to_foreground().unwrap_or(false) {
                // Its owner leaves it and opens it again.
                pass(clock, 500.0);
                let _ = phone.reopen_app();
            }
        }
        Fault::Crash => {
            phone.leave_network();
            let _ = phone.reopen_app();
        }
    }
    if matches!(fault, Fault::Cut | Fault::Silent | Fault::Slow) {
        pass(clock, length);
        phone.set_fault(None);
    }
}

/// What a session asks of the phone. However it goes, a video that it began is stopped.
fn session(
    phone: &SimPhone,
    clock: &TrueClock,
    cancelled: &Arc<AtomicBool>,
    folder: &Path,
) -> String {
    let asked_to_stop = Arc::clone(cancelled);
    let settings = Settings {
        margin: MARGIN,
        busy: Duration::from_secs(1),
        video_ready: MARGIN,
        stop: StopSignal::new(move || asked_to_stop.load(Ordering::Relaxed)),
        ..Settings::default()
    };
    let address = phone.address().to_string();
    let recorded = PhoneClient::connect(&address, settings.clone()).and_then(|mut client| {
        client.imu(ImuRequest::gyroscope(Duration::from_secs(2)))?;
        let asked = client.clock()?;
        let started = client.start_video(asked);
        started.map_err(|error| client.undo_start(error))?;
        pass(clock, 300.0);
        Ok(())
    });
    let story = match recorded {
        Ok(()) => String::from("started"),
        Err(error) => return error.to_string(),
    };
    let calm = Settings {
        stop: StopSignal::default(),
        ..settings
    };
    let stopped = stop(&address, &calm);
    let fetched = stopped.and_then(|mut client| {
        let target = VideoTarget::Folder(folder.to_owned());
        client.get_video(&target, false, &mut |_, _| ())
    });
    match fetched {
        Ok(_) => format!("{story}, stopped and fetched"),
        Err(error) => format!("{story}, then: {error}"),
    }
}

/// Stops the video, again and again while that fails, as a session does.
fn stop(address: &str, settings: &Settings) -> Result<PhoneClient, PhoneError> {
    let begun = Instant::now();
    loop {
        let stopped = PhoneClient::connect(address, settings.clone())
            .and_then(|mut client| client.stop_video().map(|()| client));
        match stopped {
            Err(_) if begun.elapsed() < STOP_PATIENCE => {
                std::thread::sleep(Duration::from_millis(100));
            }
            other => return other,
        }
    }
}
