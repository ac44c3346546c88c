use lsfb_problems::bal::{self, BalProblem};
use lsfb_solver::{Kernel, LinearSolver, Method, Report, SolveConfig, solve};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A made-up BAL problem: cameras on an arc look at scattered points; starting values are disturbed.
pub fn scattered(cameras: usize, points: usize) -> BalProblem {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut uniform = move |half: f64| (rng.random::<f64>() * 2.0 - 1.0) * half;
    let positions: Vec<[f64; 3]> = (0..points)
        .map(|_| [uniform(3.0), uniform(2.0), uniform(2.0)])
        .collect();
    let angles: Vec<f64> = (0..cameras).map(|c| c as f64 * 0.1 - 1.0).collect();
    let mut observations = String::new();
    let mut count = 0;
    for (p, x) in positions.iter().enumerate() {
        for (c, angle) in angles.iter().enumerate() {
            if (p + 3 * c) % 4 == 0 {
                continue;
            }
            let (sin, cos) = angle.sin_cos();
            let in_camera = [
                cos * x[0] + sin * x[2],
                x[1],
                -sin * x[0] + cos * x[2] - 10.0,
            ];
            let u = -in_camera[0] / in_camera[2] * 500.0 + uniform(0.5);
            let v = -in_camera[1] / in_camera[2] * 500.0 + uniform(0.5);
            observations += &format!("{c} {p} {u} {v}\n");
            count += 1;
        }
    }
    let mut text = format!("{cameras} {points} {count}\n{observations}");
    for angle in &angles {
        text += &format!(
            "{} {} {} {} {} {} 505 0 0\n",
            uniform(0.01),
            angle + uniform(0.01),
            uniform(0.01),
            uniform(0.1),
            uniform(0.1),
            -10.0 + uniform(0.1)
        );
    }
    for x in &positions {
        text += &format!(
            "{} {} {}\n",
            x[0] + uniform(0.1),
            x[1] + uniform(0.1),
            x[2] + uniform(0.1)
        );
    }
    bal::parse(&text, Kernel::Squared).expect("its own text")
}

#[test]
fn same_bits_on_any_number_of_threads() {
    for (linear_solver, method) in [
        (LinearSolver::Auto, Method::LevenbergMarquardt),
        (LinearSolver::Sparse, Method::LevenbergMarquardt),
        (LinearSolver::Iterative, Method::LevenbergMarquardt),
        (LinearSolver::Dense, Method::Dogleg),
    ] {
        let config = SolveConfig {
            linear_solver,
            method,
            ..SolveConfig::default()
        };
        let (report, bits) = solved_on(1, &config);
        assert!(report.final_cost < 1e-2 * report.initial_cost, "{report:?}");
        for threads in [2, 3, 16] {
            let (other, other_bits) = solved_on(threads, &config);
            assert_eq!(other, report, "{threads} threads, {config:?}");
            assert!(other_bits == bits, "{threads} threads, {config:?}");
        }
    }
}

/// Report, and the bits of all values.
fn solved_on(threads: usize, config: &SolveConfig) -> (Report, Vec<u64>) {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("pool");
    pool.install(|| {
        let mut problem = scattered(20, 700).problem;
        let report = solve(&mut problem, config).expect("solves");
        let values = problem.stored_values().iter();
        (report, values.map(|x| x.to_bits()).collect())
    })
}
