//! Our own recordings (`recording.mcap`, see `docs/formats.md`) as events.
//!
//! [`recording::reader`] reads such a file message by message. The
//! extraction goes over hours of samples more than once, so it takes whole chunks
//! instead: a batch of them is read, unpacked and decoded in parallel, and only
//! messages of the topics that it needs are looked at. A chunk whose checksum is
//! wrong, or that cannot be unpacked, is left out and named; a file that was not
//! closed is read to its last whole chunk.
//!
//! In the topics layout our topics have the published system's names:
//! `/board/trigger` is `/mcu_cameras_ts`, `/session/markers` is `/sequences_ts`,
//! `/board/gnss` is `/mcu_lidar_ts`, and each clock model is a pair on `/mcu_s10_ts`.
//! Pulses of the further outputs come as `/output/` and the sensor's name.
//!
//! Limits: chunks are stored as they are or with LZ4, which is all that our writer
//! makes.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use mcap::records::{Record, op};
use rayon::prelude::*;
use recording::chunks::{BadChunk, Chunk, Chunks, ChunksError, OWN_RATIO, Packed, parse};
use recording::messages::{self, ClockModel};
use recording::{Item, Topic};
use timebase::{BoardSeconds, PhoneNanos, Wander};
use twist_sync::tracker::{Asked, Exchange};

use super::{BoardError, BoardEvent, BoardStream, ImuRow, LIDAR_TOPIC, OUTPUT_TOPICS, TimePair};
use crate::depth_clock::PulseTime;
use crate::time::{BoardNanos, SECOND};
use formats::faults::Faults;

/// Chunks that are decoded at a time, and from how many bytes on no further one is
/// taken. A chunk of ours is some 100 kB when unpacked: so many stay in the processor's
/// cache, with what comes out of them.
const BATCH: usize = 12;
const BATCH_BYTES: u64 = 8 << 20;
/// Memory for unpacking that is kept for the next batch, of each chunk.
const SPARE_BYTES: usize = 1 << 20;
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

/// A decoded message.
enum Decoded {
    Event(BoardEvent),
    Temperature(BoardNanos, f64),
}

/// What came out of one chunk, and how many of its messages cannot be decoded.
type Outcome = (Vec<Decoded>, u64);

pub(super) struct McapStream {
    chunks: Chunks,
    path: PathBuf,
    /// Those that are of use.
    topics: HashMap<u16, Topic>,
    /// Decoded, but not yet put in their place.
    decoded: std::iter::Flatten<std::vec::IntoIter<Vec<Decoded>>>,
    /// Memory of the last batch's unpacked chunks, for the next one: asking the system for
    /// it anew costs as much as unpacking.
    spare: Vec<Vec<u8>>,
    /// The last sample, until its temperature or the next sample comes.
    waiting: Option<ImuRow>,
    faults: Faults,
    ended: bool,
}

impl McapStream {
    pub(super) fn open(path: &Path) -> Result<Self, BoardError> {
        let chunks = Chunks::open(path, OWN_RATIO).map_err(|error| BoardError::Open {
            path: path.to_owned(),
            error,
        })?;
        Ok(Self {
            chunks,
            path: path.to_owned(),
            topics: HashMap::new(),
            decoded: Vec::new().into_iter().flatten(),
            spare: Vec::new(),
            waiting: None,
            faults: Faults::new(MAX_FAULTS),
            ended: false,
        })
    }

    /// The next chunk of the file. `None` at its end, or where it breaks off.
    fn next_chunk(&mut self) -> Result<Option<Packed>, BoardError> {
        if self.ended {
            return Ok(None);
        }
        let next = self.chunks.next_packed();
        self.ended = !matches!(next, Ok(Some(_)));
        let at = self.chunks.position();
        let path = self.path.clone();
        match next {
            Ok(chunk) => return Ok(chunk),
            // Only an index and statistics are missing.
            Err(_) if self.chunks.data_complete() => {}
            Err(ChunksError::Read(error)) => return Err(BoardError::Open { path, error }),
            Err(error)
                if at <= mcap::MAGIC.len() as u64
                    || matches!(error, ChunksError::Mcap(mcap::McapError::BadMagic)) =>
            {
                let what = error.to_string();
                return Err(BoardError::NotMcap { path, what });
            }
            Err(ChunksError::CutOff) => self.faults.add(format!(
                "the recording was not closed: it ends at byte {at}, and at most its last second is missing"
            )),
            Err(error) => self.faults.add(format!(
                "the recording cannot be read beyond byte {at}: {error}"
            )),
        }
        Ok(None)
    }

    /// Reads and decodes a batch of chunks. False at the end.
    fn next_batch(&mut self) -> Result<bool, BoardError> {
        let mut batch = Vec::with_capacity(BATCH);
        let mut bytes = 0;
        while batch.len() < BATCH && bytes < BATCH_BYTES {
            let Some(chunk) = self.next_chunk()? else {
                break;
            };
            bytes += chunk.size();
            batch.push(chunk);
        }
        if batch.is_empty() {
            return Ok(false);
        }
        self.spare.resize_with(batch.len(), Vec::new);
        let memory = self.spare.drain(..);
        let jobs: Vec<(Packed, Vec<u8>)> = batch.into_iter().zip(memory).collect();
        let unpacked: Vec<Result<Unpacked, String>> = jobs
            .into_par_iter()
            .map(|(chunk, memory)| {
                let from = chunk.starts_at();
                let chunk = chunk.unpack(memory).map_err(|why| left_out(from, &why))?;
                Ok(Unpacked::new(chunk))
            })
            .collect();
        // Channels may be described in any chunk: take them up in order first.
        for chunk in unpacked.iter().flatten() {
            self.topics.extend(chunk.channels.iter().copied());
        }
        let topics = &self.topics;
        let outcomes: Vec<Result<Outcome, String>> = unpacked
            .par_iter()
            .map(|unpacked| match unpacked {
                Ok(unpacked) => Ok(decode(&unpacked.chunk, topics)),
                Err(fault) => Err(fault.clone()),
            })
            .collect();
        let cut_off = unpacked.iter().flatten().map(|chunk| chunk.cut_off);
        for bytes in cut_off.filter(|&bytes| bytes > 0) {
            self.faults.add(format!(
                "a chunk ends within a record: {bytes} bytes are left out"
            ));
        }
        let chunks = unpacked.into_iter().flatten();
        let memory = chunks.map(|unpacked| unpacked.chunk.into_memory());
        let small = memory.filter(|memory| memory.capacity() <= SPARE_BYTES);
        self.spare.extend(small);
        let mut decoded = Vec::with_capacity(outcomes.len());
        for outcome in outcomes {
            match outcome {
                Err(fault) => self.faults.add(fault),
                Ok((messages, broken)) => {
                    if broken > 0 {
                        let what = format!("{broken} messages cannot be decoded");
                        self.faults.add(what);
                    }
                    decoded.push(messages);
                }
            }
        }
        self.decoded = decoded.into_iter().flatten();
        Ok(true)
    }

    /// Puts a decoded message in its place; a sample waits for its temperature.
    fn give(&mut self, decoded: Decoded) -> Option<BoardEvent> {
        match decoded {
            Decoded::Temperature(at, temperature) => {
                let mut row = self.waiting.take()?;
                if row.at == at {
                    row.temperature = Some(temperature);
                }
                Some(BoardEvent::Imu(row))
            }
            Decoded::Event(BoardEvent::Imu(row)) => self.waiting.replace(row).map(BoardEvent::Imu),
            Decoded::Event(event) => Some(event),
        }
    }
}

impl BoardStream for McapStream {
    fn next_event(&mut self) -> Result<Option<BoardEvent>, BoardError> {
        loop {
            if let Some(decoded) = self.decoded.next() {
                if let Some(event) = self.give(decoded) {
                    return Ok(Some(event));
                }
            } else if !self.next_batch()? {
                return Ok(self.waiting.take().map(BoardEvent::Imu));
            }
        }
    }

    fn damage(&self) -> Vec<String> {
        self.faults.words("damaged parts")
    }

    fn position(&self) -> u64 {
        self.chunks.position()
    }
}

/// A chunk, and what must be known of it before those of its batch are decoded.
struct Unpacked {
    chunk: Chunk,
    /// That are of use.
    channels: Vec<(u16, Topic)>,
    /// Bytes behind its last whole record.
    cut_off: usize,
}

impl Unpacked {
    fn new(chunk: Chunk) -> Self {
        let described = chunk.records().filter(|(opcode, _)| *opcode == op::CHANNEL);
        let channels = described.filter_map(|(opcode, data)| {
            let Some(Record::Channel(channel)) = parse(opcode, data) else {
                return None;
            };
            let topic = Topic::of(&channel.topic)?;
            (!PASSED_OVER.contains(&topic)).then_some((channel.id, topic))
        });
        Self {
            channels: channels.collect(),
            cut_off: chunk.cut_off(),
            chunk,
        }
    }
}

/// A chunk that is left out, in words; `from` is the board time of its first message, ns.
fn left_out(from: Option<u64>, why: &BadChunk) -> String {
    match from {
        Some(from) => {
            let seconds = from / SECOND.unsigned_abs();
            format!("the chunk from second {seconds} of board time on is left out: {why}")
        }
        None => format!("a chunk is left out: {why}"),
    }
}

fn decode(chunk: &Chunk, topics: &HashMap<u16, Topic>) -> Outcome {
    let (mut decoded, mut broken) = (Vec::new(), 0);
    for (_, body) in chunk.records().filter(|(opcode, _)| *opcode == op::MESSAGE) {
        // channel u16, sequence u32, log time u64, publish time u64, then the data.
        let Some((head, data)) = body.split_first_chunk::<22>() else {
            broken += 1;
            continue;
        };
        let channel = u16::from_le_bytes([head[0], head[1]]);
        let sequence = u32::from_le_bytes([head[2], head[3], head[4], head[5]]);
        let Some(topic) = topics.get(&channel) else {
            continue;
        };
        match topic.read(data) {
            Ok(item) => message(item, sequence, &mut decoded),
            Err(_) => broken += 1,
        }
    }
    (decoded, broken)
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

fn message(item: Item, seq: u32, out: &mut Vec<Decoded>) {
    let stamp = |header: &messages::Header| BoardNanos(header.stamp.nanos());
    let pair = |topic: &str, stamp, other| {
        let pair = TimePair {
            topic: topic.into(),
            seq,
            stamp,
            other,
        };
        Decoded::Event(BoardEvent::Times(pair))
    };
    let reference = |topic: &str, times: &messages::TimeReference| {
        pair(topic, stamp(&times.header), times.time_ref.nanos())
    };
    let decoded = match item {
        Item::Imu(imu) => Decoded::Event(BoardEvent::Imu(ImuRow {
            at: stamp(&imu.header),
            gyro: imu.angular_velocity,
            accel: imu.linear_acceleration,
            temperature: None,
        })),
        Item::Temperature(value) => Decoded::Temperature(stamp(&value.header), value.temperature),
        Item::Trigger(times) => reference(CAMERAS, &times),
        Item::Pulse(pulse) => Decoded::Event(BoardEvent::Pulse(PulseTime {
            train: pulse.train,
            number: pulse.number,
            at: protocol::Ticks(pulse.ticks).into(),
        })),
        Item::Marker(times) => {
            out.push(Decoded::Event(BoardEvent::Mark(stamp(&times.header))));
            reference(SEQUENCES, &times)
        }
        Item::Output(pulse) => {
            let at = stamp(&pulse.header);
            let topic = format!("{OUTPUT_TOPICS}{}", pulse.header.frame_id);
            pair(&topic, at, at.0)
        }
        Item::Gnss(times) => reference(LIDAR_TOPIC, &times),
        Item::Exchange(exchange) => Decoded::Event(exchange_of(&exchange)),
        Item::Clock(model) => {
            let relation = relation(&model);
            let at = stamp(&model.header);
            let phone = relation.to_phone(BoardSeconds(at.0 as f64 * 1e-9));
            out.push(pair(PHONE, at, phone.nanos().0));
            Decoded::Event(BoardEvent::Clock(None, relation))
        }
        Item::PhoneClock(model) => {
            let relation = relation(&model);
            Decoded::Event(BoardEvent::Clock(Some(model.header.frame_id), relation))
        }
        Item::Strobe(_)
        | Item::Capture(_)
        | Item::Status(_)
        | Item::Link(_)
        | Item::HostTime(_)
        | Item::Period(_)
        | Item::Run(_)
        | Item::Log(_) => return,
    };
    out.push(decoded);
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
