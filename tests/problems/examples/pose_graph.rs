//! Solves a pose graph in g2o format and writes it again, its poses improved:
//!
//! ```sh
//! cargo run --release -p lsfb-problems --example pose_graph -- sphere.g2o solved.g2o
//! ```

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use std::fmt::Write as _;

use lsfb_problems::g2o;
use lsfb_solver::{SolveConfig, solve};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut path = || arguments.next().ok_or("pose_graph IN.g2o OUT.g2o");
    let (input, output) = (path()?, path()?);
    let text = std::fs::read_to_string(input)?;
    // Each edge becomes a residual between two poses, the first pose is held: see `tests/problems/src/g2o.rs`.
    let mut graph = g2o::parse(&text)?;
    let report = solve(&mut graph.problem, &SolveConfig::default())?;
    println!(
        "{} poses, {} edges: cost {:.3} -> {:.3} in {} iterations",
        graph.poses.len(),
        graph.edges,
        report.initial_cost,
        report.final_cost,
        report.iterations
    );
    // What the data do not determine is named; a graph in two parts leaves one of them free.
    for free in &report.undetermined {
        println!("{free}");
    }
    let mut solved = String::new();
    let mut poses = graph.poses.iter();
    for line in text.lines() {
        let mut words = line.split_ascii_whitespace();
        match (words.next(), words.next()) {
            (Some(kind @ "VERTEX_SE3:QUAT"), Some(id)) => {
                let pose = graph
                    .problem
                    .value(*poses.next().ok_or("a vertex without a pose")?);
                let (t, q) = (pose.translation, pose.rotation.coords);
                writeln!(
                    solved,
                    "{kind} {id} {} {} {} {} {} {} {}",
                    t.x, t.y, t.z, q.x, q.y, q.z, q.w
                )?;
            }
            _ => writeln!(solved, "{line}")?,
        }
    }
    std::fs::write(output, solved)?;
    Ok(())
}
