//! A camera over a Unix stream socket: frame bytes and extension unit transactions, the level at which `v4l` and the
//! kernel's UVC driver hand them over. Mock units speak it; the parsing behind it is that of real ones.
//!
//! Both sides send messages of an 8-byte header and a body:
//!
//! | byte | content |
//! | --- | --- |
//! | 0 | kind |
//! | 1 | selector of the extension unit, or of a control of the processing unit, else 0 |
//! | 2 | query code (USB Video Class table A-8), else 0 |
//! | 3 | 1 in a reply that refuses the transaction, else 0 |
//! | 4–7 | length of the body, little-endian |
//!
//! | kind | direction | body |
//! | --- | --- | --- |
//! | 1 start | host → unit | width u32, height u32, rate in Hz u32, little-endian |
//! | 2 transaction | host → unit | bytes of a write, empty for a read |
//! | 3 frame | unit → host | frame bytes, trailer included |
//! | 4 reply | unit → host | bytes of a read, empty for a write |
//! | 6 control | host → unit | value i32 of a write, little-endian; empty for a read, whose reply has it |
//! | 5 end | unit → host | empty; the socket closes after it |
//!
//! Each transaction and control has one reply, in order; frames may come before it. The unit sends frames only after a start. A
//! slow host blocks the unit: nothing is dropped. A socket that closes without an end is a lost unit.

mod message;
#[cfg(test)]
mod tests;
mod unit;

use std::collections::VecDeque;
use std::io;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::{Duration, Instant};

use lsfb_types::Packet;

use self::message::{Header, Kind, MessageReader, StreamRequest};
use super::PacketSource;
use crate::Error;
use crate::transport::uvc::{FrameFormat, ImageControl, XuQuery, XuSelector};

pub use self::unit::{CameraListener, CameraUnit, UnitRequest};

/// Largest body: a frame of the largest format, with room for wider ones.
const MAX_BODY_BYTES: usize = 16 << 20;
/// Frames that may pile up while the host waits for a reply: as many as the vendor's SDK keeps buffers.
const MAX_WAITING_FRAMES: usize = 24;
/// How long a reply is waited for.
const REPLY_TIMEOUT: Duration = Duration::from_secs(5);

/// The host's side of a camera.
#[derive(Debug)]
pub struct SocketLink {
    socket: UnixStream,
    device: String,
    reader: MessageReader,
    waiting: VecDeque<Packet>,
    ended: bool,
}

impl SocketLink {
    /// Connects to the socket at `path`.
    pub fn connect(path: &Path) -> Result<Self, Error> {
        let device = path.display().to_string();
        let socket = UnixStream::connect(path).map_err(|cause| Error::Open {
            device: device.clone(),
            action: "connect to the camera socket",
            cause,
        })?;
        Ok(Self {
            socket,
            device,
            reader: MessageReader::default(),
            waiting: VecDeque::new(),
            ended: false,
        })
    }

    /// The path as the user named it.
    pub fn device(&self) -> &str {
        &self.device
    }

    /// Asks for frames.
    pub fn start(&mut self, format: FrameFormat, rate_hz: u32) -> Result<(), Error> {
        let body = StreamRequest { format, rate_hz }.emit();
        self.send(Header::new(Kind::Start), &body)
    }

    /// The next frame. `None`: nothing within `timeout`; a part that arrived is kept for the next call.
    pub fn next_frame(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        if let Some(frame) = self.waiting.pop_front() {
            return Ok(Some(frame));
        }
        let deadline = Instant::now() + timeout;
        match self.next_message(deadline)? {
            None => Ok(None),
            Some((header, packet)) if header.kind == Kind::Frame => Ok(Some(packet)),
            Some((header, _)) => Err(self.unexpected(header)),
        }
    }

    /// Writes to the extension unit.
    pub fn xu_set(&mut self, selector: XuSelector, bytes: &[u8]) -> Result<(), Error> {
        self.transact(Kind::Transaction, selector.id(), XuQuery::SetCur, bytes)
            .map(|_| ())
    }

    /// Sets a control of the image sensors.
    pub fn control_set(&mut self, control: ImageControl, value: i32) -> Result<(), Error> {
        let bytes = value.to_le_bytes();
        self.transact(Kind::Control, control.id(), XuQuery::SetCur, &bytes)
            .map(|_| ())
    }

    /// Current value of a control of the image sensors.
    pub fn control_get(&mut self, control: ImageControl) -> Result<i32, Error> {
        let bytes = self.transact(Kind::Control, control.id(), XuQuery::GetCur, &[])?;
        let value = bytes.as_slice().try_into().map_err(|_| {
            self.protocol(format!(
                "{} bytes in a reply about {control:?}, which has 4",
                bytes.len()
            ))
        })?;
        Ok(i32::from_le_bytes(value))
    }

    /// Reads from the extension unit.
    pub fn xu_get(&mut self, selector: XuSelector, query: XuQuery) -> Result<Vec<u8>, Error> {
        let bytes = self.transact(Kind::Transaction, selector.id(), query, &[])?;
        if bytes.len() != selector.len_bytes() {
            return Err(self.protocol(format!(
                "{} bytes in a reply of selector {}, which has {}",
                bytes.len(),
                selector.id(),
                selector.len_bytes()
            )));
        }
        Ok(bytes)
    }

    fn transact(
        &mut self,
        kind: Kind,
        selector: u8,
        query: XuQuery,
        bytes: &[u8],
    ) -> Result<Vec<u8>, Error> {
        let request = Header {
            selector,
            query: query.code(),
            ..Header::new(kind)
        };
        self.send(request, bytes)?;
        let deadline = Instant::now() + REPLY_TIMEOUT;
        loop {
            let Some((header, packet)) = self.next_message(deadline)? else {
                return Err(self.protocol(format!(
                    "no reply about selector {} within {} s",
                    selector,
                    REPLY_TIMEOUT.as_secs()
                )));
            };
            match header.kind {
                Kind::Frame if self.waiting.len() < MAX_WAITING_FRAMES => {
                    self.waiting.push_back(packet);
                }
                Kind::Frame => {
                    return Err(self.protocol(format!(
                        "{MAX_WAITING_FRAMES} frames before the reply about selector {}",
                        selector
                    )));
                }
                Kind::Reply if header.selector == selector && header.query == query.code() => {
                    if header.refused {
                        return Err(self.protocol(format!(
                            "the unit rejected query {:#04x} of selector {}",
                            query.code(),
                            selector
                        )));
                    }
                    return Ok(packet.bytes);
                }
                _ => return Err(self.unexpected(header)),
            }
        }
    }

    /// The next message but an end, which becomes [`Error::EndOfStream`].
    fn next_message(&mut self, deadline: Instant) -> Result<Option<(Header, Packet)>, Error> {
        if self.ended {
            return Err(self.end_of_stream());
        }
        match self.reader.read(&self.socket, deadline) {
            Ok(Some((header, _))) if header.kind == Kind::End => {
                self.ended = true;
                Err(self.end_of_stream())
            }
            Ok(message) => Ok(message),
            Err(cause) if cause.kind() == io::ErrorKind::InvalidData => {
                Err(self.protocol(cause.to_string()))
            }
            Err(cause) => Err(Error::Lost {
                device: self.device.clone(),
                cause,
            }),
        }
    }

    fn send(&mut self, header: Header, body: &[u8]) -> Result<(), Error> {
        message::write(&mut self.socket, header, body).map_err(|cause| Error::Send {
            device: self.device.clone(),
            cause,
        })
    }

    fn end_of_stream(&self) -> Error {
        Error::EndOfStream {
            device: self.device.clone(),
        }
    }

    fn unexpected(&self, header: Header) -> Error {
        self.protocol(format!("unexpected message: {header:?}"))
    }

    fn protocol(&self, problem: String) -> Error {
        Error::Protocol {
            device: self.device.clone(),
            problem,
        }
    }
}

impl PacketSource for SocketLink {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        self.next_frame(timeout)
    }
}
