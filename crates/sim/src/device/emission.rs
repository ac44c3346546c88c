//! All that the devices send, with the times at which it arrives: the way from the twin to a recorder without sockets and
//! without waiting. Arrivals are those of the links configured, so that the clocks can be told from them.

use std::collections::VecDeque;

use lsfb_drivers::sidecar::SidecarMessage;
use lsfb_drivers::sidecar::credentials::DeviceKey;
use lsfb_drivers::sidecar::wire::Hello;
use lsfb_drivers::transport::uvc::FrameFormat;
use lsfb_types::{Image, Packet, Timestamp};

use super::feed::Shot;
use super::inertial::InertialStream;
use super::lidar::POSITION_NS;
use super::mynt::frame_bytes;
use super::outbox::{Content, Outbox};
use super::position::position_packet;
use super::session::MYNT_UNITS;
use crate::timing::Clocked;
use crate::{Error, RigSim, Simulation};

/// Data packets of the LiDAR made at a time.
const BATCH_PACKETS: usize = 64;

/// What arrived.
#[derive(Clone, Debug, PartialEq)]
pub enum Emitted {
    /// A datagram of the LiDAR, of either kind.
    Lidar(Packet),
    /// A piece of the IMU's byte stream.
    Imu(Packet),
    /// A frame of a stereo unit.
    Frame {
        /// Unit 0 holds `cam0` and `cam1`, unit 1 `cam2` and `cam3`.
        unit: usize,
        /// Its bytes.
        packet: Packet,
    },
    /// What the app of a phone or of glasses said.
    Sidecar {
        /// When it arrived.
        arrival: Timestamp,
        /// What it said.
        message: SidecarMessage,
    },
}

impl Simulation {
    /// All that these devices of the backpack send, in the order of arrival; [`Clocked::SCAN`] are all.
    pub fn emit_scan(&self, devices: &[Clocked]) -> ScanEmission<'_> {
        ScanEmission::new(self, devices)
    }

    /// All that the second walk's device sends, in the order of arrival.
    pub fn emit_walk(&self) -> WalkEmission<'_> {
        WalkEmission::new(self)
    }
}

/// The streams of the backpack; at equal arrivals those that come first here are first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stream {
    Position,
    Data,
    Imu,
    Unit(usize),
}

/// A stream and when its packets arrive.
struct Lane {
    stream: Stream,
    arrivals_ns: Vec<i64>,
    next: usize,
}

/// All that a backpack's devices send, in the order of arrival.
pub struct ScanEmission<'a> {
    simulation: &'a Simulation,
    lanes: Vec<Lane>,
    imu: InertialStream,
    /// Samples in one piece of the IMU's stream.
    imu_batch: usize,
    position_step_ns: i64,
    fired: u64,
    fired_packets: VecDeque<Vec<u8>>,
}

impl<'a> ScanEmission<'a> {
    fn new(simulation: &'a Simulation, devices: &[Clocked]) -> Self {
        let rig = simulation.scan();
        let clocks = rig.clocks();
        let duration_ns = (rig.walk().duration_s() * 1e9) as i64;
        let mut lanes = Vec::new();
        let mut lane = |stream, arrivals_ns| {
            lanes.push(Lane {
                stream,
                arrivals_ns,
                next: 0,
            });
        };
        let mut position_step_ns = POSITION_NS;
        let wanted = |device| devices.contains(&device);
        if let Some(lidar) = rig.lidar().filter(|_| wanted(Clocked::Lidar)) {
            let packet_ns = lidar.packet_ns();
            let link = clocks.link(Clocked::Lidar);
            let packets = duration_ns / packet_ns;
            let per_position = (POSITION_NS / packet_ns).max(1);
            position_step_ns = per_position * packet_ns;
            // A packet leaves when its last laser has fired.
            let data: Vec<i64> = (1..=packets).map(|k| k * packet_ns).collect();
            let positions: Vec<i64> = (0..(packets + per_position - 1) / per_position)
                .map(|k| k * position_step_ns)
                .collect();
            lane(Stream::Position, link.arrivals(&positions));
            lane(Stream::Data, link.arrivals(&data));
        }
        let link = clocks.link(Clocked::Imu);
        let ready: Vec<i64> = rig.imu().iter().map(|s| s.offset_ns).collect();
        let imu_batch = link.batch();
        let arrivals = link.arrivals(&ready);
        if wanted(Clocked::Imu) {
            let pieces = arrivals
                .chunks(imu_batch)
                .filter_map(|c| c.first().copied());
            lane(Stream::Imu, pieces.collect());
        }
        let frames: Vec<i64> = (0..rig.frame_count())
            .map(|f| rig.frame_offset_ns(f))
            .collect();
        for unit in (0..MYNT_UNITS).filter(|unit| wanted(Clocked::Unit(*unit))) {
            let link = clocks.link(Clocked::Unit(unit));
            lane(Stream::Unit(unit), link.arrivals(&frames));
        }
        Self {
            simulation,
            lanes,
            imu: InertialStream::new(simulation),
            imu_batch,
            position_step_ns,
            fired: 0,
            fired_packets: VecDeque::new(),
        }
    }

    fn rig(&self) -> &'a RigSim {
        self.simulation.scan()
    }

    fn make(
        &mut self,
        stream: Stream,
        number: usize,
        arrival: Timestamp,
    ) -> Result<Emitted, Error> {
        let rig = self.rig();
        let packet = |bytes: Vec<u8>| Packet { arrival, bytes };
        Ok(match stream {
            Stream::Position => {
                let bytes = position_packet(rig, number as i64 * self.position_step_ns)?;
                Emitted::Lidar(packet(bytes.to_vec()))
            }
            Stream::Data => {
                if self.fired_packets.is_empty() {
                    let world = self.simulation.world();
                    let made = rig.lidar_packets(world, self.fired, BATCH_PACKETS)?;
                    self.fired += made.len() as u64;
                    self.fired_packets.extend(made.iter().map(|p| p.to_vec()));
                }
                Emitted::Lidar(packet(self.fired_packets.pop_front().unwrap_or_default()))
            }
            Stream::Imu => {
                let first = number * self.imu_batch;
                let mut bytes = Vec::new();
                for sample in rig.imu().iter().skip(first).take(self.imu_batch) {
                    self.imu.push(rig, sample, &mut bytes)?;
                }
                Emitted::Imu(packet(bytes))
            }
            Stream::Unit(unit) => {
                let frame = number as u32;
                let image = |camera| rig.image(self.simulation.world(), camera, frame);
                let images: Vec<Image> = [2 * unit, 2 * unit + 1]
                    .into_iter()
                    .filter_map(image)
                    .map(|stamped| stamped.sample)
                    .collect();
                let [width, height] = images.first().map_or([0; 2], |i| [i.width, i.height]);
                // Both images side by side.
                let format = FrameFormat {
                    width: 2 * width,
                    height,
                };
                let shot = Shot {
                    frame,
                    offset_ns: rig.frame_offset_ns(frame),
                    images,
                };
                let mut bytes = Vec::new();
                frame_bytes(rig, unit, format, &shot, &mut bytes)?;
                Emitted::Frame {
                    unit,
                    packet: packet(bytes),
                }
            }
        })
    }
}

impl Iterator for ScanEmission<'_> {
    type Item = Result<Emitted, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        let upcoming = self.lanes.iter().enumerate().filter_map(|(k, lane)| {
            let arrival_ns = lane.arrivals_ns.get(lane.next)?;
            Some((*arrival_ns, k))
        });
        let (arrival_ns, k) = upcoming.min()?;
        let lane = self.lanes.get_mut(k)?;
        let (stream, number) = (lane.stream, lane.next);
        lane.next += 1;
        let arrival = self.rig().time(arrival_ns);
        Some(self.make(stream, number, arrival))
    }
}

/// All that the device of the second walk sends, in the order of arrival.
pub struct WalkEmission<'a> {
    simulation: &'a Simulation,
    outbox: Outbox<'a>,
    opening: VecDeque<SidecarMessage>,
    arrivals_ns: Vec<i64>,
    next: usize,
    sent: u64,
    goodbye: bool,
}

impl<'a> WalkEmission<'a> {
    fn new(simulation: &'a Simulation) -> Self {
        let outbox = Outbox::of(simulation);
        let mut opening = VecDeque::from([SidecarMessage::Hello(Hello {
            session: format!("seed-{}", simulation.config().seed),
            first_unacked: 1,
            device: simulation.glasses().rig().name.clone(),
            device_key: DeviceKey([0; 32]),
            pairing_token: None,
        })]);
        opening.extend(outbox.channels().into_iter().map(SidecarMessage::Advertise));
        let link = simulation.glasses().clocks().link(Clocked::Walker);
        let ready: Vec<i64> = outbox.items().iter().map(|i| i.ready_ns).collect();
        Self {
            simulation,
            outbox,
            opening,
            arrivals_ns: link.arrivals(&ready),
            next: 0,
            sent: 0,
            goodbye: false,
        }
    }

    fn emit(&self, arrival_ns: i64, message: SidecarMessage) -> Emitted {
        Emitted::Sidecar {
            arrival: self.simulation.glasses().time(arrival_ns),
            message,
        }
    }
}

impl Iterator for WalkEmission<'_> {
    type Item = Result<Emitted, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(message) = self.opening.pop_front() {
            return Some(Ok(self.emit(0, message)));
        }
        while let Some(item) = self.outbox.items().get(self.next) {
            let arrival_ns = self.arrivals_ns.get(self.next).copied().unwrap_or_default();
            self.next += 1;
            let image = match item.content {
                Content::Image { frame, camera } => {
                    let world = self.simulation.world();
                    self.simulation.glasses().image(world, camera, frame)
                }
                _ => None,
            };
            let image = image.map(|stamped| stamped.sample);
            if let Some(outgoing) = self.outbox.outgoing(item, image.as_ref()) {
                self.sent += 1;
                let data = SidecarMessage::Data {
                    channel: outgoing.channel,
                    seq: self.sent,
                    device_time_ns: outgoing.device_time_ns,
                    payload: outgoing.payload,
                };
                return Some(Ok(self.emit(arrival_ns, data)));
            }
        }
        if self.goodbye {
            return None;
        }
        self.goodbye = true;
        let last_ns = self.arrivals_ns.last().copied().unwrap_or_default();
        let bye = SidecarMessage::Bye {
            last_seq: self.sent,
        };
        Some(Ok(self.emit(last_ns, bye)))
    }
}
