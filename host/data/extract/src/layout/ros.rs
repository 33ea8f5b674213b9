//! ROS 2 bag of images and samples: `ros2/data.mcap` with `metadata.yaml`. All messages
//! are in order of time.
//!
//! | topic | content |
//! |---|---|
//! | `/cam0/image_raw` | the phone's camera, `rgb8` |
//! | `/cam1/image_raw/compressed` | the depth camera's colour images, as the camera's JPEG files |
//! | `/depth0/image_raw` | depth in mm, `16UC1` |
//! | `/ir0/image_raw` | infrared, `mono16` |
//! | `/cam0/camera_info`, … | with each image, if the intrinsics are known |
//! | `/imu0`, `/imu1` | the IMUs of board and phone |
//!
//! The images are files at first ([`parts`]).

use std::fs;
use std::io;
use std::iter::Peekable;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use recording::messages::camera::{CameraInfo, CompressedImage, Image};
use recording::messages::{Header, Imu, RosMessage, Time, to_cdr};
use recording::profile::{DistortionModel, Intrinsics};
use recording::rosbag2::{Bag, METADATA_FILE};

use super::offset::{moved, write_offset};
use super::{DataSetInfo, ImageKind, ImageRow, ImuRow, ImuTable, Layout, SequenceTables, parts};
use crate::output::png_file::{Decoded, read_png};
use crate::output::whole_file::{WholeFile, write_whole};
use crate::time::BoardNanos;

const BAG: &str = "ros2/data.mcap";
const BOARD_IMU: &str = ".parts/imu0.csv";
const PHONE_IMU: &str = ".parts/imu1.csv";
const MCAP_FILE: &str = "data.mcap";
/// Largest number of images that are decoded at a time.
const IMAGES_AT_A_TIME: usize = 4;
/// Largest number of messages that are encoded at a time.
const MESSAGES_AT_A_TIME: usize = 512;

/// The layout of a ROS 2 bag.
pub(super) struct Ros2;

impl Layout for Ros2 {
    fn folder(&self, kind: ImageKind) -> Option<&'static str> {
        Some(match kind {
            ImageKind::Color => ".parts/cam0",
            ImageKind::Depth => ".parts/depth0",
            ImageKind::Infrared => ".parts/ir0",
            ImageKind::Camera => ".parts/cam1",
        })
    }

    fn board_imu(&self) -> ImuTable {
        ImuTable::plain(BOARD_IMU, "")
    }

    fn phone_imu(&self) -> Option<ImuTable> {
        Some(ImuTable::plain(PHONE_IMU, ""))
    }

    fn joined(&self) -> Option<&'static str> {
        Some(BAG)
    }

    fn finish(
        &self,
        folder: &Path,
        tables: &SequenceTables<'_>,
        facts: &DataSetInfo,
    ) -> io::Result<()> {
        super::auxiliary::write(folder, tables)?;
        write_offset(folder)?;
        let path = folder.join(BAG);
        parts::join(folder, &path, tables, || {
            write_bag(&path, folder, tables, facts)
        })
    }
}

/// Writes the bag and its metadata.
fn write_bag(
    path: &Path,
    folder: &Path,
    tables: &SequenceTables<'_>,
    facts: &DataSetInfo,
) -> io::Result<()> {
    let mut file = WholeFile::create(path)?;
    let mut bag = Bag::create(&mut file).map_err(io::Error::other)?;
    fill(&mut bag, folder, tables, facts)?;
    let metadata = bag.finish(MCAP_FILE).map_err(io::Error::other)?;
    file.finish()?;
    write_whole(&path.with_file_name(METADATA_FILE), metadata.as_bytes())
}

/// Camera of the bag.
struct BagCamera<'a> {
    name: &'static str,
    form: Form,
    rows: &'a [ImageRow],
    intrinsics: Option<&'a Intrinsics>,
    /// Number of the topic of its images; the next one has its `CameraInfo`, if that is known.
    topic: usize,
}

/// Form of a camera's images.
#[derive(Clone, Copy)]
enum Form {
    /// PNG files; those of 16 bits have this encoding.
    Png(&'static str),
    /// JPEG files of this width and height.
    Jpeg(Option<(u32, u32)>),
}

/// IMU of the bag.
struct Samples {
    name: &'static str,
    path: PathBuf,
    variances: [f64; 2],
    topic: usize,
}

/// Image or sample to be written as messages.
enum Event<'a> {
    Image(&'a BagCamera<'a>, &'a ImageRow),
    Sample(&'a Samples, ImuRow),
}

impl Event<'_> {
    fn at(&self) -> BoardNanos {
        match self {
            Self::Image(_, row) => row.at,
            Self::Sample(_, row) => row.at,
        }
    }
}

type Events<'a> = Box<dyn Iterator<Item = io::Result<Event<'a>>> + 'a>;

/// Adds all topics and messages to the bag.
fn fill(
    bag: &mut Bag<'_>,
    folder: &Path,
    tables: &SequenceTables<'_>,
    facts: &DataSetInfo,
) -> io::Result<()> {
    let mut topics = 0;
    let cameras = add_cameras(bag, &mut topics, tables, facts)?;
    let imus = add_imus(bag, &mut topics, folder, facts)?;
    let mut streams: Vec<Peekable<Events<'_>>> = Vec::new();
    for camera in &cameras {
        let events = camera
            .rows
            .iter()
            .map(move |row| Ok(Event::Image(camera, row)));
        streams.push((Box::new(events) as Events<'_>).peekable());
    }
    for imu in &imus {
        let rows = csv::ReaderBuilder::new()
            .has_headers(false)
            .from_path(&imu.path)?;
        let events = rows.into_deserialize().map(move |row| {
            let (at, gyro, accel) = row?;
            let sample = ImuRow {
                at: BoardNanos(at),
                gyro,
                accel,
                temperature: None,
            };
            Ok(Event::Sample(imu, sample))
        });
        streams.push((Box::new(events) as Events<'_>).peekable());
    }
    loop {
        let batch = next_batch(&mut streams)?;
        if batch.is_empty() {
            return Ok(());
        }
        let made: Vec<io::Result<_>> = batch
            .par_iter()
            .map(|event| messages(event, folder))
            .collect();
        for (event, messages) in batch.iter().zip(made) {
            let nanos = moved(event.at()).0.max(0).unsigned_abs();
            for (topic, bytes) in messages? {
                bag.put(topic, None, nanos, &bytes)
                    .map_err(io::Error::other)?;
            }
        }
    }
}

/// Adds the topics of each camera that has images. Without intrinsics there is no
/// `CameraInfo`: one of zeros keeps Rerun from showing the images.
fn add_cameras<'a>(
    bag: &mut Bag<'_>,
    topics: &mut usize,
    tables: &'a SequenceTables<'_>,
    facts: &'a DataSetInfo,
) -> io::Result<Vec<BagCamera<'a>>> {
    let (gray, depth) = (Form::Png("mono16"), Form::Png("16UC1"));
    let jpeg = Form::Jpeg(facts.camera_size);
    let known = &facts.cameras;
    let mut cameras = Vec::new();
    for (name, form, rows, intrinsics) in [
        ("cam0", gray, &tables.color, &known.phone.intrinsics),
        ("cam1", jpeg, &tables.camera, &known.color.intrinsics),
        ("depth0", depth, &tables.depth, &known.depth.intrinsics),
        ("ir0", gray, &tables.infrared, &None),
    ] {
        if rows.is_empty() {
            continue;
        }
        cameras.push(BagCamera {
            name,
            form,
            rows,
            intrinsics: intrinsics.as_ref(),
            topic: *topics,
        });
        match form {
            Form::Png(_) => add_topic::<Image>(bag, &format!("/{name}/image_raw"))?,
            Form::Jpeg(_) => {
                add_topic::<CompressedImage>(bag, &format!("/{name}/image_raw/compressed"))?
            }
        }
        *topics += 1;
        if intrinsics.is_some() {
            add_topic::<CameraInfo>(bag, &format!("/{name}/camera_info"))?;
            *topics += 1;
        }
    }
    Ok(cameras)
}

/// Adds a topic to the bag.
fn add_topic<M: RosMessage>(bag: &mut Bag<'_>, name: &str) -> io::Result<()> {
    bag.add_topic::<M>(name).map_err(io::Error::other)
}

fn encode<M: RosMessage>(message: &M) -> io::Result<Vec<u8>> {
    to_cdr(message).map_err(io::Error::other)
}

/// Adds a topic for each IMU that has samples.
fn add_imus(
    bag: &mut Bag<'_>,
    topics: &mut usize,
    folder: &Path,
    facts: &DataSetInfo,
) -> io::Result<Vec<Samples>> {
    let mut imus = Vec::new();
    let both = facts.imus().into_iter().zip([BOARD_IMU, PHONE_IMU]);
    for ((name, rate, noise), path) in both {
        let path = folder.join(path);
        if path.exists() {
            add_topic::<Imu>(bag, &format!("/{name}"))?;
            imus.push(Samples {
                name,
                path,
                variances: noise.variances(rate),
                topic: *topics,
            });
            *topics += 1;
        }
    }
    Ok(imus)
}

/// Returns the next events of all streams in order of time; none at the end.
fn next_batch<'a>(streams: &mut [Peekable<Events<'a>>]) -> io::Result<Vec<Event<'a>>> {
    let (mut batch, mut images) = (Vec::new(), 0);
    while batch.len() < MESSAGES_AT_A_TIME && images < IMAGES_AT_A_TIME {
        let first = streams.iter_mut().filter_map(|stream| {
            // An error is returned at once.
            let at = match stream.peek()? {
                Ok(event) => event.at().0,
                Err(_) => i64::MIN,
            };
            Some((at, stream))
        });
        let Some((_, stream)) = first.min_by_key(|(at, _)| *at) else {
            break;
        };
        let Some(event) = stream.next().transpose()? else {
            break;
        };
        images += usize::from(matches!(event, Event::Image(..)));
        batch.push(event);
    }
    Ok(batch)
}

/// Returns the header of a message.
fn header(at: BoardNanos, name: &str) -> Header {
    Header {
        stamp: Time::from_nanos(moved(at).0.max(0)),
        frame_id: name.to_owned(),
    }
}

/// Returns the messages of an event with the numbers of their topics.
fn messages(event: &Event<'_>, folder: &Path) -> io::Result<Vec<(usize, Vec<u8>)>> {
    let (camera, row) = match event {
        Event::Image(camera, row) => (camera, row),
        Event::Sample(imu, row) => return Ok(vec![(imu.topic, encode(&imu_message(imu, row))?)]),
    };
    let path = folder.join(&row.path);
    let header = header(row.at, camera.name);
    let (bytes, size) = match camera.form {
        Form::Png(gray) => {
            let Decoded {
                size,
                is_rgb,
                pixels,
            } = read_png(&path)?;
            let image = Image {
                header: header.clone(),
                height: size.1,
                width: size.0,
                encoding: String::from(if is_rgb { "rgb8" } else { gray }),
                is_bigendian: 0,
                step: size.0 * if is_rgb { 3 } else { 2 },
                data: pixels,
            };
            (encode(&image)?, size)
        }
        Form::Jpeg(size) => {
            let image = CompressedImage {
                header: header.clone(),
                format: String::from("jpeg"),
                data: fs::read(path)?,
            };
            (encode(&image)?, size.unwrap_or_default())
        }
    };
    let mut messages = vec![(camera.topic, bytes)];
    if let Some(known) = camera.intrinsics {
        let info = camera_info(header, size, known);
        messages.push((camera.topic + 1, encode(&info)?));
    }
    Ok(messages)
}

/// Returns the message of a sample.
fn imu_message(imu: &Samples, row: &ImuRow) -> Imu {
    let covariance =
        |variance| std::array::from_fn(|place| if place % 4 == 0 { variance } else { 0.0 });
    let [rate, force] = imu.variances;
    let mut unknown = [0.0; 9];
    unknown[0] = -1.0;
    Imu {
        header: header(row.at, imu.name),
        orientation: [0.0, 0.0, 0.0, 1.0],
        orientation_covariance: unknown,
        angular_velocity: row.gyro,
        angular_velocity_covariance: covariance(rate),
        linear_acceleration: row.accel,
        linear_acceleration_covariance: covariance(force),
    }
}

/// Returns the message of known intrinsics for images of a size.
fn camera_info(header: Header, (width, height): (u32, u32), known: &Intrinsics) -> CameraInfo {
    let mut info = CameraInfo {
        header,
        height,
        width,
        ..CameraInfo::default()
    };
    let ([fx, fy], [cx, cy]) = (known.focal, known.center);
    info.k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
    info.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    info.p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
    info.d.clone_from(&known.coefficients);
    info.distortion_model = String::from(match known.distortion {
        DistortionModel::None | DistortionModel::Radtan => "plumb_bob",
        DistortionModel::Rational => "rational_polynomial",
        DistortionModel::Equidistant => "equidistant",
    });
    match known.distortion {
        // plumb_bob has five: k1, k2, p1, p2, k3.
        DistortionModel::None | DistortionModel::Radtan => info.d.resize(5, 0.0),
        DistortionModel::Rational | DistortionModel::Equidistant => {}
    }
    info
}
