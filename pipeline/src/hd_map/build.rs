use std::collections::BTreeMap;

use arrow_buffer::{ArrowNativeType, Buffer, ScalarBuffer};
use lsfb_geometry::{Matrix6, Rig, RigCamera, StampedPose, Vector3};
use lsfb_types::{Bounds, ProgressFn};
use serde::{Deserialize, Serialize};

use super::{
    CovarianceColumns, DescriptorColumns, HdMap, KeyframeColumns, KeyframeImage, MapObservation,
    MapPoint, ObservationColumns, PointColumns, QualityColumns, SiteFrame,
};
use crate::Error;
use crate::descriptor_index::{DescriptorIndex, DescriptorSource, IndexConfig};
use crate::features::matching::distance_squared;
use crate::features::{Descriptor, Feature};

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
    /// What the descriptors of the images are of.
    pub feature: &'a Feature,
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

/// A map row by row, as it is taken apart and put together.
#[derive(Clone, Debug)]
pub(super) struct MapRows {
    /// Cameras by name: an observation's camera is its place among them.
    pub rig: Rig,
    /// Those of them that were stated otherwise, as they were stated.
    pub stated: BTreeMap<String, RigCamera>,
    pub keyframes: Vec<StampedPose>,
    /// How well each of them is known; `None` where that is unknown.
    pub covariances: Vec<Option<Matrix6<f64>>>,
    pub points: Vec<PointRow>,
    pub feature: Feature,
    pub provenance: String,
    pub failures: Vec<String>,
    pub site: Option<SiteFrame>,
}

/// A point with what saw it.
#[derive(Clone, Debug)]
pub(super) struct PointRow {
    /// In the world, metres.
    pub position: Vector3<f64>,
    /// By keyframe and camera.
    pub observations: Vec<MapObservation>,
    pub descriptors: Vec<Descriptor>,
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

        let mut rows = Vec::with_capacity(content.points.len());
        for (index, p) in content.points.iter().enumerate() {
            if !p.point_in_world.iter().all(|v| v.is_finite()) {
                return Err(Error::MapContent {
                    point: index,
                    reason: "its position is not finite",
                });
            }
            let mut row = PointRow {
                position: p.point_in_world,
                observations: Vec::with_capacity(p.observations.len()),
                descriptors: Vec::new(),
            };
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
                row.observations.push(MapObservation {
                    point: index as u32,
                    keyframe: image.keyframe as u32,
                    camera: camera_of_image[o.image],
                    pixel: keypoint.pixel,
                });
            }
            row.descriptors = typical(&seen, config.max_descriptors_per_point.max(1));
            rows.push(row);
        }
        let mut rig = Rig::empty(&content.rig.name);
        rig.cameras = content.rig.cameras.clone();
        rig.cameras.retain(|name, _| cameras.contains(name));
        let rows = MapRows {
            rig,
            stated: BTreeMap::new(),
            keyframes: content.keyframes.to_vec(),
            covariances: vec![None; content.keyframes.len()],
            points: rows,
            feature: content.feature.clone(),
            provenance: content.provenance.to_owned(),
            failures: Vec::new(),
            site: None,
        };
        Self::from_rows(rows, &config.index, progress)
    }

    /// Columns from rows whose references lead somewhere; the observations' own `point` is set anew.
    pub(super) fn from_rows(
        rows: MapRows,
        index: &IndexConfig,
        progress: ProgressFn,
    ) -> Result<Self, Error> {
        let mut first_observation = Vec::with_capacity(rows.points.len());
        let mut first_descriptor = Vec::with_capacity(rows.points.len());
        let mut observations: Vec<MapObservation> = Vec::new();
        let (mut owner, mut descriptors): (Vec<u32>, Vec<Descriptor>) = (Vec::new(), Vec::new());
        for (point, row) in rows.points.iter().enumerate() {
            let point = point as u32;
            first_observation.push(observations.len() as u32);
            first_descriptor.push(descriptors.len() as u32);
            let own = row.observations.iter();
            observations.extend(own.map(|o| MapObservation { point, ..*o }));
            owner.extend(std::iter::repeat_n(point, row.descriptors.len()));
            descriptors.extend(&row.descriptors);
        }
        let axis = |a: usize| -> Vec<f64> { rows.points.iter().map(|p| p.position[a]).collect() };
        let index =
            DescriptorIndex::build(DescriptorSource::Memory(&descriptors), index, progress)?;
        let map = Self {
            cameras: rows.rig.cameras.keys().cloned().collect(),
            rig: rows.rig,
            stated: rows.stated,
            feature: rows.feature,
            provenance: rows.provenance,
            failures: rows.failures,
            site: rows.site,
            points: PointColumns {
                x_m: axis(0).into(),
                y_m: axis(1).into(),
                z_m: axis(2).into(),
                first_observation: first_observation.into(),
                first_descriptor: first_descriptor.into(),
            },
            quality: QualityColumns::default(),
            keyframes: keyframe_columns(&rows.keyframes, &rows.covariances),
            observations: ObservationColumns {
                point: column(&observations, |o| o.point),
                keyframe: column(&observations, |o| o.keyframe),
                camera: column(&observations, |o| o.camera),
                u_px: column(&observations, |o| o.pixel[0]),
                v_px: column(&observations, |o| o.pixel[1]),
            },
            descriptors: DescriptorColumns {
                point: owner.into(),
                values: Buffer::from(descriptors.into_flattened()),
            },
            index,
        };
        Ok(map.with_quality())
    }

    /// The map's own rows.
    pub(super) fn rows(&self) -> MapRows {
        let points = 0..self.point_count() as u32;
        let keyframes = 0..self.keyframe_count() as u32;
        let covariances = keyframes.clone();
        MapRows {
            rig: self.rig.clone(),
            stated: self.stated.clone(),
            keyframes: keyframes.filter_map(|k| self.keyframe(k)).collect(),
            covariances: covariances.map(|k| self.keyframe_covariance(k)).collect(),
            points: points
                .filter_map(|p| {
                    Some(PointRow {
                        position: self.position(p)?,
                        observations: self.observations(p).collect(),
                        descriptors: self.descriptors(p).to_vec(),
                    })
                })
                .collect(),
            feature: self.feature.clone(),
            provenance: self.provenance.clone(),
            failures: self.failures.clone(),
            site: self.site.clone(),
        }
    }
}

fn column<T: ArrowNativeType>(
    observations: &[MapObservation],
    value: impl Fn(&MapObservation) -> T,
) -> ScalarBuffer<T> {
    observations.iter().map(value).collect::<Vec<T>>().into()
}

fn keyframe_columns(
    keyframes: &[StampedPose],
    covariances: &[Option<Matrix6<f64>>],
) -> KeyframeColumns {
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
        covariance: CovarianceColumns::new(covariances),
    }
}

/// The descriptor with the smallest sum of distances to all others, then those farthest from the chosen ones.
pub(super) fn typical(seen: &[&Descriptor], limit: usize) -> Vec<Descriptor> {
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
