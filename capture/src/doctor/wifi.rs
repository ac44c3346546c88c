//! Whether a phone's system held Wi-Fi scans back.

use lsfb_recording::Recording;
use lsfb_recording::message::{self, decode_wifi};
use lsfb_types::{Finding, Limit, Verdict};

use super::Findings;
use crate::wifi_scans::WifiScans;

impl Findings {
    /// Wi-Fi scans of each phone.
    pub(super) fn wifi(&mut self, recording: &Recording) {
        let topics = recording.topics();
        let topics = topics
            .iter()
            .filter(|t| t.schema == message::WIFI_READING.name);
        for topic in topics {
            let Ok(messages) = recording.messages(&topic.topic) else {
                continue;
            };
            let mut scans = WifiScans::default();
            for message in messages.flatten() {
                // What cannot be read is counted where losses are.
                if let Ok(reading) = decode_wifi(&message.bytes) {
                    scans.note(message.time, reading);
                }
            }
            scans.finish();
            self.add(judged(&topic.topic, &scans));
        }
    }
}

fn judged(topic: &str, scans: &WifiScans) -> Finding {
    let verdict = Verdict::Warn.unless(!scans.were_held_back());
    let finding = Finding::new("wifi-scans", verdict, topic, scans.words())
        .value(scans.handed_out_again() as f64, "")
        .limit(Limit::AtMost(0.0));
    match verdict {
        Verdict::Pass => finding,
        _ => finding.remedy("turn off \"Wi-Fi scan throttling\" in the phone's developer options (Android 10 and later)"),
    }
}
