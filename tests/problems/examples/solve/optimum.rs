//! The optimum of a problem in BAL format, written in that format for a peer to start from.

use std::fmt::Write;

use crate::{Outcome, cost};
use lsfb_problems::bal;
use lsfb_problems::bal::BalProblem;
use lsfb_problems::gauge::solve_to_the_last_bit;
use lsfb_solver::Kernel;

pub fn run(path: &str, out: &str) -> Outcome {
    let text = cost::read_text(path)?;
    let mut bal = bal::parse(&text, Kernel::Squared)?;
    let report = solve_to_the_last_bit(&mut bal)?;
    println!(
        "cost {:.9} -> {:.9}, {} iterations, {:?}",
        report.initial_cost, report.final_cost, report.iterations, report.termination
    );
    let values = 9 * bal.cameras.len() + 3 * bal.points.len();
    std::fs::write(out, with_values(&text, values, &bal)?)?;
    Ok(())
}

/// The text with its last `count` words, the values, those of the problem: to the last bit but for rotations, which are
/// quaternions here and vectors there.
fn with_values(text: &str, count: usize, bal: &BalProblem) -> Result<String, std::fmt::Error> {
    let words: Vec<&str> = text.split_ascii_whitespace().collect();
    let (counts, observations) = words[..words.len() - count].split_at(3);
    let mut out = format!("{}\n", counts.join(" "));
    for observation in observations.chunks(4) {
        writeln!(out, "{}", observation.join(" "))?;
    }
    for camera in &bal.cameras {
        let camera = bal.problem.value(*camera);
        let turn = camera.camera_from_world.scaled_axis();
        let values = [turn, camera.translation, camera.intrinsics];
        for x in values.iter().flatten() {
            writeln!(out, "{x:.17e}")?;
        }
    }
    for point in &bal.points {
        for x in &bal.problem.value(*point) {
            writeln!(out, "{x:.17e}")?;
        }
    }
    Ok(out)
}
