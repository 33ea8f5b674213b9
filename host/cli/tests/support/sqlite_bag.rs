//! A part of a ROS 2 bag in sqlite3, with the tables of `rosbag2_storage_sqlite3`.

use std::path::Path;

use rusqlite::{Connection, Result};

/// Without the recorder's constraints: a damaged bag may hold any value in any column.
const TABLES: &str = "CREATE TABLE topics(id, name, type, serialization_format, \
    offered_qos_profiles); CREATE TABLE messages(id, topic_id, timestamp, data); \
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
    for (id, (received, data)) in (1_i64..).zip(messages) {
        let put = "INSERT INTO messages VALUES (?1, 1, ?2, ?3)";
        all.execute(put, (id, received, data))?;
    }
    all.commit()?;
    Ok(connection)
}
