//! The datagrams of a LiDAR, as they were received.

use std::path::Path;
use std::time::Duration;

use lsfb_drivers::any_lidar::{device_ns, factory_ports, is_beside_data};
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::pcap::PcapSource;
use lsfb_drivers::transport::rosbag2::Rosbag2Source;
use lsfb_drivers::transport::udp_sender::UdpSender;
use lsfb_recording::{LIDAR_POSITION, RecordedPacket, Recording};
use lsfb_types::Timestamp;

use super::{PAUSE_NS, Play, PlaybackEndpoints, readable};
use crate::Error;
use crate::device::clock::{SimClock, Turn};
use crate::device::host::Host;
use crate::device::session::SessionReport;

pub(super) const DATA_TOPIC: &str = "/lidar/packets";
pub(super) const POSITION_TOPIC: &str = "/lidar/position";
/// Datagrams that no LiDAR sends, and that came to one of its ports.
pub(super) const STRANGE_TOPIC: &str = "/raw/lidar";
const HOUR_NS: i64 = 3_600_000_000_000;
/// How often a host that is not there yet is looked for.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Opens a file that holds packets only.
pub(super) fn capture(path: &Path) -> Result<Box<dyn PacketSource>, Error> {
    let database = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("db3"));
    Ok(if database {
        Box::new(Rosbag2Source::open(path)?)
    } else {
        Box::new(PcapSource::open(path, &factory_ports())?)
    })
}

/// Sends them to the host.
pub(super) struct LidarPlayer {
    data: UdpSender,
    position: UdpSender,
    host: Host,
    report: SessionReport,
}

impl LidarPlayer {
    pub(super) fn new(endpoints: &PlaybackEndpoints) -> Result<Self, Error> {
        Ok(Self {
            data: UdpSender::aim(endpoints.lidar_data)?,
            position: UdpSender::aim(endpoints.lidar_position)?,
            host: Host::new(&[endpoints.lidar_data, endpoints.lidar_position]),
            report: SessionReport::default(),
        })
    }

    pub(super) fn run(
        mut self,
        play: &Play,
        clock: &SimClock,
        device: usize,
    ) -> Result<SessionReport, Error> {
        while !self.host.listens() {
            if clock.is_stopped() {
                return Ok(self.report);
            }
            std::thread::sleep(LOOK_EVERY);
        }
        if play.capture {
            self.play_capture(play, clock, device)?;
        } else {
            self.play_recording(play, clock, device)?;
        }
        Ok(self.report)
    }

    fn play_capture(&mut self, play: &Play, clock: &SimClock, device: usize) -> Result<(), Error> {
        let mut base_ns = 0;
        for _ in play.turns() {
            let mut source = capture(&play.path)?;
            let mut began = None;
            let mut due_ns = base_ns;
            loop {
                let packet = match source.recv(Duration::ZERO) {
                    Ok(Some(packet)) => packet,
                    Ok(None) => continue,
                    Err(lsfb_drivers::Error::EndOfStream { .. }) => break,
                    Err(e) => return Err(e.into()),
                };
                let began = *began.get_or_insert(packet.arrival);
                due_ns = due_ns.max(base_ns + (packet.arrival - began));
                if clock.reach(device, due_ns) == Turn::Stop {
                    return Ok(());
                }
                self.send(&packet.bytes, clock)?;
            }
            if began.is_none() {
                return Err(Error::Source {
                    path: play.path.clone(),
                    problem: "it has no LiDAR packets".to_owned(),
                });
            }
            base_ns = due_ns + PAUSE_NS;
        }
        Ok(())
    }

    fn play_recording(
        &mut self,
        play: &Play,
        clock: &SimClock,
        device: usize,
    ) -> Result<(), Error> {
        let recording = play.recording()?;
        for base_ns in play.turns() {
            let mut unreadable = SessionReport::default();
            let mut unreadable_positions = SessionReport::default();
            let mut strange_unreadable = SessionReport::default();
            let mut within = WithinRevolution::default();
            let data = packets(&recording, "lidar/packets", &mut unreadable)
                .map(|p| (play.offset_ns(within.time(&p)), p));
            let positions = packets(&recording, LIDAR_POSITION, &mut unreadable_positions)
                .map(|p| (play.offset_ns(p.time), p));
            let arrivals = recording.arrival_range();
            let strange = packets(&recording, "lidar", &mut strange_unreadable).map(|p| {
                let began = arrivals.as_ref().map_or(p.time, |range| range.start);
                ((p.time - began).max(0), p)
            });
            let mut data = data.peekable();
            let mut positions = positions.peekable();
            let mut strange = strange.peekable();
            loop {
                let due = [
                    data.peek().map(|(offset, _)| *offset),
                    positions.peek().map(|(offset, _)| *offset),
                    strange.peek().map(|(offset, _)| *offset),
                ];
                let Some(first) = due.iter().flatten().min().copied() else {
                    break;
                };
                // A position packet goes before the data of its instant: it says how to read them.
                let next = if due[1] == Some(first) {
                    positions.next()
                } else if due[0] == Some(first) {
                    data.next()
                } else {
                    strange.next()
                };
                if clock.reach(device, base_ns + first) == Turn::Stop {
                    return Ok(());
                }
                if let Some((_, packet)) = next {
                    self.send(&packet.packet.bytes, clock)?;
                }
            }
            drop((data, positions, strange));
            for part in [unreadable, unreadable_positions, strange_unreadable] {
                self.report.unreadable += part.unreadable;
            }
        }
        Ok(())
    }

    fn send(&mut self, datagram: &[u8], clock: &SimClock) -> Result<(), Error> {
        self.host.wait_for_room(clock);
        if is_beside_data(datagram) {
            self.report.lidar_position_packets += 1;
            Ok(self.position.send(datagram)?)
        } else {
            self.report.lidar_data_packets += 1;
            Ok(self.data.send(datagram)?)
        }
    }
}

/// Packets of a source; none where the recording has no such topic.
fn packets<'a>(
    recording: &'a Recording,
    source: &str,
    report: &'a mut SessionReport,
) -> impl Iterator<Item = RecordedPacket> + use<'a> {
    let found = recording.packets(source).into_iter().flatten();
    readable(found, report)
}

/// Data packets of one revolution share its time; each has the sensor's own counter besides.
#[derive(Default)]
struct WithinRevolution {
    first: Option<FirstPacket>,
}

#[derive(Clone, Copy)]
struct FirstPacket {
    time: Timestamp,
    toh_ns: i64,
}

impl WithinRevolution {
    fn time(&mut self, packet: &RecordedPacket) -> Timestamp {
        let Some(toh_ns) = device_ns(&packet.packet.bytes) else {
            return packet.time;
        };
        let first = match self.first {
            Some(first) if first.time == packet.time => first,
            _ => *self.first.insert(FirstPacket {
                time: packet.time,
                toh_ns,
            }),
        };
        let past_ns = (toh_ns - first.toh_ns).rem_euclid(HOUR_NS);
        // A packet from before its revolution's first, out of order: it goes at once.
        let past_ns = if past_ns > HOUR_NS / 2 { 0 } else { past_ns };
        packet.time.plus_nanos(past_ns)
    }
}

#[cfg(test)]
mod tests {
    use lsfb_drivers::hesai::Model;
    use lsfb_drivers::hesai::wire::{Clock, DataPacket, ReturnMode};
    use lsfb_types::Packet;

    use super::*;

    /// One XT32 packet, so many microseconds after a full second.
    fn xt32(micros: u32) -> Vec<u8> {
        let bytes = vec![0; Model::Xt32.layout().len + 4];
        let mut packet =
            DataPacket::init(bytes, Model::Xt32, ReturnMode::Strongest).expect("length");
        packet.set_clock(&Clock {
            date: [126, 3, 1],
            time: [10, 59, 59],
            micros,
        });
        packet.into_inner()
    }

    /// Those of another vendor than Velodyne all went out at once, a revolution at a time.
    #[test]
    fn packets_of_any_lidar_go_out_as_they_were_fired() {
        let time = Timestamp::from_nanos(1_772_362_799_000_000_000);
        let mut within = WithinRevolution::default();
        // Over the end of the hour, and one that was late.
        for (micros, past_us) in [
            (999_600, 0),
            (1_000_000, 400),
            (999_200, 0),
            (1_000_400, 800),
        ] {
            let bytes = xt32(micros);
            assert!(!is_beside_data(&bytes));
            let packet = RecordedPacket {
                time,
                kind: 0,
                sequence: 0,
                packet: Packet {
                    arrival: time,
                    bytes,
                },
            };
            assert_eq!(within.time(&packet) - time, past_us * 1_000, "{micros}");
        }
        let about_gps = [&[0xFF, 0xEE][..], &[0; 510]].concat();
        assert!(is_beside_data(&about_gps));
        assert!(factory_ports().contains(&10110));
    }
}
