use super::*;
use crate::odometry::tests::room::{self, Room};
use lsfb_geometry::{Camera, Se3, StampedPose, UnitQuaternion};
use lsfb_types::Verdict;

/// What a LiDAR carried through the furnished room saw of it in twelve seconds.
fn surface_of(room: &Room) -> Surface {
    surface_at(room, room::world_from_rig)
}

/// The same with poses that are given for it, at seconds.
fn surface_at(room: &Room, pose_at: impl Fn(f64) -> Se3) -> Surface {
    let mut rig = Rig::empty("backpack");
    rig.lidars.insert("lidar".to_owned(), room::lidar());
    let poses = (0..2400).map(|i| {
        let t = 1.0 + f64::from(i) * 0.005;
        StampedPose {
            time: room::time(t),
            world_from_rig: pose_at(t),
        }
    });
    let trajectory = Trajectory::new(poses.collect());
    let mut builder = SurfaceBuilder::new(&rig, &SurfaceConfig::default()).expect("a LiDAR");
    let inserted = (0..60).filter(|i| {
        let scan = room::scan(room, 1.0 + f64::from(*i) * 0.2, *i as u64);
        builder.insert(&scan, &trajectory)
    });
    assert!(inserted.count() > 50);
    // A scan that the trajectory does not reach is none.
    assert!(!builder.insert(&room::scan(room, 40.0, 7), &trajectory));
    builder.finish()
}

fn camera() -> Camera {
    Camera::pinhole(160, 120, [100.0, 100.0], [79.5, 59.5])
}

/// A camera at a place, that looks along a direction of the ground and somewhat down.
fn looking(place: [f64; 3], yaw_rad: f64) -> Se3 {
    let forward = Vector3::new(yaw_rad.cos(), yaw_rad.sin(), -0.15).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let down = forward.cross(&right);
    let axes = nalgebra::Matrix3::from_columns(&[right, down, forward]);
    Se3::new(UnitQuaternion::from_matrix(&axes), Vector3::from(place))
}

/// Depths of cameras that stand where the scanner never was: right where they are given, and given for most of the image.
#[test]
fn depths_are_those_of_the_room() {
    let room = Room::furnished();
    let surface = surface_of(&room);
    assert!(!surface.is_empty());
    let camera = camera();
    let places = [
        looking([0.3, 0.9, 1.1], 0.2),
        looking([1.2, -0.6, 1.7], 2.6),
        looking([3.6, 0.7, 1.4], -0.6),
        looking([-0.5, -0.2, 1.3], 1.2),
    ];
    let (mut errors_m, mut all, mut turned) = (Vec::new(), 0, 0);
    for world_from_camera in &places {
        let view = surface.render(&camera, world_from_camera);
        assert_eq!(view, surface.render(&camera, world_from_camera));
        all += view.depths_m.len();
        for (index, depth_m) in view.depths_m.iter().enumerate() {
            let Some(depth_m) = depth_m else {
                assert_eq!(view.normals[index], [0.0; 3]);
                continue;
            };
            let (u, v) = (index % 160, index / 160);
            let ray = camera
                .unproject(&[u as f64, v as f64].into())
                .expect("a ray");
            let in_world = world_from_camera.rotation * ray;
            let true_m = room.cast(&world_from_camera.translation, &in_world) * ray.z;
            errors_m.push((f64::from(*depth_m) - true_m).abs());
            // Walls of the room stand along its axes.
            let normal = Vector3::from(view.normals[index].map(f64::from));
            let in_world = world_from_camera.rotation * normal;
            turned += usize::from(in_world.amax() < 0.98);
        }
    }
    let known = errors_m.len();
    errors_m.sort_by(f64::total_cmp);
    let at = |share: f64| errors_m[((known - 1) as f64 * share) as usize];
    let wrong = errors_m.iter().filter(|e| **e > 0.05).count();
    let said = format!(
        "known {known} of {all}; error median {:.4}, 95 % {:.4}, largest {:.3} m; {wrong} beyond 5 cm; {turned} normals off by more than 11°",
        at(0.5),
        at(0.95),
        at(1.0)
    );
    // Floor and ceiling near its way the scanner never saw: its beams rise and fall too little.
    assert!(known * 2 >= all, "{said}");
    assert!(at(0.5) < 0.006 && at(0.95) < 0.03, "{said}");
    assert!(at(1.0) < 0.5, "{said}");
    assert!(wrong * 100 < known && turned * 100 < known, "{said}");
}

/// `map depth` took any trajectory: that of another walk gave depth to every sixth pixel, without a word.
#[test]
fn scans_at_poses_of_another_walk_disagree() {
    let room = Room::furnished();
    let verdict = |pose_at: &dyn Fn(f64) -> Se3| {
        let surface = surface_at(&room, pose_at);
        let finding = surface.agreement().finding();
        (finding.verdict, finding.what)
    };
    let own = room::world_from_rig;
    let (right, what) = verdict(&own);
    assert_eq!(right, Verdict::Pass, "{what}");
    let off = |t: f64, metres: [f64; 3]| {
        let pose = own(t);
        Se3::new(pose.rotation, pose.translation + Vector3::from(metres))
    };
    let backwards = |t: f64| own(14.0 - t);
    let late = |t: f64| own(t - 1.0);
    let still = |_: f64| own(1.0);
    let wrong: [&dyn Fn(f64) -> Se3; 3] = [&backwards, &late, &still];
    for (number, pose_at) in wrong.into_iter().enumerate() {
        let (found, what) = verdict(pose_at);
        assert_eq!(found, Verdict::Fail, "{number}: {what}");
    }
    let drifting = |t: f64| off(t, [0.1 * t, 0.0, 0.0]);
    let (found, what) = verdict(&drifting);
    assert!(found >= Verdict::Warn, "{what}");
}

/// A room that nobody has been in, and one that is seen from behind its walls, has no depth.
#[test]
fn what_nobody_saw_has_no_depth() {
    let surface = surface_of(&Room::furnished());
    let outside = looking([-6.0, 0.0, 1.4], 0.0);
    let view = surface.render(&camera(), &outside);
    assert!(view.known_share() < 0.02, "{}", view.known_share());
    let empty = Surface {
        blocks: CellMap::default(),
        free: FreeSpace::default(),
        max_depth_m: 10.0,
        agreement: Agreement::default(),
    };
    assert!(empty.is_empty());
    assert_eq!(empty.render(&camera(), &outside).known_share(), 0.0);
}
