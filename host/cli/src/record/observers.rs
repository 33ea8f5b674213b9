//! Who looks at the board's messages as they go by, and the one place through which
//! every message goes: it is watched, put into SI units, shown and written.

use protocol::{Arrived, DeviceToHost, ImuSample, Ticks};

use super::Stop;
use super::journal::Journal;
use super::link::BoardLink;
use board::Stream;
use board::imu::{ImuLook, Sample};
use recording::finding::Finding;
use recording::finding::Severity;
use recording::session_file::SessionFile;
use session::watch::Watch;

/// Who looks on.
#[derive(Default)]
pub struct Observers {
    /// Set while recording.
    pub watch: Option<Watch>,
    /// What the watch has found.
    pub(super) findings: Vec<Finding>,
    /// The IMU's samples, while it is checked.
    pub(super) look: Option<ImuLook>,
    /// Gyroscope samples, while a twist is taken.
    pub(super) gyro: Option<Vec<(Ticks, [f64; 3])>>,
    /// Temperature of the IMU, °C, from its last sample.
    pub(super) temperature: Option<f64>,
    /// The last arrival that was reported.
    pub(super) arrived: Option<Arrived>,
}

impl Observers {
    /// Messages of a stream are missing.
    pub(super) fn lost(&mut self, stream: Stream, count: u32) {
        if let Some(look) = &mut self.look {
            look.gap();
        }
        if let Some(watch) = &mut self.watch {
            watch.lost(stream, count, &mut self.findings);
        }
    }

    /// A message's number does not follow on the one before.
    pub(super) fn disordered(&mut self, stream: Stream) {
        if let Some(watch) = &mut self.watch {
            watch.disordered(stream, &mut self.findings);
        }
    }

    /// All that had come by this time was taken.
    pub(super) fn time(&mut self, now: Ticks) {
        if let Some(watch) = &mut self.watch {
            watch.time(now, &mut self.findings);
        }
    }

    /// The link was lost until now.
    pub(super) const fn resume(&mut self, now: Ticks) {
        if let Some(watch) = &mut self.watch {
            watch.resume(now);
        }
    }

    fn sample(&mut self, raw: &ImuSample, sample: &Sample) {
        self.temperature = Some(sample.temperature);
        if let Some(look) = &mut self.look {
            look.add(sample);
        }
        if let Some(gyro) = &mut self.gyro {
            gyro.push((sample.at, sample.gyro));
        }
        if let Some(watch) = &mut self.watch {
            watch.imu(raw, &mut self.findings);
        }
    }

    fn message(&mut self, message: &DeviceToHost) {
        match (message, &mut self.watch) {
            (DeviceToHost::Pulse(pulse), Some(watch)) if pulse.output.is_camera() => {
                watch.pulse(pulse, &mut self.findings);
            }
            (DeviceToHost::Status(status), Some(watch)) => {
                watch.status(status, &mut self.findings);
            }
            (DeviceToHost::Arrived(arrived), _) if arrived.output.is_camera() => {
                self.arrived = Some(*arrived);
            }
            _ => {}
        }
    }
}

/// Whether the trigger had arrived on the phone's frames, or was started on them after a
/// reset. The board says of any grid that a pulse is on it.
fn is_on_phone(session: &SessionFile, at: Ticks) -> bool {
    let since = match session.runs.last() {
        Some(run) => run.anchor,
        None => session.alignment.and_then(|alignment| alignment.arrival),
    };
    since.is_some_and(|since| at >= since)
}

/// A message of the board, with its times on the recording's axis.
pub(super) fn take_message(
    link: &mut BoardLink<'_>,
    observers: &mut Observers,
    journal: &mut Journal<'_>,
    message: DeviceToHost,
) -> Result<(), Stop> {
    journal.live.take(&message, link.scale());
    let Some(writer) = &mut journal.writer else {
        return Ok(());
    };
    observers.message(&message);
    let profile = &journal.file.profile;
    let clock = journal.file.clock;
    let phone_time = |at| clock.map(|clock| clock.ticks_to_phone(at));
    let (at, written) = match message {
        DeviceToHost::Imu(raw) => {
            let sample = link.in_si(&raw);
            observers.sample(&raw, &sample);
            (raw.at, writer.imu(&sample))
        }
        DeviceToHost::Pulse(mut pulse) if pulse.output.is_camera() => {
            pulse.aligned &= is_on_phone(&journal.file, pulse.at);
            (pulse.at, writer.pulse(&pulse, phone_time(pulse.at)))
        }
        DeviceToHost::Pulse(pulse) => {
            let name = profile.output_name(pulse.output);
            (pulse.at, writer.output_pulse(&pulse, &name))
        }
        DeviceToHost::Capture(capture) => {
            let phone = phone_time(capture.at);
            (capture.at, writer.capture(&capture, phone))
        }
        DeviceToHost::Status(status) => (status.at, writer.status(&status, &link.id)),
        DeviceToHost::Arrived(arrived) => {
            let (kind, name) = match arrived.output.is_camera() {
                true => ("arrived", String::from("the trigger")),
                false => ("output_arrived", profile.output_name(arrived.output)),
            };
            let (pulse, remaining) = (arrived.pulse, arrived.remaining.0);
            let text = format!("{name} arrived at pulse {pulse}, {remaining} ticks from its grid");
            let written = writer.log(arrived.at, Severity::Good, kind, &text);
            (arrived.at, written)
        }
        DeviceToHost::Pps(pps) => (pps.at, writer.pps(&pps, profile.lidar_name())),
        DeviceToHost::Hello(hello) => (
            hello.now,
            writer.log(hello.now, Severity::Good, "hello", "the board said hello"),
        ),
        DeviceToHost::Answer(_) | DeviceToHost::Filler(_) => return Ok(()),
    };
    written?;
    journal.advance(at)
}
