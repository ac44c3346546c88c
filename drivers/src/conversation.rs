//! Requests and answers on a serial line, until the unit begins to send by itself.

use std::path::Path;
use std::time::{Duration, Instant};

use lsfb_types::{Packet, Timestamp};

use crate::Error;
use crate::byte_stream::ByteStream;
use crate::transport::PacketSource;
use crate::transport::serial::SerialLine;

/// How often a request is repeated before the unit counts as absent: a measuring unit may miss the first.
const ATTEMPTS: u32 = 5;
/// How long one answer is waited for. The manual of the slower family allows half a second.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(500);

/// A unit that is being configured.
#[derive(Debug)]
pub(crate) struct Conversation {
    line: SerialLine,
    stream: ByteStream,
}

impl Conversation {
    pub(crate) fn open(path: &Path, baud: u32) -> Result<Self, Error> {
        Ok(Self {
            line: SerialLine::open(path, baud)?,
            stream: ByteStream::default(),
        })
    }

    /// Sends `request` until `answer` finds what answers it among what has arrived: `None` where that is not there yet, a
    /// problem where the unit refuses. `what` names the request in errors. Data of a unit that still measures passes by.
    pub(crate) fn ask<A>(
        &mut self,
        what: &str,
        request: &[u8],
        mut answer: impl FnMut(&mut ByteStream) -> Option<Result<A, String>>,
    ) -> Result<A, Error> {
        for _ in 0..ATTEMPTS {
            self.line.send(request)?;
            let deadline = Instant::now() + ANSWER_TIMEOUT;
            while let Some(left) = deadline.checked_duration_since(Instant::now()) {
                if let Some(answer) = answer(&mut self.stream) {
                    return answer.map_err(|problem| self.protocol(problem));
                }
                if let Some(packet) = self.line.recv(left)? {
                    self.stream.push(packet.arrival, &packet.bytes);
                }
            }
        }
        Err(self.protocol(format!(
            "no answer to {what}; check that the unit is on and that the baud rate is right"
        )))
    }

    /// The unit has begun to send, at `arrival` of its last answer.
    pub(crate) fn finish(mut self, arrival: Timestamp) -> StreamingLine {
        let bytes = self.stream.take_rest();
        StreamingLine {
            first: (!bytes.is_empty()).then_some(Packet { arrival, bytes }),
            line: self.line,
        }
    }

    /// An error of the unit on this line.
    pub(crate) fn protocol(&self, problem: String) -> Error {
        Error::Protocol {
            device: self.line.device().to_owned(),
            problem,
        }
    }
}

/// A line on which a unit sends by itself: first what came behind its last answer, then what comes.
#[derive(Debug)]
pub(crate) struct StreamingLine {
    first: Option<Packet>,
    line: SerialLine,
}

impl PacketSource for StreamingLine {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        match self.first.take() {
            Some(packet) => Ok(Some(packet)),
            None => self.line.recv(timeout),
        }
    }
}
