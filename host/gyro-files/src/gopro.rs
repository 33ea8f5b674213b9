//! The gyroscope in the videos of GoPro cameras, from the HERO5 on.
//!
//! A track of the MP4 holds a payload a second of nested keys, lengths and values (GPMF).
//! Source: the maker's description and samples, <https://github.com/gopro/gpmf-parser>.
//!
//! Times are the camera's own: microseconds of a payload's first sample (`STMP`, newer
//! cameras), else milliseconds (`TICK`), else the track's. Samples lie evenly between
//! microseconds. Coarser stamps scatter by more than a crystal does in an hour, so only
//! the first and the last count.
//!
//! A frame's time is the start of the frame, by the maker's word (discussion 189 there). The
//! read-out counts where it is a setting of the file (HERO8 on): as a stream, on the
//! HERO7, it is often wrong (discussion 48).
//!
//! Limits: one gyroscope; axes in the order of the file, which is a rotation of the
//! camera's for all cameras that the maker lists.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::Path;

use crate::{Frame, GyroFileError, GyroRecording, mp4, telemetry};

/// Names of keys.
const DEVICE: &[u8] = b"DEVC";
const STREAM: &[u8] = b"STRM";

/// A key with its values.
struct Entry<'a> {
    key: &'a [u8],
    /// Letter of the values' type; 0 of nested entries.
    kind: u8,
    data: &'a [u8],
}

/// Entries one behind the other, up to the first that is cut off.
fn entries(mut rest: &[u8]) -> impl Iterator<Item = Entry<'_>> {
    std::iter::from_fn(move || {
        let (&[a, b, c, d, kind, size, high, low], _) = rest.split_first_chunk::<8>()?;
        let length = usize::from(size) * usize::from(u16::from_be_bytes([high, low]));
        let entry = Entry {
            key: rest.get(..4).filter(|_| [a, b, c, d] != [0; 4])?,
            kind,
            data: rest.get(8..8 + length)?,
        };
        // Padded to words of 32 bits; the last one perhaps not.
        rest = rest
            .get(8 + length.next_multiple_of(4)..)
            .unwrap_or_default();
        Some(entry)
    })
}

impl Entry<'_> {
    /// Its numbers; none of other types.
    fn numbers(&self) -> Vec<f64> {
        fn all<const N: usize>(data: &[u8], number: fn([u8; N]) -> f64) -> Vec<f64> {
            let (values, _) = data.as_chunks::<N>();
            values.iter().map(|&bytes| number(bytes)).collect()
        }
        match self.kind {
            b's' => all(self.data, |b| i16::from_be_bytes(b).into()),
            b'S' => all(self.data, |b| u16::from_be_bytes(b).into()),
            b'l' => all(self.data, |b| i32::from_be_bytes(b).into()),
            b'L' => all(self.data, |b| u32::from_be_bytes(b).into()),
            b'f' => all(self.data, |b| f32::from_be_bytes(b).into()),
            b'J' => all(self.data, |b| u64::from_be_bytes(b) as f64),
            _ => Vec::new(),
        }
    }

    fn number(&self) -> Option<f64> {
        self.numbers().first().copied()
    }
}

/// Where a payload's time comes from, the best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Source {
    Microseconds,
    Milliseconds,
    Track,
}

/// Values of a stream, with the time of the first of each payload.
#[derive(Default)]
struct Series<T> {
    values: Vec<T>,
    stamps: Vec<(usize, i64)>,
    source: Option<Source>,
}

impl<T> Series<T> {
    fn add(&mut self, values: impl Iterator<Item = T>, (source, at): (Source, i64)) {
        let first = self.values.len();
        self.values.extend(values);
        // The first payload's source counts; one of another is between its neighbours.
        if self.values.len() > first && *self.source.get_or_insert(source) == source {
            self.stamps.push((first, at));
        }
    }

    /// The time of each value, if there are two payloads at least.
    fn times(&self) -> Option<Vec<i64>> {
        let stamps = match (self.source?, self.stamps.as_slice()) {
            (Source::Microseconds, all) => all.to_vec(),
            (_, [first, .., last]) => vec![*first, *last],
            _ => return None,
        };
        let mut pairs = stamps.windows(2).map(|pair| (pair[0], pair[1])).peekable();
        let (mut from, mut to) = pairs.next()?;
        let between = |value: usize| {
            while let Some((_, next)) = pairs.peek().filter(|(first, _)| first.0 <= value) {
                (from, to) = (to, *next);
                pairs.next();
            }
            let length = i128::from(to.1) - i128::from(from.1);
            let steps = to.0 - from.0;
            let part = length * (value as i128 - from.0 as i128);
            i64::try_from(i128::from(from.1) + part / steps.max(1) as i128).unwrap_or(i64::MAX)
        };
        Some((0..self.values.len()).map(between).collect())
    }
}

pub(crate) fn read(path: &Path) -> Result<GyroRecording, GyroFileError> {
    let none = |found: &str| GyroFileError::None {
        form: "a video",
        found: found.to_owned(),
    };
    let mut file = files::open(path)?;
    let length = file.metadata()?.len();
    let index = mp4::index(&mut file)?
        .ok_or_else(|| none("it has no index of tracks (its recorder did not come to its end)"))?;
    let Some(samples) = mp4::samples(&index, b"gpmd") else {
        return Err(GyroFileError::OtherMaker {
            path: path.to_owned(),
            what: telemetry::kind(&mut file, &index)?,
        });
    };
    let mut out = Streams::default();
    let mut bytes = 0;
    for sample in samples {
        // One behind the other they cannot be longer than the file.
        bytes += sample.length;
        if bytes > length || !out.read(&mut file, sample)? {
            let at = sample.at;
            out.damage
                .push(format!("the data of its track end at byte {at}"));
            break;
        }
    }
    let Streams {
        name,
        gyro,
        exposures,
        damage,
    } = out;
    let times = gyro.times().ok_or_else(|| {
        let damage = damage.first().map_or("", String::as_str);
        none(&format!(
            "less than two seconds of them in the track of its camera {damage}"
        ))
    })?;
    let stamps = match gyro.source {
        Some(Source::Microseconds) => "in stamps of microseconds",
        Some(Source::Milliseconds) => "in stamps of milliseconds",
        _ => "in the track's times",
    };
    let readout_ns = mp4::inside(&index, &[b"udta", b"GPMF"]).and_then(readout);
    let frames = match (readout_ns, exposures.times()) {
        (Some(readout_ns), Some(times)) => times
            .into_iter()
            .zip(exposures.values)
            .map(|(start_ns, exposure_ns)| Frame {
                start_ns,
                exposure_ns,
                readout_ns,
            })
            .collect(),
        _ => Vec::new(),
    };
    Ok(GyroRecording {
        form: format!("GoPro ({name}), {stamps}"),
        times,
        rates: gyro.values,
        frames,
        stamp_step_ns: (gyro.source == Some(Source::Milliseconds)).then_some(1_000_000),
        damage,
    })
}

/// What is taken of the payloads.
#[derive(Default)]
struct Streams {
    /// The camera, as it calls itself.
    name: String,
    gyro: Series<[f64; 3]>,
    /// Exposure of each frame, nanoseconds.
    exposures: Series<i64>,
    damage: Vec<String>,
}

impl Streams {
    /// Reads a payload; false if it is not there in full.
    fn read(&mut self, file: &mut File, sample: mp4::Sample) -> std::io::Result<bool> {
        let mut payload = Vec::new();
        file.seek(SeekFrom::Start(sample.at.min(i64::MAX as u64)))?;
        file.take(sample.length).read_to_end(&mut payload)?;
        for device in entries(&payload).filter(|entry| entry.key == DEVICE) {
            let mut name = String::new();
            for entry in entries(device.data) {
                match entry.key {
                    b"DVNM" => {
                        let text = String::from_utf8_lossy(entry.data);
                        name = text.trim_end_matches('\0').chars().take(40).collect();
                    }
                    STREAM if self.stream(entry.data, sample.begins) => {
                        self.name.clone_from(&name);
                    }
                    _ => {}
                }
            }
        }
        Ok(payload.len() as u64 == sample.length)
    }

    /// Takes a stream; whether it is the gyroscope's.
    fn stream(&mut self, data: &[u8], begins: i64) -> bool {
        let mut scales = Vec::new();
        let mut at = (Source::Track, begins);
        let nanos = |number: Option<f64>, unit: f64| number.map_or(begins, |n| (n * unit) as i64);
        for entry in entries(data) {
            match entry.key {
                b"STMP" => at = (Source::Microseconds, nanos(entry.number(), 1e3)),
                b"TICK" if at.0 == Source::Track => {
                    at = (Source::Milliseconds, nanos(entry.number(), 1e6));
                }
                b"SCAL" => scales = entry.numbers(),
                b"GYRO" => {
                    let numbers = entry.numbers();
                    let (rates, _) = numbers.as_chunks::<3>();
                    let scale = |axis: usize| match scales.as_slice() {
                        &[x, y, z] => [x, y, z][axis],
                        all => all.first().copied().unwrap_or(1.0),
                    };
                    let rates = rates
                        .iter()
                        .map(|rate| std::array::from_fn(|axis| rate[axis] / scale(axis)));
                    self.gyro.add(rates, at);
                    return true;
                }
                b"SHUT" => {
                    let exposures = entry.numbers();
                    self.exposures
                        .add(exposures.iter().map(|s| (s * 1e9) as i64), at);
                }
                _ => {}
            }
        }
        false
    }
}

/// `SROT` of the settings, milliseconds, as nanoseconds.
fn readout(settings: &[u8]) -> Option<i64> {
    let devices = entries(settings).filter(|entry| entry.key == DEVICE);
    let mut found = devices.flat_map(|device| entries(device.data).filter(|e| e.key == b"SROT"));
    found.next()?.number().map(|ms| (ms * 1e6) as i64)
}
