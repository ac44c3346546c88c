//! The answer of selector 5: files in an envelope with a checksum.

use crate::WireError;

/// Bit of the request's first byte: read.
const READ: u8 = 0x80;

/// What a unit keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum UnitFile {
    /// What it is: [`super::DeviceInfo`].
    DeviceInfo,
    /// Calibration of the cameras: [`super::ImageCalibration`].
    Images,
    /// Calibration of the IMU: [`super::ImuCalibration`].
    Imu,
}

impl UnitFile {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::DeviceInfo, Self::Images, Self::Imu];

    /// Its bit in the request, and its number in the answer.
    pub const fn id(self) -> u8 {
        match self {
            Self::DeviceInfo => 1,
            Self::Images => 2,
            Self::Imu => 4,
        }
    }

    /// First byte of the 2000-byte request for it; the rest is zero.
    pub const fn request(self) -> u8 {
        READ | self.id()
    }

    /// The file that a request asks for.
    pub fn from_request(first_byte: u8) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|file| file.request() == first_byte)
    }

    /// Its content, out of an answer that may hold others too.
    pub fn find(self, answer: &[u8]) -> Result<&[u8], WireError> {
        let Some((&[mask, high, low], rest)) = answer.split_first_chunk() else {
            return Err(WireError::Length {
                expected: 4,
                got: answer.len(),
            });
        };
        let len = usize::from(u16::from_be_bytes([high, low]));
        let (Some(files), Some(&got)) = (rest.get(..len), rest.get(len)) else {
            return Err(WireError::Length {
                expected: len + 4,
                got: answer.len(),
            });
        };
        let expected = checksum(files);
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
            if id == self.id() {
                return Ok(file);
            }
            rest = after;
        }
        Err(WireError::Value {
            field: "file mask",
            offset: 0,
            got: mask.into(),
        })
    }

    /// An answer with this file alone, without the don't-care bytes up to 2000. More than they hold is an error.
    pub fn emit(self, content: &[u8]) -> Result<Vec<u8>, WireError> {
        const ENVELOPE: usize = 3 + 3 + 1;
        let room = crate::transport::uvc::LARGE_TRANSFER_BYTES - ENVELOPE;
        if content.len() > room {
            return Err(WireError::Length {
                expected: room,
                got: content.len(),
            });
        }
        let mut files = vec![self.id()];
        files.extend((content.len() as u16).to_be_bytes());
        files.extend(content);
        let mut out = vec![self.id()];
        out.extend((files.len() as u16).to_be_bytes());
        out.extend(&files);
        out.push(checksum(&files));
        Ok(out)
    }
}

fn checksum(files: &[u8]) -> u8 {
    files.iter().fold(0, |sum, byte| sum ^ byte)
}
