use lsfb_geometry::{Se3, Vector3, Vector6};
use lsfb_types::Timestamp;
use nalgebra::DMatrix;

use super::snooping::{Snooped, Surveyed, scale_of_survey, snoop};
use super::*;
use crate::hd_map::Click;

const LIMIT: f64 = 5.0;
const SIGMA_M: f64 = 0.005;

/// Sums of twelve uniform numbers are normal enough.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut uniform = || {
            let Self(state) = self;
            *state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (*state >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::from([(); 3].map(|()| self.next()))
    }
}

/// Marks along a walk of 40 m, left and right of it, of which the map has places with 5 mm of noise and is too long by a factor; what it says of itself: 5 mm, and
/// a scale known to 0.02 %.
fn marks(count: usize, too_long: f64, seed: u64) -> (Vec<Surveyed>, DMatrix<f64>, Se3) {
    let site_from_world = Se3::exp(&Vector6::new(0.0, 0.0, 0.8, 120.0, -40.0, 7.0));
    let mut noise = Noise(seed);
    let truth = (0..count).map(|k| {
        let along = 40.0 * k as f64 / count as f64;
        Vector3::new(
            along,
            3.0 * f64::from(k as u32 % 3) - 2.0,
            f64::from(k as u32 % 2),
        )
    });
    let truth: Vec<Vector3<f64>> = truth.collect();
    let mut covariance = DMatrix::identity(3 * count, 3 * count) * SIGMA_M.powi(2);
    for (i, a) in truth.iter().enumerate() {
        for (j, b) in truth.iter().enumerate() {
            let mut of_both = covariance.fixed_view_mut::<3, 3>(3 * i, 3 * j);
            of_both += a * b.transpose() * 2e-4f64.powi(2);
        }
    }
    let mark = |place: &Vector3<f64>| Surveyed {
        in_world: place * too_long + noise.vector() * SIGMA_M,
        in_site: site_from_world * *place + noise.vector() * SIGMA_M,
        sigmas_m: Vector3::repeat(SIGMA_M),
    };
    (
        truth.iter().map(mark).collect(),
        covariance,
        site_from_world,
    )
}

fn snooped((marks, covariance, _): &(Vec<Surveyed>, DMatrix<f64>, Se3)) -> Snooped {
    snoop(marks, covariance, LIMIT).expect("marks in general position")
}

#[test]
fn marks_that_agree_all_hold() {
    for seed in 0..10 {
        let made = marks(8, 1.0, seed);
        let found = snooped(&made);
        assert_eq!(found.holding, (0..8).collect::<Vec<_>>(), "{found:?}");
        assert!(found.map_factor < 2.5, "{found:?}");
        let off = made.2.inverse() * found.site_from_world;
        assert!(off.translation.norm() < 0.05 && off.rotation.angle() < 0.01);
    }
}

/// What a blunder is off by is told, and in how many standard deviations, though the least squares of all would spread it over all marks.
#[test]
fn a_blunder_is_told_from_right_marks() {
    for seed in 0..10 {
        let mut made = marks(6, 1.0, seed);
        let blunder = Vector3::new(0.06, -0.08, 0.0);
        made.0[2].in_site -= blunder;
        let found = snooped(&made);
        assert_eq!(found.holding, [0, 1, 3, 4, 5], "{found:?}");
        let off = found.off[2].expect("told");
        assert!((off.metres - blunder).norm() < 0.04, "{off:?}");
        assert!(off.sigmas > LIMIT && off.sigmas < 30.0, "{off:?}");
    }
}

/// Two marks exchanged and one a metre off, of nine: each makes right ones look wrong.
#[test]
fn several_blunders_are_told() {
    for seed in 0..10 {
        let mut made = marks(9, 1.0, seed);
        let first = made.0[3].in_site;
        made.0[3].in_site = made.0[7].in_site;
        made.0[7].in_site = first;
        made.0[5].in_site.z += 1.0;
        let found = snooped(&made);
        assert_eq!(found.holding, [0, 1, 2, 4, 6, 8], "{found:?}");
        assert!(found.map_factor < 3.0, "{found:?}");
    }
}

/// A map that is 1 % too long where it says 0.02 %: marks that agree with that hold it all the same, and a blunder does not.
#[test]
fn a_map_that_is_worse_than_it_says_is_no_blunder_of_the_marks() {
    for seed in 0..10 {
        let mut made = marks(8, 1.01, seed);
        let found = snooped(&made);
        assert_eq!(found.holding.len(), 8, "{found:?}");
        assert!(found.map_factor > 3.0, "{found:?}");
        made.0[4].in_site.y += 2.0;
        let found = snooped(&made);
        assert_eq!(found.holding, [0, 1, 2, 3, 5, 6, 7], "{found:?}");
    }
}

/// A survey in feet, or with a tape that is 2 % too long; a single blunder is no other size.
#[test]
fn a_survey_of_another_size_is_named() {
    for (too_long, expected) in [(1.0 / 3.2808, 3.2808), (1.02, 1.0 / 1.02)] {
        let (marks, ..) = marks(6, too_long, 5);
        let scale = scale_of_survey(&marks).expect("another size");
        assert!((scale / expected - 1.0).abs() < 1e-3, "{scale}");
    }
    let (mut right, ..) = marks(6, 1.0, 5);
    assert_eq!(scale_of_survey(&right), None);
    right[1].in_site.x += 0.2;
    assert_eq!(scale_of_survey(&right), None);
}

/// Three marks say that something is wrong, and not what.
#[test]
fn of_three_marks_none_is_condemned() {
    let mut made = marks(3, 1.0, 1);
    made.0[1].in_site.x += 0.5;
    let found = snooped(&made);
    assert_eq!(found.holding.len(), 3);
    assert!(found.map_factor * found.sigma0 > 10.0, "{found:?}");
}

fn point(mark: &str, place_m: [f64; 3]) -> ControlPoint {
    ControlPoint {
        mark: mark.to_owned(),
        place_m: place_m.into(),
        sigmas_m: Vector3::repeat(0.002),
    }
}

fn clicked(marks: &[&str]) -> Vec<Click> {
    let click = |(k, mark): (usize, &&str)| Click {
        mark: (*mark).to_owned(),
        camera: "cam0".to_owned(),
        time: Timestamp::from_nanos(k as i64),
        pixel: Default::default(),
    };
    let twice = marks.iter().chain(marks);
    twice.enumerate().map(click).collect()
}

#[test]
fn too_few_marks_and_such_on_a_line_are_refused_and_said_why() {
    let places = [
        point("a", [0.0, 0.0, 0.0]),
        point("b", [10.0, 0.0, 1.0]),
        point("c", [20.0, 0.01, 2.0]),
        point("d", [5.0, 4.0, 1.0]),
    ];
    let refused = |points: &[ControlPoint], clicks: &[&str]| {
        let error = Control::new(points.to_vec(), &clicked(clicks)).expect_err("refused");
        error.to_string()
    };
    let reason = refused(&places, &["a", "b", "x"]);
    assert!(
        reason.contains("2 of 4") && reason.contains("rotate"),
        "{reason}"
    );
    let reason = refused(&places, &["a", "b", "c"]);
    assert!(reason.contains("one line"), "{reason}");
    let same = [0, 1, 2].map(|k| point(["a", "b", "c"][k], [1.0; 3]));
    assert!(refused(&same, &["a", "b", "c"]).contains("one line"));
    assert!(Control::new(places.to_vec(), &clicked(&["a", "b", "d", "x"])).is_ok());
}

/// Coordinates of a national grid: single precision would know 0.5 m of them.
#[test]
fn large_coordinates_are_shifted() {
    let far = [
        point("a", [500_120.0, 5_400_900.0, 430.0]),
        point("b", [500_130.0, 5_400_900.0, 431.0]),
        point("c", [500_120.0, 5_400_912.0, 430.0]),
    ];
    let control = Control::new(far.to_vec(), &clicked(&["a", "b", "c"])).expect("three");
    assert_eq!(control.origin_m, Vector3::new(500_000.0, 5_401_000.0, 0.0));
}
