//! Places of the twin have no texture that comes again a few metres on: what a map does not have is found nowhere in it by being moved along.

use std::path::Path;

use lsfb_pipeline::features::FeatureDetector;
use lsfb_pipeline::hd_map::{PosedMapConfig, build_map_from_posed_images};
use lsfb_pipeline::localization::{Localizer, LocalizerConfig, localize_posed_images};
use lsfb_pipeline::posed_images::{PosedImage, PosedImages};
use lsfb_sim::{Device, Look, Place, SimConfig, Simulation, preview::Picture};
use lsfb_types::no_progress;

/// Images along a walk: every other one is mapped, the others are looked for.
const IMAGES: u32 = 160;
/// A pose is right within this distance, metres; what repeats does so after more.
const RIGHT_M: f64 = 0.5;
/// What repeats along a wall is seen from the same direction, degrees.
const SAME_DIRECTION_DEG: f64 = 20.0;

/// Images along the whole walk of a phone, at their true poses.
fn walk_through(place: Place, folder: &Path) -> PosedImages {
    let mut config = SimConfig::for_place(place, Device::Iphone);
    (config.seed, config.look, config.texel_m) = (5, Look::Detailed, 0.006);
    config.scan.duration_s = 1.0;
    let cameras = &mut config.glasses_cameras;
    (cameras.width, cameras.height) = (480, 360);
    (cameras.motion_blur, cameras.readout_ns) = (false, 0);
    let simulation = Simulation::new(&config, &no_progress).expect("valid");
    let phone = simulation.glasses();
    let (name, _) = phone.rig().cameras.first_key_value().expect("a camera");
    let images = (0..IMAGES).map(|k| {
        let frame = phone.frame_count() * (2 * k + 1) / (2 * IMAGES);
        let image = phone.image(simulation.world(), 0, frame).expect("a camera");
        let path = folder.join(format!("{k}.png"));
        let picture = Picture {
            width: image.sample.width as usize,
            height: image.sample.height as usize,
            pixels: image.sample.pixels,
        };
        picture.write_png(&path).expect("written");
        let at_s = phone.frame_offset_ns(frame) as f64 * 1e-9;
        PosedImage {
            path,
            camera: name.clone(),
            world_from_rig: phone.walk().at(at_s).world_from_rig,
            instant: None,
        }
    });
    PosedImages {
        images: images.collect(),
        rig: phone.rig().clone(),
        notes: Vec::new(),
    }
}

/// Halves of a walk are mapped, and images of all of it looked for. Things that are the same in two places may be taken for one another
/// (`docs/known-faults.md`); what repeats along a wall would be seen from the same direction.
#[test]
fn what_a_map_does_not_have_is_not_found_by_moving_along() {
    for place in [Place::WideCorridor, Place::ExhibitionHall] {
        let folder = tempfile::tempdir().expect("folder");
        let walk = walk_through(place, folder.path());
        let (mapped, queries) = (walk.without_every(2), walk.every(2));
        let half = mapped.images.len() / 2;
        for images in mapped.images.chunks(half) {
            let mapped = PosedImages {
                images: images.to_vec(),
                ..mapped.clone()
            };
            let config = PosedMapConfig::default();
            let map = build_map_from_posed_images(&mapped, &config, &no_progress).expect("a map");
            let localizer = Localizer::new(&map, &LocalizerConfig::default()).expect("an index");
            let detector = FeatureDetector::new(&config.sift, None).expect("SIFT");
            let found = localize_posed_images(&localizer, &queries, &detector, &no_progress);
            let found = found.expect("localized");
            let given = found
                .iter()
                .filter_map(|f| Some((f.distance_m()?, f.angle_deg()?)));
            let given: Vec<(f64, f64)> = given.collect();
            assert!(given.len() > half / 2, "{}: {given:?}", place.name());
            let is_moved =
                |(off_m, off_deg): &(f64, f64)| *off_m > RIGHT_M && *off_deg < SAME_DIRECTION_DEG;
            assert!(!given.iter().any(is_moved), "{}: {given:?}", place.name());
        }
    }
}
