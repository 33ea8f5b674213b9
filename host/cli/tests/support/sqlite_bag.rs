//! A part of a ROS 2 bag in sqlite3, with the tables of `rosbag2_storage_sqlite3`.

use std::path::Path;

use rusqlite::{Connection, Result};

const TABLES: &str = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, \
    type TEXT NOT NULL, serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL); \
    CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, \
    timestamp INTEGER NOT NULL, data BLOB NOT NULL); \
    CREATE INDEX timestamp_idx ON messages (timestamp ASC)";

/// Writes messages of one topic, and gives the open database.
pub(crate) fn write(
    path: &Path,
    (topic, kind): (&str, &str),
    messages: impl IntoIterator<Item = (i64, Vec<u8>)>,
) -> Result<Connection> {
    let mut connection = Connection::open(path)?;
    connection.execute_batch(TABLES)?;
    let all = connection.transaction()?;
    all.execute(
        "INSERT INTO topics VALUES (1, ?1, ?2, 'cdr', '')",
        (topic, kind),
    )?;
    for (received, data) in messages {
        let put = "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?1, ?2)";
        all.execute(put, (received, data))?;
    }
    all.commit()?;
    Ok(connection)
}
