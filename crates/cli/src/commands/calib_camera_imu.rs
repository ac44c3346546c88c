//! `lsfb calib camera-imu`: views of a board and an IMU → poses and clocks of cameras on the IMU.

use std::path::PathBuf;

use anyhow::Context as _;
use lsfb_calib::camera_imu::{
    CameraImuCalibration, CameraImuConfig, KnownCamera, calibrate_camera_imu,
};
use lsfb_calib::exchange::{ChainOrigin, camera_chain};
use lsfb_calib::joint::IMU;
use lsfb_geometry::{Rig, Se3};
use lsfb_recording::{Provenance, write_tum};
use lsfb_types::Verdict;

use super::calib_board::BoardArguments;
use super::calib_input::{Source, add_input, calibrated_unix_s, imu_of, name_of_camera, views_of};
use super::calib_result::{Calibrated, Results, write_transforms};
use super::write;
use crate::context::Context;
use crate::outcome::Outcome;
use crate::pages;

/// Calibrate the cameras' poses and clocks relative to the IMU, from a walk in front of a board.
///
/// The rig must hold the lenses, the cameras' poses relative to each other (`lsfb calib camera`) and
/// the noise of the IMU. Images in folders are named by their stamps in nanoseconds. If the
/// reprojection error is larger than the noise of any detector, no rig is written, the page says why,
/// and the exit code is 4.
///
/// Examples:
///   lsfb calib camera-imu --target grid.yaml --rig rig.toml --recording scan.mcap --camera cam0 --camera cam1 --out rig2.toml
///   lsfb calib camera-imu --april-grid 6,6,0.088,0.3 --rig rig.toml --camera cam0=mav0/cam0/data --imu mav0/imu0/data.csv --out rig2.toml
///   lsfb calib camera-imu --target grid.yaml --rig rig.toml --recording ros.bag --camera cam0=/cam0/image_raw --imu /imu0 --out rig2.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(flatten)]
    board: BoardArguments,
    /// The rig to start from, with the noise of its IMU.
    #[arg(long, value_name = "TOML")]
    rig: PathBuf,
    /// A camera of the rig: NAME in the recording, NAME=TOPIC in a ROS bag, NAME=FOLDER, or NAME=FOLDER/PREFIX*; may be repeated. The
    /// first gives the initial guess.
    #[arg(long = "camera", required = true, value_name = "NAME[=FOLDER]")]
    cameras: Vec<String>,
    /// Recording with the IMU and the cameras given without a folder; or a ROS bag (.bag, .mcap, .db3, or a rosbag2 folder).
    #[arg(long, value_name = "MCAP")]
    recording: Option<PathBuf>,
    /// IMU table (EuRoC: ns, rad/s, m/s²) instead of the recording's IMU; or its topic in a bag.
    #[arg(long, value_name = "CSV|TOPIC")]
    imu: Option<PathBuf>,
    /// The rig to write; a page with plots and the transforms for `lsfb calib joint` are written beside it.
    #[arg(long, value_name = "TOML")]
    out: PathBuf,
    /// Also write Kalibr's camera chain with the IMU.
    #[arg(long, value_name = "YAML")]
    out_kalibr: Option<PathBuf>,
    /// Also write the trajectory of the rig in the board's frame, 200 poses per second.
    #[arg(long, value_name = "TUM")]
    out_trajectory: Option<PathBuf>,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

/// Calibrates, writes the rig, prints the report.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let target = arguments.board.target()?;
    let pairs: Vec<[&str; 2]> = arguments
        .cameras
        .iter()
        .map(|c| [IMU, name_of_camera(c)])
        .collect();
    let results = Results {
        out: &arguments.out,
        transforms: &pairs,
        others: &[
            arguments.out_kalibr.as_deref(),
            arguments.out_trajectory.as_deref(),
        ],
        rig: Some(&arguments.rig),
        read: [&arguments.recording, &arguments.imu]
            .into_iter()
            .flatten()
            .map(PathBuf::as_path)
            .collect(),
    };
    results.claim(context)?;
    let config: CameraImuConfig = match &arguments.config {
        Some(path) => super::read_config(path)?,
        None => CameraImuConfig::default(),
    };
    let mut rig = Rig::read(&arguments.rig)?;
    let noise = rig.imu_noise().cloned().with_context(|| {
        format!(
            "{rig} has no [imu]: measure its noise (`lsfb calib imu-noise --rig {rig} --out-rig {rig}`), or import \
             Kalibr's file (`lsfb calib import kalibr imu.yaml --rig {rig} --out {rig}`)",
            rig = arguments.rig.display()
        )
    })?;
    let mut provenance = Provenance::new(&config);
    provenance.add_input(&arguments.rig)?;
    let cameras: Vec<&str> = arguments.cameras.iter().map(String::as_str).collect();
    let recording = match &arguments.recording {
        Some(path) => {
            add_input(&mut provenance, path)?;
            Some(Source::open(path, &cameras, context)?)
        }
        None => None,
    };
    if let Some(path) = arguments.imu.as_deref().filter(|p| p.is_file()) {
        provenance.add_input(path)?;
    }
    let imu = imu_of(arguments.imu.as_deref(), recording.as_ref(), context)?;
    let mut known: Vec<KnownCamera> = Vec::with_capacity(arguments.cameras.len());
    let mut rig_from_first = Se3::identity();
    for camera in &arguments.cameras {
        let views = views_of(camera, recording.as_ref(), &target, context)?;
        let mounted = rig
            .cameras
            .get(&views.name)
            .with_context(|| format!("{} has no camera {}", arguments.rig.display(), views.name))?;
        if known.is_empty() {
            rig_from_first = mounted.rig_from_camera;
        }
        known.push(KnownCamera {
            camera: mounted.camera,
            camera_from_first: mounted.rig_from_camera.inverse() * rig_from_first,
            readout_s: mounted.timing.readout_s,
            views,
        });
    }
    let show = |p| context.show(p);
    let mut calibration = calibrate_camera_imu(&target, &known, &imu, &noise, &config, &show)?;
    calibration.compare_with(&rig);
    calibration.put_into(&mut rig);
    let stamps_ns = imu.iter().map(|(time, _)| time.nanos());
    rig.calibrated_unix_s = calibrated_unix_s(recording.as_ref(), stamps_ns)?;
    let page = arguments.out.with_extension("html");
    pages::write(
        &page,
        calibration.page("Camera–IMU calibration"),
        &provenance,
    )?;
    let mut transforms = Vec::new();
    let judgement = calibration.judgement();
    if judgement.verdict() != Verdict::Fail {
        write(&arguments.out, rig.to_toml())?;
        transforms = write_transforms(&arguments.out, &calibration.edges())?;
        if let Some(path) = &arguments.out_kalibr {
            let names = calibration.cameras.iter().map(|c| c.name.as_str());
            write(path, camera_chain(&rig, names, ChainOrigin::Imu))?;
        }
        if let Some(path) = &arguments.out_trajectory {
            write_tum(path, &calibration.motion.trajectory(INTERVAL_S))?;
        }
        provenance.write(&arguments.out)?;
    }
    let result = Calibrated {
        judgement: &judgement,
        summary: calibration.summary(),
        out: &arguments.out,
        page: &page,
        transforms: &transforms,
        calibration: &calibration,
    };
    result.print(context, || summary(&calibration))
}

/// Time between poses of the trajectory, seconds.
const INTERVAL_S: f64 = 0.005;

fn summary(calibration: &CameraImuCalibration) -> String {
    let mut text = String::new();
    for c in &calibration.cameras {
        let t = c.camera_from_rig.inverse().translation * 1e3;
        let s = c.position_sigma_m.map(|s| s * 1e3);
        let worst_turn = c.rotation_sigma_rad.iter().copied().fold(0.0, f64::max);
        text += &format!(
            "\n  {}: {:.3} px rms over {} corners, {} outliers; clock {:+.3} ± {:.3} ms; position on the IMU {:.1} {:.1} {:.1} ± {:.1} {:.1} {:.1} mm, rotation ± {:.3}°",
            c.name,
            c.rms_px,
            c.corners,
            c.outliers,
            c.rig_from_camera_s * 1e3,
            c.rig_from_camera_sigma_s * 1e3,
            t.x,
            t.y,
            t.z,
            s[0],
            s[1],
            s[2],
            worst_turn.to_degrees()
        );
    }
    if calibration.board_is_measured {
        text += &format!(
            "\n  board: {:+.2} ± {:.2} % larger than specified, according to the accelerometer",
            calibration.board_excess * 100.0,
            calibration.board_excess_sigma * 100.0
        );
    }
    text
}
