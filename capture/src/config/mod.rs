//! Which devices are recorded: `devices.toml`.

mod lidar;

use std::collections::BTreeSet;
use std::marker::PhantomData;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use lsfb_drivers::ImuFamily;
use lsfb_drivers::mynt_s::{self, CameraConfig, Exposure, StampInstant};
use lsfb_drivers::transport::uvc::FrameFormat;
use lsfb_geometry::MAIN_IMU;
use lsfb_recording::{Compression, Durability, Existing};
use lsfb_types::Bounds;
use serde::de::value::MapAccessDeserializer;
use serde::de::{MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::Error;

pub use lidar::{LidarNetConfig, LidarSettingsConfig};

/// What happens to a message when the writer's queue is full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Overflow {
    /// It is dropped and counted: no device ever waits for the disk.
    #[default]
    Drop,
    /// Its device waits: for sources that can (simulated devices, capture files).
    Wait,
}

/// The devices of one recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DevicesConfig {
    /// Rig file, attached to the recording; relative to the file that names it.
    pub rig: Option<PathBuf>,
    /// What happens when the disk cannot keep up.
    pub overflow: Overflow,
    /// Files, disks, queue.
    pub recorder: RecorderConfig,
    /// LiDARs; one alone may be written `[lidar]`, several are `[[lidar]]`.
    #[serde(rename = "lidar", deserialize_with = "one_or_many")]
    pub lidars: Vec<LidarNetConfig>,
    /// Mynt units: together they form the camera group.
    #[serde(rename = "camera")]
    pub cameras: Vec<CameraUnitConfig>,
    /// IMUs; one alone may be written `[imu]`, several are `[[imu]]`.
    #[serde(rename = "imu", deserialize_with = "one_or_many")]
    pub imus: Vec<ImuLineConfig>,
    /// Phones and glasses.
    pub sidecar: Option<SidecarConfig>,
}

/// Reads one table, or an array of them.
fn one_or_many<'de, D, T>(deserializer: D) -> Result<Vec<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct Tables<T>(PhantomData<T>);

    impl<'de, T: Deserialize<'de>> Visitor<'de> for Tables<T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str("a table or an array of tables")
        }

        fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
            T::deserialize(MapAccessDeserializer::new(map)).map(|one| vec![one])
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
            let mut many = Vec::new();
            while let Some(next) = seq.next_element()? {
                many.push(next);
            }
            Ok(many)
        }
    }
    deserializer.deserialize_any(Tables(PhantomData))
}

/// What is kept of a LiDAR.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LidarData {
    /// Packets as received, and the clouds made of them.
    #[default]
    Both,
    /// Packets alone: less on the disk, and clouds are made of them again when the recording is replayed.
    Packets,
    /// Clouds alone: firings without an echo are gone.
    Clouds,
}

/// How recordings are kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecorderConfig {
    /// Compression of the chunks.
    pub compression: Compression,
    /// What the recording survives while it is being written; the disk is at most a second or two behind in any case.
    pub durability: Durability,
    /// What happens to a recording of the same name.
    pub existing: Existing,
    /// What is kept of LiDARs.
    pub lidar_data: LidarData,
    /// Largest size of a chunk before compression, bytes.
    pub chunk_bytes: u64,
    /// A new file after this many bytes; 0 never.
    pub split_bytes: u64,
    /// A new file after this many seconds; 0 never.
    pub split_secs: f64,
    /// Folder on another disk, to go on with when the first is nearly full; relative to the file that names it.
    pub second_folder: Option<PathBuf>,
    /// A disk with less room than this is full, bytes: enough to close a recording.
    pub reserve_bytes: u64,
    /// A recording is not begun with room for less than this, seconds; 0 begins in any case.
    pub least_space_secs: f64,
    /// Bytes per second to reckon with before the first are written; 0 takes what the devices send at most.
    pub expected_bytes_per_sec: f64,
    /// Memory between the devices and the disk, bytes.
    pub queue_bytes: u64,
}

impl Default for RecorderConfig {
    /// One file, `lz4`, room for ten minutes, some seconds of the whole rig in memory.
    fn default() -> Self {
        Self {
            compression: Compression::default(),
            durability: Durability::default(),
            existing: Existing::Refuse,
            lidar_data: LidarData::Both,
            chunk_bytes: 4 << 20,
            split_bytes: 0,
            split_secs: 0.0,
            second_folder: None,
            reserve_bytes: 256 << 20,
            least_space_secs: 600.0,
            expected_bytes_per_sec: 0.0,
            queue_bytes: 384 << 20,
        }
    }
}

lsfb_types::bounds! {
    RecorderConfig {
        compression: any,
        durability: any,
        existing: any,
        lidar_data: any,
        chunk_bytes: number(Bounds::AT_LEAST_ONE),
        split_bytes: any,
        split_secs: number(Bounds::NOT_NEGATIVE),
        second_folder: any,
        reserve_bytes: any,
        least_space_secs: number(Bounds::NOT_NEGATIVE),
        expected_bytes_per_sec: number(Bounds::NOT_NEGATIVE),
        queue_bytes: number(Bounds::AT_LEAST_ONE),
    }
}

/// One Mynt unit: a stereo unit, or one of any number of cameras whose images lie side by side in its frames.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraUnitConfig {
    /// Its capture node, or the socket of a mock unit.
    pub path: PathBuf,
    /// Serial number it must have; empty accepts any.
    #[serde(default)]
    pub serial: String,
    /// Names of its cameras in the rig, left to right.
    pub names: Vec<String>,
    /// Size of a frame with all images, pixels: of a stereo unit `[1280, 400]` or `[2560, 800]`.
    #[serde(default = "CameraUnitConfig::default_frame")]
    pub frame_px: [u32; 2],
    /// Frames per second.
    #[serde(default = "CameraUnitConfig::default_rate")]
    pub rate_hz: u32,
    /// Name of the unit's own IMU in the recording, as `imu1`; without a name it is not asked.
    #[serde(default)]
    pub imu: Option<String>,
    /// Which instant of the exposure its stamps mark.
    #[serde(default)]
    pub stamp: StampInstant,
    /// Exposure time and gain; what is set is read back.
    #[serde(default)]
    pub exposure: Exposure,
}

lsfb_types::bounds! {
    CameraUnitConfig {
        path: any,
        serial: any,
        names: any,
        frame_px: each(Bounds::AT_LEAST_ONE),
        rate_hz: number(Bounds::AT_LEAST_ONE),
        imu: any,
        stamp: any,
        exposure: any,
    }
}

impl CameraUnitConfig {
    /// A stereo unit of 640×400 at 10 Hz with the factory's settings.
    pub fn stereo(path: PathBuf, names: [String; 2]) -> Self {
        Self {
            path,
            serial: String::new(),
            names: names.to_vec(),
            frame_px: Self::default_frame(),
            rate_hz: Self::default_rate(),
            imu: None,
            stamp: StampInstant::default(),
            exposure: Exposure::default(),
        }
    }

    fn default_frame() -> [u32; 2] {
        [1280, 400]
    }

    fn default_rate() -> u32 {
        10
    }

    pub(crate) fn format(&self) -> FrameFormat {
        FrameFormat {
            width: self.frame_px[0],
            height: self.frame_px[1],
        }
    }

    /// What the driver opens.
    pub(crate) fn open(&self) -> CameraConfig {
        CameraConfig {
            path: self.path.clone(),
            serial: self.serial.clone(),
            format: self.format(),
            rate_hz: self.rate_hz,
            options: Vec::new(),
            exposure: self.exposure,
        }
    }

    /// How its frames are read.
    pub(crate) fn decoder(&self) -> mynt_s::DecoderConfig {
        mynt_s::DecoderConfig {
            format: self.format(),
            cameras: self.names.len() as u32,
            stamp: self.stamp,
            ..mynt_s::DecoderConfig::default()
        }
    }
}

/// An IMU on a line or bus of its own.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuLineConfig {
    /// Its name in the recording and in the rig.
    #[serde(default = "ImuLineConfig::default_name")]
    pub name: String,
    /// What it speaks.
    #[serde(default)]
    pub family: ImuFamily,
    /// The serial line, the usbfs node, or the name of the CAN interface.
    pub path: PathBuf,
    /// Speed of a serial line, baud.
    #[serde(default = "ImuLineConfig::default_baud")]
    pub baud: u32,
    /// Samples per second, of units that are told on a serial line.
    #[serde(default = "ImuLineConfig::default_rate")]
    pub rate_hz: u16,
}

lsfb_types::bounds! {
    ImuLineConfig {
        name: any,
        family: any,
        path: any,
        baud: number(Bounds::NOT_NEGATIVE),
        rate_hz: number(Bounds::AT_LEAST_ONE),
    }
}

impl ImuLineConfig {
    fn default_name() -> String {
        MAIN_IMU.to_owned()
    }

    fn default_baud() -> u32 {
        lsfb_drivers::xsens::model::DEFAULT_BAUD
    }

    fn default_rate() -> u16 {
        200
    }
}

/// Where phones and glasses connect.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SidecarConfig {
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Folder of the rig's certificate and of the devices that are paired with it; made where it is not there.
    #[serde(default = "sidecar_folder")]
    pub folder: PathBuf,
    /// How long a device that was lost is waited for where nothing else is recorded, seconds.
    #[serde(default = "come_back_secs")]
    pub come_back_secs: u32,
}

fn sidecar_folder() -> PathBuf {
    PathBuf::from("sidecar")
}

fn come_back_secs() -> u32 {
    120
}

impl SidecarConfig {
    /// Listens there, and knows devices by this folder.
    pub fn new(listen: SocketAddr, folder: PathBuf) -> Self {
        Self {
            listen,
            folder,
            come_back_secs: come_back_secs(),
        }
    }
}

lsfb_types::bounds! {
    DevicesConfig {
        rig: any,
        overflow: any,
        recorder: section,
        lidars: sections,
        cameras: sections,
        imus: sections,
        sidecar: any,
    }
}

impl DevicesConfig {
    /// Reads `devices.toml`; relative paths in it start at its folder.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path).map_err(|cause| Error::Io {
            path: path.to_owned(),
            cause,
        })?;
        let mut config: Self = toml::from_str(&text).map_err(|e| Error::Config {
            path: path.to_owned(),
            message: lsfb_geometry::toml_problem(&text, &e),
        })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        if let Some(rig) = &mut config.rig {
            *rig = folder.join(&*rig);
        }
        for camera in &mut config.cameras {
            camera.path = folder.join(&camera.path);
        }
        if let Some(second) = &mut config.recorder.second_folder {
            *second = folder.join(&*second);
        }
        if let Some(sidecar) = &mut config.sidecar {
            sidecar.folder = folder.join(&sidecar.folder);
        }
        // A CAN interface is no file.
        for imu in config
            .imus
            .iter_mut()
            .filter(|imu| imu.family != ImuFamily::Sbg)
        {
            imu.path = folder.join(&imu.path);
        }
        for angles in config
            .lidars
            .iter_mut()
            .filter_map(|lidar| lidar.angles.as_mut())
        {
            *angles = folder.join(&*angles);
        }
        Ok(config)
    }

    /// Refuses settings outside their bounds, cameras that cannot be told apart, and images that do not fill a frame.
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.check_bounds("")?;
        for lidar in &self.lidars {
            lidar.check_settings()?;
        }
        let mut known = BTreeSet::new();
        for unit in &self.cameras {
            let names = unit.names.join(", ");
            let problem = if unit.format().image_width(unit.names.len() as u32).is_none() {
                let [width, height] = unit.frame_px;
                let count = unit.names.len();
                format!("{count} images do not fill a frame of {width}x{height}")
            } else if let Some(name) = unit.names.iter().find(|n| !known.insert(n.as_str())) {
                format!("{name} is there twice")
            } else {
                continue;
            };
            return Err(Error::Cameras { names, problem });
        }
        self.check_names()
    }

    /// Refuses devices of one name, names that are no parts of topics, and LiDARs that would take each other's packets.
    fn check_names(&self) -> Result<(), Error> {
        let units = self.cameras.iter();
        let inside = units.flat_map(|unit| unit.names.iter().chain(&unit.imu));
        let lidars = self.lidars.iter().map(|lidar| &lidar.name);
        let names = inside
            .chain(lidars)
            .chain(self.imus.iter().map(|imu| &imu.name));
        check_device_names(names)?;
        for (index, lidar) in self.lidars.iter().enumerate() {
            let takes_same = |other: &&LidarNetConfig| {
                let has_own_address = lidar.sensor.is_some()
                    && other.sensor.is_some()
                    && lidar.sensor != other.sensor;
                lidar.shares_port_with(other) && !has_own_address
            };
            if let Some(other) = self.lidars[..index].iter().find(takes_same) {
                return Err(Error::LidarPorts {
                    first: other.name.clone(),
                    second: lidar.name.clone(),
                });
            }
        }
        Ok(())
    }

    /// What all devices together write at most, bytes per second, unless [`RecorderConfig::expected_bytes_per_sec`] says.
    pub fn expected_bytes_per_sec(&self) -> f64 {
        /// A VLP-32C with one return: 1.8 MB of packets and 13 MB of points, which compress to two thirds.
        const LIDAR: f64 = 10e6;
        /// Samples, counters and raw bytes, at 400 Hz.
        const IMU: f64 = 0.3e6;
        /// Glasses with one compressed video.
        const SIDECAR: f64 = 3e6;
        if self.recorder.expected_bytes_per_sec > 0.0 {
            return self.recorder.expected_bytes_per_sec;
        }
        let pixels = |c: &CameraUnitConfig| f64::from(c.frame_px[0]) * f64::from(c.frame_px[1]);
        let cameras: f64 = self
            .cameras
            .iter()
            .map(|c| pixels(c) * f64::from(c.rate_hz))
            .sum();
        let part = |there: bool, rate: f64| if there { rate } else { 0.0 };
        cameras
            + self.lidars.len() as f64 * LIDAR
            + self.imus.len() as f64 * IMU
            + part(self.sidecar.is_some(), SIDECAR)
    }

    /// The text of `devices.toml`.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }
}

/// Refuses two devices of one name, and names that are no parts of topics.
pub(crate) fn check_device_names<'a>(
    names: impl IntoIterator<Item = &'a String>,
) -> Result<(), Error> {
    let mut known = BTreeSet::new();
    for name in names {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let problem = if name.is_empty() || !name.chars().all(is_plain) {
            "a name is made of letters, digits and underscores"
        } else if !known.insert(name) {
            "two devices have this name"
        } else {
            continue;
        };
        return Err(Error::DeviceName {
            name: name.clone(),
            problem,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_its_own_text_and_names_what_it_does_not_know() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("devices.toml");
        let config = DevicesConfig {
            lidars: vec![LidarNetConfig::default()],
            cameras: vec![CameraUnitConfig {
                stamp: StampInstant::ExposureEnd,
                exposure: Exposure::Manual {
                    gain: 24,
                    exposure: 90,
                },
                ..CameraUnitConfig::stereo("/run/lsfb/front".into(), ["cam0".into(), "cam1".into()])
            }],
            ..DevicesConfig::default()
        };
        std::fs::write(&path, config.to_toml()).unwrap();
        assert_eq!(DevicesConfig::read(&path).unwrap(), config);
        std::fs::write(&path, "[lidar]\nrpm = 600\n").unwrap();
        let message = DevicesConfig::read(&path).unwrap_err().to_string();
        assert!(
            message.contains("devices.toml: line 2: ")
                && message.contains("rpm")
                && message.lines().count() == 1,
            "{message}"
        );
    }

    #[test]
    fn one_lidar_is_a_table_several_are_an_array_and_they_keep_apart() {
        let read = |text: &str| toml::from_str::<DevicesConfig>(text).unwrap();
        let one = read("[lidar]\nmodel = 'vlp-16'\n[imu]\npath = 'imu'\n");
        assert_eq!(
            (one.lidars.len(), one.lidars[0].name.as_str()),
            (1, "lidar")
        );
        assert_eq!((one.imus.len(), one.imus[0].name.as_str()), (1, "imu0"));
        let two = read(
            "[[lidar]]\n[[lidar]]\nname = 'lidar_rear'\ndata = '0.0.0.0:2369'\nposition = '0.0.0.0:8309'\n",
        );
        assert!(two.check_names().is_ok());
        assert_eq!(read(&two.to_toml()), two);
        let problem = |text: &str| read(text).check_names().unwrap_err().to_string();
        let message = problem("[[lidar]]\n[[lidar]]\nname = 'lidar_rear'\n");
        assert!(
            message.contains("lidar and lidar_rear listen on one port"),
            "{message}"
        );
        let told_apart = read(
            "[[lidar]]\nsensor = '192.168.1.201'\n[[lidar]]\nname = 'lidar_rear'\nsensor = '192.168.1.202'\n",
        );
        assert!(told_apart.check_names().is_ok());
        let message = problem(
            "[[lidar]]\nsensor = '192.168.1.201'\n[[lidar]]\nname = 'lidar_rear'\nsensor = '192.168.1.201'\n",
        );
        assert!(message.contains("listen on one port"), "{message}");
        let message = problem("[[lidar]]\n[[lidar]]\n");
        assert!(
            message.contains("lidar: two devices have this name"),
            "{message}"
        );
        let message = problem("[lidar]\nname = 'rear/left'\n");
        assert!(
            message.contains("letters, digits and underscores"),
            "{message}"
        );
    }

    #[test]
    fn numbers_of_a_lidar_outside_their_bounds_are_refused_by_name() {
        let refused = |text: &str| {
            let config: DevicesConfig = toml::from_str(text).unwrap();
            config.check().unwrap_err().to_string()
        };
        // A whole number of degrees that is not there saturated to 0, and an empty buffer lost every packet.
        for (setting, expected) in [
            ("cut_azimuth_deg = nan", "cut_azimuth_deg is NaN"),
            ("cut_azimuth_deg = 36000.0", "it must be -360 to 360"),
            ("receive_buffer_bytes = 0", "receive_buffer_bytes is 0"),
        ] {
            let message = refused(&format!("[lidar]\n{setting}\n"));
            assert!(message.contains(expected), "{message}");
        }
        let page = "[lidar.settings]\npage = '192.168.1.201:80'\n";
        for (setting, expected) in [
            ("rpm = 200", "settings.rpm is 200: it must be 300 to 1200"),
            ("rpm = 601", "lidar: rpm cannot be `601`"),
            (
                "field_of_view_deg = [0, 360]",
                "field of view cannot be `360`",
            ),
            ("phase_lock_centideg = 36000", "it must be 0 to 35999"),
        ] {
            let message = refused(&format!("{page}{setting}\n"));
            assert!(message.contains(expected), "{message}");
        }
        let good = format!("{page}rpm = 600\nfield_of_view_deg = [0, 359]\n");
        let config: DevicesConfig = toml::from_str(&good).unwrap();
        assert!(config.check().is_ok());
    }

    #[test]
    fn cameras_that_share_a_name_or_do_not_fill_a_frame_are_refused() {
        let with = |names: &[&[&str]]| DevicesConfig {
            cameras: names
                .iter()
                .map(|names| CameraUnitConfig {
                    names: names.iter().map(|n| (*n).to_owned()).collect(),
                    ..CameraUnitConfig::stereo(PathBuf::new(), Default::default())
                })
                .collect(),
            ..DevicesConfig::default()
        };
        for good in [
            &[&["cam0"][..], &["cam1"]][..],
            &[&["a", "b", "c", "d"], &["e", "f"]],
        ] {
            assert!(with(good).check().is_ok(), "{good:?}");
        }
        for (bad, expected) in [
            (&[&["cam0", "cam0"][..]][..], "cam0 is there twice"),
            (
                &[&["cam0", "cam1"], &["cam1", "cam2"]],
                "cam1 is there twice",
            ),
            (
                &[&["a", "b", "c"]],
                "3 images do not fill a frame of 1280x400",
            ),
            (&[&[]], "0 images"),
        ] {
            let message = with(bad).check().unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
