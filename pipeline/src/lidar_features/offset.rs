//! By how much a scan lies off the surfaces that the scans of a keyframe saw.

use lsfb_geometry::{Matrix6, Se3, Vector3, Vector6, so3};
use lsfb_perception::lidar::Plane;
use lsfb_solver::gauss_newton::{Next, NormalEquations, minimise};

use super::{LidarFeatures, ScanFeatures};

/// Farthest surface that a point may belong to, metres: what lies farther off is another.
const GATE_M: f64 = 0.3;
/// Distances beyond this count less and less, metres: some centimetres of noise, and what is no plane.
const SCALE_M: f64 = 0.05;
/// Points so near to a surface lie on it, metres.
const ON_SURFACE_M: f64 = 0.08;
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

/// Where less of a scan lies on surfaces than this share of what should, it is looked for around; it is there only where so many times as much does.
const DOUBTFUL: f64 = 0.8;
const CLEARLY: f64 = 1.15;
/// Shifts, metres, and turns about the vertical, radians, from which it is looked for: surfaces that they bring nearer than [`GATE_M`].
const SHIFTS_M: [f64; 4] = [-0.8, -0.4, 0.4, 0.8];
const TURNS_RAD: [f64; 4] = [-0.1, -0.05, 0.05, 0.1];
/// Points and steps of such a search.
const SEARCH_POINTS: usize = 500;
const SEARCH_STEPS: u32 = 5;

/// By how much a scan lies off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanOffset {
    /// What takes the scan to where it fits, in its own frame.
    pub correction: Se3,
    /// How far that moves its points on average, those farther than 8 m brought to 8 m, metres.
    pub moved_m: f64,
    /// Share of its points that then lie on surfaces.
    pub on_surfaces: f64,
    /// By how much the logarithm of the likelihood of its points grows.
    pub evidence: f64,
    /// How much better it fits then: by how much the logarithm of the likelihood of its points grows, for each of those that see the difference, as a
    /// share of what it is for a point that lies so far off. Near one where it did lie off; a fit that went astray gains nothing.
    pub gain: f64,
}

impl LidarFeatures {
    /// Share of a scan's points that lie on the planes here, where it is thought to be.
    pub fn share_on_surfaces(&self, scan: &ScanFeatures, keyframe_from_scan: &Se3) -> f64 {
        let [on, _, asked] = self.count(scan, keyframe_from_scan);
        on as f64 / asked.max(1) as f64
    }

    /// By how much a scan, put where it is thought to be, lies off the planes here; `None` where it shares too few. Where much less of it lies on planes
    /// than the share `expected`, it may belong up to a metre or 6° from there, and is looked for.
    pub fn offset_of(
        &self,
        scan: &ScanFeatures,
        keyframe_from_scan: &Se3,
        expected: f64,
    ) -> Option<ScanOffset> {
        let thought = keyframe_from_scan;
        let settle = |start| {
            let pose = self.fit(scan, thought, start, MOST_POINTS, MOST_STEPS)?;
            self.offset(scan, thought, &pose)
        };
        let here = settle(*thought);
        let share = here.map_or(0.0, |here| here.on_surfaces);
        if share >= DOUBTFUL * expected {
            return here;
        }
        let tried = starts(thought).into_iter().filter_map(|start| {
            let pose = self.fit(scan, thought, start, SEARCH_POINTS, SEARCH_STEPS)?;
            Some((self.share_on_surfaces(scan, &pose), pose))
        });
        let best = tried.max_by(|a, b| a.0.total_cmp(&b.0));
        let there = best.and_then(|(_, pose)| settle(pose));
        there
            .filter(|there| there.on_surfaces > CLEARLY * share)
            .or(here)
    }

    /// The plane that a point seen from `sensor` belongs to, and how far it lies before it, metres.
    fn plane_of(&self, seen: &Vector3<f64>, sensor: &Vector3<f64>) -> Option<(Plane, f64)> {
        let towards = (sensor - seen).try_normalize(0.0)?;
        let plane = self.surfaces.find(seen, &towards, GATE_M, LEAST_COSINE)?;
        Some((plane, plane.normal.dot(&(seen - plane.point))))
    }

    /// Points of a scan that lie on planes, that have one near by, and that were asked.
    fn count(&self, scan: &ScanFeatures, pose: &Se3) -> [usize; 3] {
        let sensor = *pose * scan.sensor_in_rig;
        let [mut on, mut met, mut asked] = [0; 3];
        for point in some_of(scan, MOST_POINTS) {
            asked += 1;
            if let Some((_, off_m)) = self.plane_of(&(*pose * *point), &sensor) {
                met += 1;
                on += usize::from(off_m.abs() < ON_SURFACE_M);
            }
        }
        [on, met, asked]
    }

    /// By how much the logarithm of the likelihood of a scan's points grows from one pose to another, and for each point whose distance from its plane that
    /// changes: a direction that few surfaces hold is judged by these few. Points that meet a plane at one of both alone are no witnesses: at the edge of
    /// a surface, and behind others, as many come as go.
    fn gain(&self, scan: &ScanFeatures, from: &Se3, to: &Se3) -> [f64; 2] {
        let (mut sum, mut sensitive) = (0.0, 0.0);
        for point in some_of(scan, MOST_POINTS) {
            let (before, after) = (*from * *point, *to * *point);
            let Some(along) = (after - before).try_normalize(f64::MIN_POSITIVE) else {
                continue;
            };
            let met_before = self.plane_of(&before, &(*from * scan.sensor_in_rig));
            let met_after = self.plane_of(&after, &(*to * scan.sensor_in_rig));
            if let (Some((_, before_m)), Some((plane, after_m))) = (met_before, met_after) {
                sum += cost(before_m) - cost(after_m);
                sensitive += plane.normal.dot(&along).powi(2);
            }
        }
        [sum, sum / f64::max(sensitive, 1.0)]
    }

    fn offset(&self, scan: &ScanFeatures, thought: &Se3, pose: &Se3) -> Option<ScanOffset> {
        let [on, met, asked] = self.count(scan, pose);
        if met < LEAST_POINTS || (met as f64) < LEAST_SHARE * asked as f64 {
            return None;
        }
        let correction = thought.inverse() * *pose;
        let moved = some_of(scan, MOST_POINTS).map(|point| {
            let near = *point * (NEAR_M / point.norm()).min(1.0);
            (correction * near - near).norm()
        });
        let moved_m = moved.sum::<f64>() / asked as f64;
        let [evidence, gain] = self.gain(scan, thought, pose);
        let of_such = f64::max(cost(moved_m), f64::MIN_POSITIVE);
        Some(ScanOffset {
            correction,
            moved_m,
            on_surfaces: on as f64 / asked as f64,
            evidence,
            gain: gain / of_such,
        })
    }

    /// Moves a scan from `start` to where it fits; `None` where hardly a plane is near.
    fn fit(
        &self,
        scan: &ScanFeatures,
        thought: &Se3,
        start: Se3,
        points: usize,
        steps: u32,
    ) -> Option<Se3> {
        let prior = {
            let (r, t) = (TURN_SIGMA_RAD.powi(-2), SHIFT_SIGMA_M.powi(-2));
            Matrix6::from_diagonal(&Vector6::new(r, r, r, t, t, t))
        };
        let terms = |pose: &Se3| {
            let mut equations = NormalEquations::default();
            let sensor = *pose * scan.sensor_in_rig;
            for point in some_of(scan, points) {
                let Some((plane, off_m)) = self.plane_of(&(*pose * *point), &sensor) else {
                    continue;
                };
                let normal = pose.rotation.inverse() * plane.normal;
                let turned = point.cross(&normal);
                let mut derivative = Vector6::zeros();
                derivative.fixed_rows_mut::<3>(0).copy_from(&turned);
                derivative.fixed_rows_mut::<3>(3).copy_from(&normal);
                let weight = (SCALE_M.powi(2) + off_m * off_m).recip();
                equations.add(off_m, &derivative, weight);
            }
            let correction = thought.inverse() * *pose;
            equations.add_prior(&correction.log(), &prior);
            Some(equations)
        };
        let found = minimise(start, steps, terms, |step| match step.amax() < SETTLED {
            true => Next::Settled,
            false => Next::Iterate,
        });
        Some(found?.value)
    }
}

/// Minus the logarithm of the likelihood of a point so far from its plane.
fn cost(off_m: f64) -> f64 {
    (off_m / SCALE_M).powi(2).ln_1p()
}

/// At most so many points of a scan, evenly taken.
fn some_of(scan: &ScanFeatures, most: usize) -> impl Iterator<Item = &Vector3<f64>> {
    let every = scan.points.len().div_ceil(most).max(1);
    scan.points.iter().step_by(every)
}

/// Where a scan is looked for that does not fit where it is thought to be.
fn starts(thought: &Se3) -> Vec<Se3> {
    let moved = |x: f64, y: f64, z: f64, yaw: f64| {
        let turn = so3::exp(&(Vector3::z() * yaw));
        *thought * Se3::new(turn, Vector3::new(x, y, z))
    };
    let mut starts = Vec::new();
    for a in SHIFTS_M {
        starts.extend([
            moved(a, 0.0, 0.0, 0.0),
            moved(0.0, a, 0.0, 0.0),
            moved(0.0, 0.0, a, 0.0),
        ]);
        starts.extend(SHIFTS_M.map(|b| moved(a, b, 0.0, 0.0)));
    }
    starts.extend(TURNS_RAD.map(|yaw| moved(0.0, 0.0, 0.0, yaw)));
    starts
}
