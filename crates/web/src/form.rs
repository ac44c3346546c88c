//! What a browser's form sends: a POST whose body is `multipart/form-data` (RFC 7578). Hostile until parsed: sizes and numbers are
//! limited, names of files are not looked at, and whatever is not as the standard says is refused.

use std::time::Duration;

use http_body_util::{BodyExt as _, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::CONTENT_LENGTH;
use hyper::{Request, StatusCode};
use tokio::time::{Instant, timeout, timeout_at};

/// Fields of a form at most.
const MAX_FIELDS: usize = 16;
/// Longest head of a field.
const MAX_HEAD_BYTES: usize = 4 << 10;
/// Longest boundary (RFC 2046, 5.1.1).
const MAX_BOUNDARY_BYTES: usize = 70;
/// What is still taken of a body that was refused, so that its sender gets to read why.
const MAX_REFUSED_BYTES: usize = 4 << 20;
/// And for how long.
const REFUSED_TIMEOUT: Duration = Duration::from_secs(2);

/// One field of a form.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name in the form.
    pub name: String,
    /// What was entered, or the file's bytes.
    pub bytes: Vec<u8>,
}

/// Takes the body of a request, of no more than `most` bytes and within a time; which status says why not.
pub async fn body(
    request: Request<Incoming>,
    most: usize,
    within: Duration,
) -> Result<Bytes, StatusCode> {
    let length = request.headers().get(CONTENT_LENGTH);
    let length = length.and_then(|value| value.to_str().ok()?.parse::<usize>().ok());
    let body = request.into_body();
    let refused = match length {
        // Without a length nobody knows where it ends; chunks are no part of what is spoken here.
        None => StatusCode::LENGTH_REQUIRED,
        Some(length) if length > most => StatusCode::PAYLOAD_TOO_LARGE,
        Some(_) => {
            let taken = timeout(within, Limited::new(body, most).collect()).await;
            return match taken {
                Ok(Ok(body)) => Ok(body.to_bytes()),
                Ok(Err(_)) => Err(StatusCode::BAD_REQUEST),
                Err(_) => Err(StatusCode::REQUEST_TIMEOUT),
            };
        }
    };
    pass_over(body).await;
    Err(refused)
}

/// Takes some of what was refused: were the connection closed at once, the answer would be lost.
async fn pass_over(mut body: Incoming) {
    let (deadline, mut taken) = (Instant::now() + REFUSED_TIMEOUT, 0);
    while taken < MAX_REFUSED_BYTES {
        match timeout_at(deadline, body.frame()).await {
            Ok(Some(Ok(frame))) => taken += frame.data_ref().map_or(0, Bytes::len),
            _ => return,
        }
    }
}

/// The fields of a form; `None` where it is not one.
pub fn fields(content_type: &str, body: &[u8]) -> Option<Vec<Field>> {
    let boundary = boundary(content_type)?;
    let first = format!("--{boundary}");
    let between = format!("\r\n--{boundary}");
    let mut rest = body.strip_prefix(first.as_bytes())?;
    let mut found: Vec<Field> = Vec::new();
    loop {
        // Two dashes end the form; what follows them means nothing.
        if rest.starts_with(b"--") {
            return Some(found);
        }
        rest = rest.strip_prefix(b"\r\n")?;
        let head_end = find(rest.get(..rest.len().min(MAX_HEAD_BYTES))?, b"\r\n\r\n")?;
        let name = name(std::str::from_utf8(rest.get(..head_end)?).ok()?)?;
        let content = rest.get(head_end + 4..)?;
        let end = find(content, between.as_bytes())?;
        let is_new = found.iter().all(|field| field.name != name);
        if !is_new || found.len() == MAX_FIELDS {
            return None;
        }
        found.push(Field {
            name,
            bytes: content.get(..end)?.to_vec(),
        });
        rest = content.get(end + between.len()..)?;
    }
}

fn boundary(content_type: &str) -> Option<&str> {
    let (kind, parameters) = content_type.split_once(';')?;
    if !kind.trim().eq_ignore_ascii_case("multipart/form-data") {
        return None;
    }
    let value = parameters.split(';').find_map(|parameter| {
        let (name, value) = parameter.trim().split_once('=')?;
        name.eq_ignore_ascii_case("boundary")
            .then(|| value.trim_matches('"'))
    })?;
    let is_plain = |c: u8| c.is_ascii_alphanumeric() || b"'()+_,-./:=?".contains(&c);
    let is_boundary =
        (1..=MAX_BOUNDARY_BYTES).contains(&value.len()) && value.bytes().all(is_plain);
    is_boundary.then_some(value)
}

/// The name that a field's head gives it.
fn name(head: &str) -> Option<String> {
    let disposition = head.split("\r\n").find_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.trim()
            .eq_ignore_ascii_case("content-disposition")
            .then_some(value)
    })?;
    let mut parts = disposition.split(';');
    if !parts.next()?.trim().eq_ignore_ascii_case("form-data") {
        return None;
    }
    parts.find_map(|part| {
        let (name, value) = part.trim().split_once('=')?;
        let value = value.strip_prefix('"')?.strip_suffix('"')?;
        (name == "name").then(|| value.to_owned())
    })
}

fn find(bytes: &[u8], wanted: &[u8]) -> Option<usize> {
    bytes
        .windows(wanted.len())
        .position(|window| window == wanted)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TYPE: &str = "multipart/form-data; boundary=----x7";
    const BODY: &[u8] = b"------x7\r\nContent-Disposition: form-data; name=\"team\"\r\n\r\nwe\r\n\
        ------x7\r\ncontent-disposition: form-data; name=\"file\"; filename=\"../../etc/passwd\"\r\n\
        Content-Type: text/plain\r\n\r\n1 2\r\n3\r\n------x7--\r\n";

    #[test]
    fn a_form_is_read_and_half_of_one_is_not() {
        let found = fields(TYPE, BODY).expect("a form");
        let field = |name: &str, bytes: &[u8]| Field {
            name: name.to_owned(),
            bytes: bytes.to_vec(),
        };
        assert_eq!(found, [field("team", b"we"), field("file", b"1 2\r\n3")]);
        // The last line end may be missing, nothing else.
        for length in 0..BODY.len() - 2 {
            assert_eq!(fields(TYPE, &BODY[..length]), None, "{length}");
        }
    }

    #[test]
    fn what_is_no_form_is_refused() {
        for kind in [
            "",
            "multipart/form-data",
            "text/plain; boundary=----x7",
            "multipart/form-data; boundary=",
            "multipart/form-data; boundary=a\u{e9}",
        ] {
            assert_eq!(fields(kind, BODY), None, "{kind}");
        }
        let long = format!("multipart/form-data; boundary={}", "x".repeat(71));
        assert_eq!(fields(&long, BODY), None);
        let part = "--b\r\nContent-Disposition: form-data; name=\"a\"\r\n\r\n1\r\n";
        let of = |text: &str| fields("multipart/form-data; boundary=\"b\"", text.as_bytes());
        assert!(of(&format!("{part}--b--")).is_some());
        assert_eq!(of(&format!("{part}{part}--b--")), None, "twice");
        let many: String = (0..17)
            .map(|i| part.replace("\"a\"", &format!("\"{i}\"")))
            .collect();
        assert_eq!(of(&format!("{many}--b--")), None, "too many");
        let head = "x".repeat(MAX_HEAD_BYTES);
        assert_eq!(of(&format!("--b\r\nA: {head}\r\n\r\n1\r\n--b--")), None);
    }
}
