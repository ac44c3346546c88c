//! The first second of a walk: all that is mapped later inherits what goes wrong in it.
//!
//! A map of one scan is rings, and a scan that sways with the carrier lies on them as if it did not. So while the carrier stands it is
//! held by its IMU, and in its first second of motion scans count little.
//!
//! Nothing tells the velocity of a carrier that moves in its first scan until the second is there: undone with none at all, a scan at a metre a
//! second is smeared by a decimetre, and all that follows is registered to it. And whether it stood in the first tenth of a second
//! is known only later. So scans of the first second are kept, and where one tells that it did not stand the walk begins again, until
//! the velocity at its start and that at which the scan is found agree. Without an IMU that is so of turn and velocity together.

use lsfb_geometry::{StampedPose, Vector3, Vector6};
use lsfb_perception::lidar::{PosePrior, ScanFinder, observability, register};
use lsfb_types::{ImuSample, LidarScan, Stamped};

use super::degeneracy::LEAST_SEEN_PER_M2;
use super::motion::{Motion, StartVelocity, end_pose};
use super::{MIN_GATE_M, Odometry, OdometryStep, ReducedScan, StepOutcome};
use crate::Error;

/// Beginnings that are tried; each is wrong by a small part of the one before.
const ROUNDS: usize = 6;
/// Velocities that agree, m/s.
const AGREE_M_S: f64 = 0.01;
/// The same without an IMU: what registration makes of a scan in a tenth of a second; and of turns, rad/s.
const EVEN_M_S: f64 = 0.05;
const EVEN_RAD_S: f64 = 0.02;
/// How much of what the next scan tells is taken at a time. A first scan that is undone too slowly is smeared, by nothing at its end and by
/// all of its motion at its beginning, so the next is found half as much too far.
const EVEN_SHARE: f64 = 2.0 / 3.0;
/// Two scans further apart than this tell a mean velocity, not that of the first, where the first moved, seconds.
const FAR_APART_S: f64 = 0.5;
/// Of a velocity of which nothing is known, m/s.
const UNKNOWN_M_S: f64 = 2.0;
/// How far two scans may be registered wrongly, metres.
const REGISTERED_M: f64 = 0.02;

/// How long scans are kept, and count little, seconds.
const SECOND_S: f64 = 1.0;
/// Who sets off sooner than this may have moved in the first scan, seconds.
const SOON_S: f64 = 0.5;
/// A carrier whose scan lies farther off than this has moved, metres.
const MOVED_M: f64 = 0.03;
/// The same of a turn, radians.
const TURNED_RAD: f64 = 0.02;
/// So many times more points of a scan that counts little share an error: they hold the pose to a third of a degree and some centimetres, no
/// better than the IMU does.
const SHARED_BY: f64 = 900.0;
/// The same while the carrier stands: nothing but that it does not turn away over minutes.
const SHARED_AT_REST: f64 = 90_000.0;

/// The odometry as it was before its first scan, and the scans since.
#[derive(Clone, Debug)]
pub(super) struct FirstSecond {
    blank: Box<Odometry>,
    scans: Vec<Stamped<LidarScan>>,
    /// Whether it stood in the first, by its IMU.
    stood: bool,
}

impl FirstSecond {
    /// Takes the first scan.
    pub fn begin(
        odometry: &mut Odometry,
        scan: &Stamped<LidarScan>,
    ) -> Result<OdometryStep, Error> {
        let blank = Box::new(odometry.clone());
        let mut step = odometry.take_scan(scan)?;
        let is_timed = scan.sample.points.iter().any(|p| p.time_offset_ns > 0);
        let stood = odometry.stands();
        if stood || is_timed {
            if !stood && matches!(odometry.motion, Motion::Inertial(_)) {
                // How it got to the end of its first scan nobody knows yet.
                step.poses.drain(..step.poses.len().saturating_sub(1));
            }
            odometry.first_second = Some(Self {
                blank,
                scans: vec![scan.clone()],
                stood,
            });
        }
        Ok(step)
    }

    /// Takes a sample that came after the first scan.
    pub fn push_imu(&mut self, sample: &Stamped<ImuSample>) {
        self.blank.push_imu(sample);
    }

    /// Takes the next scan.
    pub fn go_on(
        mut self,
        odometry: &mut Odometry,
        scan: &Stamped<LidarScan>,
    ) -> Result<OdometryStep, Error> {
        if !self.stood {
            let begun = match odometry.motion {
                Motion::Inertial(_) => self.begun_again(scan, FAR_APART_S),
                Motion::Constant { .. } => self.begun_evenly(scan),
            };
            if let Some((begun, anew)) = begun {
                *odometry = begun;
                return odometry.take_scan(scan).map(|step| step.instead_of(anew));
            }
            return odometry.take_scan(scan);
        }
        let passed_s = scan.time.secs_since(self.first().time);
        let step = odometry.take_scan(scan);
        let felt = !odometry.stands() && !odometry.unfelt && passed_s < SOON_S;
        odometry.began_unfelt = odometry.unfelt;
        if (felt || odometry.unfelt)
            && let Some((mut begun, anew)) = self.begun_again(scan, SECOND_S)
        {
            begun.began_unfelt = odometry.unfelt;
            *odometry = begun;
            return odometry.take_scan(scan).map(|step| step.instead_of(anew));
        }
        if odometry.stands() && passed_s < SECOND_S {
            if step.is_ok() {
                self.scans.push(scan.clone());
            }
            odometry.first_second = Some(self);
        }
        step
    }

    fn first(&self) -> &Stamped<LidarScan> {
        &self.scans[0]
    }

    /// The odometry as it is before a scan that tells how it began, and the steps to there. `None` where that scan, or the first, tells
    /// nothing of the velocity.
    fn begun_again(
        &self,
        telling: &Stamped<LidarScan>,
        far_apart_s: f64,
    ) -> Option<(Odometry, Vec<OdometryStep>)> {
        let apart_s = telling.time.secs_since(self.first().time);
        if !(apart_s > 0.0 && apart_s <= far_apart_s) {
            return None;
        }
        let mut start = StartVelocity {
            velocity_m_s: Vector3::zeros(),
            sigma_m_s: UNKNOWN_M_S,
        };
        for _ in 0..ROUNDS {
            let (begun, _) = self.begin_with(start)?;
            let end = begun.end_of(telling).ok()?;
            let mut predicted = begun.clone();
            let path = predicted.predict(telling.time, end).ok()?;
            let mut found = begun.clone();
            let step = found.take_scan(telling).ok()?;
            if step.outcome != StepOutcome::Registered {
                return None;
            }
            let span_s = end.secs_since(begun.last?.time);
            let missed_m = step.by_scan_alone.translation - end_pose(&path).translation;
            let change = missed_m / span_s;
            start.velocity_m_s += change;
            start.sigma_m_s = (2.0 * change.norm()).clamp(REGISTERED_M / span_s, 0.5 * UNKNOWN_M_S);
            if change.norm() < AGREE_M_S {
                let (mut begun, step) = self.begin_with(start)?;
                let mut steps = vec![step];
                for scan in &self.scans[1..] {
                    steps.push(begun.take_scan(scan).ok()?);
                }
                return Some((begun, steps));
            }
        }
        None
    }

    /// The same without an IMU: it moved in the first scan as it did from there to the next. `None` also where it hardly moved.
    fn begun_evenly(&self, next: &Stamped<LidarScan>) -> Option<(Odometry, Vec<OdometryStep>)> {
        let apart_s = next.time.secs_since(self.first().time);
        if !(apart_s > 0.0 && apart_s <= FAR_APART_S) {
            return None;
        }
        let mut twist_per_s = Vector6::zeros();
        for round in 0..=ROUNDS {
            let mut begun = (*self.blank).clone();
            if let Motion::Constant {
                twist_per_s: of, ..
            } = &mut begun.motion
            {
                *of = twist_per_s;
            }
            let first = begun.take_scan(self.first()).ok()?;
            let mut found = begun.clone();
            let step = found.take_scan(next).ok()?;
            if step.outcome != StepOutcome::Registered {
                return None;
            }
            let span_s = step.time.secs_since(first.time);
            let moved = first.world_from_rig.local(&step.world_from_rig) / span_s;
            let change = moved - twist_per_s;
            let turned_rad_s = change.fixed_rows::<3>(0).norm();
            let moved_m_s = change.fixed_rows::<3>(3).norm();
            if round == 0 && turned_rad_s * span_s < TURNED_RAD && moved_m_s * span_s < MOVED_M {
                return None;
            }
            if turned_rad_s < EVEN_RAD_S && moved_m_s < EVEN_M_S {
                return Some((begun, vec![first]));
            }
            twist_per_s += change * EVEN_SHARE;
        }
        None
    }

    /// After the first scan, with a start velocity.
    fn begin_with(&self, start: StartVelocity) -> Option<(Odometry, OdometryStep)> {
        let mut begun = (*self.blank).clone();
        if let Motion::Inertial(inertial) = &mut begun.motion {
            inertial.start = Some(start);
        }
        let step = begun.take_scan(self.first()).ok()?;
        if start.sigma_m_s < UNKNOWN_M_S {
            // What the next scan is matched with is near: between the rings of one scan other surfaces are nearest.
            begun.corrections_m = [REGISTERED_M; 3].into();
            begun.unsteady_until = Some(step.time.plus_secs(SECOND_S));
        }
        Some((begun, step))
    }
}

impl Odometry {
    /// Whether the carrier has not moved since the start, by its IMU.
    pub(super) fn stands(&self) -> bool {
        match &self.motion {
            Motion::Inertial(inertial) => inertial.filter.as_ref().is_some_and(|f| f.stands()),
            Motion::Constant { .. } => false,
        }
    }

    /// Sees to it that a scan counts as it should in the first second: little while the carrier stands, and for a second then.
    pub(super) fn steady(&mut self, reduced: &ReducedScan, path: &[StampedPose]) {
        let Some(end) = path.last() else {
            return;
        };
        if self.stands() {
            if self.has_moved(reduced, path) {
                self.unfelt = true;
                if let Motion::Inertial(inertial) = &mut self.motion
                    && let Some(filter) = &mut inertial.filter
                {
                    filter.stands_no_more();
                }
                self.unsteady_until = None;
            } else {
                self.unsteady_until = Some(end.time.plus_secs(SECOND_S));
            }
        }
        self.shared_by = match self.unsteady_until {
            _ if self.stands() => SHARED_AT_REST,
            Some(until) if end.time <= until => SHARED_BY,
            _ => 1.0,
        };
    }

    /// Whether a scan lies off where the carrier would stand, by planes alone: nearest points hold it where it was.
    fn has_moved(&self, reduced: &ReducedScan, path: &[StampedPose]) -> bool {
        if self.map.is_empty() {
            return false;
        }
        let prior = PosePrior {
            world_from_rig: end_pose(path),
            information: nalgebra::Matrix6::identity(),
        };
        let config = self.config.registration(&self.lidar, MIN_GATE_M);
        let sensor_in_rig = self.lidar.rig_from_lidar.translation;
        let points = &reduced.keypoints;
        let mut finder = ScanFinder::new(&self.map, points, &sensor_in_rig);
        let found = register(points, &prior, &config, |pose, gate_m| {
            finder.find_planes(pose, gate_m)
        });
        let planes = |points: &[Vector3<f64>], pose: &lsfb_geometry::Se3, gate_m| {
            let mut finder = ScanFinder::new(&self.map, points, &sensor_in_rig);
            finder.find_planes(pose, gate_m)
        };
        let shift_m = 0.5 * self.config.finest_cell_m();
        let Some(seen) = observability(points, &found, &config, shift_m, planes) else {
            return false;
        };
        let r = seen.usual_range_m;
        let off = prior.world_from_rig.local(&found.world_from_rig);
        let off_m = off.component_mul(&Vector6::new(r, r, r, 1.0, 1.0, 1.0));
        let seen = seen
            .directions
            .iter()
            .filter(|d| d.seen_per_m2() > LEAST_SEEN_PER_M2);
        let seen: Vector6<f64> = seen.map(|d| d.along * d.along.dot(&off_m)).sum();
        let turned_rad = seen.fixed_rows::<3>(0).norm() / r;
        let moved_m = seen.fixed_rows::<3>(3).norm();
        found.inlier_ratio > self.config.min_inlier_ratio
            && (moved_m > MOVED_M || turned_rad > TURNED_RAD)
    }
}
