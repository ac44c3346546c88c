//! One camera of a chain: its pose, clock, shutter and lens.

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, CameraTiming, Matrix3, Se3, Vector3};
use serde::Deserialize;

use crate::exchange::omni::Omni;
use crate::exchange::yaml::Others;
use crate::exchange::{checked, is_finite, list, rotation};

#[derive(Deserialize)]
pub(super) struct Link {
    camera_model: String,
    intrinsics: Vec<f64>,
    distortion_model: Option<String>,
    #[serde(default)]
    distortion_coeffs: Vec<f64>,
    resolution: [u32; 2],
    #[serde(rename = "T_cam_imu")]
    camera_from_imu: Option<[[f64; 4]; 4]>,
    /// OpenVINS writes this one.
    #[serde(rename = "T_imu_cam")]
    imu_from_camera: Option<[[f64; 4]; 4]>,
    #[serde(rename = "T_cn_cnm1")]
    camera_from_before: Option<[[f64; 4]; 4]>,
    timeshift_cam_imu: Option<f64>,
    /// Time from one row to the next, seconds or nanoseconds, as forks of Kalibr that know rolling shutters write it.
    line_delay: Option<f64>,
    line_delay_nanoseconds: Option<f64>,
    /// Where its images come from, and which cameras see the same: nothing that a rig says.
    #[serde(rename = "rostopic")]
    _topic: Option<String>,
    #[serde(rename = "cam_overlaps")]
    _overlaps: Option<Vec<u32>>,
    #[serde(flatten)]
    pub others: Others,
}

/// No shutter takes longer to read an image, seconds.
const LONGEST_READOUT_S: f64 = 1.0;
/// Difference of two poses in one file that is more than their rounding, `[rad, m]` together.
const SAME_POSE: f64 = 1e-3;

impl Link {
    /// Its clock and shutter. Kalibr's stamps are those of the first row, a rig's those of the middle one.
    pub fn timing(&self, name: &str, notes: &mut Vec<String>) -> Result<CameraTiming, String> {
        let delays_s = [
            self.line_delay,
            self.line_delay_nanoseconds.map(|ns| ns * 1e-9),
        ];
        let row_s = match delays_s {
            [Some(a), Some(b)] if a != b => {
                return Err(
                    "line_delay and line_delay_nanoseconds contradict each other".to_owned(),
                );
            }
            [a, b] => a.or(b).unwrap_or(0.0),
        };
        let shift_s = self.timeshift_cam_imu.unwrap_or(0.0);
        let [_, height] = self.resolution.map(f64::from);
        let timing = CameraTiming {
            rig_from_camera_s: shift_s + 0.5 * (height - 1.0) * row_s,
            readout_s: height * row_s,
        };
        if !(timing.rig_from_camera_s.is_finite() && timing.readout_s.is_finite()) {
            return Err("the time offset or line delay is not a number".to_owned());
        }
        if timing.readout_s.abs() > LONGEST_READOUT_S {
            return Err(format!(
                "rows {row_s} s apart make {} s per image: line_delay is in seconds",
                timing.readout_s
            ));
        }
        if self.timeshift_cam_imu.is_none() && self.has_imu() {
            notes.push(format!(
                "{name}: it has no timeshift_cam_imu: its clock is assumed to be the IMU's"
            ));
        }
        if row_s != 0.0 {
            notes.push(format!(
                "{name}: rolling shutter with a readout of {:.2} ms. Kalibr's stamps are of the first row, so that the rig's time offset, of the middle row, is {:.2} ms",
                timing.readout_s * 1e3,
                timing.rig_from_camera_s * 1e3
            ));
        }
        Ok(timing)
    }

    pub fn has_imu(&self) -> bool {
        self.camera_from_imu.is_some() || self.imu_from_camera.is_some()
    }

    /// The pose of the camera by whatever says it; `None` where nothing does. What says it twice must agree.
    pub fn rig_from_camera(&self, before: Option<Se3>) -> Result<Option<Se3>, String> {
        let read = |name: &'static str, rows: &Option<[[f64; 4]; 4]>| {
            let pose = rows.as_ref().map(pose).transpose();
            pose.map_err(|p| format!("{name} {p}"))
        };
        let said = [
            read("T_cam_imu", &self.camera_from_imu)?.map(|p| ("T_cam_imu", p.inverse())),
            read("T_imu_cam", &self.imu_from_camera)?.map(|p| ("T_imu_cam", p)),
            read("T_cn_cnm1", &self.camera_from_before)?
                .zip(before)
                .map(|(p, before)| ("T_cn_cnm1", before * p.inverse())),
        ];
        let mut said = said.into_iter().flatten();
        let Some((first, pose)) = said.next() else {
            return Ok(None);
        };
        for (other, again) in said {
            let off = (pose.inverse() * again).log();
            if off.norm() > SAME_POSE {
                return Err(format!(
                    "{first} and {other} contradict each other by {:.1}° and {:.1} mm: delete the wrong one",
                    off.fixed_rows::<3>(0).norm().to_degrees(),
                    off.fixed_rows::<3>(3).norm() * 1e3
                ));
            }
        }
        Ok(Some(pose))
    }
}

fn pose(rows: &[[f64; 4]; 4]) -> Result<Se3, String> {
    let last = [0.0, 0.0, 0.0, 1.0];
    let is_last = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-9;
    if !rows[3].iter().zip(&last).all(is_last) {
        return Err(format!(
            "is not a rigid transform: its last row is {}, expected [0, 0, 0, 1]; is it written column by column?",
            list(&rows[3])
        ));
    }
    let turn = Matrix3::from_fn(|i, j| rows[i][j]);
    let rotation = rotation(&turn).ok_or("is not a rigid transform")?;
    let translation = Vector3::from_fn(|i, _| rows[i][3]);
    let pose = Se3::new(rotation, translation);
    is_finite(&pose)
        .then_some(pose)
        .ok_or_else(|| "has a translation that is not a number".to_owned())
}

/// The camera, and by how much its lens misses the one in the file at most, pixels.
pub(super) fn camera(link: &Link) -> Result<(Camera, f64), String> {
    let distortion_model = link.distortion_model.as_deref().unwrap_or("none");
    let expect = |values: &[f64], n: usize, what: &str| {
        if values.len() == n {
            Ok(())
        } else {
            Err(format!("{} {what}, expected {n}", values.len()))
        }
    };
    let own = match link.camera_model.as_str() {
        "pinhole" => 0,
        "omni" => 1,
        "ds" | "eucm" => 2,
        other => {
            return Err(format!(
                "camera_model {other} is not supported: use pinhole, omni, ds or eucm"
            ));
        }
    };
    expect(&link.intrinsics, own + 4, "intrinsics")?;
    let (shape, pinhole) = link.intrinsics.split_at(own);
    let focal_px = [pinhole[0], pinhole[1]];
    let principal_px = [pinhole[2], pinhole[3]];
    let d = &link.distortion_coeffs;
    if distortion_model == "none" && d.iter().any(|k| *k != 0.0) {
        return Err("distortion_coeffs without a distortion_model".to_owned());
    }
    let [width, height] = link.resolution;
    let mut miss_px = 0.0;
    let lens = match (link.camera_model.as_str(), distortion_model) {
        ("omni", "none" | "radtan") => {
            if distortion_model == "radtan" {
                expect(d, 4, "distortion_coeffs")?;
            }
            let omni = Omni {
                xi: shape[0],
                focal_px,
                principal_px,
                distortion: std::array::from_fn(|k| d.get(k).copied().unwrap_or(0.0)),
            };
            let (lens, miss) = omni.to_lens(width, height)?;
            miss_px = miss;
            lens
        }
        ("ds", "none") => Lens::DoubleSphere {
            focal_px,
            principal_px,
            distortion: [shape[0], shape[1]],
        },
        ("eucm", "none") => Lens::ExtendedUnified {
            focal_px,
            principal_px,
            distortion: [shape[0], shape[1]],
        },
        ("pinhole", "none") => Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion: [0.0; 5],
        },
        ("pinhole", "radtan") => {
            expect(d, 4, "distortion_coeffs")?;
            Lens::PinholeRadtan {
                focal_px,
                principal_px,
                distortion: [d[0], d[1], d[2], d[3], 0.0],
            }
        }
        ("pinhole", "equidistant") => {
            expect(d, 4, "distortion_coeffs")?;
            Lens::KannalaBrandt {
                focal_px,
                principal_px,
                distortion: [d[0], d[1], d[2], d[3]],
            }
        }
        ("pinhole", "fov") => {
            expect(d, 1, "distortion_coeffs")?;
            Lens::FieldOfView {
                focal_px,
                principal_px,
                distortion: [d[0]],
            }
        }
        (model, distortion) => {
            return Err(format!(
                "{model} with distortion {distortion} is not supported"
            ));
        }
    };
    let camera = checked(Camera {
        width,
        height,
        lens,
    })?;
    Ok((camera, miss_px))
}
