//! Opening and configuring a unit.

use std::path::PathBuf;
use std::time::Duration;

use lsfb_types::Packet;

use super::model::FrameFormat;
use super::wire::{
    CameraOption, DeviceInfo, ImuProtocol, ImuRequest, OptionCommand, Version, XuQuery, XuSelector,
};
use crate::transport::camera_link::{CameraLink, LinkCounters};
use crate::transport::{PacketSource, arrival_now};
use crate::{Error, WireError};

/// First spec version whose IMU sends floats.
const FLOAT_IMU_SPEC: Version = Version { major: 1, minor: 3 };

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
        }
    }
}

/// A configured, streaming unit: yields frames for [`super::Decoder`].
#[derive(Debug)]
pub struct MyntCamera {
    link: CameraLink,
    info: DeviceInfo,
}

impl MyntCamera {
    /// Connects, checks the serial number, sets options and reads them back, and starts the stream.
    pub fn open(config: &CameraConfig) -> Result<Self, Error> {
        let mut link = CameraLink::open(&config.path)?;
        let info = read_info(&mut link)?;
        if !config.serial.is_empty() && config.serial != info.serial {
            return Err(Error::Protocol {
                device: link.device().to_owned(),
                problem: format!(
                    "unit {} is here where {} is configured; are the cables swapped?",
                    info.serial, config.serial
                ),
            });
        }
        for &(option, value) in &config.options {
            link.xu_set(
                XuSelector::CamCtrl,
                &OptionCommand::Set { option, value }.emit(),
            )?;
            let got = read_option(&mut link, option)?;
            if got != value {
                return Err(Error::Protocol {
                    device: link.device().to_owned(),
                    problem: format!("{option:?} was set to {value} and reads {got}"),
                });
            }
        }
        link.start(config.format, config.rate_hz)?;
        Ok(Self { link, info })
    }

    /// What the unit says about itself.
    pub fn info(&self) -> &DeviceInfo {
        &self.info
    }

    /// What the link has met so far.
    pub fn link_counters(&self) -> LinkCounters {
        self.link.counters()
    }

    /// Current value of an option.
    pub fn option(&mut self, option: CameraOption) -> Result<u16, Error> {
        read_option(&mut self.link, option)
    }

    /// Layout of the unit's IMU segments.
    pub fn imu_protocol(&self) -> ImuProtocol {
        if self.info.spec < FLOAT_IMU_SPEC {
            ImuProtocol::Integer
        } else {
            ImuProtocol::Float
        }
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

fn read_info(link: &mut CameraLink) -> Result<DeviceInfo, Error> {
    let mut request = vec![0; XuSelector::File.len_bytes()];
    if let Some(first) = request.first_mut() {
        *first = DeviceInfo::REQUEST;
    }
    link.xu_set(XuSelector::File, &request)?;
    let answer = link.xu_get(XuSelector::File, XuQuery::GetCur)?;
    DeviceInfo::parse(&answer).map_err(|e| garbled(link, "device information", e))
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
