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
//! Where the board was reset, each run can be moved against the one before (the
//! session knew their distance only roughly), and trains go on being numbered.
//!
//! Limits: chunks are stored as they are or with LZ4, which is all that our writer
//! makes.

use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::McapError;
use mcap::records::{ChunkHeader, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader};
use rayon::prelude::*;

use super::{
    BoardError, BoardEvent, BoardStream, ImuRow, LIDAR_TOPIC, OUTPUT_TOPICS, RunMark, TimePair,
};
use crate::depth_clock::PulseTime;
use crate::faults::Faults;
use crate::time::{BoardNanos, SECOND};
use recording::messages::{self, ClockModel};
use recording::reader::{is_end, record_reader};
use recording::scan::{MAX_CHUNK, is_intact, records_of, unpack_records};
use recording::{Item, Topic};
use timebase::BoardSeconds;
use timebase::Wander;

/// Chunks that are decoded at a time, and their bytes at most.
const BATCH: usize = 64;
const BATCH_BYTES: usize = 32 << 20;
/// How many faults are kept with their text.
const MAX_FAULTS: usize = 50;

/// Whether the messages of a topic are looked at.
const fn is_of_use(topic: Topic) -> bool {
    match topic {
        Topic::Imu
        | Topic::Temperature
        | Topic::Trigger
        | Topic::Pulse
        | Topic::Clock
        | Topic::PhoneClock
        | Topic::Marker
        | Topic::Output
        | Topic::Gnss
        | Topic::Run => true,
        Topic::Strobe
        | Topic::Capture
        | Topic::Status
        | Topic::Link
        | Topic::HostTime
        | Topic::Log => false,
    }
}

/// Names of the published system.
struct Names {
    cameras: Arc<str>,
    phone: Arc<str>,
    sequences: Arc<str>,
    lidar: Arc<str>,
}

/// A chunk as it stands in the file.
struct Packed {
    header: ChunkHeader,
    data: Vec<u8>,
}

/// A decoded message.
enum Decoded {
    Event(BoardEvent),
    Temperature(BoardNanos, f64),
}

/// What came out of one chunk.
#[derive(Default)]
struct Outcome {
    decoded: Vec<Decoded>,
    broken: u64,
    fault: Option<String>,
}

pub(super) struct McapStream {
    reader: LinearReader,
    file: BufReader<File>,
    path: PathBuf,
    position: u64,
    /// Those that are of use.
    topics: HashMap<u16, Topic>,
    names: Names,
    events: VecDeque<BoardEvent>,
    /// Memory of the last batch's unpacked chunks, for the next one: asking the system for
    /// it anew costs as much as unpacking.
    spare: Vec<Vec<u8>>,
    /// How much later each run is than it stands in the file, ns.
    moved: Vec<i64>,
    /// The run that is being read.
    run: usize,
    /// Trains of all former runs, and the highest number so far.
    trains: (u32, u32),
    /// The last sample, until its temperature or the next sample comes.
    waiting: Option<ImuRow>,
    faults: Faults,
    ended: bool,
}

impl McapStream {
    pub(super) fn open(path: &Path, moved: &[i64]) -> Result<Self, BoardError> {
        let unreadable = |error| BoardError::Open {
            path: path.to_owned(),
            error,
        };
        let file = File::open(path).map_err(unreadable)?;
        Ok(Self {
            reader: record_reader(&file).map_err(unreadable)?,
            file: BufReader::with_capacity(1 << 20, file),
            path: path.to_owned(),
            position: 0,
            topics: HashMap::new(),
            names: Names {
                cameras: "/mcu_cameras_ts".into(),
                phone: "/mcu_s10_ts".into(),
                sequences: "/sequences_ts".into(),
                lidar: LIDAR_TOPIC.into(),
            },
            events: VecDeque::new(),
            spare: Vec::new(),
            moved: moved.to_vec(),
            run: 0,
            trains: (0, 0),
            waiting: None,
            faults: Faults::new(MAX_FAULTS),
            ended: false,
        })
    }

    /// The next record of the file that matters here. `None` at its end.
    fn next_chunk(&mut self) -> Result<Option<Packed>, BoardError> {
        while !self.ended {
            let event = match self.reader.next_event() {
                None => {
                    self.ended = true;
                    return Ok(None);
                }
                Some(Ok(event)) => event,
                Some(Err(error)) => {
                    self.ended = true;
                    if self.position <= mcap::MAGIC.len() as u64 || is_bad_magic(&error) {
                        return Err(self.not_mcap(&error));
                    }
                    let at = self.position;
                    self.faults.add(if is_end(&error) {
                        format!(
                            "the recording was not closed: it ends at byte {at}, and at most its last second is missing"
                        )
                    } else {
                        format!("the recording cannot be read beyond byte {at}: {error}")
                    });
                    return Ok(None);
                }
            };
            match event {
                LinearReadEvent::ReadRequest(need) => {
                    let space = self.reader.insert(need);
                    let count = self.file.read(space).map_err(|error| BoardError::Open {
                        path: self.path.clone(),
                        error,
                    })?;
                    self.position += count as u64;
                    self.reader.notify_read(count);
                }
                LinearReadEvent::Record { data, opcode } => match opcode {
                    op::CHUNK => match mcap::parse_record(opcode, data) {
                        Ok(Record::Chunk { header, data }) => {
                            return Ok(Some(Packed {
                                header,
                                data: data.into_owned(),
                            }));
                        }
                        _ => self.faults.add("a chunk's head cannot be read".into()),
                    },
                    op::CHANNEL => {
                        let data = data.to_vec();
                        self.channel(&data);
                    }
                    // Only an index and statistics follow.
                    op::DATA_END => {
                        self.ended = true;
                    }
                    _ => {}
                },
            }
        }
        Ok(None)
    }

    fn not_mcap(&self, error: &McapError) -> BoardError {
        BoardError::NotMcap {
            path: self.path.clone(),
            what: error.to_string(),
        }
    }

    fn channel(&mut self, data: &[u8]) {
        if let Ok(Record::Channel(channel)) = mcap::parse_record(op::CHANNEL, data)
            && let Some(topic) = Topic::of(&channel.topic).filter(|topic| is_of_use(*topic))
        {
            self.topics.insert(channel.id, topic);
        }
    }

    /// Reads and decodes a batch of chunks. False at the end.
    fn next_batch(&mut self) -> Result<bool, BoardError> {
        let mut batch = Vec::with_capacity(BATCH);
        let mut bytes = 0;
        while batch.len() < BATCH && bytes < BATCH_BYTES {
            let Some(chunk) = self.next_chunk()? else {
                break;
            };
            bytes += chunk.data.len();
            batch.push(chunk);
        }
        if batch.is_empty() {
            return Ok(false);
        }
        self.spare.resize_with(batch.len(), Vec::new);
        let memory = self.spare.drain(..);
        let jobs: Vec<(Packed, Vec<u8>)> = batch.into_iter().zip(memory).collect();
        let unpacked: Vec<Result<Vec<u8>, String>> = jobs
            .into_par_iter()
            .map(|(chunk, memory)| unpack(chunk, memory))
            .collect();
        // Channels may be described in any chunk: take them up in order first.
        for chunk in unpacked.iter().flatten() {
            for (_, data) in records_of(chunk).filter(|(opcode, _)| *opcode == op::CHANNEL) {
                self.channel(data);
            }
        }
        let (topics, names) = (&self.topics, &self.names);
        let outcomes: Vec<Outcome> = unpacked
            .par_iter()
            .map(|chunk| match chunk {
                Ok(chunk) => decode(chunk, topics, names),
                Err(fault) => Outcome {
                    fault: Some(fault.clone()),
                    ..Outcome::default()
                },
            })
            .collect();
        self.spare.extend(unpacked.into_iter().flatten());
        for outcome in outcomes {
            if let Some(fault) = outcome.fault {
                self.faults.add(fault);
            }
            if outcome.broken > 0 {
                self.faults
                    .add(format!("{} messages cannot be decoded", outcome.broken));
            }
            for decoded in outcome.decoded {
                self.give(decoded);
            }
        }
        Ok(true)
    }

    /// Puts a message of this run where the run lies.
    fn place(&mut self, decoded: Decoded) -> Decoded {
        let by = |run: usize| self.moved.get(run).copied().unwrap_or_default();
        let move_by = by(self.run);
        let seconds = move_by as f64 * 1e-9;
        let later = |at: BoardNanos| BoardNanos(at.0.saturating_add(move_by));
        match decoded {
            Decoded::Temperature(at, value) => Decoded::Temperature(later(at), value),
            Decoded::Event(event) => Decoded::Event(match event {
                BoardEvent::Imu(row) => BoardEvent::Imu(ImuRow {
                    at: later(row.at),
                    ..row
                }),
                BoardEvent::Pulse(pulse) => {
                    let train = self.trains.0.saturating_add(pulse.train);
                    self.trains.1 = self.trains.1.max(train);
                    BoardEvent::Pulse(PulseTime {
                        train,
                        at: later(pulse.at),
                        ..pulse
                    })
                }
                BoardEvent::Mark(at) => BoardEvent::Mark(later(at)),
                BoardEvent::Times(pair) => BoardEvent::Times(TimePair {
                    stamp: later(pair.stamp),
                    ..pair
                }),
                BoardEvent::Clock(phone, model) => {
                    BoardEvent::Clock(phone, model.with_board_later(seconds))
                }
                BoardEvent::Run(mark) => {
                    self.trains.0 = self.trains.1;
                    self.run += 1;
                    let from = mark.from.0.saturating_add(by(self.run));
                    BoardEvent::Run(RunMark {
                        from: BoardNanos(from),
                        last: later(mark.last),
                        ..mark
                    })
                }
                BoardEvent::Image(image) => BoardEvent::Image(image),
            }),
        }
    }

    /// Puts a decoded message into the queue; samples with their temperature.
    fn give(&mut self, decoded: Decoded) {
        let decoded = self.place(decoded);
        match decoded {
            Decoded::Temperature(at, temperature) => {
                if let Some(mut row) = self.waiting.take() {
                    if row.at == at {
                        row.temperature = Some(temperature);
                    }
                    self.events.push_back(BoardEvent::Imu(row));
                }
            }
            Decoded::Event(BoardEvent::Imu(row)) => {
                if let Some(before) = self.waiting.replace(row) {
                    self.events.push_back(BoardEvent::Imu(before));
                }
            }
            Decoded::Event(event) => self.events.push_back(event),
        }
    }
}

impl BoardStream for McapStream {
    fn next_event(&mut self) -> Result<Option<BoardEvent>, BoardError> {
        loop {
            if let Some(event) = self.events.pop_front() {
                return Ok(Some(event));
            }
            if !self.next_batch()? {
                return Ok(self.waiting.take().map(BoardEvent::Imu));
            }
        }
    }

    fn damage(&self) -> Vec<String> {
        self.faults.words("damaged parts")
    }

    fn position(&self) -> u64 {
        self.position
    }
}

fn is_bad_magic(error: &McapError) -> bool {
    matches!(error, McapError::BadMagic)
}

/// A chunk's records, in `out` if they are packed.
fn unpack(chunk: Packed, out: Vec<u8>) -> Result<Vec<u8>, String> {
    let header = &chunk.header;
    let seconds = header.message_start_time / SECOND.unsigned_abs();
    let from = format!("the chunk from second {seconds} of board time on");
    if header.uncompressed_size > MAX_CHUNK {
        return Err(format!("{from} claims more than any real one holds"));
    }
    let compression = header.compression.as_str();
    let data = unpack_records(compression, chunk.data.into(), out).map_err(|error| {
        if error.kind() == io::ErrorKind::Unsupported {
            let other: String = compression.chars().take(16).collect();
            format!("{from} is packed with {other:?}; expected lz4 or nothing")
        } else {
            format!("{from} cannot be unpacked: {error}")
        }
    })?;
    if !is_intact(header, &data) {
        return Err(format!("{from} is damaged: its checksum is wrong"));
    }
    Ok(data)
}

fn decode(chunk: &[u8], topics: &HashMap<u16, Topic>, names: &Names) -> Outcome {
    let mut out = Outcome::default();
    for (opcode, body) in records_of(chunk) {
        if opcode != op::MESSAGE {
            continue;
        }
        // channel u16, sequence u32, log time u64, publish time u64, then the data.
        let Some((head, data)) = body.split_first_chunk::<22>() else {
            out.broken += 1;
            continue;
        };
        let channel = u16::from_le_bytes([head[0], head[1]]);
        let sequence = u32::from_le_bytes([head[2], head[3], head[4], head[5]]);
        let Some(topic) = topics.get(&channel) else {
            continue;
        };
        match topic.read(data) {
            Ok(item) => message(item, sequence, names, &mut out.decoded),
            Err(_) => out.broken += 1,
        }
    }
    out
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

fn message(item: Item, sequence: u32, names: &Names, out: &mut Vec<Decoded>) {
    let stamp = |header: &messages::Header| BoardNanos(header.stamp.nanos());
    let mut event = |event| out.push(Decoded::Event(event));
    match item {
        Item::Imu(imu) => {
            event(BoardEvent::Imu(ImuRow {
                at: stamp(&imu.header),
                gyro: imu.angular_velocity.into(),
                accel: imu.linear_acceleration.into(),
                temperature: None,
            }));
        }
        Item::Temperature(value) => {
            out.push(Decoded::Temperature(
                stamp(&value.header),
                value.temperature,
            ));
        }
        Item::Trigger(times) => {
            event(BoardEvent::Times(TimePair {
                topic: names.cameras.clone(),
                seq: sequence,
                stamp: stamp(&times.header),
                other: times.time_ref.nanos(),
            }));
        }
        Item::Pulse(pulse) => {
            event(BoardEvent::Pulse(PulseTime {
                train: pulse.train,
                number: pulse.number,
                at: protocol::Ticks(pulse.ticks).into(),
            }));
        }
        Item::Marker(times) => {
            let stamp = stamp(&times.header);
            event(BoardEvent::Mark(stamp));
            event(BoardEvent::Times(TimePair {
                topic: names.sequences.clone(),
                seq: sequence,
                stamp,
                other: times.time_ref.nanos(),
            }));
        }
        Item::Output(pulse) => {
            let at = stamp(&pulse.header);
            event(BoardEvent::Times(TimePair {
                topic: format!("{OUTPUT_TOPICS}{}", pulse.header.frame_id).into(),
                seq: sequence,
                stamp: at,
                other: at.0,
            }));
        }
        Item::Gnss(times) => {
            event(BoardEvent::Times(TimePair {
                topic: names.lidar.clone(),
                seq: sequence,
                stamp: stamp(&times.header),
                other: times.time_ref.nanos(),
            }));
        }
        Item::Run(run) => {
            event(BoardEvent::Run(RunMark {
                from: stamp(&run.header),
                last: protocol::Ticks(run.last_ticks).into(),
                sigma_s: run.shift_sigma_s,
            }));
        }
        Item::Clock(model) => {
            let relation = relation(&model);
            let stamp = stamp(&model.header);
            event(BoardEvent::Times(TimePair {
                topic: names.phone.clone(),
                seq: sequence,
                stamp,
                other: relation
                    .to_phone(BoardSeconds(stamp.0 as f64 * 1e-9))
                    .nanos()
                    .0,
            }));
            event(BoardEvent::Clock(None, relation));
        }
        Item::PhoneClock(model) => {
            let relation = relation(&model);
            event(BoardEvent::Clock(Some(model.header.frame_id), relation));
        }
        Item::Strobe(_)
        | Item::Capture(_)
        | Item::Status(_)
        | Item::Link(_)
        | Item::HostTime(_)
        | Item::Log(_) => {}
    }
}
