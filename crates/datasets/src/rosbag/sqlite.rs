//! The `.db3` files of rosbag2: a database with a table of topics and one of messages.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, OpenFlags};

use super::file::{Visit, unreadable};
use crate::Error;

pub(super) struct Database {
    path: PathBuf,
    database: Connection,
    /// Number, name, type.
    topics: Vec<(i64, String, String)>,
}

impl Database {
    pub fn open(path: &Path) -> Result<Self, Error> {
        let wrong = |e: rusqlite::Error| unreadable(path, format!("not a rosbag2 database ({e})"));
        // sqlite would report a missing file without its cause.
        std::fs::metadata(path).map_err(|source| Error::Io {
            path: path.to_owned(),
            source,
        })?;
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let database = Connection::open_with_flags(path, flags).map_err(wrong)?;
        let read = || -> rusqlite::Result<Vec<(i64, String, String, String)>> {
            let mut query = database
                .prepare("SELECT id, name, type, serialization_format FROM topics ORDER BY id")?;
            query
                .query_map([], |row| {
                    Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?))
                })?
                .collect()
        };
        let mut topics = Vec::new();
        for (id, name, kind, format) in read().map_err(wrong)? {
            if format != "cdr" {
                return Err(unreadable(
                    path,
                    format!(
                        "messages of {name} are serialized as {format}, but only cdr is supported"
                    ),
                ));
            }
            topics.push((id, name, kind));
        }
        Ok(Self {
            path: path.to_owned(),
            database,
            topics,
        })
    }

    pub fn topics(&self) -> impl Iterator<Item = (&str, &str)> {
        self.topics
            .iter()
            .map(|(_, name, kind)| (name.as_str(), kind.as_str()))
    }

    /// Gives the messages of a topic in the order in which they arrived.
    pub fn visit(&self, topic: &str, each: Visit<'_>) -> Result<(), Error> {
        let wrong = |e: rusqlite::Error| unreadable(&self.path, e);
        let ids = self.topics.iter().filter(|(_, name, _)| name == topic);
        for (id, ..) in ids {
            let mut query = self
                .database
                .prepare("SELECT data FROM messages WHERE topic_id = ?1 ORDER BY timestamp, id")
                .map_err(wrong)?;
            let mut rows = query.query([id]).map_err(wrong)?;
            while let Some(row) = rows.next().map_err(wrong)? {
                let data = row.get_ref(0).map_err(wrong)?;
                let bytes = data.as_blob();
                each(bytes.map_err(|_| "a message that is not a blob".to_owned()))
                    .map_err(|problem| unreadable(&self.path, problem))?;
            }
        }
        Ok(())
    }
}
