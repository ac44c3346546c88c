//! From an adjustment to what is told about it.

use lsfb_geometry::Matrix6;
use lsfb_types::{Finding, Limit, Verdict};
use nalgebra::DMatrix;

use super::holdout::Holdout;
use super::shutter::velocities;
use super::solved::Solved;
use super::uncertainty::Uncertainty;
use super::{
    BoardDeformation, CalibratedCamera, CameraCalibration, CameraConfig, CameraViews, Estimate,
};
use crate::Error;
use crate::board::Target;
use crate::clusters::{Clusters, share_of_board};
use crate::coverage::{CellErrors, cell, corners_by_cell};
use crate::findings;
use crate::residual_diagnosis::{AdjustedCorner, AdjustedView, Diagnosis, Field};

/// Relative standard deviation of a focal length above which it counts as not determined.
const LARGEST_FOCAL_SIGMA: f64 = 0.02;
/// Coverage below which a warning is due.
const LEAST_COVERAGE: f64 = 0.5;
/// Errors of a camera among others, as a multiple of those it leaves for itself, that are no accident.
const WORSE_TOGETHER: f64 = 1.3;

/// Errors of one camera over the views adjusted.
struct Errors {
    all: Vec<[f64; 2]>,
    by_cell: CellErrors,
    inlier_squares: f64,
    inliers: usize,
    /// By view and part of the board, and by part of the image.
    clusters: [Clusters; 2],
}

impl Errors {
    fn of(target: &Target, solved: &Solved, camera: usize) -> Self {
        let lens = &solved.cameras[camera].camera;
        let size_px = [lens.width, lens.height];
        let mut errors = Self {
            all: Vec::new(),
            by_cell: CellErrors::new(size_px),
            inlier_squares: 0.0,
            inliers: 0,
            clusters: Default::default(),
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
                    errors.by_cell.add(&corner.pixel, &error);
                    let share = share_of_board(target, &target.corner(corner.index));
                    errors.clusters[0].add(*instant, share, &error);
                    let place = cell(&corner.pixel, size_px);
                    errors.clusters[1].add(place as i64, [0.0; 2], &error);
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
        let errors: Vec<Errors> = (0..self.cameras.len())
            .map(|k| Errors::of(target, self, k))
            .collect();
        let squares: f64 = errors.iter().map(|e| e.inlier_squares).sum();
        let count: usize = errors.iter().map(|e| e.inliers).sum();
        let freedom = (2 * count).saturating_sub(self.unknowns()).max(1);
        // The spread of the residuals themselves says how good a corner is, their correlation how many it is worth.
        let effects = errors.iter().flat_map(|e| &e.clusters);
        let effect = effects.map(Clusters::design_effect).fold(1.0, f64::max);
        let variance = squares / freedom as f64 * effect;
        let fields: Vec<Field> = (0..self.cameras.len())
            .map(|k| {
                let seen = self.seen(target, k).collect();
                Diagnosis::new(target, &self.cameras[k].camera, seen).field(variance)
            })
            .collect();
        let known = self.uncertainties(target, &fields, variance)?;
        let mut cameras = Vec::with_capacity(given.len());
        for ((k, errors), known) in errors.into_iter().enumerate().zip(&known) {
            let holdout = self.holdout(target, k, config)?;
            let mut camera = self.camera(k, errors, known, holdout)?;
            let rms_px = camera.inlier_rms_px;
            let diagnosis = Diagnosis::new(
                target,
                &self.cameras[k].camera,
                self.seen(target, k).collect(),
            );
            // What matters most comes first.
            let fit = diagnosis.finding(&camera.name, rms_px);
            let gap = diagnosis.another_gap(&camera.name, rms_px);
            let shutter = diagnosis.rolling_shutter(&camera.name, variance);
            let names: Vec<String> = self.cameras[k].chosen.iter().map(i64::to_string).collect();
            // A shutter that rolls, and a model that is not the lens's, change the lens of each view with where the board was and how it
            // moved.
            let is_explained =
                shutter.is_some() || camera.findings.iter().any(|f| f.code == "lens-model");
            let lens = match is_explained {
                true => None,
                false => diagnosis.another_lens(&camera.name, &names),
            };
            let first = lens.into_iter().chain([fit]).chain(gap).chain(shutter);
            camera.findings.splice(0..0, first);
            let deformation = diagnosis.board(variance);
            for (p, more) in camera
                .parameters
                .iter_mut()
                .zip(deformation.lens_covariance.diagonal().iter())
            {
                p.sigma = p.sigma.hypot(more.max(0.0).sqrt());
            }
            camera.board = deformation.board;
            cameras.push(camera);
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
        known: &Uncertainty,
        holdout: Option<Holdout>,
    ) -> Result<CalibratedCamera, Error> {
        let start = &self.cameras[k];
        let lens = &start.camera.lens;
        let by_weights = known.covariance.map_diagonal(|v| v.max(0.0).sqrt());
        let size = known.bias.len();
        let covariance = DMatrix::from_fn(size, size, |i, j| {
            let own = known.covariance[(i, j)] * known.factors[i] * known.factors[j];
            own + known.bias[i] * known.bias[j]
        });
        let sigmas = covariance.map_diagonal(|v| v.max(0.0).sqrt());
        let names = lens.model().parameter_names();
        let parameters: Vec<Estimate> = names
            .iter()
            .zip(lens.parameters().values)
            .zip(sigmas.iter())
            .map(|((name, value), sigma)| Estimate {
                name: (*name).to_owned(),
                value,
                sigma: *sigma,
            })
            .collect();
        // What is not determined even by the weights.
        let weak: Vec<String> = parameters[..2]
            .iter()
            .zip(by_weights.iter())
            .filter(|(p, sigma)| !(**sigma < LARGEST_FOCAL_SIGMA * p.value))
            .map(|(p, sigma)| format!("{} = {:.0} ± {sigma:.0} px", p.name, p.value))
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
        let views = start.views;
        let cells = corners_by_cell(views.views.values().flatten(), [views.width, views.height]);
        let seen = cells.iter().filter(|n| **n > 0).count();
        let coverage = seen as f64 / cells.len() as f64;
        let name = &start.views.name;
        let outliers = corners - errors.inliers.min(corners);
        let inlier_rms_px = (errors.inlier_squares / errors.inliers.max(1) as f64).sqrt();
        let mut found = vec![findings::coverage(name, &cells, LEAST_COVERAGE)];
        found.extend(findings::unseen_corners(name, &cells));
        found.push(findings::outliers(name, outliers, corners));
        if let Some(alone_px) = start.alone_rms_px {
            let limit = Limit::AtMost(WORSE_TOGETHER * alone_px);
            let what = format!(
                "reprojection error {alone_px:.2} px alone, {inlier_rms_px:.2} px together with the other cameras"
            );
            let together = Finding::new("together", Verdict::Warn, name, what);
            found.push(together.judged(inlier_rms_px, "px", limit).remedy(
                "check that the cameras are triggered together, that their stamps are right, and that no camera is loose",
            ));
        }
        let holdout_rms_px = holdout.as_ref().map(|h| h.rms_px);
        found.extend(holdout.and_then(|h| h.wrong_model));
        if let Some(rms_px) = holdout_rms_px {
            let most_px = 1.5 * inlier_rms_px;
            found.push(findings::holdout(name, rms_px, inlier_rms_px, most_px));
        }
        let at = lens.parameters().count;
        let pose_covariance = Matrix6::from_fn(|i, j| covariance[(at + i, at + j)]);
        Ok(CalibratedCamera {
            name: start.views.name.clone(),
            camera: start.camera,
            parameters,
            camera_from_first: start.camera_from_first,
            pose_sigma: std::array::from_fn(|i| sigmas[at + i]),
            pose_covariance,
            images: start.views.images,
            found: start.views.views.len(),
            views: start.chosen.len(),
            rms_px: (squares / corners.max(1) as f64).sqrt(),
            inlier_rms_px,
            corners,
            outliers,
            holdout_rms_px,
            coverage,
            cells,
            cell_errors_px: errors.by_cell.means(),
            board: BoardDeformation::default(),
            errors_px: errors.all,
            findings: found,
        })
    }

    /// The corners that count, as the adjustment leaves them.
    fn seen<'a>(&'a self, target: &'a Target, k: usize) -> impl Iterator<Item = AdjustedView> + 'a {
        let start = &self.cameras[k];
        start.chosen.iter().map(move |instant| {
            let velocities = velocities(&start.views.views, *instant, 0.0);
            let velocity = move |index| velocities.get(&index).copied().unwrap_or_default();
            let corners = start.views.views[instant].iter();
            let inliers = corners.zip(&self.inliers[k][instant]);
            AdjustedView {
                camera_from_target: start.camera_from_first * self.first_from_target[instant],
                corners: inliers
                    .filter(|(_, inlier)| **inlier)
                    .map(|(corner, _)| AdjustedCorner {
                        point: target.corner(corner.index),
                        pixel: corner.pixel,
                        velocity_px_s: velocity(corner.index),
                    })
                    .collect(),
            }
        })
    }
}
