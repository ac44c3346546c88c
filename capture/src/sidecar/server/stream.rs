//! One WebSocket: an app says who it is, in time, and is listened to if it may.

use std::sync::Arc;
use std::time::Duration;

use lsfb_drivers::sidecar::model::MAX_DEVICES;
use lsfb_drivers::sidecar::wire::{Envelope, EnvelopeKind, Hello, Refusal, State};
use lsfb_drivers::sidecar::{Decoder, SidecarMessage};
use lsfb_web::Socket;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

use super::conversation::Conversation;
use super::socket::{End, SEND_TIMEOUT, hear, send};
use super::{INTRODUCTION, Recorded, SidecarEvent, Visit};

/// How long the last goodbye may take.
const GOODBYE: Duration = Duration::from_secs(3);

/// Serves a WebSocket to its end.
pub(super) async fn serve(mut socket: Socket, visit: Visit) {
    let mut decoder = Decoder::new();
    let ticket = Arc::clone(&visit.ticket);
    let introduced = tokio::select! {
        introduced = introduce(&mut socket, &mut decoder, &visit) => introduced,
        () = ticket.sent_away() => Err(End::Gone("disconnected to make room for others")),
    };
    let (end, device) = match introduced {
        Ok((hello, recorded)) => {
            let device = hello.device.clone();
            let end = converse(&mut socket, &mut decoder, &visit, hello, &recorded).await;
            let is_own = recorded.sessions.close(visit.connection, &device);
            (end, is_own.then_some(device))
        }
        Err(end) => (end, None),
    };
    let why = match &end {
        End::Bye => None,
        End::Refused(refusal, words) => {
            visit.shared.refusals.count(refusal.name());
            Some(words.clone())
        }
        End::Gone(words) => {
            if device.is_none() {
                visit.shared.refusals.count(words);
            }
            Some((*words).to_owned())
        }
    };
    // Told first: what the app is told may take its time.
    if let Some(device) = device {
        let closed = SidecarEvent::Closed {
            connection: visit.connection,
            device,
            duplicated: decoder.counters().duplicated,
            why,
        };
        // An error: nobody records any more.
        let _ = visit.shared.events.send(closed).await;
    }
    if let End::Refused(refusal, text) = end {
        let state = State {
            refusal: Some(refusal),
            text,
        };
        // It may have gone.
        let _ = send(
            &mut socket,
            &Envelope::around(EnvelopeKind::State, &state.emit()),
        )
        .await;
    }
    let _ = timeout(GOODBYE, socket.close(None)).await;
}

/// The app says who it is, in time.
async fn introduce(
    socket: &mut Socket,
    decoder: &mut Decoder,
    visit: &Visit,
) -> Result<(Hello, Arc<Recorded>), End> {
    let heard = timeout(INTRODUCTION, hear(socket)).await;
    let bytes = heard.map_err(|_| End::Gone("did not identify itself"))??;
    let Some(SidecarMessage::Hello(hello)) = decoder.push(&bytes)? else {
        return Err(Refusal::BadMessage.into());
    };
    admit(&hello, visit).await?;
    visit.ticket.enter();
    // A recording that has not begun yet will soon.
    let mut recording = visit.shared.recording.clone();
    let begun = timeout(SEND_TIMEOUT, recording.wait_for(Option::is_some)).await;
    let recorded = match begun {
        Ok(Ok(recorded)) => recorded.clone(),
        _ => None,
    };
    let recorded = recorded.ok_or(Refusal::Ended)?;
    let sessions = &recorded.sessions;
    if !sessions.is_connected(&hello.device) && sessions.connected() >= MAX_DEVICES {
        return Err(Refusal::Full.into());
    }
    Ok((hello, recorded))
}

/// Whether a device may come in: it is paired, or has an invitation.
async fn admit(hello: &Hello, visit: &Visit) -> Result<(), Refusal> {
    let pairing = visit.shared.pairing.clone();
    let (device, key, token) = (hello.device.clone(), hello.device_key, hello.pairing_token);
    let is_barred = visit.ticket.is_barred();
    let looked = spawn_blocking(move || {
        if pairing.knows(&device, &key) {
            return Ok(());
        }
        match token {
            // A key of 256 bits cannot be tried out, and is looked at in any case.
            Some(_) if is_barred => Err(Refusal::TooManyAttempts),
            Some(token) => pairing.pair(&device, &key, &token),
            None => Err(Refusal::NotPaired),
        }
    });
    let admitted = looked.await.unwrap_or(Err(Refusal::NotPaired));
    admitted.inspect_err(|_| visit.ticket.fail())
}

async fn converse(
    socket: &mut Socket,
    decoder: &mut Decoder,
    visit: &Visit,
    hello: Hello,
    recorded: &Arc<Recorded>,
) -> End {
    match Conversation::open(visit, hello, recorded).await {
        Ok(mut conversation) => {
            decoder.resume_after(conversation.received());
            match conversation.run(socket, decoder).await {
                Ok(()) => End::Bye,
                Err(end) => end,
            }
        }
        Err(end) => end,
    }
}
