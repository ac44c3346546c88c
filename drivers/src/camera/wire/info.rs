//! Device information: file 1 of selector 5.

use super::files::UnitFile;
use crate::WireError;

/// Bytes of the file from spec version 1.3 on.
const INFO_BYTES: usize = 62;
const NAME_BYTES: usize = 16;
const SERIAL_BYTES: usize = 20;

/// Major and minor number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version {
    /// Major.
    pub major: u8,
    /// Minor.
    pub minor: u8,
}

/// What a unit says about itself (spec version 1.3 and later).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceInfo {
    /// USB vendor id.
    pub usb_vendor: u16,
    /// USB product id.
    pub usb_product: u16,
    /// Name, at most 16 characters.
    pub name: String,
    /// Serial number, at most 20 characters.
    pub serial: String,
    /// Version of these layouts.
    pub spec: Version,
    /// Lens: vendor, product.
    pub lens: [u16; 2],
    /// IMU: vendor, product.
    pub imu: [u16; 2],
    /// Distance of the two cameras, millimetres.
    pub baseline_mm: u16,
    /// Auxiliary chip.
    pub auxiliary_chip: Version,
    /// Image signal processor.
    pub image_processor: Version,
    /// Firmware.
    pub firmware: Version,
    /// Hardware.
    pub hardware: Version,
    /// Hardware flags.
    pub hardware_flags: u8,
}

impl DeviceInfo {
    /// First bytes of the 2000-byte request; the rest is zero.
    pub const REQUEST: u8 = UnitFile::DeviceInfo.request();

    /// Reads the answer; other files in it are passed over.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        Self::parse_file(UnitFile::DeviceInfo.find(bytes)?)
    }

    fn parse_file(file: &[u8]) -> Result<Self, WireError> {
        let file: &[u8; INFO_BYTES] = file.try_into().map_err(|_| WireError::Length {
            expected: INFO_BYTES,
            got: file.len(),
        })?;
        let word = |at: usize| u16::from_be_bytes([file[at], file[at + 1]]);
        let version = |at: usize| Version {
            major: file[at],
            minor: file[at + 1],
        };
        Ok(Self {
            usb_vendor: word(0),
            usb_product: word(2),
            name: text(&file[4..4 + NAME_BYTES]),
            serial: text(&file[20..20 + SERIAL_BYTES]),
            // Byte 40 is reserved.
            spec: version(41),
            lens: [word(43), word(45)],
            imu: [word(47), word(49)],
            baseline_mm: word(51),
            auxiliary_chip: version(53),
            image_processor: version(55),
            firmware: version(57),
            hardware: version(59),
            hardware_flags: file[61],
        })
    }

    /// The answer's bytes, without the don't-care bytes up to 2000. Text longer than its field is cut.
    pub fn emit(&self) -> Vec<u8> {
        let mut file = Vec::with_capacity(INFO_BYTES);
        file.extend(self.usb_vendor.to_be_bytes());
        file.extend(self.usb_product.to_be_bytes());
        file.extend(padded(&self.name, NAME_BYTES));
        file.extend(padded(&self.serial, SERIAL_BYTES));
        file.push(0);
        file.extend([self.spec.major, self.spec.minor]);
        for ids in [self.lens, self.imu] {
            file.extend(ids.iter().flat_map(|id| id.to_be_bytes()));
        }
        file.extend(self.baseline_mm.to_be_bytes());
        for version in [
            self.auxiliary_chip,
            self.image_processor,
            self.firmware,
            self.hardware,
        ] {
            file.extend([version.major, version.minor]);
        }
        file.push(self.hardware_flags);
        // It always fits.
        UnitFile::DeviceInfo.emit(&file).unwrap_or_default()
    }
}

/// Text padded with spaces, or by some firmware with zeros.
fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes)
        .trim_end_matches(['\0', ' '])
        .to_owned()
}

fn padded(text: &str, len: usize) -> impl Iterator<Item = u8> {
    text.bytes().chain(std::iter::repeat(b' ')).take(len)
}
