//! What the board recorded as one stream of events in board time: from our own
//! `recording.mcap` (see `docs/formats.md`), or from a bag of the published system that
//! `rosbags-convert` has made an MCAP file of.
//!
//! | topic of the published system | type | becomes |
//! |---|---|---|
//! | `/mcu_imu`, `/mcu_imu_temp` | Imu, Temperature | [`BoardEvent::Imu`], joined by their stamp |
//! | `/mcu_cameras_ts` | TimeReference | [`BoardEvent::Pulse`] and [`BoardEvent::Times`] |
//! | `/mcu_lidar_ts`, `/mcu_s10_ts`, `/depth_to_mcu_offset` | TimeReference | [`BoardEvent::Times`] |
//! | `/sequences_ts` | TimeReference | [`BoardEvent::Mark`] and [`BoardEvent::Times`] |
//!
//! It has no trains and no numbers of pulses: the pulses are one train, numbered as they
//! stand in the bag. Topics below a name space (`/mcu/mcu_imu`) count too.
//!
//! A stream is read front to back and can be opened again ([`BoardStream::open`]): the
//! extraction goes over it more than once instead of keeping it in memory. What is damaged
//! is left out and named; a file that was not closed is read to its last whole chunk.

use std::collections::{HashMap, VecDeque};
use std::mem::{Discriminant, discriminant};
use std::path::Path;
use std::sync::Arc;

use clock::{BoardSeconds, BoardToPhone, ClockRelation, PhoneNanos, Wander};
use protocol::Ticks;
use recording::messages::{self, Imu, RosMessage, Temperature, TimeReference, from_cdr};
use recording::walk::{Event, Message, Walk};
use recording::{Item, RecordingError, Topic};
use twist_sync::tracker::{Asked, Exchange};

use crate::depth::depth_clock::PulseTime;
use crate::faults::Faults;
use crate::time::BoardNanos;
use system::ReadMonitor;

/// How many samples wait for their temperature.
const WAITING: usize = 64;

/// How many faults are kept with their text.
const MAX_FAULTS: usize = 50;

/// Topics whose messages become nothing, and so are not even decoded.
const PASSED_OVER: [Topic; 6] = [
    Topic::Capture,
    Topic::Status,
    Topic::Link,
    Topic::HostTime,
    Topic::Period,
    Topic::Log,
];

/// One sample of the board's IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ImuRow {
    /// The data-ready edge; the filter's delay is not subtracted.
    pub(crate) at: BoardNanos,
    /// rad/s.
    pub(crate) gyro: [f64; 3],
    /// m/s².
    pub(crate) accel: [f64; 3],
    /// °C.
    pub(crate) temperature: Option<f64>,
}

/// What a pair of times is of.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Reference {
    /// The trigger, and the phone.
    Cameras,
    /// The depth camera's clock, as the published system measures it.
    DepthOffset,
    /// A pulse per second, and the UTC that a lidar was told.
    Lidar,
    /// The relation of phone and board.
    Phone,
    /// A pulse of an auxiliary output; the sensor's name.
    Output(Arc<str>),
    /// A mark.
    Sequences,
}

impl Reference {
    /// The sensor's name, if a sensor gets these pulses; `lidar` is that of the lidar.
    pub(crate) fn sensor<'a>(&'a self, lidar: Option<&'a str>) -> Option<&'a str> {
        match self {
            Self::Lidar => Some(lidar.unwrap_or("gnss")),
            Self::Output(name) => Some(name),
            Self::Cameras | Self::DepthOffset | Self::Phone | Self::Sequences => None,
        }
    }
}

/// A pair of times of one instant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TimePair {
    /// What it is of.
    pub(crate) of: Reference,
    /// Its number among those of its kind in the file.
    pub(crate) seq: u32,
    /// Board time.
    pub(crate) stamp: BoardNanos,
    /// The other time, in ns.
    pub(crate) other: i64,
}

/// Something that the board recorded.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum BoardEvent {
    /// A sample of the IMU.
    Imu(ImuRow),
    /// The sample of this time, which follows, is marked as late or at the end of its range.
    Marked(BoardNanos),
    /// A trigger pulse.
    Pulse(PulseTime),
    /// The beginning of a sequence.
    Mark(BoardNanos),
    /// A pair of times.
    Times(TimePair),
    /// A relation of phone and board that the session found: of the phone that the
    /// trigger was aligned to, or of another one by its name.
    Clock(Option<String>, ClockRelation),
    /// A clock was asked for its time: the phone's or, as a, the board's.
    Exchange(Asked, Exchange),
    /// The file is of the published system; given once.
    Published,
}

/// Events one after the other.
pub(crate) struct BoardStream {
    walk: Walk,
    sorter: Sorter,
}

struct Sorter {
    events: VecDeque<BoardEvent>,
    /// Samples whose temperature has not come yet.
    waiting: VecDeque<ImuRow>,
    /// How many pairs of times there were of each kind.
    counts: HashMap<Discriminant<Reference>, u32>,
    /// The relation of the clocks that was known last.
    clock: Option<ClockRelation>,
    /// The file is of the published system.
    published: bool,
    faults: Faults,
}

impl BoardStream {
    /// Begins at the front of an MCAP file.
    ///
    /// # Errors
    ///
    /// Fails if it cannot be opened.
    pub(crate) fn open(path: &Path, monitor: &ReadMonitor) -> Result<Self, RecordingError> {
        Ok(Self {
            walk: Walk::open(path, monitor)?,
            sorter: Sorter {
                events: VecDeque::new(),
                waiting: VecDeque::new(),
                counts: HashMap::new(),
                clock: None,
                published: false,
                faults: Faults::new(MAX_FAULTS),
            },
        })
    }

    /// The next event; `None` at the end.
    ///
    /// # Errors
    ///
    /// Reading fails. Damage is no error: see [`BoardStream::damage`].
    pub(crate) fn next_event(&mut self) -> Result<Option<BoardEvent>, RecordingError> {
        loop {
            if let Some(event) = self.sorter.events.pop_front() {
                return Ok(Some(event));
            }
            let sorter = &mut self.sorter;
            let more = self.walk.next_part(&mut |event| match event {
                Event::Message(message) => sorter.message(&message),
                Event::Damage(damage) if damage.is_loss() => {
                    sorter.faults.add(damage.to_string());
                }
                _ => {}
            })?;
            if !more {
                sorter.release(0);
                if sorter.events.is_empty() {
                    return Ok(None);
                }
            }
        }
    }

    /// What could not be read so far, in words.
    pub(crate) fn damage(&self) -> Vec<String> {
        self.sorter.faults.summary("damaged parts")
    }
}

impl Sorter {
    fn message(&mut self, message: &Message<'_>) {
        let read = match message.channel.known {
            Some(topic) if PASSED_OVER.contains(&topic) => Ok(()),
            Some(topic) => match topic.read(message.data) {
                Ok(item) => {
                    self.item(item);
                    Ok(())
                }
                Err(error) => Err(error.to_string()),
            },
            None => self.published(message),
        };
        if let Err(why) = read {
            let topic = &message.channel.described.topic;
            self.faults
                .add(format!("a message of {topic} is left out: {why}"));
        }
    }

    /// A message of one of our topics.
    fn item(&mut self, item: Item) {
        match item {
            Item::Imu(imu) => self.sample(&imu),
            Item::Temperature(value) => self.temperature(&value),
            Item::Pulse(pulse) => {
                let at = stamp(&pulse.header);
                let phone = |clock: ClockRelation| clock.ticks_to_phone(Ticks(pulse.ticks)).0;
                let phone = self.clock.map_or(0, phone);
                self.pair(Reference::Cameras, at, phone);
                self.pulse(pulse.train, pulse.number, at);
            }
            Item::Marker(times) => self.mark(&times),
            Item::Output(pulse) => {
                let at = stamp(&pulse.header);
                self.pair(Reference::Output(pulse.header.frame_id.into()), at, at.0);
            }
            Item::Gnss(times) => self.times(Reference::Lidar, &times),
            Item::Exchange(exchange) => self.events.push_back(exchange_of(&exchange)),
            Item::Clock(model) => {
                let relation = relation(&model);
                let at = stamp(&model.header);
                let phone = relation.to_phone(BoardSeconds(at.0 as f64 * 1e-9));
                self.pair(Reference::Phone, at, phone.nanos().0);
                self.clock = Some(relation);
                self.events.push_back(BoardEvent::Clock(None, relation));
            }
            Item::PhoneClock(model) => {
                let relation = relation(&model);
                let name = Some(model.header.frame_id);
                self.events.push_back(BoardEvent::Clock(name, relation));
            }
            Item::ImuFlags(flags) if flags.late || flags.saturated => {
                let at = stamp(&flags.header);
                self.events.push_back(BoardEvent::Marked(at));
            }
            Item::ImuFlags(_)
            | Item::Capture(_)
            | Item::Status(_)
            | Item::Link(_)
            | Item::HostTime(_)
            | Item::Period(_)
            | Item::Log(_) => {}
        }
    }

    /// A message of the published system, or one of another topic, which is passed over.
    fn published(&mut self, message: &Message<'_>) -> Result<(), String> {
        let topic = &message.channel.described.topic;
        let name = topic.rsplit('/').next().unwrap_or(topic);
        match name {
            "mcu_imu" => self.sample(&read(message)?),
            "mcu_imu_temp" => self.temperature(&read(message)?),
            "mcu_cameras_ts" => {
                let times: TimeReference = read(message)?;
                let number = *self.count(&Reference::Cameras);
                self.pulse(0, number.into(), stamp(&times.header));
                self.times(Reference::Cameras, &times);
            }
            "mcu_lidar_ts" => self.times(Reference::Lidar, &read(message)?),
            "mcu_s10_ts" => self.times(Reference::Phone, &read(message)?),
            "depth_to_mcu_offset" => self.times(Reference::DepthOffset, &read(message)?),
            "sequences_ts" => self.mark(&read(message)?),
            _ => return Ok(()),
        }
        if !self.published {
            self.published = true;
            self.events.push_back(BoardEvent::Published);
        }
        Ok(())
    }

    fn pulse(&mut self, train: u32, number: u64, at: BoardNanos) {
        let pulse = PulseTime { train, number, at };
        self.events.push_back(BoardEvent::Pulse(pulse));
    }

    fn mark(&mut self, times: &TimeReference) {
        let mark = BoardEvent::Mark(stamp(&times.header));
        self.events.push_back(mark);
        self.times(Reference::Sequences, times);
    }

    fn sample(&mut self, imu: &Imu) {
        self.waiting.push_back(ImuRow {
            at: stamp(&imu.header),
            gyro: imu.angular_velocity,
            accel: imu.linear_acceleration,
            temperature: None,
        });
        self.release(WAITING);
    }

    fn temperature(&mut self, value: &Temperature) {
        let at = stamp(&value.header);
        if let Some(row) = self.waiting.iter_mut().find(|row| row.at == at) {
            row.temperature = Some(value.temperature);
        }
        let complete = self
            .waiting
            .iter()
            .take_while(|row| row.temperature.is_some());
        let rows = self.waiting.drain(..complete.count());
        self.events.extend(rows.map(BoardEvent::Imu));
    }

    /// Lets samples go on without a temperature, down to `keep` that wait.
    fn release(&mut self, keep: usize) {
        let go = self.waiting.len().saturating_sub(keep);
        let rows = self.waiting.drain(..go);
        self.events.extend(rows.map(BoardEvent::Imu));
    }

    fn times(&mut self, of: Reference, times: &TimeReference) {
        self.pair(of, stamp(&times.header), times.time_ref.nanos());
    }

    fn count(&mut self, of: &Reference) -> &mut u32 {
        self.counts.entry(discriminant(of)).or_default()
    }

    fn pair(&mut self, of: Reference, stamp: BoardNanos, other: i64) {
        let count = self.count(&of);
        let seq = *count;
        *count = seq.wrapping_add(1);
        let pair = TimePair {
            of,
            seq,
            stamp,
            other,
        };
        self.events.push_back(BoardEvent::Times(pair));
    }
}

/// A message of a topic that is not one of ours, whose type the file states.
fn read<M: RosMessage>(message: &Message<'_>) -> Result<M, String> {
    let kind = &message.channel.kind;
    if kind != M::TYPE {
        return Err(format!("it is a {kind}, expected {}", M::TYPE));
    }
    from_cdr(message.data).map_err(|error| error.to_string())
}

fn stamp(header: &messages::Header) -> BoardNanos {
    BoardNanos(header.stamp.nanos())
}

fn relation(model: &messages::ClockModel) -> ClockRelation {
    let [a, b, c, d] = model.covariance;
    ClockRelation {
        reference: model.reference_s,
        offset: model.offset_s,
        skew: model.skew,
        covariance: [[a, b], [c, d]],
        wander: Wander(model.wander),
    }
}

fn exchange_of(exchange: &messages::ClockExchange) -> BoardEvent {
    let asked = match exchange.header.frame_id == "board" {
        true => Asked::A,
        false => Asked::B,
    };
    let seconds = |nanos| PhoneNanos(nanos).seconds().0;
    let exchange = Exchange {
        sent: seconds(exchange.sent_ns),
        received: seconds(exchange.received_ns),
        stamp: seconds(exchange.clock_ns),
    };
    BoardEvent::Exchange(asked, exchange)
}
