//! IMU messages of recordings and ROS 2 bags.

use std::collections::BTreeMap;
use std::path::Path;

use formats::faults::Faults;
use recording::RecordingError;
use recording::messages::{Imu, RosMessage, from_cdr};
use recording::walk::{Event, Walk};

use crate::{GyroFileError, GyroRecording};

/// How many faults are kept with their text.
const MAX_FAULTS: usize = 50;

/// Samples of each topic with a gyroscope.
struct Topics {
    samples: BTreeMap<String, (Vec<i64>, Vec<[f64; 3]>)>,
    /// Topics of other types; those with a gyroscope may be among them.
    others: Vec<String>,
    broken: u64,
    damage: Faults,
}

impl Topics {
    fn new() -> Self {
        Self {
            samples: BTreeMap::new(),
            others: Vec::new(),
            broken: 0,
            damage: Faults::new(MAX_FAULTS),
        }
    }

    fn add(&mut self, topic: &str, at: i64, rate: [f64; 3]) {
        let (times, rates) = self.samples.entry(topic.to_owned()).or_default();
        times.push(at);
        rates.push(rate);
    }

    fn chosen(
        mut self,
        form: &'static str,
        topic: Option<&str>,
    ) -> Result<GyroRecording, GyroFileError> {
        if self.broken > 0 {
            let broken = format!("{} messages cannot be decoded", self.broken);
            self.damage.add(broken);
        }
        let damage = self.damage.words("faults of the bag");
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
            let mut found = match (topic, there.is_empty()) {
                (_, true) => String::from("it has no topics"),
                (Some(topic), _) => {
                    format!("no IMU on topic {topic}; there are {}", there.join(", "))
                }
                (None, _) => format!("its topics are {}", there.join(", ")),
            };
            // They may have been in what is damaged.
            if let Some(damage) = damage.first() {
                found = format!("{found}; damaged: {damage}");
            }
            return Err(GyroFileError::None { form, found });
        };
        Ok(GyroRecording {
            form: format!("{form}: {name}, times of the messages' headers"),
            times,
            rates,
            damage,
            ..GyroRecording::default()
        })
    }
}

/// A bag of ROS 2, or a recording of ours.
pub(crate) fn bag(path: &Path, topic: Option<&str>) -> Result<GyroRecording, GyroFileError> {
    let mut walk = Walk::open(path)?;
    let mut out = Topics::new();
    while walk.next_part::<RecordingError>(&mut |event| {
        match event {
            Event::Message(message) if message.channel.kind == Imu::TYPE => {
                match from_cdr::<Imu>(message.data) {
                    Ok(imu) => out.add(
                        &message.channel.described.topic,
                        imu.header.stamp.nanos(),
                        imu.angular_velocity,
                    ),
                    Err(_) => out.broken += 1,
                }
            }
            Event::Damage(damage) if damage.is_loss() => out.damage.add(damage.to_string()),
            _ => {}
        }
        Ok(())
    })? {}
    let topics = walk.topics().map(|channel| channel.described.topic.clone());
    out.others = topics.collect();
    out.chosen("ROS 2 bag", topic)
}
