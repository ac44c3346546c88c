use lsfb_types::Timestamp;

use crate::cdr::{CdrError, CdrReader, CdrWriter};

/// `lsfb_msgs/msg/RawPacket`: bytes exactly as a device sent them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawPacket {
    /// Name of the device or port.
    pub source: String,
    /// What kind of traffic this is, by the driver's own numbering; 0 where there is one kind only.
    pub kind: u16,
    /// Counts the packets of this source, gaps included: a jump is loss.
    pub sequence: u64,
    /// The bytes.
    pub bytes: Vec<u8>,
}

/// `lsfb_msgs/msg/RawPacket`.
pub fn encode_raw_packet(time: Timestamp, frame: &str, packet: &RawPacket) -> Vec<u8> {
    let mut w =
        CdrWriter::with_capacity(64 + frame.len() + packet.source.len() + packet.bytes.len());
    w.header(time, frame);
    w.string(&packet.source);
    w.u16(packet.kind);
    w.u64(packet.sequence);
    w.byte_sequence(&packet.bytes);
    w.finish()
}

/// A `lsfb_msgs/msg/RawPacket`.
pub fn decode_raw_packet(bytes: &[u8]) -> Result<RawPacket, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    Ok(RawPacket {
        source: r.string("source")?.to_owned(),
        kind: r.u16("kind")?,
        sequence: r.u64("seq")?,
        bytes: r.byte_sequence("data")?.to_vec(),
    })
}

/// `lsfb_msgs/msg/FrameMeta`: what a camera says about a frame beside its pixels.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FrameMeta {
    /// The device's frame counter.
    pub frame_id: u32,
    /// The device's clock at the frame, in its own unit.
    pub device_ticks: u64,
    /// Exposure time, nanoseconds; 0 where unknown.
    pub exposure_ns: u32,
    /// The frame's trailer as received; empty where the device has none.
    pub trailer: Vec<u8>,
}

/// `lsfb_msgs/msg/FrameMeta`.
pub fn encode_frame_meta(time: Timestamp, frame: &str, meta: &FrameMeta) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(64 + frame.len() + meta.trailer.len());
    w.header(time, frame);
    w.u32(meta.frame_id);
    w.u64(meta.device_ticks);
    w.u32(meta.exposure_ns);
    w.byte_sequence(&meta.trailer);
    w.finish()
}

/// A `lsfb_msgs/msg/FrameMeta`.
pub fn decode_frame_meta(bytes: &[u8]) -> Result<FrameMeta, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    Ok(FrameMeta {
        frame_id: r.u32("frame_id")?,
        device_ticks: r.u64("device_ticks")?,
        exposure_ns: r.u32("exposure_ns")?,
        trailer: r.byte_sequence("trailer")?.to_vec(),
    })
}
