//! WebSockets over TCP: whole binary messages in both directions.
//!
//! TLS goes between the stream and the WebSocket once pairing exists; nothing above this file will change.

use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use lsfb_types::Packet;
use tungstenite::handshake::server::{Callback, ErrorResponse, Request, Response};
use tungstenite::http::{HeaderValue, StatusCode, Uri, header};
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Bytes, ClientRequestBuilder, HandshakeError, Message, WebSocket};

use super::arrival_now;
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

/// Accepts connections.
#[derive(Debug)]
pub struct WebSocketListener {
    listener: TcpListener,
    address: SocketAddr,
}

impl WebSocketListener {
    /// Listens on `address`; port 0 picks a free one.
    pub fn bind(address: SocketAddr) -> Result<Self, Error> {
        let bound = TcpListener::bind(address).and_then(|listener| {
            listener.set_nonblocking(true)?;
            let address = listener.local_addr()?;
            Ok(Self { listener, address })
        });
        bound.map_err(|cause| Error::Open {
            device: address.to_string(),
            action: "listen",
            cause,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The next TCP connection, waiting up to `timeout`. Its handshake is a step of its own, since the other side may
    /// be slow about it.
    pub fn accept(&self, timeout: Duration) -> Result<Option<PendingWebSocket>, Error> {
        let lost = |cause| Error::Lost {
            device: self.address.to_string(),
            cause,
        };
        if !readable(&self.listener, timeout).map_err(lost)? {
            return Ok(None);
        }
        match self.listener.accept() {
            Ok((stream, peer)) => Ok(Some(PendingWebSocket { stream, peer })),
            // The other side left between the two calls.
            Err(e)
                if matches!(
                    e.kind(),
                    io::ErrorKind::WouldBlock
                        | io::ErrorKind::Interrupted
                        | io::ErrorKind::ConnectionAborted
                ) =>
            {
                Ok(None)
            }
            Err(e) => Err(lost(e)),
        }
    }
}

/// A TCP connection that has not yet become a WebSocket.
#[derive(Debug)]
pub struct PendingWebSocket {
    stream: TcpStream,
    peer: SocketAddr,
}

impl PendingWebSocket {
    /// Answers the opening handshake: another path or subprotocol is refused.
    pub fn handshake(self, endpoint: Endpoint) -> Result<WebSocketConnection, Error> {
        let device = self.peer.to_string();
        let refused = |cause| Error::Open {
            device: device.clone(),
            action: "open the WebSocket",
            cause,
        };
        prepare(&self.stream).map_err(refused)?;
        let socket = tungstenite::accept_hdr_with_config(
            self.stream,
            RequestCheck(endpoint),
            Some(endpoint.limits()),
        )
        .map_err(|e| refused(handshake_failed(e)))?;
        WebSocketConnection::new(socket, device)
    }
}

/// Looks at the opening request.
struct RequestCheck(Endpoint);

impl Callback for RequestCheck {
    fn on_request(
        self,
        request: &Request,
        mut response: Response,
    ) -> Result<Response, ErrorResponse> {
        let Self(endpoint) = self;
        if request.uri().path() != endpoint.path {
            let problem = format!("the stream is at {}", endpoint.path);
            return Err(refusal(StatusCode::NOT_FOUND, problem));
        }
        let offered = request
            .headers()
            .get_all(header::SEC_WEBSOCKET_PROTOCOL)
            .into_iter()
            .filter_map(|value| value.to_str().ok())
            .flat_map(|value| value.split(','))
            .any(|name| name.trim() == endpoint.subprotocol);
        if !offered {
            let problem = format!("only subprotocol {} is spoken", endpoint.subprotocol);
            return Err(refusal(StatusCode::BAD_REQUEST, problem));
        }
        response.headers_mut().insert(
            header::SEC_WEBSOCKET_PROTOCOL,
            HeaderValue::from_static(endpoint.subprotocol),
        );
        Ok(response)
    }
}

fn refusal(status: StatusCode, problem: String) -> ErrorResponse {
    let mut refusal = ErrorResponse::new(Some(problem));
    *refusal.status_mut() = status;
    refusal
}

/// One side of an open WebSocket.
#[derive(Debug)]
pub struct WebSocketConnection {
    socket: WebSocket<TcpStream>,
    device: String,
    ended: bool,
}

impl WebSocketConnection {
    /// Connects to `ws://address` and the endpoint's path.
    pub fn connect(address: SocketAddr, endpoint: Endpoint) -> Result<Self, Error> {
        let device = format!("ws://{address}{}", endpoint.path);
        let refused = |cause| Error::Open {
            device: device.clone(),
            action: "open the WebSocket",
            cause,
        };
        let stream = TcpStream::connect_timeout(&address, HANDSHAKE_TIMEOUT).map_err(refused)?;
        prepare(&stream).map_err(refused)?;
        let uri: Uri = device
            .parse()
            .map_err(|e| refused(io::Error::new(io::ErrorKind::InvalidInput, e)))?;
        let request = ClientRequestBuilder::new(uri).with_sub_protocol(endpoint.subprotocol);
        let (socket, _) =
            tungstenite::client::client_with_config(request, stream, Some(endpoint.limits()))
                .map_err(|e| refused(handshake_failed(e)))?;
        Self::new(socket, device)
    }

    fn new(socket: WebSocket<TcpStream>, device: String) -> Result<Self, Error> {
        // From here on a slow reader may block the writer for as long as it likes.
        match socket.get_ref().set_write_timeout(None) {
            Ok(()) => Ok(Self {
                socket,
                device,
                ended: false,
            }),
            Err(cause) => Err(Error::Lost { device, cause }),
        }
    }

    /// The other side, for messages.
    pub fn device(&self) -> &str {
        &self.device
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
        readable(self.socket.get_ref(), Duration::ZERO).unwrap_or(true)
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
            if let Err(cause) = self.socket.get_ref().set_read_timeout(Some(left)) {
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
                            "a text message of {} bytes; only binary is spoken",
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
    stream.set_nonblocking(false)?;
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
