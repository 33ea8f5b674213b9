//! The monitors of the board's messages, and the one place through which every message
//! goes: it is watched, put into SI units, reported and written.

use std::time::Duration;

use board::Stream;
use board::imu::{ImuLook, Sample};
use clock::push_board_sample;
use protocol::{Arrived, DeviceToHost, ImuFlags, ImuSample, Ticks};
use recording::session_file::{SessionFile, Span};
use twist_sync::GyroTrack;

use crate::error::Stop;
use crate::event::SessionEvent;
use crate::link::BoardLink;
use crate::link::watch::Watch;
use crate::log::Log;
use board::finding::Finding;

/// The monitors.
#[derive(Default)]
pub struct Monitors {
    /// Set while recording.
    pub watch: Option<Watch>,
    /// What the watch has found.
    pub(crate) findings: Vec<Finding>,
    /// The IMU's samples, while it is checked.
    pub(crate) look: Option<ImuLook>,
    /// Gyroscope samples, while a twist is taken.
    pub(crate) gyro: Option<BoardGyro>,
    /// The least by which the computer's clock was ahead of a status' time, s.
    least_ahead_s: Option<f64>,
    /// Temperature of the IMU, °C, from its last sample.
    pub(crate) temperature: Option<f64>,
    /// The last arrival that was reported.
    pub(crate) arrived: Option<Arrived>,
}

/// Samples of the board's gyroscope in a twist.
#[derive(Default)]
pub(crate) struct BoardGyro {
    pub(crate) track: GyroTrack,
    /// Times of the first and the last sample of the track.
    pub(crate) span: Span,
    /// Number of samples that the board has marked as late or saturated, which are not in the
    /// track: their rates are another sample's, or at the end of the range.
    pub(crate) marked: usize,
}

impl BoardGyro {
    fn take(&mut self, sample: &Sample) {
        if sample.flags.has(ImuFlags::LATE) || sample.flags.has(ImuFlags::SATURATED) {
            self.marked += 1;
            return;
        }
        if self.track.is_empty() {
            self.span.from = sample.at;
        }
        self.span.to = sample.at;
        push_board_sample(&mut self.track, self.span.from, sample.at, sample.gyro);
    }
}

impl Monitors {
    /// How long a status has waited before it was taken, beyond what the fastest took.
    fn waited(&mut self, now: Duration, at: Ticks) -> Duration {
        let ahead_s = now.as_secs_f64() - at.as_secs_f64();
        let least_s = self.least_ahead_s.map_or(ahead_s, |s| s.min(ahead_s));
        self.least_ahead_s = Some(least_s);
        Duration::from_secs_f64(ahead_s - least_s)
    }

    /// Messages of a stream are missing.
    pub(crate) fn lost(&mut self, stream: Stream, count: u32) {
        if let Some(look) = &mut self.look {
            look.gap();
        }
        if let Some(watch) = &mut self.watch {
            watch.lost(stream, count, &mut self.findings);
        }
    }

    /// A message's number does not follow on the one before.
    pub(crate) fn disordered(&mut self, stream: Stream) {
        if let Some(watch) = &mut self.watch {
            watch.disordered(stream, &mut self.findings);
        }
    }

    /// All that had come by this time was taken.
    pub(crate) fn time(&mut self, now: Ticks) {
        if let Some(watch) = &mut self.watch {
            watch.time(now, &mut self.findings);
        }
    }

    /// The link was lost until now.
    pub(crate) const fn resume(&mut self, now: Ticks) {
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
            gyro.take(sample);
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

/// Tells whether the trigger had arrived on the phone's frames. The board says of any grid that a
/// pulse is on it.
fn is_on_phone(session: &SessionFile, at: Ticks) -> bool {
    let arrival = session.alignment.and_then(|alignment| alignment.arrival);
    arrival.is_some_and(|arrival| at >= arrival)
}

/// Takes a message of the board.
pub(crate) fn take_message(
    link: &BoardLink<'_>,
    monitors: &mut Monitors,
    log: &mut Log<'_>,
    message: DeviceToHost,
) -> Result<(), Stop> {
    let sample = match &message {
        DeviceToHost::Imu(raw) => Some(link.in_si(raw)),
        _ => None,
    };
    log.tell(SessionEvent::Board {
        message: message.clone(),
        sample,
    });
    let Some(writer) = &mut log.writer else {
        return Ok(());
    };
    monitors.message(&message);
    let profile = &log.file.profile;
    let at = match message {
        DeviceToHost::Imu(raw) => {
            if let Some(sample) = sample {
                monitors.sample(&raw, &sample);
                writer.imu(&sample, raw.seq)?;
            }
            raw.at
        }
        DeviceToHost::Pulse(mut pulse) if pulse.output.is_camera() => {
            pulse.aligned &= is_on_phone(&log.file, pulse.at);
            writer.pulse(&pulse)?;
            pulse.at
        }
        DeviceToHost::Pulse(pulse) => {
            writer.output_pulse(&pulse, &profile.output_name(pulse.output))?;
            pulse.at
        }
        DeviceToHost::Capture(capture) => {
            writer.capture(&capture)?;
            capture.at
        }
        DeviceToHost::Status(status) => {
            // The computer's time of day is that of its arrival.
            let waited = monitors.waited(link.board.now(), status.at);
            writer.status(&status, link.id(), waited)?;
            status.at
        }
        DeviceToHost::Arrived(arrived) => {
            let is_camera = arrived.output.is_camera();
            let name = match is_camera {
                true => String::from("the trigger"),
                false => profile.output_name(arrived.output),
            };
            let event = SessionEvent::Arrived {
                name,
                is_camera,
                pulse: arrived.pulse,
                remaining: arrived.remaining.0,
            };
            log.report_at(arrived.at, event)?;
            arrived.at
        }
        DeviceToHost::Pps(pps) => {
            writer.pps(&pps, profile.lidar_name())?;
            pps.at
        }
        DeviceToHost::Hello(hello) => {
            log.report_at(hello.now, SessionEvent::Hello)?;
            hello.now
        }
        DeviceToHost::Answer(_) | DeviceToHost::Filler(_) => return Ok(()),
    };
    log.advance(at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_that_the_board_has_marked_are_not_in_the_twist() {
        let mut gyro = BoardGyro::default();
        let marks = [
            0,
            ImuFlags::LATE.0,
            ImuFlags::FIRST.0,
            ImuFlags::SATURATED.0,
        ];
        for (at, mark) in (0..).map(Ticks).zip(marks) {
            let flags = ImuFlags(mark);
            let sample = Sample {
                at,
                flags,
                ..Sample::default()
            };
            gyro.take(&sample);
        }
        let span = Span {
            from: Ticks(0),
            to: Ticks(2),
        };
        assert_eq!((gyro.track.len(), gyro.span, gyro.marked), (2, span, 2));
    }
}
