//! An SBG unit on a CAN bus: the driver and the `socketcan` crate as they are, above an emulated kernel.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests, and the one line a skipped test owes its reader"
)]

mod fake_kernel;

use std::io::IoSlice;
use std::os::fd::AsRawFd;
use std::path::Path;
use std::thread::{self, JoinHandle};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use lsfb_capture::{DevicesConfig, ImuFamily, ImuLineConfig, Overflow, RecorderConfig, Session};
use lsfb_drivers::Error;
use lsfb_drivers::sbg::wire::SbgMessage;
use lsfb_drivers::sbg::{Decoder, SbgConfig, SbgImu};
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::can::{CanConfig, CanFrame, CanSource};
use lsfb_recording::Recording;
use lsfb_types::no_progress;
use nix::sys::socket::{
    AddressFamily, Backlog, MsgFlags, SockFlag, SockType, UnixAddr, accept, bind, listen, recv,
    sendmsg, socket,
};

const BUS: &str = "LSFB_FAKE_CAN";
const SAMPLES: u32 = 1_000;
const TIMEOUT: Duration = Duration::from_secs(5);

/// The bus: sends `frames` to the socket that connects, takes as many as `count` from it, and goes.
fn start_bus(path: &Path, frames: Vec<Vec<u8>>, count: usize) -> JoinHandle<Vec<CanFrame>> {
    let flags = SockFlag::SOCK_CLOEXEC;
    let bus = socket(AddressFamily::Unix, SockType::SeqPacket, flags, None).unwrap();
    bind(bus.as_raw_fd(), &UnixAddr::new(path).unwrap()).unwrap();
    listen(&bus, Backlog::new(1).unwrap()).unwrap();
    let work = move || {
        let node = accept(bus.as_raw_fd()).unwrap();
        for bytes in frames {
            let slices = [IoSlice::new(&bytes)];
            sendmsg::<()>(node, &slices, &[], MsgFlags::empty(), None).unwrap();
        }
        let taken = (0..count).map(|_| {
            let mut bytes = [0; 16];
            recv(node, &mut bytes, MsgFlags::empty()).unwrap();
            CanFrame::parse(&bytes).unwrap()
        });
        let taken = taken.collect();
        nix::unistd::close(node).unwrap();
        taken
    };
    thread::Builder::new()
        .name("bus".to_owned())
        .spawn(work)
        .unwrap()
}

/// A unit at 200 Hz between frames of others.
fn unit() -> Vec<Vec<u8>> {
    let mut frames: Vec<CanFrame> = Vec::new();
    for n in 0..SAMPLES {
        let messages = [
            SbgMessage::ImuInfo {
                time_us: 5_000 * n,
                status: 0x3FF,
                temperature: 2_500,
            },
            SbgMessage::Accelerometer([0, 0, 981]),
            SbgMessage::Gyroscope([0, 0, n as i16]),
        ];
        frames.extend(messages.map(|message| message.emit()));
        frames.push(CanFrame::standard(0x6FF, &[1, 2, 3]));
    }
    frames.iter().map(|frame| frame.emit().to_vec()).collect()
}

/// The same where nobody took the frames of 20 samples in time: the kernel dropped them, and says so with each frame after.
fn unit_with_drops() -> Vec<Vec<u8>> {
    let all = unit();
    let dropped = 4 * 500..4 * 500 + DROPPED_FRAMES as usize;
    let mut frames = all.clone();
    for frame in frames.iter_mut().skip(dropped.end) {
        frame.extend(DROPPED_FRAMES.to_le_bytes());
    }
    frames.drain(dropped);
    frames
}

const DROPPED_FRAMES: u32 = 4 * 20;

/// Above the emulated kernel: runs the test below it, on a bus that sends `frames` and is sent `expected`; `false`.
fn is_below(name: &str, frames: impl FnOnce() -> Vec<Vec<u8>>, expected: &[CanFrame]) -> bool {
    if std::env::var_os(BUS).is_some() {
        return true;
    }
    if fake_kernel::is_possible(name) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("bus");
        let bus = start_bus(&path, frames(), expected.len());
        fake_kernel::run_below(name, &[(BUS, path.display().to_string())]);
        assert_eq!(bus.join().unwrap(), expected);
    }
    false
}

fn host_now_ns() -> i64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    now.as_nanos() as i64
}

#[test]
fn every_sample_of_a_unit_arrives_and_others_are_filtered_out() {
    let name = "every_sample_of_a_unit_arrives_and_others_are_filtered_out";
    if !is_below(name, unit, &[]) {
        return;
    }
    let mut imu = SbgImu::open(&SbgConfig {
        interface: "vcan0".to_owned(),
    })
    .unwrap();
    let mut decoder = Decoder::new();
    let mut samples = 0u32;
    let lost = loop {
        let packet = match imu.recv(TIMEOUT) {
            Ok(Some(packet)) => packet,
            // A frame that the filters keep away looks like nothing, for a moment.
            Ok(None) => continue,
            Err(error) => break error,
        };
        assert!(packet.arrival.nanos() <= host_now_ns());
        if let Some(reading) = decoder.push(&packet).unwrap() {
            assert_eq!(reading.device_ticks, u64::from(5_000 * samples));
            let rate = reading.sample.sample.angular_velocity_rad_s[2];
            assert_eq!(rate, f64::from(samples) / 1000.0);
            samples += 1;
        }
    };
    // The bus has gone.
    assert!(matches!(lost, Error::Lost { .. }), "{lost}");
    assert_eq!(samples, SAMPLES);
    let counters = decoder.counters();
    // What came between opening the socket and setting its filters is on the bus, as with a real kernel.
    assert_eq!((counters.incomplete, counters.missing), (0, 0));
    assert!(counters.foreign < 50, "{counters:?}");
    assert_eq!(imu.kernel_drops(), 0);
}

#[test]
fn frames_go_out_and_an_absent_bus_is_an_error() {
    let name = "frames_go_out_and_an_absent_bus_is_an_error";
    let out = [
        CanFrame::standard(0x601, &[4, 5]),
        CanFrame::standard(0x120, &[0; 8]),
    ];
    if !is_below(name, Vec::new, &out) {
        return;
    }
    let config = |interface: &str| CanConfig {
        interface: interface.to_owned(),
        ids: Vec::new(),
    };
    let mut bus = CanSource::open(&config("vcan0")).unwrap();
    for frame in &out {
        bus.send(frame).unwrap();
    }
    let error = CanSource::open(&config("can9")).unwrap_err();
    assert!(matches!(error, Error::Open { .. }), "{error}");
}

#[test]
fn what_the_kernel_drops_is_counted_and_told() {
    let name = "what_the_kernel_drops_is_counted_and_told";
    if !is_below(name, unit_with_drops, &[]) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let config = DevicesConfig {
        imus: vec![ImuLineConfig {
            name: "imu0".to_owned(),
            family: ImuFamily::Sbg,
            path: "vcan0".into(),
            baud: 0,
            rate_hz: 200,
        }],
        recorder: RecorderConfig {
            least_space_secs: 0.0,
            ..RecorderConfig::default()
        },
        overflow: Overflow::Wait,
        ..DevicesConfig::default()
    };
    let out = folder.path().join("scan.mcap");
    let session = Session::open(&config).unwrap();
    let snapshots = session.health().subscribe();
    let report = session.run(&out, &no_progress).unwrap();
    let [imu] = report.streams.as_slice() else {
        panic!("{report:?}");
    };
    assert_eq!((imu.decoded, imu.missing), (u64::from(SAMPLES) - 20, 20));
    let words = format!("{DROPPED_FRAMES} frames dropped by the kernel");
    assert!(imu.notes.iter().any(|n| n.contains(&words)), "{imu:?}");
    assert!(report.lost >= 20, "{report:?}");
    let told = snapshots.iter().last().unwrap();
    assert_eq!(told.devices[0].missing, 20);
    let recording = Recording::open(&out).unwrap();
    let samples = recording.imu().unwrap().map(Result::unwrap);
    assert_eq!(samples.count() as u64, imu.decoded);
    // The frames themselves, as they came.
    assert!(recording.packets("imu0").unwrap().count() as u64 >= 3 * imu.decoded);
}
