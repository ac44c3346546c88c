//! Opening the unit.

use std::path::PathBuf;
use std::time::Duration;

use lsfb_types::Packet;

use super::model::{ENDPOINT_IN, INTERFACE, REPORT_LEN, USB_PRODUCT, USB_VENDOR};
use crate::Error;
use crate::transport::PacketSource;
use crate::transport::usb::{UsbConfig, UsbSource};

/// Which unit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MyntDConfig {
    /// Its usbfs node, or the name that a udev rule gives it.
    pub path: PathBuf,
}

impl Default for MyntDConfig {
    /// The name that the udev rule gives.
    fn default() -> Self {
        Self {
            path: PathBuf::from("/dev/lsfb/imu_mynt_d"),
        }
    }
}

/// An open unit: yields reports for [`super::Decoder`]. It sends as soon as it has power.
#[derive(Debug)]
pub struct MyntDImu {
    reports: UsbSource,
}

impl MyntDImu {
    /// Opens the node, checks that it is such a unit, and takes it from the kernel's HID driver. Needs the feature
    /// `hardware`.
    pub fn open(config: &MyntDConfig) -> Result<Self, Error> {
        let reports = UsbSource::open(&UsbConfig {
            path: config.path.clone(),
            vendor: USB_VENDOR,
            product: USB_PRODUCT,
            interface: INTERFACE,
            endpoint_in: ENDPOINT_IN,
            longest: REPORT_LEN,
        })?;
        Ok(Self { reports })
    }
}

impl PacketSource for MyntDImu {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        self.reports.recv(timeout)
    }
}
