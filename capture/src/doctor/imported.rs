//! Recordings that were made of files of another program.

use std::collections::BTreeMap;

use lsfb_recording::Recording;
use lsfb_types::{Finding, Limit, Verdict};

use super::Findings;

/// Metadata of a recording that `lsfb import` wrote.
const IMPORT: &str = "lsfb.import";

/// What is said of where the recording comes from; `None` where it was recorded here.
pub(super) fn entries(recording: &Recording) -> Option<BTreeMap<String, String>> {
    let entries = recording.metadata(IMPORT).ok()?;
    (!entries.is_empty()).then_some(entries)
}

impl Findings {
    /// No host received these messages: their arrivals are the device's stamps again, and agree with them whatever its clock did.
    pub(super) fn imported(&mut self, import: &BTreeMap<String, String>) {
        let said = |name: &str| import.get(name).map_or("?", String::as_str);
        let clock = match said("clock") {
            "utc" => "its clock shows the time of day, with unknown accuracy",
            _ => {
                "its clock starts at an arbitrary zero and cannot be compared with other recordings"
            }
        };
        let found = format!(
            "imported from {} ({}): no host received it, so that arrivals are the device's own stamps; {clock}",
            said("source"),
            said("format"),
        );
        let finding = Finding::new("import", Verdict::Unknown, "clock", found);
        self.add(
            finding.remedy("align it with another recording of the same walk with `lsfb align`"),
        );
        let count = |name: &str| said(name).parse::<u64>().ok();
        let Some(unreadable) = count("unreadable") else {
            let found = "the import does not say what could not be read";
            return self.add(Finding::new("losses", Verdict::Warn, "losses", found));
        };
        let mut found = match unreadable {
            0 => format!("all {} records were imported", said("records")),
            lost => format!("{lost} of {} records could not be read", said("records")),
        };
        for (name, what) in [
            ("repeated", "were duplicates"),
            ("reordered", "were out of order"),
        ] {
            if let Some(number) = count(name).filter(|n| *n > 0) {
                found += &format!(", {number} {what}");
            }
        }
        if !said("left_out").is_empty() {
            found += &format!("; left out: {}", said("left_out"));
        }
        let verdict = Verdict::Fail.unless(unreadable == 0);
        let finding = Finding::new("losses", verdict, "losses", found);
        self.add(
            finding
                .value(unreadable as f64, "")
                .limit(Limit::AtMost(0.0)),
        );
    }
}
