//! What the devices are, by what the recorder wrote of them.

use std::collections::BTreeSet;

use lsfb_recording::Recording;
use lsfb_types::{Finding, Verdict};

use super::Findings;
use super::stream::Stream;
use crate::device_note::DeviceNote;

impl Findings {
    pub(super) fn devices(&mut self, recording: &Recording, streams: &[Stream<'_>]) {
        let names: BTreeSet<&str> = streams.iter().filter_map(Stream::device).collect();
        for name in names {
            let Some(note) = DeviceNote::read(recording, name) else {
                continue;
            };
            let mut found = note.words();
            if let Some(rate_hz) = note.rate_hz() {
                found += &format!(", {rate_hz:.1} Hz");
            }
            let subject = format!("device {name}");
            self.add(Finding::new("device", Verdict::Pass, subject, found));
        }
    }
}
