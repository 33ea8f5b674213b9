//! Azure Kinect recordings: depth, infrared, colour and IMU in the camera's own time.
//!
//! Device time = block time + the tag `K4A_START_OFFSET_NS`. A recorder that
//! crashed has written neither this tag nor the segment information. The time
//! unit is then assumed to be 1,000 ns (which this recorder always uses), and the
//! offset is recovered from the IMU track, whose records contain absolute device
//! times. Without an IMU track the device times are relative
//! ([`StartOffset::Lost`]), which is enough to match them to pulses by their pattern.
//!
//! Depth and infrared are `b16g`: 16 bits a pixel, big-endian; depth in
//! millimetres, 0 = none. Colour in the format `MJPG`, a JPEG file per frame, is returned
//! unchanged.

use std::io::BufReader;
use std::path::Path;

use system::{Input, ReadMonitor, Sparse};

pub use crate::depth::mkv::MkvError;

use crate::depth::mkv::{Cluster, Frame, Header, Mkv, Track};

/// The recorder's unit of time.
const RECORDER_SCALE: u64 = 1_000;
/// Largest accepted width or height of an image.
const MAX_SIDE: u64 = 8192;
/// Largest number of clusters that are searched for a first IMU record.
const IMU_SEARCH: usize = 200;

/// Instant of the depth camera's own clock, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub struct DeviceNanos(pub i64);

/// Reason why a file cannot be read as a depth recording.
#[derive(Debug, thiserror::Error)]
pub enum K4aError {
    /// The file cannot be opened.
    #[error("opening it: {0}")]
    Open(#[source] std::io::Error),
    /// Reading failed after opening.
    #[error("reading it: {0}")]
    Read(#[source] std::io::Error),
    /// The file is not a readable Matroska file.
    #[error(transparent)]
    Mkv(#[from] MkvError),
    /// There is no depth track.
    #[error(
        "no depth track: expected a track named DEPTH with codec V_MS/VFW/FOURCC and format b16g, \
         found {found}; record with a depth mode other than OFF and PASSIVE_IR"
    )]
    NoDepth {
        /// Names and codecs of the existing tracks.
        found: String,
    },
    /// The depth track differs from what the camera writes.
    #[error("the depth track {what}")]
    BadTrack {
        /// The difference.
        what: String,
    },
}

/// Device time of the zero of the block times, and its origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartOffset {
    /// Nanoseconds from the tag.
    Tag(i64),
    /// Nanoseconds from the device times in the IMU track, as the tag is lost.
    Imu(i64),
    /// Unknown: device times count from the first block.
    Lost,
}

impl StartOffset {
    /// Returns the offset in nanoseconds; 0 if it is unknown.
    #[must_use]
    pub fn nanos(self) -> i64 {
        match self {
            Self::Tag(nanos) | Self::Imu(nanos) => nanos,
            Self::Lost => 0,
        }
    }
}

/// Sample of the camera's own IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraImu {
    /// Device time of the acceleration.
    pub accel_at: DeviceNanos,
    /// Acceleration, m/s².
    pub accel: [f32; 3],
    /// Device time of the angular rate.
    pub gyro_at: DeviceNanos,
    /// Angular rate, rad/s.
    pub gyro: [f32; 3],
}

/// Image with its bytes as they are in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawImage {
    /// Device time of the centre of exposure.
    pub at: DeviceNanos,
    /// Size in bytes.
    pub size: usize,
    /// Big-endian pixels row by row, or a JPEG file; empty if only times were requested.
    pub bytes: Vec<u8>,
}

/// Contents of one cluster.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// Depth images.
    pub depth: Vec<RawImage>,
    /// Infrared images.
    pub ir: Vec<RawImage>,
    /// Colour images; JPEG files if the track's format is `MJPG`.
    pub color: Vec<RawImage>,
    /// IMU samples.
    pub imu: Vec<CameraImu>,
    /// False if the cluster's checksum is wrong, so that at least one of its frames is damaged.
    pub intact: bool,
}

/// Extent of reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// Times and IMU samples, without pixels.
    Times,
    /// Times, IMU samples and pixels.
    Pixels,
}

/// Colour track of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColorTrack {
    /// Format of the images: `MJPG`, `NV12`, `YUY2`, `BGRA`.
    pub format: String,
    /// Width and height in pixels.
    pub size: (u32, u32),
    number: u64,
}

impl ColorTrack {
    /// Returns true if the frames are JPEG files.
    #[must_use]
    pub fn is_jpeg(&self) -> bool {
        self.format == "MJPG"
    }
}

/// Depth recording that is open for reading.
pub struct Recording<R> {
    mkv: Mkv<R>,
    depth: u64,
    ir: Option<u64>,
    imu: Option<u64>,
    color: Option<ColorTrack>,
    size: (u32, u32),
    scale: i64,
    offset: StartOffset,
}

impl Recording<BufReader<Input>> {
    /// Opens a file.
    ///
    /// # Errors
    ///
    /// Fails if the file cannot be read or is not a depth recording.
    pub fn open(path: &Path, monitor: &ReadMonitor) -> Result<Self, K4aError> {
        let file = system::open(path, monitor).map_err(K4aError::Open)?;
        let recording = Self::new(BufReader::with_capacity(256 * 1024, file))?;
        if recording.offset == StartOffset::Lost && recording.imu.is_some() {
            // The tag is lost: search for an IMU record, with a second reader.
            let file = system::open(path, monitor).map_err(K4aError::Open)?;
            let mut search = Self::new(BufReader::new(file))?;
            let found = search.search_offset().map_err(K4aError::Open)?;
            return Ok(Self {
                offset: found.map_or(StartOffset::Lost, StartOffset::Imu),
                ..recording
            });
        }
        Ok(recording)
    }
}

impl<R: Sparse> Recording<R> {
    /// Reads the header from a reader at its beginning. The start offset is taken from the tag
    /// only.
    ///
    /// # Errors
    ///
    /// Fails if the content is not a depth recording.
    pub fn new(reader: R) -> Result<Self, K4aError> {
        let mkv = Mkv::open(reader)?;
        let header = mkv.header();
        let depth = find_track(header, "DEPTH", "K4A_DEPTH_TRACK")
            .filter(|track| is_b16g(track))
            .ok_or_else(|| K4aError::NoDepth {
                found: describe(&header.tracks),
            })?;
        let size = image_size(depth)?;
        let number = depth.number;
        let ir = find_track(header, "IR", "K4A_IR_TRACK")
            .filter(|track| is_b16g(track) && image_size(track).ok() == Some(size))
            .map(|track| track.number);
        let imu = find_track(header, "IMU", "K4A_IMU_TRACK")
            .filter(|track| track.codec == "S_K4A/IMU")
            .map(|track| track.number);
        let color = find_track(header, "COLOR", "K4A_COLOR_TRACK").and_then(|track| {
            Some(ColorTrack {
                format: String::from_utf8_lossy(&fourcc(track)?).trim().to_owned(),
                size: image_size(track).ok()?,
                number: track.number,
            })
        });
        let scale = header.scale.unwrap_or(RECORDER_SCALE);
        let scale = i64::try_from(scale).map_err(|_| K4aError::BadTrack {
            what: format!("has a time unit of {scale} ns, which no recorder writes"),
        })?;
        let offset = header
            .tag("K4A_START_OFFSET_NS")
            .and_then(|value| value.trim().parse().ok())
            .map_or(StartOffset::Lost, StartOffset::Tag);
        Ok(Self {
            depth: number,
            ir,
            imu,
            color,
            size,
            scale,
            offset,
            mkv,
        })
    }

    /// Returns width and height of the depth images in pixels.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// Returns the number of bytes of a whole depth image.
    #[must_use]
    pub fn image_bytes(&self) -> usize {
        self.size.0 as usize * self.size.1 as usize * 2
    }

    /// Returns the device time of the zero of the block times.
    #[must_use]
    pub fn start_offset(&self) -> StartOffset {
        self.offset
    }

    /// Returns true if the recorder closed the file, so that it has its information and size.
    #[must_use]
    pub fn was_closed(&self) -> bool {
        let header = self.mkv.header();
        header.scale.is_some() && header.has_size
    }

    /// Returns the program that wrote the file in another unit of time than the recorder's, and
    /// that unit in nanoseconds, to which the times of the frames are rounded.
    #[must_use]
    pub fn rewritten(&self) -> Option<(&str, u64)> {
        let header = self.mkv.header();
        let scale = header.scale.filter(|&scale| scale > RECORDER_SCALE)?;
        Some((header.written_by.as_deref().unwrap_or_default(), scale))
    }

    /// Returns the colour track, if there is one.
    #[must_use]
    pub fn color(&self) -> Option<&ColorTrack> {
        self.color.as_ref()
    }

    /// Returns the value of a tag (`K4A_DEPTH_MODE`, `K4A_DEVICE_SERIAL_NUMBER`, ...).
    #[must_use]
    pub fn tag(&self, name: &str) -> Option<&str> {
        self.mkv.header().tag(name)
    }

    /// Returns the camera's calibration, the attachment `calibration.json`.
    #[must_use]
    pub fn calibration(&self) -> Option<&[u8]> {
        let attachments = &self.mkv.header().attachments;
        let found = attachments
            .iter()
            .find(|(name, _)| name == "calibration.json")?;
        Some(&found.1)
    }

    /// Returns descriptions of what could not be read so far.
    #[must_use]
    pub fn damage(&self) -> &[String] {
        self.mkv.damage()
    }

    /// Reads the next cluster; `None` at the end.
    ///
    /// # Errors
    ///
    /// Fails if the file cannot be read.
    pub fn next_batch(&mut self, content: Content) -> Result<Option<Batch>, K4aError> {
        let imu = self.imu;
        let wanted = |track| match content {
            Content::Times => Some(track) == imu,
            // All tracks: the checksum covers the whole cluster.
            Content::Pixels => true,
        };
        let cluster = self.mkv.next_cluster(&wanted).map_err(K4aError::Read)?;
        Ok(cluster.map(|cluster| self.sort_out(cluster)))
    }

    /// Sorts the frames of a cluster by track.
    fn sort_out(&self, cluster: Cluster) -> Batch {
        let mut batch = Batch {
            intact: cluster.crc_ok != Some(false),
            ..Batch::default()
        };
        for frame in cluster.frames {
            if Some(frame.track) == self.imu {
                batch.imu.extend(imu_record(&frame.data));
            } else if frame.track == self.depth {
                batch.depth.push(self.image(frame));
            } else if Some(frame.track) == self.ir {
                batch.ir.push(self.image(frame));
            } else if self.color.as_ref().map(|color| color.number) == Some(frame.track) {
                batch.color.push(self.image(frame));
            }
        }
        batch
    }

    fn image(&self, frame: Frame) -> RawImage {
        let nanos = frame.time.saturating_mul(self.scale);
        RawImage {
            at: DeviceNanos(nanos.saturating_add(self.offset.nanos())),
            size: frame.size,
            bytes: frame.data,
        }
    }

    /// Returns device time minus block time, ns, from the first IMU record: a block's time is
    /// that of its first record's acceleration.
    fn search_offset(&mut self) -> std::io::Result<Option<i64>> {
        let imu = self.imu;
        for _ in 0..IMU_SEARCH {
            let Some(cluster) = self.mkv.next_cluster(&|track| Some(track) == imu)? else {
                return Ok(None);
            };
            let first = cluster.frames.iter().find(|frame| Some(frame.track) == imu);
            if let Some(record) =
                first.and_then(|frame| Some((frame.time, imu_record(&frame.data)?)))
            {
                let (time, sample) = record;
                return Ok(sample
                    .accel_at
                    .0
                    .checked_sub(time.saturating_mul(self.scale)));
            }
        }
        Ok(None)
    }
}

/// Finds a track by the tag that names its UID, otherwise by its name.
fn find_track<'a>(header: &'a Header, name: &str, tag: &str) -> Option<&'a Track> {
    let uid = header
        .tag(tag)
        .and_then(|uid| uid.trim().parse::<u64>().ok());
    let tracks = &header.tracks;
    tracks
        .iter()
        .find(|track| Some(track.uid) == uid)
        .or_else(|| tracks.iter().find(|track| track.name == name))
}

/// Returns the format in the BITMAPINFOHEADER, which is the codec's set-up data.
fn fourcc(track: &Track) -> Option<[u8; 4]> {
    track.codec_private.get(16..20)?.try_into().ok()
}

fn is_b16g(track: &Track) -> bool {
    track.codec == "V_MS/VFW/FOURCC" && fourcc(track) == Some(*b"b16g")
}

fn image_size(track: &Track) -> Result<(u32, u32), K4aError> {
    let header = |at: usize| -> Option<u64> {
        let bytes = track.codec_private.get(at..at + 4)?.try_into().ok()?;
        Some(u32::from_le_bytes(bytes).into())
    };
    let size = track.pixels.or_else(|| Some((header(4)?, header(8)?)));
    let valid = |side: u64| (1..=MAX_SIDE).contains(&side);
    match size {
        Some((width, height)) if valid(width) && valid(height) => Ok((width as u32, height as u32)),
        Some((width, height)) => Err(K4aError::BadTrack {
            what: format!("claims images of {width} × {height}; expected sides of 1 to {MAX_SIDE}"),
        }),
        None => Err(K4aError::BadTrack {
            what: "does not say the size of its images".into(),
        }),
    }
}

fn describe(tracks: &[Track]) -> String {
    let names: Vec<String> = tracks
        .iter()
        .take(8)
        .map(|track| {
            let clip = |text: &str| text.chars().take(24).collect::<String>();
            format!("{:?} ({})", clip(&track.name), clip(&track.codec))
        })
        .collect();
    names.join(", ")
}

/// Reads {u64 acceleration time, 3 × f32, u64 angular rate time, 3 × f32}, little-endian.
fn imu_record(data: &[u8]) -> Option<CameraImu> {
    let sensor = |bytes: &[u8]| {
        let (time, axes) = bytes.split_first_chunk::<8>()?;
        let (&[x, y, z], []) = axes.as_chunks::<4>() else {
            return None;
        };
        let at = i64::try_from(u64::from_le_bytes(*time)).ok()?;
        Some((DeviceNanos(at), [x, y, z].map(f32::from_le_bytes)))
    };
    let (accel, gyro) = data.split_at_checked(20)?;
    let (accel_at, accel) = sensor(accel)?;
    let (gyro_at, gyro) = sensor(gyro)?;
    Some(CameraImu {
        accel_at,
        accel,
        gyro_at,
        gyro,
    })
}
