//! Where scans do not see motion along a direction, the accelerometer alone has it. Whether that is right along it the scans tell where they see such motion elsewhere
//! on the walk. Where they never do, an axis that is turned round shows in nothing: then poses may be as far on the other side of where the stretch began, and
//! covariances say so.

use lsfb_geometry::{Matrix3, Vector3};

use super::OdometryResult;
use crate::odometry::{MotionKind, OdometryWarning};

/// What is less is within other errors, metres.
const LEAST_M: f64 = 0.1;

/// Widens covariances by what nothing tells, and says so.
pub(super) fn widen(result: &mut OdometryResult, is_told_along: impl Fn(&Vector3<f64>) -> bool) {
    let Some(first) = result.scan_poses.first().map(|scan| scan.pose) else {
        return;
    };
    let mut widened = false;
    for stretch in &mut result.report.unseen {
        let along = Vector3::from(stretch.direction_in_world);
        if stretch.motion != MotionKind::Shift || is_told_along(&along) {
            continue;
        }
        let at_s = |scan: &super::ScanPose| scan.pose.time.secs_since(first.time);
        let place = |scan: &super::ScanPose| along.dot(&scan.pose.world_from_rig.translation);
        let begun = result
            .scan_poses
            .partition_point(|scan| at_s(scan) < stretch.from_s);
        let ended = result
            .scan_poses
            .partition_point(|scan| at_s(scan) <= stretch.to_s);
        let Some(start) = result.scan_poses.get(begun.saturating_sub(1)).map(place) else {
            continue;
        };
        let inside = result.scan_poses.get(begun..ended).unwrap_or_default();
        let moved: Vec<f64> = inside.iter().map(|scan| place(scan) - start).collect();
        let farthest_m = moved.iter().fold(0.0, |most: f64, m| most.max(m.abs()));
        if 2.0 * farthest_m < LEAST_M {
            continue;
        }
        let at_end = moved.last().copied().unwrap_or(0.0);
        let of_each = moved.into_iter().chain(std::iter::repeat(at_end));
        for (scan, moved) in result.scan_poses.iter_mut().skip(begun).zip(of_each) {
            let in_rig = scan.pose.world_from_rig.rotation.inverse() * along;
            let sigma_m = 2.0 * moved;
            let of_place: Matrix3<f64> = in_rig * in_rig.transpose() * (sigma_m * sigma_m);
            let mut block = scan.covariance.fixed_view_mut::<3, 3>(3, 3);
            block += of_place;
        }
        stretch.sigma_at_end = stretch.sigma_at_end.hypot(2.0 * at_end);
        result
            .report
            .warnings
            .push(OdometryWarning::AccelerometerUntold {
                from_s: stretch.from_s,
                to_s: stretch.to_s,
                direction_in_world: stretch.direction_in_world,
                off_m: 2.0 * farthest_m,
            });
        widened = true;
    }
    if widened {
        result.summarise();
    }
}
