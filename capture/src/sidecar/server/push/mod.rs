//! Batches that another app pushes by HTTP: Sensor Logger's (`docs/sidecar.md`, "Sensor Logger").
//!
//! `POST /v1/push/NAME/KEY`, or `/v1/push/NAME` with `Authorization: Bearer KEY`. The answer says that the batch is on the disk. The app
//! keeps nothing and repeats nothing by itself: what does not get here is missing, and counted.

mod channels;
mod order;
mod session;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use http_body_util::{BodyExt as _, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{AUTHORIZATION, CONTENT_LENGTH};
use hyper::{Request, StatusCode};
use lsfb_drivers::sidecar::credentials::from_hex;
use lsfb_drivers::sidecar::sensor_logger::{PushError, PushUnits, PushedBody};
use lsfb_drivers::sidecar::wire::is_name;
use lsfb_web::{Answer, said, said_aloud};
use tokio::sync::Mutex;
use tokio::task::spawn_blocking;
use tokio::time::{Instant, sleep, timeout};

use super::{Recorded, Visit};
use crate::receipt::Progress;
use session::{BatchState, NotStored, Paused, PushSession, SILENT};

/// Longest body: images are not taken.
const MAX_BODY_BYTES: usize = 4 << 20;
/// How long a body may take.
const BODY_TIMEOUT: Duration = Duration::from_secs(10);
/// How long the disk may take.
const STORE_TIMEOUT: Duration = Duration::from_secs(10);
/// How often it is looked for what does not come.
const LOOK_EVERY: Duration = Duration::from_millis(250);
/// Apps that push at once at most.
const MAX_PUSHING: usize = lsfb_drivers::sidecar::model::MAX_DEVICES;
/// The app shows the text of an answer with this number to its user.
const SHOWN_STATUS: u16 = 499;

/// The sessions that are open or paused, by device.
#[derive(Debug, Default)]
pub(super) struct Pushing(Mutex<BTreeMap<String, Arc<Mutex<Slot>>>>);

/// What a device pushes.
#[derive(Debug, Default)]
struct Slot {
    open: Option<PushSession>,
    /// The last one, where it was silent for long.
    paused: Option<Paused>,
}

/// Takes one batch.
pub(super) async fn take(
    request: Request<Incoming>,
    visit: &Visit,
    device: &str,
    key: Option<&str>,
) -> Answer {
    let units = match admitted(&request, visit, device, key).await {
        Ok(units) => units,
        Err(refused) => return refused,
    };
    let Some(recorded) = visit.shared.recording.borrow().clone() else {
        return said(StatusCode::SERVICE_UNAVAILABLE, "not recording yet");
    };
    let bytes = match received(request).await {
        Ok(bytes) => bytes,
        Err(refused) => return refused,
    };
    let body = match spawn_blocking(move || PushedBody::parse(&bytes, units)).await {
        Ok(Ok(body)) => body,
        Ok(Err(why)) => return refuse(visit, why),
        Err(_) => return said(StatusCode::INTERNAL_SERVER_ERROR, "not read"),
    };
    match store(visit, &recorded, device, body).await {
        Ok(answer) => answer,
        Err(NotStored) => {
            visit.shared.refusals.count("pushed, and not stored");
            said(StatusCode::SERVICE_UNAVAILABLE, "not stored")
        }
    }
}

/// Who pushes, and how its app is set.
async fn admitted(
    request: &Request<Incoming>,
    visit: &Visit,
    device: &str,
    key: Option<&str>,
) -> Result<PushUnits, Answer> {
    let refuse = |reason| {
        visit.shared.refusals.count(reason);
        visit.ticket.fail();
        said(StatusCode::UNAUTHORIZED, "this app is not invited")
    };
    if visit.ticket.is_barred() {
        visit.shared.refusals.count("too many attempts");
        return Err(said(StatusCode::TOO_MANY_REQUESTS, "too many attempts"));
    }
    let header = request.headers().get(AUTHORIZATION);
    let bearer = header.and_then(|value| value.to_str().ok()?.strip_prefix("Bearer "));
    let key = key.or(bearer).and_then(from_hex::<16>);
    let Some(key) = key.filter(|_| is_name(device)) else {
        return Err(refuse("bad credentials"));
    };
    let (pairing, name) = (visit.shared.pairing.clone(), device.to_owned());
    match spawn_blocking(move || pairing.pusher(&name, &key)).await {
        Ok(Some(units)) => {
            visit.ticket.enter();
            Ok(units)
        }
        _ => Err(refuse("not paired")),
    }
}

async fn received(request: Request<Incoming>) -> Result<Bytes, Answer> {
    let length = request.headers().get(CONTENT_LENGTH);
    let length = length.and_then(|value| value.to_str().ok()?.parse::<usize>().ok());
    let too_long = || {
        said(
            StatusCode::PAYLOAD_TOO_LARGE,
            "at most 4 MiB, and no images",
        )
    };
    if length.is_some_and(|length| length > MAX_BODY_BYTES) {
        return Err(too_long());
    }
    let body = Limited::new(request.into_body(), MAX_BODY_BYTES).collect();
    match timeout(BODY_TIMEOUT, body).await {
        Ok(Ok(body)) => Ok(body.to_bytes()),
        Ok(Err(_)) => Err(too_long()),
        Err(_) => Err(said(StatusCode::REQUEST_TIMEOUT, "too slow")),
    }
}

fn refuse(visit: &Visit, why: PushError) -> Answer {
    visit.shared.refusals.count(match why {
        PushError::Units { .. } | PushError::Times => "pushed in another unit",
        _ => "bad body",
    });
    let status = match why {
        PushError::Units { .. } | PushError::Times => StatusCode::from_u16(SHOWN_STATUS),
        _ => Ok(StatusCode::BAD_REQUEST),
    };
    said_aloud(status.unwrap_or(StatusCode::BAD_REQUEST), why.to_string())
}

async fn store(
    visit: &Visit,
    recorded: &Arc<Recorded>,
    device: &str,
    body: PushedBody,
) -> Result<Answer, NotStored> {
    // What the app sends to try whether anybody is there.
    if body.readings.is_empty() && body.unknown.is_empty() && body.message_id == 0 {
        return Ok(said(StatusCode::OK, "the rig is here"));
    }
    let slot = {
        let mut pushing = recorded.pushing.0.lock().await;
        if pushing.len() >= MAX_PUSHING && !pushing.contains_key(device) {
            visit.shared.refusals.count("too many devices");
            return Ok(said(StatusCode::SERVICE_UNAVAILABLE, "too many devices"));
        }
        Arc::clone(pushing.entry(device.to_owned()).or_default())
    };
    let mut pushed = slot.lock().await;
    let Slot { open, paused } = &mut *pushed;
    let is_other = open
        .as_ref()
        .is_some_and(|session: &PushSession| session.session_id != body.session_id);
    if is_other && let Some(before) = open.take() {
        before.close("began another recording").await;
    }
    let session = match &mut *open {
        Some(session) => session,
        none => {
            let before = paused.take();
            let session = PushSession::open(visit, recorded, device, &body, before).await?;
            tokio::spawn(watch(visit.clone(), Arc::clone(&slot)));
            none.insert(session)
        }
    };
    let place = match session.take(body).await {
        Ok(place) => place,
        Err(NotStored) => {
            if let Some(broken) = open.take() {
                broken.close("could not be stored").await;
            }
            return Err(NotStored);
        }
    };
    drop(pushed);
    match place {
        BatchState::Recorded(progress, seq) => {
            stored(&progress, seq).await?;
            Ok(said(StatusCode::OK, "stored"))
        }
        BatchState::Held => Ok(said(StatusCode::ACCEPTED, "waits for earlier batches")),
        BatchState::Repeated => Ok(said(StatusCode::OK, "stored before")),
        BatchState::Late => Ok(said(StatusCode::GONE, "too late: given up before it came")),
    }
}

/// Until a batch is on the disk.
async fn stored(progress: &Progress, seq: u64) -> Result<(), NotStored> {
    let began = Instant::now();
    while progress.stored_seq() < seq {
        if progress.is_broken() || began.elapsed() >= STORE_TIMEOUT {
            return Err(NotStored);
        }
        // Of several who wait one is told.
        let _ = timeout(Duration::from_millis(50), progress.changed()).await;
    }
    Ok(())
}

/// Looks after a session until it is silent, or replaced, or the recording ends.
async fn watch(visit: Visit, slot: Arc<Mutex<Slot>>) {
    let mut running = visit.shared.running.clone();
    loop {
        tokio::select! {
            _ = running.changed() => return,
            () = sleep(LOOK_EVERY) => {}
        }
        let mut pushed = slot.lock().await;
        let Slot { open, paused } = &mut *pushed;
        let Some(session) = open.as_mut() else {
            return;
        };
        let is_over = session.heard.elapsed() >= SILENT || session.look().await.is_err();
        if is_over && let Some(silent) = open.take() {
            *paused = Some(silent.pause("no data pushed for 10 s").await);
            return;
        }
    }
}
