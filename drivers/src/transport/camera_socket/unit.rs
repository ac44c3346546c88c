//! The unit's side, for mocks.

use std::collections::BTreeMap;
use std::io;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::message::{self, Header, Kind, MessageReader, StreamRequest};
use crate::Error;
use crate::transport::poll::readable;
use crate::transport::uvc::{FrameFormat, ImageControl, XuQuery, XuRefusal, XuSelector};

/// Waits for hosts at a socket path. The file at the path is removed when this is dropped.
#[derive(Debug)]
pub struct CameraListener {
    listener: UnixListener,
    path: PathBuf,
}

impl CameraListener {
    /// Makes the socket at `path`, which must not exist.
    pub fn bind(path: &Path) -> Result<Self, Error> {
        let listener = UnixListener::bind(path).map_err(|cause| Error::Open {
            device: path.display().to_string(),
            action: "create the camera socket",
            cause,
        })?;
        Ok(Self {
            listener,
            path: path.to_owned(),
        })
    }

    /// The next host, waiting up to `timeout`.
    pub fn accept(&self, timeout: Duration) -> Result<Option<CameraUnit>, Error> {
        let accepted = readable(&self.listener, timeout).and_then(|ready| {
            if ready {
                self.listener.accept().map(Some)
            } else {
                Ok(None)
            }
        });
        let accepted = accepted.map_err(|cause| Error::Open {
            device: self.path.display().to_string(),
            action: "accept a host",
            cause,
        })?;
        Ok(accepted.map(|(socket, _)| CameraUnit {
            socket,
            device: self.path.display().to_string(),
            reader: MessageReader::default(),
            controls: BTreeMap::new(),
        }))
    }
}

impl Drop for CameraListener {
    fn drop(&mut self) {
        // Whoever removed the file first has done the work.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// What a host asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum UnitRequest {
    /// Send frames of this format at this rate.
    Start {
        /// Size of the frames.
        format: FrameFormat,
        /// Frames per second.
        rate_hz: u32,
    },
    /// A write to the extension unit; answer it with [`CameraUnit::reply_set`].
    XuSet {
        /// Channel.
        selector: XuSelector,
        /// What is written.
        bytes: Vec<u8>,
    },
    /// A read; answer it with [`CameraUnit::reply_get`].
    XuGet {
        /// Channel.
        selector: XuSelector,
        /// What is asked.
        query: XuQuery,
    },
}

/// A unit with one host.
#[derive(Debug)]
pub struct CameraUnit {
    socket: UnixStream,
    device: String,
    reader: MessageReader,
    controls: BTreeMap<ImageControl, i32>,
}

impl CameraUnit {
    /// What the host set a control of the image sensors to.
    pub fn control(&self, control: ImageControl) -> Option<i32> {
        self.controls.get(&control).copied()
    }

    /// The host's next request, waiting up to `timeout`. A host that closed is [`Error::Lost`]. Controls of the image
    /// sensors are kept and answered here.
    pub fn next_request(&mut self, timeout: Duration) -> Result<Option<UnitRequest>, Error> {
        let deadline = Instant::now() + timeout;
        let (header, packet) = loop {
            let read = self.reader.read(&self.socket, deadline);
            match read.map_err(|cause| self.lost(cause))? {
                Some((header, packet)) if header.kind == Kind::Control => {
                    self.answer_control(header, &packet.bytes)?;
                }
                Some(message) => break message,
                None => return Ok(None),
            }
        };
        let selector = || {
            XuSelector::from_id(header.selector).ok_or_else(|| {
                self.protocol(format!("selector {} does not exist", header.selector))
            })
        };
        match header.kind {
            Kind::Start => {
                let request = StreamRequest::parse(&packet.bytes);
                let request = request.map_err(|e| self.protocol(e.to_string()))?;
                Ok(Some(UnitRequest::Start {
                    format: request.format,
                    rate_hz: request.rate_hz,
                }))
            }
            Kind::Transaction => match XuQuery::from_code(header.query) {
                Some(XuQuery::SetCur) => Ok(Some(UnitRequest::XuSet {
                    selector: selector()?,
                    bytes: packet.bytes,
                })),
                Some(query) => Ok(Some(UnitRequest::XuGet {
                    selector: selector()?,
                    query,
                })),
                None => Err(self.protocol(format!("query {:#04x} does not exist", header.query))),
            },
            _ => Err(self.protocol(format!("a message that no host sends: {header:?}"))),
        }
    }

    fn answer_control(&mut self, request: Header, bytes: &[u8]) -> Result<(), Error> {
        /// Values that the sensors have.
        const RANGE: std::ops::RangeInclusive<i32> = 0..=1000;
        let control = ImageControl::from_id(request.selector);
        let answer = match (control, XuQuery::from_code(request.query)) {
            (Some(control), Some(XuQuery::GetCur)) => {
                let value = self.control(control).unwrap_or_default();
                Some(value.to_le_bytes().to_vec())
            }
            (Some(control), Some(XuQuery::SetCur)) => {
                let value = bytes.try_into().map(i32::from_le_bytes);
                let value = value.ok().filter(|value| RANGE.contains(value));
                value.map(|value| {
                    self.controls.insert(control, value);
                    Vec::new()
                })
            }
            _ => None,
        };
        let header = Header {
            kind: Kind::Reply,
            refused: answer.is_none(),
            ..request
        };
        self.send(header, &answer.unwrap_or_default())
    }

    /// Answers a write.
    pub fn reply_set(
        &mut self,
        selector: XuSelector,
        outcome: Result<(), XuRefusal>,
    ) -> Result<(), Error> {
        self.reply(selector, XuQuery::SetCur, outcome.map(|()| Vec::new()))
    }

    /// Answers a read.
    pub fn reply_get(
        &mut self,
        selector: XuSelector,
        query: XuQuery,
        outcome: Result<Vec<u8>, XuRefusal>,
    ) -> Result<(), Error> {
        self.reply(selector, query, outcome)
    }

    /// Sends a frame, waiting until the host has room for it.
    pub fn send_frame(&mut self, frame: &[u8]) -> Result<(), Error> {
        self.send(Header::new(Kind::Frame), frame)
    }

    /// Says that there is nothing more to come, and closes.
    pub fn finish(mut self) -> Result<(), Error> {
        self.send(Header::new(Kind::End), &[])
    }

    fn reply(
        &mut self,
        selector: XuSelector,
        query: XuQuery,
        outcome: Result<Vec<u8>, XuRefusal>,
    ) -> Result<(), Error> {
        let header = Header {
            selector: selector.id(),
            query: query.code(),
            refused: outcome.is_err(),
            ..Header::new(Kind::Reply)
        };
        self.send(header, &outcome.unwrap_or_default())
    }

    fn send(&mut self, header: Header, body: &[u8]) -> Result<(), Error> {
        message::write(&mut self.socket, header, body).map_err(|cause| self.lost(cause))
    }

    fn lost(&self, cause: io::Error) -> Error {
        Error::Lost {
            device: self.device.clone(),
            cause,
        }
    }

    fn protocol(&self, problem: String) -> Error {
        Error::Protocol {
            device: self.device.clone(),
            problem,
        }
    }
}
