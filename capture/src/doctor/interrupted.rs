//! What a recorder that was interrupted had said until then: it left no report, but its health twice a second.

use std::collections::{BTreeMap, BTreeSet};

use lsfb_recording::message::{HealthValue, decode_health_value};
use lsfb_recording::{HEALTH, Recording};
use lsfb_types::{Finding, Limit, Verdict};

/// Level of [`HealthValue`] at which data is being lost.
const LOSING: u8 = 2;
/// Problems that are told; more would hide the first.
const MOST_TOLD: usize = 4;

/// What is said of losses where the recorder left no report.
pub(super) fn finding(recording: &Recording) -> Finding {
    let new = |verdict, what: &str| Finding::new("losses", verdict, "losses", what);
    let drops = values(recording, "drops");
    if drops.is_empty() {
        let what = "the recorder left no report: it was interrupted, or another program wrote this";
        return new(Verdict::Warn, what);
    }
    // Each counts since the start: the last says all.
    let by_device: BTreeMap<&str, f64> =
        drops.iter().map(|d| (d.device.as_str(), d.value)).collect();
    let lost: f64 = by_device.values().sum();
    let rates = values(recording, "rate");
    let problems: BTreeSet<String> = rates
        .iter()
        .filter(|rate| rate.level >= LOSING && !rate.text.is_empty())
        .map(|rate| {
            // A silence that goes on is said anew each time.
            let text = rate.text.split(" for ").next().unwrap_or_default();
            format!("{}: {text}", rate.device)
        })
        .collect();
    let mut what =
        "the recorder's report is missing: it was interrupted, or continued in another part; according to its health messages ".to_owned();
    let counted = by_device.iter().filter(|(_, count)| **count > 0.0);
    let counted: Vec<String> = counted
        .map(|(device, count)| format!("{device}: {count}"))
        .collect();
    what += &match counted.is_empty() {
        true => "no packet was lost until then".to_owned(),
        false => format!(
            "{lost} packets were unreadable, missing or dropped until then ({})",
            counted.join(", ")
        ),
    };
    if !problems.is_empty() {
        let told: Vec<&str> = problems
            .iter()
            .take(MOST_TOLD)
            .map(String::as_str)
            .collect();
        what += &format!(", with warnings: {}", told.join("; "));
    }
    let limit = Limit::AtMost(0.0);
    let verdict = Verdict::Fail.unless(limit.holds(lost)).max(Verdict::Warn);
    new(verdict, &what).value(lost, "").limit(limit)
}

/// All values of a quantity, in order; what cannot be read is left out, as the file is damaged.
fn values(recording: &Recording, quantity: &str) -> Vec<HealthValue> {
    let Ok(messages) = recording.messages(&format!("{HEALTH}{quantity}")) else {
        return Vec::new();
    };
    messages
        .filter_map(|message| decode_health_value(&message.ok()?.bytes).ok())
        .collect()
}
