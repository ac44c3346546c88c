//! What is asked for by HTTP: the stream, segments of a recording, how far a session has got, and the page for browsers.

use std::convert::Infallible;

use hyper::body::Incoming;
use hyper::header::{
    AUTHORIZATION, CONTENT_TYPE, HeaderValue, SEC_WEBSOCKET_KEY, SEC_WEBSOCKET_PROTOCOL, UPGRADE,
};
use hyper::{Method, Request, StatusCode};
use hyper_util::rt::TokioIo;
use lsfb_drivers::sidecar::credentials::{DeviceKey, from_hex};
use lsfb_drivers::sidecar::model::{MAX_ENVELOPE_BYTES, STREAM_PATH, SUBPROTOCOL};
use lsfb_drivers::sidecar::wire::is_name;
use serde_json::json;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};

use super::answers::{Answer, json_of, said};
use super::{Visit, page, push, segments, stream};

/// Answers one request.
pub(super) async fn answer(request: Request<Incoming>, visit: Visit) -> Result<Answer, Infallible> {
    let path = request.uri().path().to_owned();
    let parts: Vec<&str> = path.trim_start_matches('/').split('/').collect();
    let method = request.method().clone();
    Ok(match (method, parts.as_slice()) {
        (Method::GET, ["v1", "hello"]) => hello(&visit),
        (Method::GET, _) if path == STREAM_PATH => upgrade(request, visit),
        (Method::GET, ["v1", "sessions", session]) => match admitted(&request, &visit).await {
            Ok(device) => segments::session(&visit, &device, session).await,
            Err(refused) => refused,
        },
        (Method::PUT, ["v1", "sessions", session, "segments", number]) => {
            match admitted(&request, &visit).await {
                Ok(device) => segments::put(request, &visit, &device, session, number).await,
                Err(refused) => refused,
            }
        }
        (Method::POST, ["v1", "push", ..]) => pushed(request, &visit, &parts).await,
        (Method::GET, [name]) => page::file(name).unwrap_or_else(nothing),
        _ => nothing(),
    })
}

/// Answers one request that came without TLS: nothing that a paired device proves itself with may come this way.
pub(super) async fn answer_pushed(
    request: Request<Incoming>,
    visit: Visit,
) -> Result<Answer, Infallible> {
    let path = request.uri().path().to_owned();
    let parts: Vec<&str> = path.trim_start_matches('/').split('/').collect();
    Ok(match *request.method() {
        Method::POST => pushed(request, &visit, &parts).await,
        _ => nothing(),
    })
}

async fn pushed(request: Request<Incoming>, visit: &Visit, parts: &[&str]) -> Answer {
    match parts {
        ["v1", "push", device] => push::take(request, visit, device, None).await,
        ["v1", "push", device, key] => push::take(request, visit, device, Some(key)).await,
        _ => nothing(),
    }
}

fn nothing() -> Answer {
    said(StatusCode::NOT_FOUND, "nothing is here")
}

fn hello(visit: &Visit) -> Answer {
    let is_recording = visit.shared.recording.borrow().is_some();
    json_of(
        StatusCode::OK,
        &json!({ "protocols": [SUBPROTOCOL], "recording": is_recording }),
    )
}

/// Turns the connection into a WebSocket. Who it is, it says there.
fn upgrade(mut request: Request<Incoming>, visit: Visit) -> Answer {
    let headers = request.headers();
    let wants = headers
        .get(UPGRADE)
        .is_some_and(|value| value.as_bytes().eq_ignore_ascii_case(b"websocket"));
    let key = headers.get(SEC_WEBSOCKET_KEY).filter(|_| wants);
    let Some(accepted) = key.map(|key| derive_accept_key(key.as_bytes())) else {
        return said(StatusCode::BAD_REQUEST, "this is a WebSocket");
    };
    let speaks = headers
        .get_all(SEC_WEBSOCKET_PROTOCOL)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .any(|name| name.trim() == SUBPROTOCOL);
    if !speaks {
        return said(
            StatusCode::BAD_REQUEST,
            "only subprotocol lsfb.sidecar.v1 is spoken",
        );
    }
    let upgraded = hyper::upgrade::on(&mut request);
    tokio::spawn(async move {
        let limits = WebSocketConfig::default()
            .max_message_size(Some(MAX_ENVELOPE_BYTES))
            .max_frame_size(Some(MAX_ENVELOPE_BYTES));
        // An error: it has gone meanwhile.
        if let Ok(upgraded) = upgraded.await {
            let io = TokioIo::new(upgraded);
            let socket = WebSocketStream::from_raw_socket(io, Role::Server, Some(limits)).await;
            stream::serve(socket, visit).await;
        }
    });
    let mut answer = said(StatusCode::SWITCHING_PROTOCOLS, "");
    let headers = answer.headers_mut();
    headers.remove(CONTENT_TYPE);
    headers.insert(UPGRADE, HeaderValue::from_static("websocket"));
    headers.insert(
        hyper::header::CONNECTION,
        HeaderValue::from_static("Upgrade"),
    );
    headers.insert(
        SEC_WEBSOCKET_PROTOCOL,
        HeaderValue::from_static(SUBPROTOCOL),
    );
    if let Ok(accepted) = HeaderValue::from_str(&accepted) {
        headers.insert(hyper::header::SEC_WEBSOCKET_ACCEPT, accepted);
    }
    answer
}

/// The device behind a request: `Authorization: Bearer DEVICE.KEY`.
async fn admitted(request: &Request<Incoming>, visit: &Visit) -> Result<String, Answer> {
    let refuse = |reason| {
        visit.shared.refusals.count(reason);
        visit.ticket.fail();
        said(StatusCode::UNAUTHORIZED, "this device is not paired")
    };
    let credentials = request.headers().get(AUTHORIZATION).and_then(|value| {
        value
            .to_str()
            .ok()?
            .strip_prefix("Bearer ")?
            .split_once('.')
    });
    let Some((device, key)) = credentials else {
        return Err(refuse("no credentials"));
    };
    let key = from_hex(key).map(DeviceKey);
    let Some(key) = key.filter(|_| is_name(device)) else {
        return Err(refuse("bad credentials"));
    };
    let (pairing, device) = (visit.shared.pairing.clone(), device.to_owned());
    let looked = tokio::task::spawn_blocking(move || {
        let is_known = pairing.knows(&device, &key);
        (device, is_known)
    });
    match looked.await {
        Ok((device, true)) => {
            visit.ticket.enter();
            Ok(device)
        }
        _ => Err(refuse("not paired")),
    }
}
