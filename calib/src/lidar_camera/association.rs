//! Which candidate of each scan is the board: those that one transform takes to where the camera has it.

use lsfb_geometry::align::{Scale, umeyama};
use lsfb_geometry::{Se3, Vector3};
use nalgebra::Matrix3;

use super::candidates::Patch;
use super::{LidarCameraConfig, MountedBoard, Scene};
use crate::{Error, JoinProblem, WrongSize};

/// Length at which a normal counts like a point, metres: a degree then weighs like 17 mm.
const NORMAL_M: f64 = 1.0;
/// Farther off than this is another thing, metres.
const FAR_M: f64 = 0.3;
/// Scales of the pattern that are tried where the one said does not fit.
const SCALES: [f64; 16] = [
    0.5, 0.6, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.05, 1.1, 1.15, 1.2, 1.3, 1.45, 1.7, 2.0,
];

/// Another scale must lower the sum of distances to this share.
const CLEARLY_BETTER: f64 = 0.6;
/// Pairs of poses that a transform is guessed from.
const MOST_PAIRS: usize = 2000;
const FEW_PAIRS: usize = 300;

/// The boards that agree.
pub(super) struct Joined {
    /// By scene: number of its candidate.
    pub patch: Vec<Option<usize>>,
    pub camera_from_lidar: Se3,
    /// Sum of what the nearest candidates miss by, those too far off counted as just that.
    pub distance_sum_m: f64,
}

struct Sight<'a> {
    scene: usize,
    center: Vector3<f64>,
    normal: Vector3<f64>,
    patches: &'a [Patch],
}

fn center(patch: &Patch) -> Vector3<f64> {
    let plane = &patch.fit.plane;
    let at = patch.rectangle.center;
    plane.origin + plane.axes[0] * at.x + plane.axes[1] * at.y
}

pub(super) fn join(
    board: &MountedBoard,
    camera: &str,
    scenes: &[Scene],
    config: &LidarCameraConfig,
) -> Result<Joined, Error> {
    let seen = scenes.iter().filter(|s| !s.in_lidar.is_empty()).count();
    if seen < config.min_poses {
        return Err(Error::BoardNotSeen {
            found: seen,
            scans: scenes.len(),
            needed: config.min_poses,
            width_m: board.width_m,
            height_m: board.height_m,
        });
    }
    let found = agreeing(scenes, 1.0, MOST_PAIRS);
    let distance_sum_m =
        |scale: f64| agreeing(scenes, scale, FEW_PAIRS).map_or(f64::INFINITY, |j| j.distance_sum_m);
    let as_said = distance_sum_m(1.0);
    let best = SCALES
        .iter()
        .map(|scale| (distance_sum_m(*scale), *scale))
        .min_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((other, scale)) = best
        && other < CLEARLY_BETTER * as_said
    {
        let wrong = WrongSize::OtherScale {
            camera: camera.to_owned(),
            factor: scale,
            edges: board.target.scaled_words(scale),
        };
        return Err(wrong.into());
    }
    let needed = config.min_poses.max(seen.div_ceil(2));
    let agree = found
        .as_ref()
        .map_or(0, |j| j.patch.iter().flatten().count());
    if agree < needed {
        return Err(Error::NotJoined {
            first: camera.to_owned(),
            second: "lidar".to_owned(),
            cause: JoinProblem::NoTransformFits {
                found: seen,
                scans: scenes.len(),
                needed,
            },
        });
    }
    let Some(joined) = found else {
        return Err(Error::BoardNotSeen {
            found: 0,
            scans: scenes.len(),
            needed: config.min_poses,
            width_m: board.width_m,
            height_m: board.height_m,
        });
    };
    check_tilts(scenes, &joined, config)?;
    check_sides(board, scenes, &joined)?;
    Ok(joined)
}

/// The largest set of candidates that one transform explains, with the pattern of the camera scaled.
fn agreeing(scenes: &[Scene], scale: f64, most_pairs: usize) -> Option<Joined> {
    let sights: Vec<Sight> = scenes
        .iter()
        .enumerate()
        .filter(|(_, s)| s.seen_by_camera() && !s.in_lidar.is_empty())
        .map(|(scene, s)| Sight {
            scene,
            center: s.in_camera.camera_from_board.translation * scale,
            normal: s.normal_in_camera(),
            patches: &s.in_lidar,
        })
        .collect();
    let mut best: Option<(f64, Se3)> = None;
    // Every pair up to a few dozen poses, a regular choice beyond.
    let stride = (sights.len() * sights.len() / 2 / most_pairs).max(1);
    let pairs = (0..sights.len()).flat_map(|i| (i + 1..sights.len()).map(move |k| (i, k)));
    for (i, k) in pairs.step_by(stride) {
        for a in sights[i].patches {
            for b in sights[k].patches {
                let Some(pose) = transform(&[(&sights[i], a), (&sights[k], b)]) else {
                    continue;
                };
                let score = sights
                    .iter()
                    .map(|s| nearest(s, &pose).map_or(FAR_M, |n| n.1))
                    .sum::<f64>();
                if best.as_ref().is_none_or(|b| score < b.0) {
                    best = Some((score, pose));
                }
            }
        }
    }
    let mut pose = best?.1;
    let mut patch = vec![None; scenes.len()];
    for _ in 0..3 {
        patch.fill(None);
        let mut chosen = Vec::new();
        for sight in &sights {
            if let Some((k, _)) = nearest(sight, &pose) {
                patch[sight.scene] = Some(k);
                chosen.push((sight, &sight.patches[k]));
            }
        }
        pose = transform(&chosen)?;
    }
    let distance_sum_m = sights
        .iter()
        .map(|s| nearest(s, &pose).map_or(FAR_M, |n| n.1))
        .sum();
    Some(Joined {
        patch,
        camera_from_lidar: pose,
        distance_sum_m,
    })
}

fn nearest(sight: &Sight, camera_from_lidar: &Se3) -> Option<(usize, f64)> {
    sight
        .patches
        .iter()
        .enumerate()
        .map(|(k, patch)| {
            let off = (*camera_from_lidar * center(patch) - sight.center).norm();
            let normal = camera_from_lidar.rotation * patch.fit.plane.normal;
            (k, off + 0.5 * NORMAL_M * (normal - sight.normal).norm())
        })
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .filter(|n| n.1 < FAR_M)
}

fn transform(pairs: &[(&Sight, &Patch)]) -> Option<Se3> {
    let mut lidar = Vec::new();
    let mut camera = Vec::new();
    for (sight, patch) in pairs {
        let c = center(patch);
        lidar.extend([c, c + patch.fit.plane.normal * NORMAL_M]);
        camera.extend([sight.center, sight.center + sight.normal * NORMAL_M]);
    }
    Some(umeyama(&lidar, &camera, Scale::Fixed)?.target_from_source)
}

/// Refuses boards that all face one way: what lies along them is then not seen.
fn check_tilts(scenes: &[Scene], joined: &Joined, config: &LidarCameraConfig) -> Result<(), Error> {
    let normals: Vec<Vector3<f64>> = scenes
        .iter()
        .zip(&joined.patch)
        .filter_map(|(s, k)| Some(s.in_lidar.get((*k)?)?.fit.plane.normal))
        .collect();
    let mean = normals.iter().sum::<Vector3<f64>>() / normals.len().max(1) as f64;
    let spread: Matrix3<f64> = normals
        .iter()
        .map(|n| (n - mean) * (n - mean).transpose())
        .sum::<Matrix3<f64>>()
        / normals.len().max(1) as f64;
    let eigen = spread.symmetric_eigen();
    // Normals move on a sphere: two directions carry their spread, the third is nearly none.
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let tilt_deg = |k: usize| {
        eigen.eigenvalues[order[k]]
            .max(0.0)
            .sqrt()
            .min(1.0)
            .asin()
            .to_degrees()
    };
    if tilt_deg(1) >= config.min_tilt_deg {
        return Ok(());
    }
    let facing = mean.try_normalize(1e-9).unwrap_or_else(Vector3::x);
    let (what, axis) = if tilt_deg(0) < config.min_tilt_deg {
        let across = if facing.z.abs() < 0.9 {
            Vector3::z().cross(&facing)
        } else {
            Vector3::x()
        };
        ("every", across)
    } else {
        let most: Vector3<f64> = eigen.eigenvectors.column(order[0]).into();
        ("one", most)
    };
    Err(Error::OneSided {
        tilt_deg: tilt_deg(1),
        needed_deg: config.min_tilt_deg,
        direction: if what == "every" {
            "any direction along the board".to_owned()
        } else {
            format!(
                "the LiDAR's direction {}",
                direction_name(&facing.cross(&axis))
            )
        },
        advice: format!(
            "tilt the board about the LiDAR's {} axis",
            direction_name(&axis)
        ),
    })
}

/// The nearest axis of the LiDAR, in words.
pub(super) fn direction_name(direction: &Vector3<f64>) -> &'static str {
    match direction.iamax() {
        0 => "x (forward)",
        1 => "y (left)",
        _ => "z (up)",
    }
}

/// Refuses width and height that were exchanged.
fn check_sides(board: &MountedBoard, scenes: &[Scene], joined: &Joined) -> Result<(), Error> {
    let longer = board.width_m.max(board.height_m);
    let square = (board.width_m - board.height_m).abs() < 0.1 * longer;
    let (mut same, mut exchanged) = (0, 0);
    for (scene, k) in scenes.iter().zip(&joined.patch) {
        let Some(patch) = k.and_then(|k| scene.in_lidar.get(k)) else {
            continue;
        };
        let plane = &patch.fit.plane;
        let along = patch.rectangle.along;
        let along = plane.axes[0] * along.x + plane.axes[1] * along.y;
        let in_camera = joined.camera_from_lidar.rotation * along;
        let pose = &scene.in_camera.camera_from_board.rotation;
        let by_axis = [Vector3::x(), Vector3::y()].map(|a| (pose * a).dot(&in_camera).abs());
        let long_axis = usize::from(board.height_m > board.width_m);
        let clear = patch.rectangle.size_m[0] > 1.1 * patch.rectangle.size_m[1];
        if clear && by_axis[long_axis] > 0.9 {
            same += 1;
        } else if clear && by_axis[1 - long_axis] > 0.9 {
            exchanged += 1;
        }
    }
    if !square && exchanged > 2 * same {
        let wrong = WrongSize::Exchanged {
            longer_axis: match board.width_m > board.height_m {
                true => 'y',
                false => 'x',
            },
            exchanged,
            poses: same + exchanged,
            plate_m: [board.width_m, board.height_m],
        };
        return Err(wrong.into());
    }
    Ok(())
}
