//! Writes messages of the board and events of the session as ROS 2 messages on their topics.

use std::time::{Duration, UNIX_EPOCH};

use protocol::{CaptureChannel, Edge, EdgeGrid, Ticks};

use super::RecordingError;
use super::diagnostics::diagnostics;
use super::messages::{
    Capture, ClockExchange, ClockModel, Header, Imu, ImuFlags, LinkFrame, Log, Pulse, Temperature,
    Time, TimeReference, TriggerPeriod,
};
use super::topic::Item;
use super::writer::Writer;
use board::finding::Severity;
use board::imu::Sample;
use clock::PhoneNanos;
use clock::{BoardSeconds, ClockRelation};

impl Writer {
    /// Writes an IMU sample with its number from the board.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be written.
    pub fn imu(&mut self, sample: &Sample, number: u32) -> Result<(), RecordingError> {
        let header = Header::at(sample.at, "board_imu");
        let has = |flag| sample.flags.has(flag);
        if sample.flags != protocol::ImuFlags::default() {
            let flags = Item::ImuFlags(ImuFlags {
                header: header.clone(),
                late: has(protocol::ImuFlags::LATE),
                saturated: has(protocol::ImuFlags::SATURATED),
                first: has(protocol::ImuFlags::FIRST),
                after_loss: has(protocol::ImuFlags::AFTER_LOSS),
            });
            self.write(sample.at, None, flags)?;
        }
        let imu = Item::Imu(Imu {
            header: header.clone(),
            orientation: [0.0, 0.0, 0.0, 1.0],
            orientation_covariance: [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            angular_velocity: sample.gyro,
            angular_velocity_covariance: [0.0; 9],
            linear_acceleration: sample.accel,
            linear_acceleration_covariance: [0.0; 9],
        });
        self.write(sample.at, Some(number), imu)?;
        let temperature = Item::Temperature(Temperature {
            header,
            temperature: sample.temperature,
            variance: 0.0,
        });
        self.write(sample.at, None, temperature)
    }

    /// Writes a pulse of the trigger.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn pulse(&mut self, pulse: &protocol::Pulse) -> Result<(), RecordingError> {
        let message = Item::Pulse(pulse_message(pulse, "trigger"));
        self.write(pulse.at, Some(pulse.seq), message)
    }

    /// Writes a pulse of an auxiliary output; `name` is the name of the sensor on it.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn output_pulse(
        &mut self,
        pulse: &protocol::Pulse,
        name: &str,
    ) -> Result<(), RecordingError> {
        let pulse = protocol::Pulse {
            readback: None,
            ..*pulse
        };
        let message = Item::Output(pulse_message(&pulse, name));
        self.write(pulse.at, Some(pulse.seq), message)
    }

    /// Writes a pulse per second with the UTC that the board, as a GNSS receiver, stated for it;
    /// `name` is the name of the lidar.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn pps(&mut self, pps: &protocol::Pps, name: &str) -> Result<(), RecordingError> {
        let second = Item::Gnss(TimeReference {
            header: Header::at(pps.at, "board"),
            time_ref: Time::from_nanos(pps.utc.saturating_mul(1_000_000_000)),
            source: name.to_owned(),
        });
        self.write(pps.at, Some(pps.seq), second)
    }

    /// Writes an edge on a capture input.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn capture(&mut self, capture: &protocol::Capture) -> Result<(), RecordingError> {
        let channel = match capture.channel {
            CaptureChannel::Strobe => "strobe",
        };
        let message = Item::Capture(Capture {
            header: Header::at(capture.at, channel),
            ticks: capture.at.0,
            channel: channel.to_owned(),
            rising: capture.edge == Edge::Rising,
            after_loss: capture.after_loss,
        });
        self.write(capture.at, Some(capture.seq), message)
    }

    /// Writes the board's status, and the host's wall clock at its arrival, which was `waited`
    /// ago.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn status(
        &mut self,
        status: &protocol::Status,
        board_id: &str,
        waited: Duration,
    ) -> Result<(), RecordingError> {
        let message = Item::Status(diagnostics(status, board_id));
        self.write(status.at, Some(status.seq), message)?;
        let wall = (self.wall)()
            .duration_since(UNIX_EPOCH)
            .ok()
            .and_then(|since| i64::try_from(since.saturating_sub(waited).as_nanos()).ok())
            .unwrap_or_default();
        let time = Item::HostTime(TimeReference {
            header: Header::at(status.at, "board"),
            time_ref: Time::from_nanos(wall),
            source: String::from("host"),
        });
        self.write(status.at, None, time)
    }

    /// Writes a marker of the user.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn marker(
        &mut self,
        at: Ticks,
        phone: Option<PhoneNanos>,
        label: &str,
    ) -> Result<(), RecordingError> {
        let marker = TimeReference {
            header: Header::at(at, "board"),
            time_ref: phone.map_or_else(Time::default, |nanos| Time::from_nanos(nanos.0)),
            source: label.to_owned(),
        };
        self.write(at, None, Item::Marker(marker))
    }

    /// Writes a relation of the clocks that is used from now on; `phone` is the name of the phone
    /// if it is not the reference.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn clock_model(
        &mut self,
        at: Ticks,
        phone: Option<&str>,
        clock: &ClockRelation,
        source: &str,
    ) -> Result<(), RecordingError> {
        let [[a, b], [c, d]] = clock.covariance;
        let message = ClockModel {
            header: Header::at(
                BoardSeconds(clock.reference).ticks(),
                phone.unwrap_or("board"),
            ),
            reference_s: clock.reference,
            offset_s: clock.offset,
            skew: clock.skew,
            covariance: [a, b, c, d],
            wander: clock.wander.0,
            source: source.to_owned(),
        };
        let item = match phone {
            None => Item::Clock(message),
            Some(_) => Item::PhoneClock(message),
        };
        self.write(at, None, item)
    }

    /// Writes a question to the clock of `name` for its time; `at` is the latest known board time.
    /// The header of the message is replaced.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn exchange(
        &mut self,
        at: Ticks,
        name: &str,
        exchange: ClockExchange,
    ) -> Result<(), RecordingError> {
        let header = Header::at(at, name);
        self.write(
            at,
            None,
            Item::Exchange(ClockExchange { header, ..exchange }),
        )
    }

    /// Writes that the trigger changes to another grid at its anchor, with the phase before that
    /// and its 1-sigma, µs.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn trigger_period(
        &mut self,
        grid: EdgeGrid,
        (phase_us, phase_sigma_us): (f64, f64),
    ) -> Result<(), RecordingError> {
        let period = Item::Period(TriggerPeriod {
            header: Header::at(grid.anchor.ticks, "board"),
            grid,
            phase_us,
            phase_sigma_us,
        });
        self.write(grid.anchor.ticks, None, period)
    }

    /// Writes an event of the session; `kind` is a stable word for its kind.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn log(
        &mut self,
        at: Ticks,
        severity: Severity,
        kind: &str,
        text: &str,
    ) -> Result<(), RecordingError> {
        let log = Item::Log(Log {
            stamp: Time::at(at),
            level: level(severity),
            name: String::from("smartdepthsync"),
            msg: text.to_owned(),
            file: String::new(),
            function: kind.to_owned(),
            line: 0,
        });
        self.write(at, None, log)
    }

    /// Writes a frame of the link as it came, without its delimiter; `at` is the latest known
    /// board time.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn frame(&mut self, at: Ticks, frame: Vec<u8>) -> Result<(), RecordingError> {
        let frame = Item::Link(LinkFrame {
            header: Header::at(at, "link"),
            data: frame,
        });
        self.write(at, None, frame)
    }

    /// Writes a message, with the board's number or numbered on its topic.
    fn write(&mut self, at: Ticks, number: Option<u32>, item: Item) -> Result<(), RecordingError> {
        let topic = item.topic();
        let data = item.to_cdr().map_err(|source| RecordingError::Message {
            topic: topic.name().to_owned(),
            source,
        })?;
        self.put_cdr(topic, at, number, &data)
    }
}

/// Returns the level of ROS for a severity.
const fn level(severity: Severity) -> u8 {
    match severity {
        Severity::Good => 20,
        Severity::Check => 30,
        Severity::Bad => 40,
    }
}

fn pulse_message(pulse: &protocol::Pulse, frame_id: &str) -> Pulse {
    Pulse {
        header: Header::at(pulse.at, frame_id),
        ticks: pulse.at.0,
        train: pulse.train,
        number: pulse.number,
        aligned: pulse.aligned,
        readback: pulse.readback.is_some(),
        readback_ticks: pulse.readback.unwrap_or(0),
    }
}
