use lsfb_geometry::camera::Lens;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use lsfb_geometry::Vector6;

use super::*;
use crate::camera::pose_of_target;
use crate::detect::Corner;

fn grid(spacing_ratio: f64) -> Target {
    Target::AprilGrid {
        columns: 6,
        rows: 6,
        tag_size_m: 0.088,
        spacing_ratio,
    }
}

const LENS: Lens = Lens::KannalaBrandt {
    focal_px: [300.0, 301.0],
    principal_px: [322.0, 238.0],
    distortion: [0.01, -0.01, 0.004, -0.001],
};

fn camera(lens: Lens) -> Camera {
    Camera {
        width: 640,
        height: 480,
        lens,
    }
}

/// Views of a board whose corners stand at `at` and are seen through `lens`; the others are what is believed.
fn views(at: impl Fn(usize) -> Vector3<f64>, lens: Lens, readout_s: f64) -> Vec<AdjustedView> {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let target = grid(0.3);
    (0..30)
        .map(|_| {
            let mut uniform = |size: f64| rng.random_range(-1.0..=1.0) * size;
            let turn = Vector6::new(uniform(0.6), uniform(0.6), uniform(1.0), 0.0, 0.0, 0.0);
            let place = Vector3::new(uniform(0.25), uniform(0.2), 0.6 + uniform(0.2));
            let facing = Se3::exp(&Vector6::new(std::f64::consts::PI, 0.0, 0.0, 0.0, 0.0, 0.0));
            let centre = Vector3::new(0.33, 0.33, 0.0);
            let camera_from_target = Se3::new(Default::default(), place)
                * Se3::exp(&turn)
                * facing
                * Se3::new(Default::default(), -centre);
            let velocity_px_s = Vector2::new(uniform(200.0), uniform(200.0));
            let corners = (0..target.corner_count()).filter_map(|k| {
                let pixel = camera(lens).project(&(camera_from_target * at(k)))?;
                let row = pixel.y / 480.0;
                let noise = Vector2::new(uniform(0.2), uniform(0.2));
                camera(lens).contains(&pixel, 2.0).then(|| AdjustedCorner {
                    point: target.corner(k),
                    pixel: pixel + velocity_px_s * (row * readout_s) + noise,
                    velocity_px_s,
                })
            });
            let corners: Vec<AdjustedCorner> = corners.collect();
            let seen: Vec<Corner> = corners
                .iter()
                .map(|c| Corner {
                    index: (0..144)
                        .find(|k| target.corner(*k) == c.point)
                        .expect("a corner"),
                    pixel: c.pixel,
                })
                .collect();
            // As an adjustment leaves it.
            let adjusted = pose_of_target(&target, &camera(LENS), &seen).expect("a pose");
            AdjustedView {
                camera_from_target: adjusted,
                corners,
            }
        })
        .collect()
}

fn said(views: Vec<AdjustedView>) -> String {
    let (target, camera) = (grid(0.3), camera(LENS));
    Diagnosis::new(&target, &camera, views)
        .finding("cam0", 1.0)
        .what
}

#[test]
fn the_cause_is_named_with_its_size() {
    let flat = |k: usize| grid(0.3).corner(k);
    let text = said(views(|k| grid(0.33).corner(k), LENS, 0.0));
    assert!(
        text.contains("gaps of 0.329") || text.contains("gaps of 0.330"),
        "{text}"
    );

    let text = said(views(
        |k| {
            let p = flat(k);
            Vector3::new(p.x, p.y * 1.01, 0.0)
        },
        LENS,
        0.0,
    ));
    assert!(
        text.contains("+1.0") && text.contains("longer along y"),
        "{text}"
    );

    let bent = |k: usize| {
        let p = flat(k);
        p + Vector3::new(0.0, 0.0, 0.06 * (p.x - 0.33) * (p.y - 0.33))
    };
    let text = said(views(bent, LENS, 0.0));
    assert!(text.contains("bent by 6."), "{text}");

    let text = said(views(flat, LENS, 0.02));
    assert!(
        text.contains("shutter with 20.") || text.contains("shutter with 19."),
        "{text}"
    );
    assert!(text.contains("in slow views"), "{text}");
}

#[test]
fn a_bent_board_makes_the_lens_less_certain() {
    let bent = |k: usize| {
        let p = grid(0.3).corner(k);
        p + Vector3::new(0.0, 0.0, 0.015 * (p.x - 0.33) * (p.y - 0.33))
    };
    let (target, camera) = (grid(0.3), camera(LENS));
    let diagnosis = Diagnosis::new(&target, &camera, views(bent, LENS, 0.0));
    let Deformation {
        board,
        lens_covariance,
    } = diagnosis.board(0.013);
    assert!(
        board.is_likely && (board.bend_m / 1.6e-3 - 1.0).abs() < 0.2,
        "{board:?}"
    );
    let focal = lens_covariance[(0, 0)].sqrt() / 300.0;
    assert!(
        focal > board.focal_change.abs() && focal > board.focal_sigma,
        "{focal}"
    );
}

#[test]
fn a_lens_that_was_given_is_compared_with_the_views() {
    let flat = |k: usize| grid(0.3).corner(k);
    let mut other = LENS;
    if let Lens::KannalaBrandt { principal_px, .. } = &mut other {
        principal_px[1] += 6.0;
    }
    let (target, camera) = (grid(0.3), camera(LENS));
    let said = Diagnosis::new(&target, &camera, views(flat, other, 0.0)).given_lens("cam0");
    let said = said.expect("another lens");
    assert!(
        said.what.contains("with cy = 24") && said.what.contains("instead of 238.0"),
        "{said:?}"
    );
}

#[test]
fn noise_alone_is_blamed_on_nothing() {
    let flat = |k: usize| grid(0.3).corner(k);
    let text = said(views(flat, LENS, 0.0));
    assert!(
        text.contains("equally large in all parts") && text.contains("likely causes are"),
        "{text}"
    );
    let (target, camera) = (grid(0.3), camera(LENS));
    let diagnosis = Diagnosis::new(&target, &camera, views(flat, LENS, 0.0));
    assert_eq!(diagnosis.finding("cam0", 0.43).verdict, Verdict::Pass);
    let Deformation {
        board,
        lens_covariance,
    } = diagnosis.board(0.01);
    assert!(!board.is_likely && lens_covariance.amax() == 0.0);
    assert!(diagnosis.given_lens("cam0").is_none());
    assert!(
        board.bend_m < 5.0 * board.bend_sigma_m && board.bend_m < 2e-4,
        "{board:?}"
    );
}
