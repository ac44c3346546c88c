//! Inertial units on a bus, played in one process and recorded in another.

use std::io::{Read as _, Write as _};
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use lsfb_capture::ImuFamily;
use lsfb_drivers::sbg::wire::SbgMessage;
use lsfb_recording::Recording;
use lsfb_types::{ImuSample, Packet, Stamped};
use nix::sys::socket::{
    AddressFamily, Backlog, SockFlag, SockType, UnixAddr, bind, listen, socket,
};

use super::recorded::{PERIOD_NS, SAMPLES, frames, mynt_d, packet, record};
use crate::running::Running;
use lsfb_tests::fake_kernel::{is_possible, library};

/// What an SBG unit puts on its bus in two seconds.
fn sbg() -> Vec<Packet> {
    let sample = |n: u32| {
        let messages = [
            SbgMessage::ImuInfo {
                time_us: 7_000_000 + 5_000 * n,
                status: 0x3FF,
                temperature: 2_500,
            },
            SbgMessage::Accelerometer([0, 0, 981]),
            SbgMessage::Gyroscope([n as i16, 0, -3]),
        ];
        let frames = messages.into_iter().zip(0..);
        frames.map(move |(message, k): (_, i64)| {
            let at_ns = i64::from(n) * PERIOD_NS + 300_000 * k;
            packet(at_ns, message.emit().emit().to_vec())
        })
    };
    (0..SAMPLES).flat_map(sample).collect()
}

/// What must be the same: the unit's bytes, and its samples but for their stamps.
fn content(path: &Path) -> (Vec<Vec<u8>>, Vec<(u64, ImuSample)>, usize) {
    let recording = Recording::open(path).expect("recording");
    let packets = recording.packets("imu0").expect("topic");
    let samples = recording.imu().expect("samples").map(Result::unwrap);
    (
        packets.map(|p| p.expect("packet").packet.bytes).collect(),
        samples
            .map(
                |Stamped {
                     device_ticks,
                     sample,
                     ..
                 }| (device_ticks, sample),
            )
            .collect(),
        recording.images("cam1").map_or(0, Iterator::count),
    )
}

/// A CAN bus: what one node sends, the others hear. Begins once two are on it, and stays until it is dropped.
struct Bus {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Bus {
    fn start(path: &Path) -> Self {
        let flags = SockFlag::SOCK_CLOEXEC;
        let bus = socket(AddressFamily::Unix, SockType::SeqPacket, flags, None).expect("a bus");
        bind(bus.as_raw_fd(), &UnixAddr::new(path).expect("a path")).expect("a bus");
        listen(&bus, Backlog::new(4).expect("few")).expect("a bus");
        let stop = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&stop);
        let thread = std::thread::Builder::new()
            .name("bus".to_owned())
            .spawn(move || run_bus(bus, &told))
            .expect("a thread");
        Self {
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Bus {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn run_bus(bus: OwnedFd, stop: &AtomicBool) {
    let listener = UnixListener::from(bus);
    listener.set_nonblocking(true).expect("a socket");
    let mut nodes: Vec<UnixStream> = Vec::new();
    while !stop.load(Ordering::Relaxed) {
        if let Ok((node, _)) = listener.accept() {
            node.set_nonblocking(true).expect("a socket");
            nodes.push(node);
        }
        let mut heard = Vec::new();
        if nodes.len() > 1 {
            for (from, node) in nodes.iter_mut().enumerate() {
                let mut frame = [0; 16];
                while let Ok(16) = node.read(&mut frame) {
                    heard.push((from, frame));
                }
            }
        }
        for (from, frame) in &heard {
            for (_, node) in nodes.iter_mut().enumerate().filter(|(to, _)| to != from) {
                node.set_nonblocking(false).expect("a socket");
                // A node that has left hears nothing.
                let _ = node.write(frame);
                node.set_nonblocking(true).expect("a socket");
            }
        }
        if heard.is_empty() {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

fn arguments(words: &str) -> Vec<String> {
    words.split(' ').map(str::to_owned).collect()
}

#[test]
fn an_sbg_unit_is_played_to_a_can_interface_and_recorded_again() {
    if !is_possible("an_sbg_unit_is_played_to_a_can_interface_and_recorded_again") {
        return;
    }
    let folder = tempfile::tempdir().expect("folder");
    let source = folder.path().join("scan.mcap");
    record(&source, ImuFamily::Sbg, sbg(), frames());
    let path = folder.path().join("bus");
    let _bus = Bus::start(&path);
    let kernel = library();
    let start = |words: &str| {
        Running::command(folder.path(), arguments(words), |lsfb| {
            lsfb.env("LD_PRELOAD", &kernel).env("LSFB_FAKE_CAN", &path)
        })
    };
    let mut mock = start("mock scan.mcap --out mock --can vcan3");
    mock.wait_for("devices.toml");
    // The bus does not say when it ends: the cameras do, and then it is silent.
    let mut scan = start("scan --devices mock/devices.toml --out again.mcap");
    assert_eq!(mock.wait().code(), Some(0), "{}", mock.said());
    assert_eq!(scan.wait().code(), Some(0), "{}", scan.said());
    let (was, is) = (content(&source), content(&folder.path().join("again.mcap")));
    assert_eq!((was.0.len(), was.1.len(), was.2), (1_200, 400, 20));
    assert!(was == is, "{} {} {}", is.0.len(), is.1.len(), is.2);
}

#[test]
fn a_mynt_d_is_played_as_a_usb_device_and_recorded_again() {
    let folder = tempfile::tempdir().expect("folder");
    let source = folder.path().join("scan.mcap");
    record(&source, ImuFamily::MyntD, mynt_d(), Vec::new());
    let start = |words: &str| Running::lsfb(folder.path(), arguments(words));
    let mut mock = start("mock scan.mcap --out mock");
    mock.wait_for("devices.toml");
    let mut scan = start("scan --devices mock/devices.toml --out again.mcap");
    assert_eq!(mock.wait().code(), Some(0), "{}", mock.said());
    assert_eq!(scan.wait().code(), Some(0), "{}", scan.said());
    let (was, is) = (content(&source), content(&folder.path().join("again.mcap")));
    assert_eq!(was.0.len(), 400);
    assert!(was.1.len() >= 399);
    assert!(was == is, "{} {}", is.0.len(), is.1.len());
}

#[test]
fn without_its_can_interface_a_recording_is_refused_with_what_to_do() {
    let folder = tempfile::tempdir().expect("folder");
    let source = folder.path().join("scan.mcap");
    record(&source, ImuFamily::Sbg, sbg(), Vec::new());
    let words = "mock scan.mcap --out mock --can lsfb_no_can";
    let mut mock = Running::lsfb(folder.path(), arguments(words));
    assert_eq!(mock.wait().code(), Some(1));
    let said = mock.said();
    assert!(
        said.contains("lsfb_no_can") && said.contains("--can"),
        "{said}"
    );
}
