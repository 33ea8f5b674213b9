//! The published system's topics of a ROS 1 bag as events.
//!
//! | topic | type | becomes |
//! |---|---|---|
//! | `/mcu_imu`, `/mcu_imu_temp` | Imu, Temperature | [`BoardEvent::Imu`], joined by their stamp |
//! | `/mcu_cameras_ts` | TimeReference | [`BoardEvent::Pulse`] and [`BoardEvent::Times`] |
//! | `/mcu_lidar_ts`, `/mcu_s10_ts`, `/depth_to_mcu_offset` | TimeReference | [`BoardEvent::Times`] |
//! | `/sequences_ts` | TimeReference | [`BoardEvent::Mark`] and [`BoardEvent::Times`] |
//! | `/azure/depth/image_raw` | Image, 16UC1 (mm) or 32FC1 (m) | [`BoardEvent::Image`] |
//!
//! The bag has no trains and no pulse numbers: the pulses are one train, numbered
//! as they were received. Topics below a name space (`/mcu/mcu_imu`) count too.

use std::collections::VecDeque;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{BagImage, BoardError, BoardEvent, BoardStream, Images, ImuRow, TimePair};
use crate::bag::messages::{Image, Imu, Short, Temperature, TimeReference};
use crate::bag::reader::{Bag, BagError, Message};
use crate::depth_clock::PulseTime;
use crate::time::BoardNanos;
use formats::faults::Faults;

/// How many samples wait for their temperature.
const WAITING: usize = 64;
/// How many faults are kept with their text.
const MAX_FAULTS: usize = 20;

pub(super) struct BagStream {
    bag: Bag<BufReader<File>>,
    path: PathBuf,
    sorter: Sorter,
}

struct Sorter {
    images: Images,
    events: VecDeque<BoardEvent>,
    waiting: VecDeque<ImuRow>,
    pulses: u64,
    faults: Faults,
}

enum Failure {
    Bag(BagError),
    Board(BoardError),
}

impl From<BagError> for Failure {
    fn from(error: BagError) -> Self {
        Self::Bag(error)
    }
}

impl BagStream {
    pub(super) fn open(path: &Path, images: Images) -> Result<Self, BoardError> {
        let file = files::open(path).map_err(|error| BoardError::Open {
            path: path.to_owned(),
            error,
        })?;
        let bag = Bag::open(BufReader::with_capacity(1 << 20, file)).map_err(|error| {
            BoardError::Bag {
                path: path.to_owned(),
                error,
            }
        })?;
        Ok(Self {
            bag,
            path: path.to_owned(),
            sorter: Sorter {
                images,
                events: VecDeque::new(),
                waiting: VecDeque::new(),
                pulses: 0,
                faults: Faults::new(MAX_FAULTS),
            },
        })
    }
}

impl BoardStream for BagStream {
    fn next_event(&mut self) -> Result<Option<BoardEvent>, BoardError> {
        loop {
            if let Some(event) = self.sorter.events.pop_front() {
                return Ok(Some(event));
            }
            let sorter = &mut self.sorter;
            let more = self
                .bag
                .next_chunk(|message| sorter.take(&message).map_err(Failure::Board));
            match more {
                Ok(true) => {}
                Ok(false) if self.sorter.waiting.is_empty() => return Ok(None),
                Ok(false) => self.sorter.release(0),
                Err(Failure::Board(error)) => return Err(error),
                Err(Failure::Bag(error)) => {
                    return Err(BoardError::Bag {
                        path: self.path.clone(),
                        error,
                    });
                }
            }
        }
    }

    fn damage(&self) -> Vec<String> {
        let mut all = self.bag.damage().to_vec();
        all.extend(self.sorter.faults.words("messages that cannot be read"));
        all
    }

    fn position(&self) -> u64 {
        self.bag.position()
    }
}

impl Sorter {
    fn take(&mut self, message: &Message<'_>) -> Result<(), BoardError> {
        let topic = &message.connection.topic;
        let name = topic.rsplit('/').next().unwrap_or(topic);
        let result = match name {
            "mcu_imu" => {
                expect(message, Imu::KIND)?;
                Imu::parse(message.data).map(|imu| {
                    self.waiting.push_back(ImuRow {
                        at: BoardNanos(imu.header.stamp),
                        gyro: imu.gyro,
                        accel: imu.accel,
                        temperature: None,
                    });
                    self.release(WAITING);
                })
            }
            "mcu_imu_temp" => {
                expect(message, Temperature::KIND)?;
                Temperature::parse(message.data).map(|value| self.temperature(&value))
            }
            "mcu_cameras_ts"
            | "mcu_lidar_ts"
            | "mcu_s10_ts"
            | "depth_to_mcu_offset"
            | "sequences_ts" => {
                expect(message, TimeReference::KIND)?;
                TimeReference::parse(message.data).map(|times| self.times(topic, name, &times))
            }
            _ if topic.ends_with("depth/image_raw") && self.images != Images::Skip => {
                expect(message, Image::KIND)?;
                Image::parse(message.data).map(|image| {
                    let image = BagImage::of(&image, self.images, &mut self.faults);
                    self.events.push_back(BoardEvent::Image(image));
                })
            }
            _ => Ok(()),
        };
        if let Err(Short(place)) = result {
            self.faults
                .add(format!("topic {topic}: a message ends within {place}"));
        }
        Ok(())
    }

    fn temperature(&mut self, value: &Temperature) {
        let stamp = BoardNanos(value.header.stamp);
        if let Some(row) = self.waiting.iter_mut().find(|row| row.at == stamp) {
            row.temperature = Some(value.temperature);
        }
        while self
            .waiting
            .front()
            .is_some_and(|row| row.temperature.is_some())
            && let Some(row) = self.waiting.pop_front()
        {
            self.events.push_back(BoardEvent::Imu(row));
        }
    }

    /// Lets samples go on without a temperature, down to `keep` that wait.
    fn release(&mut self, keep: usize) {
        while self.waiting.len() > keep {
            if let Some(row) = self.waiting.pop_front() {
                self.events.push_back(BoardEvent::Imu(row));
            }
        }
    }

    fn times(&mut self, topic: &Arc<str>, name: &str, times: &TimeReference) {
        let stamp = BoardNanos(times.header.stamp);
        match name {
            "mcu_cameras_ts" => {
                self.events.push_back(BoardEvent::Pulse(PulseTime {
                    train: 0,
                    number: self.pulses,
                    at: stamp,
                }));
                self.pulses += 1;
            }
            "sequences_ts" => self.events.push_back(BoardEvent::Mark(stamp)),
            _ => {}
        }
        self.events.push_back(BoardEvent::Times(TimePair {
            topic: Arc::clone(topic),
            seq: times.header.seq,
            stamp,
            other: times.time_ref,
        }));
    }
}

fn expect(message: &Message<'_>, expected: &'static str) -> Result<(), BoardError> {
    if message.connection.kind == expected {
        return Ok(());
    }
    Err(BoardError::OtherType {
        topic: message.connection.topic.to_string(),
        found: message.connection.kind.clone(),
        expected,
    })
}

impl BagImage {
    /// The image of a message, with its pixels if they are wanted.
    pub(crate) fn of(image: &Image<'_>, images: Images, faults: &mut Faults) -> Self {
        let stamp = image.header.stamp;
        let pixels = match images {
            Images::Pixels => millimetres(image).unwrap_or_else(|what| {
                // It still counts as a frame: frames are numbered.
                faults.add(format!("a depth image at {stamp} ns {what}"));
                Vec::new()
            }),
            Images::Stamps | Images::Skip => Vec::new(),
        };
        Self {
            stamp,
            width: image.width,
            height: image.height,
            pixels,
        }
    }
}

/// An image's pixels as big-endian millimetres.
fn millimetres(image: &Image<'_>) -> Result<Vec<u8>, &'static str> {
    let bytes = match image.encoding {
        "16UC1" | "mono16" => 2,
        "32FC1" => 4,
        _ => return Err("has an encoding other than 16UC1 (mm) and 32FC1 (m)"),
    };
    let row = (image.width as usize)
        .checked_mul(bytes)
        .ok_or("is too wide")?;
    let step = image.step as usize;
    if row == 0 || step < row || image.data.len() / step.max(1) < image.height as usize {
        return Err("holds less than its size says");
    }
    let mut pixels = Vec::with_capacity(row / bytes * 2 * image.height as usize);
    for line in image.data.chunks_exact(step).take(image.height as usize) {
        for value in line[..row].chunks_exact(bytes) {
            let millimetres = match *value {
                [a, b] if image.big_endian => u16::from_be_bytes([a, b]),
                [a, b] => u16::from_le_bytes([a, b]),
                _ => {
                    let value: [u8; 4] = value.try_into().map_err(|_| "has odd pixels")?;
                    let metres = if image.big_endian {
                        f32::from_be_bytes(value)
                    } else {
                        f32::from_le_bytes(value)
                    };
                    // Saturates; not-a-number, "no depth", becomes 0.
                    (f64::from(metres) * 1000.0).round() as u16
                }
            };
            pixels.extend_from_slice(&millimetres.to_be_bytes());
        }
    }
    Ok(pixels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::messages::Header;

    #[test]
    fn depth_of_both_encodings_is_millimetres() {
        let header = Header { seq: 0, stamp: 0 };
        let floats: Vec<u8> = [1.234_f32, f32::NAN, 0.0, 70.0]
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        let image = Image {
            header,
            height: 2,
            width: 2,
            encoding: "32FC1",
            big_endian: false,
            step: 8,
            data: &floats,
        };
        let values = |bytes: Vec<u8>| -> Vec<u16> {
            bytes
                .chunks_exact(2)
                .map(|pair| u16::from_be_bytes([pair[0], pair[1]]))
                .collect()
        };
        assert_eq!(values(millimetres(&image).unwrap()), [1234, 0, 0, u16::MAX]);
        // Rows with padding.
        let ints = [1_u8, 2, 9, 9, 3, 4, 9, 9];
        let image = Image {
            width: 1,
            encoding: "16UC1",
            step: 4,
            data: &ints,
            ..image
        };
        assert_eq!(values(millimetres(&image).unwrap()), [0x0201, 0x0403]);
        assert!(millimetres(&Image { height: 3, ..image }).is_err());
        assert!(millimetres(&Image { step: 1, ..image }).is_err());
        assert!(
            millimetres(&Image {
                encoding: "rgb8",
                ..image
            })
            .is_err()
        );
    }
}
