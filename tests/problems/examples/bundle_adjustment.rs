//! Bundle adjustment of a file in BAL format (<https://grail.cs.washington.edu/projects/bal/>): cameras and points that explain where
//! points were seen, though some were seen wrongly.
//!
//! ```sh
//! cargo run --release -p lsfb-problems --example bundle_adjustment -- problem-16-22106-pre.txt
//! ```

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use lsfb_problems::bal;
use lsfb_solver::{Kernel, SolveConfig, solve_controlled};

/// Residuals beyond this count less and less, pixels.
const WRONG_PX: f64 = 2.0;
const PATIENCE: Duration = Duration::from_secs(60);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("bundle_adjustment FILE")?;
    let text = std::fs::read_to_string(path)?;
    // Points are added as blocks that are eliminated, which makes the reduced system one of the cameras alone.
    let mut bal = bal::parse(&text, Kernel::Huber { scale: WRONG_PX })?;
    let began = Instant::now();
    let report = solve_controlled(
        &mut bal.problem,
        &SolveConfig::default(),
        &mut |iteration| {
            println!("{:3} of at most {}", iteration.number, iteration.of);
            if began.elapsed() > PATIENCE {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        },
    )?;
    println!(
        "{} cameras, {} points: cost {:.1} -> {:.1}, {:?}",
        bal.cameras.len(),
        bal.points.len(),
        report.initial_cost,
        report.final_cost,
        report.termination
    );
    // Nothing says where the scene is, how it is turned and how large it is: seven numbers are free, and are named.
    for free in &report.undetermined {
        println!("{free}");
    }
    Ok(())
}
