//! Time of one projection, with derivatives, for each camera model: `cargo run --release -p lsfb-geometry --example
//! projection_speed`. The same work in OpenCV: `benches/projection/opencv.py`.

use std::hint::black_box;
use std::time::Instant;

use lsfb_geometry::camera::{LensModel, MAX_PARAMETERS};
use lsfb_geometry::{Camera, Vector3};

const POINTS: usize = 10_000;
const ROUNDS: usize = 200;

#[allow(clippy::print_stdout, reason = "an example prints its result")]
fn main() {
    let points: Vec<Vector3<f64>> = (0..POINTS)
        .map(|k| {
            let t = k as f64 * 0.001;
            Vector3::new(
                0.7 * (7.3 * t).sin(),
                0.5 * (3.1 * t).cos(),
                1.2 + 0.4 * t.sin(),
            )
        })
        .collect();
    for model in LensModel::ALL {
        let mut parameters: [f64; MAX_PARAMETERS] =
            [350.0, 352.0, 321.0, 198.5, 0.0, 0.0, 0.0, 0.0, 0.0];
        let distortion: &[f64] = match model {
            LensModel::PinholeRadtan => &[-0.28, 0.07, 1e-3, -5e-4, -0.006],
            LensModel::KannalaBrandt => &[0.01, -0.02, 0.005, -0.001],
            LensModel::DoubleSphere => &[-0.172, 0.593],
            LensModel::ExtendedUnified => &[0.62, 1.1],
            LensModel::FieldOfView => &[0.92],
        };
        parameters[4..4 + distortion.len()].copy_from_slice(distortion);
        let camera = Camera {
            width: 640,
            height: 400,
            lens: model.lens(&parameters),
        };
        let time_ns = |sum: &dyn Fn(&Vector3<f64>) -> f64| {
            // The fastest round: other work on the machine only ever adds.
            let rounds = (0..ROUNDS).map(|_| {
                let start = Instant::now();
                black_box(black_box(&points).iter().map(sum).sum::<f64>());
                start.elapsed().as_secs_f64()
            });
            rounds.fold(f64::INFINITY, f64::min) * 1e9 / POINTS as f64
        };
        let plain = time_ns(&|p| camera.project(p).map_or(0.0, |q| q.x));
        let by_point = time_ns(&|p| {
            let seen = camera.project_with_jacobian(p);
            seen.map_or(0.0, |s| s.pixel.x + s.pixel_by_point.sum())
        });
        let by_all = time_ns(&|p| {
            let seen = camera.project_full(p);
            seen.map_or(0.0, |s| s.pixel_by_parameter.sum() + s.pixel_by_point.sum())
        });
        println!(
            "{:17} pixel {plain:5.1} ns, by point {by_point:5.1} ns, by point and parameter {by_all:5.1} ns",
            model.name()
        );
    }
}
