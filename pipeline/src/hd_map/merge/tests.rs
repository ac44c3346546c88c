use lsfb_geometry::{Camera, CameraTiming, Matrix6, Rig, RigCamera};
use lsfb_types::{Timestamp, Verdict, no_progress};

use super::*;
use crate::descriptor_index::IndexConfig;
use crate::features::Feature;
use crate::hd_map::build::PointRow;
use crate::hd_map::{Region, SiteFrame};

/// A camera that looks along x.
fn camera(focal_px: f64) -> RigCamera {
    let forward = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let rotation = lsfb_geometry::UnitQuaternion::from_matrix(&forward);
    RigCamera {
        camera: Camera::pinhole(640, 480, [focal_px; 2], [319.5, 239.5]),
        rig_from_camera: Se3::new(rotation, Vector3::zeros()),
        timing: CameraTiming::default(),
        sigmas: Default::default(),
    }
}

/// Points of a hall with the looks that `look` gives each, seen from keyframes `along` it; in a frame moved by `world`.
struct Hall {
    world: Se3,
    along: std::ops::Range<i32>,
    focal_px: f64,
}

impl Hall {
    fn map(&self, look: impl Fn(u64) -> u64) -> HdMap {
        let mut rig = Rig::empty("walker");
        rig.cameras.insert("cam0".to_owned(), camera(self.focal_px));
        let keyframes: Vec<StampedPose> = self
            .along
            .clone()
            .map(|x| StampedPose {
                time: Timestamp::from_nanos(i64::from(x)),
                world_from_rig: Se3::new(Se3::identity().rotation, Vector3::x() * f64::from(x)),
            })
            .collect();
        let mut points = Vec::new();
        for number in 0..1_200_u64 {
            let mut random = ChaCha8Rng::seed_from_u64(number);
            let position = Vector3::new(
                random.random_range(0.0..24.0),
                random.random_range(-3.0..3.0),
                random.random_range(-1.0..2.0),
            );
            let observations: Vec<_> = (0..)
                .zip(&keyframes)
                .filter_map(|(keyframe, k)| {
                    let mounted = &rig.cameras["cam0"];
                    let in_camera =
                        (k.world_from_rig * mounted.rig_from_camera).inverse() * position;
                    let pixel = mounted.camera.project(&in_camera)?;
                    let is_near = in_camera.z < 8.0 && mounted.camera.contains(&pixel, 0.0);
                    is_near.then(|| crate::hd_map::MapObservation {
                        point: 0,
                        keyframe,
                        camera: 0,
                        pixel: [pixel.x as f32, pixel.y as f32 + 0.3],
                    })
                })
                .collect();
            if observations.len() < 2 {
                continue;
            }
            let mut noise = ChaCha8Rng::seed_from_u64(number + 7_000 * self.along.end as u64);
            let mut looks = ChaCha8Rng::seed_from_u64(look(number));
            points.push(PointRow {
                position: self.world
                    * (position + Vector3::repeat(noise.random_range(-0.01..0.01))),
                observations,
                descriptors: vec![std::array::from_fn(|_| {
                    looks.random_range(0..120_u8) + noise.random_range(0..9_u8)
                })],
            });
        }
        let rows = MapRows {
            rig,
            stated: BTreeMap::new(),
            feature: Feature::Sift,
            keyframes: keyframes
                .into_iter()
                .map(|k| StampedPose {
                    world_from_rig: self.world * k.world_from_rig,
                    ..k
                })
                .collect(),
            covariances: vec![Some(Matrix6::identity()); self.along.len()],
            points,
            provenance: format!("{:?}", self.along),
            failures: Vec::new(),
            site: None,
        };
        HdMap::from_rows(rows, &IndexConfig::default(), &no_progress).expect("built")
    }
}

fn moved() -> Se3 {
    Se3::exp(&[0.1, -0.2, 2.0, 30.0, -4.0, 1.0].into())
}

#[test]
fn two_scans_of_one_hall_become_one_map() {
    let first = Hall {
        world: Se3::identity(),
        along: 0..14,
        focal_px: 400.0,
    };
    let second = Hall {
        world: moved(),
        along: 8..20,
        focal_px: 410.0,
    };
    let bent = "cam0: turned by 3°".to_owned();
    let b = second.map(|n| n).with_failures(vec![bent.clone()]);
    let (a, failures) = (first.map(|n| n), [bent]);
    let (merged, report) = a
        .merge(&b, &MergeConfig::default(), &no_progress)
        .expect("merged");
    let error = report.first_from_second * moved();
    assert!(
        error.translation.norm() < 0.01 && error.rotation.angle() < 1e-3,
        "{error:?}"
    );
    assert!(
        report.shared > 200 && report.worst_sigma_m < 0.01,
        "{report:?}"
    );
    assert_eq!(
        merged.point_count(),
        a.point_count() + b.point_count() - report.shared
    );
    assert_eq!(
        merged.keyframe_count(),
        a.keyframe_count() + b.keyframe_count()
    );
    // Those of the second are moved by an alignment with errors of its own.
    let known = |k: usize| merged.keyframe_covariance(k as u32).is_some();
    let of_first = a.keyframe_count();
    assert!((0..of_first).all(known) && !(of_first..merged.keyframe_count()).any(known));
    assert_eq!(
        merged.observation_count(),
        a.observation_count() + b.observation_count()
    );
    assert_eq!(merged.cameras(), ["cam0", "cam0-2"]);
    // Every point is still where its pixels see it, through either camera.
    let errors = (0..merged.point_count() as u32).filter_map(|p| merged.quality(p));
    let worst = errors.fold(0.0, |worst: f64, q| worst.max(q.reprojection_rms_px));
    assert!(worst < 12.0, "{worst} px");
    let folder = tempfile::tempdir().expect("scratch folder");
    merged.write(folder.path()).expect("written");
    let opened = HdMap::open(folder.path()).expect("sound");
    assert_eq!(opened.failures(), failures, "of one of them");
    let (all, index) = (opened.region().expect("points"), IndexConfig::default());
    let part = opened.crop(&all, &index, &no_progress).expect("points");
    assert_eq!(part.failures(), failures);
    let judged = part.checks();
    let codes: Vec<&str> = judged.findings().iter().map(|f| &*f.code).collect();
    assert_eq!(codes, vec!["failed-map"; failures.len()]);
    assert_eq!(judged.verdict(), Verdict::Fail);
    assert_eq!(a.checks().verdict(), Verdict::Pass);
}

/// Naively a map and a crop of it became one in which each observation stood twice, and σ was too small by √2.
#[test]
fn maps_of_the_same_images_are_refused() {
    let map = Hall {
        world: Se3::identity(),
        along: 0..14,
        focal_px: 400.0,
    }
    .map(|n| n);
    let crop = |min_x: f64, max_x: f64| {
        let region = Region {
            min: Vector3::new(min_x, -5.0, -5.0),
            max: Vector3::new(max_x, 5.0, 5.0),
        };
        let index = IndexConfig::default();
        map.crop(&region, &index, &no_progress).expect("points")
    };
    for (first, second) in [
        (&map, &map),
        (&map, &crop(0.0, 10.0)),
        (&crop(0.0, 12.0), &crop(6.0, 20.0)),
    ] {
        let merged = first.merge(second, &MergeConfig::default(), &no_progress);
        let Err(Error::Refused(Refusal::SameImages { points, shared })) =
            merged.map(|(_, report)| report)
        else {
            panic!("merged");
        };
        assert!(shared >= 50 && points == shared, "{points} of {shared}");
    }
}

/// Naively the frame of the survey of one of the maps was lost without a word, or contradicted by the other.
#[test]
fn surveys_of_both_maps_are_compared() {
    let site = |origin_m: [f64; 3], point: &str| SiteFrame {
        origin_m,
        control_points: vec![point.to_owned()],
    };
    let hall = |world, along, focal_px| {
        let hall = Hall {
            world,
            along,
            focal_px,
        };
        hall.map(|n| n)
    };
    let a = hall(Se3::identity(), 0..14, 400.0);
    let shifted = Se3::new(Se3::identity().rotation, Vector3::new(30.0, -4.0, 1.0));
    let b = hall(shifted, 8..20, 410.0);
    let merged = |first: Option<SiteFrame>, second: Option<SiteFrame>| {
        let (a, b) = (a.clone().with_site(first), b.clone().with_site(second));
        a.merge(&b, &MergeConfig::default(), &no_progress)
            .map(|(map, _)| map.site().cloned())
    };
    let one = || Some(site([1e6, 2e6, 0.0], "A"));
    assert_eq!(merged(one(), None).expect("merged"), one());
    assert_eq!(merged(None, None).expect("merged"), None);
    let both = merged(one(), Some(site([1e6 - 30.0, 2e6 + 4.0, -1.0], "B"))).expect("merged");
    let both = both.expect("a frame");
    assert_eq!(both.origin_m, [1e6, 2e6, 0.0]);
    assert_eq!(both.control_points, ["A", "B"]);
    assert!(matches!(merged(None, one()), Err(Error::SurveyedSecond)));
    let Err(Error::Refused(Refusal::SurveysDisagree { shift_m, .. })) = merged(one(), one()) else {
        panic!("merged");
    };
    assert!((shift_m - Vector3::new(30.0_f64, 4.0, 1.0).norm()).abs() < 0.02);
}

#[test]
fn maps_that_do_not_surely_meet_are_refused() {
    let first = Hall {
        world: Se3::identity(),
        along: 0..14,
        focal_px: 400.0,
    };
    let second = Hall {
        world: moved(),
        along: 8..20,
        focal_px: 400.0,
    };
    let refusal = |a: &HdMap, b: &HdMap| {
        let merged = a.merge(b, &MergeConfig::default(), &no_progress);
        match merged.map(|(_, report)| report) {
            Err(Error::Refused(Refusal::MapsDoNotMeet { shared, .. })) => shared,
            other => panic!("{other:?}"),
        }
    };
    let elsewhere = refusal(&first.map(|n| n), &second.map(|n| n + 50_000));
    assert!(elsewhere < 10, "{elsewhere} points shared");
    // No overlap.
    let behind = Hall {
        world: moved(),
        along: 15..23,
        focal_px: 400.0,
    };
    refusal(
        &Hall {
            along: 0..4,
            ..first
        }
        .map(|n| n),
        &behind.map(|n| n),
    );
}

/// A hall whose second half looks like its first, against a scan of one of the halves.
#[test]
fn a_place_that_repeats_is_refused() {
    let first = Hall {
        world: Se3::identity(),
        along: 0..14,
        focal_px: 400.0,
    };
    let a = first.map(|n| n);
    let mut twice = a.rows();
    // Every other point stands here, the others there: the scan fits half of each.
    let points = std::mem::take(&mut twice.points).into_iter().enumerate();
    twice.points = points
        .map(|(number, mut p)| {
            p.position.x += if number % 2 == 0 { 0.0 } else { 40.0 };
            p
        })
        .collect();
    let index = IndexConfig::default();
    let twice = HdMap::from_rows(twice, &index, &no_progress).expect("built");
    let found = twice.merge(&a, &MergeConfig::default(), &no_progress);
    let Err(Error::Refused(Refusal::MapsDoNotMeet { shared, rival, .. })) =
        found.map(|(_, report)| report)
    else {
        panic!("merged");
    };
    assert!(
        rival * 2 > shared && shared > 100,
        "{shared} here, {rival} there"
    );
}

/// One per cent in scale lies within the gate everywhere, and in no scatter.
#[test]
fn a_map_of_another_scale_is_refused() {
    let hall = |along| Hall {
        world: Se3::identity(),
        along,
        focal_px: 400.0,
    };
    let (first, second) = (hall(0..14).map(|n| n), hall(8..20).map(|n| n));
    let mut rows = second.rows();
    for point in &mut rows.points {
        point.position *= 1.01;
    }
    for keyframe in &mut rows.keyframes {
        keyframe.world_from_rig.translation *= 1.01;
    }
    let larger = HdMap::from_rows(rows, &IndexConfig::default(), &no_progress).expect("built");
    let merged = first.merge(&larger, &MergeConfig::default(), &no_progress);
    let Err(Error::Refused(Refusal::MapsDoNotMeet {
        shared,
        scale_shift_m,
        ..
    })) = merged.map(|(_, report)| report)
    else {
        panic!("merged");
    };
    assert!(
        shared > 200 && scale_shift_m > 0.03,
        "{shared}, {scale_shift_m} m"
    );
}

#[test]
fn a_part_of_a_map_holds_what_saw_it() {
    let map = Hall {
        world: Se3::identity(),
        along: 0..20,
        focal_px: 400.0,
    }
    .map(|n| n);
    let region = Region {
        min: Vector3::new(0.0, -5.0, -5.0),
        max: Vector3::new(6.0, 5.0, 5.0),
    };
    let part = map
        .crop(&region, &IndexConfig::default(), &no_progress)
        .expect("points");
    assert!(part.point_count() > 50 && part.point_count() < map.point_count() / 2);
    assert!(part.positions().all(|p| region.contains(&p)));
    assert!(
        part.keyframe_count() < 8,
        "{} keyframes",
        part.keyframe_count()
    );
    let seen = (0..part.point_count() as u32).filter_map(|p| part.quality(p));
    assert!(seen.map(|q| q.reprojection_rms_px).fold(0.0, f64::max) < 12.0);
    let nowhere = Region {
        min: Vector3::repeat(90.0),
        max: Vector3::repeat(91.0),
    };
    let error = map
        .crop(&nowhere, &IndexConfig::default(), &no_progress)
        .expect_err("empty");
    assert!(error.to_string().contains("lsfb map info"));
}

/// Each quadrant has about a quarter of the points, and what is withheld in one map is what is left in the other.
#[test]
fn quadrants_of_a_map_are_withheld() {
    let map = Hall {
        world: Se3::identity(),
        along: 0..20,
        focal_px: 400.0,
    }
    .map(|n| n);
    let index = IndexConfig::default();
    let left = |withheld: &[usize]| map.without_quadrants(withheld, &index, &no_progress);
    let whole: Vec<_> = left(&[]).expect("all points").positions().collect();
    assert!(whole.into_iter().eq(map.positions()));
    let mut all = 0;
    for quadrant in 0..4 {
        let others: Vec<usize> = (0..4).filter(|k| *k != quadrant).collect();
        let alone = left(&others).expect("a quarter");
        let rest = left(&[quadrant]).expect("three quarters");
        assert_eq!(alone.point_count() + rest.point_count(), map.point_count());
        assert!(8 * alone.point_count() > map.point_count());
        let mut of_both = alone.positions();
        assert!(of_both.all(|p| rest.positions().all(|q| q != p)));
        all += alone.point_count();
    }
    assert_eq!(all, map.point_count());
    assert!(matches!(left(&[0, 1, 2, 3]), Err(Error::EmptyRegion)));
}
