//! Growing problems against cold solves of the same.

use lsfb_geometry::{Se3, Vector2, Vector6};
use lsfb_problems::walk::{Added, Target, Walk, farthest_m, solve_to_the_last_digit};
use lsfb_solver::{
    Diagnosis, Incremental, IncrementalConfig, Kernel, PosePrior, Problem, SolveConfig,
    UpdateReport, VectorPrior, solve,
};

fn cold(walk: &Walk, added: &Added, keyframes: usize) -> f64 {
    cold_with_last(walk, added, keyframes).0
}

/// Cost of a cold solve, and where it has the last keyframe.
fn cold_with_last(walk: &Walk, added: &Added, keyframes: usize) -> (f64, Se3) {
    let mut problem = Problem::new();
    let mut again = Added::default();
    for _ in 0..keyframes {
        again
            .add(walk, &mut Target::Whole(&mut problem), Some(added))
            .expect("blocks fit");
    }
    let config = SolveConfig {
        cost_tolerance: 1e-13,
        max_iterations: 200,
        diagnosis: Diagnosis::Off,
        ..SolveConfig::default()
    };
    let cost = solve(&mut problem, &config).expect("solves").final_cost;
    (cost, problem.value(again.poses[keyframes - 1]))
}

#[test]
fn the_cost_of_a_growing_walk_is_that_of_a_cold_solve() {
    let walk = Walk::new(80, 40, 3);
    let mut growing =
        Incremental::new(Problem::new(), IncrementalConfig::default()).expect("starts");
    let mut added = Added::default();
    let mut few_columns = 0;
    for k in 0..walk.keyframes.len() {
        added
            .add(&walk, &mut Target::Growing(&mut growing), None)
            .expect("blocks fit");
        let report = growing.update().expect("updates");
        assert!(report.converged, "keyframe {k}: {report:?}");
        few_columns += usize::from(report.factored_columns < 20 * report.rounds);
        // Every keyframe at first, and about the loop; some of those between.
        if !(10..=74).contains(&k) || k % 10 == 0 {
            let expected = cold(&walk, &added, k + 1);
            // One keyframe alone fits all that it saw: there the cost is zero.
            let apart = (growing.cost() - expected).abs();
            let allowed = 1e-6 * expected + 1e-9;
            assert!(
                apart < allowed,
                "keyframe {k}: {apart:.1e} {expected} {report:?}"
            );
        }
    }
    assert!(few_columns > 60, "{few_columns}");
    let end = added.poses[79];
    let error = walk.truth[79].inverse() * growing.value(end);
    assert!(error.translation.norm() < 0.1, "{error:?}");
}

#[test]
fn work_does_not_grow_with_the_walk() {
    for seed in [6, 7] {
        let walk = Walk::new(300, 40, seed);
        let mut growing =
            Incremental::new(Problem::new(), IncrementalConfig::default()).expect("starts");
        let mut added = Added::default();
        let mut reports = Vec::new();
        // The loop closes behind the last of these.
        for _ in 0..270 {
            added
                .add(&walk, &mut Target::Growing(&mut growing), None)
                .expect("blocks fit");
            reports.push(growing.update().expect("updates"));
        }
        let work = |range: std::ops::Range<usize>| {
            let reports = &reports[range];
            let residuals: usize = reports.iter().map(|r| r.relinearized_residuals).sum();
            let columns: usize = reports.iter().map(|r| r.factored_columns).sum();
            [residuals, columns].map(|sum| sum as f64 / reports.len() as f64)
        };
        let (early, late) = (work(50..100), work(220..270));
        for (early, late) in early.iter().zip(&late) {
            assert!(*late < 1.3 * early, "{early} {late}");
        }
        let (expected, last) = cold_with_last(&walk, &added, 270);
        let apart = growing.cost() / expected - 1.0;
        assert!(apart.abs() < 1e-7, "{apart:.1e}");
        let moved = growing.value(added.poses[269]).translation - last.translation;
        assert!(moved.norm() < 2e-3, "{:.1e} m", moved.norm());
    }
}

#[test]
fn in_a_map_poses_are_those_of_the_optimum_and_work_does_not_grow() {
    for seed in [6, 7, 8] {
        let walk = Walk::in_map(400, 60, 20, seed);
        let mut growing =
            Incremental::new(Problem::new(), IncrementalConfig::default()).expect("starts");
        let mut added = Added::default();
        let mut work = Vec::new();
        // The loop closes behind the last of these.
        for k in 0..360 {
            added
                .add(&walk, &mut Target::Growing(&mut growing), None)
                .expect("blocks fit");
            let report = growing.update().expect("updates");
            assert!(report.converged && !report.solved_cold, "{k}: {report:?}");
            work.push(report.relinearized_residuals + report.factored_columns);
            if (k + 1) % 60 != 0 {
                continue;
            }
            let mut optimum = growing.snapshot();
            let least = solve_to_the_last_digit(&mut optimum).expect("solves");
            let above = growing.cost() / least - 1.0;
            assert!(above < 1e-8, "keyframe {k}: {above:.1e}");
            let poses = added.poses.iter();
            let apart_m = farthest_m(poses.map(|p| (growing.value(*p), optimum.value(*p))));
            assert!(apart_m < 1e-6, "keyframe {k}: {apart_m:.1e} m");
        }
        let mean = |range: std::ops::Range<usize>| {
            work[range.clone()].iter().sum::<usize>() as f64 / range.len() as f64
        };
        let (early, late) = (mean(60..120), mean(300..360));
        assert!(late < 1.2 * early, "{early} {late}");
    }
}

/// With the order of elimination in which keyframes came, each round of each update at a loop made all columns anew, with rows of all keyframes of the
/// loop: the last of these took 3.5 s at 2 000 keyframes, where a cold solve took 0.43.
#[test]
fn a_loop_makes_the_columns_between_anew_once() {
    const KEYFRAMES: usize = 320;
    // Without a map everything turns a little with each update, and is linearized anew in any order.
    for (map_percent, most, farthest_allowed_m) in [(20, 0.5, 1e-6), (0, 1.0, 1e-3)] {
        let walk = Walk::in_map(KEYFRAMES, 60, map_percent, 6);
        let mut growing =
            Incremental::new(Problem::new(), IncrementalConfig::default()).expect("starts");
        let mut added = Added::default();
        let of_first = |(number, _): &(usize, _)| {
            walk.keyframes[0]
                .seen
                .iter()
                .any(|(other, _)| other == number)
        };
        let (mut is_closed, mut anew, mut rounds) = (false, 0, 0);
        for k in 0..KEYFRAMES {
            is_closed |= k > KEYFRAMES / 2 && walk.keyframes[k].seen.iter().any(of_first);
            added
                .add(&walk, &mut Target::Growing(&mut growing), None)
                .expect("blocks fit");
            let report = growing.update().expect("updates");
            assert!(report.converged && !report.solved_cold, "{k}: {report:?}");
            if is_closed {
                anew += report.factored_columns;
                rounds += report.rounds;
            }
            if k % 4 == 0 && k > 300 || k + 1 == KEYFRAMES {
                let mut optimum = growing.snapshot();
                let least = solve_to_the_last_digit(&mut optimum).expect("solves");
                let above = growing.cost() / least - 1.0;
                assert!(above < 1e-8, "keyframe {k}: {above:.1e}");
                let poses = added.poses.iter();
                let apart_m = farthest_m(poses.map(|p| (growing.value(*p), optimum.value(*p))));
                assert!(
                    apart_m < farthest_allowed_m,
                    "keyframe {k}: {apart_m:.1e} m"
                );
            }
        }
        assert!(rounds > 50, "{rounds} rounds at the loop");
        let share = anew as f64 / (rounds * KEYFRAMES) as f64;
        assert!(
            share < most,
            "{map_percent} %: {share:.2} of all columns in a round of the loop"
        );
    }
}

#[test]
fn what_is_removed_leaves_no_trace() {
    let walk = Walk::new(30, 40, 4);
    let mut growing =
        Incremental::new(Problem::new(), IncrementalConfig::default()).expect("starts");
    let mut added = Added::default();
    for _ in 0..30 {
        added
            .add(&walk, &mut Target::Growing(&mut growing), None)
            .expect("blocks fit");
        growing.update().expect("updates");
    }
    // A wrong point and a wrong pull on a pose come and go.
    let cost = growing.cost();
    let pose = added.poses[12];
    let shift = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.2, 0.1, 0.0));
    let wrong = PosePrior::isotropic(growing.value(pose) * shift, 0.01, 0.01);
    let pull = growing
        .add_residual(wrong, &[pose.id()], Kernel::Squared)
        .expect("blocks fit");
    growing.update().expect("updates");
    assert!(growing.cost() > 1.1 * cost);
    growing.remove_residual(pull);
    growing.update().expect("updates");
    let apart = growing.cost() / cost - 1.0;
    assert!(apart.abs() < 1e-6, "{apart:.1e}");

    // The last keyframe goes: what stays is the walk without it.
    let last = added.poses.pop().expect("thirty keyframes");
    growing.remove_block(last);
    growing.update().expect("updates");
    let expected = cold(&walk, &added, 29);
    // Points that only the last keyframe saw cost nothing.
    let apart = growing.cost() / expected - 1.0;
    assert!(apart.abs() < 1e-6, "{apart:.1e}");
}

#[test]
fn growing_has_the_same_bits_on_any_number_of_threads() {
    let (reports, bits) = grown_on(1);
    assert!(reports.iter().any(|report| report.solved_cold));
    for threads in [2, 16] {
        let (other, other_bits) = grown_on(threads);
        assert_eq!(other, reports, "{threads} threads");
        assert!(other_bits == bits, "{threads} threads");
    }
}

/// Reports of all updates, and the bits of costs and values after each: growing, a pull so wrong that a cold solve takes
/// over, its removal, and that of a pose.
fn grown_on(threads: usize) -> (Vec<UpdateReport>, Vec<u64>) {
    fn update(growing: &mut Incremental, reports: &mut Vec<UpdateReport>, bits: &mut Vec<u64>) {
        reports.push(growing.update().expect("updates"));
        bits.push(growing.cost().to_bits());
        let now = growing.snapshot();
        bits.extend(now.stored_values().iter().map(|x| x.to_bits()));
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("pool");
    pool.install(|| {
        let walk = Walk::new(40, 60, 5);
        let mut growing =
            Incremental::new(Problem::new(), IncrementalConfig::default()).expect("starts");
        let (mut added, mut reports, mut bits) = (Added::default(), Vec::new(), Vec::new());
        for _ in 0..40 {
            added
                .add(&walk, &mut Target::Growing(&mut growing), None)
                .expect("blocks fit");
            update(&mut growing, &mut reports, &mut bits);
        }
        let pose = added.poses[20];
        let shift = Se3::exp(&Vector6::new(0.0, 0.0, 2.5, 30.0, -20.0, 0.0));
        let wrong = PosePrior::isotropic(growing.value(pose) * shift, 1e-3, 1e-3);
        let pull = growing
            .add_residual(wrong, &[pose.id()], Kernel::Squared)
            .expect("blocks fit");
        update(&mut growing, &mut reports, &mut bits);
        update(&mut growing, &mut reports, &mut bits);
        growing.remove_residual(pull);
        update(&mut growing, &mut reports, &mut bits);
        growing.remove_block(pose);
        update(&mut growing, &mut reports, &mut bits);
        (reports, bits)
    })
}

#[test]
fn held_blocks_are_points_of_the_map() {
    let mut growing =
        Incremental::new(Problem::new(), IncrementalConfig::default()).expect("starts");
    let block = growing.add_block(Vector2::new(5.0, 5.0));
    let prior = VectorPrior::new(Vector2::new(1.0, 2.0), Vector2::repeat(1.0));
    growing
        .add_residual(prior, &[block.id()], Kernel::Squared)
        .expect("blocks fit");
    growing.set_constant(block);
    growing.update().expect("updates");
    assert_eq!(growing.value(block), Vector2::new(5.0, 5.0));
    growing.set_free(block);
    let report = growing.update().expect("updates");
    assert!(report.converged);
    assert!((growing.value(block) - Vector2::new(1.0, 2.0)).norm() < 1e-6);
    // A block that is new, and held, does not make everything begin anew.
    let known = growing.add_block(Vector2::new(7.0, 7.0));
    growing
        .add_residual(
            VectorPrior::new(Vector2::new(6.0, 7.0), Vector2::repeat(1.0)),
            &[known.id()],
            Kernel::Squared,
        )
        .expect("blocks fit");
    growing.set_constant(known);
    let report = growing.update().expect("updates");
    assert_eq!(report.relinearized_residuals, 1, "{report:?}");
    assert_eq!(growing.value(known), Vector2::new(7.0, 7.0));
    let problem = growing.into_problem();
    assert!((problem.value(block) - Vector2::new(1.0, 2.0)).norm() < 1e-6);
}

#[test]
fn bounds_are_kept() {
    let mut problem = Problem::new();
    let block = problem.add_block(Vector2::new(0.0, 0.0));
    problem
        .set_bounds(block, 0, -1.0, 1.0)
        .expect("is a component");
    let mut growing = Incremental::new(problem, IncrementalConfig::default()).expect("starts");
    let prior = VectorPrior::new(Vector2::new(5.0, 2.0), Vector2::repeat(1.0));
    growing
        .add_residual(prior, &[block.id()], Kernel::Squared)
        .expect("blocks fit");
    growing.update().expect("updates");
    assert!((growing.value(block) - Vector2::new(1.0, 2.0)).norm() < 1e-6);
}

#[test]
fn what_is_not_finite_is_said_until_it_is_gone() {
    let mut growing =
        Incremental::new(Problem::new(), IncrementalConfig::default()).expect("starts");
    let block = growing.add_block(Vector2::new(0.0, 0.0));
    let prior = |x: f64| VectorPrior::new(Vector2::new(x, 2.0), Vector2::repeat(1.0));
    growing
        .add_residual(prior(1.0), &[block.id()], Kernel::Squared)
        .expect("blocks fit");
    let wrong = growing
        .add_residual(prior(f64::NAN), &[block.id()], Kernel::Squared)
        .expect("blocks fit");
    assert!(growing.update().is_err());
    assert!(growing.update().is_err());
    growing.remove_residual(wrong);
    growing.update().expect("updates");
    assert!((growing.value(block) - Vector2::new(1.0, 2.0)).norm() < 1e-6);
}
