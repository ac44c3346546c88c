//! A walk that grows, and is solved cold now and then.

use lsfb_solver::{Diagnosis, Incremental, IncrementalConfig, Problem, SolveConfig, solve};

use crate::cost::cpu_secs;
use lsfb_problems::walk::{Added, Target, Walk, farthest_m, solve_to_the_last_digit};

pub fn run(
    keyframes: usize,
    points: usize,
    map_percent: u32,
) -> Result<(), Box<dyn std::error::Error>> {
    let walk = Walk::in_map(keyframes, points, map_percent, 7);
    let observations: usize = walk.keyframes.iter().map(|k| k.seen.len()).sum();
    println!(
        "{keyframes} keyframes, {} points, {observations} observations",
        walk.points
    );
    let mut growing = Incremental::new(Problem::new(), IncrementalConfig::default())?;
    let mut added = Added::default();
    let mut times_ms = Vec::new();
    let step = (keyframes / 10).max(1);
    for k in 0..keyframes {
        added.add(&walk, &mut Target::Growing(&mut growing), None)?;
        let began = cpu_secs();
        let report = growing.update()?;
        times_ms.push(1e3 * (cpu_secs() - began));
        if (k + 1) % step != 0 {
            continue;
        }
        let mut problem = Problem::new();
        let mut again = Added::default();
        for _ in 0..=k {
            again.add(&walk, &mut Target::Whole(&mut problem), Some(&added))?;
        }
        let config = SolveConfig {
            cost_tolerance: 1e-12,
            max_iterations: 100,
            diagnosis: Diagnosis::Off,
            ..SolveConfig::default()
        };
        let began = cpu_secs();
        solve(&mut problem, &config)?;
        let cold_ms = 1e3 * (cpu_secs() - began);
        let optimum = solve_to_the_last_digit(&mut problem)?;
        let poses = added.poses.iter().zip(&again.poses);
        let apart_m = farthest_m(poses.map(|(a, b)| (growing.value(*a), problem.value(*b))));
        let mut recent = times_ms[times_ms.len() - step..].to_vec();
        recent.sort_by(f64::total_cmp);
        let error = walk.truth[k].inverse() * growing.value(added.poses[k]);
        println!(
            "{:5} keyframes: update median {:.2} ms, most {:.2} ms; cold {cold_ms:.1} ms; cost {:.6}, apart {:.1e}, poses {apart_m:.1e} m; last update {} rounds, {} of {} columns; {:.3} m off",
            k + 1,
            recent[step / 2],
            recent[step - 1],
            growing.cost(),
            growing.cost() / optimum - 1.0,
            report.rounds,
            report.factored_columns,
            report.columns,
            error.translation.norm(),
        );
    }
    Ok(())
}
