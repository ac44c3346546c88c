//! Answers to HTTP requests.

use http_body_util::Full;
use hyper::body::Bytes;
use hyper::header::{
    CACHE_CONTROL, CONNECTION, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderValue, REFERRER_POLICY,
    X_CONTENT_TYPE_OPTIONS,
};
use hyper::{Response, StatusCode};

/// An answer with a body.
pub type Answer = Response<Full<Bytes>>;

/// A few words.
pub fn said(status: StatusCode, words: &'static str) -> Answer {
    with_body(status, "text/plain", Bytes::from_static(words.as_bytes()))
}

/// A sentence that depends on what was asked.
pub fn said_aloud(status: StatusCode, words: String) -> Answer {
    with_body(status, "text/plain", Bytes::from(words))
}

/// A file.
pub fn file_of(status: StatusCode, media_type: &'static str, body: impl Into<Bytes>) -> Answer {
    with_body(status, media_type, body.into())
}

/// Some JSON, as text.
pub fn json_of(status: StatusCode, text: String) -> Answer {
    with_body(status, "application/json", Bytes::from(text))
}

/// The answer for a page that may do what `policy` says (a `Content-Security-Policy`). It is kept nowhere, ends its connection (a browser
/// would keep it, and count as somebody who never said who it is), and no other site is told where a reader came from; forms need
/// their own site to be told.
pub fn under(policy: &'static str, mut answer: Answer) -> Answer {
    let headers = answer.headers_mut();
    for (name, value) in [
        (CONTENT_SECURITY_POLICY, policy),
        (CACHE_CONTROL, "no-store"),
        (CONNECTION, "close"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    answer
}

fn with_body(status: StatusCode, media_type: &'static str, body: Bytes) -> Answer {
    let mut answer = Response::new(Full::new(body));
    *answer.status_mut() = status;
    answer
        .headers_mut()
        .insert(CONTENT_TYPE, HeaderValue::from_static(media_type));
    answer
}
