//! The samples of one track of an MP4 file, by the format that the track states.
//!
//! Source: ISO/IEC 14496-12 (boxes `moov`, `trak`, `mdhd`, `stsd`, `stts`, `stsc`, `stsz`,
//! `stco`, `co64`); big-endian throughout.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};

/// The longest index: that of a day of video at 60 frames a second has some 50 MB.
const MAX_INDEX: u64 = 64 << 20;
/// Most samples of a track: one a second for ten days.
const MAX_SAMPLES: usize = 1_000_000;
/// Most boxes before the index.
const MAX_BOXES: usize = 10_000;

/// A sample of a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Sample {
    /// Where it stands in the file.
    pub(crate) at: u64,
    /// Its bytes.
    pub(crate) length: u64,
    /// When it begins, nanoseconds from the begin of the track.
    pub(crate) begins: i64,
}

/// The content of the box `moov`; `None` if there is none, or it is longer than any.
pub(crate) fn index(file: &mut File) -> io::Result<Option<Vec<u8>>> {
    let mut at = 0_u64;
    for _ in 0..MAX_BOXES {
        file.seek(SeekFrom::Start(at))?;
        let mut head = Vec::new();
        file.take(16).read_to_end(&mut head)?;
        let Some((kind, _)) = head.get(4..).and_then(<[u8]>::split_first_chunk::<4>) else {
            return Ok(None);
        };
        let (body, length) = match (word(&head, 0), long(&head, 8)) {
            (Some(1), Some(length)) => (16, length),
            // To the end of the file.
            (Some(0), _) => (8, u64::MAX),
            (length, _) => (8, length.unwrap_or(0).into()),
        };
        let Some(rest) = length.checked_sub(body) else {
            return Ok(None);
        };
        if kind == b"moov" {
            if rest > MAX_INDEX {
                return Ok(None);
            }
            file.seek(SeekFrom::Start(at + body))?;
            let mut index = Vec::new();
            file.take(rest).read_to_end(&mut index)?;
            return Ok(Some(index));
        }
        // One that leads out of the file ends the reading there.
        at = at.saturating_add(length).min(i64::MAX as u64);
    }
    Ok(None)
}

/// Kind and content of boxes one behind the other, up to the first that is cut off.
pub(crate) fn boxes(mut rest: &[u8]) -> impl Iterator<Item = (&[u8], &[u8])> {
    std::iter::from_fn(move || {
        let length = word(rest, 0)? as usize;
        let found = (rest.get(4..8)?, rest.get(8..length)?);
        rest = &rest[length..];
        Some(found)
    })
}

/// The first box at a path of kinds.
pub(crate) fn inside<'a>(bytes: &'a [u8], path: &[&[u8; 4]]) -> Option<&'a [u8]> {
    path.iter().try_fold(bytes, |bytes, kind| {
        let mut found = boxes(bytes).filter(|(found, _)| *found == kind.as_slice());
        found.next().map(|(_, body)| body)
    })
}

/// The samples of the first track of a format.
pub(crate) fn samples(index: &[u8], format: &[u8; 4]) -> Option<Vec<Sample>> {
    let tracks = boxes(index).filter(|(kind, _)| kind == b"trak");
    let mut found = tracks.filter_map(|(_, track)| {
        let table = inside(track, &[b"mdia", b"minf", b"stbl"])?;
        let is_it = inside(table, &[b"stsd"])?.get(12..16)? == format;
        is_it.then(|| table_of(inside(track, &[b"mdia", b"mdhd"])?, table))?
    });
    found.next()
}

fn table_of(header: &[u8], table: &[u8]) -> Option<Vec<Sample>> {
    // After version, flags and two times, of 64 bits in version 1.
    let place = if header.first() == Some(&1) { 20 } else { 12 };
    let ticks_a_second = word(header, place).filter(|&ticks| ticks > 0)?;
    let of = |kind: &[u8; 4]| inside(table, &[kind]);
    let (sizes, offsets, wide_offsets) = (of(b"stsz")?, of(b"stco"), of(b"co64"));
    let same = word(sizes, 4)?;
    let count = word(sizes, 8)? as usize;
    let size_of = |number: usize| match same {
        0 => word(sizes, 12 + 4 * number),
        same => Some(same),
    };
    let mut durations = rows::<2>(of(b"stts")?)
        .flat_map(|[count, ticks]| std::iter::repeat_n(ticks, count as usize));
    let mut chunk_rows = rows::<3>(of(b"stsc")?).peekable();
    let (mut in_chunk, mut out) = (0, Vec::new());
    let mut ticks = 0_u64;
    for chunk in 0.. {
        let mut at = match offsets {
            Some(offsets) => word(offsets, 8 + 4 * chunk).map(u64::from),
            None => long(wide_offsets?, 8 + 8 * chunk),
        };
        // Each row is for the chunks from its number, from 1, on.
        while let Some([_, samples, _]) =
            chunk_rows.next_if(|[first, ..]| *first as usize <= chunk + 1)
        {
            in_chunk = samples;
        }
        for _ in 0..in_chunk {
            let (Some(begin), Some(length)) = (at, size_of(out.len())) else {
                return Some(out);
            };
            if out.len() >= count.min(MAX_SAMPLES) {
                return Some(out);
            }
            let nanos = u128::from(ticks) * 1_000_000_000 / u128::from(ticks_a_second);
            out.push(Sample {
                at: begin,
                length: length.into(),
                begins: i64::try_from(nanos).ok()?,
            });
            at = begin.checked_add(length.into());
            ticks += u64::from(durations.next().unwrap_or(0));
        }
        if at.is_none() {
            break;
        }
    }
    Some(out)
}

/// Rows of `N` numbers behind the count of a table.
fn rows<const N: usize>(table: &[u8]) -> impl Iterator<Item = [u32; N]> {
    let rows = table.get(8..).unwrap_or_default().chunks_exact(4 * N);
    rows.map(|row| std::array::from_fn(|k| word(row, 4 * k).unwrap_or(0)))
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    let (word, _) = bytes.get(at..)?.split_first_chunk::<4>()?;
    Some(u32::from_be_bytes(*word))
}

fn long(bytes: &[u8], at: usize) -> Option<u64> {
    let (long, _) = bytes.get(at..)?.split_first_chunk::<8>()?;
    Some(u64::from_be_bytes(*long))
}
