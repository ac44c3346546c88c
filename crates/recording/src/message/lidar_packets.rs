//! Data packets of a LiDAR, those of one revolution in a message: our own type, and those of two ROS drivers, which are read.

use lsfb_types::{Packet, Timestamp};

use super::schema::{LIDAR_PACKETS, PANDAR_SCAN, Schema, VELODYNE_SCAN};
use crate::cdr::{CdrError, CdrReader, CdrWriter, Layout};

/// A message type of a ROS driver that holds packets, each in an array of one length.
struct RosPackets {
    schema: Schema,
    /// Length of the array.
    array_bytes: usize,
    /// Whether a number behind the array says how much of it is the packet.
    has_size: bool,
}

const ROS_PACKETS: [RosPackets; 2] = [
    RosPackets {
        schema: VELODYNE_SCAN,
        array_bytes: 1206,
        has_size: false,
    },
    RosPackets {
        schema: PANDAR_SCAN,
        array_bytes: 1500,
        has_size: true,
    },
];
/// A packet in a message takes a stamp and a length at least.
const LEAST_PACKET_BYTES: usize = 12;

/// Names of the types of messages that hold LiDAR packets that [`decode_lidar_packets`] reads: ours first.
pub fn lidar_packet_types() -> impl Iterator<Item = &'static str> {
    let others = ROS_PACKETS.iter().map(|known| known.schema.name);
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
    let of_ros = ROS_PACKETS.iter().find(|known| known.schema.name == schema);
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
