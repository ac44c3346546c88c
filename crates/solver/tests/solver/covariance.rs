//! Covariances against a dense inverse, and against those of Ceres.

use lsfb_geometry::{Matrix6, Se3};
use lsfb_problems::bal::{BalProblem, parse};
use lsfb_problems::g2o::Between;
use lsfb_problems::gauge::{hold_gauge, solve_to_the_last_bit};
use lsfb_solver::{
    BlockId, Error, Kernel, Problem, SolveConfig, covariance, covariance_of_groups, dense_jacobian,
    solve,
};
use nalgebra::DMatrix;

use crate::bal::ladybug;
use crate::threads::scattered;

#[test]
fn covariances_are_blocks_of_the_dense_inverse() {
    let mut bal = scattered(4, 40);
    hold_gauge(&mut bal, 3).expect("cameras have poses");
    solve(&mut bal.problem, &SolveConfig::default()).expect("solves");
    let dense = dense_jacobian(&bal.problem).expect("defined");
    let normal = dense.matrix.transpose() * &dense.matrix;
    // Scaled, so that the oracle is as exact as it can be.
    let scale = normal.diagonal().map(|d| 1.0 / d.sqrt());
    let scaled = DMatrix::from_fn(scale.len(), scale.len(), |r, c| {
        normal[(r, c)] * scale[r] * scale[c]
    });
    let inverse = scaled.cholesky().expect("determined").inverse();
    let chosen: Vec<BlockId> = [
        bal.cameras[2].id(),
        bal.points[7].id(),
        bal.cameras[1].id(),
        bal.points[30].id(),
    ]
    .into();
    let found = covariance(&bal.problem, &chosen).expect("determined");
    for a in &chosen {
        for b in &chosen {
            let block = found.between(*a, *b).expect("was asked for");
            for (r, row) in dense.columns_of(*a).iter().copied().enumerate() {
                for (c, column) in dense.columns_of(*b).iter().copied().enumerate() {
                    let expected = match (row, column) {
                        (Some(r), Some(c)) => inverse[(r, c)] * scale[r] * scale[c],
                        _ => 0.0,
                    };
                    let deviation = |row: Option<usize>| {
                        row.map_or(1.0, |r| (inverse[(r, r)] * scale[r] * scale[r]).sqrt())
                    };
                    let error = (block[(r, c)] - expected).abs();
                    assert!(
                        error <= 1e-8 * deviation(row) * deviation(column),
                        "{a:?} {b:?} ({r}, {c}): {} instead of {expected}",
                        block[(r, c)]
                    );
                }
            }
        }
    }
    assert!(found.between(bal.cameras[0].id(), chosen[0]).is_none());
}

/// Groups, one block in two of them, are what each is alone; and work that is refused ends.
#[test]
fn groups_have_the_covariances_that_they_have_alone() {
    let mut bal = scattered(4, 40);
    hold_gauge(&mut bal, 3).expect("cameras have poses");
    solve(&mut bal.problem, &SolveConfig::default()).expect("solves");
    let [a, b, c] = [bal.cameras[2].id(), bal.points[7].id(), bal.cameras[1].id()];
    let groups = [vec![a, b], vec![c, a]];
    let mut told = Vec::new();
    let found = covariance_of_groups(&bal.problem, &groups, |done| {
        told.push(done);
        Ok::<(), Error>(())
    });
    let found = found.expect("determined");
    assert_eq!(told, [0, 1]);
    for (found, group) in found.iter().zip(&groups) {
        assert_eq!(*found, covariance(&bal.problem, group).expect("determined"));
    }
    let stopped = Error::UnknownBlock {
        block: 7,
        blocks: 7,
    };
    let refused = covariance_of_groups(&bal.problem, &groups, |_| Err(stopped.clone()));
    assert_eq!(refused, Err(stopped));
}

/// What `benches/solver/ceres_bal FILE sparse analytic covariance` prints after its headings: translation, focal length, k1,
/// k2 of camera 5 and point 100, none of which depends on how rotations are parametrized. Once at the values of the
/// problem's file, once at those that `solve bal-optimum` writes.
const CERES_AT_START: &str = include_str!("ceres_covariance_at_start.txt");
const CERES_AT_OPTIMUM: &str = include_str!("ceres_covariance_at_optimum.txt");

#[test]
fn covariances_are_those_of_ceres() {
    let Some(mut bal) = ladybug("covariances_are_those_of_ceres") else {
        return;
    };
    hold_gauge(&mut bal, 5).expect("cameras have poses");
    let at_start = farthest_from(CERES_AT_START, &bal);
    solve_to_the_last_bit(&mut bal).expect("solves");
    let at_optimum = farthest_from(CERES_AT_OPTIMUM, &bal);
    println!("{at_start:.1e} at the start, {at_optimum:.1e} at the optimum");
    // Ceres goes by QR, we by normal equations, which square the condition: far from the optimum there is less of it.
    assert!(at_start < 2e-5, "{at_start:.1e}");
    assert!(at_optimum < 2e-7, "{at_optimum:.1e}");
}

/// Largest difference of a covariance from the one expected, in standard deviations of the two parameters.
fn farthest_from(expected: &str, bal: &BalProblem) -> f64 {
    let (camera, point) = (bal.cameras[5].id(), bal.points[100].id());
    let found = covariance(&bal.problem, &[camera, point]).expect("determined");
    let mut expected = expected
        .split_whitespace()
        .map(|word| word.parse::<f64>().expect("a number"));
    let of_camera = found.between(camera, camera).expect("was asked for");
    let of_camera = of_camera.view((3, 3), (6, 6)).into_owned();
    let of_point = found.between(point, point).expect("was asked for");
    let mut farthest = 0.0f64;
    for block in [of_camera, of_point] {
        for r in 0..block.nrows() {
            for c in 0..block.ncols() {
                let theirs = expected.next().expect("45 numbers");
                let deviations = (block[(r, r)] * block[(c, c)]).sqrt();
                farthest = farthest.max((block[(r, c)] - theirs).abs() / deviations);
            }
        }
    }
    assert_eq!(expected.next(), None);
    farthest
}

const LINKS: usize = 2000;
const LINK_M: f64 = 2e-6;
const HELD_M: f64 = 0.05;

/// A chain of thousands of stiff links behind a soft one; its first block is held, or nothing is.
fn chain(is_held: bool) -> (Problem, Vec<BlockId>) {
    let mut problem = Problem::new();
    let chain: Vec<_> = (0..=LINKS + 1)
        .map(|_| problem.add_block(Se3::identity()))
        .collect();
    if is_held {
        problem.set_constant(chain[0]);
    }
    for (k, pair) in chain.windows(2).enumerate() {
        let sigma_m = if k == 0 { HELD_M } else { LINK_M };
        let mut sqrt_information = Matrix6::identity();
        for row in 3..6 {
            sqrt_information[(row, row)] = 1.0 / sigma_m;
        }
        let link = Between {
            b_from_a_measured: Se3::identity(),
            sqrt_information,
        };
        let pair = [pair[0].id(), pair[1].id()];
        let added = problem.add_residual(link, &pair, Kernel::Squared);
        added.expect("fits");
    }
    (problem, chain.iter().map(|block| block.id()).collect())
}

/// A chain that hangs on thousands of stiff links, and is held softly at one end, is determined, however small the eigenvalue: so walks hang on
/// their IMU.
#[test]
fn the_end_of_a_long_chain_has_its_covariance() {
    let (problem, chain) = chain(true);
    let found = covariance(&problem, &[chain[LINKS + 1]]).expect("determined");
    let variance = HELD_M.powi(2) + LINKS as f64 * LINK_M.powi(2);
    for row in 3..6 {
        let ratio = found.joint()[(row, row)] / variance;
        assert!((0.99..1.01).contains(&ratio), "{ratio}");
    }
}

/// The same chain held nowhere: what is free is told from what is held softly.
#[test]
fn a_long_chain_that_nothing_holds_has_no_covariance() {
    let (problem, chain) = chain(false);
    let error = covariance(&problem, &[chain[LINKS + 1]]).expect_err("free");
    assert!(
        matches!(error, Error::Undetermined { parameters: 6, .. }),
        "{error}"
    );
}

#[test]
fn free_gauge_has_no_covariance_and_the_error_says_which_parameter() {
    let bal = scattered(4, 40);
    let error = covariance(&bal.problem, &[bal.points[0].id()]).expect_err("gauge is free");
    assert!(
        matches!(error, Error::Undetermined { parameters: 7, .. }),
        "{error}"
    );
    assert!(error.to_string().contains("camera "), "{error}");

    let mut bal = parse(
        "1 1 1  0 0 -300.0 120.0  0.1 -0.2 0.3  0.5 -0.4 -5.0  500.0 -0.1 0.02  1.0 2.0 -3.0",
        Kernel::Squared,
    )
    .expect("a problem");
    bal.problem.set_constant(bal.cameras[0]);
    let error = covariance(&bal.problem, &[bal.cameras[0].id()]).expect_err("constant");
    assert!(matches!(error, Error::NoCovariance { .. }), "{error}");
    // A point seen once has no depth.
    let error = covariance(&bal.problem, &[bal.points[0].id()]).expect_err("no depth");
    assert!(matches!(error, Error::Undetermined { .. }), "{error}");
}
