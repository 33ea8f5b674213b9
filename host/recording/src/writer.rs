//! Writes `recording.mcap` so that a kill loses at most a second.
//!
//! A chunk is closed and handed to the system whenever half a second of board
//! time or of the host's time has passed since the last one, whichever comes
//! first (the caller gives the latter: on a simulated rig it is virtual). Chunks are built in memory
//! and written in one go, so what a kill leaves is whole chunks, and perhaps the
//! beginning of one. Once a second the file is also pushed to the disk
//! (`fdatasync`), against power loss; the link has a thread of its own, so a slow
//! disk does not stall the board.
//!
//! `log_time` and `publish_time` are board time in nanoseconds. Ticks of 20.83 ns
//! round to different nanoseconds, so `round(ns · 6 / 125)` gives them back
//! exactly.
//!
//! What a message becomes, and on which topic, is in [`Topics`]; where it goes is an
//! [`Output`]: the file here, or a viewer that listens live.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Cursor, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{Compression, WriteOptions};
use protocol::{CaptureChannel, Edge, TICK_HZ, Ticks};

use super::messages::{
    BoardRun, Capture, ClockModel, DiagnosticArray, DiagnosticStatus, Header, Imu, KeyValue,
    LinkFrame, Log, Pulse, RosMessage, Temperature, Time, TimeReference, to_cdr,
};
use super::{MCAP_FILE, RecordingError, topic};
use board::imu::Sample;
use board::reset_cause;
use timebase::ClockModel as ClockRelation;
use timebase::PhoneNanos;
use timebase::runs::Joint;

/// The longest stretch of board time in one chunk, ticks.
const CHUNK_TICKS: u64 = TICK_HZ as u64 / 2;

/// The longest time on the host's clock before a chunk is closed into which nothing
/// comes any more.
const CHUNK_TIME: Duration = Duration::from_millis(500);

/// How often the file is pushed to the disk.
const SYNC_TIME: Duration = Duration::from_secs(1);

/// Where a message goes in the file: its channel and its running number.
#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    id: u16,
    sequence: u32,
}

/// The kinds of messages, as indices of channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// [`topic::IMU`].
    Imu,
    /// [`topic::TEMPERATURE`].
    Temperature,
    /// [`topic::TRIGGER`].
    Trigger,
    /// [`topic::PULSE`].
    Pulse,
    /// [`topic::STROBE`].
    Strobe,
    /// [`topic::CAPTURE`].
    Capture,
    /// [`topic::STATUS`].
    Status,
    /// [`topic::LINK`].
    Link,
    /// [`topic::CLOCK`].
    Clock,
    /// [`topic::MARKER`].
    Marker,
    /// [`topic::HOST_TIME`].
    HostTime,
    /// [`topic::LOG`].
    Log,
    /// [`topic::OUTPUT`].
    Output,
    /// [`topic::GNSS`].
    Gnss,
    /// [`topic::RUN`].
    Run,
    /// [`topic::PHONE_CLOCK`].
    PhoneClock,
}

/// How bad something is that is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// As it should be.
    Info,
    /// Something may be missing.
    Warning,
    /// Something is missing or broken.
    Error,
}

/// Where the messages of the topics go.
pub trait Output {
    /// Takes the CDR form of a message.
    ///
    /// # Errors
    ///
    /// It cannot be kept.
    fn put(&mut self, kind: Kind, at: Ticks, data: &[u8]) -> Result<(), RecordingError>;

    /// The time of day, which is told once a second and used for nothing.
    fn time_of_day(&self) -> SystemTime {
        SystemTime::now()
    }
}

/// What the board and the session say, as ROS 2 messages on their topics.
pub struct Topics<O>(O);

/// Writes a recording's file.
pub type Writer = Topics<McapFile>;

/// The file that is being written.
pub struct McapFile {
    mcap: mcap::Writer<NoSeek<BufWriter<File>>>,
    file: File,
    path: PathBuf,
    channels: [Channel; 16],
    chunk_from: Option<Ticks>,
    waits_since: Option<Duration>,
    synced: Instant,
    dirty: bool,
    mirror: Option<Box<dyn Output + Send>>,
    wall: WallClock,
}

/// Tells the time of day.
pub type WallClock = Box<dyn Fn() -> SystemTime + Send>;

impl Writer {
    /// Makes the file in a recording's folder.
    ///
    /// # Errors
    ///
    /// It is there already or cannot be written.
    pub fn create(folder: &Path) -> Result<Self, RecordingError> {
        let path = folder.join(MCAP_FILE);
        let io = |source| RecordingError::Io {
            action: "write",
            path: path.clone(),
            source,
        };
        let file = File::create_new(&path).map_err(io)?;
        let copy = file.try_clone().map_err(io)?;
        let mut mcap = options()
            .create(NoSeek::new(BufWriter::with_capacity(1 << 20, file)))
            .map_err(|source| mcap_error(&path, source))?;
        let channels = make_channels(&mut mcap).map_err(|source| mcap_error(&path, source))?;
        let mut file = McapFile {
            mcap,
            file: copy,
            path,
            channels,
            chunk_from: None,
            waits_since: None,
            synced: Instant::now(),
            dirty: true,
            mirror: None,
            wall: Box::new(SystemTime::now),
        };
        file.flush()?;
        Ok(Self(file))
    }

    /// Takes the time of day, which is recorded once a second and used for nothing,
    /// from another clock than the system's.
    pub fn set_wall_clock(&mut self, wall: WallClock) {
        self.0.wall = wall;
    }

    /// Shows everything that is written from here on to those who look on live.
    pub fn mirror(&mut self, to: impl Output + Send + 'static) {
        self.0.mirror = Some(Box::new(to));
    }

    /// Closes the chunk if it has waited long enough, by the clock that `now` is of,
    /// since this was called first with something in it. Call it often, also when
    /// nothing comes.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn tick(&mut self, now: Duration) -> Result<(), RecordingError> {
        if !self.0.dirty {
            return Ok(());
        }
        let since = *self.0.waits_since.get_or_insert(now);
        if now.saturating_sub(since) >= CHUNK_TIME {
            self.0.flush()?;
        }
        Ok(())
    }

    /// Closes the chunk and hands it to the system.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.0.flush()
    }

    /// Writes index and end of the file and pushes it to the disk.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.0
            .mcap
            .finish()
            .map_err(|source| mcap_error(&self.0.path, source))?;
        self.0.sync()
    }
}

impl<O: Output> Topics<O> {
    /// Into this output.
    pub const fn new(output: O) -> Self {
        Self(output)
    }

    /// An IMU sample.
    ///
    /// # Errors
    ///
    /// The file cannot be written; so all of these.
    pub fn imu(&mut self, sample: &Sample) -> Result<(), RecordingError> {
        let header = header(sample.at, "board_imu");
        self.put(
            Kind::Imu,
            sample.at,
            &Imu {
                header: header.clone(),
                orientation: [0.0, 0.0, 0.0, 1.0],
                orientation_covariance: [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                angular_velocity: sample.gyro.into(),
                angular_velocity_covariance: [0.0; 9],
                linear_acceleration: sample.accel.into(),
                linear_acceleration_covariance: [0.0; 9],
            },
        )?;
        self.put(
            Kind::Temperature,
            sample.at,
            &Temperature {
                header,
                temperature: sample.temperature,
                variance: 0.0,
            },
        )
    }

    /// A pulse of the trigger; `phone` is the same instant in the phone's time
    /// as far as it is known.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn pulse(
        &mut self,
        pulse: &protocol::Pulse,
        phone: Option<PhoneNanos>,
    ) -> Result<(), RecordingError> {
        self.time_reference(Kind::Trigger, pulse.at, phone, "phone")?;
        self.put(
            Kind::Pulse,
            pulse.at,
            &Pulse {
                header: header(pulse.at, "trigger"),
                ticks: pulse.at.0,
                train: pulse.train,
                number: pulse.number,
                aligned: pulse.aligned,
                readback: pulse.readback.is_some(),
                readback_ticks: pulse.readback.unwrap_or(0),
            },
        )
    }

    /// A pulse of one of the further outputs; `name` is the sensor's on it.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn output_pulse(
        &mut self,
        pulse: &protocol::Pulse,
        name: &str,
    ) -> Result<(), RecordingError> {
        self.put(
            Kind::Output,
            pulse.at,
            &Pulse {
                header: header(pulse.at, name),
                ticks: pulse.at.0,
                train: pulse.train,
                number: pulse.number,
                aligned: pulse.aligned,
                readback: false,
                readback_ticks: 0,
            },
        )
    }

    /// A pulse per second: the UTC that begins with it for whoever takes the
    /// board for a GNSS receiver; `name` is what the lidar is called.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn pps(&mut self, pps: &protocol::Pps, name: &str) -> Result<(), RecordingError> {
        self.put(
            Kind::Gnss,
            pps.at,
            &TimeReference {
                header: header(pps.at, "board"),
                time_ref: Time::from_nanos(pps.utc.saturating_mul(1_000_000_000)),
                source: name.to_owned(),
            },
        )
    }

    /// An edge on a capture input.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn capture(
        &mut self,
        capture: &protocol::Capture,
        phone: Option<PhoneNanos>,
    ) -> Result<(), RecordingError> {
        let rising = capture.edge == Edge::Rising;
        self.time_reference(Kind::Strobe, capture.at, phone, "phone")?;
        let channel = match capture.channel {
            CaptureChannel::Strobe => "strobe",
        };
        self.put(
            Kind::Capture,
            capture.at,
            &Capture {
                header: header(capture.at, channel),
                ticks: capture.at.0,
                channel: channel.to_owned(),
                rising,
                after_loss: capture.after_loss,
            },
        )
    }

    /// The board's status; with it, the host's wall clock.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn status(
        &mut self,
        status: &protocol::Status,
        board_id: &str,
    ) -> Result<(), RecordingError> {
        self.put(Kind::Status, status.at, &diagnostics(status, board_id))?;
        let wall = self
            .0
            .time_of_day()
            .duration_since(UNIX_EPOCH)
            .ok()
            .and_then(|since| i64::try_from(since.as_nanos()).ok())
            .unwrap_or_default();
        self.put(
            Kind::HostTime,
            status.at,
            &TimeReference {
                header: header(status.at, "board"),
                time_ref: Time::from_nanos(wall),
                source: String::from("host"),
            },
        )
    }

    /// A marker of the user.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn marker(
        &mut self,
        at: Ticks,
        phone: Option<PhoneNanos>,
        label: &str,
    ) -> Result<(), RecordingError> {
        self.time_reference(Kind::Marker, at, phone, label)
    }

    /// A relation of the clocks that holds from now on.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn clock_model(
        &mut self,
        at: Ticks,
        clock: &ClockRelation,
        source: &str,
    ) -> Result<(), RecordingError> {
        let message = clock_message(clock, "board", source);
        self.put(Kind::Clock, at, &message)
    }

    /// The same of a further phone, with its name.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn phone_clock_model(
        &mut self,
        at: Ticks,
        name: &str,
        clock: &ClockRelation,
        source: &str,
    ) -> Result<(), RecordingError> {
        let message = clock_message(clock, name, source);
        self.put(Kind::PhoneClock, at, &message)
    }

    /// The board was reset: a later run begins. `since` is tick 0 of it, `last` the
    /// last tick of the run before, both recorded; `joint` says how they hang
    /// together.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn board_run(
        &mut self,
        since: Ticks,
        hello: &protocol::Hello,
        joint: &Joint,
        last: Ticks,
    ) -> Result<(), RecordingError> {
        self.put(
            Kind::Run,
            since,
            &BoardRun {
                header: header(since, "board"),
                epoch: hello.epoch,
                reset_cause: reset_cause(hello.reset_cause).to_owned(),
                shift_ticks: joint.shift,
                shift_sigma_s: joint.sigma_s,
                last_ticks: last.0,
            },
        )
    }

    /// Something that was said. `kind` is a stable word for it.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn log(
        &mut self,
        at: Ticks,
        severity: Severity,
        kind: &str,
        text: &str,
    ) -> Result<(), RecordingError> {
        self.put(
            Kind::Log,
            at,
            &Log {
                stamp: stamp(at),
                level: match severity {
                    Severity::Info => Log::INFO,
                    Severity::Warning => Log::WARN,
                    Severity::Error => Log::ERROR,
                },
                name: String::from("smartdepthsync"),
                msg: text.to_owned(),
                file: String::new(),
                function: kind.to_owned(),
                line: 0,
            },
        )
    }

    /// A frame of the link, as it came, without its delimiter. `at` is the
    /// latest board time known.
    ///
    /// # Errors
    ///
    /// As [`Topics::imu`].
    pub fn frame(&mut self, at: Ticks, frame: Vec<u8>) -> Result<(), RecordingError> {
        self.put(
            Kind::Link,
            at,
            &LinkFrame {
                header: header(at, "link"),
                data: frame,
            },
        )
    }

    fn time_reference(
        &mut self,
        kind: Kind,
        at: Ticks,
        phone: Option<PhoneNanos>,
        source: &str,
    ) -> Result<(), RecordingError> {
        self.put(
            kind,
            at,
            &TimeReference {
                header: header(at, "board"),
                time_ref: phone.map_or_else(Time::default, |nanos| Time::from_nanos(nanos.0)),
                source: source.to_owned(),
            },
        )
    }

    fn put<M: RosMessage>(
        &mut self,
        kind: Kind,
        at: Ticks,
        message: &M,
    ) -> Result<(), RecordingError> {
        let data = to_cdr(message).map_err(|source| RecordingError::Message {
            topic: M::TYPE.to_owned(),
            source,
        })?;
        self.0.put(kind, at, &data)
    }
}

impl McapFile {
    fn flush(&mut self) -> Result<(), RecordingError> {
        self.mcap
            .flush()
            .map_err(|source| mcap_error(&self.path, source))?;
        self.chunk_from = None;
        self.waits_since = None;
        self.dirty = false;
        if self.synced.elapsed() >= SYNC_TIME {
            self.sync()?;
        }
        Ok(())
    }

    fn sync(&mut self) -> Result<(), RecordingError> {
        self.synced = Instant::now();
        self.file.sync_data().map_err(|source| RecordingError::Io {
            action: "write",
            path: self.path.clone(),
            source,
        })
    }
}

impl Output for McapFile {
    fn time_of_day(&self) -> SystemTime {
        (self.wall)()
    }

    fn put(&mut self, kind: Kind, at: Ticks, data: &[u8]) -> Result<(), RecordingError> {
        let nanos = at.as_nanos();
        if let Some(channel) = self.channels.get_mut(kind as usize) {
            let header = MessageHeader {
                channel_id: channel.id,
                sequence: channel.sequence,
                log_time: nanos,
                publish_time: nanos,
            };
            channel.sequence = channel.sequence.wrapping_add(1);
            self.mcap
                .write_to_known_channel(&header, data)
                .map_err(|source| mcap_error(&self.path, source))?;
        }
        self.dirty = true;
        let from = *self.chunk_from.get_or_insert(at);
        if at.0.abs_diff(from.0) >= CHUNK_TICKS {
            self.flush()?;
        }
        match &mut self.mirror {
            Some(mirror) => mirror.put(kind, at, data),
            None => Ok(()),
        }
    }
}

fn mcap_error(path: &Path, source: mcap::McapError) -> RecordingError {
    RecordingError::Mcap {
        path: path.to_owned(),
        source,
    }
}

/// How recordings are written.
pub fn options() -> WriteOptions {
    WriteOptions::new()
        .profile("ros2")
        .library(concat!("smartdepthsync ", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Lz4))
        // Chunks are closed by time.
        .chunk_size(Some(16 << 20))
        .disable_seeking(true)
}

/// The topics of every recording with their numbers and types, as the writer
/// makes them.
///
/// # Errors
///
/// None that is known: it writes into memory.
pub fn known_channels() -> Result<mcap::Summary, mcap::McapError> {
    let mut mcap = options().create(NoSeek::new(Cursor::new(Vec::new())))?;
    make_channels(&mut mcap)?;
    mcap.finish()
}

/// A topic and what is on it.
pub struct Description {
    /// Its name.
    pub topic: &'static str,
    /// The type of its messages.
    pub name: &'static str,
    /// The type's schema.
    pub schema: String,
}

/// The topics in the order of [`Kind`].
pub fn descriptions() -> [Description; 16] {
    fn of<M: RosMessage>(topic: &'static str) -> Description {
        Description {
            topic,
            name: M::TYPE,
            schema: M::schema(),
        }
    }
    [
        of::<Imu>(topic::IMU),
        of::<Temperature>(topic::TEMPERATURE),
        of::<TimeReference>(topic::TRIGGER),
        of::<Pulse>(topic::PULSE),
        of::<TimeReference>(topic::STROBE),
        of::<Capture>(topic::CAPTURE),
        of::<DiagnosticArray>(topic::STATUS),
        of::<LinkFrame>(topic::LINK),
        of::<ClockModel>(topic::CLOCK),
        of::<TimeReference>(topic::MARKER),
        of::<TimeReference>(topic::HOST_TIME),
        of::<Log>(topic::LOG),
        of::<Pulse>(topic::OUTPUT),
        of::<TimeReference>(topic::GNSS),
        of::<BoardRun>(topic::RUN),
        of::<ClockModel>(topic::PHONE_CLOCK),
    ]
}

fn make_channels<W: Write + Seek>(
    mcap: &mut mcap::Writer<W>,
) -> Result<[Channel; 16], mcap::McapError> {
    let mut channels = [Channel::default(); 16];
    for (channel, described) in channels.iter_mut().zip(descriptions()) {
        let schema = mcap.add_schema(described.name, "ros2msg", described.schema.as_bytes())?;
        channel.id = mcap.add_channel(schema, described.topic, "cdr", &BTreeMap::new())?;
    }
    Ok(channels)
}

fn stamp(at: Ticks) -> Time {
    Time::from_nanos(i64::try_from(at.as_nanos()).unwrap_or(i64::MAX))
}

fn header(at: Ticks, frame_id: &str) -> Header {
    Header {
        stamp: stamp(at),
        frame_id: frame_id.to_owned(),
    }
}

fn clock_message(clock: &ClockRelation, frame_id: &str, source: &str) -> ClockModel {
    let [[a, b], [c, d]] = clock.covariance;
    ClockModel {
        header: header(clock.reference.ticks(), frame_id),
        reference_s: clock.reference.0,
        offset_s: clock.offset,
        skew: clock.skew,
        covariance: [a, b, c, d],
        wander: clock.wander.0,
        source: source.to_owned(),
    }
}

fn diagnostics(status: &protocol::Status, board_id: &str) -> DiagnosticArray {
    let part =
        |name: &str, level: u8, message: String, values: &[(&str, String)]| DiagnosticStatus {
            level,
            name: name.to_owned(),
            message,
            hardware_id: board_id.to_owned(),
            values: values
                .iter()
                .map(|(key, value)| KeyValue {
                    key: (*key).to_owned(),
                    value: value.clone(),
                })
                .collect(),
        };
    let dropped = &status.dropped;
    let any_dropped = dropped.total() > 0 || status.link.lost_frames() > 0;
    let trigger = &status.trigger;
    let imu = &status.imu;
    DiagnosticArray {
        header: header(status.at, "board"),
        status: vec![
            part(
                "board",
                u8::from(any_dropped),
                String::from(if any_dropped {
                    "messages were dropped"
                } else {
                    "ok"
                }),
                &[
                    ("epoch", status.epoch.to_string()),
                    ("cpu_permille", status.cpu_permille.to_string()),
                    ("stack_used", status.stack_used.to_string()),
                    ("stack_size", status.stack_size.to_string()),
                    ("connects", status.connects.to_string()),
                    ("dropped_answers", dropped.answers.to_string()),
                    ("dropped_pulses", dropped.pulses.to_string()),
                    ("dropped_captures", dropped.captures.to_string()),
                    ("dropped_imu", dropped.imu.to_string()),
                    ("dropped_status", dropped.status.to_string()),
                    ("dropped_outputs", dropped.outputs.to_string()),
                    ("link_lost_frames", status.link.lost_frames().to_string()),
                    (
                        "strobe_overcaptures",
                        status.strobe_overcaptures.to_string(),
                    ),
                    ("strobe_floods", status.strobe_floods.to_string()),
                ],
            ),
            part(
                "trigger",
                u8::from(trigger.late > 0 || trigger.readback.missing > 0),
                format!("{:?}", trigger.state),
                &[
                    ("train", trigger.train.to_string()),
                    ("pulses", trigger.pulses.to_string()),
                    ("period_q32", trigger.period.0.to_string()),
                    ("late", trigger.late.to_string()),
                    ("readback_seen", trigger.readback.seen.to_string()),
                    ("readback_missing", trigger.readback.missing.to_string()),
                    ("readback_stray", trigger.readback.stray.to_string()),
                    ("latency_ticks", status.trigger_latency.to_string()),
                    ("busy_ticks", status.trigger_busy.to_string()),
                ],
            ),
            part(
                "imu",
                match imu.state {
                    protocol::ImuState::Running => 0,
                    protocol::ImuState::Starting => 1,
                    protocol::ImuState::Failed => 2,
                },
                format!("{:?}", imu.state),
                &[
                    ("clock", format!("{:?}", imu.clock)),
                    ("samples", imu.samples.to_string()),
                    ("late", imu.late.to_string()),
                    ("overcaptures", imu.overcaptures.to_string()),
                    ("recoveries", imu.recoveries.to_string()),
                    (
                        "last_fault",
                        imu.last_fault
                            .map_or(String::new(), |fault| format!("{fault:?}")),
                    ),
                ],
            ),
            part(
                "outputs",
                u8::from(status.outputs.iter().any(|output| output.late > 0)),
                outputs_state(&status.outputs),
                &outputs_values(&status.outputs, status.output_latency),
            ),
            part(
                "gnss",
                u8::from(status.gnss.late > 0 || status.gnss.missed > 0),
                format!("{:?}", status.gnss.state),
                &[
                    ("pulses", status.gnss.pulses.to_string()),
                    ("sentences", status.gnss.sentences.to_string()),
                    ("missed", status.gnss.missed.to_string()),
                    ("late", status.gnss.late.to_string()),
                ],
            ),
        ],
    }
}

fn outputs_state(outputs: &[protocol::OutputStatus; 3]) -> String {
    outputs
        .map(|output| format!("{:?}", output.state))
        .join(", ")
}

fn outputs_values(
    [two, three, four]: &[protocol::OutputStatus; 3],
    latency: u32,
) -> [(&'static str, String); 7] {
    [
        ("pulses_2", two.pulses.to_string()),
        ("pulses_3", three.pulses.to_string()),
        ("pulses_4", four.pulses.to_string()),
        ("late_2", two.late.to_string()),
        ("late_3", three.late.to_string()),
        ("late_4", four.late.to_string()),
        ("latency_ticks", latency.to_string()),
    ]
}
