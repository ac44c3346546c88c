//! Eq. 3 against exact truth: `joint_rigs BATCHES RIGS` prints the LiDAR's error after joining over that of the four chains alone,
//! beside what the graph can give at best, and how often all poses lie within their stated 95 % regions: mean over batches of
//! rigs, and the worst batch.

use lsfb_calib::joint::{JointConfig, LIDAR, Weights, join_transforms};
use lsfb_rigs::graph::{Errors, Graph, difference, squares};
use rayon::prelude::*;

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// 95 % of a chi-square with six degrees of freedom.
const CHI_SQUARE: f64 = 12.5916;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let word = |k: usize, default: &str| arguments.get(k).map_or(default.into(), String::clone);
    let (batches, rigs): (u64, u64) = (word(0, "20").parse()?, word(1, "200").parse()?);
    for (name, errors, weights) in [
        ("paper's covariances, true", Errors::Paper, Weights::Paper),
        ("measured covariances", Errors::Measured, Weights::Measured),
        (
            "the same rigs, paper's weights",
            Errors::Measured,
            Weights::Paper,
        ),
    ] {
        let run = |batch: u64| Batch::run(errors, weights, batch * rigs..(batch + 1) * rigs);
        let all: Vec<Batch> = (0..batches)
            .into_par_iter()
            .map(run)
            .collect::<Result<_, _>>()?;
        print(name, errors, &all);
    }
    Ok(())
}

/// Sums over the rigs of a batch.
#[derive(Default)]
struct Batch {
    joint: [f64; 2],
    alone: [f64; 2],
    expected_joint: [f64; 2],
    expected_alone: [f64; 2],
    inside: f64,
    poses: f64,
}

impl Batch {
    fn run(errors: Errors, weights: Weights, seeds: std::ops::Range<u64>) -> Result<Self, Failure> {
        let config = JointConfig {
            weights,
            ..JointConfig::default()
        };
        let mut sums = Self::default();
        for seed in seeds {
            let graph = Graph::simulate(errors, seed);
            let found = join_transforms(&graph.edges, &config)?;
            for sensor in &found.sensors {
                let error = difference(&graph.truth(&sensor.name), &sensor.imu_from_sensor);
                let inverse = sensor.covariance.try_inverse().ok_or("no covariance")?;
                let nees = (error.transpose() * inverse * error)[0];
                sums.inside += f64::from(u8::from(nees < CHI_SQUARE));
                sums.poses += 1.0;
            }
            let lidar = found.sensor(LIDAR).ok_or("no LiDAR")?.imu_from_sensor;
            let own = squares(&lidar, &graph.lidar);
            let [alone, joint] = graph.expected_squares();
            for k in 0..2 {
                sums.joint[k] += own[k];
                let chains = (0..4).map(|c| squares(&graph.chain(c), &graph.lidar)[k]);
                sums.alone[k] += chains.sum::<f64>() / 4.0;
                sums.expected_joint[k] += joint[k];
                sums.expected_alone[k] += alone[k];
            }
        }
        Ok(sums)
    }

    fn ratio(&self, k: usize) -> f64 {
        (self.joint[k] / self.alone[k]).sqrt()
    }

    fn expected(&self, k: usize) -> f64 {
        (self.expected_joint[k] / self.expected_alone[k]).sqrt()
    }

    fn coverage(&self) -> f64 {
        100.0 * self.inside / self.poses
    }
}

#[allow(clippy::print_stdout, reason = "an example prints its result")]
fn print(name: &str, errors: Errors, batches: &[Batch]) {
    let n = batches.len() as f64;
    for (k, what) in ["rotation", "translation"].iter().enumerate() {
        let ratios: Vec<f64> = batches.iter().map(|b| b.ratio(k)).collect();
        let mean = ratios.iter().sum::<f64>() / n;
        let spread = (ratios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        let worst = ratios.iter().copied().fold(0.0, f64::max);
        let theory = match errors {
            Errors::Paper => format!(
                ", {:.4} in theory",
                batches.iter().map(|b| b.expected(k)).sum::<f64>() / n
            ),
            Errors::Measured => String::new(),
        };
        println!(
            "{name}: {what} of the LiDAR, joint over separate: mean {mean:.4} ± {:.4}{theory}, one batch ± {spread:.3}, worst batch {worst:.3}",
            spread / n.sqrt()
        );
    }
    let coverage: Vec<f64> = batches.iter().map(Batch::coverage).collect();
    println!(
        "{name}: {:.1} % of all poses within their 95 % region, by batch {:.1} to {:.1} %",
        coverage.iter().sum::<f64>() / n,
        coverage.iter().copied().fold(100.0, f64::min),
        coverage.iter().copied().fold(0.0, f64::max)
    );
}
