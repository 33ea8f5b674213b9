//! A video's file with the track of a GoPro camera, by the maker's description of GPMF and
//! ISO/IEC 14496-12. There is no picture in it.

use twist_sync::GyroTrack;

/// Frames a second, exposure and read-out of the camera.
pub(crate) const FRAMES: i64 = 30;
pub(crate) const EXPOSURE_S: f32 = 0.004;
pub(crate) const READOUT_MS: f32 = 20.5;

/// Divisor of the rates.
const SCALE: i16 = 3755;

/// How a payload is stamped.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stamps {
    Microseconds,
    Milliseconds,
    /// By the track's times only.
    None,
}

/// The file, with a payload a second. Frames begin with the payloads.
pub(crate) fn mp4(track: &GyroTrack, stamps: Stamps) -> Vec<u8> {
    let mut file = boxed(b"ftyp", b"mp41\0\0\0\0");
    let mut payloads = Vec::new();
    let seconds = track.t.last().unwrap().ceil() as u32;
    for second in 0..seconds {
        let in_second = |t: &f64| t.floor() as u32 == second;
        let samples = track.t.iter().zip(&track.w).filter(|(t, _)| in_second(t));
        let (times, rates): (Vec<f64>, Vec<&[f64; 3]>) = samples.map(|(t, w)| (*t, w)).unzip();
        let Some(first) = times.first() else { continue };
        let counts = rates.iter().flat_map(|rate| {
            let count = |rate: &f64| (rate * f64::from(SCALE)).round() as i16;
            rate.iter()
                .map(count)
                .flat_map(i16::to_be_bytes)
                .collect::<Vec<_>>()
        });
        let gyro = [
            stamp(track.epoch_s + first, stamps),
            klv(b"SCAL", b's', 2, &SCALE.to_be_bytes()),
            klv(b"GYRO", b's', 6, &counts.collect::<Vec<_>>()),
        ];
        let exposures = EXPOSURE_S.to_be_bytes().repeat(FRAMES as usize);
        let frames = [
            stamp(track.epoch_s + f64::from(second), stamps),
            klv(b"SHUT", b'f', 4, &exposures),
        ];
        let device = [
            klv(b"DVNM", b'c', 1, b"Hero of tests"),
            klv(b"STRM", 0, 1, &gyro.concat()),
            klv(b"STRM", 0, 1, &frames.concat()),
        ];
        payloads.push(klv(b"DEVC", 0, 1, &device.concat()));
    }
    let count = payloads.len() as u32;
    let mut at = file.len() as u32 + 8;
    let (mut sizes, mut places) = (vec![0, 0, count], vec![0, count]);
    for payload in &payloads {
        sizes.push(payload.len() as u32);
        places.push(at);
        at += payload.len() as u32;
    }
    file.extend(boxed(b"mdat", &payloads.concat()));
    let format = [words(&[0, 1]), boxed(b"gpmd", &[0, 0, 0, 0, 0, 0, 0, 1])];
    let table = [
        boxed(b"stsd", &format.concat()),
        boxed(b"stts", &words(&[0, 1, count, 1000])),
        boxed(b"stsc", &words(&[0, 1, 1, 1, 1])),
        boxed(b"stsz", &words(&sizes)),
        boxed(b"stco", &words(&places)),
    ];
    let media = [
        boxed(b"mdhd", &words(&[0, 0, 0, 1000, count * 1000, 0])),
        boxed(b"minf", &boxed(b"stbl", &table.concat())),
    ];
    let settings = klv(b"SROT", b'f', 4, &READOUT_MS.to_be_bytes());
    let index = [
        boxed(b"udta", &boxed(b"GPMF", &klv(b"DEVC", 0, 1, &settings))),
        boxed(b"trak", &boxed(b"mdia", &media.concat())),
    ];
    file.extend(boxed(b"moov", &index.concat()));
    file
}

fn stamp(at_s: f64, stamps: Stamps) -> Vec<u8> {
    match stamps {
        Stamps::Microseconds => klv(b"STMP", b'J', 8, &((at_s * 1e6) as u64).to_be_bytes()),
        Stamps::Milliseconds => klv(b"TICK", b'L', 4, &((at_s * 1e3) as u32).to_be_bytes()),
        Stamps::None => Vec::new(),
    }
}

/// Key, length and values of `size` bytes each, padded to words.
fn klv(key: &[u8; 4], kind: u8, size: u8, data: &[u8]) -> Vec<u8> {
    // Of nested entries the length may need both factors.
    let size = if kind == 0 { 4 } else { size };
    let repeat = (data.len() / usize::from(size)) as u16;
    let mut out = [&key[..], &[kind, size], &repeat.to_be_bytes(), data].concat();
    out.resize(out.len().next_multiple_of(4), 0);
    out
}

fn boxed(kind: &[u8; 4], body: &[u8]) -> Vec<u8> {
    let length = (8 + body.len()) as u32;
    [&length.to_be_bytes(), &kind[..], body].concat()
}

fn words(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_be_bytes()).collect()
}
