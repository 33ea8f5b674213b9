//! IMU messages of MCAP files and ROS 1 bags.

use std::collections::{BTreeMap, HashMap};
use std::io::BufReader;
use std::path::Path;

use extract::bag::messages::Imu as BagImu;
use extract::bag::reader::{Bag, BagError};
use mcap::records::{Record, op};
use recording::chunks::{Chunks, ChunksError};
use recording::messages::{Imu, RosMessage, from_cdr};

use crate::{GyroFileError, GyroRecording};

/// Channel, sequence, log time and publish time in front of a message.
const MESSAGE_HEAD: usize = 22;

/// Samples of each topic with a gyroscope.
#[derive(Default)]
struct Topics {
    samples: BTreeMap<String, (Vec<i64>, Vec<[f64; 3]>)>,
    /// Topics of other types.
    others: Vec<String>,
    broken: u64,
    damage: Vec<String>,
}

impl Topics {
    fn add(&mut self, topic: &str, at: i64, rate: [f64; 3]) {
        if !self.samples.contains_key(topic) {
            self.samples.insert(topic.to_owned(), Default::default());
        }
        if let Some((times, rates)) = self.samples.get_mut(topic) {
            times.push(at);
            rates.push(rate);
        }
    }

    fn chosen(
        mut self,
        form: &'static str,
        topic: Option<&str>,
    ) -> Result<GyroRecording, GyroFileError> {
        let names = || self.samples.keys().cloned().collect::<Vec<_>>();
        let name = match (topic, names().as_slice()) {
            (Some(topic), _) => topic.to_owned(),
            (None, [only]) => only.clone(),
            (None, []) => String::new(),
            (None, several) => return Err(GyroFileError::Several(several.to_vec())),
        };
        let Some((times, rates)) = self.samples.remove(&name) else {
            let mut there: Vec<String> = self.samples.into_keys().chain(self.others).collect();
            there.sort();
            there.dedup();
            let found = match (topic, there.is_empty()) {
                (_, true) => String::from("it has no topics"),
                (Some(topic), _) => {
                    format!("no IMU on topic {topic}; there are {}", there.join(", "))
                }
                (None, _) => format!("its topics are {}", there.join(", ")),
            };
            return Err(GyroFileError::None { form, found });
        };
        if self.broken > 0 {
            let broken = format!("{} messages cannot be decoded", self.broken);
            self.damage.push(broken);
        }
        Ok(GyroRecording {
            form: format!("{form}: {name}, times of the messages' headers"),
            times,
            rates,
            damage: self.damage,
        })
    }
}

/// Topics of an MCAP file by channel, types by schema.
#[derive(Default)]
struct Channels {
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, (String, u16)>,
}

impl Channels {
    /// The topic of a channel whose messages are of an IMU.
    fn imu(&self, channel: u16) -> Option<&str> {
        let (topic, schema) = self.channels.get(&channel)?;
        let is_imu = self
            .schemas
            .get(schema)
            .is_some_and(|name| name == Imu::TYPE);
        is_imu.then_some(topic.as_str())
    }
}

pub(crate) fn mcap(path: &Path, topic: Option<&str>) -> Result<GyroRecording, GyroFileError> {
    let mut chunks = Chunks::open(path)?;
    let (mut known, mut out) = (Channels::default(), Topics::default());
    let mut memory = Vec::new();
    loop {
        let packed = match chunks.next_packed() {
            Ok(Some(packed)) => packed,
            Ok(None) => break,
            // Only an index and statistics are missing.
            Err(_) if chunks.data_complete() => break,
            Err(ChunksError::Read(error)) => return Err(error.into()),
            Err(error) if out.samples.is_empty() => {
                return Err(GyroFileError::Mcap(error.to_string()));
            }
            Err(error) => {
                let at = chunks.position();
                out.damage
                    .push(format!("it cannot be read beyond byte {at}: {error}"));
                break;
            }
        };
        let chunk = match packed.unpack(memory) {
            Ok(chunk) => chunk,
            Err(why) => {
                out.damage.push(format!("a chunk is left out: {why}"));
                memory = Vec::new();
                continue;
            }
        };
        for (opcode, body) in chunk.records() {
            record(opcode, body, &mut known, &mut out);
        }
        memory = chunk.into_memory();
    }
    // Of a file whose chunks cannot be unpacked, that is the reason.
    match out.damage.first() {
        Some(damage) if known.channels.is_empty() => Err(GyroFileError::Mcap(damage.clone())),
        _ => out.chosen("MCAP", topic),
    }
}

fn record(opcode: u8, body: &[u8], known: &mut Channels, out: &mut Topics) {
    match opcode {
        op::MESSAGE => {
            let Some((head, data)) = body.split_first_chunk::<MESSAGE_HEAD>() else {
                out.broken += 1;
                return;
            };
            let Some(topic) = known.imu(u16::from_le_bytes([head[0], head[1]])) else {
                return;
            };
            match from_cdr::<Imu>(data) {
                Ok(imu) => out.add(topic, imu.header.stamp.nanos(), imu.angular_velocity.into()),
                Err(_) => out.broken += 1,
            }
        }
        op::SCHEMA | op::CHANNEL => match recording::chunks::parse(opcode, body) {
            Some(Record::Schema { header, .. }) => {
                known.schemas.insert(header.id, header.name);
            }
            Some(Record::Channel(channel)) => {
                out.others.push(channel.topic.clone());
                let of = (channel.topic, channel.schema_id);
                known.channels.insert(channel.id, of);
            }
            _ => {}
        },
        _ => {}
    }
}

pub(crate) fn bag(path: &Path, topic: Option<&str>) -> Result<GyroRecording, GyroFileError> {
    let mut bag = Bag::open(BufReader::with_capacity(1 << 20, files::open(path)?))?;
    let mut out = Topics::default();
    let mut others = std::collections::BTreeSet::new();
    loop {
        let more = bag.next_chunk::<BagError>(|message| {
            if message.connection.kind != BagImu::KIND {
                if !others.contains(&*message.connection.topic) {
                    others.insert(message.connection.topic.to_string());
                }
            } else if let Ok(imu) = BagImu::parse(message.data) {
                out.add(&message.connection.topic, imu.header.stamp, imu.gyro);
            } else {
                out.broken += 1;
            }
            Ok(())
        })?;
        if !more {
            break;
        }
    }
    out.others = others.into_iter().collect();
    let damage = bag
        .damage()
        .iter()
        .map(|d| format!("at byte {}: {}", d.at, d.what));
    out.damage = damage.collect();
    out.chosen("ROS 1 bag", topic)
}
