//! Frames to image pairs. No I/O.

use lsfb_types::{Image, Packet};

use super::model::{EXPOSURE_STEP_NS, FrameFormat};
use super::wire::{Frame, Side, TimeSource};
use crate::{Decoded, WireError};

/// What to do about the trailer's checksum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChecksumRule {
    /// A frame whose checksum is wrong is dropped and counted.
    #[default]
    Required,
    /// Not compared: for firmware that turns out to follow another rule.
    Ignored,
}

/// What the unit was asked to stream, and how strictly to read it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecoderConfig {
    /// Size of the frames.
    pub format: FrameFormat,
    /// What to do about the trailer's checksum.
    pub checksum: ChecksumRule,
}

impl Default for DecoderConfig {
    fn default() -> Self {
        Self {
            format: FrameFormat::S2_1280X400,
            checksum: ChecksumRule::default(),
        }
    }
}

/// Two images of one trigger. Their `frame_id` is the trailer's, continued beyond 16 bits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StereoFrame {
    /// Left image.
    pub left: Image,
    /// Right image; its last 8 pixels lay under the trailer and repeat their left neighbour.
    pub right: Image,
    /// Whose clock stamped the frame.
    pub time_source: TimeSource,
}

/// What the decoder has met so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounters {
    /// Frames decoded.
    pub frames: u64,
    /// Frames of a wrong length.
    pub bad_length: u64,
    /// Frames without the trailer's header.
    pub bad_header: u64,
    /// Frames dropped for their checksum.
    pub bad_checksum: u64,
    /// Frames that the frame ids say are missing; damaged ones are among them.
    pub missing: u64,
    /// Frames dropped because they repeat the one before.
    pub duplicated: u64,
    /// Times the frame id went backwards: the unit began anew.
    pub restarts: u64,
}

/// Frames in, image pairs out.
///
/// `device_ticks` is microseconds: since power-up, or of the external time that the unit was given.
#[derive(Clone, Debug)]
pub struct Decoder {
    config: DecoderConfig,
    counters: FrameCounters,
    last_frame_id: Option<u32>,
}

impl Decoder {
    /// A decoder at the beginning of a stream.
    pub fn new(config: DecoderConfig) -> Self {
        Self {
            config,
            counters: FrameCounters::default(),
            last_frame_id: None,
        }
    }

    /// Decodes one frame. `None`: a repetition of the one before. An error is counted here; the stream goes on.
    pub fn push(&mut self, packet: &Packet) -> Result<Option<Decoded<StereoFrame>>, WireError> {
        let frame = self.check(&packet.bytes).inspect_err(|error| {
            *match error {
                WireError::Length { .. } => &mut self.counters.bad_length,
                WireError::Checksum { .. } => &mut self.counters.bad_checksum,
                _ => &mut self.counters.bad_header,
            } += 1;
        })?;
        let trailer = frame.trailer();
        let Some(frame_id) = self.continue_id(trailer.frame_id) else {
            self.counters.duplicated += 1;
            return Ok(None);
        };
        self.counters.frames += 1;
        let image = |side| Image {
            width: self.config.format.image_width(),
            height: self.config.format.height,
            pixels: frame.grey(side),
            exposure_ns: u32::from(trailer.exposure_steps) * EXPOSURE_STEP_NS,
            frame_id,
        };
        Ok(Some(Decoded {
            arrival: packet.arrival,
            device_ticks: trailer.timestamp_us,
            sample: StereoFrame {
                left: image(Side::Left),
                right: image(Side::Right),
                time_source: trailer.time_source,
            },
        }))
    }

    /// What was met so far.
    pub fn counters(&self) -> FrameCounters {
        self.counters
    }

    fn check<'a>(&self, bytes: &'a [u8]) -> Result<Frame<&'a [u8]>, WireError> {
        let frame = Frame::new(bytes, self.config.format)?;
        let trailer = frame.trailer();
        let expected = trailer.expected_checksum();
        if self.config.checksum == ChecksumRule::Required && trailer.checksum != expected {
            return Err(WireError::Checksum {
                expected: expected.into(),
                got: trailer.checksum.into(),
            });
        }
        Ok(frame)
    }

    /// The id beyond 16 bits, or `None` for a repetition.
    fn continue_id(&mut self, id: u16) -> Option<u32> {
        let continued = match self.last_frame_id {
            None => u32::from(id),
            Some(last) => {
                let step = id.wrapping_sub(last as u16);
                match step {
                    0 => return None,
                    1..0x8000 => self.counters.missing += u64::from(step - 1),
                    // Half the range forward would be the better part of an hour without a frame.
                    _ => self.counters.restarts += 1,
                }
                last.wrapping_add(step.into())
            }
        };
        self.last_frame_id = Some(continued);
        Some(continued)
    }
}

#[cfg(test)]
mod tests;
