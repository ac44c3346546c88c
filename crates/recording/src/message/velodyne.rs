use lsfb_types::{Packet, Timestamp};

use crate::cdr::{CdrError, CdrReader, CdrWriter};

/// Size of a Velodyne data packet's payload: `VelodynePacket.data` is a fixed array.
pub const VELODYNE_PACKET_BYTES: usize = 1206;

/// `velodyne_msgs/msg/VelodyneScan`; each packet keeps its own receive time. `None` where a packet has not 1206 bytes.
///
/// A packet is 8 + 1206 bytes, and 1214 is no multiple of four: the next stamp is padded to one.
pub fn encode_velodyne_scan(time: Timestamp, frame: &str, packets: &[Packet]) -> Option<Vec<u8>> {
    let mut w = CdrWriter::with_capacity(64 + packets.len() * (VELODYNE_PACKET_BYTES + 10));
    w.header(time, frame);
    w.u32(packets.len() as u32);
    for packet in packets {
        if packet.bytes.len() != VELODYNE_PACKET_BYTES {
            return None;
        }
        w.time(packet.arrival);
        w.raw(&packet.bytes);
    }
    Some(w.finish())
}

/// The packets of a `velodyne_msgs/msg/VelodyneScan`.
pub fn decode_velodyne_scan(bytes: &[u8]) -> Result<Vec<Packet>, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    let count = r.u32("packets")? as usize;
    let mut packets = Vec::with_capacity(count.min(bytes.len() / VELODYNE_PACKET_BYTES));
    for _ in 0..count {
        packets.push(Packet {
            arrival: r.time("packets.stamp")?,
            bytes: r.raw("packets.data", VELODYNE_PACKET_BYTES)?.to_vec(),
        });
    }
    Ok(packets)
}
