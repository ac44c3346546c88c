use arrow_buffer::Buffer;
use lsfb_geometry::{Rig, StampedPose};
use lsfb_types::{Bounds, ProgressFn};
use serde::{Deserialize, Serialize};

use super::index::{DescriptorIndex, IndexConfig};
use super::{
    DescriptorColumns, HdMap, KeyframeColumns, KeyframeImage, MapPoint, ObservationColumns,
    PointColumns, QualityColumns,
};
use crate::Error;
use crate::features::Descriptor;
use crate::features::matching::distance_squared;

/// What a map is made of.
#[derive(Clone, Copy, Debug)]
pub struct MapContent<'a> {
    /// The cameras and where they sit.
    pub rig: &'a Rig,
    /// The keyframes, with their final poses.
    pub keyframes: &'a [StampedPose],
    /// Their images.
    pub images: &'a [KeyframeImage],
    /// The points, with their final positions.
    pub points: &'a [MapPoint],
    /// Hash of the inputs, written beside the map.
    pub provenance: &'a str,
}

/// Configuration of [`HdMap::build`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HdMapConfig {
    /// Most descriptors kept of a point: the most typical one and those that differ most from it.
    pub max_descriptors_per_point: usize,
    /// The descriptor index.
    pub index: IndexConfig,
}

impl Default for HdMapConfig {
    fn default() -> Self {
        Self {
            max_descriptors_per_point: 4,
            index: IndexConfig::default(),
        }
    }
}

lsfb_types::bounds! {
    HdMapConfig {
        max_descriptors_per_point: number(Bounds::AT_LEAST_ONE),
        index: section,
    }
}

impl HdMap {
    /// Puts a map together, measures how well its points are known and trains its index. Refuses observations of images,
    /// cameras, keypoints or keyframes that are not there, and points that are not finite.
    pub fn build(
        content: &MapContent,
        config: &HdMapConfig,
        progress: ProgressFn,
    ) -> Result<Self, Error> {
        let mut cameras: Vec<String> = content.images.iter().map(|i| i.camera.clone()).collect();
        cameras.sort_unstable();
        cameras.dedup();
        let camera_of = |name: &str| cameras.iter().position(|c| c == name).unwrap_or(0) as u16;
        let camera_of_image: Vec<u16> = content
            .images
            .iter()
            .map(|i| camera_of(&i.camera))
            .collect();

        let mut first_observation = Vec::new();
        let mut first_descriptor = Vec::new();
        let (mut point, mut keyframe, mut camera) = (Vec::new(), Vec::new(), Vec::new());
        let (mut u_px, mut v_px) = (Vec::new(), Vec::new());
        let (mut owner, mut kept): (Vec<u32>, Vec<Descriptor>) = (Vec::new(), Vec::new());
        for (index, p) in content.points.iter().enumerate() {
            if !p.point_in_world.iter().all(|v| v.is_finite()) {
                return Err(Error::MapContent {
                    point: index,
                    reason: "its position is not finite",
                });
            }
            first_observation.push(point.len() as u32);
            first_descriptor.push(kept.len() as u32);
            let mut seen = Vec::with_capacity(p.observations.len());
            for o in &p.observations {
                let missing = |reason| Error::MapContent {
                    point: index,
                    reason,
                };
                let image = content
                    .images
                    .get(o.image)
                    .ok_or(missing("its image is missing"))?;
                if !content.rig.cameras.contains_key(&image.camera) {
                    return Err(missing("its camera is not in the rig"));
                }
                if image.keyframe >= content.keyframes.len() {
                    return Err(missing("its keyframe is missing"));
                }
                let at = o.keypoint as usize;
                let features = &image.features;
                let keypoint = features
                    .keypoints
                    .get(at)
                    .ok_or(missing("its keypoint is missing"))?;
                seen.push(
                    features
                        .descriptors
                        .get(at)
                        .ok_or(missing("its descriptor is missing"))?,
                );
                point.push(index as u32);
                keyframe.push(image.keyframe as u32);
                camera.push(camera_of_image[o.image]);
                u_px.push(keypoint.pixel[0]);
                v_px.push(keypoint.pixel[1]);
            }
            let chosen = typical(&seen, config.max_descriptors_per_point.max(1));
            owner.extend(std::iter::repeat_n(index as u32, chosen.len()));
            kept.extend(chosen);
        }
        let axis = |a: usize| {
            content
                .points
                .iter()
                .map(|p| p.point_in_world[a])
                .collect::<Vec<f64>>()
        };
        let index = DescriptorIndex::build(&kept, &config.index, progress)?;
        let mut rig = Rig::empty(&content.rig.name);
        rig.cameras = content.rig.cameras.clone();
        rig.cameras.retain(|name, _| cameras.contains(name));
        Ok(Self {
            rig,
            cameras,
            provenance: content.provenance.to_owned(),
            points: PointColumns {
                x_m: axis(0).into(),
                y_m: axis(1).into(),
                z_m: axis(2).into(),
                first_observation: first_observation.into(),
                first_descriptor: first_descriptor.into(),
            },
            keyframes: keyframe_columns(content.keyframes),
            observations: ObservationColumns {
                point: point.into(),
                keyframe: keyframe.into(),
                camera: camera.into(),
                u_px: u_px.into(),
                v_px: v_px.into(),
            },
            descriptors: DescriptorColumns {
                point: owner.into(),
                values: Buffer::from(kept.into_flattened()),
            },
            quality: QualityColumns::default(),
            index,
        }
        .with_quality())
    }
}

fn keyframe_columns(keyframes: &[StampedPose]) -> KeyframeColumns {
    let time_ns: Vec<i64> = keyframes.iter().map(|k| k.time.nanos()).collect();
    let pose = std::array::from_fn(|i| {
        let value = |k: &StampedPose| {
            let q = k.world_from_rig.rotation.quaternion();
            let t = k.world_from_rig.translation;
            [q.i, q.j, q.k, q.w, t.x, t.y, t.z][i]
        };
        keyframes.iter().map(value).collect::<Vec<f64>>().into()
    });
    KeyframeColumns {
        time_ns: time_ns.into(),
        pose,
    }
}

/// The descriptor with the smallest sum of distances to all others, then those farthest from the chosen ones.
fn typical(seen: &[&Descriptor], limit: usize) -> Vec<Descriptor> {
    let sum = |d: &Descriptor| -> u64 {
        seen.iter()
            .map(|other| u64::from(distance_squared(d, other)))
            .sum()
    };
    let Some(medoid) = (0..seen.len()).min_by_key(|i| (sum(seen[*i]), *i)) else {
        return Vec::new();
    };
    let mut chosen = vec![medoid];
    let to = |index: usize| move |d: &&Descriptor| distance_squared(d, seen[index]);
    let mut nearest: Vec<u32> = seen.iter().map(to(medoid)).collect();
    while chosen.len() < limit {
        let farthest = (0..seen.len()).max_by_key(|i| (nearest[*i], std::cmp::Reverse(*i)));
        let Some(next) = farthest.filter(|i| nearest[*i] > 0) else {
            break;
        };
        chosen.push(next);
        for (nearest, distance) in nearest.iter_mut().zip(seen.iter().map(to(next))) {
            *nearest = distance.min(*nearest);
        }
    }
    chosen.into_iter().map(|i| *seen[i]).collect()
}
