//! As much HTTP/1.1 as a sensor's web page needs: one request per connection, on both sides of it. Heads are parsed by `httparse`, as
//! those of the operator's screen are; framing and limits are here.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use super::poll::readable;
use crate::{Error, WireError};

/// Longest head of a message: start line and header fields.
const MAX_HEAD_LEN: usize = 16 << 10;
/// Most header fields.
const MAX_HEADERS: usize = 64;
/// Longest body.
const MAX_BODY_LEN: usize = 1 << 20;
const CHUNK_BYTES: usize = 4096;

/// What is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// A document.
    Get,
    /// A change.
    Post,
}

impl Method {
    fn name(self) -> &'static str {
        match self {
            Self::Get => "GET",
            Self::Post => "POST",
        }
    }
}

/// A request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HttpRequest {
    /// What is asked for.
    pub method: Method,
    /// Path, from its first slash on.
    pub path: String,
    /// Form fields; empty for a [`Method::Get`].
    pub body: Vec<u8>,
}

/// An answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HttpResponse {
    /// Status code: 200 and its like mean that it worked.
    pub status: u16,
    /// The document.
    pub body: Vec<u8>,
}

/// Whether more bytes can come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    /// The other side may still be sending.
    Open,
    /// It has closed.
    Closed,
}

impl HttpRequest {
    /// The bytes of the request to `host`.
    pub fn emit(&self, host: &str) -> Vec<u8> {
        let mut bytes = format!(
            "{} {} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n",
            self.method.name(),
            self.path
        );
        if self.method == Method::Post {
            bytes.push_str("Content-Type: application/x-www-form-urlencoded\r\n");
            bytes.push_str(&format!("Content-Length: {}\r\n", self.body.len()));
        }
        bytes.push_str("\r\n");
        [bytes.as_bytes(), &self.body].concat()
    }

    /// Reads a request. `None`: its end is not there yet.
    pub fn parse(bytes: &[u8]) -> Result<Option<Self>, WireError> {
        let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
        let mut request = httparse::Request::new(&mut headers);
        let Some(len) = whole_head(request.parse(bytes), bytes)? else {
            return Ok(None);
        };
        let method = match request.method {
            Some("GET") => Method::Get,
            Some("POST") => Method::Post,
            _ => return Err(bad("method", 0, bytes.first())),
        };
        let path = request.path.filter(|path| path.starts_with('/'));
        let path = path.ok_or(bad("path", 0, bytes.first()))?.to_owned();
        let head = Head::of(request.headers, len)?;
        let body = bytes.get(head.len..).unwrap_or_default();
        let len = head.content_len.unwrap_or(0);
        Ok(body.get(..len).map(|body| Self {
            method,
            path,
            body: body.to_vec(),
        }))
    }
}

impl HttpResponse {
    /// The bytes of the answer.
    pub fn emit(&self) -> Vec<u8> {
        let head = format!(
            "HTTP/1.1 {} {}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
            self.status,
            if self.status < 400 { "OK" } else { "Refused" },
            self.body.len()
        );
        [head.as_bytes(), &self.body].concat()
    }

    /// Reads an answer. `None`: its end is not there yet. Without a length, the body ends where the stream does.
    pub fn parse(bytes: &[u8], stream: Stream) -> Result<Option<Self>, WireError> {
        let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
        let mut response = httparse::Response::new(&mut headers);
        // A sensor's page is read whatever else stands in its head.
        let mut parser = httparse::ParserConfig::default();
        parser
            .ignore_invalid_headers_in_responses(true)
            .allow_spaces_after_header_name_in_responses(true);
        let Some(len) = whole_head(parser.parse_response(&mut response, bytes), bytes)? else {
            return cut_off(bytes, stream);
        };
        let status = response.code.filter(|code| (100..600).contains(code));
        let status = status.ok_or(bad("status line", 0, bytes.first()))?;
        let head = Head::of(response.headers, len)?;
        let rest = bytes.get(head.len..).unwrap_or_default();
        let body = match (status, head.content_len) {
            (100..200 | 204 | 304, _) => Some(Vec::new()),
            _ if head.is_chunked => unchunk(rest, head.len)?,
            (_, Some(len)) => rest.get(..len).map(<[u8]>::to_vec),
            (_, None) if stream == Stream::Open => None,
            (_, None) => Some(rest.to_vec()),
        };
        match body {
            Some(body) => Ok(Some(Self { status, body })),
            None => cut_off(bytes, stream),
        }
    }
}

/// Nothing to read yet; or, where no more comes, an error.
fn cut_off<T>(bytes: &[u8], stream: Stream) -> Result<Option<T>, WireError> {
    match stream {
        Stream::Open if bytes.len() <= MAX_HEAD_LEN + MAX_BODY_LEN => Ok(None),
        Stream::Open | Stream::Closed => Err(WireError::Length {
            expected: bytes.len() + 1,
            got: bytes.len(),
        }),
    }
}

/// Length of a head that has been parsed. `None`: its end is not there yet.
fn whole_head(
    parsed: Result<httparse::Status<usize>, httparse::Error>,
    bytes: &[u8],
) -> Result<Option<usize>, WireError> {
    let len = match parsed {
        Ok(httparse::Status::Complete(len)) => Some(len),
        Ok(httparse::Status::Partial) => None,
        Err(_) => return Err(bad("head", 0, bytes.first())),
    };
    if len.unwrap_or(bytes.len()) >= MAX_HEAD_LEN {
        return Err(WireError::Length {
            expected: MAX_HEAD_LEN,
            got: bytes.len(),
        });
    }
    Ok(len)
}

/// What a head says about its body, and where that begins.
struct Head {
    content_len: Option<usize>,
    is_chunked: bool,
    /// Bytes up to the body.
    len: usize,
}

impl Head {
    fn of(headers: &[httparse::Header<'_>], len: usize) -> Result<Self, WireError> {
        let mut head = Self {
            content_len: None,
            is_chunked: false,
            len,
        };
        for header in headers {
            let value = std::str::from_utf8(header.value).map(str::trim);
            if header.name.eq_ignore_ascii_case("content-length") {
                let len = value.ok().and_then(|value| value.parse().ok());
                let len = len.filter(|&len| len <= MAX_BODY_LEN);
                head.content_len = Some(len.ok_or(bad("content length", 0, None))?);
            } else if header.name.eq_ignore_ascii_case("transfer-encoding") {
                head.is_chunked = value.is_ok_and(|value| value.eq_ignore_ascii_case("chunked"));
            }
        }
        Ok(head)
    }
}

/// A body in chunks, each behind its length in hexadecimal. `None`: its end is not there yet.
fn unchunk(mut rest: &[u8], offset: usize) -> Result<Option<Vec<u8>>, WireError> {
    let mut body = Vec::new();
    loop {
        let Some(end) = rest.windows(2).position(|window| window == b"\r\n") else {
            return Ok(None);
        };
        let (line, after) = rest.split_at(end);
        let line = line.split(|&b| b == b';').next().unwrap_or_default();
        let len = std::str::from_utf8(line)
            .ok()
            .and_then(|line| usize::from_str_radix(line.trim(), 16).ok())
            .filter(|len| body.len() + len <= MAX_BODY_LEN);
        let len = len.ok_or(bad("chunk length", offset, rest.first()))?;
        let Some(chunk) = after.get(2..2 + len) else {
            return Ok(None);
        };
        if len == 0 {
            return Ok(Some(body));
        }
        body.extend_from_slice(chunk);
        match after.get(2 + len..4 + len) {
            Some(b"\r\n") => rest = after.get(4 + len..).unwrap_or_default(),
            Some(other) => return Err(bad("end of chunk", offset, other.first())),
            None => return Ok(None),
        }
    }
}

fn bad(field: &'static str, offset: usize, byte: Option<&u8>) -> WireError {
    WireError::Value {
        field,
        offset,
        got: byte.copied().unwrap_or_default().into(),
    }
}

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
    listener: TcpListener,
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_random::Random;

    fn whole(text: &[u8]) -> HttpResponse {
        HttpResponse::parse(text, Stream::Open).unwrap().unwrap()
    }

    #[test]
    fn answers_of_every_framing_are_read() {
        let by_length = b"HTTP/1.0 200 OK\r\ncontent-length: 3\r\n\r\nabcdef";
        assert_eq!(whole(by_length).body, b"abc");
        let chunked = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: Chunked\r\n\r\n3;x=y\r\nabc\r\nA\r\n0123456789\r\n0\r\n\r\n";
        assert_eq!(whole(chunked).body, b"abc0123456789");
        let empty = b"HTTP/1.1 204 No Content\r\nServer: x\r\n\r\n";
        assert_eq!((whole(empty).status, whole(empty).body.len()), (204, 0));
        let by_close = b"HTTP/1.1 404 Not Found\r\n\r\nnothing here";
        assert_eq!(HttpResponse::parse(by_close, Stream::Open), Ok(None));
        let closed = HttpResponse::parse(by_close, Stream::Closed)
            .unwrap()
            .unwrap();
        assert_eq!(
            (closed.status, &closed.body[..]),
            (404, &b"nothing here"[..])
        );
        for text in [&by_length[..], chunked, empty] {
            for end in 0..text.len() - 10 {
                let part = HttpResponse::parse(&text[..end], Stream::Open);
                assert!(matches!(part, Ok(None | Some(_))), "{end}: {part:?}");
            }
        }
        assert!(HttpResponse::parse(&by_length[..40], Stream::Closed).is_err());
        let response = HttpResponse {
            status: 200,
            body: b"{}".to_vec(),
        };
        assert_eq!(whole(&response.emit()), response);
    }

    #[test]
    fn requests_are_written_and_read() {
        for request in [
            HttpRequest {
                method: Method::Get,
                path: "/cgi/settings.json".to_owned(),
                body: Vec::new(),
            },
            HttpRequest {
                method: Method::Post,
                path: "/cgi/setting".to_owned(),
                body: b"rpm=600".to_vec(),
            },
        ] {
            let bytes = request.emit("192.168.1.201");
            assert_eq!(HttpRequest::parse(&bytes), Ok(Some(request)));
            assert_eq!(HttpRequest::parse(&bytes[..bytes.len() - 1]), Ok(None));
        }
        for text in [
            "PUT / HTTP/1.1\r\n\r\n",
            "GET x HTTP/1.1\r\n\r\n",
            "GET\r\n\r\n",
        ] {
            assert!(HttpRequest::parse(text.as_bytes()).is_err(), "{text}");
        }
    }

    #[test]
    fn sizes_are_bounded_and_nonsense_is_an_error() {
        for text in [
            "HTTP/1.1 999 X\r\n\r\n",
            "HTTP/2 200 OK\r\n\r\n",
            "ICY 200 OK\r\n\r\n",
            "HTTP/1.1 200 OK\r\nContent-Length: 99999999999\r\n\r\n",
            "HTTP/1.1 200 OK\r\nContent-Length: -1\r\n\r\n",
            "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nFFFFFFFFFFFFFFFF\r\n",
            "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n1\r\nabc\r\n",
        ] {
            let outcome = HttpResponse::parse(text.as_bytes(), Stream::Open);
            assert!(outcome.is_err(), "{text}: {outcome:?}");
        }
        let endless = vec![b'x'; MAX_HEAD_LEN];
        let unfinished = [b"HTTP/1.1 200 OK\r\nServer: ", &endless[..]].concat();
        for head in [endless, unfinished] {
            assert!(HttpResponse::parse(&head, Stream::Open).is_err());
        }
        // What belongs in no head does not keep a sensor's answer from being read.
        let odd = b"HTTP/1.1 200 OK\r\nno field\r\nServer : x\r\nContent-Length : 1\r\n\r\ny";
        assert_eq!(whole(odd).body, b"y");
        let mut random = Random::new(4);
        for _ in 0..20_000 {
            let mut bytes = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\nContent-Length: 2\r\n\r\n3\r\nabc\r\n0\r\n\r\n".to_vec();
            random.mutate(&mut bytes);
            let _ = HttpResponse::parse(&bytes, Stream::Open);
            let _ = HttpResponse::parse(&bytes, Stream::Closed);
            let _ = HttpRequest::parse(&bytes);
        }
    }

    #[test]
    fn a_server_that_is_absent_silent_or_hangs_up_is_an_error() {
        let listener = HttpListener::bind(([127, 0, 0, 1], 0).into()).unwrap();
        let address = listener.address();
        let request = HttpRequest {
            method: Method::Get,
            path: "/".to_owned(),
            body: Vec::new(),
        };
        let silent = exchange(address, &request, Duration::from_millis(50));
        assert!(matches!(silent, Err(Error::Lost { .. })), "{silent:?}");
        let hang_up = std::thread::Builder::new()
            .name("hang-up".to_owned())
            .spawn(move || {
                listener
                    .listener
                    .accept()
                    .map(drop)
                    .and(listener.listener.accept())
                    .map(drop)
            })
            .unwrap();
        let cut = exchange(address, &request, Duration::from_secs(5)).unwrap_err();
        assert!(
            matches!(
                cut,
                Error::Protocol { .. } | Error::Lost { .. } | Error::Send { .. }
            ),
            "{cut}"
        );
        hang_up.join().unwrap().unwrap();
        let absent = exchange(address, &request, Duration::from_secs(1)).unwrap_err();
        assert!(matches!(absent, Error::Open { .. }), "{absent}");
    }
}
