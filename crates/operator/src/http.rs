//! Just enough HTTP/1.1: one GET per connection, answered with a small file or turned into a WebSocket; where forms are taken, one POST.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use tungstenite::WebSocket;
use tungstenite::handshake::derive_accept_key;
use tungstenite::protocol::{Role, WebSocketConfig};

/// Longest request head.
const MAX_HEAD_BYTES: usize = 8 << 10;
/// Most headers of a request; browsers send about twenty.
const MAX_HEADERS: usize = 64;
/// How long a request may take to arrive.
const HEAD_TIMEOUT: Duration = Duration::from_secs(5);
/// How long a client may take to make room before it is given up.
const WRITE_TIMEOUT: Duration = Duration::from_secs(5);
/// How long a WebSocket waits for its client before it looks whether there is something to send.
const READ_TIMEOUT: Duration = Duration::from_millis(25);
/// Longest message of a client: a note.
const MAX_MESSAGE_BYTES: usize = 64 << 10;
/// Nothing but what is served here may be loaded or asked.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
     manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// What a request asks for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Request {
    /// Its path, without what follows a question mark.
    pub path: String,
    /// Name and port that the client believes to talk to.
    pub host: Option<String>,
    /// The site whose script asks; absent where a person or a program does.
    pub origin: Option<String>,
    /// Key of a WebSocket's opening handshake.
    pub websocket_key: Option<String>,
    /// Subprotocols on offer.
    pub protocols: Vec<String>,
    /// Whether it brings something: a POST.
    pub is_post: bool,
    /// What it brings.
    pub content_type: Option<String>,
    /// How many bytes it brings; absent where it does not say, or says it in chunks.
    pub content_length: Option<usize>,
    /// What has arrived behind the head.
    pub rest: Vec<u8>,
}

impl Request {
    /// Whether it comes from a page that was served here, or from no page at all. A script of any other site that the
    /// operator's browser happens to show must not start or stop a recording.
    pub fn is_ours(&self) -> bool {
        let Some(origin) = &self.origin else {
            return true;
        };
        let site = origin.strip_prefix("http://");
        site.is_some() && site == self.host.as_deref()
    }
}

/// Which requests are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Taken {
    Get,
    GetAndPost,
}

/// Reads one GET. An error has been answered where an answer is due.
pub fn read(stream: &mut TcpStream) -> io::Result<Request> {
    read_head(stream, Taken::Get)
}

/// Reads one GET, or the head of a POST, the same way.
pub fn read_form(stream: &mut TcpStream) -> io::Result<Request> {
    read_head(stream, Taken::GetAndPost)
}

fn read_head(stream: &mut TcpStream, taken: Taken) -> io::Result<Request> {
    stream.set_nonblocking(false)?;
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
    let deadline = Instant::now() + HEAD_TIMEOUT;
    let mut bytes = Vec::new();
    let mut part = [0; 2048];
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        let got = stream.read(&mut part)?;
        if got == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        bytes.extend_from_slice(part.get(..got).unwrap_or_default());
        match parse(&bytes, taken) {
            Ok(Some(request)) => return Ok(request),
            Ok(None) if bytes.len() <= MAX_HEAD_BYTES => {}
            Ok(None) => {
                answer(stream, Status::TooLong, "text/plain", b"request too long")?;
                return Err(io::ErrorKind::InvalidData.into());
            }
            Err(status) => {
                answer(
                    stream,
                    status,
                    "text/plain",
                    b"no request that is taken here",
                )?;
                return Err(io::ErrorKind::InvalidData.into());
            }
        }
    }
}

/// A request out of the bytes so far; `None`: more are needed.
fn parse(bytes: &[u8], taken: Taken) -> Result<Option<Request>, Status> {
    let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
    let mut head = httparse::Request::new(&mut headers);
    let length = match head.parse(bytes) {
        Ok(httparse::Status::Complete(length)) => length,
        Ok(httparse::Status::Partial) => return Ok(None),
        Err(_) => return Err(Status::BadRequest),
    };
    let is_post = match (head.method, taken) {
        (Some("GET"), _) => false,
        (Some("POST"), Taken::GetAndPost) => true,
        _ => return Err(Status::NotAllowed),
    };
    let mut request = Request {
        path: head
            .path
            .and_then(|path| path.split(['?', '#']).next())
            .unwrap_or("/")
            .to_owned(),
        rest: bytes.get(length..).unwrap_or_default().to_vec(),
        is_post,
        ..Request::default()
    };
    let (mut wants_websocket, mut is_chunked) = (false, false);
    let mut key = None;
    for header in head.headers.iter() {
        let Ok(value) = std::str::from_utf8(header.value) else {
            continue;
        };
        let is = |name: &str| header.name.eq_ignore_ascii_case(name);
        if is("host") {
            request.host = Some(value.to_owned());
        } else if is("origin") {
            request.origin = Some(value.to_owned());
        } else if is("upgrade") {
            wants_websocket = value.eq_ignore_ascii_case("websocket");
        } else if is("sec-websocket-key") {
            key = Some(value.to_owned());
        } else if is("sec-websocket-protocol") {
            let names = value.split(',').map(|name| name.trim().to_owned());
            request.protocols.extend(names);
        } else if is("content-type") {
            request.content_type = Some(value.to_owned());
        } else if is("transfer-encoding") {
            is_chunked = true;
        } else if is("content-length") {
            // Whoever says two lengths wants one of two readers to be wrong.
            let said: usize = value.trim().parse().map_err(|_| Status::BadRequest)?;
            if request.content_length.replace(said).is_some() {
                return Err(Status::BadRequest);
            }
        }
    }
    request.content_length = request.content_length.filter(|_| !is_chunked);
    request.websocket_key = key.filter(|_| wants_websocket);
    Ok(Some(request))
}

/// How a request is answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    Ok,
    BadRequest,
    Forbidden,
    NotFound,
    NotAllowed,
    Timeout,
    LengthRequired,
    TooLarge,
    Misdirected,
    Unprocessable,
    TooMany,
    TooLong,
    Unavailable,
}

impl Status {
    fn line(self) -> &'static str {
        match self {
            Self::Ok => "200 OK",
            Self::BadRequest => "400 Bad Request",
            Self::Forbidden => "403 Forbidden",
            Self::NotFound => "404 Not Found",
            Self::NotAllowed => "405 Method Not Allowed",
            Self::Timeout => "408 Request Timeout",
            Self::LengthRequired => "411 Length Required",
            Self::TooLarge => "413 Content Too Large",
            Self::Misdirected => "421 Misdirected Request",
            Self::Unprocessable => "422 Unprocessable Content",
            Self::TooMany => "429 Too Many Requests",
            Self::TooLong => "431 Request Header Fields Too Large",
            Self::Unavailable => "503 Service Unavailable",
        }
    }
}

/// Answers and ends the conversation. No other site is told where a reader came from; forms need their own site to be told.
pub fn answer(
    stream: &mut TcpStream,
    status: Status,
    media_type: &str,
    body: &[u8],
) -> io::Result<()> {
    answer_under(POLICY, stream, status, media_type, body)
}

/// The same, where the page may do what `policy` says (a `Content-Security-Policy`).
pub fn answer_under(
    policy: &str,
    stream: &mut TcpStream,
    status: Status,
    media_type: &str,
    body: &[u8],
) -> io::Result<()> {
    let head = format!(
        "HTTP/1.1 {}\r\nContent-Type: {media_type}\r\nContent-Length: {}\r\nConnection: close\r\nCache-Control: no-store\r\n\
         Content-Security-Policy: {policy}\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: same-origin\r\n\r\n",
        status.line(),
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body)?;
    stream.flush()
}

/// Turns the connection into a WebSocket that speaks `protocol`, where one was offered.
pub fn upgrade(
    mut stream: TcpStream,
    request: Request,
    protocol: Option<&str>,
) -> io::Result<WebSocket<TcpStream>> {
    let Some(key) = &request.websocket_key else {
        answer(
            &mut stream,
            Status::BadRequest,
            "text/plain",
            b"not a WebSocket",
        )?;
        return Err(io::ErrorKind::InvalidData.into());
    };
    let mut head = format!(
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: {}\r\n",
        derive_accept_key(key.as_bytes())
    );
    if let Some(protocol) = protocol {
        head += &format!("Sec-WebSocket-Protocol: {protocol}\r\n");
    }
    stream.write_all(head.as_bytes())?;
    stream.write_all(b"\r\n")?;
    stream.flush()?;
    stream.set_read_timeout(Some(READ_TIMEOUT))?;
    let limits = WebSocketConfig::default()
        .max_message_size(Some(MAX_MESSAGE_BYTES))
        .max_frame_size(Some(MAX_MESSAGE_BYTES));
    Ok(WebSocket::from_partially_read(
        stream,
        request.rest,
        Role::Server,
        Some(limits),
    ))
}

/// Whether an error only says that nothing has arrived yet.
pub fn is_quiet(error: &tungstenite::Error) -> bool {
    matches!(
        error,
        tungstenite::Error::Io(e)
            if matches!(
                e.kind(),
                io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
            )
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read_whatever_arrives() {
        let text = b"GET /ws?x=1 HTTP/1.1\r\nHost: rig:8080\r\nUpgrade: WebSocket\r\nOrigin: http://rig:8080\r\n\
            Sec-WebSocket-Key: abc\r\nSec-WebSocket-Protocol: a, b\r\n\r\nmore";
        let get = |bytes: &[u8]| parse(bytes, Taken::Get);
        let request = get(text).unwrap().unwrap();
        assert_eq!(request.path, "/ws");
        assert_eq!(request.websocket_key.as_deref(), Some("abc"));
        assert_eq!(request.protocols, ["a", "b"]);
        assert_eq!(request.rest, b"more");
        assert!(request.is_ours());
        let head = text.len() - 4;
        for length in 0..head {
            assert_eq!(get(&text[..length]), Ok(None), "{length}");
        }
        assert_eq!(get(b"POST / HTTP/1.1\r\n\r\n"), Err(Status::NotAllowed));
        assert_eq!(get(b"\x00\xff\r\n\r\n"), Err(Status::BadRequest));
        let form = |headers: &str| {
            let text = format!("POST / HTTP/1.1\r\n{headers}\r\n\r\n");
            parse(text.as_bytes(), Taken::GetAndPost).map(|r| r.and_then(|r| r.content_length))
        };
        assert_eq!(form("Content-Length: 12"), Ok(Some(12)));
        assert_eq!(
            form("Content-Length: 12\r\nTransfer-Encoding: chunked"),
            Ok(None)
        );
        for lengths in [
            "Content-Length: 1\r\ncontent-length: 1",
            "Content-Length: -1",
            "Content-Length: 99999999999999999999",
        ] {
            assert_eq!(form(lengths), Err(Status::BadRequest), "{lengths}");
        }
    }

    #[test]
    fn scripts_of_other_sites_are_strangers() {
        let from = |origin: Option<&str>| Request {
            host: Some("127.0.0.1:8080".to_owned()),
            origin: origin.map(str::to_owned),
            ..Request::default()
        };
        assert!(from(None).is_ours());
        assert!(from(Some("http://127.0.0.1:8080")).is_ours());
        for stranger in ["http://evil.example", "https://127.0.0.1:8080", "null", ""] {
            assert!(!from(Some(stranger)).is_ours(), "{stranger}");
        }
    }
}
