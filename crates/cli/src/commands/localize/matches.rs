//! The features of a frame that agree with its best pose, and the map points they show: for CSV, and as they are kept.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path;

use anyhow::Context as _;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lsfb_geometry::{Camera, Rig, Se3, Vector2, Vector3};
use lsfb_pipeline::localization::{FeatureMatch, Localization, Localizer, NotLocalized};

use super::frames::{Frame, field};

/// Inliers of the best pose of a frame, localized or not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inliers {
    /// The cameras of the frame's images, as the inliers count them.
    pub cameras: Vec<String>,
    /// None where there is no pose.
    pub inliers: Vec<FeatureMatch>,
}

impl Inliers {
    pub fn new(cameras: Vec<String>, found: &Result<Localization, NotLocalized>) -> Self {
        let best = found.as_ref().map_or_else(NotLocalized::best, Some);
        Self {
            cameras,
            inliers: best.map_or_else(Vec::new, |best| best.matches.clone()),
        }
    }

    /// Those of one camera.
    pub fn of_camera(&self, camera: &str) -> impl Iterator<Item = &FeatureMatch> {
        let of_it = move |m: &&FeatureMatch| self.cameras.get(m.frame).is_some_and(|c| c == camera);
        self.inliers.iter().filter(of_it)
    }
}

/// A camera in the world, as the pose of its rig has it.
pub struct PosedCamera {
    camera: Camera,
    camera_from_world: Se3,
}

impl PosedCamera {
    /// A camera of the rig as poses in the map were found with it. `None` of one that the rig does not have.
    pub fn new(
        localizer: &Localizer,
        rig: &Rig,
        camera: &str,
        world_from_rig: &Se3,
    ) -> Option<Self> {
        let mounted = localizer.map().as_found(camera, rig.cameras.get(camera)?);
        Some(Self {
            camera: mounted.camera,
            camera_from_world: (*world_from_rig * mounted.rig_from_camera).inverse(),
        })
    }

    /// Where it sees a point; `None` behind it.
    pub fn project(&self, point_in_world: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.camera
            .project(&(self.camera_from_world * *point_in_world))
    }
}

/// Writes a line for each inlier of each frame.
pub fn write_csv(
    path: &Path,
    frames: &[Frame],
    inliers: &[Inliers],
    localizer: &Localizer,
    rig: &Rig,
) -> anyhow::Result<()> {
    let written = File::create(path).and_then(|file| {
        let mut out = BufWriter::new(file);
        writeln!(
            out,
            "frame,localized,camera,u_px,v_px,point,x_m,y_m,z_m,residual_px"
        )?;
        for (frame, inliers) in frames.iter().zip(inliers) {
            let Some(pose) = &frame.pose else {
                continue;
            };
            let (name, localized) = (field(&frame.frame), u8::from(frame.localized));
            for camera in &inliers.cameras {
                let posed = PosedCamera::new(localizer, rig, camera, &pose.world_from_rig());
                let camera_name = field(camera);
                for m in inliers.of_camera(camera) {
                    // All of their digits: what is computed again from the table is the same.
                    let [u, v] = m.pixel.map(f64::from);
                    let seen = Vector2::new(u, v);
                    let Some(point) = localizer.map().position(m.point) else {
                        continue;
                    };
                    let expected = posed.as_ref().and_then(|posed| posed.project(&point));
                    let residual = expected
                        .map_or_else(String::new, |expected| (expected - seen).norm().to_string());
                    let [x, y, z]: [f64; 3] = point.into();
                    let id = m.point;
                    writeln!(
                        out,
                        "{name},{localized},{camera_name},{u},{v},{id},{x},{y},{z},{residual}"
                    )?;
                }
            }
        }
        out.flush()
    });
    written.with_context(|| path.display().to_string())
}

/// Bytes of an inlier as it is kept.
const KEPT_BYTES: usize = 16;

/// The inliers of a single image as one word.
pub fn kept(inliers: &[FeatureMatch]) -> String {
    let bytes = inliers.iter().flat_map(|m| {
        let [u, v] = m.pixel.map(f32::to_le_bytes);
        [m.point.to_le_bytes(), m.keypoint.to_le_bytes(), u, v].concat()
    });
    STANDARD.encode(bytes.collect::<Vec<u8>>())
}

/// The inliers of a word of [`kept`]; `None` of another word.
pub fn of_kept(word: &str) -> Option<Vec<FeatureMatch>> {
    let bytes = STANDARD.decode(word).ok()?;
    let (inliers, rest) = bytes.as_chunks::<KEPT_BYTES>();
    let of_bytes = |bytes: &[u8; KEPT_BYTES]| {
        let (fields, _) = bytes.as_chunks::<4>();
        let [point, keypoint, u, v] = <[[u8; 4]; 4]>::try_from(fields).ok()?;
        Some(FeatureMatch {
            point: u32::from_le_bytes(point),
            frame: 0,
            keypoint: u32::from_le_bytes(keypoint),
            pixel: [u, v].map(f32::from_le_bytes),
        })
    };
    rest.is_empty()
        .then(|| inliers.iter().map(of_bytes).collect())?
}
