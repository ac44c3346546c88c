//! By how much a scan lies off the surfaces that the scans of a keyframe saw.

use lsfb_geometry::{Matrix6, Se3, Vector6};
use lsfb_perception::gauss_newton::{Next, NormalEquations, minimise};

use super::{LidarFeatures, ScanFeatures};

/// Farthest surface that a point may belong to, metres: what lies farther off is another.
const GATE_M: f64 = 0.3;
/// Distances beyond this count less and less, metres: some centimetres of noise, and what is no plane.
const SCALE_M: f64 = 0.05;
/// Surfaces are met from the front, cosine.
const LEAST_COSINE: f64 = 0.1;
/// Fewer points on surfaces, of all or as a share, tell nothing.
const LEAST_POINTS: usize = 200;
const LEAST_SHARE: f64 = 0.2;
/// More points tell nothing new.
const MOST_POINTS: usize = 2_000;
/// What lies farther off counts as if it lay here, metres: a turn that nobody notices in a room moves what is seen across a park by centimetres.
const NEAR_M: f64 = 8.0;
/// Steps at most, and the last that matters, radians and metres.
const MOST_STEPS: u32 = 8;
const SETTLED: f64 = 2e-4;
/// What is thought possible beforehand, 1 σ: it holds directions that the surfaces do not.
const TURN_SIGMA_RAD: f64 = 0.03;
const SHIFT_SIGMA_M: f64 = 0.1;

/// By how much a scan lies off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanOffset {
    /// What takes the scan to where it fits, in its own frame.
    pub correction: Se3,
    /// How far that moves its points on average, those farther than 8 m brought to 8 m, metres.
    pub moved_m: f64,
}

impl LidarFeatures {
    /// By how much a scan, put where it is thought to be, lies off the planes here; `None` where it shares too few.
    pub fn offset_of(&self, scan: &ScanFeatures, keyframe_from_scan: &Se3) -> Option<ScanOffset> {
        let every = scan.points.len().div_ceil(MOST_POINTS).max(1);
        let points = || scan.points.iter().step_by(every);
        let prior = {
            let (r, t) = (TURN_SIGMA_RAD.powi(-2), SHIFT_SIGMA_M.powi(-2));
            Matrix6::from_diagonal(&Vector6::new(r, r, r, t, t, t))
        };
        let mut moved_m = 0.0;
        let terms = |pose: &Se3| {
            let mut equations = NormalEquations::default();
            let sensor = *pose * scan.sensor_in_rig;
            let correction = keyframe_from_scan.inverse() * *pose;
            let (mut met, mut asked, mut sum_m) = (0, 0, 0.0);
            for point in points() {
                asked += 1;
                let seen = *pose * *point;
                let Some(towards) = (sensor - seen).try_normalize(0.0) else {
                    continue;
                };
                let plane = self.surfaces.find(&seen, &towards, GATE_M, LEAST_COSINE);
                let Some(plane) = plane else { continue };
                let off_m = plane.normal.dot(&(seen - plane.point));
                let normal = pose.rotation.inverse() * plane.normal;
                let turned = point.cross(&normal);
                let mut derivative = Vector6::zeros();
                derivative.fixed_rows_mut::<3>(0).copy_from(&turned);
                derivative.fixed_rows_mut::<3>(3).copy_from(&normal);
                let weight = (SCALE_M.powi(2) + off_m * off_m).recip();
                equations.add(off_m, &derivative, weight);
                let near = *point * (NEAR_M / point.norm()).min(1.0);
                sum_m += (correction * near - near).norm();
                met += 1;
            }
            if met < LEAST_POINTS || (met as f64) < LEAST_SHARE * asked as f64 {
                return None;
            }
            moved_m = sum_m / met as f64;
            equations.add_prior(&correction.log(), &prior);
            Some(equations)
        };
        let found = minimise(*keyframe_from_scan, MOST_STEPS, terms, |step| {
            match step.amax() < SETTLED {
                true => Next::Settled,
                false => Next::Iterate,
            }
        })?;
        Some(ScanOffset {
            correction: keyframe_from_scan.inverse() * found.value,
            moved_m,
        })
    }
}
