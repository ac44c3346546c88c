//! Simulated walks written straight to files, whole or without a sensor.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use lsfb_geometry::Rig;
use lsfb_recording::{Writer, WriterConfig};
use lsfb_sim::{RigSim, SimConfig, Simulation, World};
use lsfb_types::{Image, ImuSample, LidarScan, Stamped, no_progress};
use tempfile::TempDir;

use crate::process::lsfb;

/// Half the resolution of the demo, for a few seconds.
fn config(seed: u64) -> SimConfig {
    let mut config = SimConfig {
        seed,
        texel_m: 0.012,
        ..SimConfig::default()
    };
    (config.scan.duration_s, config.glasses.duration_s) = (5.0, 2.0);
    for walk in [&mut config.scan, &mut config.glasses] {
        walk.rest_s = 0.5;
    }
    for cameras in [&mut config.scan_cameras, &mut config.glasses_cameras] {
        (cameras.width, cameras.height) = (320, 200);
    }
    config
}

/// Everything a rig measures in a walk.
struct Measured {
    rig: Rig,
    imu: Vec<Stamped<ImuSample>>,
    images: Vec<(String, Stamped<Image>)>,
    scans: Vec<Stamped<LidarScan>>,
}

impl Measured {
    fn by(rig: &RigSim, world: &World) -> Self {
        let frames = 0..rig.frame_count();
        let images = frames.flat_map(|frame| {
            let cameras = rig.rig().cameras.keys().enumerate();
            cameras.filter_map(move |(camera, name)| {
                Some((name.clone(), rig.image(world, camera, frame)?))
            })
        });
        let scans =
            (0..rig.revolution_count()).filter_map(|revolution| rig.scan(world, revolution));
        let imu = rig.imu().iter().map(|s| {
            let time = rig.time(s.offset_ns);
            Stamped {
                time,
                arrival: time,
                device_ticks: (s.offset_ns / 100_000) as u64,
                sample: s.sample,
            }
        });
        Self {
            rig: rig.rig().clone(),
            imu: imu.collect(),
            images: images.collect(),
            scans: if rig.rig().lidar().is_some() {
                scans.collect()
            } else {
                Vec::new()
            },
        }
    }

    /// Writes a recording; `without` names sensors as they are named there: `imu0`, `cam2`, `lidar`, and `rig` for the
    /// attachment.
    fn write(&self, path: &Path, without: &[&str]) {
        let mut writer = Writer::create(path, &WriterConfig::default()).expect("recording");
        let has = |sensor: &str| !without.contains(&sensor);
        if has("rig") {
            writer.attach_rig(&self.rig).expect("rig");
        }
        let (mut imu, mut scans) = (self.imu.iter().peekable(), self.scans.iter().peekable());
        for (camera, image) in &self.images {
            while let Some(sample) = imu.next_if(|s| s.time <= image.time) {
                if has("imu0") {
                    writer.write_imu("imu0", sample).expect("sample");
                }
            }
            while let Some(scan) = scans.next_if(|s| s.time <= image.time) {
                if has("lidar") {
                    writer.write_scan("lidar", scan).expect("scan");
                }
            }
            if has(camera) {
                writer.write_image(camera, image).expect("image");
            }
        }
        writer.finish().expect("recording");
    }
}

/// A scan and a walk through one building, a walk through another, and the scan's map: made once for all tests.
pub fn inputs() -> &'static Path {
    static INPUTS: OnceLock<PathBuf> = OnceLock::new();
    INPUTS.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(env!("CARGO_CRATE_NAME"));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("folder");
        let here = Simulation::new(&config(1), &no_progress).expect("simulation");
        let scan = Measured::by(here.scan(), here.world());
        for (name, without) in [
            ("scan", ""),
            ("no-imu", "imu0"),
            ("no-cam2", "cam2"),
            ("no-lidar", "lidar"),
            ("no-rig", "rig"),
        ] {
            scan.write(&folder.join(name).with_extension("mcap"), &[without]);
        }
        let walk = Measured::by(here.glasses(), here.world());
        walk.write(&folder.join("walk.mcap"), &[]);
        walk.write(&folder.join("walk-no-imu.mcap"), &["imu0"]);
        let elsewhere = Simulation::new(&config(2), &no_progress).expect("simulation");
        Measured::by(elsewhere.glasses(), elsewhere.world())
            .write(&folder.join("elsewhere.mcap"), &[]);
        let output = lsfb(
            &folder,
            &[
                "map",
                "scan.mcap",
                "--out",
                "map",
                "--out-trajectory",
                "scan.tum",
            ],
        );
        assert!(output.status.success(), "{output:?}");
        folder
    })
}

/// A folder with copies of some of the inputs, files or folders.
pub fn with(names: &[&str]) -> TempDir {
    let folder = TempDir::new_in(env!("CARGO_TARGET_TMPDIR")).expect("folder");
    for name in names {
        let (from, to) = (inputs().join(name), folder.path().join(name));
        if from.is_dir() {
            std::fs::create_dir(&to).expect("folder");
            for entry in std::fs::read_dir(&from).expect("folder") {
                let entry = entry.expect("file");
                std::fs::copy(entry.path(), to.join(entry.file_name())).expect("copy");
            }
        } else {
            std::fs::copy(from, to).expect("copy");
        }
    }
    folder
}
