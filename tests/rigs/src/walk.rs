//! Simulated walks with the backpack, written straight to files: the cameras that are asked for, the LiDAR and the IMU.

use std::path::Path;

use lsfb_geometry::Rig;
use lsfb_recording::{Writer, WriterConfig};
use lsfb_sim::{SimConfig, Simulation};
use lsfb_types::{Image, ImuSample, LidarScan, Stamped, no_progress};

/// Everything a rig measured.
#[derive(Clone)]
pub struct Walk {
    /// The rig as it is, with the cameras that were asked for.
    pub rig: Rig,
    imu: Vec<Stamped<ImuSample>>,
    /// Images with the names of their cameras.
    pub images: Vec<(String, Stamped<Image>)>,
    /// Scans of the LiDAR.
    pub scans: Vec<Stamped<LidarScan>>,
}

impl Walk {
    /// The first seconds of the scan of a simulation.
    pub fn simulate(config: &SimConfig, cameras: &[&str], seconds: f64) -> Self {
        let simulation = Simulation::new(config, &no_progress).expect("simulation");
        let (scan, world) = (simulation.scan(), simulation.world());
        let end_ns = (seconds * 1e9) as i64;
        let numbered: Vec<(usize, &String)> = scan
            .rig()
            .cameras
            .keys()
            .enumerate()
            .filter(|(_, name)| cameras.contains(&name.as_str()))
            .collect();
        let frames = (0..scan.frame_count()).filter(|f| scan.frame_offset_ns(*f) < end_ns);
        let images = frames.flat_map(|frame| {
            numbered.iter().filter_map(move |(number, name)| {
                Some(((*name).clone(), scan.image(world, *number, frame)?))
            })
        });
        let revolutions = (seconds * 10.0) as u32;
        let imu = scan.imu().iter().filter(|s| s.offset_ns < end_ns).map(|s| {
            let time = scan.time(s.offset_ns);
            Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: s.sample,
            }
        });
        let mut rig = scan.rig().clone();
        rig.cameras
            .retain(|name, _| cameras.contains(&name.as_str()));
        Self {
            rig,
            imu: imu.collect(),
            images: images.collect(),
            scans: (0..revolutions.min(scan.revolution_count()))
                .filter_map(|k| scan.scan(world, k))
                .collect(),
        }
    }

    /// Writes a recording in which images are stamped late.
    pub fn write(&self, path: &Path, images_late_s: f64) {
        let mut writer = Writer::create(path, &WriterConfig::default()).expect("recording");
        writer.attach_rig(&self.rig).expect("rig");
        let (mut imu, mut scans) = (self.imu.iter().peekable(), self.scans.iter().peekable());
        for (camera, image) in &self.images {
            let mut image = image.clone();
            image.time = image.time.plus_secs(images_late_s);
            image.arrival = image.time;
            while let Some(sample) = imu.next_if(|s| s.time <= image.time) {
                writer.write_imu("imu0", sample).expect("sample");
            }
            while let Some(scan) = scans.next_if(|s| s.time <= image.time) {
                writer.write_scan("lidar", scan).expect("scan");
            }
            writer.write_image(camera, &image).expect("image");
        }
        for sample in imu {
            writer.write_imu("imu0", sample).expect("sample");
        }
        writer.finish().expect("recording");
    }
}
