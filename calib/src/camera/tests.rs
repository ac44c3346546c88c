use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Vector2, Vector3, Vector6};
use lsfb_types::{Finding, Verdict, no_progress};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::adjustment::{adjust_alone, adjust_robustly};
use super::solved::Start;
use super::*;

const GRID: Target = Target::AprilGrid {
    columns: 6,
    rows: 6,
    tag_size_m: 0.088,
    spacing_ratio: 0.3,
};

fn lenses() -> [Lens; 5] {
    let principal_px = [322.0, 238.0];
    let focal_px = [300.0, 301.0];
    [
        Lens::PinholeRadtan {
            focal_px: [500.0, 503.0],
            principal_px,
            distortion: [-0.25, 0.06, 1e-3, -5e-4, 0.0],
        },
        Lens::KannalaBrandt {
            focal_px,
            principal_px,
            distortion: [0.01, -0.01, 0.004, -0.001],
        },
        Lens::DoubleSphere {
            focal_px: [240.0, 241.0],
            principal_px,
            distortion: [-0.18, 0.58],
        },
        Lens::ExtendedUnified {
            focal_px,
            principal_px,
            distortion: [0.6, 1.1],
        },
        Lens::FieldOfView {
            focal_px: [320.0, 322.0],
            principal_px,
            distortion: [0.9],
        },
    ]
}

/// Views of the grid from random places, tilted by up to `tilt_rad`; two cameras 12 cm apart.
fn stereo(lens: Lens, views: i64, tilt_rad: f64, noise_px: f64, seed: u64) -> [CameraViews; 2] {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let camera = Camera {
        width: 640,
        height: 480,
        lens,
    };
    let baseline = Se3::exp(&Vector6::new(0.02, -0.01, 0.03, 0.12, 0.002, -0.004));
    let mut seen = [0, 1].map(|k| CameraViews {
        name: format!("cam{k}"),
        width: 640,
        height: 480,
        images: views as usize,
        views: BTreeMap::new(),
    });
    for instant in 0..views {
        let mut uniform = |size: f64| rng.random_range(-1.0..=1.0) * size;
        let turn = Vector3::new(uniform(tilt_rad), uniform(tilt_rad), uniform(1.0));
        let place = Vector3::new(uniform(0.25), uniform(0.2), 0.6 + uniform(0.2));
        let centre = Vector3::new(0.33, 0.33, 0.0);
        // The grid faces the camera: its z axis points back at it.
        let facing = Se3::exp(&Vector6::new(std::f64::consts::PI, 0.0, 0.0, 0.0, 0.0, 0.0));
        let tilted = Se3::exp(&Vector6::new(turn.x, turn.y, turn.z, 0.0, 0.0, 0.0));
        let about_centre = tilted * facing * Se3::new(Default::default(), -centre);
        let first_from_target = Se3::new(Default::default(), place) * about_centre;
        for (k, view) in seen.iter_mut().enumerate() {
            let pose = if k == 0 {
                first_from_target
            } else {
                baseline * first_from_target
            };
            let corners: Vec<Corner> = (0..GRID.corner_count())
                .filter_map(|index| {
                    let pixel = camera.project(&(pose * GRID.corner(index)))?;
                    let off = Vector2::new(uniform(noise_px), uniform(noise_px)) * 3f64.sqrt();
                    camera.contains(&pixel, 2.0).then(|| Corner {
                        index,
                        pixel: pixel + off,
                    })
                })
                .collect();
            view.views.insert(instant, corners);
        }
    }
    seen
}

fn config(model: LensModel) -> CameraConfig {
    CameraConfig {
        model,
        ..CameraConfig::default()
    }
}

#[test]
fn every_model_is_found_again() {
    for lens in lenses() {
        let views = stereo(lens, 30, 0.6, 0.1, 5);
        let found = calibrate_cameras(&GRID, &views, &config(lens.model()), &no_progress)
            .expect("calibrated");
        let truth = lens.parameters();
        for camera in &found.cameras {
            assert!(
                (camera.inlier_rms_px - 0.1 * 2f64.sqrt()).abs() < 0.01,
                "{camera:?}"
            );
            // What counts is where the camera looks: parameters of the unified models trade against each other.
            let real = Camera {
                lens,
                ..camera.camera
            };
            for pixel in [[60.0, 60.0], [320.0, 240.0], [580.0, 420.0], [100.0, 400.0]] {
                let pixel = Vector2::from(pixel);
                let (a, b) = (real.unproject(&pixel), camera.camera.unproject(&pixel));
                let (a, b) = (a.expect("in the lens"), b.expect("in the lens"));
                let off_px = a.angle(&b) * real.focal_px()[0];
                assert!(off_px < 0.3, "{:?} {pixel} {off_px}", lens.model());
            }
            // These models have no such trade: their parameters lie within their own sigmas.
            if matches!(
                lens.model(),
                LensModel::PinholeRadtan | LensModel::KannalaBrandt
            ) {
                for (p, truth) in camera.parameters.iter().zip(truth.values) {
                    assert!((p.value - truth).abs() < 4.5 * p.sigma, "{p:?} {truth}");
                }
            }
        }
        let second = &found.cameras[1];
        let baseline = Vector6::new(0.02, -0.01, 0.03, 0.12, 0.002, -0.004);
        let off = (Se3::exp(&baseline).inverse() * second.camera_from_first).log();
        for k in 0..6 {
            assert!(off[k].abs() < 4.5 * second.pose_sigma[k], "{off}");
        }
    }
}

/// From a first lens that is far off a double sphere finds nothing, and the other models are no better judges of it: they only
/// say where to start.
#[test]
fn a_double_sphere_that_cannot_start_is_started_from_another_model() {
    let lens = lenses()[2];
    let [views, _] = stereo(lens, 20, 0.6, 0.1, 5);
    let config = config(lens.model());
    let start = Start {
        chosen: views.views.keys().copied().collect(),
        views: &views,
        camera: Camera {
            width: 640,
            height: 480,
            lens: Lens::DoubleSphere {
                focal_px: [2400.0, 2400.0],
                principal_px: [320.0, 240.0],
                distortion: [0.9, 0.1],
            },
        },
        camera_from_first: Se3::identity(),
        alone_rms_px: None,
    };
    let alone = adjust_robustly(&GRID, vec![start.clone()], &config);
    assert!(matches!(alone, Err(Error::DoesNotFit { .. })));
    let found = adjust_alone(&GRID, start, &config).expect("started from another model");
    let found = found.cameras[0].camera;
    assert_eq!(found.lens.model(), LensModel::DoubleSphere);
    let real = Camera { lens, ..found };
    for pixel in [[60.0, 60.0], [320.0, 240.0], [580.0, 420.0]].map(Vector2::from) {
        let rays = [real, found].map(|c| c.unproject(&pixel).expect("in the lens"));
        let off_px = rays[0].angle(&rays[1]) * real.focal_px()[0];
        assert!(off_px < 0.3, "{pixel} {off_px}");
    }
}

/// A lens that draws lines outwards where the model asked for only draws them inwards: naively the board was blamed.
#[test]
fn a_model_that_cannot_fit_is_refused_with_the_one_that_does() {
    let lens = Lens::PinholeRadtan {
        focal_px: [400.0, 401.0],
        principal_px: [322.0, 238.0],
        distortion: [0.5, 0.3, 0.0, 0.0, 0.0],
    };
    let [views, _] = stereo(lens, 20, 0.6, 0.1, 5);
    let run = |model: LensModel| {
        let views = std::slice::from_ref(&views);
        calibrate_cameras(&GRID, views, &config(model), &no_progress)
    };
    let error = run(LensModel::FieldOfView).expect_err("no such lens");
    let Error::AnotherModelFits {
        model,
        rms_px,
        other,
        other_rms_px,
        ..
    } = &error
    else {
        panic!("{error}");
    };
    assert_eq!(*model, "field-of-view");
    assert!(
        *rms_px > 10.0 * other_rms_px && *other_rms_px < 0.2,
        "{error}"
    );
    let other = LensModel::ALL.into_iter().find(|m| m.name() == *other);
    run(other.expect("a model")).expect("what is advised works");
}

#[test]
fn what_views_do_not_determine_is_named() {
    // Always facing the board: focal length and distance cannot be told apart.
    let [views, _] = stereo(lenses()[0], 20, 0.0, 0.1, 3);
    let error = calibrate_cameras(
        &GRID,
        &[views],
        &config(LensModel::PinholeRadtan),
        &no_progress,
    )
    .expect_err("not determined")
    .to_string();
    assert!(error.contains("cam0") && error.contains("fx"), "{error}");
}

#[test]
fn bad_input_is_named() {
    let [good, other] = stereo(lenses()[1], 20, 0.6, 0.1, 3);
    let run = |target: &Target, views: &[CameraViews]| {
        calibrate_cameras(target, views, &CameraConfig::default(), &no_progress)
            .expect_err("bad input")
            .to_string()
    };
    let mut unseen = good.clone();
    unseen.views.clear();
    let error = run(&GRID, &[unseen]);
    assert!(error.contains("found in 0 of 20 images"), "{error}");

    // A grid of other spacing.
    let wrong = Target::AprilGrid {
        columns: 6,
        rows: 6,
        tag_size_m: 0.088,
        spacing_ratio: 0.6,
    };
    let error = run(&wrong, std::slice::from_ref(&good));
    assert!(error.contains("geometry is wrong"), "{error}");

    // One camera that sees nothing.
    let mut blind = other.clone();
    blind.views.clear();
    let error = run(&GRID, &[good.clone(), blind]);
    assert!(
        error.contains("cam1: the target was found in 0 of 20"),
        "{error}"
    );

    // A board that looks alike from both ends, and one camera counts from the other one: tags last to first, corners of each
    // by half a turn.
    let mut turned = other.clone();
    for corner in turned.views.values_mut().flatten() {
        let (tag, of_tag) = (corner.index / 4, corner.index % 4);
        corner.index = 4 * (35 - tag) + (of_tag + 2) % 4;
    }
    let error = run(&GRID, &[good.clone(), turned]);
    assert!(
        error.contains("cam1") && error.contains("upside down"),
        "{error}"
    );

    // Cameras that never saw the board at one time.
    let mut later = other;
    later.views = later
        .views
        .into_iter()
        .map(|(t, v)| (t + 1000, v))
        .collect();
    let error = run(&GRID, &[good.clone(), later.clone()]);
    assert!(error.contains("at 0 instants"), "{error}");

    // Cameras whose stamps are off by one view.
    later.views = later.views.into_iter().map(|(t, v)| (t - 999, v)).collect();
    let error = run(&GRID, &[good, later]);
    assert!(error.contains("not triggered together"), "{error}");
}

#[test]
fn corners_that_miss_by_more_than_a_detector_does_are_explained() {
    let [good, other] = stereo(lenses()[1], 20, 0.6, 0.1, 3);
    let spaced = |spacing_ratio: f64| Target::AprilGrid {
        columns: 6,
        rows: 6,
        tag_size_m: 0.088,
        spacing_ratio,
    };
    for (ratio, outcome) in [
        (0.3, Verdict::Pass),
        (0.312, Verdict::Warn),
        (0.36, Verdict::Fail),
    ] {
        let both = [good.clone(), other.clone()];
        let config = CameraConfig::default();
        let found =
            calibrate_cameras(&spaced(ratio), &both, &config, &no_progress).expect("calibrated");
        let judgement = found.judgement();
        assert_eq!(judgement.verdict(), outcome, "{ratio}: {judgement:?}");
        for camera in &found.cameras {
            let named = |f: &Finding| {
                f.what.contains("explained by gaps of 0.29") || f.what.contains("of 0.30")
            };
            assert_eq!(
                camera.findings.iter().any(named),
                ratio != 0.3,
                "{:?}",
                camera.findings
            );
        }
        assert!(found.page("page").to_html().contains(outcome.name()));
    }
}

#[test]
fn the_order_of_corners_and_other_cameras_does_not_matter() {
    let [first, second] = stereo(lenses()[1], 15, 0.6, 0.1, 9);
    let [_, mut third] = stereo(lenses()[1], 15, 0.6, 0.1, 9);
    third.name = "cam2".into();
    for corner in third.views.values_mut().flatten() {
        corner.pixel.x += 2.0 + 0.01 * (corner.index % 7) as f64;
    }
    let run = |views: &[CameraViews]| {
        calibrate_cameras(&GRID, views, &CameraConfig::default(), &no_progress).expect("calibrated")
    };
    let straight = run(&[first.clone(), second.clone(), third.clone()]);
    for seed in 0..4 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut shuffled = [first.clone(), third.clone(), second.clone()];
        for corners in shuffled.iter_mut().flat_map(|v| v.views.values_mut()) {
            corners.shuffle(&mut rng);
        }
        let mut again = run(&shuffled);
        again.cameras.swap(1, 2);
        assert_eq!(again, straight);
    }
}

#[test]
fn left_and_right_that_are_swapped_are_warned_of() {
    // The second camera stands on the left: camera_from_first moves points to its right.
    let mut views = stereo(lenses()[1], 20, 0.6, 0.1, 3);
    let warned = |views: &[CameraViews]| {
        let found = calibrate_cameras(&GRID, views, &CameraConfig::default(), &no_progress);
        let findings = found.expect("calibrated").cameras[1].findings.clone();
        findings
            .iter()
            .any(|f| f.what.contains("their views or their names are swapped"))
    };
    views[0].name = "right".into();
    views[1].name = "left".into();
    assert!(!warned(&views));
    views[0].name = "left".into();
    views[1].name = "right".into();
    assert!(warned(&views));
}

#[test]
fn outliers_do_not_move_the_result() {
    let lens = lenses()[1];
    let [clean, _] = stereo(lens, 30, 0.6, 0.1, 8);
    let mut dirty = clean.clone();
    for (k, corner) in dirty.views.values_mut().flatten().enumerate() {
        if k % 20 == 0 {
            corner.pixel.x += 25.0;
        }
    }
    let found = calibrate_cameras(&GRID, &[dirty], &CameraConfig::default(), &no_progress)
        .expect("calibrated");
    let camera = &found.cameras[0];
    assert!((camera.parameters[0].value - 300.0).abs() < 4.5 * camera.parameters[0].sigma);
    assert!(camera.outliers * 21 > camera.corners && camera.outliers * 19 < camera.corners);
}

/// A board that is moved before a camera whose rows are exposed one after the other, ten images a second.
fn moved_before(lens: Lens, readout_s: f64, noise_px: f64) -> CameraViews {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let camera = Camera {
        width: 640,
        height: 480,
        lens,
    };
    let centre = Vector3::new(0.33, 0.33, 0.0);
    let facing = Se3::exp(&Vector6::new(std::f64::consts::PI, 0.0, 0.0, 0.0, 0.0, 0.0));
    let camera_from_target = |t: f64| {
        let wave = |size: f64, hz: f64| size * (std::f64::consts::TAU * hz * t).sin();
        let tilted = Se3::exp(&Vector6::new(
            wave(0.5, 0.31),
            wave(0.5, 0.23),
            wave(0.6, 0.11),
            0.0,
            0.0,
            0.0,
        ));
        let place = Vector3::new(wave(0.2, 0.19), wave(0.16, 0.27), 0.8 + wave(0.2, 0.13));
        Se3::new(Default::default(), place)
            * (tilted * facing * Se3::new(Default::default(), -centre))
    };
    let views = (0..150_i64).map(|k| {
        let t = 0.1 * k as f64;
        let corners = (0..GRID.corner_count()).filter_map(|index| {
            let mut pixel: Vector2<f64> = Vector2::new(319.5, 239.5);
            for _ in 0..12 {
                let late_s = readout_s * (pixel.y - 239.5) / 480.0;
                pixel = camera.project(&(camera_from_target(t + late_s) * GRID.corner(index)))?;
            }
            let noise = Vector2::from_fn(|_, _| {
                (0..12).map(|_| rng.random_range(-0.5..=0.5)).sum::<f64>() * noise_px
            });
            let inside = pixel.x > 4.0 && pixel.y > 4.0 && pixel.x < 635.0 && pixel.y < 475.0;
            inside.then_some(Corner {
                index,
                pixel: pixel + noise,
            })
        });
        (k * 100_000_000, corners.collect())
    });
    CameraViews {
        name: "cam0".into(),
        width: 640,
        height: 480,
        images: 150,
        views: views.collect(),
    }
}

/// Naively a lens like any other: a rolling shutter bent the focal length by percents, and was named as one of three likely causes.
#[test]
fn a_rolling_shutter_is_named_and_taken_out_where_it_is_known() {
    let readout_s = 0.024;
    let lens = lenses()[0];
    let found = |views: &CameraViews| {
        let config = CameraConfig {
            model: lens.model(),
            ..CameraConfig::default()
        };
        let views = std::slice::from_ref(views);
        let mut found = calibrate_cameras(&GRID, views, &config, &no_progress).expect("calibrated");
        found.cameras.remove(0)
    };
    let shutter = |c: &CalibratedCamera| {
        c.findings
            .iter()
            .find(|f| f.code == "rolling-shutter")
            .cloned()
    };
    let rolling = moved_before(lens, readout_s, 0.1);
    let naive = found(&rolling);
    let finding = shutter(&naive).expect("named");
    // Each view has another lens then; they are not another camera's.
    assert!(naive.findings.iter().all(|f| f.code != "one-lens"));
    let said_ms = finding.value.expect("a number");
    assert!((said_ms - 24.0).abs() < 8.0, "{finding:?}");
    let true_px = lens.parameters().values[0];
    let off = |c: &CalibratedCamera| c.parameters[0].value / true_px - 1.0;
    let known = found(&as_global_shutter(&rolling, readout_s));
    assert_eq!(shutter(&known), None);
    assert!(
        off(&known).abs() < 0.1 * off(&naive).abs().max(0.01),
        "{} {}",
        off(&known),
        off(&naive)
    );
    assert!((known.parameters[0].value - true_px).abs() < 3.0 * known.parameters[0].sigma);
    assert_eq!(shutter(&found(&moved_before(lens, 0.0, 0.1))), None);
}

/// One camera's views, each through a lens of its own.
fn through(lens: impl Fn(i64) -> Lens, views: i64, seed: u64) -> CameraViews {
    let [mut all, _] = stereo(lens(0), views, 0.6, 0.1, seed);
    for (instant, corners) in &mut all.views {
        let [own, _] = stereo(lens(*instant), views, 0.6, 0.1, seed);
        *corners = own.views[instant].clone();
    }
    all
}

/// A camera, and what is said of whether it has one lens.
fn of_one_lens(views: CameraViews, model: LensModel) -> (CalibratedCamera, Option<Finding>) {
    let config = CameraConfig {
        holdout_every: 0,
        ..config(model)
    };
    let found = calibrate_cameras(&GRID, &[views], &config, &no_progress).expect("calibrated");
    let camera = found.cameras[0].clone();
    let finding = camera.findings.iter().find(|f| f.code == "one-lens");
    (camera.clone(), finding.cloned())
}

/// Cameras of one kind, 0.3 % apart in focal length and 0.8 % of it in the principal point: one lens meets all corners to a tenth of a pixel, and is neither's.
#[test]
fn images_of_two_cameras_in_one_folder_are_named() {
    for lens in lenses() {
        let model = lens.model();
        let mut values = lens.parameters().values;
        let focal_px = values[0];
        for (value, by) in values.iter_mut().zip([0.003, 0.003, 0.008, -0.006]) {
            *value += by * focal_px;
        }
        let twin = model.lens(&values);
        let mixed = |of_twin: fn(i64) -> bool| {
            let views = through(|t| if of_twin(t) { twin } else { lens }, 40, 9);
            of_one_lens(views, model)
        };
        // Either half may be the one that is named.
        let named = |(_, finding): (_, Option<Finding>), named: [&str; 2]| {
            let finding = finding.unwrap_or_else(|| panic!("{} is not named", model.name()));
            let is_named = named.iter().any(|n| finding.what.contains(n));
            assert!(is_named && finding.verdict >= Verdict::Warn, "{finding:?}");
        };
        named(
            mixed(|t| t % 2 == 1),
            ["1, 3, 5 and so on", "0, 2, 4 and so on"],
        );
        named(mixed(|t| t >= 24), ["24 to 39"; 2]);
        // A tenth is named, or so few that what is said holds all the same.
        let (camera, finding) = mixed(|t| t % 10 == 4);
        match finding {
            Some(_) => named((camera, finding), ["4, 14, 24 and so on"; 2]),
            None => {
                for (p, truth) in camera.parameters.iter().zip(lens.parameters().values) {
                    assert!((p.value - truth).abs() < 4.0 * p.sigma, "{p:?} {truth}");
                }
            }
        }
    }
}

/// A zoom or focus that moves while the board is shown is the same fault.
#[test]
fn a_focal_length_that_drifts_is_named() {
    let drifting = |t: i64| {
        let grown = 1.0 + 0.01 * (t as f64 / 39.0 - 0.5);
        Lens::KannalaBrandt {
            focal_px: [300.0 * grown, 301.0 * grown],
            principal_px: [322.0, 238.0],
            distortion: [0.01, -0.01, 0.004, -0.001],
        }
    };
    let views = through(drifting, 40, 3);
    let (_, finding) = of_one_lens(views, LensModel::KannalaBrandt);
    let finding = finding.expect("named");
    assert!(finding.what.contains("have f"), "{finding:?}");
}

/// However few or many views there are, and whatever lens it is.
#[test]
fn one_lens_is_taken_for_one() {
    for (k, lens) in lenses().into_iter().enumerate() {
        for count in [8, 10, 13, 40] {
            let views = through(|_| lens, count, 100 * k as u64 + count as u64);
            let (_, finding) = of_one_lens(views, lens.model());
            assert_eq!(finding, None, "{} {count}", lens.model().name());
        }
    }
}

/// Left is right and right is left from some instant on: each alone is met well.
#[test]
fn cameras_exchanged_half_way_are_refused() {
    let [mut left, mut right] = stereo(lenses()[1], 30, 0.6, 0.1, 8);
    for instant in 18..30 {
        let own = left.views.remove(&instant).expect("a view");
        let other = right.views.insert(instant, own).expect("a view");
        left.views.insert(instant, other);
    }
    let config = config(LensModel::KannalaBrandt);
    let error = calibrate_cameras(&GRID, &[left, right], &config, &no_progress)
        .expect_err("exchanged")
        .to_string();
    assert!(
        error.contains("their images are swapped at 12 of 30 instants, from 18 to 29"),
        "{error}"
    );
}

/// Once the standard deviations shrank, and holdout views were met as well as those that they were copies of.
#[test]
fn copies_of_images_count_once() {
    let lens = lenses()[0];
    let [alone, _] = stereo(lens, 24, 0.5, 0.2, 5);
    let mut twice = alone.clone();
    let copies = alone.views.iter().map(|(k, v)| (k + 1000, v.clone()));
    twice.views.extend(copies);
    twice.images *= 2;
    let found = |views: CameraViews| {
        let config = config(lens.model());
        let found = calibrate_cameras(&GRID, &[views], &config, &no_progress).expect("found");
        found.cameras.into_iter().next().expect("one")
    };
    let (alone, twice) = (found(alone), found(twice));
    assert_eq!(twice.parameters, alone.parameters);
    assert_eq!(twice.holdout_rms_px, alone.holdout_rms_px);
    let copies = |c: &CalibratedCamera| c.findings.iter().find(|f| f.code == "copies").cloned();
    assert_eq!(copies(&alone), None);
    let copies = copies(&twice).expect("a finding");
    assert_eq!(copies.verdict, Verdict::Warn);
    assert!(copies.what.contains("24 of 48 images"), "{}", copies.what);
}
