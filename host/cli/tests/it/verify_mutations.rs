//! Every part of a good recording, dropped, cut, shifted, repeated, swapped or changed, with
//! checksums that are right again: none is called good.
//!
//! The MCAP file is written again by the `mcap` library, as other programs would, with a right
//! index. Numbers of `session.json` are changed with and without its own checksum.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use board::finding::Severity;
use extract::layout::Format;
use extract::options::Options;
use extract::report::LossPart;
use extract::run::{Job, run};
use mcap::records::MessageHeader;
use recording::rosbag2::METADATA_FILE;
use recording::session_file::{with_checksum, without_checksum};
use recording::verify::{Verification, verify};
use recording::walk::{Event, Walk};
use recording::{MCAP_FILE, SESSION_FILE};
use serde_json::Value;
use system::ReadMonitor;
use test_support::TestFolder;

use crate::support::synthetic::{Wrong, make};

#[derive(Clone)]
struct Message {
    topic: String,
    header: MessageHeader,
    data: Vec<u8>,
}

fn check(folder: &Path) -> Verification {
    verify(folder, &ReadMonitor::default()).unwrap()
}

/// Extracts a recording, and returns the number of losses of the board's part.
fn losses_of_board(folder: &Path, out: &Path) -> Result<usize, String> {
    let job = Job {
        recording: folder.to_owned(),
        phone: None,
        depth: None,
        format: Format::Euroc,
        out: out.to_owned(),
        options: Options::default(),
        overwrite: true,
        monitor: ReadMonitor::default(),
    };
    let report = run(&job).map_err(|error| error.to_string())?;
    let losses = report.losses.iter();
    Ok(losses.filter(|loss| loss.part == LossPart::Board).count())
}

fn messages(folder: &Path) -> Vec<Message> {
    let mut all = Vec::new();
    let mut walk = Walk::open(folder, &ReadMonitor::default()).unwrap();
    let mut each = |event: Event<'_>| {
        if let Event::Message(message) = event {
            all.push(Message {
                topic: message.channel.described.topic.clone(),
                header: message.header,
                data: message.data.to_vec(),
            });
        }
    };
    while walk.next_part(&mut each).unwrap() {}
    all
}

/// Writes the messages as another program would: chunks, checksums and index are right.
fn rewrite(original: &[u8], folder: &Path, messages: &[Message]) {
    let summary = mcap::Summary::read(original).unwrap().unwrap();
    let mut writer = recording::rosbag2::options()
        .create(mcap::write::NoSeek::new(Vec::new()))
        .unwrap();
    let mut channels = BTreeMap::new();
    let mut known: Vec<_> = summary.channels.values().collect();
    known.sort_by_key(|channel| channel.id);
    for channel in known {
        let schema = channel.schema.as_ref().unwrap();
        let schema = writer
            .add_schema(&schema.name, &schema.encoding, &schema.data)
            .unwrap();
        let id = writer
            .add_channel(schema, &channel.topic, "cdr", &channel.metadata)
            .unwrap();
        channels.insert(channel.topic.clone(), id);
    }
    for message in messages {
        let header = MessageHeader {
            channel_id: channels[&message.topic],
            ..message.header
        };
        writer
            .write_to_known_channel(&header, &message.data)
            .unwrap();
    }
    writer.finish().unwrap();
    let bytes = writer.into_inner().into_inner();
    fs::write(folder.join(MCAP_FILE), bytes).unwrap();
}

/// A change of the messages of one topic, given their places among all messages.
type Change = (&'static str, fn(&mut Vec<Message>, &[usize]));

fn shift(messages: &mut [Message], places: &[usize], by: i64) {
    for place in places {
        let header = &mut messages[*place].header;
        header.log_time = header.log_time.saturating_add_signed(by);
        header.publish_time = header.log_time;
    }
}

/// Removes messages, from the last on.
fn remove(messages: &mut Vec<Message>, places: &[usize]) {
    for place in places.iter().rev() {
        messages.remove(*place);
    }
}

const CHANGES: [Change; 14] = [
    ("dropped", |all, places| remove(all, places)),
    ("first half dropped", |all, places| {
        remove(all, &places[..places.len().div_ceil(2)])
    }),
    ("second half dropped", |all, places| {
        remove(all, &places[places.len() / 2..])
    }),
    ("first dropped", |all, places| remove(all, &places[..1])),
    ("last dropped", |all, places| {
        remove(all, &places[places.len() - 1..])
    }),
    ("every tenth dropped", |all, places| {
        remove(all, &places.iter().copied().step_by(10).collect::<Vec<_>>());
    }),
    ("shifted by an hour", |all, places| {
        shift(all, places, 3_600_000_000_000)
    }),
    ("shifted by a millisecond", |all, places| {
        shift(all, places, 1_000_000)
    }),
    ("second half shifted", |all, places| {
        shift(all, &places[places.len() / 2..], 5_000_000)
    }),
    ("last repeated", |all, places| {
        let last = all[places[places.len() - 1]].clone();
        all.push(last);
    }),
    ("two swapped", |all, places| {
        let (a, b) = (places[0], places[places.len() - 1]);
        if a == b {
            all[a].data.reverse();
        } else {
            let data = all[a].data.clone();
            all[a].data = std::mem::replace(&mut all[b].data, data);
        }
    }),
    ("numbered anew", |all, places| {
        for place in places {
            all[*place].header.sequence += 7;
        }
    }),
    ("one byte changed", |all, places| {
        let data = &mut all[places[places.len() / 2]].data;
        let middle = data.len() - 3;
        data[middle] ^= 1;
    }),
    ("stamps half a minute off", |all, places| {
        // The seconds of the stamp come first in every message of the board.
        for place in places {
            all[*place].data[4] ^= 0x1f;
        }
    }),
];

/// Changes each number, text or list of a document, and passes the document to `each`.
fn each_change(document: &Value, each: &mut dyn FnMut(&str, &Value)) {
    fn paths(value: &Value, path: String, all: &mut Vec<String>) {
        match value {
            Value::Object(map) => {
                for (key, value) in map {
                    let key = key.replace('~', "~0").replace('/', "~1");
                    paths(value, format!("{path}/{key}"), all);
                }
            }
            Value::Array(list) => {
                for (index, value) in list.iter().enumerate() {
                    paths(value, format!("{path}/{index}"), all);
                }
            }
            _ => {}
        }
        all.push(path);
    }
    let mut all = Vec::new();
    paths(document, String::new(), &mut all);
    for path in all {
        let mut changed = document.clone();
        let value = changed.pointer_mut(&path).unwrap();
        *value = match value.clone() {
            Value::Number(number) => match number.as_u64() {
                Some(whole) => (whole + 1).into(),
                None => (number.as_f64().unwrap() * 1.001 + 1.0).into(),
            },
            Value::String(text) => format!("{text}x").into(),
            Value::Bool(flag) => (!flag).into(),
            Value::Null => 1.into(),
            Value::Array(_) => Value::Array(Vec::new()),
            Value::Object(_) => Value::Null,
        };
        if changed != *document {
            each(&path, &changed);
        }
    }
}

#[test]
fn no_change_of_a_recording_is_called_good() {
    no_change_is_good(25);
}

#[test]
#[ignore = "takes a minute"]
fn no_change_of_a_recording_is_extracted_without_a_loss() {
    no_change_is_good(1);
}

/// One in `extracted` of the changed recordings is extracted too.
fn no_change_is_good(extracted: u32) {
    let parent = TestFolder::new();
    let wrong = Wrong {
        every_topic: true,
        ..Wrong::default()
    };
    let folder = make(parent.path(), wrong);
    let whole = check(&folder);
    assert_eq!(whole.severity, Severity::Good, "{:#?}", whole.findings);
    assert!(whole.compared.len() >= 7, "{:#?}", whole.compared);
    let mut tried = 0;
    let mut wrongly_good = Vec::new();
    let out = parent.path().join("out");
    assert_eq!(losses_of_board(&folder, &out), Ok(0));
    let mut judge = |name: String| {
        tried += 1;
        if tried % extracted == 0 && losses_of_board(&folder, &out) == Ok(0) {
            wrongly_good.push(format!("extract: {name}"));
        }
        if let Ok(found) = verify(&folder, &ReadMonitor::default())
            && found.severity == Severity::Good
        {
            wrongly_good.push(name);
        }
    };

    // The messages, topic by topic.
    let mcap = fs::read(folder.join(MCAP_FILE)).unwrap();
    let all = messages(&folder);
    let mut topics: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (place, message) in all.iter().enumerate() {
        topics.entry(&message.topic).or_default().push(place);
    }
    assert!(topics.len() >= 8, "{:?}", topics.keys());
    for (topic, places) in &topics {
        for (name, change) in CHANGES {
            let mut changed = all.clone();
            change(&mut changed, places);
            rewrite(&mcap, &folder, &changed);
            judge(format!("{topic}: {name}"));
        }
    }
    let half = &all[..all.len() / 2];
    rewrite(&mcap, &folder, half);
    judge(String::from("second half of the file"));
    // Written again without a change, it is as good as it was.
    rewrite(&mcap, &folder, &all);
    let again = check(&folder);
    assert_eq!(again.severity, Severity::Good, "{:#?}", again.findings);
    fs::write(folder.join(MCAP_FILE), &mcap).unwrap();

    // Every field of the session file, as an editor leaves it.
    let path = folder.join(SESSION_FILE);
    let text = fs::read_to_string(&path).unwrap();
    let document: Value = serde_json::from_str(&without_checksum(&text)).unwrap();
    each_change(&document, &mut |place, changed| {
        if place.is_empty() {
            return;
        }
        let changed = serde_json::to_string_pretty(changed).unwrap();
        fs::write(&path, &changed).unwrap();
        judge(format!("session.json without a checksum: {place}"));
        // With the old one.
        let end = text.rfind(",\n  \"checksum\"").unwrap();
        let open = changed.strip_suffix("\n}").unwrap();
        fs::write(&path, format!("{open}{}", &text[end..])).unwrap();
        judge(format!("session.json: {place}"));
    });
    // What it states about the messages, with a checksum that is right.
    let contents = &document["contents"];
    each_change(contents, &mut |place, changed| {
        let mut whole = document.clone();
        whole["contents"] = changed.clone();
        let text = with_checksum(&serde_json::to_string_pretty(&whole).unwrap());
        fs::write(&path, text).unwrap();
        judge(format!("session.json, with its checksum: contents{place}"));
    });
    fs::remove_file(&path).unwrap();
    judge(String::from("no session.json"));
    fs::write(&path, &text).unwrap();

    // Other files: gone, empty, cut, longer, one byte changed.
    for name in [METADATA_FILE, "twist_1_phone_gyro.csv", "depth.mkv"] {
        let path = folder.join(name);
        let bytes = fs::read(&path).unwrap();
        fs::remove_file(&path).unwrap();
        judge(format!("{name} gone"));
        let mut flipped = bytes.clone();
        flipped[bytes.len() / 2] ^= 1;
        let longer = [&bytes[..], b"0"].concat();
        for (what, bytes) in [
            ("empty", &b""[..]),
            ("cut", &bytes[..bytes.len() / 2]),
            ("longer", &longer),
            ("changed", &flipped),
        ] {
            fs::write(&path, bytes).unwrap();
            judge(format!("{name} {what}"));
        }
        fs::write(&path, bytes).unwrap();
    }
    println!("{tried} changes, {} extracted", tried / extracted);
    assert!(tried >= 400, "{tried}");
    assert_eq!(wrongly_good, [""; 0], "of {tried}");
    assert_eq!(check(&folder).severity, Severity::Good);
}

/// An index with right checksums that names other places, times or counts than the file has.
#[test]
fn an_index_that_lies_is_found() {
    let parent = TestFolder::new();
    let folder = make(parent.path(), Wrong::default());
    let bytes = fs::read(folder.join(MCAP_FILE)).unwrap();
    let footer = bytes.len() - 8 - 20;
    let word = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    let summary = word(footer);
    // Records of the summary: opcode, length, body.
    let mut at = summary;
    let mut lies = Vec::new();
    while at < footer - 9 {
        let (opcode, length) = (bytes[at], word(at + 1));
        let body = at + 9;
        match opcode {
            mcap::records::op::CHUNK_INDEX => {
                lies.extend((0..4).map(|field| (body + 8 * field, "chunk_index")));
            }
            mcap::records::op::STATISTICS => {
                lies.push((body, "message_count"));
                // Chunks, first and last time, and the count of a topic.
                lies.extend([22, 26, 34, body_of_counts(&bytes, body)].map(|offset| {
                    (
                        if offset < 64 { body + offset } else { offset },
                        "statistics",
                    )
                }));
            }
            _ => {}
        }
        at += 9 + length;
    }
    assert!(lies.len() > 40, "{}", lies.len());
    for (place, kind) in lies {
        let mut lying = bytes.clone();
        lying[place] ^= 0x10;
        let crc = crc32fast::hash(&lying[summary..footer + 16]);
        lying[footer + 16..footer + 20].copy_from_slice(&crc.to_le_bytes());
        fs::write(folder.join(MCAP_FILE), lying).unwrap();
        let found = check(&folder);
        let kinds: Vec<String> = found.findings.iter().map(|f| f.kind.to_string()).collect();
        assert!(kinds.contains(&kind.to_owned()), "byte {place}: {kinds:?}");
    }
}

/// The place of the first count of a topic's messages that is not 0, in statistics.
fn body_of_counts(bytes: &[u8], body: usize) -> usize {
    let mut at = body + 8 + 2 + 4 * 4 + 8 + 8 + 4;
    while bytes[at + 2..at + 10] == [0; 8] {
        at += 10;
    }
    at + 2
}
