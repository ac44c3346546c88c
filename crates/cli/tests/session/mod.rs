//! Simulated walks written straight to files, whole or without a sensor.

use std::path::Path;

use lsfb_geometry::Rig;
use lsfb_recording::{Writer, WriterConfig};
use lsfb_sim::{RigSim, SimConfig, World};
use lsfb_types::{Image, ImuSample, LidarScan, Stamped};

/// Half the resolution of the demo, for a few seconds.
pub fn config(seed: u64) -> SimConfig {
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
pub struct Measured {
    rig: Rig,
    imu: Vec<Stamped<ImuSample>>,
    images: Vec<(String, Stamped<Image>)>,
    scans: Vec<Stamped<LidarScan>>,
}

impl Measured {
    pub fn by(rig: &RigSim, world: &World) -> Self {
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
            scans: if rig.rig().lidar.is_some() {
                scans.collect()
            } else {
                Vec::new()
            },
        }
    }

    /// Writes a recording; `without` names sensors as they are named there: `imu0`, `cam2`, `lidar`, and `rig` for the
    /// attachment.
    pub fn write(&self, path: &Path, without: &[&str]) {
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
                    writer.write_scan(scan).expect("scan");
                }
            }
            if has(camera) {
                writer.write_image(camera, image).expect("image");
            }
        }
        writer.finish().expect("recording");
    }
}
