//! Device information: file 1 of selector 5.

use crate::WireError;

/// Bit of the request and of the answer's first byte.
const DEVICE_INFO: u8 = 1;
/// Bit of the request's first byte: read.
const READ: u8 = 0x80;
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
    pub const REQUEST: u8 = READ | DEVICE_INFO;

    /// Reads the answer; other files in it are passed over.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let Some((&[_, high, low], rest)) = bytes.split_first_chunk() else {
            return Err(WireError::Length {
                expected: 4,
                got: bytes.len(),
            });
        };
        let len = usize::from(u16::from_be_bytes([high, low]));
        let (Some(files), Some(&got)) = (rest.get(..len), rest.get(len)) else {
            return Err(WireError::Length {
                expected: len + 4,
                got: bytes.len(),
            });
        };
        let expected = files.iter().fold(0, |sum, byte| sum ^ byte);
        if got != expected {
            return Err(WireError::Checksum {
                expected: expected.into(),
                got: got.into(),
            });
        }
        let mut rest = files;
        while let Some((&[id, high, low], after)) = rest.split_first_chunk() {
            let len = usize::from(u16::from_be_bytes([high, low]));
            let Some((file, after)) = after.split_at_checked(len) else {
                return Err(WireError::Length {
                    expected: len,
                    got: after.len(),
                });
            };
            if id == DEVICE_INFO {
                return Self::parse_file(file);
            }
            rest = after;
        }
        Err(WireError::Value {
            field: "file mask",
            offset: 0,
            got: bytes.first().copied().unwrap_or_default().into(),
        })
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
        let mut files = vec![DEVICE_INFO];
        files.extend((INFO_BYTES as u16).to_be_bytes());
        files.extend(self.usb_vendor.to_be_bytes());
        files.extend(self.usb_product.to_be_bytes());
        files.extend(padded(&self.name, NAME_BYTES));
        files.extend(padded(&self.serial, SERIAL_BYTES));
        files.push(0);
        files.extend([self.spec.major, self.spec.minor]);
        for ids in [self.lens, self.imu] {
            files.extend(ids.iter().flat_map(|id| id.to_be_bytes()));
        }
        files.extend(self.baseline_mm.to_be_bytes());
        for version in [
            self.auxiliary_chip,
            self.image_processor,
            self.firmware,
            self.hardware,
        ] {
            files.extend([version.major, version.minor]);
        }
        files.push(self.hardware_flags);
        let checksum = files.iter().fold(0, |sum, byte| sum ^ byte);
        let mut out = vec![DEVICE_INFO];
        out.extend((files.len() as u16).to_be_bytes());
        out.extend(files);
        out.push(checksum);
        out
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
