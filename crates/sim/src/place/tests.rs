use super::*;
use crate::Simulation;
use crate::config::Device;
use crate::simulation::RigSim;
use crate::walk::{PaperMotion, Walk};
use lsfb_types::no_progress;

fn coarse(place: Place) -> SimConfig {
    let mut config = SimConfig::for_place(place, Device::Android);
    config.texel_m = 0.08;
    for cameras in [&mut config.scan_cameras, &mut config.glasses_cameras] {
        (cameras.width, cameras.height) = (160, 104);
    }
    config
}

/// How near something comes to a walk at three heights, metres, and where.
fn nearest_m(world: &World, walk: &Walk) -> (f32, [f32; 3]) {
    let mut nearest = (f32::INFINITY, [0.0; 3]);
    for step in 0..(walk.duration_s() * 1.6) as u32 {
        let at = walk.at(f64::from(step) * 0.625).world_from_rig.translation;
        for height in [-0.75, -0.2, 0.3] {
            let origin = [at.x as f32, at.y as f32, at.z as f32 + height];
            for k in 0..10_u8 {
                let (sin, cos) = (f32::from(k) * 0.6283).sin_cos();
                if let Some(hit) = world.cast(origin, [cos, sin, 0.0])
                    && hit.distance < nearest.0
                {
                    nearest = (hit.distance, origin);
                }
            }
        }
    }
    nearest
}

#[test]
fn places_have_their_size_and_walks_keep_clear_of_everything() {
    let mut blocked = Vec::new();
    for place in Place::ENVIRONMENTS.into_iter().chain([Place::Calibration]) {
        let simulation = Simulation::new(&coarse(place), &no_progress).expect("valid");
        let world = simulation.world();
        let [w, d] = place.size_m();
        let floor = world.facets().iter().flat_map(|f| f.vertices());
        let mut low = [f32::INFINITY; 2];
        let mut high = [f32::NEG_INFINITY; 2];
        for v in floor.filter(|_| !place.is_outdoors()) {
            for i in 0..2 {
                low[i] = low[i].min(v[i]);
                high[i] = high[i].max(v[i]);
            }
        }
        if !place.is_outdoors() {
            let close = |got: f32, wanted: f64| (f64::from(got) - wanted).abs() < 0.35;
            assert!(
                close(low[0], 0.0) && close(low[1], 0.0),
                "{place:?}: {low:?}"
            );
            assert!(
                close(high[0], w) && close(high[1], d),
                "{place:?}: {high:?}"
            );
        }
        let walks = [simulation.scan(), simulation.glasses()].map(RigSim::walk);
        for (name, walk) in ["scan", "walk"].into_iter().zip(walks) {
            let nearest = nearest_m(world, walk);
            if nearest.0 < 0.2 {
                blocked.push(format!("{place:?} {name}: {nearest:?}"));
            }
        }
    }
    assert!(blocked.is_empty(), "{blocked:#?}");
}

/// Distances of a walk from the scanner's, metres, sorted.
fn off_path_m(scan: &Walk, walk: &Walk) -> Vec<f64> {
    let points = |walk: &Walk| -> Vec<[f64; 3]> {
        let at = |k: u32| {
            walk.at(f64::from(k) * 0.25)
                .world_from_rig
                .translation
                .into()
        };
        (0..(walk.duration_s() * 4.0) as u32).map(at).collect()
    };
    let scanned = points(scan);
    let nearest = |p: [f64; 3]| {
        let same_storey = scanned.iter().filter(|q| (p[2] - q[2]).abs() < 1.5);
        same_storey
            .map(|q| (p[0] - q[0]).hypot(p[1] - q[1]))
            .fold(f64::INFINITY, f64::min)
    };
    let mut all: Vec<f64> = points(walk).into_iter().map(nearest).collect();
    all.sort_by(f64::total_cmp);
    all
}

#[test]
fn walks_off_the_scanners_path_keep_clear_of_everything() {
    let mut wrong = Vec::new();
    for place in Place::ENVIRONMENTS {
        let world = Place::build(&coarse(place), &no_progress).expect("built");
        // Two metres have no room for two ways, nor have the doors and rooms of the houses.
        let wanted_m = match place {
            Place::NarrowCorridor => 0.1,
            Place::HousePark => 0.2,
            Place::Stairs | Place::WideCorridor => 0.4,
            _ => 0.7,
        };
        for (seed, scan_s) in [(1, 0.0), (2, 45.0), (3, 45.0)] {
            let mut config = SimConfig {
                seed,
                off_path_m: 6.0,
                ..coarse(place)
            };
            config.scan.duration_s = scan_s;
            let [scan, walk] = crate::simulation::walks(&config, &world).expect("walks");
            let off_m = off_path_m(&scan, &walk);
            let median = off_m[off_m.len() / 2];
            let nearest = nearest_m(&world, &walk);
            if nearest.0 < 0.2 || median < wanted_m || off_m[off_m.len() - 1] > 9.0 {
                wrong.push(format!(
                    "{place:?} {seed}: {nearest:?}, {median} m off, at most {:?}",
                    off_m.last()
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn motions_have_the_frames_and_lengths_of_table_vii() {
    assert_eq!(PaperMotion::all().len(), 25);
    let nowhere = World::of(&Default::default(), 0, 0.1, &no_progress).expect("built");
    for motion in PaperMotion::all() {
        for device in Device::ALL {
            // The longest walks of the three are alike: one is enough.
            if motion.name.starts_with('L') && device != Device::Glasses {
                continue;
            }
            let config = SimConfig::for_motion(motion, device);
            let walk = crate::simulation::walks(&config, &nowhere).expect("valid")[1].clone();
            let frames = walk.duration_s() * 30.0;
            let wanted = f64::from(motion.frames[device as usize]);
            assert!(
                (frames / wanted - 1.0).abs() < 0.05,
                "{} {device:?}",
                motion.name
            );
            let (got, wanted) = (walk.length_m(), motion.length_m(device));
            assert!(
                (got / wanted - 1.0).abs() < 0.05,
                "{} {device:?}: {got} m",
                motion.name
            );
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_place() {
    let on = |threads, months_later| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("pool").install(|| {
            let mut config = coarse(Place::ExhibitionHall);
            config.months_later = months_later;
            let simulation = Simulation::new(&config, &no_progress).expect("valid");
            let image = simulation.glasses().image(simulation.world(), 0, 300);
            (image, simulation.scan().scan(simulation.world(), 50))
        })
    };
    let once = on(1, 0);
    assert!(once == on(3, 0));
    assert!(once != on(2, 2));
}

#[test]
fn a_scene_of_others_can_be_walked_through() {
    let test = "a_scene_of_others_can_be_walked_through";
    let Some(scene) = lsfb_tests::recordings(test, "lidar/scenes/vr-gallery.glb") else {
        return;
    };
    let config = SimConfig {
        scene,
        ..coarse(Place::Imported)
    };
    let simulation = Simulation::new(&config, &no_progress).expect("a scene");
    let world = simulation.world();
    assert!(world.facets().len() > 1900);
    let [low, high] = world.extent_m();
    // The file's own bounds, y and z exchanged: about ten metres square and five high.
    assert!((0..2).all(|i| (high[i] - low[i] - 10.12).abs() < 0.1));
    assert!((high[2] - low[2] - 5.05).abs() < 0.1);
    for frame in [10, 200] {
        let image = simulation
            .glasses()
            .image(world, 0, frame)
            .expect("camera")
            .sample;
        let mean =
            image.pixels.iter().map(|p| u64::from(*p)).sum::<u64>() / image.pixels.len() as u64;
        let black = image.pixels.iter().filter(|p| **p < 4).count();
        assert!(
            (60..200).contains(&mean) && black * 20 < image.pixels.len(),
            "{mean} {black}"
        );
    }
    let scan = simulation.scan().scan(world, 30).expect("returns");
    assert!(scan.sample.points.len() > 40_000);
}
