//! Whether a phone's system held Wi-Fi scans back.
//!
//! Android lets an app in front start four scans in two minutes, and one in the background far fewer. Beyond that it refuses, or hands out
//! the results of an earlier scan once more: the same networks with the same times, or, where the app did not keep those, with the same
//! levels throughout.

use std::collections::{BTreeMap, BTreeSet};

use lsfb_recording::Recording;
use lsfb_recording::message::{self, decode_wifi};
use lsfb_types::{Finding, Limit, Timestamp, Verdict};

use super::Findings;

/// Fewer networks with the same levels as before are no wonder.
const LEAST_NETWORKS: usize = 4;
/// Four scans in two minutes are one in 30 s; what scans as it likes takes 2 to 10 s.
const SLOW_SECS: f64 = 20.0;
/// Fewer scans have no pace.
const LEAST_SCANS: usize = 3;

/// Networks of one scan: address → when it was heard and how strong.
type Scan = BTreeMap<String, (Timestamp, i16)>;

/// What the scans of a topic tell.
#[derive(Debug, Default, PartialEq)]
struct Scans {
    number: usize,
    handed_out_again: usize,
    /// Between scans that are new, the middle one; `None`: too few.
    every_secs: Option<f64>,
}

impl Findings {
    /// Wi-Fi scans of each phone.
    pub(super) fn wifi(&mut self, recording: &Recording) {
        let topics = recording.topics();
        let scans = topics
            .iter()
            .filter(|t| t.schema == message::WIFI_READING.name);
        for topic in scans {
            let Ok(messages) = recording.messages(&topic.topic) else {
                continue;
            };
            let mut by_number: BTreeMap<u32, Scan> = BTreeMap::new();
            for message in messages.flatten() {
                // What cannot be read is counted where losses are.
                let Ok(reading) = decode_wifi(&message.bytes) else {
                    continue;
                };
                let heard = (message.time, reading.rssi_dbm);
                by_number
                    .entry(reading.scan)
                    .or_default()
                    .insert(reading.bssid, heard);
            }
            let scans: Vec<Scan> = by_number.into_values().collect();
            self.add(judged(&topic.topic, &looked_at(&scans)));
        }
    }
}

fn looked_at(scans: &[Scan]) -> Scans {
    let mut seen: BTreeSet<(&str, Timestamp)> = BTreeSet::new();
    let mut new_at = Vec::new();
    for (n, scan) in scans.iter().enumerate() {
        let is_new = scan
            .iter()
            .any(|(bssid, (heard, _))| !seen.contains(&(bssid.as_str(), *heard)));
        let levels = |scan: &Scan| -> Vec<(String, i16)> {
            scan.iter()
                .map(|(bssid, (_, rssi))| (bssid.clone(), *rssi))
                .collect()
        };
        let before = n.checked_sub(1).and_then(|before| scans.get(before));
        let is_copy = scan.len() >= LEAST_NETWORKS
            && before.is_some_and(|before| levels(before) == levels(scan));
        if is_new && !is_copy {
            new_at.extend(scan.values().map(|(heard, _)| *heard).min());
        }
        seen.extend(
            scan.iter()
                .map(|(bssid, (heard, _))| (bssid.as_str(), *heard)),
        );
    }
    let mut pauses: Vec<f64> = new_at
        .windows(2)
        .map(|pair| pair[1].secs_since(pair[0]))
        .collect();
    pauses.sort_by(f64::total_cmp);
    Scans {
        number: scans.len(),
        handed_out_again: scans.len() - new_at.len(),
        every_secs: match new_at.len() {
            0..LEAST_SCANS => None,
            _ => pauses.get(pauses.len() / 2).copied(),
        },
    }
}

fn judged(topic: &str, scans: &Scans) -> Finding {
    let Scans {
        number,
        handed_out_again,
        every_secs,
    } = scans;
    let is_slow = every_secs.is_some_and(|secs| secs > SLOW_SECS);
    let mut found = format!("{number} Wi-Fi scans");
    if let Some(secs) = every_secs {
        found += &format!(", one every {secs:.1} s");
    }
    if *handed_out_again > 0 {
        found += &format!("; {handed_out_again} of them hand out old results once more");
    }
    if is_slow || *handed_out_again > 0 {
        found += ": the phone's system holds scans back";
    }
    let verdict = Verdict::Warn.unless(!is_slow && *handed_out_again == 0);
    let finding = Finding::new("wifi-scans", verdict, topic, found)
        .value(*handed_out_again as f64, "")
        .limit(Limit::AtMost(0.0));
    match verdict {
        Verdict::Pass => finding,
        _ => finding.remedy("switch off \"Wi-Fi scan throttling\" in the phone's developer options (Android 10 and later)"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scans, each of so many networks heard at so many seconds, with so much added to their levels.
    fn scans(of: &[(usize, i64, i16)]) -> Vec<Scan> {
        of.iter()
            .map(|(networks, secs, level)| {
                (0..*networks)
                    .map(|n| {
                        let heard = Timestamp::from_nanos(secs * 1_000_000_000 + n as i64);
                        (
                            format!("ac:de:48:00:11:{n:02x}"),
                            (heard, *level - n as i16),
                        )
                    })
                    .collect()
            })
            .collect()
    }

    #[test]
    fn old_results_and_four_scans_in_two_minutes_are_throttling() {
        let free = looked_at(&scans(&[
            (5, 0, -50),
            (5, 3, -51),
            (6, 6, -50),
            (5, 9, -50),
        ]));
        assert_eq!((free.handed_out_again, free.every_secs), (0, Some(3.0)));
        assert_eq!(judged("/wifi", &free).verdict, Verdict::Pass);
        // The third with the times of the first, the fourth with new times and the levels of the third.
        let again = looked_at(&scans(&[
            (5, 0, -50),
            (5, 3, -51),
            (5, 0, -50),
            (5, 9, -50),
            (5, 12, -53),
        ]));
        assert_eq!((again.number, again.handed_out_again), (5, 2));
        assert_eq!(judged("/wifi", &again).verdict, Verdict::Warn);
        let slow = looked_at(&scans(&[
            (5, 0, -50),
            (5, 30, -51),
            (5, 60, -52),
            (5, 90, -53),
        ]));
        assert_eq!((slow.handed_out_again, slow.every_secs), (0, Some(30.0)));
        assert_eq!(judged("/wifi", &slow).verdict, Verdict::Warn);
        // Two networks at the same level twice are no wonder.
        assert_eq!(
            looked_at(&scans(&[(2, 0, -50), (2, 3, -50)])).handed_out_again,
            0
        );
    }
}
