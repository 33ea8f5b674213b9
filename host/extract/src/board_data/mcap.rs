//! Our own recordings (`recording.mcap`, see `docs/formats.md`) as events.
//!
//! What is damaged is left out and named; a file that was not closed is read to its last
//! whole chunk.
//!
//! In the topics layout our topics have the published system's names:
//! `/board/trigger` is `/mcu_cameras_ts`, `/session/markers` is `/sequences_ts`,
//! `/board/gnss` is `/mcu_lidar_ts`, and each clock model is a pair on `/mcu_s10_ts`.
//! Pulses of the further outputs come as `/output/` and the sensor's name.

use std::collections::VecDeque;
use std::path::Path;

use recording::messages::{self, ClockModel};
use recording::walk::{Event, Message, Walk};
use recording::{Item, RecordingError, Topic};
use timebase::{BoardSeconds, PhoneNanos, Wander};
use twist_sync::tracker::{Asked, Exchange};

use super::{BoardError, BoardEvent, BoardStream, ImuRow, LIDAR_TOPIC, OUTPUT_TOPICS, TimePair};
use crate::depth_clock::PulseTime;
use crate::time::BoardNanos;
use formats::faults::Faults;

/// How many faults are kept with their text.
const MAX_FAULTS: usize = 50;

/// Topics whose messages become nothing, and so are not even decoded.
const PASSED_OVER: [Topic; 7] = [
    Topic::Strobe,
    Topic::Capture,
    Topic::Status,
    Topic::Link,
    Topic::HostTime,
    Topic::Period,
    Topic::Log,
];

/// Names of the published system.
const CAMERAS: &str = "/mcu_cameras_ts";
const PHONE: &str = "/mcu_s10_ts";
const SEQUENCES: &str = "/sequences_ts";

pub(super) struct McapStream {
    walk: Walk,
    sorter: Sorter,
}

struct Sorter {
    events: VecDeque<BoardEvent>,
    /// The last sample, until its temperature or the next sample comes.
    waiting: Option<ImuRow>,
    faults: Faults,
}

impl McapStream {
    pub(super) fn open(path: &Path) -> Result<Self, BoardError> {
        Ok(Self {
            walk: Walk::open(path)?,
            sorter: Sorter {
                events: VecDeque::new(),
                waiting: None,
                faults: Faults::new(MAX_FAULTS),
            },
        })
    }
}

impl BoardStream for McapStream {
    fn next_event(&mut self) -> Result<Option<BoardEvent>, BoardError> {
        loop {
            if let Some(event) = self.sorter.events.pop_front() {
                return Ok(Some(event));
            }
            let sorter = &mut self.sorter;
            let more = self.walk.next_part(&mut |event| {
                match event {
                    Event::Message(message) => sorter.message(&message),
                    Event::Damage(damage) if damage.is_loss() => {
                        sorter.faults.add(damage.to_string())
                    }
                    _ => {}
                }
                Ok::<(), RecordingError>(())
            });
            if !more? && self.sorter.events.is_empty() {
                return Ok(self.sorter.waiting.take().map(BoardEvent::Imu));
            }
        }
    }

    fn damage(&self) -> Vec<String> {
        self.sorter.faults.words("damaged parts")
    }

    fn position(&self) -> u64 {
        self.walk.position()
    }
}

impl Sorter {
    fn message(&mut self, message: &Message<'_>) {
        let known = message.channel.known;
        if known.is_none_or(|topic| PASSED_OVER.contains(&topic)) {
            return;
        }
        match message.item() {
            Some(Ok(item)) => self.item(item, message.header.sequence),
            Some(Err(error)) => self.faults.add(format!(
                "a message of {} cannot be read: {error}",
                message.channel.described.topic
            )),
            None => {}
        }
    }

    /// Puts an event behind the others.
    fn give(&mut self, event: BoardEvent) {
        self.events.push_back(event);
    }

    fn times(&mut self, topic: &str, seq: u32, times: &messages::TimeReference) {
        let stamp = stamp(&times.header);
        self.pair(topic, seq, stamp, times.time_ref.nanos());
    }

    fn pair(&mut self, topic: &str, seq: u32, stamp: BoardNanos, other: i64) {
        self.give(BoardEvent::Times(TimePair {
            topic: topic.into(),
            seq,
            stamp,
            other,
        }));
    }

    fn item(&mut self, item: Item, seq: u32) {
        match item {
            Item::Imu(imu) => {
                let row = ImuRow {
                    at: stamp(&imu.header),
                    gyro: imu.angular_velocity,
                    accel: imu.linear_acceleration,
                    temperature: None,
                };
                let before = self.waiting.replace(row);
                self.events.extend(before.map(BoardEvent::Imu));
            }
            Item::Temperature(value) => {
                if let Some(mut row) = self.waiting.take() {
                    let is_its = row.at == stamp(&value.header);
                    row.temperature = is_its.then_some(value.temperature);
                    self.give(BoardEvent::Imu(row));
                }
            }
            Item::Trigger(times) => self.times(CAMERAS, seq, &times),
            Item::Pulse(pulse) => self.give(BoardEvent::Pulse(PulseTime {
                train: pulse.train,
                number: pulse.number,
                at: protocol::Ticks(pulse.ticks).into(),
            })),
            Item::Marker(times) => {
                self.give(BoardEvent::Mark(stamp(&times.header)));
                self.times(SEQUENCES, seq, &times);
            }
            Item::Output(pulse) => {
                let at = stamp(&pulse.header);
                let topic = format!("{OUTPUT_TOPICS}{}", pulse.header.frame_id);
                self.pair(&topic, seq, at, at.0);
            }
            Item::Gnss(times) => self.times(LIDAR_TOPIC, seq, &times),
            Item::Exchange(exchange) => self.give(exchange_of(&exchange)),
            Item::Clock(model) => {
                let relation = relation(&model);
                let at = stamp(&model.header);
                let phone = relation.to_phone(BoardSeconds(at.0 as f64 * 1e-9));
                self.pair(PHONE, seq, at, phone.nanos().0);
                self.give(BoardEvent::Clock(None, relation));
            }
            Item::PhoneClock(model) => {
                let relation = relation(&model);
                self.give(BoardEvent::Clock(Some(model.header.frame_id), relation));
            }
            Item::Strobe(_)
            | Item::Capture(_)
            | Item::Status(_)
            | Item::Link(_)
            | Item::HostTime(_)
            | Item::Period(_)
            | Item::Run(_)
            | Item::Log(_) => {}
        }
    }
}

fn stamp(header: &messages::Header) -> BoardNanos {
    BoardNanos(header.stamp.nanos())
}

fn relation(model: &ClockModel) -> timebase::ClockModel {
    let [a, b, c, d] = model.covariance;
    timebase::ClockModel {
        reference: BoardSeconds(model.reference_s),
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
