//! Phones and glasses: an own server takes what they send, and it goes into the recording.
//!
//! [`server`] talks to the network and to nothing else; [`sessions`] says which message is whose and the next; [`apps`] puts what
//! came into the recording; a [`crate::receipt::Receipt`] comes back from there when it is in the file.

mod apps;
mod pairing;
mod presence;
mod pseudonyms;
mod recorded;
mod server;
mod sessions;
mod time_sync;
mod topics;

use std::sync::atomic::Ordering;
use std::time::Duration;

pub(crate) use apps::Apps;
pub use pairing::{INVITATION, PairingFolder};
use presence::Presence;
pub use server::PhonesListener;
use server::SidecarEvent;
pub(crate) use server::SidecarServer;
pub(crate) use sessions::RecordingFolders;
pub(crate) use time_sync::decode_exchange;
#[cfg(test)]
pub(crate) use time_sync::encode_exchange;
pub(crate) use topics::{CAMERA_INFO, TIME_SYNC, Topics, is_recorders_own};

use crate::control::Control;
use crate::health::{Connection, Ending, Meter, StreamReport};
use crate::recorder::{Entry, RecorderSender, WriterGone};

/// How long to wait for an event before it is looked whether the session stops.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Records until every device that came has gone and nothing else is recorded, or the session stops. As long as others send,
/// devices may come, go and come back; where nothing else is recorded, one that was lost is waited for.
pub(crate) fn record(
    mut server: SidecarServer,
    place: RecordingFolders,
    come_back: Duration,
    to_recorder: &RecorderSender,
    control: &Control,
    meter: &Meter,
) -> StreamReport {
    server.begin(place);
    let refusals = server.refusals();
    let mut recording = Recording {
        apps: Apps::new(meter, server.pseudonyms().cloned()),
        presence: Presence::default(),
    };
    // Whether everybody who came has gone.
    let mut all_gone = false;
    let ending = loop {
        if let Some(event) = server.recv(LOOK_EVERY) {
            if recording.take(event, to_recorder, meter).is_err() {
                break Ending::Stopped;
            }
            let decoded = recording.apps.report.decoded;
            control
                .progress
                .sidecar_messages
                .store(decoded, Ordering::Relaxed);
        }
        meter.set_gone(recording.presence.sentence());
        meter.set_partial(recording.apps.held_back());
        if recording.presence.is_all_gone() != all_gone {
            all_gone = !all_gone;
            match all_gone {
                true => control.leave(),
                false => control.come_back(),
            }
            meter.set_connected(match all_gone {
                true => Connection::Left,
                false => Connection::There,
            });
        }
        // First, as the others have ended too by then.
        if control.is_stopping() {
            break Ending::Stopped;
        }
        if all_gone && control.nothing_is_left() && recording.presence.gave_up(come_back) {
            break Ending::EndOfStream;
        }
    };
    if all_gone {
        // Whoever runs this thread counts it out again.
        control.come_back();
    }
    drop(server);
    let mut report = recording.apps.into_report();
    report.notes.extend(refusals.sentence());
    report.ending = match recording.presence.lost() {
        Some(why) => Ending::Lost(why),
        None if report.received == 0 => Ending::Lost(
            "sidecar: no phone sent data; pair one with `lsfb sidecar pair`".to_owned(),
        ),
        None => ending,
    };
    report
}

struct Recording {
    apps: Apps,
    presence: Presence,
}

impl Recording {
    fn take(
        &mut self,
        event: SidecarEvent,
        to_recorder: &RecorderSender,
        meter: &Meter,
    ) -> Result<(), WriterGone> {
        match event {
            SidecarEvent::Opened {
                connection,
                hello,
                arrival,
                start,
                missing,
                note,
            } => {
                let report = &mut self.apps.report;
                report.missing += missing;
                report.notes.extend(note);
                report
                    .notes
                    .extend(self.presence.come(&hello.device, connection));
                if let Some(start) = start {
                    let message = start.message(&hello.device, arrival);
                    to_recorder.put(Entry::Own(message), report)?;
                }
                meter.heard(report, arrival);
            }
            SidecarEvent::Message {
                device,
                arrival,
                message,
                receipt,
            } => {
                let apps = &mut self.apps;
                apps.message(&device, arrival, message, receipt, to_recorder)?;
                meter.heard(&apps.report, arrival);
            }
            SidecarEvent::Time {
                device,
                arrival,
                clock_id,
                exchange,
            } => {
                self.apps.exchange(&device, &clock_id, &exchange);
                let message = time_sync::message(&device, &clock_id, &exchange, arrival);
                to_recorder.put(Entry::Own(message), &mut self.apps.report)?;
            }
            SidecarEvent::Pushed {
                device,
                missing,
                missing_before,
                left_out,
                bad,
            } => {
                self.apps.leave_out(&device, left_out);
                let report = &mut self.apps.report;
                report.missing = (report.missing + missing).saturating_sub(missing_before);
                report.bad += bad;
                if bad > 0 {
                    report
                        .first_bad
                        .get_or_insert_with(|| format!("{device}: a reading without values"));
                }
                meter.count(report);
            }
            SidecarEvent::Closed {
                connection,
                device,
                duplicated,
                why,
            } => {
                self.apps.report.duplicated += duplicated;
                self.presence.leave(&device, connection, why);
                meter.count(&self.apps.report);
            }
        }
        Ok(())
    }
}
