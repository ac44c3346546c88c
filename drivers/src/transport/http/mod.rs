//! As much HTTP/1.1 as a sensor's web page needs: one request per connection, on both sides of it. Heads are parsed by `httparse`, as
//! those of the operator's screen are; framing and limits are here.

mod connection;

use crate::WireError;

pub use connection::{HttpListener, exchange};

/// Longest head of a message: start line and header fields.
const MAX_HEAD_LEN: usize = 16 << 10;
/// Most header fields.
const MAX_HEADERS: usize = 64;
/// Longest body.
const MAX_BODY_LEN: usize = 1 << 20;

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

#[cfg(test)]
mod tests;
