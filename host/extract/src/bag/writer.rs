//! Writes a bag: chunks without compression, each followed by its index, and at the end
//! what is in which chunk.

use std::io::{self, Seek, SeekFrom, Write};

use recording::messages::camera::{CameraInfo, CompressedImage, Image};
use recording::messages::{Header, Imu, RosMessage, SEPARATOR};

use super::reader::{MAGIC, OP_BAG, OP_CHUNK, OP_CHUNK_INFO, OP_CONNECTION, OP_INDEX, OP_MESSAGE};

/// A chunk is closed behind the message that makes it longer than this.
const CHUNK_BYTES: usize = 4 << 20;
/// Length of the record of the bag itself, which is written again at the end.
const BAG_RECORD: usize = 4096;
const VERSION: [u8; 4] = 1_u32.to_le_bytes();

/// A message with its form in ROS 1.
pub(crate) trait Ros1Message: RosMessage {
    /// MD5 of its definition, by which ROS 1 tells types apart.
    const MD5: &'static str;

    /// Appends its bytes.
    fn write_ros1(&self, out: &mut Vec<u8>);
}

/// The ROS 1 name of a type.
fn type_name<M: Ros1Message>() -> String {
    M::TYPE.replace("/msg/", "/")
}

/// The definition of a type in the ROS 1 message language: a header has a number, time is
/// a type of its own, and the matrices of a camera have capital letters.
fn definition<M: Ros1Message>() -> String {
    let schema = M::schema();
    let parts = schema.split(SEPARATOR);
    let parts = parts.filter(|part| !part.starts_with("MSG: builtin_interfaces/Time\n"));
    let joined = parts.collect::<Vec<_>>().join(SEPARATOR);
    let mut text = joined.replace("builtin_interfaces/Time stamp", "uint32 seq\ntime stamp");
    for (two, one) in [
        ("float64[] d\n", "float64[] D\n"),
        ("float64[9] k\n", "float64[9] K\n"),
        ("float64[9] r\n", "float64[9] R\n"),
        ("float64[12] p\n", "float64[12] P\n"),
    ] {
        text = text.replace(two, one);
    }
    text
}

fn push_bytes(out: &mut Vec<u8>, bytes: &[u8]) {
    out.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
    out.extend_from_slice(bytes);
}

fn push_numbers(out: &mut Vec<u8>, numbers: &[f64]) {
    for number in numbers {
        out.extend_from_slice(&number.to_le_bytes());
    }
}

fn push_words(out: &mut Vec<u8>, words: &[u32]) {
    for word in words {
        out.extend_from_slice(&word.to_le_bytes());
    }
}

fn push_header(out: &mut Vec<u8>, header: &Header) {
    // The number of a header is for the publisher to fill in; messages have their order.
    push_words(
        out,
        &[0, header.stamp.sec.unsigned_abs(), header.stamp.nanosec],
    );
    push_bytes(out, header.frame_id.as_bytes());
}

impl Ros1Message for Image {
    const MD5: &'static str = "060021388200f6f0f447d0fcd9c64743";

    fn write_ros1(&self, out: &mut Vec<u8>) {
        push_header(out, &self.header);
        push_words(out, &[self.height, self.width]);
        push_bytes(out, self.encoding.as_bytes());
        out.push(self.is_bigendian);
        push_words(out, &[self.step]);
        push_bytes(out, &self.data);
    }
}

impl Ros1Message for CompressedImage {
    const MD5: &'static str = "8f7a12909da2c9d3332d540a0977563f";

    fn write_ros1(&self, out: &mut Vec<u8>) {
        push_header(out, &self.header);
        push_bytes(out, self.format.as_bytes());
        push_bytes(out, &self.data);
    }
}

impl Ros1Message for CameraInfo {
    const MD5: &'static str = "c9a58c1b0b154e0e6da7578cb991d214";

    fn write_ros1(&self, out: &mut Vec<u8>) {
        push_header(out, &self.header);
        push_words(out, &[self.height, self.width]);
        push_bytes(out, self.distortion_model.as_bytes());
        push_words(out, &[self.d.len() as u32]);
        push_numbers(out, &self.d);
        push_numbers(out, &self.k);
        push_numbers(out, &self.r);
        push_numbers(out, &self.p);
        push_words(out, &[self.binning_x, self.binning_y]);
        let roi = &self.roi;
        push_words(out, &[roi.x_offset, roi.y_offset, roi.height, roi.width]);
        out.push(u8::from(roi.do_rectify));
    }
}

impl Ros1Message for Imu {
    const MD5: &'static str = "6a62c6daae103f4ff57a132d6f95cec2";

    fn write_ros1(&self, out: &mut Vec<u8>) {
        push_header(out, &self.header);
        push_numbers(out, &self.orientation);
        push_numbers(out, &self.orientation_covariance);
        push_numbers(out, &self.angular_velocity);
        push_numbers(out, &self.angular_velocity_covariance);
        push_numbers(out, &self.linear_acceleration);
        push_numbers(out, &self.linear_acceleration_covariance);
    }
}

/// A header's fields: a list of {length, `name=value`}.
pub(super) fn fields(fields: &[(&str, &[u8])]) -> Vec<u8> {
    let mut out = Vec::new();
    for (name, value) in fields {
        out.extend_from_slice(&((name.len() + 1 + value.len()) as u32).to_le_bytes());
        out.extend_from_slice(name.as_bytes());
        out.push(b'=');
        out.extend_from_slice(value);
    }
    out
}

/// A record: header and data, each behind its length.
pub(super) fn record(header: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    push_bytes(&mut out, &fields(header));
    push_bytes(&mut out, data);
    out
}

/// ROS time: seconds and nanoseconds.
fn time(nanos: u64) -> [u8; 8] {
    const SECOND: u64 = 1_000_000_000;
    let seconds = u32::try_from(nanos / SECOND).unwrap_or(u32::MAX);
    let rest = (nanos % SECOND) as u32;
    (u64::from(seconds) | (u64::from(rest) << 32)).to_le_bytes()
}

/// A bag that is being written.
pub(crate) struct BagWriter<W> {
    to: W,
    /// Records of the topics.
    connections: Vec<Vec<u8>>,
    chunk: Vec<u8>,
    /// First and last time in the chunk.
    span: Option<(u64, u64)>,
    /// Time and place of each message in the chunk, by topic.
    index: Vec<Vec<u8>>,
    /// Records of the finished chunks.
    chunks: Vec<u8>,
    chunk_count: u32,
}

impl<W: Write + Seek> BagWriter<W> {
    /// Begins a bag at the front of a file.
    ///
    /// # Errors
    ///
    /// Writing fails.
    pub(crate) fn create(mut to: W) -> io::Result<Self> {
        to.write_all(MAGIC)?;
        to.write_all(&bag_record(0, 0, 0))?;
        Ok(Self {
            to,
            connections: Vec::new(),
            chunk: Vec::new(),
            span: None,
            index: Vec::new(),
            chunks: Vec::new(),
            chunk_count: 0,
        })
    }

    /// Adds a topic of messages `M`. Topics are numbered from 0.
    pub(crate) fn add_topic<M: Ros1Message>(&mut self, name: &str) {
        let number = (self.connections.len() as u32).to_le_bytes();
        let (kind, text) = (type_name::<M>(), definition::<M>());
        let data = fields(&[
            ("topic", name.as_bytes()),
            ("type", kind.as_bytes()),
            ("md5sum", M::MD5.as_bytes()),
            ("message_definition", text.as_bytes()),
        ]);
        let header: &[(&str, &[u8])] = &[
            ("op", &[OP_CONNECTION]),
            ("conn", &number),
            ("topic", name.as_bytes()),
        ];
        let connection = record(header, &data);
        self.chunk.extend_from_slice(&connection);
        self.connections.push(connection);
        self.index.push(Vec::new());
    }

    /// Adds a message at a time in ns. One of a topic that was not added is left out.
    ///
    /// # Errors
    ///
    /// Writing fails.
    pub(crate) fn put(&mut self, topic: usize, nanos: u64, message: &[u8]) -> io::Result<()> {
        let Some(index) = self.index.get_mut(topic) else {
            return Ok(());
        };
        index.extend_from_slice(&time(nanos));
        index.extend_from_slice(&(self.chunk.len() as u32).to_le_bytes());
        let header: &[(&str, &[u8])] = &[
            ("op", &[OP_MESSAGE]),
            ("conn", &(topic as u32).to_le_bytes()),
            ("time", &time(nanos)),
        ];
        push_bytes(&mut self.chunk, &fields(header));
        push_bytes(&mut self.chunk, message);
        let (first, last) = self.span.unwrap_or((nanos, nanos));
        self.span = Some((first.min(nanos), last.max(nanos)));
        if self.chunk.len() > CHUNK_BYTES {
            self.close_chunk()?;
        }
        Ok(())
    }

    fn close_chunk(&mut self) -> io::Result<()> {
        let Some((first, last)) = self.span.take() else {
            return Ok(());
        };
        let at = self.to.stream_position()?;
        let chunk = std::mem::take(&mut self.chunk);
        let header = fields(&[
            ("op", &[OP_CHUNK]),
            ("compression", b"none"),
            ("size", &(chunk.len() as u32).to_le_bytes()),
        ]);
        let mut head = Vec::new();
        push_bytes(&mut head, &header);
        push_words(&mut head, &[chunk.len() as u32]);
        self.to.write_all(&head)?;
        self.to.write_all(&chunk)?;
        self.chunk = chunk;
        self.chunk.clear();
        let mut counts = Vec::new();
        for number in 0..self.index.len() {
            let entries = std::mem::take(&mut self.index[number]);
            if entries.is_empty() {
                continue;
            }
            let (number, count) = (number as u32, (entries.len() / 12) as u32);
            push_words(&mut counts, &[number, count]);
            let header: &[(&str, &[u8])] = &[
                ("op", &[OP_INDEX]),
                ("ver", &VERSION),
                ("conn", &number.to_le_bytes()),
                ("count", &count.to_le_bytes()),
            ];
            self.to.write_all(&record(header, &entries))?;
        }
        let header: &[(&str, &[u8])] = &[
            ("op", &[OP_CHUNK_INFO]),
            ("ver", &VERSION),
            ("chunk_pos", &at.to_le_bytes()),
            ("start_time", &time(first)),
            ("end_time", &time(last)),
            ("count", &((counts.len() / 8) as u32).to_le_bytes()),
        ];
        self.chunks.extend(record(header, &counts));
        self.chunk_count += 1;
        Ok(())
    }

    /// Finishes it.
    ///
    /// # Errors
    ///
    /// Writing fails.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        self.close_chunk()?;
        let index = self.to.stream_position()?;
        for connection in &self.connections {
            self.to.write_all(connection)?;
        }
        self.to.write_all(&self.chunks)?;
        self.to.seek(SeekFrom::Start(MAGIC.len() as u64))?;
        let count = self.index.len() as u32;
        self.to
            .write_all(&bag_record(index, count, self.chunk_count))
    }
}

/// The record of the bag itself, filled up with blanks.
fn bag_record(index: u64, connections: u32, chunks: u32) -> Vec<u8> {
    let header: &[(&str, &[u8])] = &[
        ("op", &[OP_BAG]),
        ("index_pos", &index.to_le_bytes()),
        ("conn_count", &connections.to_le_bytes()),
        ("chunk_count", &chunks.to_le_bytes()),
    ];
    let blanks = BAG_RECORD - 8 - fields(header).len();
    record(header, &vec![b' '; blanks])
}

#[cfg(test)]
mod tests {
    use super::super::messages;
    use super::super::reader::{Bag, BagError};
    use super::*;
    use recording::messages::Time;

    #[test]
    fn the_reader_finds_what_was_written() {
        let imu = |number: u32| Imu {
            header: Header {
                stamp: Time::from_nanos(1_000_000_000_007 + i64::from(number) * 2_000_000),
                frame_id: String::from("imu0"),
            },
            orientation: [0.0, 0.0, 0.0, 1.0],
            orientation_covariance: [0.0; 9],
            angular_velocity: [f64::from(number), 2.0, 3.0],
            angular_velocity_covariance: [0.5; 9],
            linear_acceleration: [4.0, 5.0, 6.0],
            linear_acceleration_covariance: [0.25; 9],
        };
        let mut file = io::Cursor::new(Vec::new());
        let mut bag = BagWriter::create(&mut file).unwrap();
        bag.add_topic::<Imu>("/imu0");
        // More than a chunk.
        let count = 20_000;
        for number in 0..count {
            let (message, mut bytes) = (imu(number), Vec::new());
            message.write_ros1(&mut bytes);
            bag.put(0, message.header.stamp.nanos().unsigned_abs(), &bytes)
                .unwrap();
        }
        bag.finish().unwrap();
        let bytes = file.into_inner();
        let mut bag = Bag::open(bytes.as_slice()).unwrap();
        let (mut number, mut chunks) = (0, 0);
        while bag
            .next_chunk(|message| {
                let expected = imu(number);
                assert_eq!(&*message.connection.topic, "/imu0");
                assert_eq!(message.connection.kind, "sensor_msgs/Imu");
                assert_eq!(message.received, expected.header.stamp.nanos());
                let found = messages::Imu::parse(message.data).unwrap();
                assert_eq!(found.gyro, expected.angular_velocity);
                number += 1;
                Ok::<(), BagError>(())
            })
            .unwrap()
        {
            chunks += 1;
        }
        assert_eq!(number, count);
        assert!(chunks > 1 && bag.damage().is_empty(), "{chunks}");
        // The header names the index, which begins with the connection.
        let name = b"index_pos=";
        let place = bytes.windows(name.len()).position(|bytes| bytes == name);
        let (index, _) = bytes[place.unwrap() + name.len()..]
            .split_first_chunk::<8>()
            .unwrap();
        let index = &bytes[u64::from_le_bytes(*index) as usize..];
        let op = fields(&[("op", &[OP_CONNECTION])]);
        assert_eq!(&index[4..4 + op.len()], op);
    }
}
