//! ROS 1 bags as the published system's recorder writes them
//! (<https://wiki.ros.org/Bags/Format/2.0>): small, and of any content.

/// The first line of a bag.
const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

/// A message with its topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// The topic.
    pub topic: String,
    /// Its type.
    pub kind: String,
    /// Its bytes.
    pub data: Vec<u8>,
}

/// How a chunk is packed: its name in the bag, and who packs.
pub type Packing<'a> = (&'a str, &'a dyn Fn(&[u8]) -> Vec<u8>);

/// Chunks as they are.
pub const NOT_PACKED: Packing<'_> = ("none", &<[u8]>::to_vec);

/// A bag of one chunk, so many times over. Each topic is a connection.
#[must_use]
pub fn bag(messages: &[Message], packing: Packing<'_>, times: usize) -> Vec<u8> {
    let mut topics: Vec<&str> = Vec::new();
    let mut chunk = Vec::new();
    for message in messages {
        let known = topics.iter().position(|topic| *topic == message.topic);
        let number = known.unwrap_or(topics.len()) as u32;
        let number = number.to_le_bytes();
        if known.is_none() {
            topics.push(&message.topic);
            let fields = fields(&[("type", message.kind.as_bytes())]);
            let head = [
                ("op", &[7][..]),
                ("conn", &number),
                ("topic", message.topic.as_bytes()),
            ];
            record(&mut chunk, &head, &fields);
        }
        let head = [("op", &[2][..]), ("conn", &number), ("time", &[0; 8])];
        record(&mut chunk, &head, &message.data);
    }
    let mut out = MAGIC.to_vec();
    record(
        &mut out,
        &[("op", &[3]), ("index_pos", &[0; 8])],
        &[b' '; 40],
    );
    let packed = (packing.1)(&chunk);
    let size = (chunk.len() as u32).to_le_bytes();
    let head = [
        ("op", &[5][..]),
        ("compression", packing.0.as_bytes()),
        ("size", &size),
    ];
    for _ in 0..times {
        record(&mut out, &head, &packed);
    }
    out
}

fn fields(all: &[(&str, &[u8])]) -> Vec<u8> {
    let mut out = Vec::new();
    for (name, value) in all {
        let length = (name.len() + 1 + value.len()) as u32;
        out.extend(length.to_le_bytes());
        out.extend(name.as_bytes());
        out.push(b'=');
        out.extend(*value);
    }
    out
}

fn record(out: &mut Vec<u8>, head: &[(&str, &[u8])], data: &[u8]) {
    for part in [&fields(head), data] {
        out.extend((part.len() as u32).to_le_bytes());
        out.extend(part);
    }
}

/// `std_msgs/Header` without a frame: number and time in nanoseconds.
#[must_use]
pub fn header(seq: u32, nanos: u64) -> Vec<u8> {
    let mut out = seq.to_le_bytes().to_vec();
    out.extend(time(nanos));
    out.extend([0; 4]);
    out
}

/// A ROS time.
#[must_use]
pub fn time(nanos: u64) -> Vec<u8> {
    let seconds = (nanos / 1_000_000_000) as u32;
    let rest = (nanos % 1_000_000_000) as u32;
    [seconds.to_le_bytes(), rest.to_le_bytes()].concat()
}

/// `sensor_msgs/TimeReference`.
#[must_use]
pub fn time_reference(topic: &str, seq: u32, nanos: u64, other: u64) -> Message {
    Message {
        topic: topic.to_owned(),
        kind: String::from("sensor_msgs/TimeReference"),
        data: [header(seq, nanos), time(other), vec![0; 4]].concat(),
    }
}

/// `sensor_msgs/Imu`: without orientation and covariances.
#[must_use]
pub fn imu(seq: u32, nanos: u64, gyro: [f64; 3]) -> Message {
    let mut data = header(seq, nanos);
    let vector = |values: [f64; 3]| values.map(f64::to_le_bytes).concat();
    // Orientation: a quaternion and nine covariances.
    data.extend([0; 13 * 8]);
    data.extend(vector(gyro));
    data.extend([0; 9 * 8]);
    data.extend(vector([0.0, 0.0, 9.81]));
    data.extend([0; 9 * 8]);
    Message {
        topic: String::from("/mcu_imu"),
        kind: String::from("sensor_msgs/Imu"),
        data,
    }
}

/// `sensor_msgs/Image` of depth in millimetres.
#[must_use]
pub fn depth_image(seq: u32, nanos: u64, (width, height): (u32, u32)) -> Message {
    let mut data = header(seq, nanos);
    data.extend(height.to_le_bytes());
    data.extend(width.to_le_bytes());
    data.extend(5_u32.to_le_bytes());
    data.extend(b"16UC1");
    data.push(0);
    data.extend((2 * width).to_le_bytes());
    let pixels: Vec<u8> = (0..width * height)
        .flat_map(|_| 900_u16.to_le_bytes())
        .collect();
    data.extend((pixels.len() as u32).to_le_bytes());
    data.extend(pixels);
    Message {
        topic: String::from("/azure/depth/image_raw"),
        kind: String::from("sensor_msgs/Image"),
        data,
    }
}
