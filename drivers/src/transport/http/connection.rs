//! One request and its answer over a connection, on both sides of it.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use super::super::poll::readable;
use super::{HttpRequest, HttpResponse, Stream};
use crate::{Error, WireError};

/// Read at once.
const CHUNK_BYTES: usize = 4096;

/// Asks the server at `address`, and waits for the whole answer.
pub fn exchange(
    address: SocketAddr,
    request: &HttpRequest,
    timeout: Duration,
) -> Result<HttpResponse, Error> {
    let device = || format!("http {address}");
    let deadline = Instant::now() + timeout;
    let mut stream =
        TcpStream::connect_timeout(&address, timeout).map_err(|cause| Error::Open {
            device: device(),
            action: "connect",
            cause,
        })?;
    let sent = stream
        .set_write_timeout(Some(timeout))
        .and_then(|()| stream.write_all(&request.emit(&address.to_string())));
    sent.map_err(|cause| Error::Send {
        device: device(),
        cause,
    })?;
    let lost = |cause| Error::Lost {
        device: device(),
        cause,
    };
    let protocol = |error: WireError| Error::Protocol {
        device: device(),
        problem: format!(
            "answer to {} {}: {error}",
            request.method.name(),
            request.path
        ),
    };
    let mut bytes = Vec::new();
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        if !readable(&stream, left).map_err(lost)? {
            return Err(lost(io::ErrorKind::TimedOut.into()));
        }
        let mut chunk = [0; CHUNK_BYTES];
        let len = stream.read(&mut chunk).map_err(lost)?;
        bytes.extend_from_slice(&chunk[..len]);
        let state = if len == 0 {
            Stream::Closed
        } else {
            Stream::Open
        };
        if let Some(response) = HttpResponse::parse(&bytes, state).map_err(protocol)? {
            return Ok(response);
        }
    }
}

/// The server's side, for mocks: answers one request after the other.
#[derive(Debug)]
pub struct HttpListener {
    pub(super) listener: TcpListener,
    address: SocketAddr,
}

impl HttpListener {
    /// Listens at `address`; port 0 takes a free one.
    pub fn bind(address: SocketAddr) -> Result<Self, Error> {
        let failed = |action| {
            move |cause| Error::Open {
                device: format!("http {address}"),
                action,
                cause,
            }
        };
        let listener = TcpListener::bind(address).map_err(failed("bind"))?;
        let address = listener
            .local_addr()
            .map_err(failed("read the bound address"))?;
        Ok(Self { listener, address })
    }

    /// The address that was bound.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers at most one request with what `handle` makes of it; `false` where none came within `timeout`, or its host
    /// went away or did not speak HTTP.
    pub fn serve(
        &self,
        timeout: Duration,
        handle: impl FnOnce(&HttpRequest) -> HttpResponse,
    ) -> Result<bool, Error> {
        let lost = |cause| Error::Lost {
            device: format!("http {}", self.address),
            cause,
        };
        if !readable(&self.listener, timeout).map_err(lost)? {
            return Ok(false);
        }
        let (stream, _) = self.listener.accept().map_err(lost)?;
        Ok(answer(stream, timeout.max(Duration::from_secs(1)), handle).is_ok())
    }
}

fn answer(
    mut stream: TcpStream,
    timeout: Duration,
    handle: impl FnOnce(&HttpRequest) -> HttpResponse,
) -> io::Result<()> {
    stream.set_read_timeout(Some(timeout))?;
    stream.set_write_timeout(Some(timeout))?;
    let mut bytes = Vec::new();
    let request = loop {
        match HttpRequest::parse(&bytes) {
            Ok(Some(request)) => break request,
            Ok(None) => {}
            Err(error) => return Err(io::Error::other(error)),
        }
        let mut chunk = [0; CHUNK_BYTES];
        match stream.read(&mut chunk)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            len => bytes.extend_from_slice(&chunk[..len]),
        }
    };
    stream.write_all(&handle(&request).emit())
}
