//! Whether the file is whole, and what the recorder itself counted.

use lsfb_recording::{Recording, TopicArrivals};
use lsfb_types::{Finding, Limit, ProgressFn, Timestamp, Verdict};

use super::{Depth, DoctorConfig, Findings, interrupted};
use crate::Error;

/// What the recorder counts of each device that is lost, and how it is called.
const COUNTS: &[(&str, &str)] = &[
    ("bad", "unreadable"),
    ("missing", "missing"),
    ("reordered", "too late for their scan"),
    ("kept_out", "from another LiDAR, rejected"),
    ("dropped", "dropped"),
    ("interruptions", "interruptions"),
    ("silences", "silences"),
    ("slowdowns", "stretches with a much too low rate"),
    ("stale", "stretches of repeated data"),
];
const RECOVER: &str = "repair the file with `lsfb recover`";

/// Whether what was found wrong is that the file ends too early.
fn is_cut_off(reason: &str) -> bool {
    reason.contains("breaks off") || reason.contains("no end")
}

impl Findings {
    /// Whether index and end are there, and where in time what is missing was.
    pub(super) fn file(&mut self, recording: &Recording, arrivals: &[TopicArrivals]) {
        if recording.damage().is_empty() {
            let found = "index and end of file are present";
            return self.add(Finding::new("file", Verdict::Pass, "file", found));
        }
        let last = arrivals.iter().filter_map(|a| a.times.last()).max();
        let until = last.map_or(String::new(), |last| {
            format!("; the last message arrived at {}", utc(*last))
        });
        for damage in recording.damage() {
            let found = if is_cut_off(&damage.reason) {
                format!(
                    "{damage}{until}; if the recorder was interrupted, at most one more second is missing; if a copy was truncated, any amount may be missing"
                )
            } else {
                damage.to_string()
            };
            self.add(Finding::new("file", Verdict::Fail, "file", found).remedy(RECOVER));
        }
    }

    /// Whether the messages that the indexes hold are those that were counted while they were written: an index that was
    /// overwritten is silent about what it held.
    pub(super) fn counts(&mut self, recording: &Recording, arrivals: &[TopicArrivals]) {
        let mut missing = Vec::new();
        let (mut written, mut indexed) = (0, 0);
        for topic in recording.topics() {
            let own = arrivals.iter().find(|a| a.topic == topic.topic);
            let own = own.map_or(0, |a| a.times.len() as u64);
            // Without a summary nobody counted.
            if topic.messages > 0 && own != topic.messages {
                missing.push(format!("{}: {own} of {}", topic.topic, topic.messages));
            }
            written += topic.messages;
            indexed += own;
        }
        if written == 0 {
            return;
        }
        let finding = |verdict, found| {
            Finding::new("counts", verdict, "message counts", found)
                .value(indexed as f64, "messages")
                .limit(Limit::AtLeast(written as f64))
        };
        // An index that was made from the data has counted itself.
        let mut damage = recording.damage().iter();
        let nobody_counted = damage.any(|d| is_cut_off(&d.reason) || !d.is_loss());
        self.add(if missing.is_empty() && nobody_counted {
            let found = format!(
                "{indexed} messages were found; without the end of the file it is unknown how many were written"
            );
            finding(Verdict::Unknown, found).remedy(RECOVER)
        } else if missing.is_empty() {
            let found = format!("the index lists all {written} messages that were written");
            finding(Verdict::Pass, found)
        } else {
            let found = format!(
                "the index lists {indexed} of {written} messages that were written ({}): part of the file was overwritten",
                missing.join(", ")
            );
            finding(Verdict::Fail, found).remedy(RECOVER)
        });
    }

    pub(super) fn checksums(
        &mut self,
        recording: &Recording,
        config: &DoctorConfig,
        progress: ProgressFn<'_>,
    ) -> Result<(), Error> {
        let finding =
            |verdict, found: String| Finding::new("checksums", verdict, "checksums", found);
        if config.read == Depth::Indexes {
            let found = "not read".to_owned();
            self.add(finding(Verdict::Unknown, found).remedy("read every byte with `--full`"));
            return Ok(());
        }
        let damage = recording.verify(progress)?;
        let new: Vec<_> = damage
            .iter()
            .filter(|d| !recording.damage().contains(d))
            .collect();
        let without = recording.chunks_without_checksum()?;
        if new.is_empty() && without == 0 {
            let found = "every chunk can be decompressed and has the right checksum".to_owned();
            self.add(finding(Verdict::Pass, found));
        } else if without > 0 {
            let found = format!(
                "{without} chunks have no checksum: their structure is valid, but their content cannot be verified"
            );
            self.add(finding(Verdict::Unknown, found));
        }
        for found in new {
            self.add(finding(Verdict::Fail, found.to_string()).remedy(RECOVER));
        }
        Ok(())
    }

    pub(super) fn part(&mut self, recording: &Recording) {
        let session = recording.metadata("lsfb.session").unwrap_or_default();
        let (Some(part), Some(previous)) = (session.get("part"), session.get("previous")) else {
            return;
        };
        let found = format!("part {part} of a recording, after {previous}");
        self.add(Finding::new("part", Verdict::Pass, "part", found));
    }

    /// What the recorder itself counted.
    pub(super) fn losses(&mut self, recording: &Recording) {
        let finding = |verdict, found: String| Finding::new("losses", verdict, "losses", found);
        let Ok(bytes) = recording.attachment("health.json") else {
            return self.add(interrupted::finding(recording));
        };
        let health: serde_json::Value = serde_json::from_slice(&bytes).unwrap_or_default();
        let Some(lost) = health.get("lost").and_then(serde_json::Value::as_u64) else {
            let found = "the recorder's report does not say what was lost".to_owned();
            return self.add(finding(Verdict::Warn, found));
        };
        let found = match lost {
            0 => "nothing lost".to_owned(),
            lost => format!("{lost} lost ({})", lost_parts(&health).join("; ")),
        };
        let verdict = Verdict::Fail.unless(lost == 0);
        let finding = finding(verdict, found).value(lost as f64, "");
        self.add(finding.limit(Limit::AtMost(0.0)));
    }
}

/// Who lost what, in words.
fn lost_parts(health: &serde_json::Value) -> Vec<String> {
    let mut parts = Vec::new();
    let streams = health.get("streams").and_then(|s| s.as_array());
    for stream in streams.into_iter().flatten() {
        let count = |key: &str| stream.get(key).and_then(serde_json::Value::as_u64);
        let name = stream.get("name").and_then(|n| n.as_str()).unwrap_or("?");
        for (key, what) in COUNTS {
            if let Some(count) = count(key).filter(|c| *c > 0) {
                parts.push(format!("{name}: {count} {what}"));
            }
        }
        if let Some(why) = stream.get("ending").and_then(|e| e.get("lost")) {
            parts.push(format!("{name}: {}", why.as_str().unwrap_or("lost")));
        }
    }
    let groups = health
        .get("groups")
        .and_then(|g| g.get("incomplete"))
        .and_then(serde_json::Value::as_u64);
    if let Some(groups) = groups.filter(|g| *g > 0) {
        parts.push(format!("{groups} triggers with missing images"));
    }
    parts
}

/// Time of day and seconds since 1970, as both are looked for.
pub(super) fn utc(time: Timestamp) -> String {
    let secs = time.nanos().div_euclid(1_000_000_000);
    let millis = time.nanos().rem_euclid(1_000_000_000) / 1_000_000;
    let of_day = secs.rem_euclid(86_400);
    format!(
        "{:02}:{:02}:{:02}.{millis:03} UTC ({secs}.{millis:03} s)",
        of_day / 3600,
        of_day / 60 % 60,
        of_day % 60
    )
}
