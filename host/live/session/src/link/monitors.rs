//! The monitors of the board's messages, and the one place that every message passes: it is
//! watched, converted to SI units, published and written.

use std::time::Duration;

use board::Stream;
use board::imu::{ImuLook, Sample};
use clock::push_board_sample;
use protocol::{Arrived, DeviceToHost, ImuFlags, ImuSample, Ticks};
use recording::session_file::{SessionFile, Span};
use recording::strobes::ExposureFinder;
use twist_sync::GyroTrack;

use crate::error::Stop;
use crate::event::SessionEvent;
use crate::link::BoardLink;
use crate::link::watch::Watch;
use crate::log::Log;
use board::finding::Finding;

/// The monitors of the board's messages.
#[derive(Default)]
pub struct Monitors {
    /// Watch over the messages, while recording.
    pub watch: Option<Watch>,
    /// Findings of the watch that were not reported yet.
    pub(crate) findings: Vec<Finding>,
    /// Statistics of the IMU's samples, while it is checked.
    pub(crate) look: Option<ImuLook>,
    /// Gyroscope samples, during a twist.
    pub(crate) gyro: Option<BoardGyro>,
    /// Smallest difference of the computer's clock and the time of a status, s.
    least_ahead_s: Option<f64>,
    /// Temperature of the IMU, °C, from its last sample.
    pub(crate) temperature: Option<f64>,
    /// Exposures that a photodiode sees, once the trigger runs.
    pub(crate) exposures: Option<ExposureFinder>,
    /// The last arrival that the board reported.
    pub(crate) arrived: Option<Arrived>,
}

/// Samples of the board's gyroscope during a twist.
#[derive(Default)]
pub(crate) struct BoardGyro {
    pub(crate) track: GyroTrack,
    /// Times of the first and the last sample of the track.
    pub(crate) span: Span,
    /// Number of samples that were left out because the board marked them as late (their rates
    /// may be those of another sample) or as saturated.
    pub(crate) marked: usize,
}

impl BoardGyro {
    fn add(&mut self, sample: &Sample) {
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
    /// Returns the delay of a status from the board to its handling at `now`, relative to the
    /// fastest one so far.
    fn waited(&mut self, now: Duration, at: Ticks) -> Duration {
        let ahead_s = now.as_secs_f64() - at.as_secs_f64();
        let least_s = self.least_ahead_s.map_or(ahead_s, |s| s.min(ahead_s));
        self.least_ahead_s = Some(least_s);
        Duration::from_secs_f64(ahead_s - least_s)
    }

    /// Notes that messages of a stream are missing.
    pub(crate) fn lost(&mut self, stream: Stream, count: u32) {
        if let Some(look) = &mut self.look {
            look.gap();
        }
        if let Some(watch) = &mut self.watch {
            watch.lost(stream, count, &mut self.findings);
        }
    }

    /// Notes that the number of a message does not follow that of the previous one.
    pub(crate) fn disordered(&mut self, stream: Stream) {
        if let Some(watch) = &mut self.watch {
            watch.disordered(stream, &mut self.findings);
        }
    }

    /// Advances board time, after all messages up to `now` were handled.
    pub(crate) fn time(&mut self, now: Ticks) {
        if let Some(watch) = &mut self.watch {
            watch.time(now, &mut self.findings);
        }
    }

    /// Notes that the link was lost until `now`.
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
            gyro.add(sample);
        }
        if let Some(watch) = &mut self.watch {
            watch.imu(raw, &mut self.findings);
        }
    }

    fn message(&mut self, message: &DeviceToHost) {
        match (message, &mut self.exposures) {
            (DeviceToHost::Pulse(pulse), Some(finder)) if pulse.output.is_camera() => {
                finder.pulse(pulse.at);
            }
            (DeviceToHost::Capture(capture), Some(finder)) => finder.edge(capture.into()),
            _ => {}
        }
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

/// Returns true if the trigger had arrived on the phone's frames by this time. The flag of the
/// board applies to any grid.
fn is_on_phone(session: &SessionFile, at: Ticks) -> bool {
    let arrival = session.alignment.and_then(|alignment| alignment.arrival);
    arrival.is_some_and(|arrival| at >= arrival)
}

/// Handles one message of the board.
pub(crate) fn handle_message(
    link: &BoardLink<'_>,
    monitors: &mut Monitors,
    file: &SessionFile,
    log: &mut Log<'_>,
    message: DeviceToHost,
) -> Result<(), Stop> {
    let sample = match &message {
        DeviceToHost::Imu(raw) => Some(link.in_si(raw)),
        _ => None,
    };
    log.publish(SessionEvent::Board {
        message: message.clone(),
        sample,
    });
    let Some(writer) = &mut log.writer else {
        return Ok(());
    };
    monitors.message(&message);
    let profile = &file.profile;
    let at = match message {
        DeviceToHost::Imu(raw) => {
            if let Some(sample) = sample {
                monitors.sample(&raw, &sample);
                writer.imu(&sample, raw.seq)?;
            }
            raw.at
        }
        DeviceToHost::Pulse(mut pulse) if pulse.output.is_camera() => {
            pulse.aligned &= is_on_phone(file, pulse.at);
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
            // The computer's time of day is read on arrival.
            let waited = monitors.waited(link.board.now(), status.at);
            writer.status(&status, link.id(), waited)?;
            status.at
        }
        DeviceToHost::Arrived(arrived) => {
            let is_camera = arrived.output.is_camera();
            let name = if is_camera {
                String::from("the trigger")
            } else {
                profile.output_name(arrived.output)
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
            gyro.add(&sample);
        }
        let span = Span {
            from: Ticks(0),
            to: Ticks(2),
        };
        assert_eq!((gyro.track.len(), gyro.span, gyro.marked), (2, span, 2));
    }
}
