//! Whether a phone's system holds Wi-Fi scans back.
//!
//! Android lets an app in front start four scans in two minutes, and one in the background far fewer. Beyond that it refuses, or hands out
//! the results of an earlier scan once more: the same networks with the same times, or, where the app did not keep those, with the same
//! levels throughout.

use std::collections::{BTreeMap, VecDeque};

use lsfb_recording::message::WifiReading;
use lsfb_types::Timestamp;

use crate::counted::counted;

/// Fewer networks with the same levels as before are no wonder.
const LEAST_NETWORKS: usize = 4;
/// Four scans in two minutes are one in 30 s; what scans as it likes takes 2 to 10 s.
const SLOW_SECS: f64 = 20.0;
/// Pauses between scans that are looked at together; fewer than two are no pace.
const PAUSES: usize = 5;
const LEAST_PAUSES: usize = 2;
/// Earlier scans of which one may be handed out once more.
const REMEMBERED: usize = 8;

/// Networks of one scan: address → when it was heard and how strong.
type Scan = BTreeMap<String, (Timestamp, i16)>;

/// The scans of one phone, reading by reading as they come.
#[derive(Clone, Debug, Default)]
pub(crate) struct WifiScans {
    /// The scan whose readings come now, and its number.
    number: Option<u32>,
    scan: Scan,
    /// Those before it, the latest last.
    earlier: VecDeque<Scan>,
    last_new: Option<Timestamp>,
    /// Seconds from one new scan to the next, lately.
    pauses_secs: VecDeque<f64>,
    slowest_secs: Option<f64>,
    count: usize,
    handed_out_again: usize,
    is_again: bool,
}

impl WifiScans {
    /// Takes what was heard then.
    pub(crate) fn note(&mut self, time: Timestamp, reading: WifiReading) {
        if self.number.is_some_and(|number| number != reading.scan) {
            self.finish();
        }
        self.number = Some(reading.scan);
        self.scan.insert(reading.bssid, (time, reading.rssi_dbm));
    }

    /// Nothing more of the scan whose readings came last.
    pub(crate) fn finish(&mut self) {
        if self.number.take().is_none() {
            return;
        }
        let scan = std::mem::take(&mut self.scan);
        let is_old = |(bssid, (heard, _)): (&String, &(Timestamp, i16))| {
            let mut earlier = self.earlier.iter();
            earlier.any(|earlier| earlier.get(bssid).is_some_and(|(time, _)| time == heard))
        };
        let is_copy =
            |before: &Scan| scan.len() >= LEAST_NETWORKS && levels(before).eq(levels(&scan));
        self.count += 1;
        self.is_again = scan.iter().all(is_old) || self.earlier.back().is_some_and(is_copy);
        match self.is_again {
            true => self.handed_out_again += 1,
            false => self.new_at(scan.values().map(|(heard, _)| *heard).min()),
        }
        self.earlier.push_back(scan);
        if self.earlier.len() > REMEMBERED {
            self.earlier.pop_front();
        }
    }

    fn new_at(&mut self, time: Option<Timestamp>) {
        let Some(time) = time else {
            return;
        };
        if let Some(last) = self.last_new.replace(time) {
            self.pauses_secs.push_back(time.secs_since(last));
        }
        if self.pauses_secs.len() > PAUSES {
            self.pauses_secs.pop_front();
        }
        if let Some(secs) = self.every_secs() {
            self.slowest_secs = Some(self.slowest_secs.map_or(secs, |slowest| slowest.max(secs)));
        }
    }

    /// From one new scan to the next, the middle of the last few, seconds; `None`: too few.
    fn every_secs(&self) -> Option<f64> {
        let mut pauses: Vec<f64> = self.pauses_secs.iter().copied().collect();
        pauses.sort_by(f64::total_cmp);
        let is_enough = pauses.len() >= LEAST_PAUSES;
        pauses.get(pauses.len() / 2).copied().filter(|_| is_enough)
    }

    /// How many handed out old results.
    pub(crate) fn handed_out_again(&self) -> usize {
        self.handed_out_again
    }

    /// Whether scans were ever held back.
    pub(crate) fn were_held_back(&self) -> bool {
        self.handed_out_again > 0 || self.slowest_secs.is_some_and(|secs| secs > SLOW_SECS)
    }

    /// Whether the last scan was held back.
    pub(crate) fn are_held_back(&self) -> bool {
        self.is_again || self.every_secs().is_some_and(|secs| secs > SLOW_SECS)
    }

    /// What they are like, in words.
    pub(crate) fn words(&self) -> String {
        let mut words = counted(self.count as u64, "Wi-Fi scan", "Wi-Fi scans");
        if let Some(secs) = self.slowest_secs {
            words += &format!(", one every {secs:.1} s at the slowest");
        }
        if self.handed_out_again > 0 {
            let repeat = if self.handed_out_again == 1 {
                "repeats"
            } else {
                "repeat"
            };
            words += &format!("; {} of them {repeat} old results", self.handed_out_again);
        }
        if self.were_held_back() {
            words += ": the phone's system throttles scans";
        }
        words
    }
}

fn levels(scan: &Scan) -> impl Iterator<Item = (&String, i16)> {
    scan.iter().map(|(bssid, (_, rssi))| (bssid, *rssi))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scans, each of so many networks heard at so many seconds, with so much added to their levels.
    fn scans(of: &[(usize, i64, i16)]) -> WifiScans {
        let mut scans = WifiScans::default();
        for (number, (networks, secs, level)) in (0..).zip(of) {
            for n in 0..*networks {
                let heard = Timestamp::from_nanos(secs * 1_000_000_000 + n as i64);
                let reading = WifiReading {
                    scan: number,
                    bssid: format!("ac:de:48:00:11:{n:02x}"),
                    rssi_dbm: *level - n as i16,
                    ..WifiReading::default()
                };
                scans.note(heard, reading);
            }
        }
        scans.finish();
        scans
    }

    #[test]
    fn old_results_and_four_scans_in_two_minutes_are_throttling() {
        let free = scans(&[(5, 0, -50), (5, 3, -51), (6, 6, -50), (5, 9, -50)]);
        assert_eq!((free.handed_out_again, free.every_secs()), (0, Some(3.0)));
        assert!(!free.were_held_back() && !free.are_held_back());
        // The third with the times of the first, the fourth with new times and the levels of the third.
        let again = scans(&[
            (5, 0, -50),
            (5, 3, -51),
            (5, 0, -50),
            (5, 9, -50),
            (5, 12, -53),
        ]);
        assert_eq!((again.count, again.handed_out_again), (5, 2));
        assert!(again.were_held_back() && !again.are_held_back());
        let slow = scans(&[(5, 0, -50), (5, 30, -51), (5, 60, -52), (5, 90, -53)]);
        assert_eq!((slow.handed_out_again, slow.every_secs()), (0, Some(30.0)));
        assert!(slow.were_held_back() && slow.are_held_back());
        // Two networks at the same level twice are no wonder.
        let few = scans(&[(2, 0, -50), (2, 3, -50)]);
        assert_eq!(few.handed_out_again, 0);
        // A system that lets go again.
        let late = scans(&[(5, 0, -50), (5, 0, -50), (5, 3, -51), (5, 6, -52)]);
        assert!(late.were_held_back() && !late.are_held_back());
    }
}
