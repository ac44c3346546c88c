//! A map of wanted size, to see how fast images are localized in it and how many still are: a map, and beside it copies of another whose
//! descriptors are others.
//!
//! `cargo run --release -p lsfb-pipeline --example large_map -- MAP OTHER DESCRIPTORS OUT [OBSERVATIONS]`
//!
//! `MAP` and `OTHER` were made by `lsfb map`, with the same feature. The points of `OTHER` are put beside `MAP`, again and again, until
//! there are so many descriptors. In each copy the cells of the descriptors of SIFT (4 × 4, of 8 directions each) change places, in another
//! order each time: they stay as descriptors are, and look like nothing that is in `MAP`. Then, say,
//! `lsfb localize --posed-images sevenscenes_redkitchen --every 2 --map OUT`. How long it takes to open the map is printed.
//!
//! With `OBSERVATIONS` no point has more of them, and one descriptor: there are then as many points as descriptors, and ten million need 10 GB of
//! memory instead of 30.

#![allow(clippy::print_stdout)] // a program, not a library

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use lsfb_geometry::{Rig, Se3, StampedPose, UnitQuaternion, Vector3};
use lsfb_pipeline::features::{DESCRIPTOR_LEN, Descriptor, Features, Keypoint};
use lsfb_pipeline::hd_map::{
    HdMap, HdMapConfig, KeyframeImage, MapContent, MapPoint, PointObservation,
};
use lsfb_types::{Timestamp, no_progress};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Directions in a cell.
const CELL: usize = 8;
/// Copies stand so far apart, in the unit of the maps.
const APART: f64 = 100.0;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (arguments, most) = match arguments.as_slice() {
        [first @ .., most] if first.len() == 4 => (first, Some(most.parse::<usize>()?)),
        all => (all, None),
    };
    let [map, other, wanted, out] = arguments else {
        return Err("give a map, another, a number of descriptors and a folder".into());
    };
    let (map, other) = (HdMap::open(Path::new(map))?, HdMap::open(Path::new(other))?);
    if map.feature() != other.feature() {
        return Err("the maps have different features".into());
    }
    let wanted: usize = wanted.parse()?;
    let mut large = Content {
        rig: map.rig().clone(),
        keyframes: Vec::new(),
        images: Vec::new(),
        points: Vec::new(),
        most_observations: most.unwrap_or(usize::MAX),
    };
    let cells: Vec<usize> = (0..DESCRIPTOR_LEN / CELL).collect();
    large.add(&map, "", &Vector3::zeros(), &cells)?;
    let descriptors_of = |map: &HdMap| match most {
        Some(_) => map.point_count(),
        None => map.descriptor_count(),
    };
    let each = descriptors_of(&other).max(1);
    for copy in 0..wanted.saturating_sub(descriptors_of(&map)).div_ceil(each) {
        let mut order = cells.clone();
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(copy as u64));
        let aside = Vector3::x() * APART * (copy + 1) as f64;
        large.add(&other, "other ", &aside, &order)?;
    }
    let content = MapContent {
        rig: &large.rig,
        keyframes: &large.keyframes,
        images: &large.images,
        points: &large.points,
        feature: map.feature(),
        provenance: "made larger by an example",
    };
    let mut config = HdMapConfig::default();
    if most.is_some() {
        config.max_descriptors_per_point = 1;
    }
    HdMap::build(&content, &config, &no_progress)?.write(Path::new(out))?;
    drop(large);
    let begin = Instant::now();
    let large = HdMap::open(Path::new(out))?;
    let opened_s = begin.elapsed().as_secs_f64();
    let (points, descriptors) = (large.point_count(), large.descriptor_count());
    println!("{out}: {points} points, {descriptors} descriptors, opened in {opened_s:.2} s");
    Ok(())
}

/// Of the map that is made.
struct Content {
    rig: Rig,
    keyframes: Vec<StampedPose>,
    images: Vec<KeyframeImage>,
    points: Vec<MapPoint>,
    most_observations: usize,
}

impl Content {
    /// Adds a map with its cameras under other names, moved, with the cells of its descriptors in another order.
    fn add(
        &mut self,
        map: &HdMap,
        prefix: &str,
        aside: &Vector3<f64>,
        order: &[usize],
    ) -> Result<(), Box<dyn Error>> {
        let moved = Se3::new(UnitQuaternion::identity(), *aside);
        let (first_keyframe, cameras) = (self.keyframes.len(), map.cameras());
        let first_image = self.images.len();
        let named = |name: &String| format!("{prefix}{name}");
        for (name, camera) in &map.rig().cameras {
            self.rig.cameras.insert(named(name), camera.clone());
        }
        for index in 0..map.keyframe_count() {
            let keyframe = map.keyframe(index as u32).ok_or("no such keyframe")?;
            self.keyframes.push(StampedPose {
                time: Timestamp::from_nanos(self.keyframes.len() as i64),
                world_from_rig: moved * keyframe.world_from_rig,
            });
            self.images.extend(cameras.iter().map(|name| KeyframeImage {
                keyframe: first_keyframe + index,
                camera: named(name),
                features: Features::default(),
            }));
        }
        for point in 0..map.point_count() as u32 {
            let descriptors = map.descriptors(point);
            let mut observations = Vec::new();
            let seen = map.observations(point).take(self.most_observations);
            for (observation, descriptor) in seen.zip(descriptors.iter().cycle()) {
                let at = observation.keyframe as usize * cameras.len();
                let image = first_image + at + usize::from(observation.camera);
                let features = &mut self.images[image].features;
                observations.push(PointObservation {
                    image,
                    keypoint: features.keypoints.len() as u32,
                });
                features.keypoints.push(Keypoint {
                    pixel: observation.pixel,
                    scale_px: 1.0,
                    angle_rad: 0.0,
                    response: 1.0,
                });
                features.descriptors.push(exchanged(descriptor, order));
            }
            self.points.push(MapPoint {
                point_in_world: map.position(point).ok_or("no such point")? + aside,
                observations,
                reprojection_rms_px: map.quality(point).map_or(1.0, |q| q.reprojection_rms_px),
            });
        }
        Ok(())
    }
}

/// A descriptor with its cells in another order.
fn exchanged(descriptor: &Descriptor, order: &[usize]) -> Descriptor {
    std::array::from_fn(|i| descriptor[order[i / CELL] * CELL + i % CELL])
}
