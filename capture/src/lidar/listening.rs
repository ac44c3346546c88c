//! LiDARs on the network: one thread listens on their ports until the recording ends.

use std::net::IpAddr;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use lsfb_drivers::any_lidar::Settings;
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::udp::UdpSource;

use super::LidarStream;
use super::shared_ports::{Admission, Lidars};
use crate::control::Control;
use crate::health::{Ending, Meter, StreamReport};
use crate::recorder::{RecorderSender, WriterGone};

/// After the other devices have ended, a LiDAR silent for this long has ended too.
const SILENT: Duration = Duration::from_millis(500);

/// LiDARs that are listened for on the same ports: one, or several that are told apart by sender.
pub(crate) struct Listening {
    pub(crate) source: UdpSource,
    pub(crate) lidars: Vec<Listened>,
}

/// One of them.
pub(crate) struct Listened {
    pub(crate) name: String,
    pub(crate) settings: Settings,
    /// The speed that it was set to, revolutions per minute, where that was asked for.
    pub(crate) set_rpm: Option<u16>,
    /// Its address, where that is known beforehand.
    pub(crate) sensor: Option<IpAddr>,
    /// Which of the source's ports its data packets and its position packets come to.
    pub(crate) ports: [usize; 2],
}

/// Tells the session whether this LiDAR was heard lately.
struct Alive<'a> {
    control: &'a Control,
    is_alive: bool,
}

impl<'a> Alive<'a> {
    fn new(control: &'a Control) -> Self {
        Self {
            control,
            is_alive: false,
        }
    }

    fn set(&mut self, is_alive: bool) {
        if is_alive != self.is_alive {
            self.is_alive = is_alive;
            self.control.count_live_lidar(is_alive);
        }
    }
}

/// Records until the session stops, or until the others have ended and nothing comes any more. One report for each LiDAR.
pub(crate) fn record(
    listening: Listening,
    to_recorder: &RecorderSender,
    control: &Control,
    meters: &[Meter],
) -> Vec<StreamReport> {
    let mut source = listening.source;
    let streams = listening.lidars.into_iter().zip(meters);
    let mut lidars = Lidars::named(streams.map(|(lidar, meter)| {
        let mut stream = LidarStream::new(&lidar.name, lidar.settings, meter);
        stream.set_rpm = lidar.set_rpm;
        (stream, lidar.sensor)
    }));
    let mut last_heard = Instant::now();
    let mut alive = Alive::new(control);
    let ending = loop {
        match source.recv(Duration::from_millis(50)) {
            Ok(Some(packet)) => {
                let sender = source.sender();
                match lidars.push(packet, sender, to_recorder) {
                    Ok(Admission::Taken) => {
                        last_heard = Instant::now();
                        alive.set(true);
                    }
                    // A stranger's packets say nothing about the sensor.
                    Ok(Admission::KeptOut) => {}
                    Err(WriterGone) => break Ending::Stopped,
                }
                control
                    .progress
                    .lidar_packets
                    .fetch_add(1, Ordering::Relaxed);
            }
            Ok(None) if control.others_ended() && last_heard.elapsed() > SILENT => {
                break Ending::EndOfStream;
            }
            Ok(None) => {
                alive.set(last_heard.elapsed() <= SILENT);
                meters.iter().for_each(Meter::looked);
            }
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break Ending::EndOfStream,
            Err(error) => break Ending::Lost(error.to_string()),
        }
        if control.is_stopping() {
            break Ending::Stopped;
        }
    };
    alive.set(false);
    let mut reports = lidars.finish(&ending, to_recorder);
    if source.kernel_drops() > 0 {
        let drops = format!(
            "the kernel dropped {} packets: raise net.core.rmem_max (receive buffer: {} bytes)",
            source.kernel_drops(),
            source.receive_buffer_bytes()
        );
        for report in &mut reports {
            report.notes.push(drops.clone());
        }
    }
    reports
}
