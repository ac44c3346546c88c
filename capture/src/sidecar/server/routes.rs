//! What is asked for by HTTP: the stream, segments of a recording, how far a session has got, and the page for browsers.

use std::sync::Arc;

use hyper::body::Incoming;
use hyper::header::AUTHORIZATION;
use hyper::{Method, Request, StatusCode};
use lsfb_drivers::sidecar::credentials::{DeviceKey, from_hex};
use lsfb_drivers::sidecar::model::{MAX_ENVELOPE_BYTES, STREAM_PATH, SUBPROTOCOL};
use lsfb_drivers::sidecar::wire::is_name;
use lsfb_web::{Answer, Handler, handler, json_of, offered, said};
use serde_json::json;

use super::{Shared, Visit, page, push, segments, stream};

/// Answers requests for as long as the recording goes on.
pub(super) fn answering<F>(
    shared: &Arc<Shared>,
    answer: impl Fn(Request<Incoming>, Visit) -> F + Copy + Send + Sync + 'static,
) -> Handler
where
    F: Future<Output = Answer> + Send + 'static,
{
    let shared = Arc::clone(shared);
    handler(move |request, connection: lsfb_web::Visit| {
        let shared = Arc::clone(&shared);
        async move {
            let mut running = shared.running.clone();
            let visit = Visit {
                connection: connection.connection,
                ticket: connection.ticket,
                shared,
            };
            tokio::select! {
                answer = answer(request, visit) => answer,
                _ = running.changed() => {
                    said(StatusCode::SERVICE_UNAVAILABLE, "the recording has ended")
                }
            }
        }
    })
}

/// Answers one request.
pub(super) async fn answer(request: Request<Incoming>, visit: Visit) -> Answer {
    let path = request.uri().path().to_owned();
    let parts: Vec<&str> = path.trim_start_matches('/').split('/').collect();
    let method = request.method().clone();
    match (method, parts.as_slice()) {
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
    }
}

/// Answers one request that came without TLS: nothing that a paired device proves itself with may come this way.
pub(super) async fn answer_pushed(request: Request<Incoming>, visit: Visit) -> Answer {
    let path = request.uri().path().to_owned();
    let parts: Vec<&str> = path.trim_start_matches('/').split('/').collect();
    match *request.method() {
        Method::POST => pushed(request, &visit, &parts).await,
        _ => nothing(),
    }
}

async fn pushed(request: Request<Incoming>, visit: &Visit, parts: &[&str]) -> Answer {
    match parts {
        ["v1", "push", device] => push::take(request, visit, device, None).await,
        ["v1", "push", device, key] => push::take(request, visit, device, Some(key)).await,
        _ => nothing(),
    }
}

fn nothing() -> Answer {
    said(StatusCode::NOT_FOUND, "not found")
}

fn hello(visit: &Visit) -> Answer {
    let is_recording = visit.shared.recording.borrow().is_some();
    json_of(
        StatusCode::OK,
        json!({ "protocols": [SUBPROTOCOL], "recording": is_recording }).to_string(),
    )
}

/// Turns the connection into a WebSocket. Who it is, it says there.
fn upgrade(request: Request<Incoming>, visit: Visit) -> Answer {
    let Some(protocol) = offered(&request, &[SUBPROTOCOL]) else {
        return said(
            StatusCode::BAD_REQUEST,
            "this is a WebSocket; the only subprotocol is lsfb.sidecar.v1",
        );
    };
    let serve = |socket| stream::serve(socket, visit);
    lsfb_web::upgrade(request, Some(protocol), MAX_ENVELOPE_BYTES, serve)
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
