//! The HD map: points with descriptors, the images that saw them, and an index over the descriptors.
//!
//! On disk it is a folder of Arrow IPC files and a `map.toml`, described in `FORMAT.md`; in memory its columns
//! are those files, mapped. Built by [`HdMap::build`] from points that [`reconstruct`] triangulated and an optimiser
//! may have moved.

mod build;
mod contradicted;
mod export;
mod file;
mod freed_cameras;
mod keyframe_covariance;
mod marks;
mod merge;
mod point_quality;
mod posed;
mod prepared_image;
mod prune;
mod reconstruction;
mod reconstruction_config;
mod reprojection_errors;
mod scene_depth;
mod site;
mod subset;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::ops::Range;

use arrow_buffer::{Buffer, ScalarBuffer};
use lsfb_geometry::{Matrix3, Rig, RigCamera, Se3, StampedPose, UnitQuaternion, Vector3};
use lsfb_types::{Finding, Judgement, Timestamp, Verdict};
use nalgebra::Quaternion;

use crate::Error;
use crate::descriptor_index::{DescriptorIndex, SearchScratch};
use crate::features::{DESCRIPTOR_LEN, Descriptor, Feature};

pub use build::{HdMapConfig, MapContent};
pub use export::{ColmapCamera, ExportedFile, ImagePose, MapFormat, export_image_poses};
pub use file::FORMAT_VERSION;
pub(crate) use freed_cameras::{FreedCameras, Sights};
use keyframe_covariance::CovarianceColumns;
pub use marks::{
    Click, ControlPoint, MarkConfig, PlacedMark, PlacedMarks, UnplacedMark, read_clicks,
    read_control_points,
};
pub(crate) use marks::{FAR_CLICK_SIGMAS, SAME_MOMENT_NS, meet_of_clicks};
pub use merge::{MergeConfig, MergeReport};
pub use point_quality::PointQuality;
pub use posed::{
    ListedErrors, PoseRefinement, PosedMap, PosedMapConfig, PosedMapReport,
    build_map_from_posed_images, build_map_from_posed_images_in_stages,
};
pub use prepared_image::KeyframeImage;
pub use prune::{PruneConfig, PruneReport};
pub(crate) use reconstruction::{CERTAIN_VIEWS, expect_map};
pub use reconstruction::{
    MapPoint, PointObservation, find_tracks, reconstruct, select_keyframes, triangulate_tracks,
};
pub use reconstruction_config::ReconstructionConfig;
pub use reprojection_errors::{CameraResiduals, PixelResiduals};
pub(crate) use reprojection_errors::{
    ErrorSummary, KeypointError, PlacedImages, drop_outliers, observation_errors_px,
    residuals_by_camera, track_errors,
};
pub use site::SiteFrame;
pub use subset::Region;

/// Points, keyframes, observations and descriptors, in columns. Cloning shares them.
#[derive(Clone, Debug)]
pub struct HdMap {
    /// The cameras that saw the points, with their poses in the rig.
    rig: Rig,
    /// Those of them that images showed to be other than stated, as they were stated.
    stated: BTreeMap<String, RigCamera>,
    /// Their names, in order.
    cameras: Vec<String>,
    feature: Feature,
    provenance: String,
    /// What was found wrong when it was made: a sentence each.
    failures: Vec<String>,
    site: Option<SiteFrame>,
    points: PointColumns,
    quality: QualityColumns,
    keyframes: KeyframeColumns,
    observations: ObservationColumns,
    descriptors: DescriptorColumns,
    index: DescriptorIndex,
}

#[derive(Clone, Debug)]
struct PointColumns {
    x_m: ScalarBuffer<f64>,
    y_m: ScalarBuffer<f64>,
    z_m: ScalarBuffer<f64>,
    first_observation: ScalarBuffer<u32>,
    first_descriptor: ScalarBuffer<u32>,
}

/// How well each point is known; [`PointQuality`] says what the columns mean.
#[derive(Clone, Debug, Default)]
struct QualityColumns {
    /// xx, xy, xz, yy, yz, zz.
    covariance_m2: [ScalarBuffer<f32>; 6],
    rms_px: ScalarBuffer<f32>,
    view: [ScalarBuffer<f32>; 3],
    view_cos: ScalarBuffer<f32>,
}

#[derive(Clone, Debug)]
struct KeyframeColumns {
    time_ns: ScalarBuffer<i64>,
    /// `qx qy qz qw tx ty tz` of `world_from_rig`.
    pose: [ScalarBuffer<f64>; 7],
    covariance: CovarianceColumns,
}

/// By point, then by keyframe and camera.
#[derive(Clone, Debug)]
struct ObservationColumns {
    point: ScalarBuffer<u32>,
    keyframe: ScalarBuffer<u32>,
    camera: ScalarBuffer<u16>,
    u_px: ScalarBuffer<f32>,
    v_px: ScalarBuffer<f32>,
}

/// By point.
#[derive(Clone, Debug)]
struct DescriptorColumns {
    point: ScalarBuffer<u32>,
    values: Buffer,
}

/// A pixel in which a map point was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapObservation {
    /// Index of the point.
    pub point: u32,
    /// Index of the keyframe.
    pub keyframe: u32,
    /// Index of the camera in [`HdMap::cameras`].
    pub camera: u16,
    /// Where, pixels.
    pub pixel: [f32; 2],
}

/// A descriptor of the map near a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapNeighbour {
    /// The point it belongs to.
    pub point: u32,
    /// Exact squared distance.
    pub distance_squared: u32,
}

impl HdMap {
    /// Name of the file in a map's folder that lists the others with their hashes.
    pub const HEADER: &str = "map.toml";

    /// Names of the cameras that saw the points.
    pub fn cameras(&self) -> &[String] {
        &self.cameras
    }

    /// The cameras that saw the points and where they sit in the rig whose poses the keyframes are.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// The cameras that the map's images showed to be other than was stated of them, as they were stated: in [`HdMap::rig`] they are as
    /// they were found.
    pub fn stated_cameras(&self) -> &BTreeMap<String, RigCamera> {
        &self.stated
    }

    /// With what was stated of cameras that [`HdMap::rig`] has as they were found.
    pub(crate) fn with_stated_cameras(self, stated: BTreeMap<String, RigCamera>) -> Self {
        Self { stated, ..self }
    }

    /// A camera as the map's images showed it, where it is stated just as one of theirs was; the camera of the same name before others.
    /// As stated where none of them is it.
    pub fn as_found(&self, name: &str, stated: &RigCamera) -> RigCamera {
        let mut same = self.stated.iter().filter(|(_, s)| is_same(s, stated));
        let first = same.clone().next();
        let found = same.find(|(other, _)| *other == name).or(first);
        let found = found.and_then(|(name, _)| self.rig.cameras.get(name));
        found.unwrap_or(stated).clone()
    }

    /// What the map was made from: a hash its maker chose.
    pub fn provenance(&self) -> &str {
        &self.provenance
    }

    /// What was found wrong with it when it was made, a sentence each: poses in such a map may be far off. Empty where nothing was.
    pub fn failures(&self) -> &[String] {
        &self.failures
    }

    /// Each of them: whatever is made of such a map, and each pose in it, is as wrong.
    pub fn failed_checks(&self) -> impl Iterator<Item = Finding> {
        self.failures.iter().map(|why| {
            let what = format!("failed its checks when it was made: {why}");
            Finding::new("failed-map", Verdict::Fail, "map", what)
                .remedy("fix that and map the place again")
        })
    }

    /// What whoever makes something else of it has to say: that it failed, or that it did not.
    pub fn checks(&self) -> Judgement {
        let mut findings: Vec<Finding> = self.failed_checks().collect();
        if findings.is_empty() {
            let what = "failed no check when it was made";
            findings.push(Finding::new("map-passed", Verdict::Pass, "map", what));
        }
        Judgement::new(findings)
    }

    /// With what was found wrong with it: [`HdMap::write`] keeps it beside the map, parts of it and maps that it is merged into have it too.
    pub fn with_failures(self, failures: Vec<String>) -> Self {
        Self { failures, ..self }
    }

    /// The surveyed frame that its world is, but for a shift; `None` where nothing was surveyed, and the world begins with the walk.
    pub fn site(&self) -> Option<&SiteFrame> {
        self.site.as_ref()
    }

    /// With the surveyed frame that its world is.
    pub(crate) fn with_site(self, site: Option<SiteFrame>) -> Self {
        Self { site, ..self }
    }

    /// What its descriptors are of.
    pub fn feature(&self) -> &Feature {
        &self.feature
    }

    /// Refuses images with another feature than the map's.
    pub(crate) fn expect_feature(&self, images: &Feature) -> Result<(), Error> {
        if *images == self.feature {
            return Ok(());
        }
        Err(Error::WrongFeature {
            map: self.feature.to_string(),
            images: images.to_string(),
        })
    }

    /// Number of points.
    pub fn point_count(&self) -> usize {
        self.points.x_m.len()
    }

    /// Number of keyframes.
    pub fn keyframe_count(&self) -> usize {
        self.keyframes.time_ns.len()
    }

    /// Number of observations.
    pub fn observation_count(&self) -> usize {
        self.observations.point.len()
    }

    /// Number of descriptors.
    pub fn descriptor_count(&self) -> usize {
        self.descriptors.point.len()
    }

    /// Position of a point in the world, metres; `None` where there is no such point.
    pub fn position(&self, point: u32) -> Option<Vector3<f64>> {
        let i = point as usize;
        let p = &self.points;
        Some(Vector3::new(*p.x_m.get(i)?, *p.y_m.get(i)?, *p.z_m.get(i)?))
    }

    /// Positions of all points in the world, metres.
    pub fn positions(&self) -> impl Iterator<Item = Vector3<f64>> + '_ {
        let p = &self.points;
        let columns = p.x_m.iter().zip(p.y_m.iter()).zip(p.z_m.iter());
        columns.map(|((x, y), z)| Vector3::new(*x, *y, *z))
    }

    /// How well a point is known; `None` where there is no such point.
    pub fn quality(&self, point: u32) -> Option<PointQuality> {
        let (i, q) = (point as usize, &self.quality);
        let rms_px = f64::from(*q.rms_px.get(i)?);
        let [xx, xy, xz, yy, yz, zz] = q.covariance_m2.each_ref().map(|c| f64::from(c[i]));
        let [x, y, z] = q.view.each_ref().map(|c| f64::from(c[i]));
        Some(PointQuality {
            covariance_m2: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
            reprojection_rms_px: rms_px,
            mean_view: Vector3::new(x, y, z),
            view_cos: f64::from(q.view_cos[i]),
        })
    }

    /// A keyframe; `None` where there is no such keyframe.
    pub fn keyframe(&self, keyframe: u32) -> Option<StampedPose> {
        let i = keyframe as usize;
        let time = Timestamp::from_nanos(*self.keyframes.time_ns.get(i)?);
        let [x, y, z, w, tx, ty, tz] = self.keyframes.pose.each_ref().map(|column| column[i]);
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
        Some(StampedPose {
            time,
            world_from_rig: Se3::new(rotation, Vector3::new(tx, ty, tz)),
        })
    }

    /// All keyframes, in the order of their numbers.
    pub fn keyframes(&self) -> impl Iterator<Item = StampedPose> + '_ {
        (0..self.keyframe_count() as u32).filter_map(|k| self.keyframe(k))
    }

    /// The observations of a point; none where there is no such point.
    pub fn observations(&self, point: u32) -> impl Iterator<Item = MapObservation> + '_ {
        let total = self.observation_count();
        range(&self.points.first_observation, point, total).map(move |i| {
            let o = &self.observations;
            MapObservation {
                point,
                keyframe: o.keyframe[i],
                camera: o.camera[i],
                pixel: [o.u_px[i], o.v_px[i]],
            }
        })
    }

    /// The descriptors of a point; none where there is no such point.
    pub fn descriptors(&self, point: u32) -> &[Descriptor] {
        let total = self.descriptor_count();
        &self.all_descriptors()[range(&self.points.first_descriptor, point, total)]
    }

    fn all_descriptors(&self) -> &[Descriptor] {
        self.descriptors.values.as_chunks::<DESCRIPTOR_LEN>().0
    }

    /// The `count` descriptors nearest to `query`, nearest first: `compared` are found by their codes in the `probes` nearest
    /// lists, and ordered by their exact distances.
    pub(crate) fn nearest(
        &self,
        query: &Descriptor,
        count: usize,
        probes: usize,
        compared: usize,
        scratch: &mut SearchScratch,
    ) -> Vec<MapNeighbour> {
        let compared = compared.max(count);
        let candidates =
            self.index
                .search_exactly(query, self.all_descriptors(), [compared, probes], scratch);
        let mut found: Vec<MapNeighbour> = candidates
            .map(|(descriptor, distance_squared)| MapNeighbour {
                point: self.descriptors.point[descriptor as usize],
                distance_squared,
            })
            .collect();
        found.sort_unstable_by_key(|n| (n.distance_squared, n.point));
        found.truncate(count);
        found
    }
}

/// Whether two cameras are stated alike: poses are rounded on their way through a file.
fn is_same(a: &RigCamera, b: &RigCamera) -> bool {
    let off = a.rig_from_camera.inverse() * b.rig_from_camera;
    a.camera == b.camera && a.timing == b.timing && off.log().norm() < 1e-9
}

/// Rows that belong to `owner` where `first` holds the first row of each; empty for an owner that is not there.
fn range(first: &[u32], owner: u32, total: usize) -> Range<usize> {
    let owner = owner as usize;
    let Some(start) = first.get(owner) else {
        return 0..0;
    };
    let end = first.get(owner + 1).map_or(total, |e| *e as usize);
    *start as usize..end
}
