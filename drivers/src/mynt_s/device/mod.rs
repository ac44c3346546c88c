//! Opening and configuring a unit.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use lsfb_types::Packet;

use super::wire::{
    CameraOption, DeviceInfo, ImageCalibration, ImuCalibration, ImuProtocol, ImuRequest,
    OptionCommand, UnitFile,
};
use crate::transport::camera_link::CameraLink;
use crate::transport::uvc::{FrameFormat, ImageControl, LinkCounters, XuQuery, XuSelector};
use crate::transport::{PacketSource, arrival_now};
use crate::{Error, WireError};

/// Who chooses exposure time and gain. What is set is read back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "kebab-case", tag = "mode", deny_unknown_fields)
)]
pub enum Exposure {
    /// As the unit is.
    #[default]
    Unchanged,
    /// The unit, within limits.
    Automatic {
        /// Largest gain.
        max_gain: u16,
        /// Longest exposure, steps of [`super::model::EXPOSURE_STEP_NS`].
        max_exposure_steps: u16,
        /// Mean grey value that it aims at.
        desired_brightness: u16,
    },
    /// Nobody: every frame alike.
    Manual {
        /// Gain.
        gain: u16,
        /// Exposure time, in the unit's steps of its brightness control.
        exposure: u16,
    },
}

/// Which unit, and what it shall do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraConfig {
    /// The unit's capture node (feature `hardware`), or the socket of a mock unit.
    pub path: PathBuf,
    /// Serial number that the unit at this place must have; empty accepts any.
    pub serial: String,
    /// Size of the frames.
    pub format: FrameFormat,
    /// Frames per second.
    pub rate_hz: u32,
    /// Options to be set before streaming, with their values.
    pub options: Vec<(CameraOption, u16)>,
    /// Who chooses exposure time and gain; set after the options.
    pub exposure: Exposure,
}

impl Default for CameraConfig {
    /// 1280×400 at 10 Hz, options left as they are, any serial number.
    fn default() -> Self {
        Self {
            path: PathBuf::from("/run/lsfb/mynt_front"),
            serial: String::new(),
            format: FrameFormat::S2_1280X400,
            rate_hz: 10,
            options: Vec::new(),
            exposure: Exposure::default(),
        }
    }
}

/// A configured, streaming unit: yields frames for [`super::Decoder`].
#[derive(Debug)]
pub struct MyntCamera {
    link: CameraLink,
    info: DeviceInfo,
    files: BTreeMap<UnitFile, Vec<u8>>,
}

impl MyntCamera {
    /// Connects, checks the serial number, reads the files that the unit keeps, sets options and reads them back, and starts
    /// the stream.
    pub fn open(config: &CameraConfig) -> Result<Self, Error> {
        let mut link = CameraLink::open(&config.path)?;
        let mut files = BTreeMap::from([(
            UnitFile::DeviceInfo,
            read_file(&mut link, UnitFile::DeviceInfo)?,
        )]);
        let info = parse_info(&link, &files)?;
        if !config.serial.is_empty() && config.serial != info.serial {
            return Err(Error::Protocol {
                device: link.device().to_owned(),
                problem: format!(
                    "found unit {}, but {} is configured; are the cables swapped?",
                    info.serial, config.serial
                ),
            });
        }
        files.extend(read_calibrations(&mut link)?);
        for &(option, value) in &config.options {
            set_option(&mut link, option, value)?;
        }
        set_exposure(&mut link, config.exposure)?;
        link.start(config.format, config.rate_hz)?;
        Ok(Self { link, info, files })
    }

    /// What the unit says about itself.
    pub fn info(&self) -> &DeviceInfo {
        &self.info
    }

    /// The unit's answers to requests for its files, as they came before the stream started; what it does not keep is absent.
    pub fn files(&self) -> &BTreeMap<UnitFile, Vec<u8>> {
        &self.files
    }

    /// What the link has met so far.
    pub fn link_counters(&self) -> LinkCounters {
        self.link.counters()
    }

    /// Current value of an option.
    pub fn option(&mut self, option: CameraOption) -> Result<u16, Error> {
        read_option(&mut self.link, option)
    }

    /// Current value of a control of the image sensors.
    pub fn control(&mut self, control: ImageControl) -> Result<i32, Error> {
        self.link.control_get(control)
    }

    /// The calibration of the cameras that the unit carries.
    pub fn image_calibration(&mut self) -> Result<ImageCalibration, Error> {
        let answer = read_file(&mut self.link, UnitFile::Images)?;
        let parsed = UnitFile::Images
            .find(&answer)
            .and_then(ImageCalibration::parse);
        parsed.map_err(|e| garbled(&self.link, "camera calibration", e))
    }

    /// The calibration of the IMU that the unit carries.
    pub fn imu_calibration(&mut self) -> Result<ImuCalibration, Error> {
        let answer = read_file(&mut self.link, UnitFile::Imu)?;
        let parsed = UnitFile::Imu.find(&answer).and_then(ImuCalibration::parse);
        parsed.map_err(|e| garbled(&self.link, "IMU calibration", e))
    }

    /// Layout of the unit's IMU segments.
    pub fn imu_protocol(&self) -> ImuProtocol {
        ImuProtocol::of_spec(self.info.spec)
    }

    /// Asks for the IMU segments since the last call, every 25 ms or so: an answer for [`super::ImuDecoder`].
    ///
    /// `last_serial`, protocol 1 only: the last segment that arrived safely, 0 at first; the unit repeats what follows.
    pub fn poll_imu(&mut self, last_serial: u32) -> Result<Packet, Error> {
        let request = match self.imu_protocol() {
            ImuProtocol::Integer => ImuRequest::After(last_serial),
            ImuProtocol::Float => ImuRequest::Single,
            ImuProtocol::FloatPaired => ImuRequest::Paired,
        };
        self.link.xu_set(XuSelector::ImuWrite, &request.emit())?;
        let bytes = self.link.xu_get(XuSelector::ImuRead, XuQuery::GetCur)?;
        Ok(Packet {
            arrival: arrival_now(),
            bytes,
        })
    }
}

impl PacketSource for MyntCamera {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        self.link.recv(timeout)
    }
}

fn parse_info(link: &CameraLink, files: &BTreeMap<UnitFile, Vec<u8>>) -> Result<DeviceInfo, Error> {
    let answer = files.get(&UnitFile::DeviceInfo);
    let parsed = DeviceInfo::parse(answer.map(Vec::as_slice).unwrap_or_default());
    parsed.map_err(|e| garbled(link, "device information", e))
}

/// A unit refuses a request for what it does not keep.
fn read_calibrations(link: &mut CameraLink) -> Result<BTreeMap<UnitFile, Vec<u8>>, Error> {
    let mut files = BTreeMap::new();
    for file in [UnitFile::Images, UnitFile::Imu] {
        match read_file(link, file) {
            Ok(answer) => {
                files.insert(file, answer);
            }
            Err(Error::Protocol { .. }) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(files)
}

fn read_file(link: &mut CameraLink, file: UnitFile) -> Result<Vec<u8>, Error> {
    let mut request = vec![0; XuSelector::File.len_bytes()];
    if let Some(first) = request.first_mut() {
        *first = file.request();
    }
    link.xu_set(XuSelector::File, &request)?;
    link.xu_get(XuSelector::File, XuQuery::GetCur)
}

fn set_option(link: &mut CameraLink, option: CameraOption, value: u16) -> Result<(), Error> {
    let command = OptionCommand::Set { option, value };
    link.xu_set(XuSelector::CamCtrl, &command.emit())?;
    let got = read_option(link, option)?;
    if got != value {
        return Err(Error::Protocol {
            device: link.device().to_owned(),
            problem: format!("{option:?} was set to {value} but reads {got}"),
        });
    }
    Ok(())
}

fn set_control(link: &mut CameraLink, control: ImageControl, value: u16) -> Result<(), Error> {
    link.control_set(control, value.into())?;
    let got = link.control_get(control)?;
    if got != i32::from(value) {
        return Err(Error::Protocol {
            device: link.device().to_owned(),
            problem: format!("{control:?} was set to {value} but reads {got}"),
        });
    }
    Ok(())
}

fn set_exposure(link: &mut CameraLink, exposure: Exposure) -> Result<(), Error> {
    const AUTOMATIC: u16 = 0;
    const MANUAL: u16 = 1;
    match exposure {
        Exposure::Unchanged => Ok(()),
        Exposure::Automatic {
            max_gain,
            max_exposure_steps,
            desired_brightness,
        } => {
            set_option(link, CameraOption::MaxGain, max_gain)?;
            set_option(link, CameraOption::MaxExposureTime, max_exposure_steps)?;
            set_option(link, CameraOption::DesiredBrightness, desired_brightness)?;
            set_option(link, CameraOption::ExposureMode, AUTOMATIC)
        }
        Exposure::Manual { gain, exposure } => {
            set_option(link, CameraOption::ExposureMode, MANUAL)?;
            set_control(link, ImageControl::Gain, gain)?;
            set_control(link, ImageControl::Brightness, exposure)
        }
    }
}

fn read_option(link: &mut CameraLink, option: CameraOption) -> Result<u16, Error> {
    link.xu_set(XuSelector::CamCtrl, &OptionCommand::Select(option).emit())?;
    let answer = link.xu_get(XuSelector::CamCtrl, XuQuery::GetCur)?;
    OptionCommand::parse_value(option, &answer).map_err(|e| garbled(link, "option", e))
}

fn garbled(link: &CameraLink, what: &str, error: WireError) -> Error {
    Error::Protocol {
        device: link.device().to_owned(),
        problem: format!("answer to the request for {what}: {error}"),
    }
}

#[cfg(test)]
mod tests;
