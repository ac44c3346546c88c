//! The YUYV frame and its trailer.

use crate::WireError;
use crate::mynt_s::model::{
    DAMAGED_PIXELS, TRAILER_BYTES, TRAILER_EXTERNAL_TIME, TRAILER_HEADER, TRAILER_SIZE,
};
use crate::transport::uvc::FrameFormat;

/// Chroma byte of a grey pixel.
const NEUTRAL_CHROMA: u8 = 128;

/// Whose clock stamped a frame or an IMU segment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimeSource {
    /// The unit's own, running since power-up.
    #[default]
    Device,
    /// One set from outside: microseconds of the time that the rig distributes.
    External,
}

/// What the unit says about a frame, in the frame's last 16 bytes, stored back to front.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Trailer {
    /// Whose clock the stamp is of.
    pub time_source: TimeSource,
    /// Counter of frames, wraps at 65 536.
    pub frame_id: u16,
    /// Stamp, microseconds.
    pub timestamp_us: u64,
    /// Exposure, steps of [`super::super::model::EXPOSURE_STEP_NS`].
    pub exposure_steps: u16,
    /// Checksum as sent.
    pub checksum: u8,
}

impl Trailer {
    /// Reads the trailer at the end of a frame. The checksum is not compared: the vendor documents no rule for it.
    pub fn parse(frame: &[u8]) -> Result<Self, WireError> {
        let Some(&wire) = frame.last_chunk::<TRAILER_BYTES>() else {
            return Err(WireError::Length {
                expected: TRAILER_BYTES,
                got: frame.len(),
            });
        };
        let b = logical(wire);
        if b[0] & !TRAILER_EXTERNAL_TIME != TRAILER_HEADER {
            return Err(WireError::Constant {
                offset: frame.len() - 1,
                expected: TRAILER_HEADER.into(),
                got: b[0].into(),
            });
        }
        Ok(Self {
            time_source: if b[0] & TRAILER_EXTERNAL_TIME == 0 {
                TimeSource::Device
            } else {
                TimeSource::External
            },
            frame_id: u16::from_be_bytes([b[2], b[3]]),
            timestamp_us: u64::from_be_bytes([b[4], b[5], b[6], b[7], b[8], b[9], b[10], b[11]]),
            exposure_steps: u16::from_be_bytes([b[12], b[13]]),
            checksum: b[14],
        })
    }

    /// The checksum that the other fields give: exclusive or of the logical bytes 2 to 13. The rule is that of the
    /// older S1 units; the SDK compares it for those only.
    pub fn expected_checksum(&self) -> u8 {
        self.emit()[2..TRAILER_BYTES - 2]
            .iter()
            .fold(0, |sum, byte| sum ^ byte)
    }

    /// With the checksum set to what the other fields give.
    pub fn with_checksum(mut self) -> Self {
        self.checksum = self.expected_checksum();
        self
    }

    /// The 16 bytes as they lie at the end of a frame.
    pub fn emit(&self) -> [u8; TRAILER_BYTES] {
        let mut b = [0; TRAILER_BYTES];
        b[0] = match self.time_source {
            TimeSource::Device => TRAILER_HEADER,
            TimeSource::External => TRAILER_HEADER | TRAILER_EXTERNAL_TIME,
        };
        b[1] = TRAILER_SIZE;
        b[2..4].copy_from_slice(&self.frame_id.to_be_bytes());
        b[4..12].copy_from_slice(&self.timestamp_us.to_be_bytes());
        b[12..14].copy_from_slice(&self.exposure_steps.to_be_bytes());
        b[14] = self.checksum;
        logical(b)
    }
}

/// Wire order to reading order, and back.
fn logical(mut bytes: [u8; TRAILER_BYTES]) -> [u8; TRAILER_BYTES] {
    bytes.reverse();
    bytes
}

/// A view of one frame.
#[derive(Clone, Copy, Debug)]
pub struct Frame<T> {
    bytes: T,
    format: FrameFormat,
    trailer: Trailer,
}

impl<T: AsRef<[u8]>> Frame<T> {
    /// Checks the length and the trailer's header.
    pub fn new(bytes: T, format: FrameFormat) -> Result<Self, WireError> {
        let got = bytes.as_ref().len();
        let expected = format.frame_bytes();
        if got != expected {
            return Err(WireError::Length { expected, got });
        }
        let trailer = Trailer::parse(bytes.as_ref())?;
        Ok(Self {
            bytes,
            format,
            trailer,
        })
    }

    /// What the unit says about the frame.
    pub fn trailer(&self) -> Trailer {
        self.trailer
    }

    /// Grey values of the images of `cameras` cameras side by side, left to right, row by row. A number that does not
    /// divide the frame is an error.
    ///
    /// The last [`DAMAGED_PIXELS`] pixels of the last image's bottom row lie under the trailer; they get the value of
    /// the pixel to their left.
    pub fn images(&self, cameras: u32) -> Result<Vec<Vec<u8>>, WireError> {
        let width = image_width(self.format, cameras)?;
        let height = self.format.height as usize;
        let mut images = vec![Vec::with_capacity(width * height); cameras as usize];
        for row in self
            .bytes
            .as_ref()
            .chunks_exact(2 * self.format.width as usize)
        {
            for (image, part) in images.iter_mut().zip(row.chunks_exact(2 * width)) {
                let (luma_chroma, _) = part.as_chunks::<2>();
                image.extend(luma_chroma.iter().map(|pair| pair[0]));
            }
        }
        if let Some(last) = images.last_mut() {
            repair(last);
        }
        Ok(images)
    }
}

fn image_width(format: FrameFormat, cameras: u32) -> Result<usize, WireError> {
    match format.image_width(cameras) {
        Some(width) => Ok(width as usize),
        None => Err(WireError::Value {
            field: "cameras side by side",
            offset: 0,
            got: cameras.into(),
        }),
    }
}

/// Replaces the pixels under the trailer by their left neighbour.
fn repair(pixels: &mut [u8]) {
    let Some(first_damaged) = pixels.len().checked_sub(DAMAGED_PIXELS) else {
        return;
    };
    if let Some((good, damaged)) = pixels.split_at_mut_checked(first_damaged)
        && let Some(&neighbour) = good.last()
    {
        damaged.fill(neighbour);
    }
}

/// Replaces the content of `out` by a frame of grey images side by side with its trailer. An image of another size than
/// its share of the frame is an error.
pub fn emit_frame(
    format: FrameFormat,
    images: &[&[u8]],
    trailer: &Trailer,
    out: &mut Vec<u8>,
) -> Result<(), WireError> {
    let width = image_width(format, images.len() as u32)?;
    let expected = width * format.height as usize;
    for image in images {
        if image.len() != expected {
            return Err(WireError::Length {
                expected,
                got: image.len(),
            });
        }
    }
    out.clear();
    out.reserve_exact(format.frame_bytes());
    for y in 0..format.height as usize {
        for image in images {
            let row = image.get(y * width..(y + 1) * width).unwrap_or_default();
            out.extend(row.iter().flat_map(|&luma| [luma, NEUTRAL_CHROMA]));
        }
    }
    out.truncate(out.len().saturating_sub(TRAILER_BYTES));
    out.extend(trailer.emit());
    Ok(())
}
