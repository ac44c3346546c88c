//! Parts of recordings, each calibrated alone, and whether they scatter as their standard deviations say.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use lsfb_calib::camera::{CameraConfig, CameraViews, calibrate_cameras};
use lsfb_calib::camera_imu::{
    CameraImuCalibration, CameraImuConfig, calibrate_camera_imu, read_imu_table,
};
use lsfb_calib::lidar_camera::{
    BoardPose, LidarCameraCalibration, LidarCameraConfig, calibrate_lidar_camera,
};
use lsfb_geometry::{Camera, Se3};
use lsfb_types::{ImuSample, Timestamp, no_progress};

use crate::recorded::{ACFR_BOARD, TUM_VI_GRID, TUM_VI_IMU_NOISE, tum_vi_views, with_own_lenses};

/// What parts say of each parameter: value and standard deviation.
#[derive(Clone, Debug, Default)]
pub struct Said {
    by_name: BTreeMap<String, Vec<[f64; 2]>>,
    /// Poses are said of as they lie from those of the first part.
    reference: Vec<Se3>,
}

impl Said {
    pub fn put(&mut self, name: impl Into<String>, value: f64, sigma: f64) {
        let name = name.into();
        assert!(sigma > 0.0 && sigma.is_finite(), "{name}: ± {sigma}");
        self.by_name.entry(name).or_default().push([value, sigma]);
    }

    fn put_poses(&mut self, poses: Vec<(String, Se3, [f64; 6])>) {
        if self.reference.is_empty() {
            self.reference = poses.iter().map(|p| p.1).collect();
        }
        for ((name, pose, sigma), reference) in poses.into_iter().zip(self.reference.clone()) {
            let off = (reference.inverse() * pose).log();
            for (k, sigma) in sigma.iter().enumerate() {
                self.put(format!("{name} {k}"), off[k], *sigma);
            }
        }
    }

    pub fn values(&self) -> impl Iterator<Item = (&str, &[[f64; 2]])> {
        let all = self.by_name.iter();
        all.map(|(name, values)| (name.as_str(), values.as_slice()))
    }

    /// Root of χ² over its degrees of freedom of each parameter, about the mean weighted by σ.
    pub fn scatter(&self) -> Vec<(&str, f64)> {
        let scatter = |values: &[[f64; 2]]| {
            let weight: f64 = values.iter().map(|[_, s]| s.powi(-2)).sum();
            let mean = values.iter().map(|[x, s]| x / (s * s)).sum::<f64>() / weight;
            let squares: f64 = values.iter().map(|[x, s]| ((x - mean) / s).powi(2)).sum();
            (squares / (values.len() - 1) as f64).sqrt()
        };
        self.values()
            .map(|(name, values)| (name, scatter(values)))
            .collect()
    }

    /// Root of the mean of χ² over its degrees of freedom over all parameters.
    pub fn rms(&self) -> f64 {
        let scatter = self.scatter();
        let squares: f64 = scatter.iter().map(|(_, s)| s * s).sum();
        (squares / scatter.len() as f64).sqrt()
    }
}

/// Both cameras of TUM VI before the board, and the IMU.
#[derive(Clone, Debug)]
pub struct TumVi {
    cameras: [CameraViews; 2],
    imu: Vec<(Timestamp, ImuSample)>,
}

impl TumVi {
    /// Of folders that follow each other.
    pub fn read<'a>(folders: impl IntoIterator<Item = &'a Path>) -> Self {
        let mut all: Option<Self> = None;
        for folder in folders {
            let cameras = tum_vi_views(folder);
            let imu = read_imu_table(&folder.join("imu0/data.csv")).expect("a table");
            let Some(all) = &mut all else {
                all = Some(Self { cameras, imu });
                continue;
            };
            for (camera, more) in all.cameras.iter_mut().zip(cameras) {
                camera.images += more.images;
                camera.views.extend(more.views);
            }
            let last = all.imu.last().map(|s| s.0);
            all.imu.extend(imu.into_iter().filter(|s| Some(s.0) > last));
        }
        all.expect("a folder")
    }

    /// Instants of views.
    pub fn len(&self) -> usize {
        self.cameras[0].views.len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// What lies between two instants, by number.
    fn part(&self, range: Range<usize>) -> Self {
        let cameras = self.cameras.clone().map(|views| {
            let own = views.views.into_iter().skip(range.start);
            CameraViews {
                images: range.len(),
                views: own.take(range.len()).collect(),
                ..views
            }
        });
        let stamps = || cameras.iter().flat_map(|c| c.views.keys().copied());
        let (first, last) = (stamps().min(), stamps().max());
        let within = |t: &Timestamp| Some(t.nanos()) >= first && Some(t.nanos()) <= last;
        let imu = self.imu.iter().filter(|s| within(&s.0)).copied().collect();
        Self { cameras, imu }
    }

    /// Calibrates a part alone, lenses and all, and notes what it says.
    pub fn calibrate(&self, range: Range<usize>, said: &mut Said) -> CameraImuCalibration {
        let Self { cameras, imu } = self.part(range);
        let (config, target) = (CameraConfig::default(), &TUM_VI_GRID);
        let lenses = calibrate_cameras(target, &cameras, &config, &no_progress).expect("lenses");
        for c in &lenses.cameras {
            for p in &c.parameters {
                said.put(format!("views: {} {}", c.name, p.name), p.value, p.sigma);
            }
        }
        let known = with_own_lenses(&cameras, &lenses);
        let (noise, config) = (TUM_VI_IMU_NOISE, CameraImuConfig::default());
        let found = calibrate_camera_imu(target, &known, &imu, &noise, &config, &no_progress);
        let found = found.expect("found");
        let second = &lenses.cameras[1];
        let mut poses = vec![(
            "views: cam1 from cam0".to_owned(),
            second.camera_from_first,
            second.pose_sigma,
        )];
        said.put("size", found.board_excess, found.board_excess_sigma);
        for c in &found.cameras {
            let sigma = std::array::from_fn(|k| c.covariance[(k, k)].sqrt());
            poses.push((format!("{} on the IMU", c.name), c.camera_from_rig, sigma));
            let (clock, drift) = (c.rig_from_camera_s, c.clock_drift);
            said.put(
                format!("{} clock", c.name),
                clock,
                c.rig_from_camera_sigma_s,
            );
            said.put(format!("{} drift", c.name), drift, c.clock_drift_sigma);
            for p in &c.lens {
                said.put(format!("{} {}", c.name, p.name), p.value, p.sigma);
            }
        }
        said.put_poses(poses);
        found
    }
}

/// Calibrates the LiDAR of acfr_cam_lidar by some of its poses, and notes what they say; fails where these do not determine it.
pub fn calibrate_acfr(
    camera: &Camera,
    poses: &[BoardPose],
    said: &mut Said,
) -> Result<LidarCameraCalibration, lsfb_calib::Error> {
    let config = LidarCameraConfig::default();
    let found = calibrate_lidar_camera(&ACFR_BOARD, "cam0", camera, poses, &config, &no_progress)?;
    said.put_poses(vec![(
        "LiDAR".to_owned(),
        found.camera_from_lidar,
        found.sigma,
    )]);
    Ok(found)
}
