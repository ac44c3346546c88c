//! What is bright to the LiDAR and to the camera depends on each other where the rig is right:
//! `I = Σ p(a, b) log (p(a, b) / p(a) p(b))` over reflectivity `a` and grey value `b` (Pandey et al., "Automatic Extrinsic
//! Calibration of Vision and Lidar by Maximizing Mutual Information", 2015).

use lsfb_geometry::Se3;

use super::view::{View, seen_at};

/// Bins of reflectivity and of grey value.
const BINS: usize = 20;
/// Returns of a view that count at most.
const MOST_RETURNS: usize = 3000;
/// Returns needed in view.
const MIN_RETURNS: f64 = 100.0;

type Table = [[f64; BINS]; BINS];

/// Bins that hold as many returns each, by reflectivity.
pub(super) fn bins_of(reflectivity: &[u8]) -> [usize; 256] {
    let mut counts = [0usize; 256];
    for r in reflectivity {
        counts[usize::from(*r)] += 1;
    }
    let mut below = 0;
    counts.map(|n| {
        let bin = (below + n / 2) * BINS / reflectivity.len().max(1);
        below += n;
        bin.min(BINS - 1)
    })
}

/// Calls with the bin of each return in view, that of its grey value, and the share of the next.
fn for_each(view: &View, camera_from_rig: &Se3, mut call: impl FnMut(usize, usize, f64)) {
    let every = view.returns.len().div_ceil(MOST_RETURNS).max(1);
    for seen in view.returns.iter().step_by(every) {
        let point = *camera_from_rig * seen.position;
        let Some(gray) = seen_at(&view.edges.gray, &point) else {
            continue;
        };
        // Shared between the two nearest bins, so that the score is smooth.
        let place = (gray / 256.0 * BINS as f64 - 0.5).clamp(0.0, (BINS - 1) as f64 - 1e-9);
        call(seen.bin, place as usize, place.fract());
    }
}

/// Counts of reflectivity and grey value, and of all.
fn counts(views: &[&View], camera_from_rig: &Se3) -> (Table, f64) {
    let mut joint = [[0.0; BINS]; BINS];
    let mut total = 0.0;
    for view in views {
        for_each(view, camera_from_rig, |a, b, share| {
            joint[a][b] += 1.0 - share;
            joint[a][b + 1] += share;
            total += 1.0;
        });
    }
    (joint, total)
}

/// `L(a, b)`; zero where nothing was seen.
fn log_ratios(joint: &Table, total: f64) -> Table {
    let by_gray: [f64; BINS] = std::array::from_fn(|b| joint.iter().map(|row| row[b]).sum());
    joint.map(|row| {
        let by_reflectivity: f64 = row.iter().sum();
        std::array::from_fn(|b| {
            if row[b] > 0.0 {
                (row[b] * total / (by_reflectivity * by_gray[b])).ln()
            } else {
                0.0
            }
        })
    })
}

/// Mutual information of reflectivity and grey value, nats.
pub(super) fn mutual_information(views: &[&View], camera_from_rig: &Se3) -> f64 {
    let (joint, total) = counts(views, camera_from_rig);
    if total < MIN_RETURNS {
        return 0.0;
    }
    let ratios = log_ratios(&joint, total);
    let pairs = joint.iter().flatten().zip(ratios.iter().flatten());
    pairs.map(|(n, l)| n / total * l).sum()
}
