//! What comes from the board: each message is recorded, watched and shown, and what it
//! says about the session itself is taken up.

use protocol::{DeviceToHost, Reply};

use super::Stop;
use super::relink::restarted;
use super::rig::Rig;
use crate::outcome::Failure;
use board::BoardError;
use board::Event;
use recording::writer::Severity;
use timebase::ClockModel;

impl Rig<'_> {
    /// Records, watches and shows what came.
    pub(super) fn take(&mut self, event: Event) -> Result<(), Stop> {
        let now = self.now;
        let Some(writer) = &mut self.writer else {
            return Ok(());
        };
        let written = match event {
            Event::Frame(frame) => writer.frame(now, frame),
            Event::Message(message) => {
                let message = self.axis.message(message);
                self.message(message)?;
                return Ok(());
            }
            Event::Lost { stream, count } => {
                self.live.gauge.lost(count);
                if let Some(look) = &mut self.look {
                    look.gap();
                }
                if let Some(watch) = &mut self.watch {
                    watch.lost(stream, count, &mut self.findings);
                }
                writer.log(
                    now,
                    Severity::Warning,
                    "lost",
                    &format!("{count} {stream} lost on the link"),
                )
            }
            Event::Damaged(error) => {
                self.live.gauge.damaged();
                writer.log(now, Severity::Warning, "damaged", &error.to_string())
            }
            Event::Restarted { .. } => {
                let recording = self.watch.is_some() || self.closing;
                let last = now;
                self.trigger_started = false;
                self.begin_run()?;
                if recording {
                    return Ok(());
                }
                return Err(restarted(last).into());
            }
            Event::OtherVersion { found } => {
                return Err(Failure::from(BoardError::OtherVersion { found }).into());
            }
            Event::Answer(answer) => {
                // Calls take their answers themselves.
                if let Ok(Reply::Pong { received, .. }) = answer.result {
                    self.axis.answered(answer.id, self.board.now(), received);
                }
                Ok(())
            }
            Event::Expired { id } => {
                self.axis.expired(id);
                Ok(())
            }
        };
        written.map_err(|error| Failure::from(error).into())
    }

    fn message(&mut self, message: DeviceToHost) -> Result<(), Stop> {
        self.live.take(&message, &self.scale);
        let Some(writer) = &mut self.writer else {
            return Ok(());
        };
        let phone_time =
            |clock: Option<ClockModel>, at| clock.map(|clock| clock.ticks_to_phone(at));
        let (at, written) = match message {
            DeviceToHost::Imu(raw) => {
                if let Some(scale) = self.next_scale.and_then(|next| next.of(&raw)) {
                    self.next_scale = None;
                    self.scale = scale;
                }
                let sample = self.scale.apply(&raw);
                if let Some(look) = &mut self.look {
                    look.add(&sample);
                }
                if let Some(gyro) = &mut self.gyro {
                    gyro.push((sample.at, sample.gyro));
                }
                if let Some(watch) = &mut self.watch {
                    watch.imu(&raw, &mut self.findings);
                }
                (raw.at, writer.imu(&sample))
            }
            DeviceToHost::Pulse(pulse) => {
                if let Some(watch) = &mut self.watch {
                    watch.pulse(&pulse, &mut self.findings);
                }
                (
                    pulse.at,
                    writer.pulse(&pulse, phone_time(self.clock, pulse.at)),
                )
            }
            DeviceToHost::Capture(capture) => (
                capture.at,
                writer.capture(&capture, phone_time(self.clock, capture.at)),
            ),
            DeviceToHost::Status(status) => {
                if let Some(watch) = &mut self.watch {
                    watch.status(&status, &mut self.findings);
                }
                (status.at, writer.status(&status, &self.board_id))
            }
            DeviceToHost::Arrived(arrived) => {
                self.arrived = Some(arrived);
                let text = format!(
                    "the trigger arrived at pulse {}, {} ticks from its grid",
                    arrived.pulse, arrived.remaining.0
                );
                (
                    arrived.at,
                    writer.log(arrived.at, Severity::Info, "arrived", &text),
                )
            }
            DeviceToHost::OutputPulse(output) => {
                let name = self.profile.output_name(output.output);
                (output.pulse.at, writer.output_pulse(&output.pulse, &name))
            }
            DeviceToHost::OutputArrived(arrived) => {
                let text = format!(
                    "{} arrived at pulse {}, {} ticks from its grid",
                    self.profile.output_name(arrived.output),
                    arrived.pulse,
                    arrived.remaining.0
                );
                (
                    arrived.at,
                    writer.log(arrived.at, Severity::Info, "output_arrived", &text),
                )
            }
            DeviceToHost::Pps(pps) => (pps.at, writer.pps(&pps, self.profile.lidar_name())),
            DeviceToHost::Hello(hello) => (
                hello.now,
                writer.log(hello.now, Severity::Info, "hello", "the board said hello"),
            ),
            DeviceToHost::Answer(_) | DeviceToHost::Filler(_) => (self.now, Ok(())),
        };
        self.now = self.now.max(at);
        written.map_err(|error| Failure::from(error).into())
    }
}
