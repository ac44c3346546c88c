//! Data packets of a LiDAR, those of one revolution in a message: our own type, and those of ROS drivers, which are read.

use lsfb_types::{Packet, RosPackets, Timestamp};

use super::schema::LIDAR_PACKETS;
use crate::cdr::{CdrError, CdrReader, CdrWriter, Layout};

/// A packet in a message takes a stamp and a length at least.
const LEAST_PACKET_BYTES: usize = 12;

/// Names of the types of messages that hold LiDAR packets that [`decode_lidar_packets`] reads: ours first.
pub fn lidar_packet_types() -> impl Iterator<Item = &'static str> {
    let others = RosPackets::ALL.into_iter().map(|known| known.name);
    std::iter::once(LIDAR_PACKETS.name).chain(others)
}

/// Whether messages of the type `schema` hold LiDAR packets that [`decode_lidar_packets`] reads.
pub fn holds_lidar_packets(schema: &str) -> bool {
    lidar_packet_types().any(|known| known == schema)
}

/// `lsfb_msgs/msg/LidarPackets`; each packet keeps its own receive time.
pub fn encode_lidar_packets(time: Timestamp, frame: &str, packets: &[Packet]) -> Vec<u8> {
    let bytes: usize = packets
        .iter()
        .map(|p| p.bytes.len() + LEAST_PACKET_BYTES + 3)
        .sum();
    let mut w = CdrWriter::with_capacity(64 + bytes);
    w.header(time, frame);
    w.u32(packets.len() as u32);
    for packet in packets {
        w.time(packet.arrival);
        w.byte_sequence(&packet.bytes);
    }
    w.finish()
}

/// The packets of a message of the type `schema`, one of [`lidar_packet_types`].
pub fn decode_lidar_packets(schema: &str, bytes: &[u8]) -> Result<Vec<Packet>, CdrError> {
    decode_packets_of(Layout::Cdr, schema, bytes)
}

/// [`decode_lidar_packets`] of a message of either ROS.
pub fn decode_packets_of(
    layout: Layout,
    schema: &str,
    bytes: &[u8],
) -> Result<Vec<Packet>, CdrError> {
    let mut r = CdrReader::with_layout(layout, bytes)?;
    r.header()?;
    let count = r.u32("packets")? as usize;
    let mut packets = Vec::with_capacity(count.min(bytes.len() / LEAST_PACKET_BYTES));
    let of_ros = RosPackets::named(schema);
    for _ in 0..count {
        let arrival = r.time("packets.stamp")?;
        let data = match of_ros {
            None => r.byte_sequence("packets.data")?,
            Some(known) => {
                let array = r.raw("packets.data", known.array_bytes)?;
                let size = match known.has_size {
                    true => r.u32("packets.size")? as usize,
                    false => known.array_bytes,
                };
                array.get(..size).ok_or(CdrError::Value {
                    field: "packets.size",
                })?
            }
        };
        packets.push(Packet {
            arrival,
            bytes: data.to_vec(),
        });
    }
    Ok(packets)
}
