//! The simulated phone: OpenCamera Sensors behind a TCP port.
//!
//! It behaves as the app does, line by line: the four requests, the error for
//! anything else (an empty line included), the answer to `video_start` only
//! after frame 60, the refusal of `imu?…` during a video, the record button
//! that toggles, one client at a time, files saved by date; and as rudely: a stop that
//! takes its time, a phase that is left from another video, presses that are ignored,
//! requests that end the app, requests of clients that have gone ([`AppConfig`]).
//! `server` and `in_process` speak with clients, with and without a socket; `app` decides,
//! `recorder` is the video's, `sensors` and `camera` make the data. Code that follows a line of
//! the app's source names it.
//!
//! The phone lives on the rig's true time ([`TrueClock`]), however fast that
//! passes. It has a clock of its own ([`Oscillator`]); all its timestamps are of
//! that clock. What it answers is a function of its configuration, the rig's
//! motion, the flashes, and the true times at which it was asked.
//!
//! Limits: the app stays in the foreground, its phone has no magnetometer (whose files are
//! empty); its own latencies are constants of one phone; the sensors' low-pass is the
//! one of [`crate::motion::inertial_channel`]; the camera sees even light only; the
//! phone never runs out of space or battery.

mod app;
mod camera;
mod clock_server;
mod config;
mod files;
mod in_process;
mod java;
mod recorder;
mod request;
mod sensors;
mod server;

use std::net::SocketAddr;
use std::sync::Arc;
use std::thread::JoinHandle;

use anyhow::{Context as _, Result};

use crate::clocks::link_delay::LinkRanges;
use crate::clocks::oscillator::Oscillator;
use crate::clocks::true_clock::TrueClock;
use crate::depth_camera::flash_log::FlashLog;
use crate::motion::gesture::Gesture;
use crate::motion::{Motion, MotionSpec};
use crate::random::{Random, Seed, Stream};

use sensors::{Kind, Sensors};
use server::Link;

pub use app::{App, VideoTruth};
pub use camera::FrameTimes;
pub use clock_server::ClockServer;
pub use config::{AppConfig, CameraConfig, PhoneConfig, SensorConfig, StorageAccess, VideoMode};
pub use in_process::{Answer, AskedPhone, RequestId};
pub use server::LinkFault;

/// The rig around a phone.
#[derive(Clone)]
pub struct Surroundings {
    /// True time as it passes.
    pub clock: TrueClock,
    /// The motion of the rig.
    pub motion: Arc<Motion>,
    /// The flashes of the depth camera and of the board's LED.
    pub light: [FlashLog; 2],
}

impl Surroundings {
    /// Returns the surroundings of a phone that is carried on a walk, without a depth camera.
    #[must_use]
    pub fn walking(seed: Seed, clock: TrueClock) -> Self {
        let walk = MotionSpec::always(Gesture::Walk);
        Self {
            clock,
            motion: walk.build(seed.stream(Stream::Motion)),
            light: Default::default(),
        }
    }
}

/// A running phone. It is switched off when dropped.
pub struct SimPhone {
    /// The app on it.
    pub app: Arc<App>,
    link: Arc<Link>,
    thread: Option<JoinHandle<()>>,
}

impl SimPhone {
    /// Switches a phone on. It listens on `port` of the loopback interface; 0
    /// takes a free one.
    ///
    /// # Errors
    ///
    /// The port is taken, or there is no folder for the phone's files.
    pub fn start(config: PhoneConfig, surroundings: Surroundings, port: u16) -> Result<Self> {
        let link = Link::open(port)
            .with_context(|| format!("the simulated phone cannot listen on 127.0.0.1:{port}"))?;
        let link = Arc::new(link);
        let app = Arc::new(App::new(config, surroundings)?);
        let thread = {
            let (app, link) = (Arc::clone(&app), Arc::clone(&link));
            std::thread::spawn(move || server::serve(&app, &link))
        };
        Ok(Self {
            app,
            link,
            thread: Some(thread),
        })
    }

    /// Returns its address.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.link.address()
    }

    /// Serves the readings of its clocks on a port of its own, with the delays of such a link.
    ///
    /// # Errors
    ///
    /// There is no port.
    pub fn serve_clock(&self, link: &LinkRanges) -> std::io::Result<ClockServer> {
        ClockServer::start(Arc::clone(&self.app), link)
    }

    /// Ends the app if it has not ended itself, and opens it again.
    ///
    /// # Errors
    ///
    /// Someone else has taken its port.
    pub fn reopen_app(&self) -> std::io::Result<()> {
        self.app.reopen();
        self.link.cut();
        self.link.join()
    }

    /// Takes the phone off the network: connections end, new ones are refused.
    pub fn leave_network(&self) {
        self.link.leave();
    }

    /// Brings the phone back to the network, at the same address.
    ///
    /// # Errors
    ///
    /// Someone else has taken its port.
    pub fn join_network(&self) -> std::io::Result<()> {
        self.link.join()
    }

    /// Adds a fault to the answers from now on.
    pub fn set_fault(&self, fault: Option<LinkFault>) {
        self.link.set_fault(fault);
    }
}

impl Drop for SimPhone {
    fn drop(&mut self) {
        self.app.close();
        self.link.cut();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        // Files of the temporary folder may still be being written: they are finished before it is
        // removed.
        let _ = self.app.wait_saved();
    }
}

/// The samples of a phone's gyroscope in a span of its boot clock, as `imu?` would answer
/// them: timestamps in nanoseconds, angular rates in rad/s. For studies without the app.
#[must_use]
pub fn gyroscope_samples(
    config: &PhoneConfig,
    oscillator: &Oscillator,
    motion: Arc<Motion>,
    span: std::ops::Range<i64>,
) -> Vec<(i64, [f32; 3])> {
    let sensors = Sensors::new(config, oscillator.clone(), motion);
    let samples = sensors.samples(Kind::Gyroscope, span.start, span.end);
    let pair = |sample: sensors::Sample| (sample.time_ns, sample.values);
    samples.into_iter().map(pair).collect()
}

/// A stream of random numbers for part `k` of one use.
fn substream(seed: Seed, stream: Stream, k: u64) -> Random {
    // SplitMix64's finaliser: neighbouring `k` give unrelated seeds.
    let mut z = seed
        .0
        .wrapping_add(k.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    Seed(z ^ (z >> 31)).stream(stream)
}
