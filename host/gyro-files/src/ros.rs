//! IMU messages of MCAP files and ROS 1 bags.

use std::collections::BTreeMap;
use std::io::BufReader;
use std::path::Path;

use extract::bag::messages::Imu as BagImu;
use extract::bag::reader::{Bag, BagError};
use recording::chunks::ChunksError;
use recording::foreign::{Messages, Next};
use recording::messages::{Imu, RosMessage, from_cdr};

use crate::{GyroFileError, GyroRecording};

/// Samples of each topic with a gyroscope.
#[derive(Default)]
struct Topics {
    samples: BTreeMap<String, (Vec<i64>, Vec<[f64; 3]>)>,
    /// Topics of other types; those with a gyroscope may be among them.
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

pub(crate) fn mcap(path: &Path, topic: Option<&str>) -> Result<GyroRecording, GyroFileError> {
    let mut messages = Messages::open(path)?;
    let mut out = Topics::default();
    loop {
        let next = messages.next_chunk(|message| {
            if message.kind != Imu::TYPE {
                return;
            }
            match from_cdr::<Imu>(message.data) {
                Ok(imu) => out.add(
                    message.topic,
                    imu.header.stamp.nanos(),
                    imu.angular_velocity.into(),
                ),
                Err(_) => out.broken += 1,
            }
        });
        match next {
            Ok(Next::Given) => {}
            Ok(Next::LeftOut(why)) => out.damage.push(format!("a chunk is left out: {why}")),
            Ok(Next::End) => break,
            Err(ChunksError::Read(error)) => return Err(error.into()),
            Err(error) if out.samples.is_empty() => {
                return Err(GyroFileError::Mcap(error.to_string()));
            }
            Err(error) => {
                let at = messages.position();
                out.damage
                    .push(format!("it cannot be read beyond byte {at}: {error}"));
                break;
            }
        }
    }
    out.others = messages.topics().map(str::to_owned).collect();
    // Of a file whose chunks cannot be unpacked, that is the reason.
    match out.damage.first() {
        Some(damage) if out.others.is_empty() => Err(GyroFileError::Mcap(damage.clone())),
        _ => out.chosen("MCAP", topic),
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
    out.damage = bag.damage().iter().map(ToString::to_string).collect();
    out.chosen("ROS 1 bag", topic)
}
