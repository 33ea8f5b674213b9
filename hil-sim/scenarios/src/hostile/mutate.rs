//! Mutations that keep the structure of a file: one value becomes an absurd one.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;

use anyhow::{Context as _, Result};
use extract::bag::reader::{Bag, BagError};
use recording::chunks::{Chunks, OWN_RATIO};
use rig::random::Random;
use rusqlite::Connection;
use rusqlite::types::Value as Sql;
use serde_json::Value;

mod samples;

use super::Command;
use super::bag::{self, Message};
use super::material::Files;

/// Opcodes of records in an MCAP file that are mutated.
const CHANNEL: u8 = 4;
const MESSAGE: u8 = 5;
const CHUNK: u8 = 6;
/// Bytes of a message before its data: channel, sequence, two times.
const MESSAGE_HEAD: usize = 22;

/// What is drawn for one run.
pub(super) struct Draw<'a> {
    random: Random,
    root: &'a Path,
}

/// Whole numbers at the ends of ranges.
const WHOLE: [u64; 14] = [
    0,
    1,
    255,
    65_535,
    0x7FFF_FFFF,
    0x8000_0000,
    0xFFFF_FFFF,
    1 << 32,
    1 << 53,
    i64::MAX as u64 - 1,
    i64::MAX as u64,
    1 << 63,
    u64::MAX - 1,
    u64::MAX,
];

/// Numbers of other kinds.
const REAL: [f64; 14] = [
    0.0,
    -0.0,
    -1.0,
    1e-320,
    1e-9,
    1e9,
    1e15,
    1e18,
    -1e18,
    1e30,
    1e308,
    -1e308,
    f64::NAN,
    f64::INFINITY,
];

impl<'a> Draw<'a> {
    pub(super) const fn new(random: Random, root: &'a Path) -> Self {
        Self { random, root }
    }

    /// A number below `end`; 0 if that is 0.
    pub(super) fn below(&mut self, end: usize) -> usize {
        self.random.below(end)
    }

    pub(super) fn one_of<'b, T>(&mut self, all: &'b [T]) -> &'b T {
        self.random.one_of(all)
    }

    /// A name that leads to the bait, or does something to a terminal, or is long.
    fn name(&mut self) -> String {
        let bait = self.root.join("bait");
        let bait = bait.display();
        match self.below(9) {
            0 => format!("{bait}/new"),
            1 => format!("{bait}/precious"),
            2 => String::from("../../bait/precious"),
            3 => String::from("../../../bait/new"),
            4 => String::from("../bait"),
            5 => String::new(),
            6 => String::from("\u{1b}[2J\u{0}\n\u{202e}"),
            7 => "x".repeat(100_000),
            _ => String::from(".."),
        }
    }

    /// A number as text.
    fn number(&mut self) -> String {
        match self.below(4) {
            0 => self.one_of(&WHOLE).to_string(),
            1 => format!("-{}", self.one_of(&WHOLE)),
            2 => format!("{:e}", self.one_of(&REAL)),
            _ => self.one_of(&REAL).to_string(),
        }
    }
}

/// Mutates one of the files that a command reads; says what it did.
pub(super) fn mutate(draw: &mut Draw<'_>, command: Command, files: &Files) -> Result<String> {
    match command {
        Command::Extract => match draw.below(8) {
            0 | 1 => session(draw, &files.session),
            2..=4 => mcap(draw, &files.mcap),
            5 => csv_of_phone(draw, files),
            6 => bytes(draw, &files.depth, true),
            _ => video_file(draw, &files.video),
        },
        Command::Verify | Command::Repair | Command::Report => match draw.below(6) {
            0 | 1 => session(draw, &files.session),
            5 => link(draw, files),
            _ => mcap(draw, &files.mcap),
        },
        Command::Bag => match draw.below(4) {
            0 => csv_of_phone(draw, files),
            _ => bag_file(draw, &files.bag),
        },
        Command::Offset => {
            let both = [&files.board_csv, &files.phone_csv];
            let file = *draw.one_of(&both);
            // One in four is no more than the reader's to refuse.
            match draw.below(4) {
                0 => csv(draw, file),
                _ => samples::mutate(draw, file),
            }
        }
        Command::Sync => match draw.below(4) {
            0 => bytes(draw, &files.sqlite_bag, false),
            _ => sqlite(draw, &files.sqlite_bag),
        },
        Command::Evaluate => match draw.below(3) {
            0 => session(draw, &files.session),
            1 => csv(draw, &files.timestamps),
            _ => video_file(draw, &files.video),
        },
        Command::Learn => match draw.below(3) {
            0 => session(draw, &files.session),
            1 => csv(draw, &files.timestamps),
            _ => profile(draw, &files.profile),
        },
        Command::Check => profile(draw, &files.profile),
    }
}

/// One value of `session.json`.
fn session(draw: &mut Draw<'_>, file: &Path) -> Result<String> {
    let text = fs::read_to_string(file)?;
    let Ok(mut root) = serde_json::from_str::<Value>(&text) else {
        return Ok(String::from("the session file is damaged already"));
    };
    // A further phone is where names become folders.
    if draw.below(4) == 0 {
        let mut phone = root["profile"]["phone"].clone();
        phone["name"] = draw.name().into();
        let what = format!("a further phone called {:.40}", phone["name"]);
        root["profile"]["phones"] = vec![phone].into();
        fs::write(file, root.to_string())?;
        return Ok(what);
    }
    let mut leaves = Vec::new();
    collect(&root, &mut String::new(), &mut leaves);
    let place = draw.one_of(&leaves).clone();
    let value = match draw.below(6) {
        0 => Value::Null,
        1 => Value::from(draw.name()),
        2 => vec![Value::from(draw.name()); 3].into(),
        3 => Value::from(-1),
        _ => serde_json::from_str(&draw.number()).unwrap_or(Value::Bool(true)),
    };
    let what = format!("session {place} = {:.60}", value.to_string());
    if let Some(slot) = root.pointer_mut(&place) {
        *slot = value;
    }
    fs::write(file, root.to_string())?;
    Ok(what)
}

/// Writes bytes over those from a place on, as far as there are any.
fn overwrite(bytes: &mut [u8], from: usize, value: impl IntoIterator<Item = u8>) {
    for (slot, byte) in bytes.iter_mut().skip(from).zip(value) {
        *slot = byte;
    }
}

fn collect(value: &Value, place: &mut String, leaves: &mut Vec<String>) {
    let below: Vec<(String, &Value)> = match value {
        Value::Object(map) => map.iter().map(|(k, v)| (k.clone(), v)).collect(),
        Value::Array(list) => (0..)
            .zip(list)
            .map(|(k, v): (u32, _)| (k.to_string(), v))
            .collect(),
        _ => Vec::new(),
    };
    if below.is_empty() {
        leaves.push(place.clone());
    }
    for (name, value) in below {
        let length = place.len();
        place.push('/');
        place.push_str(&name);
        collect(value, place, leaves);
        place.truncate(length);
    }
}

/// A record as opcode and body.
type Record = (u8, Vec<u8>);

/// Values of messages, written into a chunk whose lengths and checksum fit again.
fn mcap(draw: &mut Draw<'_>, file: &Path) -> Result<String> {
    let mut records: Vec<Record> = Vec::new();
    let mut chunks = Chunks::open(file, OWN_RATIO)?;
    while let Ok(Some(packed)) = chunks.next_packed() {
        if let Ok(chunk) = packed.unpack(Vec::new()) {
            records.extend(
                chunk
                    .records()
                    .map(|(opcode, body)| (opcode, body.to_vec())),
            );
        }
    }
    if records.is_empty() {
        return Ok(String::from("the recording is damaged already"));
    }
    let what = change(draw, &mut records);
    let mut inner = Vec::new();
    for record in &records {
        put(&mut inner, record);
    }
    let mut chunk = Vec::new();
    chunk.extend(0_u64.to_le_bytes());
    chunk.extend(u64::MAX.to_le_bytes());
    chunk.extend((inner.len() as u64).to_le_bytes());
    chunk.extend(crc32fast::hash(&inner).to_le_bytes());
    chunk.extend(0_u32.to_le_bytes());
    chunk.extend((inner.len() as u64).to_le_bytes());
    chunk.extend(inner);
    let mut out = b"\x89MCAP0\r\n".to_vec();
    put(&mut out, &(CHUNK, chunk));
    fs::write(file, out).context("writing the recording")?;
    Ok(what)
}

fn put(out: &mut Vec<u8>, (opcode, body): &Record) {
    out.push(*opcode);
    out.extend((body.len() as u64).to_le_bytes());
    out.extend(body);
}

fn change(draw: &mut Draw<'_>, records: &mut Vec<Record>) -> String {
    let messages: Vec<usize> = (0..records.len())
        .filter(|&i| records[i].0 == MESSAGE)
        .collect();
    if messages.is_empty() {
        return String::from("there are no messages left");
    }
    let which = *draw.one_of(&messages);
    let whole = *draw.one_of(&WHOLE);
    let real = *draw.one_of(&REAL);
    match draw.below(9) {
        // All messages of one topic, or one alone.
        kind @ 0..=3 => {
            let all = draw.below(3) == 0;
            let channel = records[which].1[..2].to_vec();
            let length = records[which].1.len();
            let place = match kind {
                0 => 6,
                1 => 2,
                _ => MESSAGE_HEAD + draw.below(length.saturating_sub(MESSAGE_HEAD)),
            };
            let value = match kind {
                0 | 1 | 3 => whole.to_le_bytes(),
                _ => real.to_le_bytes(),
            };
            let those = (0..records.len())
                .filter(|&i| {
                    i == which || all && records[i].0 == MESSAGE && records[i].1[..2] == channel
                })
                .collect::<Vec<_>>();
            for &i in &those {
                overwrite(&mut records[i].1, place, value);
            }
            format!(
                "{} messages of channel {channel:?}: byte {place} = {value:?}",
                those.len()
            )
        }
        4 => {
            let times = [50, 5_000, 200_000][draw.below(3)];
            let copy = records[which].clone();
            records.splice(which..which, std::iter::repeat_n(copy, times));
            format!("message {which} {times} times more")
        }
        5 => {
            let length = records[which].1.len();
            let to = MESSAGE_HEAD.min(length) + draw.below(length);
            records[which].1.truncate(to);
            format!("message {which} cut to {to} bytes")
        }
        6 => {
            let other = *draw.one_of(&messages);
            records.swap(which, other);
            format!("messages {which} and {other} swapped")
        }
        7 => {
            let described = (0..records.len()).filter(|&i| records[i].0 == CHANNEL);
            let described: Vec<usize> = described.collect();
            if described.is_empty() {
                return String::from("no topic is described");
            }
            let channel = *draw.one_of(&described);
            let place = draw.below(records[channel].1.len());
            records[channel].1[place] ^= 1 << draw.below(8);
            format!("topic {channel}: a bit of byte {place}")
        }
        _ => {
            let length = records[which].1.len();
            let claim = [whole as u32, length as u32 * 2, u32::MAX][draw.below(3)];
            let place = MESSAGE_HEAD + 4 + 4 * draw.below(length / 4);
            overwrite(&mut records[which].1, place, claim.to_le_bytes());
            format!("message {which}: a length of {claim} at {place}")
        }
    }
}

/// Values of messages in a bag.
fn bag_file(draw: &mut Draw<'_>, file: &Path) -> Result<String> {
    let mut reader = Bag::open(fs::File::open(file)?)?;
    let mut messages: Vec<Message> = Vec::new();
    while reader.next_chunk(|message| {
        messages.push(Message {
            topic: message.connection.topic.to_string(),
            kind: message.connection.kind.clone(),
            data: message.data.to_vec(),
        });
        Ok::<_, BagError>(())
    })? {}
    if messages.is_empty() {
        return Ok(String::from("the bag is damaged already"));
    }
    // Rare topics as often as common ones.
    let mut topics: Vec<String> = messages.iter().map(|m| m.topic.clone()).collect();
    topics.sort();
    topics.dedup();
    let topic = draw.one_of(&topics).clone();
    let those = (0..messages.len()).filter(|&i| messages[i].topic == topic);
    let those: Vec<usize> = those.collect();
    let which = *draw.one_of(&those);
    let length = messages[which].data.len();
    let what = match draw.below(8) {
        0..=3 => {
            let value = if draw.below(2) == 0 {
                draw.one_of(&WHOLE).to_le_bytes()
            } else {
                draw.one_of(&REAL).to_le_bytes()
            };
            let place = 4 * draw.below(length / 4);
            let all = draw.below(4) == 0;
            for &index in those.iter().filter(|&&index| all || index == which) {
                overwrite(&mut messages[index].data, place, value);
            }
            format!(
                "byte {place} of {} messages = {value:?}",
                if all { those.len() } else { 1 }
            )
        }
        4 => {
            let times = [50, 5_000, 100_000][draw.below(3)];
            let copy = messages[which].clone();
            messages.splice(which..which, std::iter::repeat_n(copy, times));
            format!("a message {times} times more")
        }
        5 => {
            messages[which].data.truncate(draw.below(length));
            String::from("a message is cut")
        }
        6 => {
            let name = draw.name();
            for &index in &those {
                messages[index].topic = format!("{name}{topic}");
            }
            format!("topic below {name:.40}")
        }
        _ => {
            let other = draw.below(messages.len());
            messages.swap(which, other);
            format!("swapped with message {other}")
        }
    };
    fs::write(file, bag::bag(&messages, bag::NOT_PACKED, 1))?;
    Ok(format!("bag {topic}: {what}"))
}

/// One value of one of the phone's files of rows.
fn csv_of_phone(draw: &mut Draw<'_>, files: &Files) -> Result<String> {
    let rows = [&files.gyro, &files.timestamps];
    let file = *draw.one_of(&rows);
    csv(draw, file)
}

/// One value of a file of rows.
fn csv(draw: &mut Draw<'_>, file: &Path) -> Result<String> {
    let text = fs::read_to_string(file)?;
    let mut rows: Vec<String> = text.lines().map(str::to_owned).collect();
    let place = match draw.below(4) {
        0 => 0,
        1 => rows.len().saturating_sub(1),
        _ => draw.below(rows.len()),
    };
    let Some(row) = rows.get_mut(place) else {
        return Ok(String::from("no rows are left"));
    };
    let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
    let cell = match draw.below(3) {
        0 => draw.below(cells.len()),
        _ => cells.len() - 1,
    };
    let value = match draw.below(8) {
        0 => "9".repeat(200_000),
        1 => draw.name(),
        2 => format!("{}.5", draw.one_of(&WHOLE)),
        _ => draw.number(),
    };
    let what = format!("row {place}, cell {cell} = {value:.40}");
    cells[cell] = value;
    *row = cells.join(",");
    match draw.below(12) {
        0 => rows.reverse(),
        1 => rows = vec![rows[place].clone(); rows.len()],
        2 => rows.truncate(place + 1),
        _ => {}
    }
    fs::write(file, rows.join("\n"))?;
    Ok(format!("{}: {what}", file.display()))
}

/// One value of a rig profile.
fn profile(draw: &mut Draw<'_>, file: &Path) -> Result<String> {
    let text = fs::read_to_string(file)?;
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let set = (0..lines.len()).filter(|&i| lines[i].contains(" = ") && !lines[i].starts_with('#'));
    let set: Vec<usize> = set.collect();
    if set.is_empty() {
        return Ok(String::from("no values are left"));
    }
    let line = *draw.one_of(&set);
    let value = match draw.below(5) {
        0 => format!("{:?}", draw.name()),
        1 => String::from("[[[[[[[[]]]]]]]]"),
        2 => String::from("{ a = 1 }"),
        _ => draw.number(),
    };
    let key = lines[line]
        .split(" = ")
        .next()
        .unwrap_or_default()
        .to_owned();
    lines[line] = format!("{key} = {value}");
    fs::write(file, lines.join("\n"))?;
    Ok(format!("profile {key} = {value:.40}"))
}

/// Bytes of a binary file: of its head, where lengths and tags are, or anywhere.
fn bytes(draw: &mut Draw<'_>, file: &Path, tags: bool) -> Result<String> {
    let mut bytes = fs::read(file)?;
    let length = bytes.len();
    let at = match draw.below(4) {
        // Numbers of Matroska's tags are texts.
        0 if tags => {
            let marks: Vec<usize> = (0..length.saturating_sub(4))
                .filter(|&i| bytes[i..].starts_with(b"K4A_"))
                .collect();
            if marks.is_empty() {
                0
            } else {
                *draw.one_of(&marks) + draw.below(64)
            }
        }
        1 | 2 => draw.below(4_096.min(length)),
        _ => draw.below(length),
    };
    let value = draw.one_of(&WHOLE).to_be_bytes();
    let count = draw.below(8) + 1;
    overwrite(&mut bytes, at, value.into_iter().rev().take(count));
    if draw.below(6) == 0 {
        bytes.truncate(draw.below(length));
    }
    fs::write(file, bytes)?;
    Ok(format!("{}: {count} bytes at {at}", file.display()))
}

/// One value of a table, or a number in a message.
fn sqlite(draw: &mut Draw<'_>, file: &Path) -> Result<String> {
    let columns = [
        ("topics", "id"),
        ("topics", "name"),
        ("topics", "type"),
        ("messages", "id"),
        ("messages", "topic_id"),
        ("messages", "data"),
    ];
    let (table, column) = *draw.one_of(&columns);
    let whole = i64::from_ne_bytes(draw.one_of(&WHOLE).to_ne_bytes());
    let row = i64::try_from(draw.below(4_000))?;
    let value = match draw.below(4) {
        0 => Sql::from(whole),
        1 => Sql::from(draw.name()),
        2 => Sql::from(vec![0; draw.below(1 << 20)]),
        _ => Sql::Null,
    };
    let what = format!("{table} {row}: {column} = {value:.60?}");
    let made = Connection::open(file).and_then(|bag| {
        // Of messages mostly a number within them.
        if column == "data" && draw.below(4) > 0 {
            let find = "SELECT data FROM messages WHERE id = ?1";
            let mut data: Vec<u8> = bag.query_row(find, [row], |row| row.get(0))?;
            let at = draw.below(data.len() / 8) * 8 + 4;
            let number = draw.one_of(&REAL).to_le_bytes();
            overwrite(&mut data, at, number);
            return bag.execute("UPDATE messages SET data = ?1 WHERE id = ?2", (data, row));
        }
        let set = format!(
            "UPDATE {table} SET {column} = ?1 WHERE rowid = (SELECT max(rowid) FROM {table} \
             WHERE rowid <= ?2)"
        );
        bag.execute(&set, (value, row))
    });
    Ok(match made {
        Ok(_) => what,
        Err(error) => format!("{what}: not made, {error}"),
    })
}

/// A video, or a playlist that names another file.
fn video_file(draw: &mut Draw<'_>, file: &Path) -> Result<String> {
    let bait = draw.root.join("bait/precious");
    let bait = bait.display();
    let list = match draw.below(6) {
        0 => format!("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{bait}\n#EXT-X-ENDLIST\n"),
        1 => format!("ffconcat version 1.0\nfile {bait}\n"),
        2 => {
            format!("<?xml version=\"1.0\"?><MPD><Period><BaseURL>{bait}</BaseURL></Period></MPD>")
        }
        _ => return bytes(draw, file, false),
    };
    fs::write(file, &list)?;
    Ok(format!("a playlist: {list:.30}"))
}

/// A link to the bait where the command writes.
fn link(draw: &mut Draw<'_>, files: &Files) -> Result<String> {
    let name = *draw.one_of(&[
        "report.html",
        "depth_recorder.log",
        "twist_1_phone_gyro.csv",
    ]);
    let place = files.recording.join(name);
    if place.symlink_metadata().is_err() {
        symlink(files.bait.join("precious"), &place)?;
    }
    Ok(format!("{name} is a link to the bait"))
}
