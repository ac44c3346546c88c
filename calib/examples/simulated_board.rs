//! LiDAR to camera against exact truth: `simulated_board SEEDS [POSES [SPEED]]` prints the errors of each seed, how often they
//! lie within their stated 95 % regions, and the boards that were not found; `simulated_board shuffle RUNS` gives the same
//! input in other orders.

use lsfb_geometry::Vector6;
use lsfb_rigs::board::{BOARD, Session, calibrate, error};
use lsfb_types::Finding;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// 95 % of a chi-square with six degrees of freedom.
const CHI_SQUARE: f64 = 12.5916;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let word = |k: usize, default: &str| arguments.get(k).map_or(default.into(), String::clone);
    match word(0, "20").as_str() {
        "shuffle" => shuffle(word(1, "100").parse()?),
        seeds => {
            let session = Session {
                poses: word(1, "30").parse()?,
                speed_m_s: word(2, "0").parse()?,
                ..Session::default()
            };
            seeds_against_truth(seeds.parse()?, &session)
        }
    }
}

/// What one seed left.
struct Run {
    error: Vector6<f64>,
    sigma: [f64; 6],
    nees: f64,
    lost: Vec<String>,
    warnings: Vec<String>,
}

#[allow(clippy::print_stdout, reason = "an example prints its result")]
fn seeds_against_truth(seeds: u64, session: &Session) -> Result<(), Failure> {
    let runs: Vec<Result<Run, Failure>> = (0..seeds)
        .into_par_iter()
        .map(|seed| {
            let found = calibrate(&BOARD, &session.simulate(seed))?;
            let error = error(&found);
            let inverse = found.covariance.try_inverse().ok_or("no covariance")?;
            let lost = found.poses.iter().filter_map(|p| {
                let why = p.rejected.as_ref()?;
                Some(format!("{} at {:.2} m: {why}", p.name, p.distance_m))
            });
            Ok(Run {
                error,
                sigma: found.sigma,
                nees: (error.transpose() * inverse * error)[0],
                lost: lost.collect(),
                warnings: found
                    .judgement()
                    .problems()
                    .map(Finding::sentence)
                    .collect(),
            })
        })
        .collect();
    let runs: Vec<Run> = runs.into_iter().collect::<Result<_, _>>()?;
    let (mut turns, mut shifts) = (Vec::new(), Vec::new());
    let (mut regions, mut numbers, mut lost, mut warned) = (0, 0, 0, 0);
    for (seed, run) in runs.iter().enumerate() {
        turns.push(run.error.fixed_rows::<3>(0).norm().to_degrees());
        shifts.push(run.error.fixed_rows::<3>(3).norm() * 1e3);
        regions += usize::from(run.nees < CHI_SQUARE);
        let within = |k: &usize| run.error[*k].abs() <= 1.96 * run.sigma[*k];
        numbers += (0..6).filter(within).count();
        lost += run.lost.len();
        warned += usize::from(!run.warnings.is_empty());
        for line in run.lost.iter().chain(&run.warnings) {
            println!("seed {seed}: {line}");
        }
    }
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let worst = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
    let share = |n: usize, of: usize| 100.0 * n as f64 / of.max(1) as f64;
    println!(
        "{seeds} sessions of {} poses: rotation mean {:.4}°, worst {:.4}°; translation mean {:.2} mm, worst {:.2} mm; {:.1} % within the 95 % region, {:.1} % of {} numbers within 1.96 σ, mean NEES {:.2} of 6; {lost} of {} boards not found, {warned} sessions with a warning",
        session.poses,
        mean(&turns),
        worst(&turns),
        mean(&shifts),
        worst(&shifts),
        share(regions, runs.len()),
        share(numbers, 6 * runs.len()),
        6 * runs.len(),
        mean(&runs.iter().map(|r| r.nees).collect::<Vec<f64>>()),
        session.poses * runs.len()
    );
    Ok(())
}

#[allow(clippy::print_stdout, reason = "an example prints its result")]
fn shuffle(runs: u64) -> Result<(), Failure> {
    let session = Session {
        poses: 12,
        ..Session::default()
    };
    let poses = session.simulate(3);
    let straight = calibrate(&BOARD, &poses)?;
    let apart: Vec<Result<f64, Failure>> = (0..runs)
        .into_par_iter()
        .map(|seed| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut other = poses.clone();
            other.shuffle(&mut rng);
            for pose in &mut other {
                pose.scan.points.shuffle(&mut rng);
                pose.sights[0].corners.shuffle(&mut rng);
            }
            let found = calibrate(&BOARD, &other)?;
            let off = (straight.camera_from_lidar.inverse() * found.camera_from_lidar).log();
            Ok(off.amax())
        })
        .collect();
    let apart: Vec<f64> = apart.into_iter().collect::<Result<_, _>>()?;
    let largest = apart.into_iter().fold(0.0, f64::max);
    println!("{runs} runs in other orders: largest difference {largest:e} (rad, m)");
    Ok(())
}
