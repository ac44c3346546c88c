//! Scans of a recording, thinned out.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use lsfb_geometry::Vector3;
use lsfb_recording::Recording;
use lsfb_types::{LidarPoint, Progress, ProgressFn};

use crate::Error;
use crate::recorded::{seconds, unreadable};

/// Returns nearer than this are the rig's own; those beyond say little, metres.
const RANGE_M: std::ops::Range<f64> = 0.4..200.0;
/// Returns of a scan that are used at most, and that it needs.
const MOST_RETURNS: usize = 12_000;
const LEAST_RETURNS: usize = 150;
/// Directions are told apart by elevation in bins of this, degrees: few beams see floor and ceiling.
const ELEVATION_DEG: f64 = 1.0;

/// A return.
#[derive(Clone, Copy)]
pub(super) struct Return {
    /// After the scan's first firing, nanoseconds.
    pub offset_ns: u32,
    pub in_lidar: Vector3<f64>,
}

/// A scan, thinned out.
pub(super) struct Scan {
    /// Time of its first firing.
    pub start_s: f64,
    pub middle_s: f64,
    pub returns: Vec<Return>,
}

/// Scans of the first so many seconds, thinned out.
pub(super) fn read(
    recording: &Recording,
    longest_s: f64,
    progress: ProgressFn,
) -> Result<Vec<Scan>, Error> {
    let mut out: Vec<Scan> = Vec::new();
    for scan in recording.scans().map_err(unreadable(recording))? {
        let scan = scan.map_err(unreadable(recording))?;
        let start_s = seconds(scan.time.nanos(), recording);
        if out
            .first()
            .is_some_and(|f| start_s - f.middle_s > longest_s)
        {
            break;
        }
        let points = &scan.sample.points;
        let (first, last) = points
            .iter()
            .map(|p| p.time_offset_ns)
            .fold((u32::MAX, 0), |(a, b), t| (a.min(t), b.max(t)));
        let middle_s = start_s + 0.5e-9 * (f64::from(first.min(last)) + f64::from(last));
        if out.last().is_some_and(|l| middle_s <= l.middle_s) {
            continue;
        }
        let placed = thinned(points).into_iter().map(|p| Return {
            offset_ns: p.time_offset_ns,
            in_lidar: Vector3::from(p.position_m).map(f64::from),
        });
        let returns: Vec<Return> = placed.collect();
        if returns.len() >= LEAST_RETURNS {
            out.push(Scan {
                start_s,
                middle_s,
                returns,
            });
        }
        progress(Progress {
            stage: "scans",
            done: out.len() as u64,
            total: 0,
        })?;
    }
    Ok(out)
}

/// Returns of a scan, as many by elevation where there are so many: what sees floor and ceiling is kept.
fn thinned(points: &[LidarPoint]) -> Vec<&LidarPoint> {
    let mut bins = BTreeMap::<i32, Vec<&LidarPoint>>::new();
    for point in points {
        let [x, y, z] = point.position_m.map(f64::from);
        let elevation_deg = z.atan2(x.hypot(y)).to_degrees();
        if RANGE_M.contains(&x.hypot(y).hypot(z)) {
            let bin = (elevation_deg / ELEVATION_DEG).floor() as i32;
            bins.entry(bin).or_default().push(point);
        }
    }
    // The fullest bins give up most.
    let mut sizes: Vec<usize> = bins.values().map(Vec::len).collect();
    sizes.sort_unstable();
    let (mut left, mut cap) = (MOST_RETURNS, usize::MAX);
    for (k, size) in sizes.iter().enumerate() {
        let share = left / (sizes.len() - k);
        if *size > share {
            cap = share.max(1);
            break;
        }
        left -= size;
    }
    let kept = bins.values().flat_map(|bin| {
        let every = bin.len().div_ceil(cap).max(1);
        bin.iter().copied().step_by(every)
    });
    kept.collect()
}

impl Scan {
    /// Time of a return.
    pub fn time_s(&self, offset_ns: i64) -> f64 {
        self.start_s + offset_ns as f64 * 1e-9
    }

    /// From the first return to the last one, after the first firing.
    pub fn span_ns(&self) -> RangeInclusive<i64> {
        let offsets = || self.returns.iter().map(|r| i64::from(r.offset_ns));
        offsets().min().unwrap_or(0)..=offsets().max().unwrap_or(0)
    }
}
