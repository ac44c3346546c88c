//! From an adjustment to what is told about it.

use std::collections::BTreeMap;

use lsfb_geometry::{Camera, Vector2};
use lsfb_solver::Kernel;

use super::adjustment::{Freedom, Solved, Start};
use super::normal::{Variances, parameter_count, variances};
use super::{
    COVERAGE_CELLS, CalibratedCamera, CameraCalibration, CameraConfig, CameraViews, Estimate,
};
use crate::Error;
use crate::clusters::{Clusters, share_of_board};
use crate::target::Target;

/// Relative standard deviation of a focal length above which it counts as not determined.
const LARGEST_FOCAL_SIGMA: f64 = 0.02;
/// Coverage below which a warning is due.
const LEAST_COVERAGE: f64 = 0.5;

/// Errors of one camera over the views adjusted.
struct Errors {
    all: Vec<[f64; 2]>,
    inlier_squares: f64,
    inliers: usize,
    clusters: Clusters,
}

impl Errors {
    fn of(target: &Target, solved: &Solved, camera: usize) -> Self {
        let mut errors = Self {
            all: Vec::new(),
            inlier_squares: 0.0,
            inliers: 0,
            clusters: Clusters::default(),
        };
        for instant in &solved.cameras[camera].chosen {
            let counts = &solved.inliers[camera][instant];
            let seen = solved.errors_px(target, camera, *instant);
            let corners = &solved.cameras[camera].views.views[instant];
            for ((error, inlier), corner) in seen.into_iter().zip(counts).zip(corners) {
                let Some(error) = error else { continue };
                errors.all.push([error.x, error.y]);
                if *inlier {
                    errors.inlier_squares += error.norm_squared();
                    errors.inliers += 1;
                    let share = share_of_board(target, &target.corner(corner.index));
                    errors.clusters.add(*instant, share, &error);
                }
            }
        }
        errors
    }
}

impl Solved<'_> {
    pub(super) fn report(
        &self,
        target: &Target,
        given: &[CameraViews],
        config: &CameraConfig,
    ) -> Result<CameraCalibration, Error> {
        let variances = variances(target, self)?;
        let errors: Vec<Errors> = (0..self.cameras.len())
            .map(|k| Errors::of(target, self, k))
            .collect();
        let squares: f64 = errors.iter().map(|e| e.inlier_squares).sum();
        let count: usize = errors.iter().map(|e| e.inliers).sum();
        let freedom = (2 * count).saturating_sub(parameter_count(self)).max(1);
        // The spread of the residuals themselves says how good a corner is, their correlation how many it is worth.
        let effect = errors.iter().map(|e| e.clusters.design_effect());
        let variance = squares / freedom as f64 * effect.fold(1.0, f64::max);
        let mut cameras = Vec::with_capacity(given.len());
        for (k, errors) in errors.into_iter().enumerate() {
            let held_back_rms_px = self.held_back(target, k, config)?;
            cameras.push(self.camera(k, errors, &variances, variance, held_back_rms_px)?);
        }
        let (sum, n) = cameras.iter().fold((0.0, 0), |(sum, n), c| {
            (sum + c.rms_px * c.rms_px * c.corners as f64, n + c.corners)
        });
        Ok(CameraCalibration {
            rms_px: (sum / n.max(1) as f64).sqrt(),
            cameras,
            first_from_target: self.first_from_target.clone(),
        })
    }

    fn camera(
        &self,
        k: usize,
        errors: Errors,
        variances: &Variances,
        variance: f64,
        held_back_rms_px: Option<f64>,
    ) -> Result<CalibratedCamera, Error> {
        let start = &self.cameras[k];
        let lens = &start.camera.lens;
        let sigmas: Vec<f64> = variances.by_camera[k]
            .iter()
            .map(|v| (v * variance).max(0.0).sqrt())
            .collect();
        let names = lens.model().parameter_names();
        let parameters: Vec<Estimate> = names
            .iter()
            .zip(lens.parameters().values)
            .zip(&sigmas)
            .map(|((name, value), sigma)| Estimate {
                name: (*name).to_owned(),
                value,
                sigma: *sigma,
            })
            .collect();
        let weak: Vec<String> = parameters[..2]
            .iter()
            .filter(|p| !(p.sigma < LARGEST_FOCAL_SIGMA * p.value))
            .map(|p| format!("{} = {:.0} ± {:.0} px", p.name, p.value, p.sigma))
            .collect();
        if !weak.is_empty() {
            return Err(Error::Undetermined {
                camera: start.views.name.clone(),
                parameters: weak.join(", "),
                advice: "show the target tilted by 30° about both of its axes, near and far",
            });
        }
        let corners = errors.all.len();
        let squares: f64 = errors.all.iter().map(|e| e[0] * e[0] + e[1] * e[1]).sum();
        let cells = cells(start.views);
        let seen = cells.iter().filter(|n| **n > 0).count();
        let coverage = seen as f64 / cells.len() as f64;
        let mut warnings = Vec::new();
        if coverage < LEAST_COVERAGE {
            warnings.push(format!(
                "corners were seen in {:.0} % of the image: move the target into {}",
                coverage * 100.0,
                empty_parts(&cells)
            ));
        }
        let outliers = corners - errors.inliers.min(corners);
        if outliers * 20 > corners {
            warnings.push(format!(
                "{outliers} of {corners} corners are outliers: hold the target still and check that it is flat"
            ));
        }
        let inlier_rms_px = (errors.inlier_squares / errors.inliers.max(1) as f64).sqrt();
        if let Some(held_back) = held_back_rms_px
            && held_back > 1.5 * inlier_rms_px
        {
            warnings.push(format!(
                "views that were held back miss by {held_back:.2} px, those adjusted by {inlier_rms_px:.2} px: record more views"
            ));
        }
        let pose_sigma = std::array::from_fn(|i| {
            let at = lens.parameters().count + i;
            sigmas.get(at).copied().unwrap_or_default()
        });
        Ok(CalibratedCamera {
            name: start.views.name.clone(),
            camera: start.camera,
            parameters,
            camera_from_first: start.camera_from_first,
            pose_sigma,
            images: start.views.images,
            found: start.views.views.len(),
            views: start.chosen.len(),
            rms_px: (squares / corners.max(1) as f64).sqrt(),
            inlier_rms_px,
            corners,
            outliers,
            held_back_rms_px,
            coverage,
            cells,
            errors_px: errors.all,
            warnings,
        })
    }

    /// Error of views that a second adjustment did not see: only the target's pose is fitted to them.
    fn held_back(
        &self,
        target: &Target,
        k: usize,
        config: &CameraConfig,
    ) -> Result<Option<f64>, Error> {
        let start = &self.cameras[k];
        let every = config.hold_back_every;
        if every == 0 || start.chosen.len() < 2 * every.max(config.min_views) {
            return Ok(None);
        }
        let split = |held: bool| -> Vec<i64> {
            let numbered = start.chosen.iter().enumerate();
            numbered
                .filter(|(n, _)| (n % every == every - 1) == held)
                .map(|(_, t)| *t)
                .collect()
        };
        let part = |chosen: Vec<i64>, camera: Camera| -> Solved<'_> {
            let poses = chosen
                .iter()
                .map(|t| (*t, start.camera_from_first * self.first_from_target[t]))
                .collect();
            let inliers: BTreeMap<i64, Vec<bool>> = chosen
                .iter()
                .map(|t| (*t, self.inliers[k][t].clone()))
                .collect();
            Solved {
                cameras: vec![Start {
                    views: start.views,
                    chosen,
                    camera,
                    camera_from_first: lsfb_geometry::Se3::identity(),
                }],
                first_from_target: poses,
                inliers: vec![inliers],
            }
        };
        let mut kept = part(split(false), start.camera);
        kept.adjust(target, Kernel::Squared, Freedom::Everything)?;
        let mut held = part(split(true), kept.cameras[0].camera);
        held.adjust(target, Kernel::Squared, Freedom::PosesOfTarget)?;
        let errors = Errors::of(target, &held, 0);
        Ok((errors.inliers > 0).then(|| (errors.inlier_squares / errors.inliers as f64).sqrt()))
    }
}

/// Corners of all views per cell of the image, by rows from the upper left.
pub(crate) fn cells(views: &CameraViews) -> Vec<u32> {
    let [columns, rows] = COVERAGE_CELLS;
    let mut cells = vec![0; columns * rows];
    let cell = |p: &Vector2<f64>| {
        let place = |x: f64, size: u32, count: usize| {
            let share = (x + 0.5) / f64::from(size) * count as f64;
            (share.max(0.0) as usize).min(count - 1)
        };
        place(p.y, views.height, rows) * columns + place(p.x, views.width, columns)
    };
    for corners in views.views.values() {
        for corner in corners {
            cells[cell(&corner.pixel)] += 1;
        }
    }
    cells
}

/// Which parts of the image have the fewest corners, in words.
fn empty_parts(cells: &[u32]) -> String {
    let [columns, rows] = COVERAGE_CELLS;
    let mut parts = Vec::new();
    for (name, top, left) in [
        ("the upper left", true, true),
        ("the upper right", true, false),
        ("the lower left", false, true),
        ("the lower right", false, false),
    ] {
        let inside =
            |k: usize| ((k / columns) * 2 < rows) == top && ((k % columns) * 2 < columns) == left;
        let (mut empty, mut all) = (0, 0);
        for (_, n) in cells.iter().enumerate().filter(|(k, _)| inside(*k)) {
            all += 1;
            empty += usize::from(*n == 0);
        }
        if 2 * empty > all {
            parts.push(name);
        }
    }
    if parts.is_empty() {
        "the border".to_owned()
    } else {
        parts.join(", ")
    }
}
