//! Data packets of a LiDAR, those of one revolution in a message: our own type, and those of two ROS drivers, which are read.

use lsfb_types::{Packet, Timestamp};

use super::schema::{LIDAR_PACKETS, PANDAR_SCAN, VELODYNE_SCAN};
use crate::cdr::{CdrError, CdrReader, CdrWriter, Layout};

/// `VelodynePacket.data` is a fixed array.
const VELODYNE_DATA_BYTES: usize = 1206;
/// `PandarPacket.data` is a fixed array, of which `size` bytes are the packet.
const PANDAR_DATA_BYTES: usize = 1500;
/// A packet in a message takes a stamp and a length at least.
const LEAST_PACKET_BYTES: usize = 12;

/// Whether messages of the type `schema` hold LiDAR packets that [`decode_lidar_packets`] reads.
pub fn holds_lidar_packets(schema: &str) -> bool {
    [LIDAR_PACKETS, VELODYNE_SCAN, PANDAR_SCAN]
        .iter()
        .any(|known| known.name == schema)
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

/// The packets of a message of the type `schema`: `lsfb_msgs/msg/LidarPackets`, `velodyne_msgs/msg/VelodyneScan` or
/// `pandar_msgs/msg/PandarScan`.
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
    for _ in 0..count {
        let arrival = r.time("packets.stamp")?;
        let data = match schema {
            _ if schema == VELODYNE_SCAN.name => r.raw("packets.data", VELODYNE_DATA_BYTES)?,
            _ if schema == PANDAR_SCAN.name => {
                let data = r.raw("packets.data", PANDAR_DATA_BYTES)?;
                let size = r.u32("packets.size")? as usize;
                data.get(..size).ok_or(CdrError::Value {
                    field: "packets.size",
                })?
            }
            _ => r.byte_sequence("packets.data")?,
        };
        packets.push(Packet {
            arrival,
            bytes: data.to_vec(),
        });
    }
    Ok(packets)
}
