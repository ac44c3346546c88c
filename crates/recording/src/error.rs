use std::path::PathBuf;

use crate::cdr::CdrError;

/// What can go wrong with a recording, a trajectory file or their provenance. Every message names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was attempted.
        action: &'static str,
        /// Why not.
        source: std::io::Error,
    },
    /// A file of this name is there, and was not to be replaced.
    #[error("{}: exists already; choose another name, or allow it to be replaced", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file has no bytes.
    #[error("{}: the file is empty; record or copy it again", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The file does not start like an MCAP file.
    #[error("{}: not an MCAP file (wrong first bytes or damaged header)", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// The file is MCAP, but laid out for something else.
    #[error("{}: MCAP profile is `{found}`, a recording has `ros2`", path.display())]
    Profile {
        /// The file.
        path: PathBuf,
        /// Its profile.
        found: String,
    },
    /// Messages lie outside chunks, where there is no index.
    #[error("{}: messages outside chunks at byte {offset}; rewrite the file with `mcap compress`", path.display())]
    Unchunked {
        /// The file.
        path: PathBuf,
        /// The first such message.
        offset: u64,
    },
    /// Nothing was recorded under this name.
    #[error("{}: no topic for `{wanted}`; the recording has {available}", path.display())]
    NoSuchTopic {
        /// The file.
        path: PathBuf,
        /// What was asked for.
        wanted: String,
        /// Topics that there are.
        available: String,
    },
    /// Several topics answer to this name.
    #[error("{}: `{wanted}` could be any of {candidates}; name the topic in full", path.display())]
    AmbiguousTopic {
        /// The file.
        path: PathBuf,
        /// What was asked for.
        wanted: String,
        /// The topics.
        candidates: String,
    },
    /// The topic carries another message type or encoding.
    #[error("{}: topic {topic} carries {found}, expected {expected}", path.display())]
    TopicType {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Message encoding and schema there.
        found: String,
        /// What is read.
        expected: String,
    },
    /// The recording lacks an attachment.
    #[error("{}: no attachment `{name}`; give the rig as a file or attach it when recording", path.display())]
    MissingAttachment {
        /// The file.
        path: PathBuf,
        /// Name of the attachment.
        name: String,
    },
    /// An attachment is there and does not say what it should.
    #[error("{}: attachment `{name}`: {problem}", path.display())]
    BadAttachment {
        /// The file.
        path: PathBuf,
        /// Name of the attachment.
        name: String,
        /// What is wrong.
        problem: String,
    },
    /// A part of the file cannot be read. Iterators report it once and go on behind it.
    #[error("{}: {damage}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where and how much.
        damage: Damage,
    },
    /// One message is not what its schema says. Iterators report it and go on with the next.
    #[error("{}: topic {topic}, message at {time_nanos} ns: {source}", path.display())]
    Message {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Its publish time, nanoseconds.
        time_nanos: i64,
        /// What is wrong.
        source: CdrError,
    },
    /// The rig attached to the recording cannot be read.
    #[error(transparent)]
    Rig(#[from] lsfb_geometry::RigError),
    /// A sample cannot be put into its message.
    #[error("{}: topic {topic}: {reason}", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Why.
        reason: String,
    },
    /// An earlier write failed. What was written before that is intact; the rest of the recording is lost.
    #[error("{}: recording stopped at byte {intact_bytes}: {cause}; everything before is intact", path.display())]
    WriterFailed {
        /// The file.
        path: PathBuf,
        /// Size of the part that can be read.
        intact_bytes: u64,
        /// The first failure.
        cause: String,
    },
    /// A line of a trajectory file is wrong.
    #[error("{}: line {line}: {reason}", path.display())]
    TrajectoryLine {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// The progress callback asked for an early end.
    #[error("{0}")]
    Stopped(#[from] lsfb_types::Stopped),
}

/// A part of a recording that could not be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// First byte of it.
    pub offset: u64,
    /// How many bytes are lost.
    pub bytes: u64,
    /// How many messages were in it, where an index tells.
    pub messages: Option<u64>,
    /// What is wrong there.
    pub reason: String,
}

impl Damage {
    /// Whether something is missing: an index that was rebuilt from the data lacks none of them.
    pub fn is_loss(&self) -> bool {
        self.bytes > 0 || !self.reason.contains(INDEX_REBUILT)
    }
}

/// How the reason begins where the index alone was damaged.
pub(crate) const INDEX_REBUILT: &str = "the index was rebuilt from the data";

impl std::fmt::Display for Damage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} at byte {}: {} bytes lost",
            self.reason, self.offset, self.bytes
        )?;
        match self.messages {
            Some(messages) => write!(f, ", {messages} messages"),
            None => Ok(()),
        }
    }
}
