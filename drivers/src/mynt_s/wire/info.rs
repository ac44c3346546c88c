//! Device information: file 1 of selector 5.

use super::files::UnitFile;
use crate::WireError;

/// Bytes of the file from spec version 1.3 on.
const INFO_BYTES: usize = 62;
/// The same with spec version 1.2, and before.
const OLD_INFO_BYTES: usize = 53;
const OLDEST_INFO_BYTES: usize = 49;
const OLD_SERIAL_BYTES: usize = 16;
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

/// What a unit says about itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceInfo {
    /// USB vendor id; 0 before spec version 1.3, which does not tell.
    pub usb_vendor: u16,
    /// USB product id; 0 likewise.
    pub usb_product: u16,
    /// Name, at most 16 characters.
    pub name: String,
    /// Serial number, at most 20 characters; 16 before spec version 1.3.
    pub serial: String,
    /// Version of these layouts.
    pub spec: Version,
    /// Lens: vendor, product.
    pub lens: [u16; 2],
    /// IMU: vendor, product.
    pub imu: [u16; 2],
    /// Distance of the two cameras, millimetres.
    pub baseline_mm: u16,
    /// Auxiliary chip; from spec version 1.2 on.
    pub auxiliary_chip: Version,
    /// Image signal processor; from spec version 1.2 on.
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
        let layout = match file.len() {
            INFO_BYTES => Layout::Current,
            OLD_INFO_BYTES => Layout::Old,
            OLDEST_INFO_BYTES => Layout::Oldest,
            got => {
                return Err(WireError::Length {
                    expected: INFO_BYTES,
                    got,
                });
            }
        };
        let word = |at: usize| u16::from_be_bytes([file[at], file[at + 1]]);
        let version = |at: usize| Version {
            major: file[at],
            minor: file[at + 1],
        };
        let info = match layout {
            Layout::Current => Self {
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
            },
            Layout::Old | Layout::Oldest => Self {
                name: text(&file[..NAME_BYTES]),
                serial: text(&file[NAME_BYTES..NAME_BYTES + OLD_SERIAL_BYTES]),
                firmware: version(32),
                hardware: version(34),
                hardware_flags: file[36],
                spec: version(37),
                lens: [word(39), word(41)],
                imu: [word(43), word(45)],
                baseline_mm: word(47),
                ..Self::default()
            },
        };
        if Layout::of(info.spec) != layout {
            return Err(WireError::Value {
                field: "spec version of this layout",
                offset: if layout == Layout::Current { 41 } else { 37 },
                got: u16::from_be_bytes([info.spec.major, info.spec.minor]).into(),
            });
        }
        Ok(match layout {
            Layout::Old => Self {
                auxiliary_chip: version(49),
                image_processor: version(51),
                ..info
            },
            Layout::Current | Layout::Oldest => info,
        })
    }

    /// The answer's bytes, without the don't-care bytes up to 2000, in the layout of the spec version. Text longer than
    /// its field is cut; what an older layout lacks is left out.
    pub fn emit(&self) -> Vec<u8> {
        let layout = Layout::of(self.spec);
        let mut file = Vec::with_capacity(INFO_BYTES);
        if layout == Layout::Current {
            file.extend(self.usb_vendor.to_be_bytes());
            file.extend(self.usb_product.to_be_bytes());
            file.extend(padded(&self.name, NAME_BYTES));
            file.extend(padded(&self.serial, SERIAL_BYTES));
            file.push(0);
        } else {
            file.extend(padded(&self.name, NAME_BYTES));
            file.extend(padded(&self.serial, OLD_SERIAL_BYTES));
            put(&[self.firmware, self.hardware], &mut file);
            file.push(self.hardware_flags);
        }
        put(&[self.spec], &mut file);
        for ids in [self.lens, self.imu] {
            file.extend(ids.iter().flat_map(|id| id.to_be_bytes()));
        }
        file.extend(self.baseline_mm.to_be_bytes());
        if layout != Layout::Oldest {
            put(&[self.auxiliary_chip, self.image_processor], &mut file);
        }
        if layout == Layout::Current {
            put(&[self.firmware, self.hardware], &mut file);
            file.push(self.hardware_flags);
        }
        // It always fits.
        UnitFile::DeviceInfo.emit(&file).unwrap_or_default()
    }
}

/// How the file is laid out.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Layout {
    /// Spec 1.3 and later.
    Current,
    /// Spec 1.2: no USB ids, a shorter serial number.
    Old,
    /// Before: no versions of the chips either.
    Oldest,
}

impl Layout {
    fn of(spec: Version) -> Self {
        match (spec.major, spec.minor) {
            (0, _) | (1, 0..=1) => Self::Oldest,
            (1, 2) => Self::Old,
            _ => Self::Current,
        }
    }
}

fn put(versions: &[Version], out: &mut Vec<u8>) {
    out.extend(versions.iter().flat_map(|v| [v.major, v.minor]));
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
