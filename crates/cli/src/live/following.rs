//! How the live odometry follows the walk: what became of the scans, how late their poses are, and what the operator is told of it.

use std::time::{Duration, Instant};

use lsfb_capture::Latencies;
use lsfb_pipeline::odometry::StepOutcome;
use serde::Serialize;

use super::odometry::LiveStep;
use super::unseen::Unseen;

/// A map whose odometry said nothing for this long shows the past.
const FROZEN_AFTER: Duration = Duration::from_secs(1);
/// The odometry needs some scans before the first is registered.
const BEGUN_AFTER: Duration = Duration::from_secs(5);

/// What the live odometry made of the scans of a recording. All of them are recorded, whatever became of them here.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LiveOdometryReport {
    /// Scans that found their place.
    pub registered: u64,
    /// Scans that found none.
    pub lost: u64,
    /// Places that the walk came back to and that were recognised; absent where nobody looked, as they are looked for to be shown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loops: Option<u64>,
    /// Scans around which loops may have been missed: the search was behind, or failed; absent as `loops`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unsearched_scans: Option<u64>,
    /// Scans that it was not given because it was behind.
    pub skipped_scans: u64,
    /// Inertial samples that it was not given because it was behind.
    pub skipped_imu_samples: u64,
    /// Images, scans and samples that the live view was too slow to take from the recorder.
    pub missed_by_tap: u64,
    /// Half of the scans had their pose this long after they came to the recorder, milliseconds.
    pub latency_p50_ms: f64,
    /// The same of 99 % of the scans.
    pub latency_p99_ms: f64,
}

/// The live odometry of one recording, as its steps tell.
#[derive(Debug, Default)]
pub struct Following {
    registered: u64,
    lost: u64,
    /// Places that were recognised.
    pub loops: u64,
    latencies: Latencies,
    /// When a scan was registered last.
    registered_at: Option<Instant>,
    /// When a scan gave a step last, wherever it was.
    answered_at: Option<Instant>,
    /// What scans do not see of the motion.
    pub unseen: Unseen,
}

impl Following {
    /// Takes what a scan gave.
    pub fn take(&mut self, live: &LiveStep, now: Instant) {
        let step = &live.step;
        self.answered_at = Some(now);
        if let Some(offered) = live.offered {
            self.latencies.add(now.saturating_duration_since(offered));
        }
        if step.begins_again() {
            // Scans before those that come anew have no place in the walk.
            let before = self.registered + self.lost;
            (self.registered, self.lost) = (0, before.saturating_sub(step.anew.len() as u64));
            self.loops = 0;
        }
        let placed = step.placed().count() as u64;
        self.registered += placed;
        self.lost += 1 + step.anew.len() as u64 - placed;
        if step.outcome != StepOutcome::Lost {
            self.registered_at = Some(now);
        }
        self.unseen.take(step, now);
    }

    /// Why the map does not grow any more, or has not begun to, in a recording that `began` then; `None` while it does.
    pub fn frozen(&self, began: Instant, now: Instant) -> Option<String> {
        let secs = |since: Instant| now.duration_since(since).as_secs_f64();
        match (self.registered_at, self.answered_at) {
            (None, _) if now.duration_since(began) > BEGUN_AFTER => Some(format!(
                "No map after {:.0} s: no scan could be registered. Check the LiDAR.",
                secs(began)
            )),
            (_, Some(last)) if now.duration_since(last) > FROZEN_AFTER => {
                let since = self.registered_at.unwrap_or(last);
                Some(format!(
                    "No scan registered for {:.1} s. Check the LiDAR.",
                    secs(since)
                ))
            }
            _ => None,
        }
    }

    /// What the operator reads while scans find no place.
    pub fn lost_sentence(&self, now: Instant) -> String {
        let since = self.registered_at.map_or_else(String::new, |last| {
            let secs = now.duration_since(last).as_secs_f64();
            format!(" for {secs:.1} s")
        });
        format!("Map lost{since}: slow down, or return to where it was good.")
    }

    /// In numbers, but for what was skipped.
    pub fn report(&self) -> LiveOdometryReport {
        LiveOdometryReport {
            registered: self.registered,
            lost: self.lost,
            latency_p50_ms: self.latencies.quantile_ms(0.5),
            latency_p99_ms: self.latencies.quantile_ms(0.99),
            ..LiveOdometryReport::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::odometry::tests::live;
    use super::*;

    /// Lost scans counted as registered: a map that had been lost for a minute was never said to be frozen, nor for how long it was lost.
    #[test]
    fn lost_scans_are_counted_as_such_and_do_not_keep_the_map_alive() {
        use StepOutcome::{First, Lost, Registered};
        let began = Instant::now();
        let at = |ms: u64| began + Duration::from_millis(ms);
        let mut following = Following::default();
        for (ms, outcome) in [(99, First), (199, Registered), (299, Lost)] {
            following.take(&live(ms as i64, outcome, at(ms)), at(ms + 40));
        }
        let report = following.report();
        assert_eq!((report.registered, report.lost), (2, 1));
        assert!((40.0..44.0).contains(&report.latency_p50_ms), "{report:?}");
        assert_eq!(following.frozen(began, at(1_000)), None);
        let said = following.lost_sentence(at(3_239));
        assert!(said.starts_with("Map lost for 3.0 s: "), "{said}");
        let frozen = following.frozen(began, at(3_239)).expect("a sentence");
        assert!(frozen.contains("for 3.0 s"), "{frozen}");

        // The next one tells how the walk began: all that was given before comes anew.
        let mut telling = live(399, Registered, at(399));
        let anew = [(99, First), (199, Registered), (299, Registered)];
        telling.step.anew = anew
            .map(|(ms, outcome)| live(ms, outcome, began).step)
            .into();
        following.take(&telling, at(499));
        let report = following.report();
        assert_eq!((report.registered, report.lost), (4, 0));
        assert!(report.latency_p99_ms >= 100.0, "{report:?}");

        // One that nothing is registered to never began.
        let mut following = Following::default();
        following.take(&live(99, Lost, began), at(5_900));
        let never = following.frozen(began, at(6_000)).expect("a sentence");
        assert!(never.starts_with("No map after 6 s"), "{never}");
    }
}
