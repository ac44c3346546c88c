//! `lsfb scan` that is told to stop, and `lsfb scan` that is killed.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use lsfb_drivers::transport::udp_sender::UdpSender;
use lsfb_recording::{LIDAR_POSITION, Recording};
use lsfb_tests::velodyne::{data_packet, data_time_us, position_packet};
use nix::sys::signal::Signal;

use crate::running::{Running, wait_until};
use crate::simulated_session::{Ports, text};

/// A recorder of a LiDAR, and the LiDAR.
struct Scan {
    process: Running,
    out: PathBuf,
    ports: [u16; 2],
    data: UdpSender,
    position: UdpSender,
    /// When each data packet was sent.
    data_sent: Vec<Instant>,
    positions_sent: usize,
    _folder: tempfile::TempDir,
}

impl Scan {
    fn start() -> Self {
        let folder = tempfile::tempdir().expect("folder");
        let Ports([data, position, _]) = Ports::free();
        let ports = [data, position];
        let address = |port: u16| SocketAddr::from(([127, 0, 0, 1], port));
        let [data, position] = ports.map(address);
        let devices = folder.path().join("devices.toml");
        let list = format!(
            "[recorder]\nleast_space_secs = 10.0\n[lidar]\ndata = \"{data}\"\nposition = \"{position}\"\n"
        );
        std::fs::write(&devices, list).expect("list of devices");
        let out = folder.path().join("scan.mcap");
        let arguments = ["scan", "--devices", text(&devices), "--out", text(&out)];
        let process = Running::lsfb(folder.path(), arguments.map(str::to_owned));
        let mut scan = Self {
            process,
            ports,
            data: UdpSender::aim(data).expect("sender"),
            position: UdpSender::aim(position).expect("sender"),
            data_sent: Vec::new(),
            positions_sent: 0,
            out,
            _folder: folder,
        };
        // The file is made after the sockets are bound.
        let out = scan.out.clone();
        scan.process
            .wait_until("the recorder listens", || out.exists());
        scan
    }

    /// Sends for `duration`, at about the rate of the sensor.
    fn send_for(&mut self, duration: Duration) {
        let began = Instant::now();
        while began.elapsed() < duration {
            let n = self.data_sent.len() as u64;
            if n.is_multiple_of(14) {
                self.position
                    .send(&position_packet(data_time_us(n)))
                    .expect("sent");
                self.positions_sent += 1;
            }
            self.data.send(&data_packet(n)).expect("sent");
            self.data_sent.push(Instant::now());
            std::thread::sleep(Duration::from_micros(1_300));
        }
    }

    /// Waits until the recorder has taken everything out of its sockets.
    fn wait_until_received(&self) {
        wait_until("everything is received", || {
            let sockets = std::fs::read_to_string("/proc/net/udp").expect("sockets");
            self.ports.iter().all(|port| {
                let wanted = format!("0100007F:{port:04X}");
                let columns = |line: &str| {
                    line.split_whitespace()
                        .map(str::to_owned)
                        .collect::<Vec<_>>()
                };
                let socket = sockets
                    .lines()
                    .map(columns)
                    .find(|c| c.get(1) == Some(&wanted));
                socket.is_some_and(|c| c[4].ends_with(":00000000"))
            })
        });
    }
}

fn packets(path: &Path, topic: &str) -> usize {
    let recording = Recording::open(path).expect("recording");
    let packets = recording.packets(topic).expect("topic");
    packets.fold(0, |count, packet| {
        packet.expect("packet");
        count + 1
    })
}

#[test]
fn ctrl_c_closes_the_file_with_everything_in_it() {
    let mut scan = Scan::start();
    scan.send_for(Duration::from_millis(1_500));
    scan.wait_until_received();
    let asked = Instant::now();
    scan.process.signal(Signal::SIGINT);
    let status = scan.process.wait();
    assert!(
        asked.elapsed() < Duration::from_secs(2),
        "{:?}",
        asked.elapsed()
    );
    assert_eq!(status.code(), Some(0), "nothing was lost");

    let recording = Recording::open(&scan.out).expect("recording");
    assert!(recording.damage().is_empty(), "{:?}", recording.damage());
    assert!(recording.attachment("health.json").is_ok());
    let bytes = std::fs::read(&scan.out).expect("recording");
    assert!(bytes.ends_with(b"\x89MCAP0\r\n"));
    assert_eq!(packets(&scan.out, "lidar/packets"), scan.data_sent.len());
    assert_eq!(packets(&scan.out, LIDAR_POSITION), scan.positions_sent);
}

#[test]
fn a_killed_recorder_leaves_all_but_the_last_second() {
    let mut scan = Scan::start();
    scan.send_for(Duration::from_millis(3_000));
    scan.wait_until_received();
    let killed = Instant::now();
    scan.process.signal(Signal::SIGKILL);
    assert_eq!(scan.process.wait().code(), None);

    let recording = Recording::open(&scan.out).expect("recording");
    assert_eq!(recording.damage().len(), 1, "{:?}", recording.damage());
    let second = Duration::from_secs(1);
    let safe = scan
        .data_sent
        .iter()
        .filter(|sent| killed.duration_since(**sent) > second)
        .count();
    let recorded = packets(&scan.out, "lidar/packets");
    assert!(
        recorded >= safe,
        "{recorded} recorded of {safe} that were sent a second before"
    );
    assert!(safe > 500, "{safe}");
}
