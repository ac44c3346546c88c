//! No iteration after the first takes memory.

#![allow(unsafe_code, reason = "an allocator that counts is unsafe to declare")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};

use lsfb_geometry::Vector3;
use lsfb_problems::bal;
use lsfb_solver::{
    Diagnosis, Kernel, LinearSolver, Method, SolveConfig, VectorPrior, solve_controlled,
};

struct Counting;

static TAKEN: AtomicUsize = AtomicUsize::new(0);

// SAFETY: everything is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        TAKEN.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller keeps the contract.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Cameras round some points, everything a bit off, and a prior on one camera's neighbourhood.
fn problem() -> lsfb_solver::Problem {
    let mut text = String::new();
    let (cameras, points) = (10, 300);
    let position = |p: usize| {
        let t = p as f64;
        [
            3.0 * (1.3 * t).sin(),
            2.0 * (2.1 * t).cos(),
            2.0 * (0.7 * t).sin(),
        ]
    };
    for p in 0..points {
        for c in 0..cameras {
            let (sin, cos) = (c as f64 * 0.1 - 0.5).sin_cos();
            let [x, y, z] = position(p);
            let (u, v, w) = (cos * x + sin * z, y, -sin * x + cos * z - 10.0);
            text += &format!("{c} {p} {} {}\n", -500.0 * u / w, -500.0 * v / w);
        }
    }
    text = format!("{cameras} {points} {}\n{text}", cameras * points);
    for c in 0..cameras {
        text += &format!(
            "0.01 {} 0.01 0.1 0.1 -10.1 520 0 0\n",
            c as f64 * 0.1 - 0.49
        );
    }
    for p in 0..points {
        let [x, y, z] = position(p);
        text += &format!("{} {} {}\n", x + 0.1, y - 0.1, z + 0.1);
    }
    let mut bal = bal::parse(&text, Kernel::Huber { scale: 1.0 }).expect("a BAL file");
    let loose = bal.problem.add_block(Vector3::zeros());
    let prior = VectorPrior::new(Vector3::new(1.0, 2.0, 3.0), Vector3::repeat(1.0));
    bal.problem
        .add_residual(prior, &[loose.id()], Kernel::Squared)
        .expect("blocks fit");
    let problem = &mut bal.problem;
    problem.set_bounds(loose, 0, -1.0, 0.5).expect("bounds");
    problem
        .set_bounds(bal.points[7], 2, -5.0, 5.0)
        .expect("bounds");
    problem
        .set_constant_components(bal.cameras[0], &[0, 1, 2, 3, 4, 5])
        .expect("a camera has a pose");
    bal.problem
}

#[test]
fn iterations_after_the_first_take_no_memory() {
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("pool");
        // A thread takes memory of its own when it first looks for work, and when it first does some, which on a busy machine may be late: by
        // the second of these each has done both.
        pool.broadcast(|_| ());
        pool.broadcast(|_| {
            let solved = solve_controlled(&mut problem(), &SolveConfig::default(), &mut |_| {
                ControlFlow::Continue(())
            });
            solved.expect("solves");
        });
        for (linear_solver, method) in [
            (LinearSolver::Dense, Method::LevenbergMarquardt),
            (LinearSolver::Sparse, Method::LevenbergMarquardt),
            (LinearSolver::Iterative, Method::LevenbergMarquardt),
            (LinearSolver::Dense, Method::Dogleg),
        ] {
            let config = SolveConfig {
                linear_solver,
                method,
                cost_tolerance: 0.0,
                gradient_tolerance: 0.0,
                step_tolerance: 0.0,
                max_iterations: 8,
                diagnosis: Diagnosis::Off,
                ..SolveConfig::default()
            };
            let taken: Vec<usize> = pool.install(|| {
                let mut problem = problem();
                let mut taken = Vec::with_capacity(64);
                solve_controlled(&mut problem, &config, &mut |_| {
                    if taken.len() < taken.capacity() {
                        taken.push(TAKEN.load(Ordering::Relaxed));
                    }
                    ControlFlow::Continue(())
                })
                .expect("solves");
                taken
            });
            assert!(taken.len() > 3, "{linear_solver:?} {method:?}: {taken:?}");
            assert!(
                taken.iter().all(|count| *count == taken[0]),
                "{threads} threads, {linear_solver:?} {method:?}: {taken:?}"
            );
        }
    }
}
