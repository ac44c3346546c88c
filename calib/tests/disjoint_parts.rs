//! Standard deviations tried on real recordings: parts of one recording, each calibrated alone, scatter as their σ say.

use std::collections::BTreeMap;

use lsfb_calib::camera::{CameraConfig, CameraViews, calibrate_cameras};
use lsfb_calib::camera_imu::{
    CameraImuCalibration, CameraImuConfig, calibrate_camera_imu, read_imu_table,
};
use lsfb_calib::lidar_camera::{BoardPose, LidarCameraConfig, calibrate_lidar_camera};
use lsfb_geometry::Se3;
use lsfb_rigs::recorded::{
    ACFR_BOARD, TUM_VI_GRID, TUM_VI_IMU_NOISE, acfr, tum_vi_views, with_own_lenses,
};
use lsfb_tests::recordings;
use lsfb_types::{ImuSample, Timestamp, Verdict, no_progress};

/// Root of χ² over its degrees of freedom that is allowed for each parameter: the aim.
const MOST: f64 = 1.5;

/// What the aim is missed by on TUM VI: its accelerometer measures 1.6 ms before its gyroscope, which is in the standard deviations
/// but not taken out of the values, so that clocks follow the motion of each part.
const TUM_VI_BARS: [(&str, f64); 3] = [("cam0 clock", 1.9), ("cam1 clock", 1.9), ("cam0 k1", 1.6)];

/// And on acfr_cam_lidar: what the given lens moves along the view is more than what is found of it from five views.
const ACFR_BARS: [(&str, f64); 1] = [("5", 2.8)];

/// What parts say of each parameter: value and standard deviation.
#[derive(Default)]
struct Said(BTreeMap<String, Vec<[f64; 2]>>);

impl Said {
    fn put(&mut self, name: String, value: f64, sigma: f64) {
        assert!(sigma > 0.0 && sigma.is_finite(), "{name}: ± {sigma}");
        self.0.entry(name).or_default().push([value, sigma]);
    }

    /// Root of χ² over its degrees of freedom of each parameter, about the mean weighted by σ.
    fn scatter(&self) -> Vec<(&str, f64)> {
        let scatter = |values: &Vec<[f64; 2]>| {
            let weight: f64 = values.iter().map(|[_, s]| s.powi(-2)).sum();
            let mean = values.iter().map(|[x, s]| x / (s * s)).sum::<f64>() / weight;
            let squares: f64 = values.iter().map(|[x, s]| ((x - mean) / s).powi(2)).sum();
            (squares / (values.len() - 1) as f64).sqrt()
        };
        let all = self.0.iter();
        all.map(|(name, values)| (name.as_str(), scatter(values)))
            .collect()
    }

    /// Within the aim, or the bar where there is one.
    fn assert_holds(&self, bars: &[(&str, f64)]) {
        let scatter = self.scatter();
        let most = |name: &str| bars.iter().find(|b| b.0 == name).map_or(MOST, |b| b.1);
        let too_large: Vec<_> = scatter.iter().filter(|(n, s)| *s > most(n)).collect();
        assert!(too_large.is_empty(), "σ too small: {too_large:?}");
        // Nor is everything called unknown: as many standard deviations as parts differ by.
        let mean_square = scatter.iter().map(|(_, s)| s * s).sum::<f64>() / scatter.len() as f64;
        assert!(mean_square > 0.2, "σ too large: {}", mean_square.sqrt());
    }
}

/// Both cameras and the IMU of a folder.
type Recorded = (Vec<CameraViews>, Vec<(Timestamp, ImuSample)>);

/// The first or second half of a folder of TUM VI.
fn half((cameras, imu): &Recorded, second: bool) -> Recorded {
    let half_of = |views: &CameraViews| {
        let count = views.views.len() / 2;
        let skip = if second { count } else { 0 };
        let own = views.views.iter().skip(skip).take(count);
        CameraViews {
            images: count,
            views: own.map(|(t, c)| (*t, c.clone())).collect(),
            ..views.clone()
        }
    };
    let cameras: Vec<CameraViews> = cameras.iter().map(half_of).collect();
    let stamps = || cameras.iter().flat_map(|c| c.views.keys().copied());
    let (first, last) = (
        stamps().min().expect("views"),
        stamps().max().expect("views"),
    );
    let within = |t: &Timestamp| (first..=last).contains(&t.nanos());
    let imu = imu.iter().filter(|s| within(&s.0)).copied().collect();
    (cameras, imu)
}

fn tum_vi(said: &mut Said, (cameras, imu): &Recorded) -> CameraImuCalibration {
    let config = CameraConfig::default();
    let lenses = calibrate_cameras(&TUM_VI_GRID, cameras, &config, &no_progress).expect("lenses");
    for c in &lenses.cameras {
        for p in &c.parameters {
            said.put(format!("views: {} {}", c.name, p.name), p.value, p.sigma);
        }
    }
    let second = &lenses.cameras[1];
    for (k, value) in second.camera_from_first.log().iter().enumerate() {
        said.put(
            format!("views: cam1 from cam0 {k}"),
            *value,
            second.pose_sigma[k],
        );
    }
    let known = with_own_lenses(cameras, &lenses);
    let noise = TUM_VI_IMU_NOISE;
    let config = CameraImuConfig::default();
    calibrate_camera_imu(&TUM_VI_GRID, &known, imu, &noise, &config, &no_progress).expect("found")
}

/// Once three of these four passed with clocks 5 σ apart, and the last failed for a board 3 % smaller than it is: the
/// accelerometer measures 1.6 ms before the gyroscope, and the board is bent.
#[test]
fn tum_vi_in_four_parts() {
    let test = "tum_vi_in_four_parts";
    let mut said = Said::default();
    let mut reference = None;
    for folder in ["tumvi_calib_imu1", "tumvi_calib_imu1_next"] {
        let Some(folder) = recordings(test, &format!("vision/{folder}/mav0")) else {
            return;
        };
        let cameras = tum_vi_views(&folder);
        let imu = read_imu_table(&folder.join("imu0/data.csv")).expect("a table");
        let recorded: Recorded = (cameras.to_vec(), imu);
        for second in [false, true] {
            let found = tum_vi(&mut said, &half(&recorded, second));
            let judgement = found.judgement();
            assert_ne!(judgement.verdict(), Verdict::Fail, "{:?}", found.findings);
            said.put("size".into(), found.board_excess, found.board_excess_sigma);
            let from: Vec<Se3> = found.cameras.iter().map(|c| c.camera_from_rig).collect();
            let reference: &Vec<Se3> = reference.get_or_insert(from);
            for (c, reference) in found.cameras.iter().zip(reference) {
                let off = (reference.inverse() * c.camera_from_rig).log();
                for (k, value) in off.iter().enumerate() {
                    let sigma = c.covariance[(k, k)].sqrt();
                    said.put(format!("{} on the IMU {k}", c.name), *value, sigma);
                }
                let clock = (c.rig_from_camera_s, c.rig_from_camera_sigma_s);
                said.put(format!("{} clock", c.name), clock.0, clock.1);
                let drift = (c.clock_drift, c.clock_drift_sigma);
                said.put(format!("{} drift", c.name), drift.0, drift.1);
                for p in &c.lens {
                    said.put(format!("{} {}", c.name, p.name), p.value, p.sigma);
                }
            }
        }
    }
    said.assert_holds(&TUM_VI_BARS);
}

/// Once 3.7 σ apart: the lens that was given is not that of these images.
#[test]
fn acfr_in_halves() {
    let Some(folder) = recordings("acfr_in_halves", "lidar/acfr_cam_lidar") else {
        return;
    };
    let (camera, poses) = acfr(&folder);
    let halves: [fn(usize) -> bool; 4] = [|k| k < 5, |k| k >= 5, |k| k % 2 == 0, |k| k % 2 == 1];
    let config = LidarCameraConfig::default();
    let found = halves.map(|half| {
        let own = poses.iter().enumerate().filter(|(k, _)| half(*k));
        let own: Vec<BoardPose> = own.map(|(_, p)| p.clone()).collect();
        calibrate_lidar_camera(&ACFR_BOARD, "cam0", &camera, &own, &config, &no_progress)
            .expect("found")
    });
    for pair in found.chunks(2) {
        let mut said = Said::default();
        for half in pair {
            let off = pair[0].camera_from_lidar.inverse() * half.camera_from_lidar;
            for (k, value) in off.log().iter().enumerate() {
                said.put(format!("{k}"), *value, half.sigma[k]);
            }
        }
        said.assert_holds(&ACFR_BARS);
    }
}
