//! The time and the result of the pose search, on problems that another program made: `benches/localization/poselib_pose.py`.
//!
//! `cargo run --release -p lsfb-pipeline --example pose_search -- PROBLEMS`
//!
//! `PROBLEMS` has numbers of eight bytes, little-endian: how many problems, how many points each, width, height, two focal lengths and the
//! principal point; then five numbers a point, of one problem after the other: pixel and position. A line for each problem: milliseconds of
//! CPU time of one thread, samples drawn, and where the camera is.

#![allow(clippy::print_stdout)] // a program, not a library

use std::error::Error;

use lsfb_geometry::{Camera, Matrix3, Se3, Vector2, Vector3};
use lsfb_pipeline::localization::{
    MountedCamera, PointMatch, RansacConfig, RefinementConfig, estimate_pose,
};
use nix::time::{ClockId, clock_gettime};

/// As the peer is told.
const MAX_ERROR_PX: f64 = 4.0;
const MIN_SAMPLES: usize = 100;
const MAX_SAMPLES: usize = 1000;
const CONFIDENCE: f64 = 0.9999;
/// Each problem is solved so often; the median counts.
const REPEATED: usize = 5;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("give a file of problems")?;
    let bytes = std::fs::read(path)?;
    let numbers = bytes.as_chunks::<8>().0.iter();
    let numbers: Vec<f64> = numbers.map(|b| f64::from_le_bytes(*b)).collect();
    let [_, points, width, height, fx, fy, cx, cy, rows @ ..] = numbers.as_slice() else {
        return Err("the file has no head".into());
    };
    let cameras = [MountedCamera {
        camera: Camera::pinhole(*width as u32, *height as u32, [*fx, *fy], [*cx, *cy]),
        rig_from_camera: Se3::identity(),
        readout_s: 0.0,
    }];
    let config = RansacConfig {
        max_error_px: MAX_ERROR_PX,
        min_samples: MIN_SAMPLES,
        max_samples: MAX_SAMPLES,
        confidence: CONFIDENCE,
        // The peer's errors count in squares up to the limit.
        refinement: RefinementConfig {
            huber_px: MAX_ERROR_PX,
            ..RefinementConfig::default()
        },
        ..RansacConfig::default()
    };
    for problem in rows.as_chunks::<5>().0.chunks((*points as usize).max(1)) {
        let matches: Vec<PointMatch> = problem
            .iter()
            .map(|[u, v, x, y, z]| PointMatch {
                camera: 0,
                pixel: Vector2::new(*u, *v),
                point_in_world: Vector3::new(*x, *y, *z),
                point_covariance_m2: Matrix3::zeros(),
            })
            .collect();
        let mut times_ms = Vec::with_capacity(REPEATED);
        let mut found = None;
        for _ in 0..REPEATED {
            let begun = clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID)?;
            found = estimate_pose(&cameras, &matches, &config);
            let spent = clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID)? - begun;
            times_ms.push(spent.tv_sec() as f64 * 1e3 + spent.tv_nsec() as f64 * 1e-6);
        }
        times_ms.sort_by(f64::total_cmp);
        let found = found.ok_or("no pose")?;
        let [x, y, z] = found.world_from_rig.translation.into();
        println!("{} {} {x} {y} {z}", times_ms[REPEATED / 2], found.samples);
    }
    Ok(())
}
