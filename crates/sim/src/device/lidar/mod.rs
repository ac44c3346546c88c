//! A Velodyne: data packets with returns, position packets with the clock's state, over UDP.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use lsfb_drivers::transport::udp_sender::UdpSender;
use lsfb_drivers::velodyne::wire::{BLOCKS, DATA_PACKET_LEN, DataPacket};
use lsfb_types::Timestamp;

use super::clock::{SimClock, Turn};
use super::host::Host;
use super::position::{position_packet, top_of_hour_us};
use crate::sensor::lidar::{FiringCycle, LidarSim};
use crate::timing::Clocked;
use crate::{Error, RigSim, Simulation, World};

/// Data packets fired at a time: 5 to 21 ms.
const BATCH_PACKETS: usize = 16;
/// Time between two position packets: 14 data packets of a VLP-32C with one return (its manual: about 14 to 1).
pub(super) const POSITION_NS: i64 = 14 * 663_552;
const NAP: Duration = Duration::from_micros(200);

/// Keeps a stream of datagrams, which nothing else holds back, from overrunning its host.
#[derive(Clone, Debug)]
pub struct FlowControl {
    /// Datagrams of the LiDAR, of both kinds, that the host has received so far. The host counts them up.
    pub received: Arc<AtomicU64>,
    /// Datagrams that may be under way.
    pub window: u64,
    /// A host that counts no further for this long is gone.
    pub patience: Duration,
}

impl FlowControl {
    /// At most 64 datagrams under way; half a minute of patience.
    pub fn new(received: Arc<AtomicU64>) -> Self {
        Self {
            received,
            window: 64,
            patience: Duration::from_secs(30),
        }
    }
}

/// What a LiDAR sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LidarTally {
    pub data_packets: u64,
    pub position_packets: u64,
}

/// Where the packets go.
pub(crate) struct LidarDevice {
    data: UdpSender,
    position: UdpSender,
    flow: Option<FlowControl>,
    host: Host,
    sent: u64,
}

impl LidarDevice {
    pub(crate) fn new(
        data: SocketAddr,
        position: SocketAddr,
        flow: Option<FlowControl>,
    ) -> Result<Self, Error> {
        Ok(Self {
            data: UdpSender::aim(data)?,
            position: UdpSender::aim(position)?,
            flow,
            host: Host::new(&[data, position]),
            sent: 0,
        })
    }

    /// Sends the whole walk.
    pub(crate) fn run(
        mut self,
        simulation: &Simulation,
        clock: &SimClock,
        device: usize,
    ) -> Result<LidarTally, Error> {
        let rig = simulation.scan();
        let mut tally = LidarTally::default();
        let Some(lidar) = rig.lidar() else {
            return Ok(tally);
        };
        let packet_ns = lidar.packet_ns();
        let packets_per_position = (POSITION_NS / packet_ns).max(1) as u64;
        let total = (rig.walk().duration_s() * 1e9) as u64 / packet_ns as u64;
        while tally.data_packets < total {
            let first = tally.data_packets;
            if clock.reach(device, first as i64 * packet_ns) == Turn::Stop {
                break;
            }
            let count = BATCH_PACKETS.min((total - first) as usize);
            for packet in rig.lidar_packets(simulation.world(), first, count)? {
                if tally.data_packets.is_multiple_of(packets_per_position) {
                    let offset_ns = tally.data_packets as i64 * packet_ns;
                    let packet = position_packet(rig, offset_ns)?;
                    self.send(&packet, PacketKind::Position, clock)?;
                    tally.position_packets += 1;
                }
                self.send(&packet, PacketKind::Data, clock)?;
                tally.data_packets += 1;
            }
        }
        Ok(tally)
    }

    fn send(&mut self, packet: &[u8], kind: PacketKind, clock: &SimClock) -> Result<(), Error> {
        if let Some(flow) = &self.flow {
            let mut seen = flow.received.load(Ordering::Acquire);
            let mut since = Instant::now();
            while self.sent >= seen + flow.window && !clock.is_stopped() {
                thread::sleep(NAP);
                let now = flow.received.load(Ordering::Acquire);
                if now != seen {
                    (seen, since) = (now, Instant::now());
                } else if since.elapsed() > flow.patience {
                    return Err(Error::Stalled {
                        device: "LiDAR",
                        sent: self.sent,
                        received: seen,
                    });
                }
            }
        } else {
            self.host.wait_for_room(clock);
        }
        match kind {
            PacketKind::Data => self.data.send(packet)?,
            PacketKind::Position => self.position.send(packet)?,
        }
        self.sent += 1;
        Ok(())
    }
}

#[derive(Clone, Copy)]
enum PacketKind {
    Data,
    Position,
}

impl RigSim {
    /// The LiDAR's data packets `first .. first + count` since the beginning, byte for byte; none without a LiDAR.
    pub fn lidar_packets(
        &self,
        world: &World,
        first: u64,
        count: usize,
    ) -> Result<Vec<[u8; DATA_PACKET_LEN]>, Error> {
        let Some(lidar) = self.lidar() else {
            return Ok(Vec::new());
        };
        let per_packet = lidar.cycles_per_packet();
        let cycles = self.fire(world, first * per_packet as u64, count * per_packet);
        cycles
            .chunks_exact(per_packet)
            .map(|cycles| data_packet(self, lidar, cycles))
            .collect()
    }
}

/// The firing cycles of one packet as they are sent.
fn data_packet(
    rig: &RigSim,
    lidar: &LidarSim,
    cycles: &[FiringCycle],
) -> Result<[u8; DATA_PACKET_LEN], Error> {
    let bytes = [0; DATA_PACKET_LEN];
    let mut packet = DataPacket::init(bytes, lidar.model().product(), lidar.return_mode())?;
    let blocks_per_cycle = BLOCKS / lidar.cycles_per_packet();
    for (first, cycle) in (0..BLOCKS).step_by(blocks_per_cycle).zip(cycles) {
        // In dual mode the last echoes come first (VLP-32C 63-9325 p. 57).
        let returns = [&cycle.returns, &cycle.second_returns];
        for (block, returns) in (first..first + blocks_per_cycle).zip(returns) {
            packet.set_azimuth_centideg(block, cycle.azimuth_centideg);
            for (channel, echo) in returns.iter().enumerate() {
                packet.set_return(block, channel, echo.range_count, echo.reflectivity);
            }
        }
    }
    let offset_ns = cycles.first().map_or(0, |c| c.offset_ns);
    let clock = rig.clocks().of(Clocked::Lidar);
    let device = Timestamp::from_nanos(clock.device_ns(offset_ns));
    packet.set_timestamp_us(top_of_hour_us(device));
    Ok(packet.into_inner())
}

#[cfg(test)]
mod tests;
