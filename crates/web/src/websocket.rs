//! Requests that become WebSockets.

use hyper::body::Incoming;
use hyper::header::{
    CONNECTION, CONTENT_TYPE, HeaderValue, SEC_WEBSOCKET_ACCEPT, SEC_WEBSOCKET_KEY,
    SEC_WEBSOCKET_PROTOCOL, UPGRADE,
};
use hyper::upgrade::Upgraded;
use hyper::{Request, StatusCode};
use hyper_util::rt::TokioIo;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};

use crate::answers::{Answer, said};

/// A WebSocket of this server.
pub type Socket = WebSocketStream<TokioIo<Upgraded>>;

/// The first of these subprotocols that the other side offers.
pub fn offered(request: &Request<Incoming>, known: &[&'static str]) -> Option<&'static str> {
    let headers = request.headers().get_all(SEC_WEBSOCKET_PROTOCOL);
    let names: Vec<&str> = headers
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(',').map(str::trim))
        .collect();
    known.iter().copied().find(|known| names.contains(known))
}

/// Turns the connection into a WebSocket that speaks `protocol`, with messages of so many bytes at most, and has `serve` talk on it; the answer says
/// so, or that this was no WebSocket.
pub fn upgrade<F>(
    mut request: Request<Incoming>,
    protocol: Option<&'static str>,
    max_message_bytes: usize,
    serve: impl FnOnce(Socket) -> F + Send + 'static,
) -> Answer
where
    F: Future<Output = ()> + Send + 'static,
{
    let headers = request.headers();
    let wants = headers
        .get(UPGRADE)
        .is_some_and(|value| value.as_bytes().eq_ignore_ascii_case(b"websocket"));
    let key = headers.get(SEC_WEBSOCKET_KEY).filter(|_| wants);
    let accepted = key.map(|key| derive_accept_key(key.as_bytes()));
    let Some(accepted) = accepted.and_then(|key| HeaderValue::from_str(&key).ok()) else {
        return said(StatusCode::BAD_REQUEST, "this is a WebSocket");
    };
    let upgraded = hyper::upgrade::on(&mut request);
    tokio::spawn(async move {
        let limits = WebSocketConfig::default()
            .max_message_size(Some(max_message_bytes))
            .max_frame_size(Some(max_message_bytes));
        // An error: it has gone meanwhile.
        if let Ok(upgraded) = upgraded.await {
            let io = TokioIo::new(upgraded);
            serve(WebSocketStream::from_raw_socket(io, Role::Server, Some(limits)).await).await;
        }
    });
    let mut answer = said(StatusCode::SWITCHING_PROTOCOLS, "");
    let headers = answer.headers_mut();
    headers.remove(CONTENT_TYPE);
    headers.insert(UPGRADE, HeaderValue::from_static("websocket"));
    headers.insert(CONNECTION, HeaderValue::from_static("Upgrade"));
    headers.insert(SEC_WEBSOCKET_ACCEPT, accepted);
    if let Some(protocol) = protocol {
        headers.insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(protocol));
    }
    answer
}
