//! The elements of the file: what the recorder's head holds, and the bytes of EBML.

use super::{DEPTH_TRACK, IMU_TRACK, IR_TRACK, K4aSettings, SCALE};

/// A block with its frames: one, or several of the same size (fixed lacing).
pub(super) fn block(track: u8, relative: i16, flags: u8, frames: &[&[u8]]) -> Vec<u8> {
    let mut data = Vec::with_capacity(8 + frames.iter().map(|frame| frame.len()).sum::<usize>());
    data.push(0x80 | track);
    data.extend_from_slice(&relative.to_be_bytes());
    if frames.len() == 1 {
        data.push(flags);
    } else {
        data.push(flags | 2 << 1);
        data.push((frames.len() - 1) as u8);
    }
    for frame in frames {
        data.extend_from_slice(frame);
    }
    data
}

pub(super) fn tracks(settings: &K4aSettings) -> Vec<u8> {
    let mut entries = Vec::new();
    let mut video = |number: u8, name: &str| {
        let mut entry = track_entry(number, 1, name, "V_MS/VFW/FOURCC");
        element(
            &mut entry,
            0x63A2,
            &bitmap_info(settings.width, settings.height),
        );
        unsigned(
            &mut entry,
            0x23_E383,
            1_000_000_000 / u64::from(settings.fps.max(1)),
        );
        let mut pixels = Vec::new();
        unsigned(&mut pixels, 0xB0, settings.width.into());
        unsigned(&mut pixels, 0xBA, settings.height.into());
        element(&mut entry, 0xE0, &pixels);
        element(&mut entries, 0xAE, &entry);
    };
    video(DEPTH_TRACK, "DEPTH");
    if settings.infrared {
        video(IR_TRACK, "IR");
    }
    if settings.imu {
        let entry = track_entry(IMU_TRACK, 0x11, "IMU", "S_K4A/IMU");
        element(&mut entries, 0xAE, &entry);
    }
    let mut out = Vec::new();
    element(&mut out, 0x1654_AE6B, &entries);
    out
}

pub(super) fn track_uid(number: u8) -> u64 {
    0x00A1_B2C3_D4E5_F600 + u64::from(number)
}

pub(super) fn track_entry(number: u8, kind: u64, name: &str, codec: &str) -> Vec<u8> {
    let mut entry = Vec::new();
    unsigned(&mut entry, 0xD7, number.into());
    unsigned(&mut entry, 0x73C5, track_uid(number));
    unsigned(&mut entry, 0x83, kind);
    unsigned(&mut entry, 0x9C, 1);
    element(&mut entry, 0x536E, name.as_bytes());
    element(&mut entry, 0x86, codec.as_bytes());
    entry
}

/// BITMAPINFOHEADER with the format `b16g`.
pub(super) fn bitmap_info(width: u32, height: u32) -> Vec<u8> {
    let mut header = Vec::with_capacity(40);
    header.extend_from_slice(&0_u32.to_le_bytes());
    header.extend_from_slice(&width.to_le_bytes());
    header.extend_from_slice(&height.to_le_bytes());
    header.extend_from_slice(&1_u16.to_le_bytes());
    header.extend_from_slice(&16_u16.to_le_bytes());
    header.extend_from_slice(b"b16g");
    header.extend_from_slice(&(width * height * 2).to_le_bytes());
    header.resize(40, 0);
    header
}

pub(super) fn attachments(settings: &K4aSettings) -> Vec<u8> {
    let mut file = Vec::new();
    element(&mut file, 0x466E, b"calibration.json");
    element(&mut file, 0x4660, b"application/octet-stream");
    unsigned(&mut file, 0x46AE, 0x00C0_FFEE);
    element(&mut file, 0x465C, &settings.calibration);
    let mut attached = Vec::new();
    element(&mut attached, 0x61A7, &file);
    let mut out = Vec::new();
    element(&mut out, 0x1941_A469, &attached);
    out
}

pub(super) fn tags(settings: &K4aSettings, start_ns: Option<u64>) -> Vec<u8> {
    let mut body = Vec::new();
    let mut add = |name: &str, value: &str, track: Option<u8>| {
        let mut targets = Vec::new();
        if track.is_some() {
            element(&mut targets, 0x63CA, b"TRACK");
        }
        unsigned(&mut targets, 0x63C5, track.map_or(0, track_uid));
        let mut simple = Vec::new();
        element(&mut simple, 0x45A3, name.as_bytes());
        element(&mut simple, 0x4487, value.as_bytes());
        let mut tag = Vec::new();
        element(&mut tag, 0x63C0, &targets);
        element(&mut tag, 0x67C8, &simple);
        element(&mut body, 0x7373, &tag);
    };
    let uid = |track| track_uid(track).to_string();
    add("K4A_DEPTH_TRACK", &uid(DEPTH_TRACK), Some(DEPTH_TRACK));
    add("K4A_DEPTH_MODE", &settings.depth_mode, Some(DEPTH_TRACK));
    if settings.infrared {
        add("K4A_IR_TRACK", &uid(IR_TRACK), Some(IR_TRACK));
        add("K4A_IR_MODE", "ACTIVE", Some(IR_TRACK));
    }
    add("K4A_WIRED_SYNC_MODE", "SUBORDINATE", None);
    add("K4A_SUBORDINATE_DELAY_NS", "0", None);
    add("K4A_DEPTH_FIRMWARE_VERSION", "1.6.80", None);
    add("K4A_DEVICE_SERIAL_NUMBER", &settings.serial, None);
    add("K4A_CALIBRATION_FILE", "calibration.json", None);
    if settings.imu {
        add("K4A_IMU_TRACK", &uid(IMU_TRACK), Some(IMU_TRACK));
        add("K4A_IMU_MODE", "ON", Some(IMU_TRACK));
    }
    if let Some(start) = start_ns {
        add("K4A_START_OFFSET_NS", &start.to_string(), None);
    }
    with_crc(0x1254_C367, &body)
}

pub(super) fn info(duration: f64) -> Vec<u8> {
    let mut body = Vec::new();
    unsigned(&mut body, 0x2A_D7B1, SCALE);
    element(&mut body, 0x4489, &duration.to_be_bytes());
    element(&mut body, 0x4D80, b"hil-sim");
    element(&mut body, 0x5741, b"k4arecord-1.4.1");
    let mut out = Vec::new();
    element(&mut out, 0x1549_A966, &body);
    out
}

pub(super) fn push_id(out: &mut Vec<u8>, id: u32) {
    let leading = (id.leading_zeros() / 8) as usize;
    out.extend_from_slice(&id.to_be_bytes()[leading..]);
}

pub(super) fn push_size(out: &mut Vec<u8>, size: u64) {
    // All ones means unknown, so each length holds one less than its bits would.
    let length = (1..8)
        .find(|length| size < (1_u64 << (7 * length)) - 1)
        .unwrap_or(8);
    let coded = size | 1 << (7 * length);
    out.extend_from_slice(&coded.to_be_bytes()[8 - length..]);
}

pub(super) fn element(out: &mut Vec<u8>, id: u32, data: &[u8]) {
    push_id(out, id);
    push_size(out, data.len() as u64);
    out.extend_from_slice(data);
}

pub(super) fn unsigned(out: &mut Vec<u8>, id: u32, value: u64) {
    let leading = (value.leading_zeros() / 8).min(7) as usize;
    element(out, id, &value.to_be_bytes()[leading..]);
}

/// A void element of `room` bytes in all (2 at least).
pub(super) fn void(out: &mut Vec<u8>, room: usize) {
    out.push(0xEC);
    if room >= 9 {
        let size = (room - 9) as u64 | 1 << 56;
        out.extend_from_slice(&size.to_be_bytes());
        out.resize(out.len() + room - 9, 0);
    } else {
        out.push(0x80 | (room - 2) as u8);
        out.resize(out.len() + room - 2, 0);
    }
}

/// A master element that begins with the CRC-32 of the rest of it.
pub(super) fn with_crc(id: u32, body: &[u8]) -> Vec<u8> {
    let mut inner = Vec::with_capacity(body.len() + 6);
    element(&mut inner, 0xBF, &crc32fast::hash(body).to_le_bytes());
    inner.extend_from_slice(body);
    let mut out = Vec::with_capacity(inner.len() + 12);
    element(&mut out, id, &inner);
    out
}
