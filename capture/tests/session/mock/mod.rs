//! Devices that speak the real wire formats, one thread each.

use std::net::{SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use lsfb_capture::{Counts, INVITATION, PairingFolder, Session, SidecarConfig};
use lsfb_drivers::microstrain::MipUnit;
use lsfb_drivers::microstrain::model::set;
use lsfb_drivers::microstrain::wire::{Field, MipPacket};
use lsfb_drivers::mynt_s::wire::{
    DeviceInfo, ImuProtocol, ImuSegment, ImuValues, TimeSource, Trailer, Version, XuDevice,
    emit_frame,
};
use lsfb_drivers::sidecar::credentials::PairingCode;
use lsfb_drivers::sidecar::model::CLOCK_UTC;
use lsfb_drivers::sidecar::wire::Advertise;
use lsfb_drivers::sidecar::{ClientConfig, SidecarClient};
use lsfb_drivers::transport::camera_socket::{CameraListener, UnitRequest};
use lsfb_drivers::transport::serial::Pty;
use lsfb_drivers::transport::uvc::FrameFormat;
use lsfb_drivers::xsens::model::message;
use lsfb_drivers::xsens::wire::{Item, Message, OutputSetting, UtcTime, Vector};
pub use lsfb_tests::velodyne::{data_packet as lidar_packet, position_packet};

/// 2026-03-01T10:00:00Z, where every mock starts.
pub const START_NS: i64 = 1_772_359_200_000_000_000;
pub const CAMERA_PERIOD_NS: i64 = 100_000_000;
pub const IMU_PERIOD_NS: i64 = 5_000_000;

pub fn spawn<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> JoinHandle<T> {
    std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(work)
        .unwrap()
}

/// Sends data packets, a `pause` after each and a position packet before every 14, never more than 200 ahead of the recorder.
pub fn send_lidar(
    addresses: &[SocketAddr],
    counts: &Counts,
    packets: u64,
    pause: Duration,
) -> JoinHandle<u64> {
    let (data, position) = (addresses[0], addresses[1]);
    let counts = counts.clone();
    spawn("mock-lidar", move || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let mut sent = 0;
        for n in 0..packets {
            if n % 14 == 0 {
                socket
                    .send_to(&position_packet((n * 664) as u32), position)
                    .unwrap();
                sent += 1;
            }
            socket.send_to(&lidar_packet(n), data).unwrap();
            sent += 1;
            std::thread::sleep(pause);
            let patience = Instant::now();
            while sent > counts.lidar_packets.load(Ordering::Relaxed) + 200 {
                if patience.elapsed() > Duration::from_secs(5) {
                    return sent;
                }
                std::thread::sleep(Duration::from_micros(100));
            }
        }
        sent
    })
}

/// How a mock's part ends.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Farewell {
    /// It says goodbye.
    Orderly,
    /// It is unplugged.
    Sudden,
}

/// A stereo unit that sends `frames`, or endlessly at its rate for `None`. Grey value: the frame's number.
pub fn stereo_unit(
    socket: &Path,
    first_id: u16,
    frames: Option<u16>,
    farewell: Farewell,
) -> JoinHandle<()> {
    camera_unit(2, socket, first_id, frames, farewell)
}

/// The same with any number of cameras, which share 1280 columns.
pub fn camera_unit(
    cameras: usize,
    socket: &Path,
    first_id: u16,
    frames: Option<u16>,
    farewell: Farewell,
) -> JoinHandle<()> {
    let listener = CameraListener::bind(socket).unwrap();
    spawn("mock-camera", move || {
        serve_unit(
            cameras,
            &listener,
            first_id,
            frames,
            farewell,
            OwnImu::Measures,
        )
    })
}

/// A stereo unit that sends images endlessly and has nothing to say of its own IMU.
pub fn unit_without_imu(socket: &Path) -> JoinHandle<()> {
    let listener = CameraListener::bind(socket).unwrap();
    spawn("mock-camera", move || {
        serve_unit(2, &listener, 0, None, Farewell::Sudden, OwnImu::Silent)
    })
}

/// Whether a unit's own IMU measures anything.
#[derive(Clone, Copy, PartialEq, Eq)]
enum OwnImu {
    Measures,
    Silent,
}

/// A unit that comes to `socket` after `delay`: one that was unplugged and is back.
pub fn stereo_unit_after(
    delay: Duration,
    socket: PathBuf,
    first_id: u16,
    frames: u16,
) -> JoinHandle<()> {
    spawn("mock-camera-again", move || {
        std::thread::sleep(delay);
        let listener = CameraListener::bind(&socket).unwrap();
        serve_unit(
            2,
            &listener,
            first_id,
            Some(frames),
            Farewell::Orderly,
            OwnImu::Measures,
        );
    })
}

fn serve_unit(
    cameras: usize,
    listener: &CameraListener,
    first_id: u16,
    frames: Option<u16>,
    farewell: Farewell,
    own_imu: OwnImu,
) {
    {
        let info = DeviceInfo {
            serial: "07C41A19".to_owned(),
            spec: Version { major: 1, minor: 3 },
            ..Default::default()
        };
        let mut device = XuDevice::new(info, ImuProtocol::Float);
        let Some(mut unit) = listener.accept(Duration::from_secs(10)).unwrap() else {
            return;
        };
        loop {
            match device.serve(&mut unit, Duration::from_secs(5)) {
                Ok(Some(UnitRequest::Start { .. })) => break,
                Ok(_) => {}
                Err(_) => return,
            }
        }
        let mut bytes = Vec::new();
        for n in 0..frames.unwrap_or(u16::MAX) {
            let trailer = Trailer {
                time_source: TimeSource::External,
                frame_id: first_id.wrapping_add(n),
                timestamp_us: ((START_NS + i64::from(n) * CAMERA_PERIOD_NS) / 1000) as u64,
                exposure_steps: 50,
                ..Trailer::default()
            };
            let pixels = vec![n as u8; 1280 * 400 / cameras];
            emit_frame(
                FrameFormat::S2_1280X400,
                &vec![pixels.as_slice(); cameras],
                &trailer.with_checksum(),
                &mut bytes,
            )
            .unwrap();
            if unit.send_frame(&bytes).is_err() {
                return;
            }
            if frames.is_none() {
                for k in (0..10).filter(|_| own_imu == OwnImu::Measures) {
                    device.push_imu(own_imu_segment(u32::from(n) * 10 + k));
                }
                let until = Instant::now() + Duration::from_millis(100);
                while Instant::now() < until {
                    // Only a recorder that wants the unit's own IMU asks.
                    if device.serve(&mut unit, Duration::from_millis(5)).is_err() {
                        return;
                    }
                }
            }
        }
        if farewell == Farewell::Orderly {
            unit.finish().unwrap();
        }
    }
}

/// Segment `n` of the unit's own IMU: gyroscope and accelerometer by turns, 100 a second.
fn own_imu_segment(n: u32) -> ImuSegment {
    ImuSegment {
        serial: n + 1,
        timestamp_us: (START_NS / 1000) as u64 + u64::from(n) * 10_000,
        time_source: TimeSource::External,
        temperature: 30.0,
        values: if n.is_multiple_of(2) {
            ImuValues::AccelerometerG([0.0, 1e-3 * (n % 100) as f32, 1.0])
        } else {
            ImuValues::GyroscopeDegS([0.0, 0.0, 90.0])
        },
    }
}

/// A mock IMU's line and thread.
pub struct MockImu {
    pub path: PathBuf,
    pub thread: JoinHandle<()>,
}

/// An Xsens unit with UTC that sends `samples`, or endlessly at its rate for `None`; `garbage` goes in between.
pub fn imu(samples: Option<u32>, garbage: &'static [u8]) -> MockImu {
    let mut pty = Pty::open().unwrap();
    let path = pty.path().to_owned();
    let thread = spawn("mock-imu", move || {
        let mut pending = Vec::new();
        'configure: loop {
            let Ok(bytes) = pty.recv(Duration::from_secs(5)) else {
                return;
            };
            pending.extend(bytes.unwrap_or_default());
            while let Ok(Some(parsed)) = Message::parse(&pending) {
                let (id, data, len) = (parsed.message.id, parsed.message.data.to_vec(), parsed.len);
                pending.drain(..len);
                let answer = match id {
                    message::REQ_DID => vec![0x03, 0x80, 0xA2, 0xC1],
                    message::SET_OUTPUT_CONFIGURATION => {
                        OutputSetting::emit_all(&OutputSetting::parse_all(&data).unwrap())
                    }
                    _ => Vec::new(),
                };
                let mut bytes = Vec::new();
                Message {
                    id: id + 1,
                    data: &answer,
                }
                .emit(&mut bytes)
                .unwrap();
                pty.send(&bytes).unwrap();
                if id == message::GO_TO_MEASUREMENT {
                    break 'configure;
                }
            }
        }
        for n in 0..samples.unwrap_or(u32::MAX) {
            let utc = UtcTime::from_unix_nanos(START_NS + i64::from(n) * IMU_PERIOD_NS).unwrap();
            let items = [
                Item::PacketCounter(n as u16),
                Item::SampleTimeFine(50 * n),
                Item::Utc(utc),
                Item::Acceleration(Vector::single([0.0, 0.0, 9.8125])),
                Item::RateOfTurn(Vector::single([0.0, 0.5, f64::from(n)])),
            ];
            let mut data = Vec::new();
            items.iter().for_each(|item| item.emit(&mut data).unwrap());
            let mut bytes = Vec::new();
            Message {
                id: message::MT_DATA2,
                data: &data,
            }
            .emit(&mut bytes)
            .unwrap();
            if n % 100 == 50 {
                bytes.extend_from_slice(garbage);
            }
            if pty.send(&bytes).is_err() {
                return;
            }
            if samples.is_none() {
                std::thread::sleep(Duration::from_millis(5));
            }
        }
        pty.finish(Duration::from_secs(20)).unwrap();
    });
    MockImu { path, thread }
}

/// A MicroStrain unit of 1000 Hz that sends `samples` of 200 Hz behind its configuration.
pub fn microstrain(samples: u32) -> MockImu {
    let mut pty = Pty::open().unwrap();
    let path = pty.path().to_owned();
    let thread = spawn("mock-mip", move || {
        let mut unit = MipUnit::new(1000);
        while !unit.is_streaming() {
            if let Some(bytes) = pty.recv(Duration::from_secs(5)).unwrap() {
                let answer = unit.handle(&bytes).unwrap();
                pty.send(&answer).unwrap();
            }
        }
        for n in 0..u64::from(samples) {
            let mut payload = Vec::new();
            for field in [
                Field::ReferenceTimeNs(n * IMU_PERIOD_NS as u64),
                Field::ReferenceDeltaNs(IMU_PERIOD_NS as u64),
                Field::AccelerometerG([0.0, 0.0, 1.0]),
                Field::GyroscopeRadS([0.0, 0.0, n as f32]),
            ] {
                field.emit(&mut payload).unwrap();
            }
            let mut bytes = Vec::new();
            MipPacket {
                descriptor_set: set::SENSOR,
                payload: &payload,
            }
            .emit(&mut bytes)
            .unwrap();
            pty.send(&bytes).unwrap();
        }
        pty.finish(Duration::from_secs(20)).unwrap();
    });
    MockImu { path, thread }
}

/// Glasses with a topic of their own, connected.
pub fn visor(config: ClientConfig) -> SidecarClient {
    let mut client = SidecarClient::connect(ClientConfig {
        device: "visor".to_owned(),
        ..config
    })
    .unwrap();
    let advertise = Advertise {
        channel: 3,
        topic: "/sidecar/visor/note".to_owned(),
        encoding: "cdr".to_owned(),
        schema_name: "std_msgs/msg/UInt32".to_owned(),
        schema: b"uint32 data".to_vec(),
        clock_id: CLOCK_UTC.to_owned(),
        metadata_json: String::new(),
    };
    client.advertise(&advertise).unwrap();
    client
}

/// The `n`-th message of a [`visor`].
pub fn send_note(client: &mut SidecarClient, n: u32) {
    let payload = [&[0, 1, 0, 0][..], &n.to_le_bytes()].concat();
    client.send(3, START_NS + i64::from(n), &payload).unwrap();
}

/// A [`visor`] that sends `messages`.
pub fn glasses(rig: ClientConfig, messages: u32) -> JoinHandle<()> {
    spawn("mock-glasses", move || {
        let mut client = visor(rig);
        for n in 0..messages {
            send_note(&mut client, n);
        }
        client.bye().unwrap();
    })
}

/// Phones connect to this machine; the rig's certificate and its devices are in a folder of the test's.
pub fn sidecar(folder: &Path) -> SidecarConfig {
    SidecarConfig {
        come_back_secs: 5,
        ..SidecarConfig::new(
            SocketAddr::from(([127, 0, 0, 1], 0)),
            folder.join("sidecar"),
        )
    }
}

/// How an app that was just invited connects.
pub fn invited(session: &Session, folder: &Path) -> ClientConfig {
    let address = session.sidecar_address().unwrap();
    let pairing = PairingFolder::open(&folder.join("sidecar")).unwrap();
    let code = PairingCode {
        address: address.to_string(),
        fingerprint: pairing.fingerprint(),
        token: pairing.invite(INVITATION).unwrap(),
    };
    ClientConfig::invited(address, &code).unwrap()
}
