//! The live view: what the operator sees while a session runs.
//!
//! - [`gauge`]: messages in, a [`Snapshot`] of the latest state out. Pure.
//! - [`draw`](mod@draw), `facts`: a snapshot onto a screen of any size. Pure.
//! - [`lines`]: a snapshot as one plain line, where there is no terminal.
//! - [`screen`]: the thread that owns the terminal.
//!
//! The session never waits for the terminal: it puts the latest snapshot into a
//! slot and goes on. A thread of its own takes what is there ten times a second
//! and draws it. A slow line only makes the picture old; a terminal that is closed
//! ends that thread and nothing else.

pub(crate) mod draw;
mod facts;
pub(crate) mod gauge;
pub(crate) mod lines;
pub(crate) mod screen;

use std::time::Duration;

use crate::tracked::Tracked;
use protocol::Ticks;
use serde::Serialize;

/// How often a new picture is made.
pub(crate) const PERIOD: Duration = Duration::from_millis(100);

/// The state of everything at one moment.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Snapshot {
    /// What the session does: `monitor`, `twist 1`, `recording`, ...
    pub(crate) state: String,
    /// The board's ID.
    pub(crate) board: String,
    /// Latest board time.
    pub(crate) now: Ticks,
    /// The board's gyroscope over the last seconds: board time in s, rad/s.
    #[serde(skip)]
    pub(crate) gyro: Vec<(f64, [f64; 3])>,
    /// The trigger.
    pub(crate) trigger: Trigger,
    /// The relation of the clocks, once there is one.
    pub(crate) clock: Option<Clock>,
    /// What the further trigger outputs and the lidar do, by the sensor's name.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) sensors: Vec<Sensor>,
    /// Phones beside the one that the trigger is aligned to.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) phones: Vec<OtherPhone>,
    /// Samples and messages a second.
    pub(crate) rates: Rates,
    /// What was lost.
    pub(crate) losses: Losses,
    /// The disk, while something is recorded.
    pub(crate) disk: Option<Disk>,
    /// The recording, while it runs.
    pub(crate) recording: Option<Recording>,
    /// The twist, while it runs.
    pub(crate) twist: Option<Twist>,
    /// The last marks: board time and label.
    pub(crate) markers: Vec<(Ticks, String)>,
    /// What is wrong, and what to do; the latest last.
    pub(crate) warnings: Vec<Warning>,
    /// What was said last, the latest last.
    #[serde(skip)]
    pub(crate) said: Vec<String>,
    /// What the keys do now.
    #[serde(skip)]
    pub(crate) keys: Keys,
}

/// The trigger.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Trigger {
    /// State of the train in words; empty before the first status.
    pub(crate) state: String,
    /// Pulses a second, from the period.
    pub(crate) fps: Option<f64>,
    /// Number of the last pulse.
    pub(crate) pulse: Option<u64>,
    /// The last pulse against the grid on the phone's frames, µs.
    pub(crate) phase_us: Option<f64>,
    /// 1-sigma of where that grid lies against the phone's frames now, µs, without that of the
    /// constant between the cameras.
    pub(crate) phase_sigma_us: Option<f64>,
    /// That is more than a twist may have: it is time for another.
    pub(crate) twist_due: bool,
    /// The phase, where the phone's clock is followed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) tracked: Option<Tracked>,
    /// From the edge to the wire, ns; nothing if it was not seen.
    pub(crate) readback_ns: Option<f64>,
    /// Pulses that the wire did not show.
    pub(crate) readback_missing: u32,
    /// Edges that came late.
    pub(crate) late: u32,
}

/// The relation of the clocks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Clock {
    /// Phone minus board now, s.
    pub(crate) offset_s: f64,
    /// Expected error of it now, 1-sigma, µs.
    pub(crate) sigma_us: f64,
    /// Rate of the phone, ppm.
    pub(crate) skew_ppm: f64,
    /// Time since its data, s.
    pub(crate) age_s: f64,
}

/// A sensor on a further trigger output, or a lidar.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Sensor {
    /// What it is called; where it is connected if that is not known.
    pub(crate) name: String,
    /// Where it is connected: `output 2`, `gnss`.
    pub(crate) at: String,
    /// State of the train in words; empty before the first status.
    pub(crate) state: String,
    /// Pulses a second.
    pub(crate) rate: f64,
    /// Number of its last pulse, or of the pulses per second so far.
    pub(crate) pulse: Option<u64>,
    /// Edges that came late, and sentences that were left out.
    pub(crate) late: u32,
    /// The UTC that a lidar was told last, in seconds since 1970.
    pub(crate) utc: Option<i64>,
}

impl Sensor {
    /// The UTC as text.
    pub(crate) fn utc_text(&self) -> Option<String> {
        let time = jiff::Timestamp::from_second(self.utc?).ok()?;
        Some(time.strftime("%Y-%m-%d %H:%M:%S UTC").to_string())
    }
}

/// A phone beside the one that the trigger is aligned to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct OtherPhone {
    /// What it is called.
    pub(crate) name: String,
    /// Its clock, once it is related.
    pub(crate) clock: Option<Clock>,
    /// Its frames against the depth images when its video began, as predicted: µs,
    /// and 1-sigma.
    pub(crate) placement_us: Option<(f64, f64)>,
}

/// Messages a second, over the last two.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Rates {
    /// IMU samples.
    pub(crate) imu: f64,
    /// Pulses.
    pub(crate) pulses: f64,
    /// Edges on the strobe input.
    pub(crate) captures: f64,
    /// Load of the board's processor, %.
    pub(crate) load_percent: f64,
    /// Temperature of the IMU, °C.
    pub(crate) temperature: Option<f64>,
    /// The IMU's state in words.
    #[serde(skip)]
    pub(crate) imu_running: Option<bool>,
}

/// What was lost since the begin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Losses {
    /// Messages by the board's numbers.
    pub(crate) messages: u64,
    /// Of these, dropped by the board itself.
    pub(crate) dropped: u64,
    /// Damaged frames.
    pub(crate) damaged: u64,
    /// How often the link was lost.
    pub(crate) reconnects: u32,
}

/// The disk.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Disk {
    /// Free, bytes.
    pub(crate) free: u64,
    /// How long a recording can still go on at the rate so far, s.
    pub(crate) left_s: Option<f64>,
}

/// A recording that runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Recording {
    /// So long, s.
    pub(crate) elapsed_s: f64,
    /// Of so much, s; until it is stopped if there is none.
    pub(crate) length_s: Option<f64>,
}

/// A twist that runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Twist {
    /// So long, s.
    pub(crate) elapsed_s: f64,
    /// Of so much, s.
    pub(crate) length_s: f64,
    /// Expected 1-sigma of the offset from the motion so far, µs.
    pub(crate) sigma_us: Option<f64>,
    /// What is enough, µs.
    pub(crate) enough_us: f64,
    /// Root mean square of each axis, rad/s.
    pub(crate) rms: [f64; 3],
}

impl Twist {
    /// Whether the motion so far suffices.
    pub(crate) fn is_enough(&self) -> bool {
        self.sigma_us.is_some_and(|sigma| sigma <= self.enough_us)
    }

    /// What to do, in words.
    pub(crate) fn advice(&self) -> &'static str {
        let enough = if self.is_enough() {
            "enough: hold still when the time is up"
        } else {
            "go on"
        };
        lacking_motion(self.rms).unwrap_or(enough)
    }
}

/// What a twist lacks with this motion of the axes, rad/s rms.
pub(crate) fn lacking_motion(rms: [f64; 3]) -> Option<&'static str> {
    let mut sorted = rms;
    sorted.sort_by(f64::total_cmp);
    if sorted[2] < 0.5 {
        Some("twist faster")
    } else if sorted[1] < 0.3 {
        Some("twist about another axis too")
    } else {
        None
    }
}

/// Something that is wrong.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Warning {
    /// Board time.
    pub(crate) at: Ticks,
    /// What.
    pub(crate) text: String,
    /// What to do about it.
    pub(crate) todo: &'static str,
}

/// What the keys do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Keys {
    /// Only to look at: stop, help.
    #[default]
    Look,
    /// A question was asked: go on, repeat, leave out, quit.
    Answer,
    /// While recording: mark, stop.
    Record,
}

/// What to do about a kind of problem, in one line.
pub(crate) fn todo_for(kind: &str) -> &'static str {
    match kind {
        "link_lost" => "check the USB cable; it is taken up again by itself",
        "pulses_missing" | "phase_off" | "trigger_late" => {
            "stop and record again; `trigger status` says more"
        }
        "readback_missing" => "check the trigger's wire and buffer",
        "imu_gap" | "imu_gone" | "imu_recovered" | "imu_late" => {
            "check the IMU's wires; the trigger is not affected"
        }
        "pulse_messages_lost" | "captures_lost" | "status_lost" => {
            "nothing to do: counted, and times are not affected"
        }
        "depth_recorder_gone" => "look at depth_recorder.log; start the recording again",
        "phone_lost" => "check the phone: app in the foreground, same network",
        "disk_nearly_full" => "free some space",
        "track_lost" => "check the phone's cable and `adb devices`",
        "twist_due" => "stop, and record again when the phase matters",
        "twist_refused" => "twist again, faster, about all axes",
        _ => "see the recording's report",
    }
}
