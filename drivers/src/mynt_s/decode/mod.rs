//! Frames to the images of a unit's cameras. No I/O.

use lsfb_types::{Image, Packet};

use super::model::EXPOSURE_STEP_NS;
use super::wire::{Frame, TimeSource};
use crate::transport::uvc::FrameFormat;
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

/// Which instant of the exposure the trailer's stamp marks. The vendor does not say; owners report the end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "kebab-case")
)]
pub enum StampInstant {
    /// The shutter opens.
    ExposureStart,
    /// Half-way: the stamp is taken as it is.
    #[default]
    ExposureMiddle,
    /// The shutter closes.
    ExposureEnd,
}

/// What the unit was asked to stream, and how strictly to read it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecoderConfig {
    /// Size of the frames.
    pub format: FrameFormat,
    /// Cameras whose images lie side by side in each.
    pub cameras: u32,
    /// What to do about the trailer's checksum.
    pub checksum: ChecksumRule,
    /// Which instant of the exposure the trailer's stamp marks.
    pub stamp: StampInstant,
}

impl Default for DecoderConfig {
    fn default() -> Self {
        Self {
            format: FrameFormat::S2_1280X400,
            cameras: 2,
            checksum: ChecksumRule::default(),
            stamp: StampInstant::default(),
        }
    }
}

/// Which trigger a frame answers. Units of one rig see the same triggers: the difference of their indices stays what it
/// was at the start, as long as neither begins a new epoch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Trigger {
    /// Times that the unit began to count anew: indices of different epochs cannot be compared.
    pub epoch: u64,
    /// The trailer's counter, continued beyond 16 bits. It counts frames that were lost on the way too.
    pub index: u64,
}

/// The images of one trigger. Their `frame_id` is the trailer's, continued beyond 16 bits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnitFrame {
    /// One per camera, left to right; the last 8 pixels of the last one lay under the trailer and repeat their left
    /// neighbour.
    pub images: Vec<Image>,
    /// Whose clock stamped the frame.
    pub time_source: TimeSource,
    /// Which trigger it answers.
    pub trigger: Trigger,
    /// What leads from the stamp to the middle of the exposure, nanoseconds: negative where the stamp marks its end.
    pub mid_exposure_from_stamp_ns: i64,
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

/// Frames in, their images out.
///
/// `device_ticks` is microseconds: since power-up, or of the external time that the unit was given.
#[derive(Clone, Debug)]
pub struct Decoder {
    config: DecoderConfig,
    counters: FrameCounters,
    last_trigger_index: Option<u64>,
}

impl Decoder {
    /// A decoder at the beginning of a stream.
    pub fn new(config: DecoderConfig) -> Self {
        Self {
            config,
            counters: FrameCounters::default(),
            last_trigger_index: None,
        }
    }

    /// Decodes one frame. `None`: a repetition of the one before. An error is counted here; the stream goes on.
    pub fn push(&mut self, packet: &Packet) -> Result<Option<Decoded<UnitFrame>>, WireError> {
        let (frame, width) = self.check(&packet.bytes).inspect_err(|error| {
            *match error {
                WireError::Length { .. } => &mut self.counters.bad_length,
                WireError::Checksum { .. } => &mut self.counters.bad_checksum,
                _ => &mut self.counters.bad_header,
            } += 1;
        })?;
        let trailer = frame.trailer();
        let Some(index) = self.continue_index(trailer.frame_id) else {
            self.counters.duplicated += 1;
            return Ok(None);
        };
        self.counters.frames += 1;
        // The field can say more than its 655 steps: up to 6.5 s, which `u32` nanoseconds cannot.
        let exposure_ns = u32::from(trailer.exposure_steps).saturating_mul(EXPOSURE_STEP_NS);
        let image = |pixels| Image {
            width,
            height: self.config.format.height,
            pixels,
            exposure_ns,
            frame_id: index as u32,
        };
        let images = frame.images(self.config.cameras)?;
        let half_ns = i64::from(exposure_ns / 2);
        Ok(Some(Decoded {
            arrival: packet.arrival,
            device_ticks: trailer.timestamp_us,
            sample: UnitFrame {
                images: images.into_iter().map(image).collect(),
                time_source: trailer.time_source,
                trigger: Trigger {
                    epoch: self.counters.restarts,
                    index,
                },
                mid_exposure_from_stamp_ns: match self.config.stamp {
                    StampInstant::ExposureStart => half_ns,
                    StampInstant::ExposureMiddle => 0,
                    StampInstant::ExposureEnd => -half_ns,
                },
            },
        }))
    }

    /// What was met so far.
    pub fn counters(&self) -> FrameCounters {
        self.counters
    }

    /// The frame, and the width of its images.
    fn check<'a>(&self, bytes: &'a [u8]) -> Result<(Frame<&'a [u8]>, u32), WireError> {
        let frame = Frame::new(bytes, self.config.format)?;
        let cameras = self.config.cameras;
        let width = self.config.format.image_width(cameras);
        let width = width.ok_or(WireError::Value {
            field: "cameras side by side",
            offset: 0,
            got: cameras.into(),
        })?;
        let trailer = frame.trailer();
        let expected = trailer.expected_checksum();
        if self.config.checksum == ChecksumRule::Required && trailer.checksum != expected {
            return Err(WireError::Checksum {
                expected: expected.into(),
                got: trailer.checksum.into(),
            });
        }
        Ok((frame, width))
    }

    /// The counter beyond 16 bits, or `None` for a repetition.
    fn continue_index(&mut self, id: u16) -> Option<u64> {
        let continued = match self.last_trigger_index {
            None => u64::from(id),
            Some(last) => {
                let step = id.wrapping_sub(last as u16);
                match step {
                    0 => return None,
                    1..0x8000 => self.counters.missing += u64::from(step - 1),
                    // Half the range forward would be the better part of an hour without a frame.
                    _ => self.counters.restarts += 1,
                }
                last + u64::from(step)
            }
        };
        self.last_trigger_index = Some(continued);
        Some(continued)
    }
}

#[cfg(test)]
mod tests;
