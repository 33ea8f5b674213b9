//! A part of a bag in sqlite3, as `rosbag2_storage_sqlite3` writes it: a table of topics,
//! and one of messages in the order in which they came.
//!
//! The file is opened as one that nobody changes, so that nothing is written beside it.
//! Tables only are read: a view or a generated column would compute what a stranger wants.
//! In memory are the cache of pages (2 MiB) and one message.

use std::collections::HashMap;
use std::path::Path;

use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::{Connection, OpenFlags};

use super::{Message, Next, Part};
use crate::chunks::Budget;

/// What such a file begins with.
pub(super) const MAGIC: &[u8] = b"SQLite format 3\0";

/// Bytes of messages that are given at a time.
const CHUNK: usize = 4 << 20;
/// The longest text of the schema and of a topic, and the longest message: above an
/// uncompressed colour image of 3840x2160, as in a ROS 1 bag.
const MAX_TEXT: i32 = 1 << 16;
const MAX_MESSAGE: i32 = 40 << 20;
/// Most topics; as in a ROS 1 bag.
const MAX_TOPICS: usize = 1_000;
/// What a message counts at least, so that a file in which one page stands for many ends.
const LEAST_BYTES: u64 = 8;

/// The columns that are read, if they are true columns of true tables.
const COLUMNS: &str = "SELECT count(*) FROM sqlite_schema AS t, pragma_table_info(t.name) AS c \
    WHERE t.type = 'table' AND t.sql LIKE 'CREATE TABLE%' AND \
    (t.name = 'topics' AND c.name IN ('id', 'name', 'type', 'serialization_format') \
    OR t.name = 'messages' AND c.name IN ('topic_id', 'data'))";
const TOPICS: &str = "SELECT id, name, type, serialization_format FROM topics NOT INDEXED";
const MESSAGES: &str = "SELECT rowid, topic_id, data FROM messages NOT INDEXED \
    WHERE rowid > ?1 ORDER BY rowid";

pub(super) struct Tables {
    connection: Connection,
    length: u64,
    topics: HashMap<i64, Topic>,
    /// Number of the last message.
    last: i64,
    given: u64,
    budget: Budget,
    /// What is to be told before the messages.
    damage: Option<String>,
    ended: bool,
}

struct Topic {
    name: String,
    kind: String,
    encoding: String,
}

impl Tables {
    /// Opens it, or says in words why not.
    pub(super) fn open(path: &Path) -> Result<Self, String> {
        let length = path.metadata().map_err(|error| error.to_string())?.len();
        let connection = connect(path).map_err(|error| error.to_string())?;
        let columns: u32 = connection
            .query_row(COLUMNS, [], |row| row.get(0))
            .map_err(|error| error.to_string())?;
        if columns != 6 {
            return Err(String::from(
                "no ROS 2 bag: expected tables of topics and messages",
            ));
        }
        let topics = topics(&connection).map_err(|error| format!("its topics: {error}"))?;
        let pending = ["-wal", "-journal"].into_iter().find(|ending| {
            let mut beside = path.as_os_str().to_owned();
            beside.push(ending);
            Path::new(&beside)
                .metadata()
                .is_ok_and(|meta| meta.len() > 0)
        });
        Ok(Self {
            connection,
            length,
            topics,
            last: i64::MIN,
            given: 0,
            // Nothing is packed.
            budget: Budget::new(1),
            damage: pending.map(|ending| {
                format!(
                    "was not closed: what stands in the file {ending} beside it is left out; \
                     `sqlite3 FILE 'SELECT count(*) FROM messages'` takes it over"
                )
            }),
            ended: false,
        })
    }

    fn rows(&mut self, each: &mut dyn FnMut(Message<'_>)) -> rusqlite::Result<Next> {
        let mut statement = self.connection.prepare(MESSAGES)?;
        let mut rows = statement.query([self.last])?;
        let mut bytes = 0;
        while let Some(row) = rows.next()? {
            let data = row.get_ref(2)?.as_blob()?;
            let counted = LEAST_BYTES.max(data.len() as u64);
            if !self.budget.takes(counted, self.length) {
                self.ended = true;
                return Ok(Next::Damaged(String::from(
                    "holds more messages than it has bytes, which no bag does: the rest is left out",
                )));
            }
            self.last = row.get(0)?;
            self.given += counted;
            if let Some(topic) = self.topics.get(&row.get(1)?) {
                each(Message {
                    topic: &topic.name,
                    kind: &topic.kind,
                    encoding: &topic.encoding,
                    data,
                });
            }
            bytes += data.len();
            if bytes >= CHUNK {
                return Ok(Next::Given);
            }
        }
        self.ended = true;
        Ok(Next::Given)
    }
}

impl Part for Tables {
    fn next_chunk(&mut self, each: &mut dyn FnMut(Message<'_>)) -> Next {
        if let Some(damage) = self.damage.take() {
            return Next::Damaged(damage);
        }
        if self.ended {
            return Next::End;
        }
        self.rows(each).unwrap_or_else(|error| {
            self.ended = true;
            Next::Damaged(format!(
                "cannot be read beyond message {}: {error}",
                self.last
            ))
        })
    }

    fn topics(&self) -> Vec<String> {
        let topics = self.topics.values();
        topics.map(|topic| topic.name.clone()).collect()
    }

    fn position(&self) -> u64 {
        self.given.min(self.length)
    }
}

fn connect(path: &Path) -> rusqlite::Result<Connection> {
    let mut uri = String::from("file:");
    for &byte in path.as_os_str().as_encoded_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'-' | b'_' => {
                uri.push(char::from(byte));
            }
            _ => uri.push_str(&format!("%{byte:02X}")),
        }
    }
    uri.push_str("?immutable=1");
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI;
    let connection = Connection::open_with_flags(uri, flags)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, MAX_TEXT)?;
    Ok(connection)
}

fn topics(connection: &Connection) -> rusqlite::Result<HashMap<i64, Topic>> {
    let mut statement = connection.prepare(TOPICS)?;
    let topic = |row: &rusqlite::Row<'_>| {
        let topic = Topic {
            name: row.get(1)?,
            kind: row.get(2)?,
            encoding: row.get(3)?,
        };
        Ok((row.get(0)?, topic))
    };
    let topics = statement.query_map([], topic)?;
    let topics = topics.take(MAX_TOPICS).collect();
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, MAX_MESSAGE)?;
    topics
}
