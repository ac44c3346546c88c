use std::io;
use std::path::PathBuf;

/// What can go wrong between a device, or a file that stands for one, and its packets.
///
/// A packet that cannot be parsed is not here: it is a [`WireError`], counted by whoever pushes packets, and the stream
/// goes on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused to open or configure a device.
    #[error("{device}: cannot {action}: {cause}")]
    Open {
        /// The device as the user named it: an address, a node, a path.
        device: String,
        /// What was attempted, in a few words ("bind", "set 115200 baud").
        action: &'static str,
        /// What the operating system said.
        #[source]
        cause: io::Error,
    },
    /// The device worked and then failed: unplugged, reset, interface down.
    #[error("{device}: lost while reading: {cause}")]
    Lost {
        /// The device as the user named it.
        device: String,
        /// What the operating system said.
        #[source]
        cause: io::Error,
    },
    /// The end: a file was read to its last packet, or the other side said goodbye. Not a fault.
    #[error("{device}: end of stream")]
    EndOfStream {
        /// The device or file.
        device: String,
    },
    /// Sending to a device failed.
    #[error("{device}: cannot send: {cause}")]
    Send {
        /// The device as the user named it.
        device: String,
        /// What the operating system said.
        #[source]
        cause: io::Error,
    },
    /// A capture file is damaged or of another kind than its reader.
    #[error("{}: at {position}: {problem}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Where in the file: a byte offset, a packet or a row.
        position: String,
        /// What was found, and what was expected or can be done.
        problem: String,
    },
    /// The other side ended the connection, and said why.
    #[error("{device}: {reason}")]
    Refused {
        /// The device as the user named it.
        device: String,
        /// Whether another attempt may go better.
        may_pass: bool,
        /// What it said.
        reason: String,
    },
    /// The other side does not keep to the protocol, so that nothing after this can be trusted.
    #[error("{device}: {problem}")]
    Protocol {
        /// The device as the user named it.
        device: String,
        /// What was received and what was expected.
        problem: String,
    },
}

/// Why some bytes are not the message they should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WireError {
    /// Too short, too long, or a length field that does not fit the bytes.
    #[error("{got} bytes, expected {expected}")]
    Length {
        /// Bytes the message needs.
        expected: usize,
        /// Bytes there are.
        got: usize,
    },
    /// A constant of the format is not there: a flag, a preamble, a version.
    #[error("byte {offset}: {got:#x}, expected {expected:#x}")]
    Constant {
        /// Where in the message.
        offset: usize,
        /// The constant.
        expected: u32,
        /// What is there.
        got: u32,
    },
    /// The checksum does not match the bytes.
    #[error("checksum {got:#x}, but the bytes give {expected:#x}")]
    Checksum {
        /// Computed from the bytes.
        expected: u32,
        /// Carried by the message.
        got: u32,
    },
    /// A field has a value that the format does not allow.
    #[error("{field} at byte {offset} cannot be {got}")]
    Value {
        /// Name of the field.
        field: &'static str,
        /// Where in the message.
        offset: usize,
        /// What is there.
        got: u64,
    },
}
