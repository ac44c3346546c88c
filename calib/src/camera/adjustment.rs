//! Bundle adjustment over lenses, camera poses and target poses.

use std::collections::BTreeMap;

use lsfb_geometry::camera::LensModel;
use lsfb_geometry::{Camera, Se3, UnitQuaternion, Vector2, Vector3};
use lsfb_solver::Kernel;
use lsfb_types::median;

use super::CameraConfig;
use super::batch::Freedom;
use super::guess::{self, fit_lens, lens_rays, pose_of_target};
use super::pairing;
use super::pose_choice::{most_central, spread};
use super::solved::{Solved, Start};
use crate::Error;
use crate::JoinProblem;
use crate::board::Target;

/// Norm of the error at which a corner's weight is halved while outliers are not yet known, pixels.
const ROBUST_SCALE_PX: f64 = 1.0;
/// Corners nearer than this are never outliers, pixels.
const NEVER_OUTLIER_PX: f64 = 0.5;
/// Corners a view needs.
const MIN_CORNERS: usize = 8;
/// Instants that two cameras must share.
const MIN_SHARED: usize = 3;
/// Spread of relative poses with the board turned by half a turn, as a share of that without, at which it is upside down.
const UPSIDE_DOWN: f64 = 0.1;

pub(super) fn adjust_each_then_all<'a>(
    target: &Target,
    starts: Vec<Start<'a>>,
    config: &CameraConfig,
) -> Result<Solved<'a>, Error> {
    let mut alone = Vec::with_capacity(starts.len());
    for start in starts {
        alone.push(adjust_alone(target, start, config)?);
    }
    if alone.len() == 1 {
        return alone.pop().ok_or_else(|| unreachable_camera(target));
    }
    let mut cameras: Vec<Start<'a>> = Vec::with_capacity(alone.len());
    let mut poses = BTreeMap::new();
    // Views of any camera at the instants chosen for one of them: so that cameras meet in as many as they can.
    let mut instants: Vec<i64> = alone
        .iter()
        .flat_map(|s| s.cameras.iter().flat_map(|c| c.chosen.iter().copied()))
        .collect();
    instants.sort_unstable();
    instants.dedup();
    for solved in &alone {
        let Some(own) = solved.cameras.first() else {
            continue;
        };
        let chosen: Vec<i64> = instants
            .iter()
            .copied()
            .filter(|t| {
                own.views
                    .views
                    .get(t)
                    .is_some_and(|c| c.len() >= MIN_CORNERS)
            })
            .collect();
        let seen: BTreeMap<i64, Se3> = chosen
            .iter()
            .filter_map(|t| {
                Some((
                    *t,
                    pose_of_target(target, &own.camera, &own.views.views[t])?,
                ))
            })
            .collect();
        let camera_from_first = match cameras.first() {
            None => Se3::identity(),
            Some(first) => relative_pose(target, first, own, &poses, &seen)?,
        };
        for (instant, pose) in &seen {
            poses
                .entry(*instant)
                .or_insert(camera_from_first.inverse() * *pose);
        }
        cameras.push(Start {
            chosen,
            camera_from_first,
            alone_rms_px: Some(solved.rms_px(target)),
            ..own.clone()
        });
    }
    let first = cameras
        .first()
        .map_or_else(String::new, |c| c.views.name.clone());
    adjust_from(target, cameras, poses, config).map_err(|error| match error {
        // Each for itself they did fit.
        Error::DoesNotFit { camera, rms_px, .. } => Error::NotJoined {
            second: match camera == first {
                true => "the others".into(),
                false => camera,
            },
            first,
            cause: JoinProblem::MissTogether { rms_px },
        },
        other => other,
    })
}

fn unreachable_camera(target: &Target) -> Error {
    Error::TargetNotSeen {
        camera: String::new(),
        found: 0,
        images: 0,
        needed: 1,
        target: target.describe(),
    }
}

/// Pose of the first camera in another: the one of all shared instants that agrees best with the others.
fn relative_pose(
    target: &Target,
    first: &Start,
    other: &Start,
    first_from_target: &BTreeMap<i64, Se3>,
    other_from_target: &BTreeMap<i64, Se3>,
) -> Result<Se3, Error> {
    let candidates: Vec<Se3> = other_from_target
        .iter()
        .filter_map(|(t, pose)| Some(*pose * first_from_target.get(t)?.inverse()))
        .collect();
    let turned: Vec<Se3> = other_from_target
        .iter()
        .filter_map(|(t, pose)| {
            Some(*pose * half_turn(target) * first_from_target.get(t)?.inverse())
        })
        .collect();
    let apart = |cause| Error::NotJoined {
        first: first.views.name.clone(),
        second: other.views.name.clone(),
        cause,
    };
    if candidates.len() >= MIN_SHARED && spread(&turned) < UPSIDE_DOWN * spread(&candidates) {
        return Err(apart(JoinProblem::OppositeEnds));
    }
    let exchanged = pairing::exchanged(first_from_target, other_from_target);
    if let [first_instant, .., last_instant] = exchanged[..] {
        return Err(apart(JoinProblem::Exchanged {
            exchanged: exchanged.len(),
            shared: candidates.len(),
            first_instant,
            last_instant,
        }));
    }
    if let Some(by) = pairing::shift(first_from_target, other_from_target) {
        return Err(apart(JoinProblem::ShiftedPairs { by }));
    }
    most_central(&candidates)
        .filter(|_| candidates.len() >= MIN_SHARED)
        .ok_or_else(|| {
            apart(JoinProblem::FewInstants {
                shared: candidates.len(),
                needed: MIN_SHARED,
            })
        })
}

/// The board turned by half a turn about its middle, which a checkerboard hides.
fn half_turn(target: &Target) -> Se3 {
    let [width, height] = target.corners_size();
    Se3::new(
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI),
        Vector3::new(width, height, 0.0),
    )
}

/// Adjusts one camera. Where its model cannot be started from the views alone it is started from what another model, which
/// starts nearly anywhere, makes of them; where that fails as well, the error names the model that fits.
pub(super) fn adjust_alone<'a>(
    target: &Target,
    start: Start<'a>,
    config: &CameraConfig,
) -> Result<Solved<'a>, Error> {
    let wanted = start.camera.lens.model();
    let failed = match adjust_robustly(target, vec![start.clone()], config) {
        Ok(solved) => return Ok(solved),
        Err(failed) => failed,
    };
    let other = [LensModel::KannalaBrandt, LensModel::PinholeRadtan]
        .into_iter()
        .filter(|model| *model != wanted)
        .filter_map(|model| {
            let camera = guess::camera(target, start.views, &start.chosen, model).ok()?;
            let start = Start {
                camera,
                ..start.clone()
            };
            adjust_robustly(target, vec![start], config).ok()
        })
        .min_by(|a, b| a.rms_px(target).total_cmp(&b.rms_px(target)));
    let Some(other) = other else {
        return Err(failed);
    };
    let Some(camera) = other.cameras.first().map(|c| c.camera) else {
        return Err(failed);
    };
    let other_rms_px = other.rms_px(target);
    let rays = lens_rays(
        &camera,
        start.chosen.iter().filter_map(|t| start.views.views.get(t)),
    );
    let start = Start {
        camera: Camera {
            lens: fit_lens(wanted, &camera, &rays),
            ..camera
        },
        ..start
    };
    adjust_robustly(target, vec![start], config).map_err(|_| match failed {
        Error::DoesNotFit {
            camera: name,
            rms_px,
            model,
            ..
        } => Error::AnotherModelFits {
            camera: name,
            model,
            rms_px,
            other: camera.lens.model().name(),
            other_rms_px,
        },
        failed => failed,
    })
}

pub(super) fn adjust_robustly<'a>(
    target: &Target,
    cameras: Vec<Start<'a>>,
    config: &CameraConfig,
) -> Result<Solved<'a>, Error> {
    let mut poses = BTreeMap::new();
    for start in &cameras {
        for instant in &start.chosen {
            let corners = &start.views.views[instant];
            if let Some(pose) = pose_of_target(target, &start.camera, corners) {
                poses.insert(*instant, pose);
            }
        }
    }
    adjust_from(target, cameras, poses, config)
}

fn adjust_from<'a>(
    target: &Target,
    cameras: Vec<Start<'a>>,
    poses: BTreeMap<i64, Se3>,
    config: &CameraConfig,
) -> Result<Solved<'a>, Error> {
    let mut solved = Solved {
        inliers: cameras
            .iter()
            .map(|c| {
                let all = c.chosen.iter().filter(|t| poses.contains_key(t));
                all.map(|t| (*t, vec![true; c.views.views[t].len()]))
                    .collect()
            })
            .collect(),
        cameras,
        first_from_target: poses,
        undetermined: None,
    };
    for camera in &mut solved.cameras {
        let poses = &solved.first_from_target;
        camera.chosen.retain(|t| poses.contains_key(t));
    }
    let robust = Kernel::Cauchy {
        scale: ROBUST_SCALE_PX,
    };
    solved.adjust(target, robust, Freedom::Everything)?;
    solved.find_outliers(target, config)?;
    solved.adjust(target, Kernel::Squared, Freedom::Everything)?;
    Ok(solved)
}

impl Solved<'_> {
    fn find_outliers(&mut self, target: &Target, config: &CameraConfig) -> Result<(), Error> {
        for k in 0..self.cameras.len() {
            let views: Vec<(i64, Vec<Option<Vector2<f64>>>)> = self.cameras[k]
                .chosen
                .iter()
                .map(|t| (*t, self.errors_px(target, k, *t)))
                .collect();
            let norms: Vec<f64> = views
                .iter()
                .flat_map(|v| v.1.iter().map(|e| e.map_or(f64::INFINITY, |e| e.norm())))
                .collect();
            let median_px = median(norms).unwrap_or(f64::INFINITY);
            if !(median_px <= config.max_rms_px) {
                return Err(Error::DoesNotFit {
                    camera: self.cameras[k].views.name.clone(),
                    rms_px: median_px,
                    target: target.describe(),
                    model: self.cameras[k].camera.lens.model().name(),
                });
            }
            // Of a two-dimensional normal error half lies within 1.177 σ.
            let limit = (config.outlier_ratio * median_px / 1.177).max(NEVER_OUTLIER_PX);
            for (t, errors) in views {
                let inliers = errors.iter().map(|e| e.is_some_and(|e| e.norm() <= limit));
                self.inliers[k].insert(t, inliers.collect());
            }
        }
        Ok(())
    }
}
