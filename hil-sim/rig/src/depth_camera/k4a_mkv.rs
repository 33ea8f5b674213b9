//! Writes depth recordings in the format of the Azure Kinect's recorder.
//!
//! The order of things in the file is the recorder's, because a file that was
//! not closed is a part of the test: first the segment with unknown size, a void
//! of 1,024 bytes for the seek head, a void of 256 bytes for the segment
//! information, tracks, the calibration as an attachment, tags without
//! `K4A_START_OFFSET_NS` and a void after them; then clusters of less than 32 ms
//! with a CRC-32; and only at [`K4aMkvWriter::finish`] the information, the start
//! offset, cues, the seek head and the segment's size. Dropping the writer
//! without it leaves what a crash leaves.
//!
//! Captures become simple blocks, IMU samples are laced in block groups (fixed
//! size). Like the recorder, the writer keeps two seconds back, so that data of
//! several tracks is sorted by time.
//!
//! Limits: no colour track; strings of the real camera's calibration are the
//! caller's.

mod elements;

use std::collections::VecDeque;
use std::io::{self, Seek, SeekFrom, Write};

use elements::*;

use crate::depth_camera::{FrameRecord, TIMESTAMP_HZ};
use crate::picture::ball;

/// Nanoseconds in a unit of the file's time.
const SCALE: u64 = 1_000;
/// Length of a cluster, in µs.
const CLUSTER_US: u64 = 32_000;
/// Time for which data is held back, in µs.
const DELAY_US: u64 = 2_000_000;
/// At most this many IMU samples in one block.
const LACED: usize = 8;

const DEPTH_TRACK: u8 = 1;
const IR_TRACK: u8 = 2;
const IMU_TRACK: u8 = 3;

/// Settings in the file's head.
#[derive(Clone, Debug)]
pub struct K4aSettings {
    /// Width of depth and infrared in pixels.
    pub width: u32,
    /// Height of depth and infrared in pixels.
    pub height: u32,
    /// Frames a second: 5, 15 or 30.
    pub fps: u32,
    /// `K4A_DEPTH_MODE`, e.g. `NFOV_UNBINNED`.
    pub depth_mode: String,
    /// `K4A_DEVICE_SERIAL_NUMBER`.
    pub serial: String,
    /// True if there is an infrared track.
    pub infrared: bool,
    /// True if there is an IMU track.
    pub imu: bool,
    /// Content of the attachment `calibration.json`.
    pub calibration: Vec<u8>,
}

impl Default for K4aSettings {
    /// NFOV unbinned at 30 fps with infrared and IMU.
    fn default() -> Self {
        Self {
            width: 640,
            height: 576,
            fps: 30,
            depth_mode: "NFOV_UNBINNED".into(),
            serial: "000000000000".into(),
            infrared: true,
            imu: true,
            calibration: br#"{"CalibrationInformation":{"Cameras":[]}}"#.to_vec(),
        }
    }
}

impl K4aSettings {
    /// Depth images of the [`ball`](crate::picture::ball) alone.
    #[must_use]
    pub fn of_ball(fps: u32) -> Self {
        let (width, height) = ball::DEPTH_SIZE;
        Self {
            width,
            height,
            fps,
            ..Self::small()
        }
    }

    /// Small depth images alone, where what is in them is not looked at.
    #[must_use]
    pub fn small() -> Self {
        Self {
            width: 32,
            height: 18,
            infrared: false,
            imu: false,
            ..Self::default()
        }
    }
}

/// A sample of the camera's IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct K4aImu {
    /// Device time of the acceleration, µs.
    pub accel_us: u64,
    /// m/s².
    pub accel: [f32; 3],
    /// Device time of the angular rate, µs.
    pub gyro_us: u64,
    /// rad/s.
    pub gyro: [f32; 3],
}

/// The recorder's device timestamp, µs rounded down, of ticks of [`TIMESTAMP_HZ`].
#[must_use]
pub fn device_us(ticks: u64) -> u64 {
    let us = u128::from(ticks) * 1_000_000 / u128::from(TIMESTAMP_HZ);
    u64::try_from(us).unwrap_or(u64::MAX)
}

/// Writes what the simulated camera delivered as a recording without infrared. `pixels` fills
/// the depth image of a frame.
///
/// # Errors
///
/// Writing fails.
pub fn write_frames<W: Write + Seek>(
    out: W,
    settings: K4aSettings,
    frames: &[FrameRecord],
    mut pixels: impl FnMut(&FrameRecord, &mut [u16]),
) -> io::Result<W> {
    let mut writer = K4aMkvWriter::new(out, settings)?;
    for frame in frames {
        writer.write_frame(frame, &mut pixels)?;
    }
    writer.finish()
}

struct Entry {
    us: u64,
    track: u8,
    data: Vec<u8>,
}

/// A depth recording being written.
pub struct K4aMkvWriter<W> {
    out: W,
    settings: K4aSettings,
    position: u64,
    segment_size_at: u64,
    segment_data: u64,
    seek_at: u64,
    info_at: u64,
    tracks_at: u64,
    attachments_at: u64,
    tags_at: u64,
    tags_room: usize,
    pending: VecDeque<Entry>,
    latest_us: u64,
    start_us: Option<u64>,
    cues: Vec<(u64, u64)>,
}

const SEEK_ROOM: usize = 1024;
const INFO_ROOM: usize = 256;
const TAGS_SPARE: usize = 1024;

impl<W: Write + Seek> K4aMkvWriter<W> {
    /// Writes the head.
    ///
    /// # Errors
    ///
    /// Writing fails.
    pub fn new(mut out: W, settings: K4aSettings) -> io::Result<Self> {
        let mut head = Vec::new();
        element(&mut head, 0x4282, b"matroska");
        unsigned(&mut head, 0x4287, 2);
        unsigned(&mut head, 0x4285, 2);
        let mut file = Vec::new();
        element(&mut file, 0x1A45_DFA3, &head);
        file.extend_from_slice(&[0x18, 0x53, 0x80, 0x67]);
        let segment_size_at = file.len() as u64;
        file.extend_from_slice(&[0x01, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF]);
        let segment_data = file.len() as u64;
        let seek_at = file.len() as u64;
        void(&mut file, SEEK_ROOM);
        let info_at = file.len() as u64;
        void(&mut file, INFO_ROOM);
        let tracks_at = file.len() as u64;
        file.extend(tracks(&settings));
        let attachments_at = file.len() as u64;
        file.extend(attachments(&settings));
        let tags_at = file.len() as u64;
        let written = tags(&settings, None);
        let tags_room = written.len() + TAGS_SPARE;
        file.extend(written);
        void(&mut file, TAGS_SPARE);
        out.write_all(&file)?;
        Ok(Self {
            out,
            position: file.len() as u64,
            settings,
            segment_size_at,
            segment_data,
            seek_at,
            info_at,
            tracks_at,
            attachments_at,
            tags_at,
            tags_room,
            pending: VecDeque::new(),
            latest_us: 0,
            start_us: None,
            cues: Vec::new(),
        })
    }

    /// Adds a frame of the simulated camera, if it was delivered; `pixels` fills its depth
    /// image. A bad one is black.
    ///
    /// # Errors
    ///
    /// Writing fails, or there is a track for infrared.
    pub fn write_frame(
        &mut self,
        frame: &FrameRecord,
        pixels: impl FnOnce(&FrameRecord, &mut [u16]),
    ) -> io::Result<()> {
        if !frame.delivered {
            return Ok(());
        }
        let mut image = vec![0; self.settings.width as usize * self.settings.height as usize];
        if !frame.bad {
            pixels(frame, &mut image);
        }
        self.write_capture(device_us(frame.device_ticks), &image, None)
    }

    /// Adds a capture at a device time in µs. Pixels row by row; `depth` in mm.
    ///
    /// # Errors
    ///
    /// Writing fails, or the infrared image is missing or not expected.
    pub fn write_capture(
        &mut self,
        us: u64,
        depth: &[u16],
        infrared: Option<&[u16]>,
    ) -> io::Result<()> {
        if infrared.is_some() != self.settings.infrared {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                "an infrared image must be given if, and only if, there is a track for it",
            ));
        }
        self.push(us, DEPTH_TRACK, big_endian(depth))?;
        if let Some(infrared) = infrared {
            self.push(us, IR_TRACK, big_endian(infrared))?;
        }
        Ok(())
    }

    /// Adds a sample of the IMU.
    ///
    /// # Errors
    ///
    /// Writing fails, or there is no track for it.
    pub fn write_imu(&mut self, sample: &K4aImu) -> io::Result<()> {
        if !self.settings.imu {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                "the recording has no IMU track",
            ));
        }
        let mut data = Vec::with_capacity(40);
        data.extend_from_slice(&(sample.accel_us * 1000).to_le_bytes());
        for axis in sample.accel {
            data.extend_from_slice(&axis.to_le_bytes());
        }
        data.extend_from_slice(&(sample.gyro_us * 1000).to_le_bytes());
        for axis in sample.gyro {
            data.extend_from_slice(&axis.to_le_bytes());
        }
        self.push(sample.accel_us, IMU_TRACK, data)
    }

    fn push(&mut self, us: u64, track: u8, data: Vec<u8>) -> io::Result<()> {
        // Nearly sorted already: step back over the few that are later.
        let place = self.pending.iter().rposition(|entry| entry.us <= us);
        let entry = Entry { us, track, data };
        self.pending
            .insert(place.map_or(0, |place| place + 1), entry);
        self.latest_us = self.latest_us.max(us);
        while let Some(first) = self.pending.front() {
            if first.us + CLUSTER_US + DELAY_US >= self.latest_us {
                break;
            }
            self.write_cluster()?;
        }
        Ok(())
    }

    fn write_cluster(&mut self) -> io::Result<()> {
        let Some(first) = self.pending.front() else {
            return Ok(());
        };
        let cluster_us = first.us;
        let start_us = *self.start_us.get_or_insert(cluster_us);
        let mut body = Vec::new();
        unsigned(&mut body, 0xE7, cluster_us.saturating_sub(start_us));
        let mut has_depth = false;
        while let Some(entry) = pop_if(&mut self.pending, |entry| {
            entry.us < cluster_us + CLUSTER_US
        }) {
            let relative = (entry.us - cluster_us) as i16;
            if entry.track != IMU_TRACK {
                has_depth |= entry.track == DEPTH_TRACK;
                let block = block(entry.track, relative, 0x80, &[&entry.data]);
                element(&mut body, 0xA3, &block);
                continue;
            }
            let mut laced = vec![entry];
            while laced.len() < LACED {
                let next = pop_if(&mut self.pending, |entry| {
                    entry.track == IMU_TRACK && entry.us < cluster_us + CLUSTER_US
                });
                let Some(next) = next else { break };
                laced.push(next);
            }
            let frames: Vec<&[u8]> = laced.iter().map(|entry| entry.data.as_slice()).collect();
            let duration = laced[laced.len() - 1].us - laced[0].us + 1;
            let mut group = Vec::new();
            element(&mut group, 0xA1, &block(IMU_TRACK, relative, 0, &frames));
            unsigned(&mut group, 0x9B, duration);
            element(&mut body, 0xA0, &group);
        }
        if has_depth {
            self.cues
                .push((cluster_us - start_us, self.position - self.segment_data));
        }
        let cluster = with_crc(0x1F43_B675, &body);
        self.out.write_all(&cluster)?;
        self.position += cluster.len() as u64;
        Ok(())
    }

    /// Writes what is held back as clusters, as the recorder does at its end.
    ///
    /// # Errors
    ///
    /// Writing fails.
    pub fn flush_clusters(&mut self) -> io::Result<()> {
        while !self.pending.is_empty() {
            self.write_cluster()?;
        }
        Ok(())
    }

    /// Leaves the recording as it is, as a crash of the recorder does: what is held
    /// back is lost.
    pub fn into_inner(self) -> W {
        self.out
    }

    /// Closes the recording and returns what was written to.
    ///
    /// # Errors
    ///
    /// Writing fails.
    pub fn finish(mut self) -> io::Result<W> {
        self.flush_clusters()?;
        let start_us = self.start_us.unwrap_or(0);
        let cues_at = self.position;
        let mut points = Vec::new();
        for (time, cluster) in &self.cues {
            let mut position = Vec::new();
            unsigned(&mut position, 0xF7, DEPTH_TRACK.into());
            unsigned(&mut position, 0xF1, *cluster);
            let mut point = Vec::new();
            unsigned(&mut point, 0xB3, *time);
            element(&mut point, 0xB7, &position);
            element(&mut points, 0xBB, &point);
        }
        let mut cues = Vec::new();
        element(&mut cues, 0x1C53_BB6B, &points);
        self.out.write_all(&cues)?;
        let end = cues_at + cues.len() as u64;

        let duration = (self.latest_us.saturating_sub(start_us)) as f64;
        self.replace(self.info_at, info(duration), INFO_ROOM)?;
        let tags = tags(&self.settings, Some(start_us * 1000));
        self.replace(self.tags_at, tags, self.tags_room)?;
        let mut seeks = Vec::new();
        for (id, at) in [
            (0x1549_A966_u32, self.info_at),
            (0x1654_AE6B, self.tracks_at),
            (0x1941_A469, self.attachments_at),
            (0x1254_C367, self.tags_at),
            (0x1C53_BB6B, cues_at),
        ] {
            let mut seek = Vec::new();
            element(&mut seek, 0x53AB, &id.to_be_bytes());
            unsigned(&mut seek, 0x53AC, at - self.segment_data);
            element(&mut seeks, 0x4DBB, &seek);
        }
        let mut seek_head = Vec::new();
        element(&mut seek_head, 0x114D_9B74, &seeks);
        self.replace(self.seek_at, seek_head, SEEK_ROOM)?;
        let size = (end - self.segment_data) | 1 << 56;
        self.out.seek(SeekFrom::Start(self.segment_size_at))?;
        self.out.write_all(&size.to_be_bytes())?;
        self.out.seek(SeekFrom::Start(end))?;
        self.out.flush()?;
        Ok(self.out)
    }

    /// Writes an element over a void and fills the rest with a void again.
    fn replace(&mut self, at: u64, mut element: Vec<u8>, room: usize) -> io::Result<()> {
        let rest = room.checked_sub(element.len()).filter(|&rest| rest != 1);
        let rest = rest.ok_or_else(|| io::Error::other("the reserved room is too small"))?;
        if rest > 0 {
            void(&mut element, rest);
        }
        self.out.seek(SeekFrom::Start(at))?;
        self.out.write_all(&element)
    }
}

fn pop_if(pending: &mut VecDeque<Entry>, wanted: impl Fn(&Entry) -> bool) -> Option<Entry> {
    if wanted(pending.front()?) {
        pending.pop_front()
    } else {
        None
    }
}

fn big_endian(pixels: &[u16]) -> Vec<u8> {
    pixels
        .iter()
        .flat_map(|pixel| pixel.to_be_bytes())
        .collect()
}
