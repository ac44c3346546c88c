//! The framing itself: headers, bodies, and reading them piece by piece.

use std::io::{self, IoSlice, Read, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use lsfb_types::{Packet, Timestamp};

use super::MAX_BODY_BYTES;
use crate::transport::arrival_now;
use crate::transport::uvc::FrameFormat;

const HEADER_BYTES: usize = 8;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Start,
    Transaction,
    Frame,
    Reply,
    End,
    Control,
}

impl Kind {
    fn id(self) -> u8 {
        match self {
            Self::Start => 1,
            Self::Transaction => 2,
            Self::Frame => 3,
            Self::Reply => 4,
            Self::End => 5,
            Self::Control => 6,
        }
    }

    fn from_id(id: u8) -> Option<Self> {
        [
            Self::Start,
            Self::Transaction,
            Self::Frame,
            Self::Reply,
            Self::End,
            Self::Control,
        ]
        .into_iter()
        .find(|kind| kind.id() == id)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) kind: Kind,
    pub(super) selector: u8,
    pub(super) query: u8,
    pub(super) refused: bool,
}

impl Header {
    pub(super) fn new(kind: Kind) -> Self {
        Self {
            kind,
            selector: 0,
            query: 0,
            refused: false,
        }
    }
}

/// What the host wants to be streamed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct StreamRequest {
    pub(super) format: FrameFormat,
    pub(super) rate_hz: u32,
}

impl StreamRequest {
    pub(super) fn emit(self) -> Vec<u8> {
        [self.format.width, self.format.height, self.rate_hz]
            .iter()
            .flat_map(|number| number.to_le_bytes())
            .collect()
    }

    pub(super) fn parse(body: &[u8]) -> io::Result<Self> {
        match body.as_chunks::<4>() {
            (&[width, height, rate_hz], []) => Ok(Self {
                format: FrameFormat {
                    width: u32::from_le_bytes(width),
                    height: u32::from_le_bytes(height),
                },
                rate_hz: u32::from_le_bytes(rate_hz),
            }),
            _ => Err(invalid(format!(
                "a start request of {} bytes instead of 12",
                body.len()
            ))),
        }
    }
}

/// Sends header and body, waiting for room.
pub(super) fn write(socket: &mut UnixStream, header: Header, body: &[u8]) -> io::Result<()> {
    let len = u32::try_from(body.len())
        .ok()
        .filter(|_| body.len() <= MAX_BODY_BYTES)
        .ok_or_else(|| invalid(format!("{} bytes are too long for a message", body.len())))?;
    let mut head = [
        header.kind.id(),
        header.selector,
        header.query,
        u8::from(header.refused),
        0,
        0,
        0,
        0,
    ];
    head[4..].copy_from_slice(&len.to_le_bytes());
    let mut slices = [IoSlice::new(&head), IoSlice::new(body)];
    let mut slices = slices.as_mut_slice();
    while slices.iter().any(|slice| !slice.is_empty()) {
        match socket.write_vectored(slices) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(len) => IoSlice::advance_slices(&mut slices, len),
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

/// Reads messages from a socket; what has arrived of an unfinished one stays here when time is up.
#[derive(Debug, Default)]
pub(super) struct MessageReader {
    head: Vec<u8>,
    body: Option<Body>,
}

#[derive(Debug)]
struct Body {
    header: Header,
    len: usize,
    arrival: Timestamp,
    bytes: Vec<u8>,
}

impl MessageReader {
    /// The next message, with the time at which its header was complete. `None`: not whole by `deadline`.
    ///
    /// A closed socket is [`io::ErrorKind::UnexpectedEof`], broken framing [`io::ErrorKind::InvalidData`].
    pub(super) fn read(
        &mut self,
        socket: &UnixStream,
        deadline: Instant,
    ) -> io::Result<Option<(Header, Packet)>> {
        loop {
            let (buffer, wanted) = match &mut self.body {
                None => (&mut self.head, HEADER_BYTES),
                Some(body) => (&mut body.bytes, body.len),
            };
            if !fill(socket, buffer, wanted, deadline)? {
                return Ok(None);
            }
            match self.body.take() {
                Some(body) => {
                    let packet = Packet {
                        arrival: body.arrival,
                        bytes: body.bytes,
                    };
                    return Ok(Some((body.header, packet)));
                }
                None => {
                    self.body = Some(Body::of(&self.head)?);
                    self.head.clear();
                }
            }
        }
    }
}

impl Body {
    fn of(head: &[u8]) -> io::Result<Self> {
        let &[kind, selector, query, refused, l0, l1, l2, l3] = head else {
            return Err(invalid(format!("a header of {} bytes", head.len())));
        };
        let Some(kind) = Kind::from_id(kind) else {
            return Err(invalid(format!(
                "message kind {kind}, which does not exist"
            )));
        };
        let len = u32::from_le_bytes([l0, l1, l2, l3]) as usize;
        if len > MAX_BODY_BYTES {
            return Err(invalid(format!(
                "a message of {len} bytes; at most {MAX_BODY_BYTES} are allowed"
            )));
        }
        Ok(Self {
            header: Header {
                kind,
                selector,
                query,
                refused: refused != 0,
            },
            len,
            arrival: arrival_now(),
            bytes: Vec::with_capacity(len),
        })
    }
}

/// Appends to `buffer` until it holds `wanted` bytes. False: the deadline came first.
fn fill(
    socket: &UnixStream,
    buffer: &mut Vec<u8>,
    wanted: usize,
    deadline: Instant,
) -> io::Result<bool> {
    while buffer.len() < wanted {
        // A timeout of zero would mean to wait for ever; what has arrived is taken even after the deadline.
        let left = deadline
            .saturating_duration_since(Instant::now())
            .max(Duration::from_micros(1));
        socket.set_read_timeout(Some(left))?;
        let missing = (wanted - buffer.len()) as u64;
        // Keeps what it read when it fails, and writes straight into the buffer that becomes the packet.
        match socket.take(missing).read_to_end(buffer) {
            Ok(_) if buffer.len() < wanted => {
                return Err(io::Error::new(
                    io::ErrorKind::UnexpectedEof,
                    format!(
                        "the unit closed the socket after {} of {wanted} bytes",
                        buffer.len()
                    ),
                ));
            }
            Ok(_) => {}
            Err(e)
                if matches!(
                    e.kind(),
                    io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut
                ) =>
            {
                if Instant::now() >= deadline {
                    return Ok(false);
                }
            }
            Err(e) => return Err(e),
        }
    }
    Ok(true)
}

pub(super) fn invalid(problem: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, problem)
}
