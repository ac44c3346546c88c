//! From the batch to what is told about it.

use lsfb_geometry::{Se3, Vector2, Vector3, spline};
use nalgebra::{RowSVector, SMatrix};

use super::bend::{BEND, Bend, bends};
use super::board_size::BoardExcess;
use super::effort::Moved;
use super::inertial::{TURNED, triad_matrix};
use super::state::{Mounted, RigEstimate, View};
use super::uncertainty::Uncertainty;
use super::{
    Axes, BoardShape, CameraImuCalibration, CameraImuConfig, CameraOnImu, FoundImu, ORDER,
    judgement,
};
use crate::board::Target;
use crate::camera::Estimate;
use crate::coverage::CellErrors;
use crate::residual_diagnosis::{
    AdjustedCorner, AdjustedView, Diagnosis, Unmodelled, WORRYING_RMS_PX, moved_by_field,
};

/// Share of the squares that a wrong size must explain where corners are met badly.
const EXPLAINED_BY_SIZE: f64 = 0.7;
/// Share of the gyroscope's squares that jitter of the IMU's stamps must explain.
const SHARE_OF_JITTER: f64 = 0.3;
/// Half the step over which an angular acceleration is taken, seconds.
const STEP_S: f64 = 2e-3;
/// Residuals of the IMU in bins, as multiples of its noise; those beyond the span are in the bins at its ends.
const BINS: usize = 40;
pub(super) const HISTOGRAM_SPAN: [f64; 2] = [-5.0, 5.0];

/// Root mean squares of the inertial residuals and their histograms, gyroscope first.
struct Inertial {
    ratio: [f64; 2],
    histogram: [Vec<u32>; 2],
    /// Spread of the times that samples are off their stamps, as far as the gyroscope tells, seconds.
    jitter_s: f64,
}

impl RigEstimate {
    /// Errors of views that the last adjustment did not see.
    pub fn holdout_rms_px(&self) -> Vec<Option<f64>> {
        (0..self.cameras.len())
            .map(|k| {
                let held = self.views.iter().filter(|v| v.camera == k && v.holdout);
                let mut lengths: Vec<f64> = held
                    .flat_map(|v| self.errors_px(v))
                    .map(|e| e.map_or(f64::INFINITY, |e| e.norm_squared()))
                    .collect();
                lengths.sort_by(f64::total_cmp);
                // Outliers there are not known yet: those beyond five times the median.
                let median = lengths.get(lengths.len() / 2)?;
                let count = lengths.partition_point(|e| *e <= 25.0 * median).max(1);
                Some((lengths[..count].iter().sum::<f64>() / count as f64).sqrt())
            })
            .collect()
    }

    /// By how much the gyroscope's noise, as found, moves the views of a camera that were held back, root mean square in pixels: between
    /// the views before and after one, what it integrates is a random walk of which both ends are known.
    fn holdout_spread_px(&self, camera: usize, gyro_ratio: f64) -> f64 {
        let adjusted = self.views.iter().filter(|v| !v.holdout);
        let mut times: Vec<f64> = adjusted.map(|v| self.time_s(v)).collect();
        times.sort_by(f64::total_cmp);
        let held = |v: &&View| v.camera == camera && v.holdout;
        let spans = self.views.iter().filter(held).filter_map(|view| {
            let time_s = self.time_s(view);
            let after = times.partition_point(|t| *t < time_s);
            Some((
                time_s - times.get(after.checked_sub(1)?)?,
                times.get(after)? - time_s,
            ))
        });
        let (sum, count) = spans.fold((0.0, 0.0), |(sum, count), (before, after)| {
            (
                sum + before * after / (before + after).max(1e-9),
                count + 1.0,
            )
        });
        let turn_rad = gyro_ratio * self.noise.gyro_noise_density;
        let by_turn = turn_rad * f64::sqrt(2.0 * sum / f64::max(count, 1.0));
        self.cameras[camera].camera.focal_px()[0] * by_turn
    }

    pub fn report(
        self,
        target: &Target,
        config: &CameraImuConfig,
        holdout: &[Option<f64>],
        uncertainty: Uncertainty,
        excess: BoardExcess,
    ) -> CameraImuCalibration {
        let inertial = self.inertial();
        // A noise that was understated makes this no surer.
        let excess = BoardExcess {
            sigma: excess.sigma * inertial.ratio[1].max(1.0),
            ..excess
        };
        let cameras: Vec<CameraOnImu> = (0..self.cameras.len())
            .map(|k| self.camera(k, holdout[k], &uncertainty))
            .collect();
        let worst_px = cameras.iter().map(|c| c.rms_px).fold(0.0, f64::max);
        // Where something else is wrong as well, the size takes what it can of that.
        let board_is_measured = worst_px < WORRYING_RMS_PX || excess.explains > EXPLAINED_BY_SIZE;
        let mut findings = vec![judgement::size(target, &excess, board_is_measured)];
        findings.extend(self.motion_findings(target, inertial.ratio, inertial.jitter_s));
        for (k, camera) in cameras.iter().enumerate() {
            let spread_px = self.holdout_spread_px(k, inertial.ratio[0]);
            findings.extend(self.camera_findings(target, k, camera, spread_px));
        }
        findings.extend(judgement::halves(&uncertainty.halves));
        findings.extend(judgement::accel_delay(
            self.accel_delay_s,
            uncertainty.accel_delay_s,
        ));
        let middle = self.middle_bias();
        let axes = match config.axes {
            Axes::Ideal => vec![],
            Axes::NearlyIdeal => self.axes(&uncertainty.axes, &[]),
            Axes::Estimated => self.axes(&uncertainty.axes, &TURNED),
        };
        findings.extend(judgement::axes(&axes, config));
        let [gyro_histogram, accel_histogram] = inertial.histogram;
        let (board_bend_m, board_bend_sigma_m) = self.largest_bend(target, &uncertainty.bend);
        if board_bend_sigma_m > 0.0 {
            findings.push(judgement::bend(board_bend_m, board_bend_sigma_m));
        }
        CameraImuCalibration {
            cameras,
            imu: FoundImu {
                gyro_bias_rad_s: self.gyro_bias[middle].into(),
                gyro_bias_sigma_rad_s: uncertainty.gyro_bias.into(),
                accel_bias_m_s2: self.accel_bias[middle].into(),
                accel_bias_sigma_m_s2: uncertainty.accel_bias.into(),
                gyro_matrix: triad_matrix(&self.gyro_axes),
                accel_matrix: triad_matrix(&self.accel_axes),
                axes,
                accel_delay_s: self.accel_delay_s,
                accel_delay_sigma_s: uncertainty.accel_delay_s,
                gyro_ratio: inertial.ratio[0],
                accel_ratio: inertial.ratio[1],
                gyro_histogram,
                accel_histogram,
                rate_rms_rad_s: self.rate_rms.into(),
                force_rms_m_s2: self.force_rms.into(),
            },
            gravity_in_target_m_s2: self.gravity.into(),
            gravity_sigma_m_s2: uncertainty.gravity.into(),
            board_is_measured,
            board_excess: excess.share,
            board_excess_sigma: excess.sigma,
            board_bend_m,
            board_bend_sigma_m,
            motion: self.motion,
            covariance: uncertainty.joint,
            halves: uncertainty.halves,
            findings,
        }
    }

    /// How far a corner lies out of the board's plane at most, with its standard deviation.
    fn largest_bend(&self, target: &Target, covariance: &SMatrix<f64, BEND, BEND>) -> (f64, f64) {
        let all: Vec<RowSVector<f64, BEND>> = (0..target.corner_count())
            .map(|k| bends(&(target.corner(k) - self.centre)).row(2).into_owned())
            .collect();
        // The plane is that of the mean.
        let mean = all.iter().sum::<RowSVector<f64, BEND>>() / all.len().max(1) as f64;
        all.iter()
            .map(|b| {
                let by = b - mean;
                let variance = (by * covariance * by.transpose())[0];
                ((by * self.bend)[0].abs(), variance.max(0.0).sqrt())
            })
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or_default()
    }

    fn camera(
        &self,
        k: usize,
        holdout_rms_px: Option<f64>,
        uncertainty: &Uncertainty,
    ) -> CameraOnImu {
        let camera = &self.cameras[k];
        let own = &uncertainty.cameras[k];
        let (mut views, mut outliers, mut errors_px) = (0, 0, Vec::new());
        let mut by_cell = CellErrors::new([camera.camera.width, camera.camera.height]);
        for view in self.views.iter().filter(|v| v.camera == k) {
            let before = errors_px.len();
            let errors = self.errors_px(view).into_iter().zip(&view.inliers);
            for ((error, inlier), (_, pixel)) in errors.zip(&view.corners) {
                match error.filter(|_| *inlier) {
                    Some(e) => {
                        errors_px.push([e.x, e.y]);
                        by_cell.add(pixel, &e);
                    }
                    None => outliers += 1,
                }
            }
            views += usize::from(errors_px.len() > before);
        }
        let squares: f64 = errors_px.iter().map(|e| e[0] * e[0] + e[1] * e[1]).sum();
        let (rotation_sigma_rad, position_sigma_m) = own.in_rig(&camera.camera_from_rig);
        let names = camera.model().parameter_names();
        let values = camera.camera.lens.parameters().values;
        let lens = names.iter().zip(values).zip(&own.lens);
        let seen = camera.cells.iter().filter(|n| **n > 0).count();
        CameraOnImu {
            name: camera.name.clone(),
            camera: camera.camera,
            lens: lens
                .map(|((name, value), sigma)| Estimate {
                    name: (*name).to_owned(),
                    value,
                    sigma: *sigma,
                })
                .collect(),
            camera_from_rig: camera.camera_from_rig,
            covariance: own.pose,
            rotation_sigma_rad,
            position_sigma_m,
            rig_from_camera_s: camera.clock.x,
            rig_from_camera_sigma_s: own.offset_s,
            clock_drift: camera.clock.y,
            clock_drift_sigma: own.drift,
            readout_s: camera.readout_s,
            readout_sigma_s: own.readout_s,
            views,
            rms_px: (squares / errors_px.len().max(1) as f64).sqrt(),
            holdout_rms_px,
            corners: errors_px.len(),
            outliers,
            coverage: seen as f64 / camera.cells.len().max(1) as f64,
            cells: camera.cells.clone(),
            cell_errors_px: by_cell.means(),
            errors_px,
        }
    }

    /// The corners of a camera that count, as the adjustment leaves them.
    pub(super) fn seen(&self, k: usize) -> impl Iterator<Item = AdjustedView> + '_ {
        self.seen_with_stamps(k).map(|(_, view)| view)
    }

    /// The same, each with its stamp in words.
    pub(super) fn seen_with_stamps(
        &self,
        k: usize,
    ) -> impl Iterator<Item = (String, AdjustedView)> + '_ {
        let own = self.views.iter().filter(move |v| v.camera == k);
        own.filter_map(move |view| Some((format!("{:.2} s", view.stamp_s), self.seen_view(view)?)))
    }

    /// Finds what moves the cameras' pixels that models do not know of, each view with a pose of its own.
    pub fn find_unmodelled(&mut self, target: &Target, config: &CameraImuConfig) {
        for k in 0..self.cameras.len() {
            let Mounted {
                camera, sigma_px, ..
            } = &self.cameras[k];
            let diagnosis = Diagnosis::new(target, camera, self.seen(k).collect());
            let variance = sigma_px * sigma_px;
            let found = match config.board {
                BoardShape::Flat => diagnosis.unmodelled(variance),
                BoardShape::Bent => Unmodelled {
                    field: diagnosis.field(variance),
                    ..Unmodelled::none()
                },
            };
            self.cameras[k].unmodelled = found;
        }
    }

    /// By how much that moves each corner of a view, if it is to be counted.
    pub fn moved_px(&self, view: &View, by: Moved) -> Vec<Vector2<f64>> {
        let still = vec![Vector2::zeros(); view.corners.len()];
        let camera = &self.cameras[view.camera];
        let (field, board) = match by {
            Moved::Nothing => return still,
            Moved::Likely => (camera.unmodelled.field, camera.unmodelled.board),
            Moved::Along(direction) => camera.unmodelled.spread_along(direction),
        };
        let Some(at) = self.at(self.time_s(view)) else {
            return still;
        };
        let [stretch, shear, a, b, c]: [f64; 5] = board.into();
        let board = Bend::new(a, b, c, stretch, shear, 0.0);
        let camera_from_target = camera.camera_from_rig * at.target_from_rig().inverse();
        let turn = camera_from_target.rotation_matrix();
        let corners = view.corners.iter().zip(still);
        corners
            .map(|((point, _), still)| {
                let in_camera = camera_from_target * self.bent(point);
                let Some(seen) = camera.camera.project_with_jacobian(&in_camera) else {
                    return still;
                };
                let by_point = seen.pixel_by_point * turn;
                let from_centre = point - self.centre;
                let place = from_centre / self.half_board_m;
                let by_field = moved_by_field(&camera.camera, &seen.pixel, &by_point, &place);
                by_field * field + by_point * (bends(&from_centre) * board)
            })
            .collect()
    }

    fn seen_view(&self, view: &View) -> Option<AdjustedView> {
        let camera = &self.cameras[view.camera];
        let at = self.at(self.time_s(view))?;
        let rig_from_target = at.target_from_rig().inverse();
        let camera_from_target = camera.camera_from_rig * rig_from_target;
        let corners = view.corners.iter().zip(&view.inliers);
        let corners = corners
            .filter(|(_, inlier)| **inlier)
            .filter_map(|((point, pixel), _)| {
                // Points of the board move against the rig by −ω × x − Rᵀ v.
                let point = self.bent(point);
                let in_rig = rig_from_target * point;
                let by_rig = -at.rotation.angular_velocity.cross(&in_rig)
                    - rig_from_target.rotation * at.position.velocity;
                let in_camera = camera.camera_from_rig * in_rig;
                let seen = camera.camera.project_with_jacobian(&in_camera)?;
                let turned = camera.camera_from_rig.rotation * by_rig;
                let velocity_px_s: Vector2<f64> = seen.pixel_by_point * turned;
                Some(AdjustedCorner {
                    point,
                    // At the view's own time.
                    pixel: pixel - velocity_px_s * camera.row_s(pixel),
                    velocity_px_s,
                })
            })
            .collect();
        Some(AdjustedView {
            camera_from_target,
            corners,
        })
    }

    /// Errors of the IMU's axes with their standard deviations, those of the accelerometer left out that were not searched.
    fn axes(&self, sigmas: &[f64], fixed: &[usize]) -> Vec<Estimate> {
        let axis = ["x", "y", "z"];
        let gyro = self.gyro_axes.iter().enumerate().map(|of| ("gyro", of));
        let accel = self.accel_axes.iter().enumerate().map(|of| ("accel", of));
        gyro.chain(accel)
            .zip(sigmas)
            .filter(|((triad, (place, _)), _)| *triad == "gyro" || !fixed.contains(place))
            .map(|((triad, (place, value)), sigma)| Estimate {
                name: format!("{triad} {}{}", axis[place / 3], axis[place % 3]),
                value: *value,
                sigma: *sigma,
            })
            .collect()
    }

    fn inertial(&self) -> Inertial {
        let mut squares = [0.0; 2];
        let mut count = [0.0; 2];
        let mut histogram = [vec![0; BINS], vec![0; BINS]];
        let mut jitter = Jitter::default();
        let matrices = [
            triad_matrix(&self.gyro_axes),
            triad_matrix(&self.accel_axes),
        ];
        for sample in &self.samples {
            // Each triad where the motion was when it measured.
            let times = [sample.time_s, sample.time_s - self.accel_delay_s];
            let [Some(at), Some(forced)] = times.map(|time_s| self.at(time_s)) else {
                continue;
            };
            let rate = at.rotation.angular_velocity;
            let (first, share) = self.bias_place(sample.time_s);
            let bias = |b: &[Vector3<f64>]| b[first] + (b[first + 1] - b[first]) * share;
            let force =
                forced.rotation.rotation.inverse() * (forced.position.acceleration - self.gravity);
            let errors = [
                (matrices[0] * rate + bias(&self.gyro_bias) - sample.gyro) / self.gyro_sigma,
                (matrices[1] * force + bias(&self.accel_bias) - sample.accel) / self.accel_sigma,
            ];
            let ends = [&sample.gyro_saturated, &sample.accel_saturated];
            let around = [-STEP_S, STEP_S].map(|step| self.at(sample.time_s + step));
            if let [Some(before), Some(after)] = around {
                let change = matrices[0]
                    * (after.rotation.angular_velocity - before.rotation.angular_velocity)
                    / (2.0 * STEP_S);
                for axis in (0..3).filter(|axis| !sample.gyro_saturated[*axis]) {
                    jitter.add(errors[0][axis] * self.gyro_sigma, change[axis]);
                }
            }
            for triad in 0..2 {
                for axis in (0..3).filter(|axis| !ends[triad][*axis]) {
                    let error = errors[triad][axis];
                    squares[triad] += error * error;
                    count[triad] += 1.0;
                    let [low, high] = HISTOGRAM_SPAN;
                    let bin = ((error - low) / (high - low) * BINS as f64).max(0.0) as usize;
                    histogram[triad][bin.min(BINS - 1)] += 1;
                }
            }
        }
        Inertial {
            ratio: [0, 1].map(|k| (squares[k] / f64::max(count[k], 1.0)).sqrt()),
            histogram,
            jitter_s: jitter.seconds(),
        }
    }

    /// The motion at a time; `None` outside the recording.
    fn at(&self, time_s: f64) -> Option<At> {
        let segment = self.segment(time_s)?;
        let range = segment.first..segment.first + ORDER;
        let motion = &self.motion;
        let rotations = motion.rotations.get(range.clone())?;
        Some(At {
            rotation: spline::rotation(&segment.weights, rotations)?,
            position: spline::position(&segment.weights, motion.positions.get(range)?)?,
        })
    }
}

/// Squared errors of a gyroscope beside the squared change of its rate: stamps that jitter make them grow together.
#[derive(Default)]
struct Jitter {
    count: f64,
    squares: f64,
    changes: f64,
    /// Sums of products: change with itself, change with error.
    both: [f64; 2],
}

impl Jitter {
    fn add(&mut self, error_rad_s: f64, change_rad_s2: f64) {
        let (error, change) = (error_rad_s.powi(2), change_rad_s2.powi(2));
        self.count += 1.0;
        self.squares += error;
        self.changes += change;
        self.both[0] += change * change;
        self.both[1] += change * error;
    }

    /// Zero where it explains little.
    fn seconds(&self) -> f64 {
        let spread = self.both[0] - self.changes * self.changes / self.count;
        let together = self.both[1] - self.changes * self.squares / self.count;
        let variance = together / spread;
        if variance * self.changes > SHARE_OF_JITTER * self.squares {
            variance.sqrt()
        } else {
            0.0
        }
    }
}

/// Where the rig is and how it moves.
struct At {
    rotation: spline::SplineRotation,
    position: spline::SplinePosition,
}

impl At {
    fn target_from_rig(&self) -> Se3 {
        Se3::new(self.rotation.rotation, self.position.position)
    }
}
