//! Answers to HTTP requests.

use http_body_util::Full;
use hyper::body::Bytes;
use hyper::header::{CONTENT_TYPE, HeaderValue};
use hyper::{Response, StatusCode};

/// An answer with a body.
pub(super) type Answer = Response<Full<Bytes>>;

/// A few words.
pub(super) fn said(status: StatusCode, words: &'static str) -> Answer {
    with_body(status, "text/plain", Bytes::from_static(words.as_bytes()))
}

/// A sentence that depends on what was asked.
pub(super) fn said_aloud(status: StatusCode, words: String) -> Answer {
    with_body(status, "text/plain", Bytes::from(words))
}

/// A file that is part of the program.
pub(super) fn file_of(status: StatusCode, media_type: &'static str, body: &'static str) -> Answer {
    with_body(status, media_type, Bytes::from_static(body.as_bytes()))
}

/// Some JSON.
pub(super) fn json_of(status: StatusCode, value: &serde_json::Value) -> Answer {
    with_body(status, "application/json", Bytes::from(value.to_string()))
}

fn with_body(status: StatusCode, media_type: &'static str, body: Bytes) -> Answer {
    let mut answer = Response::new(Full::new(body));
    *answer.status_mut() = status;
    answer
        .headers_mut()
        .insert(CONTENT_TYPE, HeaderValue::from_static(media_type));
    answer
}
