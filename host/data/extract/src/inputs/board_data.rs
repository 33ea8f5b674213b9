//! Everything that the board recorded, as one stream of events in board time: from our own
//! `recording.mcap` (see `docs/formats.md`), or from a bag of the published system that
//! `rosbags-convert` has converted to MCAP.
//!
//! | topic of the published system | type | becomes |
//! |---|---|---|
//! | `/mcu_imu`, `/mcu_imu_temp` | Imu, Temperature | [`BoardEvent::Sample`] |
//! | `/mcu_cameras_ts` | TimeReference | [`BoardEvent::Pulse`] |
//! | `/mcu_lidar_ts`, `/mcu_s10_ts`, `/depth_to_mcu_offset` | TimeReference | [`BoardEvent::Times`] |
//! | `/sequences_ts` | TimeReference | [`BoardEvent::Mark`] and [`BoardEvent::Times`] |
//!
//! A bag has neither trains nor numbers of pulses: its pulses are one train, numbered in the
//! order of the bag. Topics below a name space (`/mcu/mcu_imu`) are read too.
//!
//! A stream is read front to back and can be opened again ([`BoardStream::open`]): the
//! extraction reads it more than once instead of keeping it in memory. Damaged parts are left
//! out and reported; a file that was not closed is read to its last whole chunk.

use std::collections::{HashMap, VecDeque};
use std::mem::{Discriminant, discriminant};
use std::path::Path;
use std::sync::Arc;

use clock::tracker::{Asked, Exchange};
use clock::{BoardSeconds, BoardToPhone, ClockRelation, PhoneNanos};
use protocol::Ticks;
use recording::messages::{self, RosMessage, Time, TimeReference, from_cdr};
use recording::samples::{RecordedSample, SampleJoiner};
use recording::strobes::StrobeEdge;
use recording::walk::{Event, Message, Walk};
use recording::{Item, RecordingError, Topic};

use crate::depth::depth_clock::PulseTime;
use crate::faults::Faults;
use crate::time::BoardNanos;
use system::ReadMonitor;

/// Most faults that are kept with their text.
const MAX_FAULTS: usize = 50;

/// Topics that the extraction has no use for; their messages are not decoded.
const UNUSED: [Topic; 5] = [
    Topic::Status,
    Topic::Link,
    Topic::HostTime,
    Topic::Period,
    Topic::Log,
];

/// Subject of a pair of times.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Reference {
    /// The depth camera's clock, as the published system measures it.
    DepthOffset,
    /// A pulse per second, and the UTC that was sent to a lidar.
    Lidar,
    /// The relation of the clocks of phone and board.
    Phone,
    /// A pulse of an auxiliary output, by the sensor's name.
    Output(Arc<str>),
    /// A mark of the user.
    Sequences,
}

impl Reference {
    /// Returns the name of the sensor that gets these pulses, if there is one; `lidar` is the
    /// name of the lidar.
    pub(crate) fn sensor<'a>(&'a self, lidar: Option<&'a str>) -> Option<&'a str> {
        match self {
            Self::Lidar => Some(lidar.unwrap_or("gnss")),
            Self::Output(name) => Some(name),
            Self::DepthOffset | Self::Phone | Self::Sequences => None,
        }
    }
}

/// One instant in board time and in another time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TimePair {
    /// Subject.
    pub(crate) of: Reference,
    /// Number among the pairs of its kind in the file, from 0.
    pub(crate) seq: u32,
    /// Board time.
    pub(crate) stamp: BoardNanos,
    /// The other time, ns.
    pub(crate) other: i64,
}

/// An event that the board recorded.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum BoardEvent {
    /// A sample of the IMU.
    Sample(RecordedSample),
    /// A trigger pulse.
    Pulse(PulseTime),
    /// An edge on the strobe input.
    Strobe(StrobeEdge),
    /// A mark of the user: a sequence begins.
    Mark(BoardNanos),
    /// A pair of times.
    Times(TimePair),
    /// A relation of the clocks of phone and board that the session found: of the phone that
    /// the trigger was aligned to (`None`), or of another one by its name.
    Clock(Option<String>, ClockRelation),
    /// A clock was asked for its time: the board's ([`Asked::A`]) or the phone's.
    Exchange(Asked, Exchange),
    /// The file is a bag of the published system; sent once.
    Published,
}

/// Reads the events one after the other.
pub(crate) struct BoardStream {
    walk: Walk,
    sorter: Sorter,
}

struct Sorter {
    events: VecDeque<BoardEvent>,
    samples: SampleJoiner,
    /// Pulses of the trigger in a bag of the published system.
    pulses: u64,
    /// Pairs of times of each kind.
    counts: HashMap<Discriminant<Reference>, u32>,
    /// The last known relation of the clocks.
    clock: Option<ClockRelation>,
    /// True if the file is a bag of the published system.
    published: bool,
    faults: Faults,
}

impl BoardStream {
    /// Opens an MCAP file.
    ///
    /// # Errors
    ///
    /// Returns an error if it cannot be opened.
    pub(crate) fn open(path: &Path, monitor: &ReadMonitor) -> Result<Self, RecordingError> {
        Ok(Self {
            walk: Walk::open(path, monitor)?,
            sorter: Sorter {
                events: VecDeque::new(),
                samples: SampleJoiner::default(),
                pulses: 0,
                counts: HashMap::new(),
                clock: None,
                published: false,
                faults: Faults::new(MAX_FAULTS),
            },
        })
    }

    /// Returns the next event; `None` at the end.
    ///
    /// # Errors
    ///
    /// Returns an error if reading fails. Messages that are left out are no error: see
    /// [`BoardStream::left_out`].
    pub(crate) fn next_event(&mut self) -> Result<Option<BoardEvent>, RecordingError> {
        loop {
            if let Some(event) = self.sorter.events.pop_front() {
                return Ok(Some(event));
            }
            let sorter = &mut self.sorter;
            let more = self.walk.next_part(&mut |event| match event {
                Event::Message(message) => sorter.message(&message),
                // The check of the recording reports damage.
                Event::Damage(_) => {}
            })?;
            if !more {
                let left = sorter.samples.drain().map(BoardEvent::Sample);
                sorter.events.extend(left);
                if sorter.events.is_empty() {
                    return Ok(None);
                }
            }
        }
    }

    /// Returns the messages that were left out so far, in words.
    pub(crate) fn left_out(&self) -> Vec<String> {
        self.sorter.faults.summary("messages")
    }
}

impl Sorter {
    fn message(&mut self, message: &Message<'_>) {
        let read = match message.channel.known {
            Some(topic) if UNUSED.contains(&topic) => Ok(()),
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

    /// Sorts a message of one of our topics.
    fn item(&mut self, item: Item) {
        match item {
            Item::ImuFlags(flags) => self.samples.add_flags(&flags),
            Item::Imu(imu) => self.samples.add_imu(&imu),
            Item::Temperature(value) => self.samples.add_temperature(&value),
            Item::Pulse(pulse) => {
                let phone = |clock: ClockRelation| clock.ticks_to_phone(Ticks(pulse.ticks)).0;
                self.events.push_back(BoardEvent::Pulse(PulseTime {
                    train: pulse.train,
                    number: pulse.number,
                    at: stamp(&pulse.header),
                    phone: self.clock.map_or(0, phone),
                }));
            }
            Item::Marker(times) => self.mark(&times),
            Item::Output(pulse) => {
                let at = stamp(&pulse.header);
                self.pair(Reference::Output(pulse.header.frame_id.into()), at, at.0);
            }
            Item::Gnss(times) => self.times(Reference::Lidar, &times),
            Item::Exchange(exchange) => self.events.push_back(exchange_of(&exchange)),
            Item::Clock(model) => {
                // `verify` reports a relation that cannot be.
                let Some(relation) = model.relation() else {
                    return;
                };
                let at = stamp(&model.header);
                let phone = relation.to_phone(BoardSeconds(at.0 as f64 * 1e-9));
                self.pair(Reference::Phone, at, phone.nanos().0);
                self.clock = Some(relation);
                self.events.push_back(BoardEvent::Clock(None, relation));
            }
            Item::PhoneClock(model) => {
                let relation = model.relation();
                let name = Some(model.header.frame_id);
                let clock = relation.map(|relation| BoardEvent::Clock(name, relation));
                self.events.extend(clock);
            }
            Item::Capture(edge) => self.events.push_back(BoardEvent::Strobe((&edge).into())),
            Item::Status(_)
            | Item::Link(_)
            | Item::HostTime(_)
            | Item::Period(_)
            | Item::Log(_) => {}
        }
        self.release_samples();
    }

    /// Sorts a message of the published system; those of other topics are ignored.
    fn published(&mut self, message: &Message<'_>) -> Result<(), String> {
        let topic = &message.channel.described.topic;
        let name = topic.rsplit('/').next().unwrap_or(topic);
        match name {
            "mcu_imu" => self.samples.add_imu(&read(message)?),
            "mcu_imu_temp" => self.samples.add_temperature(&read(message)?),
            "mcu_cameras_ts" => {
                let times: TimeReference = read(message)?;
                self.events.push_back(BoardEvent::Pulse(PulseTime {
                    train: 0,
                    number: self.pulses,
                    at: stamp(&times.header),
                    phone: times.time_ref.nanos(),
                }));
                self.pulses += 1;
            }
            "mcu_lidar_ts" => self.times(Reference::Lidar, &read(message)?),
            "mcu_s10_ts" => self.times(Reference::Phone, &read(message)?),
            "depth_to_mcu_offset" => self.times(Reference::DepthOffset, &read(message)?),
            "sequences_ts" => self.mark(&read(message)?),
            _ => return Ok(()),
        }
        self.release_samples();
        if !self.published {
            self.published = true;
            self.events.push_back(BoardEvent::Published);
        }
        Ok(())
    }

    fn mark(&mut self, times: &TimeReference) {
        let mark = BoardEvent::Mark(stamp(&times.header));
        self.events.push_back(mark);
        self.times(Reference::Sequences, times);
    }

    fn release_samples(&mut self) {
        let ready = std::iter::from_fn(|| self.samples.next_ready());
        self.events.extend(ready.map(BoardEvent::Sample));
    }

    fn times(&mut self, of: Reference, times: &TimeReference) {
        self.pair(of, stamp(&times.header), times.time_ref.nanos());
    }

    fn pair(&mut self, of: Reference, stamp: BoardNanos, other: i64) {
        let count = self.counts.entry(discriminant(&of)).or_default();
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

/// Reads a message of a topic that is not one of ours, after a check of its type.
fn read<M: RosMessage>(message: &Message<'_>) -> Result<M, String> {
    let kind = &message.channel.kind;
    if kind != M::TYPE {
        return Err(format!("it is a {kind}, expected {}", M::TYPE));
    }
    from_cdr(message.data).map_err(|error| error.to_string())
}

fn stamp(header: &messages::Header) -> BoardNanos {
    board_time(header.stamp)
}

/// Returns the stamp of a message as board time.
pub(crate) fn board_time(stamp: Time) -> BoardNanos {
    BoardNanos(stamp.nanos())
}

fn exchange_of(exchange: &messages::ClockExchange) -> BoardEvent {
    let asked = if exchange.header.frame_id == "board" {
        Asked::A
    } else {
        Asked::B
    };
    let seconds = |nanos| PhoneNanos(nanos).seconds().0;
    let exchange = Exchange {
        sent: seconds(exchange.sent_ns),
        received: seconds(exchange.received_ns),
        stamp: seconds(exchange.clock_ns),
    };
    BoardEvent::Exchange(asked, exchange)
}
