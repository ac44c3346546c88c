//! Places where scans do not see all of the motion: the covariance and the report say so, and hold what is off.

use super::super::unseen::UnseenStretches;
use super::room::{self, Room};
use super::*;

/// How a walk went.
struct Walked {
    /// Of each scan but the first: how far its pose is off in its own tangent, relative to the first, with the covariance.
    scans: Vec<(Vector6<f64>, Matrix6<f64>)>,
    stretches: Vec<UnseenStretch>,
}

impl Walked {
    /// Share of poses whose error is within the region in which 95 of 100 should be.
    fn within_95(&self) -> f64 {
        let inside = self.scans.iter().filter(|(error, covariance)| {
            let cholesky = covariance.cholesky().expect("positive definite");
            // Chi squared of six degrees of freedom.
            error.dot(&cholesky.solve(error)) < 12.591_587
        });
        inside.count() as f64 / self.scans.len() as f64
    }

    /// The longest stretch in which motion along a direction of the world is not seen.
    fn longest_along(&self, direction: &Vector3<f64>) -> Option<&UnseenStretch> {
        let along = self.stretches.iter().filter(|s| {
            s.motion == MotionKind::Shift
                && Vector3::from(s.direction_in_world).dot(direction).abs() > 0.95
        });
        along.max_by(|a, b| (a.to_s - a.from_s).total_cmp(&(b.to_s - b.from_s)))
    }
}

fn walk(room: &Room, imu: Option<&ImuNoiseModel>, duration_s: f64, seed: u64) -> Walked {
    let config = OdometryConfig::default();
    let mut odometry = Odometry::new(&config, &room::lidar(), imu).expect("config");
    for sample in room::imu_samples(duration_s + 1.0, seed) {
        odometry.push_imu(&sample);
    }
    let mut stretches = UnseenStretches::default();
    let mut start: Option<(Se3, Se3)> = None;
    let mut scans = Vec::new();
    for i in 0..(duration_s * 10.0) as u64 {
        let scan = room::scan(room, i as f64 * 0.1, i + 1000 * seed);
        let step = odometry.push_scan(&scan).expect("scan");
        let truth = room::world_from_rig(step.time.secs_since(room::time(0.0)));
        let Some((found_start, true_start)) = start else {
            start = Some((step.world_from_rig, truth));
            continue;
        };
        stretches.take(&step);
        let found = found_start.inverse() * step.world_from_rig;
        scans.push((
            found.local(&(true_start.inverse() * truth)),
            step.covariance,
        ));
    }
    Walked {
        scans,
        stretches: stretches.finish(&lsfb_geometry::UnitQuaternion::identity()),
    }
}

#[test]
fn a_room_that_is_seen_well_is_said_to_be() {
    let imu = room::imu();
    let walked = walk(&Room::furnished(), Some(&imu), 6.0, 1);
    assert!(walked.stretches.is_empty(), "{:?}", walked.stretches);
    assert!(walked.within_95() > 0.8, "{}", walked.within_95());
    for (_, covariance) in &walked.scans {
        assert!(covariance[(5, 5)].sqrt() < 0.1, "{covariance}");
    }
}

/// Naively rings on the walls hold the height, and the walk sinks by metres with a covariance of millimetres. What the IMU alone has of it is decimetres off.
#[test]
fn without_a_floor_the_height_is_said_not_to_be_seen() {
    let imu = room::imu();
    let walked = walk(&Room::without_floor(), Some(&imu), 8.0, 1);
    let up = walked.longest_along(&Vector3::z()).expect("said");
    assert!(up.to_s - up.from_s > 6.0, "{up}");
    assert!((0.1..0.3).contains(&up.sigma_at_end), "{up}");
    assert!(walked.within_95() > 0.8, "{}", walked.within_95());
}

/// Naively the walls hold the place along them, by nearest points and by planes that lean by a degree.
#[test]
fn along_a_corridor_without_ends_the_place_is_said_not_to_be_seen() {
    let imu = room::imu();
    for imu in [Some(&imu), None] {
        let walked = walk(&Room::endless_corridor(), imu, 6.0, 1);
        // Without an IMU the start defines the axes.
        let mut along = room::world_from_rig(0.0).rotation.inverse() * Vector3::x();
        if imu.is_some() {
            along = Vector3::x();
        }
        let stretch = walked.longest_along(&along).expect("said");
        assert!(stretch.to_s - stretch.from_s > 3.0, "{stretch}");
        assert!(walked.within_95() > 0.8, "{}", walked.within_95());
    }
}
