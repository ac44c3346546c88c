//! Recordings in the layouts that SLAM systems read.

mod hidden;
mod sensors;

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write as _};
use std::path::{Path, PathBuf};

use lsfb_geometry::Rig;
use lsfb_perception::image::{Compression, Samples, write_png};
use lsfb_recording::{Recording, message};
use lsfb_types::{Image, Stamped, Timestamp};
use serde::{Deserialize, Serialize};

use crate::Error;
pub use hidden::HiddenRegions;

/// What a system reads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// The recording itself, a ROS 2 MCAP, or the folder that the plan names.
    #[default]
    AsIs,
    /// EuRoC ASL: `mav0/camN/data/<ns>.png`, `mav0/camN/data.csv`, `mav0/imu0/data.csv`, and in each folder `sensor.yaml`, where the
    /// recording has a rig with lenses that the format knows.
    Euroc,
    /// TUM-VI: as EuRoC, and `dso/camN/times.txt`, `dso/imu.txt`.
    TumVi,
    /// KITTI odometry: `image_N/000000.png`, `velodyne/000000.bin`, `times.txt`; and with the stamps unshifted `stamps.txt` of the images
    /// and `velodyne_stamps.txt` of the scans, as scans need not come with images.
    Kitti,
    /// `camN/000000.png` and `camN/times.txt`, seconds.
    Images,
    /// `CAMERA/<ns>.png`, as images lie beside a COLMAP model or in a kapture.
    Stamped,
}

impl Layout {
    /// As folders are called.
    pub fn name(self) -> &'static str {
        match self {
            Self::AsIs => "as_is",
            Self::Euroc => "euroc",
            Self::TumVi => "tum_vi",
            Self::Kitti => "kitti",
            Self::Images => "images",
            Self::Stamped => "stamped",
        }
    }
}

/// Writes a recording in a layout, with its rig as `rig.toml` (for `lsfb calib export`). The folder is there whole, or not at all.
pub fn export(recording: &Recording, layout: Layout, folder: &Path) -> Result<(), Error> {
    export_without(recording, layout, &HiddenRegions::default(), folder)
}

/// The same without what must not be seen in its images. A region that is in no image is refused.
pub fn export_without(
    recording: &Recording,
    layout: Layout,
    hidden: &HiddenRegions,
    folder: &Path,
) -> Result<(), Error> {
    let io = |source| Error::Io {
        path: folder.to_owned(),
        source,
    };
    let half = folder.with_extension("part");
    if half.exists() {
        fs::remove_dir_all(&half).map_err(io)?;
    }
    fs::create_dir_all(&half).map_err(io)?;
    write(recording, layout, hidden, &half)?;
    hidden.expect_used()?;
    fs::rename(&half, folder).map_err(io)
}

fn write(
    recording: &Recording,
    layout: Layout,
    hidden: &HiddenRegions,
    folder: &Path,
) -> Result<(), Error> {
    let out = Output {
        folder: folder.to_owned(),
        hidden,
    };
    let rig = recording.rig().ok();
    if let Some(rig) = &rig {
        out.text("rig.toml", &rig.to_toml())?;
    }
    let cameras = cameras(recording);
    let names: Vec<&str> = cameras.iter().map(String::as_str).collect();
    match layout {
        Layout::AsIs => Ok(()),
        Layout::Euroc => euroc(recording, rig.as_ref(), &names, &out),
        Layout::TumVi => {
            euroc(recording, rig.as_ref(), &names, &out)?;
            dso(recording, &names, &out)
        }
        Layout::Kitti => kitti(recording, &names, &out),
        Layout::Images => images(recording, &names, &out),
        Layout::Stamped => stamped(recording, &names, &out),
    }
}

/// Image topics, by name.
fn cameras(recording: &Recording) -> Vec<String> {
    let topics = recording.topics().iter();
    let images = topics.filter(|t| t.schema == message::IMAGE.name && t.messages > 0);
    images.map(|t| t.topic.clone()).collect()
}

fn euroc(
    recording: &Recording,
    rig: Option<&Rig>,
    cameras: &[&str],
    out: &Output<'_>,
) -> Result<(), Error> {
    for (i, camera) in cameras.iter().enumerate() {
        let mut list = "#timestamp [ns],filename\n".to_owned();
        let mut times = Vec::new();
        for image in recording.images(camera)? {
            let image = image?;
            let name = format!("{}.png", image.time.nanos());
            let _ = writeln!(list, "{},{name}", image.time.nanos());
            out.png(&format!("mav0/cam{i}/data/{name}"), camera, &image)?;
            times.push(image.time);
        }
        out.text(&format!("mav0/cam{i}/data.csv"), &list)?;
        let name = camera_name(camera);
        if let Some(yaml) = rig.and_then(|rig| sensors::camera(rig, name, rate_hz(&times))) {
            out.text(&format!("mav0/cam{i}/sensor.yaml"), &yaml)?;
        }
    }
    let heading = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],\
         a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]";
    let (rows, times) = inertial(recording, heading, ",")?;
    out.text("mav0/imu0/data.csv", &rows)?;
    match rig.and_then(|rig| sensors::imu(rig, rate_hz(&times))) {
        Some(yaml) if !times.is_empty() => out.text("mav0/imu0/sensor.yaml", &yaml),
        _ => Ok(()),
    }
}

/// How often a sensor spoke, to a thousandth of a hertz; zero where that is not known.
fn rate_hz(times: &[Timestamp]) -> f64 {
    match times {
        [first, .., last] if last > first => {
            let rate_hz = (times.len() - 1) as f64 / last.secs_since(*first);
            (1000.0 * rate_hz).round() / 1000.0
        }
        _ => 0.0,
    }
}

fn dso(recording: &Recording, cameras: &[&str], out: &Output<'_>) -> Result<(), Error> {
    for (i, camera) in cameras.iter().enumerate() {
        let mut times = "# id timestamp[s] exposure[ms]\n".to_owned();
        for image in recording.images(camera)? {
            let image = image?;
            let exposure_ms = f64::from(image.sample.exposure_ns) * 1e-6;
            let _ = writeln!(times, "{} {} {exposure_ms}", image.time.nanos(), image.time);
        }
        out.text(&format!("dso/cam{i}/times.txt"), &times)?;
    }
    let heading = "# timestamp[ns] w.x w.y w.z a.x a.y a.z";
    out.text("dso/imu.txt", &inertial(recording, heading, " ")?.0)
}

fn kitti(recording: &Recording, cameras: &[&str], out: &Output<'_>) -> Result<(), Error> {
    let mut stamps = Vec::new();
    if !cameras.is_empty() {
        // An image of each camera in every row, or cameras slip against each other.
        let shared = shared_times(recording, cameras)?;
        for (i, camera) in cameras.iter().enumerate() {
            let mut row = 0;
            for image in recording.images(camera)? {
                let image = image?;
                if shared.contains(&image.time) {
                    out.png(&format!("image_{i}/{row:06}.png"), camera, &image)?;
                    row += 1;
                }
            }
        }
        stamps = shared.into_iter().collect();
    }
    let has_scans = recording
        .topics()
        .iter()
        .any(|t| t.schema == message::POINT_CLOUD.name);
    if has_scans {
        let mut of_scans = Vec::new();
        for scan in recording.scans()? {
            let scan = scan?;
            let mut bytes = Vec::with_capacity(16 * scan.sample.points.len());
            for point in &scan.sample.points {
                let [x, y, z] = point.position_m;
                let row = [x, y, z, f32::from(point.intensity) / 255.0];
                bytes.extend(row.into_iter().flat_map(f32::to_le_bytes));
            }
            out.bytes(&format!("velodyne/{:06}.bin", of_scans.len()), &bytes)?;
            of_scans.push(scan.time);
        }
        let absolute: String = of_scans.iter().map(|stamp| format!("{stamp}\n")).collect();
        out.text("velodyne_stamps.txt", &absolute)?;
        if stamps.is_empty() {
            stamps = of_scans;
        }
    }
    let first = stamps.first().copied().unwrap_or_default();
    let (mut times, mut absolute) = (String::new(), String::new());
    for stamp in stamps {
        let _ = writeln!(times, "{:.9}", stamp.secs_since(first));
        let _ = writeln!(absolute, "{stamp}");
    }
    out.text("times.txt", &times)?;
    out.text("stamps.txt", &absolute)
}

fn images(recording: &Recording, cameras: &[&str], out: &Output<'_>) -> Result<(), Error> {
    for (i, camera) in cameras.iter().enumerate() {
        let mut times = String::new();
        for (row, image) in recording.images(camera)?.enumerate() {
            let image = image?;
            let _ = writeln!(times, "{}", image.time);
            out.png(&format!("cam{i}/{row:06}.png"), camera, &image)?;
        }
        out.text(&format!("cam{i}/times.txt"), &times)?;
    }
    Ok(())
}

fn stamped(recording: &Recording, cameras: &[&str], out: &Output<'_>) -> Result<(), Error> {
    for camera in cameras {
        for image in recording.images(camera)? {
            let image = image?;
            let name = format!("{}/{}.png", camera_name(camera), image.time.nanos());
            out.png(&name, camera, &image)?;
        }
    }
    Ok(())
}

/// The name of a camera in its rig: `cam0` of `/sidecar/glasses/cam0/image`.
pub fn camera_name(topic: &str) -> &str {
    let of = topic.strip_suffix("/image").unwrap_or(topic);
    of.rsplit('/').next().unwrap_or(of)
}

fn shared_times(recording: &Recording, cameras: &[&str]) -> Result<BTreeSet<Timestamp>, Error> {
    let mut shared: Option<BTreeSet<Timestamp>> = None;
    for camera in cameras {
        let mut times = BTreeSet::new();
        for image in recording.images(camera)? {
            times.insert(image?.time);
        }
        shared = Some(match shared {
            Some(before) => before.intersection(&times).copied().collect(),
            None => times,
        });
    }
    Ok(shared.unwrap_or_default())
}

/// Below a heading: stamp, angular velocity, rad/s, and specific force, m/s². No row where there is no IMU.
fn inertial(
    recording: &Recording,
    heading: &str,
    separator: &str,
) -> Result<(String, Vec<Timestamp>), Error> {
    let (mut rows, mut times) = (format!("{heading}\n"), Vec::new());
    if recording
        .topics()
        .iter()
        .all(|t| t.schema != message::IMU.name)
    {
        return Ok((rows, times));
    }
    for sample in recording.imu()? {
        let sample = sample?;
        times.push(sample.time);
        rows += &sample.time.nanos().to_string();
        let (w, a) = (
            sample.sample.angular_velocity_rad_s,
            sample.sample.specific_force_m_s2,
        );
        for value in w.into_iter().chain(a) {
            let _ = write!(rows, "{separator}{value}");
        }
        rows.push('\n');
    }
    Ok((rows, times))
}

/// Where is written.
struct Output<'a> {
    folder: PathBuf,
    hidden: &'a HiddenRegions,
}

impl Output<'_> {
    fn place(&self, name: &str) -> Result<PathBuf, Error> {
        let path = self.folder.join(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(|source| Error::Io {
                path: parent.to_owned(),
                source,
            })?;
        }
        Ok(path)
    }

    fn bytes(&self, name: &str, bytes: &[u8]) -> Result<(), Error> {
        let path = self.place(name)?;
        fs::write(&path, bytes).map_err(|source| Error::Io { path, source })
    }

    fn text(&self, name: &str, text: &str) -> Result<(), Error> {
        self.bytes(name, text.as_bytes())
    }

    fn png(&self, name: &str, camera: &str, image: &Stamped<Image>) -> Result<(), Error> {
        let path = self.place(name)?;
        let image = self.hidden.hide(camera, image);
        let written = || -> Result<(), io::Error> {
            let mut file = BufWriter::new(File::create(&path)?);
            let size = (image.width, image.height);
            write_png(
                &mut file,
                size,
                Samples::Grey(&image.pixels),
                Compression::Fast,
            )?;
            file.flush()
        };
        written().map_err(|source| Error::Io { path, source })
    }
}

#[cfg(test)]
mod tests;
