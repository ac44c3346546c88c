//! Whether the times of a scan's points are believed: a wrong unit shows in how long the scan would take against the time between
//! scans. And times by azimuth, for sensors that spin.

use std::f64::consts::{PI, TAU};

use lsfb_recording::cloud::PointTimes;
use lsfb_types::{LidarPoint, LidarScan, Stamped};
use serde::{Deserialize, Serialize};

use super::ring_order::{AzimuthProblem, azimuth_rad, rings_are_cones, times_by_ring};
use super::warning::OdometryWarning;

/// A scan, and where the times of its points come from.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedScan {
    /// The scan; its time is when the offsets of its points are zero.
    pub scan: Stamped<LidarScan>,
    /// Where these offsets come from.
    pub times: PointTimes,
}

/// How motion within scans was undone, in numbers of scans.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeskewReport {
    /// By the times of their points.
    pub by_times: u64,
    /// By the azimuths of their points.
    pub by_azimuth: u64,
    /// Of the latter, those that are ordered ring by ring.
    #[serde(default)]
    pub ring_by_ring: u64,
    /// Of those by azimuth that are in firing order, those whose points carry no numbers of rings: nothing tells whether they had been deskewed before.
    #[serde(default)]
    pub unnumbered: u64,
    /// Not at all: nothing says when their points were measured.
    pub none: u64,
    /// Of the latter, those whose times would have them last longer than until the scan behind them.
    pub not_believed: u64,
    /// The field of times, where there is one.
    pub field: Option<String>,
    /// Why the azimuths of the first of those that were not deskewed tell nothing, where they were to stand for times.
    #[serde(default)]
    pub azimuths: Option<AzimuthProblem>,
}

impl DeskewReport {
    /// What the reader should know.
    pub(super) fn warnings(&self) -> Vec<OdometryWarning> {
        let of = self.by_times + self.by_azimuth + self.none;
        let not_deskewed = (self.none > 0).then(|| OdometryWarning::NotDeskewed {
            scans: self.none,
            of,
            field: self.field.clone(),
            not_believed: self.not_believed,
            azimuths: self.azimuths,
        });
        let by_azimuth = (self.by_azimuth > 0).then_some(OdometryWarning::DeskewedByAzimuth {
            scans: self.by_azimuth,
            of,
            ring_by_ring: self.ring_by_ring,
            unnumbered: self.unnumbered,
        });
        not_deskewed.into_iter().chain(by_azimuth).collect()
    }
}

/// A scan lasts at most so many times as long as the time from scan to scan: sensors that overlap a little, and jitter of stamps.
const MAX_SPAN_PERIODS: f64 = 1.5;
/// Intervals between scans that are looked back at.
const INTERVALS: usize = 15;
/// A turn that is not whole, and beams of one firing that look to different sides, radians.
const MIN_TURN_RAD: f64 = 0.7 * TAU;
const MAX_TURN_RAD: f64 = 1.1 * TAU;
const MAX_BEAM_OFFSET_RAD: f64 = 0.4;
/// No sensor turns more slowly; where scans are rarer some are missing, and a turn takes the usual time (10 Hz), nanoseconds.
const SLOWEST_TURN_NS: i64 = 250_000_000;
const USUAL_TURN_NS: i64 = 100_000_000;

/// Holds each scan back until the next one tells how long it can have taken.
#[derive(Default)]
pub(super) struct PointClock {
    /// Whether azimuths may stand for times.
    pub azimuths_are_times: bool,
    pub report: DeskewReport,
    held: Option<TimedScan>,
    /// Between the scans lately, nanoseconds.
    intervals_ns: Vec<i64>,
}

impl PointClock {
    /// Takes a scan and gives the one before it.
    pub fn push(&mut self, scan: TimedScan) -> Option<Stamped<LidarScan>> {
        let start = scan.scan.time;
        let held = self.held.replace(scan)?;
        let interval_ns = start - held.scan.time;
        if interval_ns > 0 {
            if self.intervals_ns.len() == INTERVALS {
                self.intervals_ns.remove(0);
            }
            self.intervals_ns.push(interval_ns);
        }
        Some(self.timed(held))
    }

    /// Gives the last scan.
    pub fn finish(&mut self) -> Option<Stamped<LidarScan>> {
        self.held.take().map(|held| self.timed(held))
    }

    /// The usual time from scan to scan, nanoseconds; `None` for a single scan.
    fn period_ns(&self) -> Option<i64> {
        let mut sorted = self.intervals_ns.clone();
        sorted.sort_unstable();
        sorted.get(sorted.len() / 2).copied()
    }

    fn timed(&mut self, held: TimedScan) -> Stamped<LidarScan> {
        let TimedScan { mut scan, times } = held;
        let points = &mut scan.sample.points;
        let period_ns = self.period_ns();
        let last_ns = points.iter().map(|p| p.time_offset_ns).max().unwrap_or(0);
        let first_ns = points.iter().map(|p| p.time_offset_ns).min().unwrap_or(0);
        if let PointTimes::Field { name, .. } | PointTimes::Unusable { name } = &times {
            self.report.field.get_or_insert_with(|| name.clone());
        }
        let fits = period_ns
            .is_none_or(|period| f64::from(last_ns - first_ns) <= MAX_SPAN_PERIODS * period as f64);
        let timed = matches!(times, PointTimes::Field { .. });
        if timed && fits {
            self.report.by_times += 1;
            return scan;
        }
        self.report.not_believed += u64::from(timed);
        let period_ns = period_ns.filter(|_| self.azimuths_are_times);
        let by_azimuth = period_ns.and_then(|period_ns| self.by_azimuth(points, period_ns));
        match &by_azimuth {
            Some(_) => self.report.by_azimuth += 1,
            None => self.report.none += 1,
        }
        let offsets = by_azimuth.into_iter().flatten().chain(std::iter::repeat(0));
        for (point, offset_ns) in points.iter_mut().zip(offsets) {
            point.time_offset_ns = offset_ns;
        }
        scan
    }

    fn by_azimuth(&mut self, points: &[LidarPoint], period_ns: i64) -> Option<Vec<u32>> {
        let turn_ns = turn_ns(period_ns);
        let times_ns = match times_by_azimuth(points, turn_ns) {
            Some(times_ns) => match rings_are_cones(points) {
                Some(false) => Err(AzimuthProblem::Moved),
                told => {
                    self.report.unnumbered += u64::from(told.is_none());
                    Ok(times_ns)
                }
            },
            None => {
                let times_ns = times_by_ring(points, turn_ns);
                self.report.ring_by_ring += u64::from(times_ns.is_ok());
                times_ns
            }
        };
        match times_ns {
            Ok(times_ns) => Some(times_ns),
            Err(problem) => {
                self.report.azimuths.get_or_insert(problem);
                None
            }
        }
    }
}

/// How long a turn takes where a scan comes every `period_ns`: of clouds that were thinned out in time many turns are missing.
fn turn_ns(period_ns: i64) -> i64 {
    if period_ns <= SLOWEST_TURN_NS {
        return period_ns;
    }
    period_ns / ((period_ns + USUAL_TURN_NS / 2) / USUAL_TURN_NS)
}

/// Nanoseconds after the first point for each, of one turn in `period_ns`, clockwise seen from above as all known sensors spin. `None`
/// where the points are not in the order of such a turn: they were sorted since, or they are not of a sensor that spins.
fn times_by_azimuth(points: &[LidarPoint], period_ns: i64) -> Option<Vec<u32>> {
    let mut last_azimuth = None;
    let mut turned_rad = 0.0;
    let mut farthest_rad: f64 = 0.0;
    let mut turns = Vec::with_capacity(points.len());
    for point in points {
        if let Some(azimuth) = azimuth_rad(point) {
            if let Some(last) = last_azimuth {
                let step: f64 = azimuth - last;
                turned_rad += (step + PI).rem_euclid(TAU) - PI;
            }
            last_azimuth = Some(azimuth);
        }
        farthest_rad = farthest_rad.max(turned_rad);
        if turned_rad < farthest_rad - MAX_BEAM_OFFSET_RAD {
            return None;
        }
        turns.push(turned_rad);
    }
    let first_rad = turns.iter().copied().fold(f64::INFINITY, f64::min);
    if !(MIN_TURN_RAD..=MAX_TURN_RAD).contains(&(farthest_rad - first_rad)) {
        return None;
    }
    let offset_ns = |turn: f64| ((turn - first_rad) / TAU * period_ns as f64).round() as u32;
    Some(turns.into_iter().map(offset_ns).collect())
}

#[cfg(test)]
mod tests {
    use lsfb_recording::cloud::TimesBegin;
    use lsfb_types::Timestamp;

    use super::*;

    /// A turn of a sensor with two beams that look to different sides, at so many tenths of a second.
    fn turn(tenths: i64, sign: f64, times_ns: impl Fn(u32) -> u32) -> TimedScan {
        let point = |k: u32| {
            let beam = if k.is_multiple_of(2) { 0.05 } else { -0.05 };
            let azimuth = sign * TAU * f64::from(k) / 1000.0 + beam + 1.0;
            LidarPoint {
                position_m: [5.0 * azimuth.cos() as f32, 5.0 * azimuth.sin() as f32, 0.0],
                time_offset_ns: times_ns(k),
                ..Default::default()
            }
        };
        let time = Timestamp::from_nanos(tenths * 100_000_000);
        TimedScan {
            scan: Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: LidarScan {
                    points: (0..1000).map(point).collect(),
                },
            },
            times: PointTimes::Field {
                name: "time".to_owned(),
                begins: TimesBegin::AfterStamp { nanos: 0 },
            },
        }
    }

    fn run(clock: &mut PointClock, scans: impl IntoIterator<Item = TimedScan>) -> Vec<u32> {
        let mut ready: Vec<_> = scans.into_iter().filter_map(|s| clock.push(s)).collect();
        ready.extend(clock.finish());
        let last = ready.last().expect("scans");
        last.sample
            .points
            .iter()
            .map(|p| p.time_offset_ns)
            .collect()
    }

    #[test]
    fn times_that_last_longer_than_the_period_are_not_believed() {
        let mut clock = PointClock::default();
        let right = run(&mut clock, (0..4).map(|i| turn(i, -1.0, |k| k * 100_000)));
        assert_eq!(right[999], 99_900_000);
        assert_eq!((clock.report.by_times, clock.report.none), (4, 0));
        assert!(clock.report.warnings().is_empty());

        // Scans of a millisecond in microseconds: as times of a slow sensor they look well by themselves.
        let mut clock = PointClock::default();
        let wrong = run(&mut clock, (0..4).map(|i| turn(i, -1.0, |k| k * 1_000_000)));
        assert_eq!(wrong[999], 0);
        assert_eq!((clock.report.by_times, clock.report.not_believed), (0, 4));
        let [warning] = &clock.report.warnings()[..] else {
            panic!("one warning: {:?}", clock.report)
        };
        let said = warning.finding().what;
        assert!(
            said.contains("`time`") && said.contains("4 of 4 scans are not deskewed"),
            "{said}"
        );
    }

    #[test]
    fn azimuths_are_times_only_in_the_order_of_a_turn() {
        let untimed = |i, sign| TimedScan {
            times: PointTimes::Absent,
            ..turn(i, sign, |_| 0)
        };
        let with = |sign: f64| {
            let mut clock = PointClock {
                azimuths_are_times: true,
                ..PointClock::default()
            };
            let times = run(&mut clock, (0..4).map(|i| untimed(i, sign)));
            (times, clock.report)
        };
        let (times, report) = with(-1.0);
        assert_eq!((report.by_azimuth, report.none), (4, 0));
        for (k, time_ns) in times.iter().enumerate() {
            // The beams look to either side of the head.
            assert!(
                time_ns.abs_diff(k as u32 * 100_000) < 2_000_000,
                "{k}: {time_ns}"
            );
        }
        assert_eq!((report.ring_by_ring, report.azimuths), (0, None));
        assert_eq!(report.unnumbered, 4);
        let said = report.warnings()[0].finding().what;
        assert!(said.contains("nothing tells whether"), "{said}");
        let (times, report) = with(1.0);
        assert_eq!((times[500], report.by_azimuth, report.none), (0, 0, 4));
        assert_eq!(report.azimuths, Some(AzimuthProblem::Order));
        let said = report.warnings()[0].finding().what;
        assert!(said.contains("neither in firing order nor ring"), "{said}");
    }

    /// In firing order a cloud that was deskewed already was deskewed once more.
    #[test]
    fn scans_in_firing_order_that_were_deskewed_are_not_deskewed_again() {
        // 16 rings of numbers and elevations of their own, as fired, and after a carrier pitched by so much per turn.
        let fired = |tenths: i64, pitched_rad: f32| {
            let mut scan = turn(tenths, -1.0, |_| 0);
            scan.times = PointTimes::Absent;
            for (k, point) in scan.scan.sample.points.iter_mut().enumerate() {
                point.ring = (k % 16) as u16;
                let [x, y, _] = point.position_m;
                let z = 5.0 * (2.0 * f32::from(point.ring) - 15.0).to_radians().tan();
                let (sin, cos) = (pitched_rad * k as f32 / 1000.0).sin_cos();
                point.position_m = [cos * x + sin * z, y, cos * z - sin * x];
            }
            scan
        };
        let report_of = |pitched_rad| {
            let mut clock = PointClock {
                azimuths_are_times: true,
                ..PointClock::default()
            };
            run(&mut clock, (0..4).map(|i| fired(i, pitched_rad)));
            clock.report
        };
        let raw = report_of(0.0);
        assert_eq!((raw.by_azimuth, raw.unnumbered, raw.azimuths), (4, 0, None));
        let said = raw.warnings()[0].finding().what;
        assert!(!said.contains("nothing tells"), "{said}");
        let deskewed = report_of(0.03);
        assert_eq!((deskewed.by_azimuth, deskewed.none), (0, 4));
        assert_eq!(deskewed.azimuths, Some(AzimuthProblem::Moved));
    }

    /// Of scans thinned out to one in five seconds a turn was taken to last five seconds.
    #[test]
    fn a_turn_of_scans_that_were_thinned_out_takes_a_tenth_of_a_second() {
        let mut clock = PointClock {
            azimuths_are_times: true,
            ..PointClock::default()
        };
        let untimed = |i: i64| TimedScan {
            times: PointTimes::Absent,
            ..turn(50 * i, -1.0, |_| 0)
        };
        let times = run(&mut clock, (0..4).map(untimed));
        assert_eq!(clock.report.by_azimuth, 4);
        assert!(
            times[999].abs_diff(99_900_000) < 2_000_000,
            "{}",
            times[999]
        );
        // A slow sensor's turn is what its scans are apart.
        assert_eq!(
            [turn_ns(200_000_000), turn_ns(50_000_000)],
            [200_000_000, 50_000_000]
        );
        // 50 turns of a VLP-16 of 76 packets each.
        assert_eq!(turn_ns(5_042_900_000), 100_858_000);
    }
}
