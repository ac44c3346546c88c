//! WebSockets over TLS, the side that connects: whole binary messages in both directions.

use std::io::{self, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use lsfb_types::Packet;
use rustls::pki_types::ServerName;
use rustls::{ClientConnection, StreamOwned};
use tungstenite::http::Uri;
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Bytes, ClientRequestBuilder, HandshakeError, Message, WebSocket};

use super::arrival_now;
use super::pinned_tls;
use super::poll::readable;
use crate::Error;

/// How long opening and closing handshakes may take.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);

/// What both sides agree on before the first message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Path of the request.
    pub path: &'static str,
    /// Subprotocol; another one is refused.
    pub subprotocol: &'static str,
    /// Longest message, bytes; a longer one ends the connection.
    pub max_message_bytes: usize,
}

impl Endpoint {
    fn limits(self) -> WebSocketConfig {
        WebSocketConfig::default()
            .max_message_size(Some(self.max_message_bytes))
            .max_frame_size(Some(self.max_message_bytes))
    }
}

/// A TCP connection that can be made to break.
#[derive(Debug)]
struct Wire {
    tcp: TcpStream,
    /// It breaks when so many more bytes are sent.
    cut_after: Option<u64>,
}

impl Read for Wire {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.tcp.read(into)
    }
}

impl Write for Wire {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let Some(left) = &mut self.cut_after else {
            return self.tcp.write(bytes);
        };
        let most = usize::try_from(*left).unwrap_or(usize::MAX);
        let allowed = bytes.get(..most).unwrap_or(bytes);
        if allowed.is_empty() {
            self.tcp.shutdown(Shutdown::Both)?;
            return Err(io::ErrorKind::ConnectionReset.into());
        }
        let sent = self.tcp.write(allowed)?;
        *left -= sent as u64;
        Ok(sent)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.tcp.flush()
    }
}

/// One side of an open WebSocket.
#[derive(Debug)]
pub struct WebSocketConnection {
    socket: WebSocket<StreamOwned<ClientConnection, Wire>>,
    device: String,
    ended: bool,
}

impl WebSocketConnection {
    /// Connects to `wss://address` and the endpoint's path; the other side must have the public key of this SHA-256.
    pub fn connect(
        address: SocketAddr,
        key_sha256: [u8; 32],
        endpoint: Endpoint,
    ) -> Result<Self, Error> {
        let device = format!("wss://{address}{}", endpoint.path);
        let refused = |cause| Error::Open {
            device: device.clone(),
            action: "open the WebSocket",
            cause,
        };
        let tcp = TcpStream::connect_timeout(&address, HANDSHAKE_TIMEOUT).map_err(refused)?;
        prepare(&tcp).map_err(refused)?;
        let tls = pinned_tls::client(key_sha256)
            .and_then(|config| {
                ClientConnection::new(config, ServerName::IpAddress(address.ip().into()))
            })
            .map_err(|e| refused(io::Error::other(e)))?;
        let wire = Wire {
            tcp,
            cut_after: None,
        };
        let uri: Uri = device
            .parse()
            .map_err(|e| refused(io::Error::new(io::ErrorKind::InvalidInput, e)))?;
        let request = ClientRequestBuilder::new(uri).with_sub_protocol(endpoint.subprotocol);
        let (socket, _) = tungstenite::client::client_with_config(
            request,
            StreamOwned::new(tls, wire),
            Some(endpoint.limits()),
        )
        .map_err(|e| refused(handshake_failed(e)))?;
        // From here on a slow reader may block the writer for as long as it likes.
        match socket.get_ref().sock.tcp.set_write_timeout(None) {
            Ok(()) => Ok(Self {
                socket,
                device,
                ended: false,
            }),
            Err(cause) => Err(Error::Lost { device, cause }),
        }
    }

    fn tcp(&self) -> &TcpStream {
        &self.socket.get_ref().sock.tcp
    }

    /// The other side, for messages.
    pub fn device(&self) -> &str {
        &self.device
    }

    /// Breaks the connection when so many more bytes are sent, wherever that is.
    pub fn cut_after(&mut self, bytes: u64) {
        self.socket.get_mut().sock.cut_after = Some(bytes);
    }

    /// Sends one message, waiting for room.
    pub fn send(&mut self, message: Vec<u8>) -> Result<(), Error> {
        self.socket
            .send(Message::Binary(Bytes::from(message)))
            .map_err(|e| match e {
                tungstenite::Error::Io(cause) => Error::Send {
                    device: self.device.clone(),
                    cause,
                },
                e => self.failed(e),
            })
    }

    /// Whether something has arrived that [`WebSocketConnection::recv`] has not looked at. False may miss what is
    /// already buffered: for hints only.
    pub fn has_arrived(&self) -> bool {
        // An error is left to the next call that can report it.
        readable(self.tcp(), Duration::ZERO).unwrap_or(true)
    }

    /// The next binary message, waiting up to `timeout`. The other side's close is [`Error::EndOfStream`].
    pub fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        if self.ended {
            return Err(self.end_of_stream());
        }
        let deadline = Instant::now() + timeout;
        loop {
            // Zero would mean to wait for ever.
            let left = deadline
                .saturating_duration_since(Instant::now())
                .max(Duration::from_micros(1));
            if let Err(cause) = self.tcp().set_read_timeout(Some(left)) {
                return Err(self.lost(cause));
            }
            match self.socket.read() {
                Ok(Message::Binary(bytes)) => {
                    return Ok(Some(Packet {
                        arrival: arrival_now(),
                        bytes: bytes.into(),
                    }));
                }
                Ok(Message::Close(_)) => {
                    self.ended = true;
                    // The answer to the close; it matters to nobody if it cannot be sent any more.
                    let _ = self.socket.flush();
                    return Err(self.end_of_stream());
                }
                // Pings are answered below us.
                Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_)) => {}
                Ok(Message::Text(text)) => {
                    return Err(Error::Protocol {
                        device: self.device.clone(),
                        problem: format!(
                            "a text message of {} bytes; only binary messages are supported",
                            text.len()
                        ),
                    });
                }
                Err(tungstenite::Error::Io(e))
                    if matches!(
                        e.kind(),
                        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut
                    ) => {}
                Err(e) => return Err(self.failed(e)),
            }
            if Instant::now() >= deadline {
                return Ok(None);
            }
        }
    }

    /// Says goodbye and waits a moment for the other side to do so.
    pub fn close(mut self) -> Result<(), Error> {
        if !self.ended {
            self.socket.close(None).map_err(|e| self.failed(e))?;
        }
        let deadline = Instant::now() + HANDSHAKE_TIMEOUT;
        while !self.ended && Instant::now() < deadline {
            match self.recv(Duration::from_millis(100)) {
                Ok(_) => {}
                Err(Error::EndOfStream { .. }) => break,
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }

    fn failed(&self, error: tungstenite::Error) -> Error {
        use tungstenite::Error as Ws;
        match error {
            Ws::ConnectionClosed | Ws::AlreadyClosed => self.end_of_stream(),
            Ws::Io(cause) => self.lost(cause),
            // The other side vanished without a closing handshake.
            Ws::Protocol(tungstenite::error::ProtocolError::ResetWithoutClosingHandshake) => {
                self.lost(io::ErrorKind::ConnectionReset.into())
            }
            e => Error::Protocol {
                device: self.device.clone(),
                problem: e.to_string(),
            },
        }
    }

    fn lost(&self, cause: io::Error) -> Error {
        Error::Lost {
            device: self.device.clone(),
            cause,
        }
    }

    fn end_of_stream(&self) -> Error {
        Error::EndOfStream {
            device: self.device.clone(),
        }
    }
}

/// Small messages leave at once, and a silent other side cannot hold a handshake open.
fn prepare(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(HANDSHAKE_TIMEOUT))?;
    stream.set_write_timeout(Some(HANDSHAKE_TIMEOUT))
}

fn handshake_failed<R: tungstenite::handshake::HandshakeRole>(
    error: HandshakeError<R>,
) -> io::Error {
    match error {
        HandshakeError::Failure(tungstenite::Error::Http(response)) => {
            let body = response.body().as_deref().unwrap_or_default();
            let body = String::from_utf8_lossy(body.get(..200).unwrap_or(body));
            io::Error::other(format!("refused with {}: {body}", response.status()))
        }
        HandshakeError::Failure(tungstenite::Error::Io(cause)) => cause,
        HandshakeError::Failure(e) => io::Error::other(e.to_string()),
        HandshakeError::Interrupted(_) => io::ErrorKind::TimedOut.into(),
    }
}
