//! A camera against the gyroscope: when, and turned how.
//!
//! Neighbouring images are registered by rotation and by a translation before a wall at constant distance, which gives an
//! angular velocity in the camera. It is the gyroscope's, turned by the pose of the camera on the rig and moved by the time offset: both are found anew and compared.

use lsfb_geometry::camera::MAX_PARAMETERS;
use lsfb_geometry::{Camera, Matrix3, Matrix6, UnitQuaternion, Vector2, Vector3, Vector6, so3};
use lsfb_types::Image;
use nalgebra::{Matrix1x6, Rotation3};

/// Width of the images that are registered, coarse first, pixels.
const WIDTHS: [u32; 2] = [64, 160];
const ITERATIONS: usize = 8;
/// Brightness error at which a pixel's weight is halved, in units of the image's contrast.
const SCALE: f64 = 0.4;
/// Weight of no translation at all: a twentieth of the distance is a standard deviation where contrast errs by a tenth.
const REST: f64 = 4.0;
/// Offsets searched, seconds.
const REACH_S: f64 = 0.15;
const STEP_S: f64 = 0.002;
/// Spread of the angular velocity about the second most used axis that a rotation needs, rad/s.
const MIN_TURNING: f64 = 0.04;
/// Pairs of images needed.
const MIN_PAIRS: usize = 30;

/// Integral of the gyroscope over time.
pub(super) struct Gyro {
    times_s: Vec<f64>,
    angles: Vec<Vector3<f64>>,
}

/// A reduced image with its camera.
#[derive(Clone)]
struct Level {
    camera: Camera,
    values: Vec<f32>,
}

/// An image ready to be registered.
#[derive(Clone)]
pub(super) struct Frame {
    pub time_s: f64,
    levels: Vec<Level>,
}

/// A camera's angular velocity between two images.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turn {
    pub from_s: f64,
    pub to_s: f64,
    /// In the camera, rad/s.
    pub rate: Vector3<f64>,
}

/// What the gyroscope says of a camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Agreement {
    /// To be added to the camera's times beyond what the rig says, seconds.
    pub offset_s: f64,
    pub offset_sigma_s: f64,
    /// Rotation of the rig in the camera.
    pub camera_from_rig: UnitQuaternion<f64>,
    pub rotation_sigma_rad: f64,
    pub pairs: usize,
}

impl Gyro {
    /// From times (seconds) and angular velocities in order.
    pub fn new(samples: &[(f64, Vector3<f64>)]) -> Self {
        let mut angle = Vector3::zeros();
        let mut times_s = Vec::with_capacity(samples.len());
        let mut angles = Vec::with_capacity(samples.len());
        for (k, (time, rate)) in samples.iter().enumerate() {
            if let Some((before, earlier)) = k.checked_sub(1).map(|b| samples[b]) {
                angle += (earlier + rate) * (0.5 * (time - before));
            }
            times_s.push(*time);
            angles.push(angle);
        }
        Self { times_s, angles }
    }

    /// Integral up to a time; `None` outside the samples.
    pub fn angle(&self, time_s: f64) -> Option<Vector3<f64>> {
        let after = self.times_s.partition_point(|t| *t <= time_s);
        let before = after.checked_sub(1)?;
        let (t0, t1) = (self.times_s[before], *self.times_s.get(after)?);
        let share = (time_s - t0) / (t1 - t0).max(1e-9);
        Some(self.angles[before] + (self.angles[after] - self.angles[before]) * share)
    }
}

impl Frame {
    pub fn new(time_s: f64, image: &Image, camera: &Camera) -> Self {
        let levels = WIDTHS
            .iter()
            .map(|width| Level::new(image, camera, (image.width / width).max(1)))
            .collect();
        Self { time_s, levels }
    }
}

impl Level {
    fn new(image: &Image, camera: &Camera, factor: u32) -> Self {
        let (width, height) = (image.width / factor, image.height / factor);
        let mut values = averaged(image, factor);
        // Exposure changes: compare contrast, not brightness.
        let n = values.len().max(1) as f32;
        let mean = values.iter().sum::<f32>() / n;
        let spread = (values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / n).sqrt();
        for value in &mut values {
            *value = (*value - mean) / spread.max(1.0);
        }
        Self {
            camera: reduced(camera, f64::from(factor), width, height),
            values,
        }
    }

    fn sample(&self, at: &Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let inside =
            at.x >= 0.0 && at.y >= 0.0 && at.x < width as f64 - 1.0 && at.y < height as f64 - 1.0;
        if !inside {
            return None;
        }
        let (i, j) = (at.x as usize, at.y as usize);
        let (u, v) = (at.x - i as f64, at.y - j as f64);
        let value = |i: usize, j: usize| f64::from(self.values[j * width + i]);
        let (a, b, c, d) = (
            value(i, j),
            value(i + 1, j),
            value(i, j + 1),
            value(i + 1, j + 1),
        );
        let (top, bottom) = (a + (b - a) * u, c + (d - c) * u);
        let gradient = Vector2::new((b - a) * (1.0 - v) + (d - c) * v, bottom - top);
        Some((top + (bottom - top) * v, gradient))
    }
}

/// An image made smaller: means over squares of pixels.
pub(super) fn averaged(image: &Image, factor: u32) -> Vec<f32> {
    let (width, height) = (image.width / factor, image.height / factor);
    let mut values = Vec::with_capacity((width * height) as usize);
    let share = 1.0 / (factor * factor) as f32;
    for y in 0..height {
        for x in 0..width {
            let mut sum = 0u32;
            for v in 0..factor {
                let start = ((y * factor + v) * image.width + x * factor) as usize;
                let row = image.pixels.get(start..start + factor as usize);
                sum += row
                    .unwrap_or_default()
                    .iter()
                    .map(|p| u32::from(*p))
                    .sum::<u32>();
            }
            values.push(sum as f32 * share);
        }
    }
    values
}

/// The camera of an image made smaller by averaging squares of pixels.
pub(super) fn reduced(camera: &Camera, factor: f64, width: u32, height: u32) -> Camera {
    let mut values = [0.0; MAX_PARAMETERS];
    values.copy_from_slice(&camera.lens.parameters().values);
    values[0] /= factor;
    values[1] /= factor;
    values[2] = (values[2] + 0.5) / factor - 0.5;
    values[3] = (values[3] + 0.5) / factor - 0.5;
    Camera {
        width,
        height,
        lens: camera.lens.model().lens(&values),
    }
}

/// Angular velocity between two images; `None` where they do not fit by a rotation.
pub(super) fn turn(a: &Frame, b: &Frame) -> Option<Turn> {
    let mut b_from_a = UnitQuaternion::identity();
    // Over the distance of the scene.
    let mut shift = Vector3::zeros();
    for (first, second) in a.levels.iter().zip(&b.levels) {
        let width = first.camera.width as usize;
        let rays: Vec<(f64, Vector3<f64>)> = first
            .values
            .iter()
            .enumerate()
            .step_by(3)
            .filter_map(|(k, value)| {
                let pixel = Vector2::new((k % width) as f64, (k / width) as f64);
                Some((f64::from(*value), first.camera.unproject(&pixel)?))
            })
            .collect();
        for _ in 0..ITERATIONS {
            let mut normal = Matrix6::from_diagonal(&Vector6::new(0.0, 0.0, 0.0, REST, REST, REST));
            let mut right = Vector6::zeros();
            right.fixed_rows_mut::<3>(3).copy_from(&(-shift * REST));
            let mut count = 0;
            for (value, ray) in &rays {
                let turned = b_from_a * ray;
                let Some(seen) = second.camera.project_with_jacobian(&(turned + shift)) else {
                    continue;
                };
                let Some((there, gradient)) = second.sample(&seen.pixel) else {
                    continue;
                };
                let error = there - value;
                let weight = 1.0 / (1.0 + (error / SCALE).powi(2));
                // exp(φ) R ray moves by φ × R ray.
                let by_point = gradient.transpose() * seen.pixel_by_point;
                let by_turn = -(by_point * so3::hat(&turned));
                let row = Matrix1x6::new(
                    by_turn.x, by_turn.y, by_turn.z, by_point.x, by_point.y, by_point.z,
                );
                normal += row.transpose() * row * weight;
                right -= row.transpose() * (error * weight);
                count += 1;
            }
            if count < 200 {
                return None;
            }
            let step = normal.cholesky()?.solve(&right);
            b_from_a = so3::exp(&step.fixed_rows::<3>(0).into()) * b_from_a;
            shift += step.fixed_rows::<3>(3);
            if step.norm() < 1e-5 {
                break;
            }
        }
    }
    let span_s = b.time_s - a.time_s;
    (span_s > 0.0).then(|| Turn {
        from_s: a.time_s,
        to_s: b.time_s,
        rate: -so3::log(&b_from_a) / span_s,
    })
}

/// Why nothing can be said.
pub(super) enum Silent {
    TooFewPairs(usize),
    TooLittleTurning(f64),
    EndOfSearch(f64),
}

/// Compares turns with the gyroscope; times of the turns are those the rig says.
pub(super) fn agree(turns: &[Turn], gyro: &Gyro) -> Result<Agreement, Silent> {
    let usable: Vec<Turn> = turns
        .iter()
        .filter(|t| {
            gyro.angle(t.from_s - 1.1 * REACH_S).is_some()
                && gyro.angle(t.to_s + 1.1 * REACH_S).is_some()
        })
        .copied()
        .collect();
    if usable.len() < MIN_PAIRS {
        return Err(Silent::TooFewPairs(usable.len()));
    }
    let mut kept = usable;
    let mut best = Fit::at(&kept, gyro, 0.0);
    for round in 0..2 {
        let steps = (REACH_S / STEP_S).round() as i32;
        for k in -steps..=steps {
            let fit = Fit::at(&kept, gyro, f64::from(k) * STEP_S);
            if fit.cost < best.cost {
                best = fit;
            }
        }
        if round == 0 {
            // Pairs that do not fit: something walked by, or the scene is near.
            let mut errors = best.errors(&kept, gyro);
            errors.sort_by(f64::total_cmp);
            let limit = 4.0 * errors[errors.len() / 2];
            let every = best.errors(&kept, gyro);
            let mut flags = every.iter().map(|e| *e <= limit);
            kept.retain(|_| flags.next().unwrap_or(false));
            best = Fit::at(&kept, gyro, best.offset_s);
        }
    }
    if kept.len() < MIN_PAIRS {
        return Err(Silent::TooFewPairs(kept.len()));
    }
    if best.offset_s.abs() > REACH_S - 2.0 * STEP_S {
        return Err(Silent::EndOfSearch(best.offset_s));
    }
    // Down to the bottom of the parabola.
    let mut width = STEP_S;
    let mut curvature = 0.0;
    for _ in 0..4 {
        let (low, high) = (
            Fit::at(&kept, gyro, best.offset_s - width),
            Fit::at(&kept, gyro, best.offset_s + width),
        );
        curvature = (low.cost + high.cost - 2.0 * best.cost) / (width * width);
        if curvature > 0.0 {
            let shift = 0.5 * (low.cost - high.cost) / (curvature * width);
            let moved = Fit::at(&kept, gyro, best.offset_s + shift.clamp(-width, width));
            if moved.cost < best.cost {
                best = moved;
            }
        }
        width *= 0.7;
    }
    let rates: Matrix3<f64> = best
        .mean_rates(&kept, gyro)
        .iter()
        .map(|g| g * g.transpose())
        .sum();
    let n = kept.len() as f64;
    let mut spread: Vec<f64> = (rates / n)
        .symmetric_eigenvalues()
        .iter()
        .copied()
        .collect();
    spread.sort_by(f64::total_cmp);
    let second = spread[1].max(0.0).sqrt();
    if second < MIN_TURNING {
        return Err(Silent::TooLittleTurning(second));
    }
    let variance = best.cost / (3.0 * n - 7.0).max(1.0);
    // A rotation about an axis is seen by the turning about the two others.
    let weakest = spread[0].max(0.0) + spread[1].max(0.0);
    Ok(Agreement {
        offset_s: best.offset_s,
        offset_sigma_s: (2.0 * variance / curvature.max(1e-12)).sqrt(),
        camera_from_rig: best.camera_from_rig,
        rotation_sigma_rad: (variance / (n * weakest).max(1e-12)).sqrt(),
        pairs: kept.len(),
    })
}

/// The best rotation and bias at one offset.
#[derive(Clone, Copy)]
struct Fit {
    offset_s: f64,
    camera_from_rig: UnitQuaternion<f64>,
    bias: Vector3<f64>,
    cost: f64,
}

fn mean_rate(turn: &Turn, gyro: &Gyro, offset_s: f64) -> Vector3<f64> {
    let ends = (
        gyro.angle(turn.from_s + offset_s),
        gyro.angle(turn.to_s + offset_s),
    );
    match ends {
        (Some(a), Some(b)) => (b - a) / (turn.to_s - turn.from_s),
        // Turns near the ends of the gyroscope's samples were left out before.
        _ => Vector3::zeros(),
    }
}

impl Fit {
    fn at(turns: &[Turn], gyro: &Gyro, offset_s: f64) -> Self {
        let n = turns.len() as f64;
        let rates: Vec<Vector3<f64>> = turns.iter().map(|t| mean_rate(t, gyro, offset_s)).collect();
        let mean_gyro = rates.iter().sum::<Vector3<f64>>() / n;
        let mean_seen = turns.iter().map(|t| t.rate).sum::<Vector3<f64>>() / n;
        let mut covariance = Matrix3::zeros();
        for (turn, rate) in turns.iter().zip(&rates) {
            covariance += (turn.rate - mean_seen) * (rate - mean_gyro).transpose();
        }
        let svd = covariance.svd(true, true);
        let rotation = match (svd.u, svd.v_t) {
            (Some(u), Some(v_t)) => {
                let mut sign = Vector3::repeat(1.0);
                sign[svd.singular_values.imin()] = (u * v_t).determinant().signum();
                u * Matrix3::from_diagonal(&sign) * v_t
            }
            _ => Matrix3::identity(),
        };
        let camera_from_rig =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        let bias = mean_seen - camera_from_rig * mean_gyro;
        let cost = turns
            .iter()
            .zip(&rates)
            .map(|(t, g)| (t.rate - camera_from_rig * g - bias).norm_squared())
            .sum();
        Self {
            offset_s,
            camera_from_rig,
            bias,
            cost,
        }
    }

    fn mean_rates(&self, turns: &[Turn], gyro: &Gyro) -> Vec<Vector3<f64>> {
        turns
            .iter()
            .map(|t| mean_rate(t, gyro, self.offset_s))
            .collect()
    }

    fn errors(&self, turns: &[Turn], gyro: &Gyro) -> Vec<f64> {
        turns
            .iter()
            .map(|t| {
                let rate = mean_rate(t, gyro, self.offset_s);
                (t.rate - self.camera_from_rig * rate - self.bias).norm()
            })
            .collect()
    }
}
