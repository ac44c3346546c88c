use std::net::Ipv4Addr;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use lsfb_drivers::mynt_s::{self, CameraConfig, MyntCamera};
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::uvc::FrameFormat;
use lsfb_drivers::velodyne::nmea::Rmc;
use lsfb_drivers::velodyne::wire::{
    DATA_PACKET_LEN, POSITION_PACKET_LEN, PositionPacket, PpsStatus,
};
use lsfb_drivers::velodyne::{self, VelodyneConfig};
use lsfb_drivers::xsens::{self, ImuConfig, XsensImu};
use lsfb_types::{Packet, no_progress};

use super::*;
use crate::SimConfig;

const PATIENCE: Duration = Duration::from_secs(20);

fn simulation() -> Arc<Simulation> {
    let mut config = SimConfig::tiny();
    config.texel_m = 0.05;
    config.scan.duration_s = 1.2;
    config.glasses.duration_s = 1.2;
    Arc::new(Simulation::new(&config, &no_progress).expect("valid"))
}

/// The bytes of one device, as they arrived.
type Stream = Vec<Vec<u8>>;

/// What a host got from a backpack.
struct Received {
    lidar: Stream,
    imu: Stream,
    frames: [Stream; MYNT_UNITS],
    unit_imu_samples: [usize; MYNT_UNITS],
    report: SessionReport,
}

/// A host that opens everything with the real drivers, one thread each.
fn host(simulation: &Arc<Simulation>) -> Received {
    let folder = tempfile::tempdir().expect("folder");
    let localhost = |port| (Ipv4Addr::LOCALHOST, port).into();
    let mut lidar = velodyne::open(&VelodyneConfig {
        data_bind: localhost(0),
        position_bind: localhost(0),
        sensor: None,
        receive_buffer_bytes: 1 << 20,
    })
    .expect("ports");
    let addresses = lidar.local_addresses();
    let received = Arc::new(AtomicU64::new(0));
    let endpoints = ScanEndpoints {
        lidar_data: addresses[0],
        lidar_position: addresses[1],
        camera_sockets: [folder.path().join("a"), folder.path().join("b")],
    };
    let flow = FlowControl::new(Arc::clone(&received));
    let session = SimSession::start_scan(simulation, &endpoints, Pace::Unlimited, Some(flow))
        .expect("devices");
    let imu_path = session.imu_path().expect("line").to_owned();
    let report = Mutex::new(None);
    let frame_format = FrameFormat {
        width: 320,
        height: 100,
    };
    thread::scope(|scope| {
        let packets = scope.spawn(|| {
            let mut packets = Stream::new();
            // The ports do not say when it is over; the report does.
            while report.lock().expect("lock").is_none_or(|r: SessionReport| {
                (packets.len() as u64) < r.lidar_data_packets + r.lidar_position_packets
            }) {
                if let Some(packet) = lidar.recv(Duration::from_millis(20)).expect("socket") {
                    packets.push(packet.bytes);
                    received.fetch_add(1, Ordering::Release);
                }
            }
            assert_eq!(lidar.kernel_drops(), 0);
            packets
        });
        let readings = scope.spawn(|| {
            let mut imu = XsensImu::open(&ImuConfig {
                path: imu_path,
                ..ImuConfig::default()
            })
            .expect("imu");
            stream(&mut imu)
        });
        let units: Vec<_> = endpoints
            .camera_sockets
            .iter()
            .map(|path| {
                scope.spawn(move || {
                    let mut unit = MyntCamera::open(&CameraConfig {
                        path: path.clone(),
                        format: frame_format,
                        ..CameraConfig::default()
                    })
                    .expect("unit");
                    let mut decoder = mynt_s::ImuDecoder::new(unit.imu_protocol());
                    let mut frames = Stream::new();
                    let mut samples = 0;
                    loop {
                        match unit.recv(PATIENCE) {
                            Ok(packet) => frames.push(packet.expect("a frame").bytes),
                            Err(lsfb_drivers::Error::EndOfStream { .. }) => break,
                            Err(e) => panic!("{e}"),
                        }
                        // Not after the last frame: the unit may have closed by then.
                        if [4, 8].contains(&frames.len()) {
                            let answer = unit.poll_imu(0).expect("answer");
                            samples += decoder.push(&answer).expect("segments").len();
                        }
                    }
                    assert_eq!(decoder.counters().missing, 0);
                    (frames, samples)
                })
            })
            .collect();
        *report.lock().expect("lock") = Some(session.join(&no_progress).expect("all sent"));
        let report = report.lock().expect("lock").expect("just set");
        let units: Vec<_> = units.into_iter().map(|u| u.join().expect("host")).collect();
        let [(first, a), (second, b)] = <[_; 2]>::try_from(units).expect("two units");
        Received {
            lidar: packets.join().expect("host"),
            imu: readings.join().expect("host"),
            frames: [first, second],
            unit_imu_samples: [a, b],
            report,
        }
    })
}

fn stream(source: &mut dyn PacketSource) -> Stream {
    let mut packets = Stream::new();
    loop {
        match source.recv(PATIENCE) {
            Ok(packet) => packets.push(packet.expect("the device went silent").bytes),
            Err(lsfb_drivers::Error::EndOfStream { .. }) => return packets,
            Err(e) => panic!("{e}"),
        }
    }
}

fn packet(bytes: &[u8]) -> Packet {
    Packet {
        arrival: Default::default(),
        bytes: bytes.to_vec(),
    }
}

#[test]
fn drivers_decode_what_the_sensors_measured() {
    let simulation = simulation();
    let got = host(&simulation);
    let rig = simulation.scan();

    assert_eq!(got.report.imu_packets, 241);
    assert_eq!(got.report.stereo_frames, 24);
    assert_eq!(got.report.lidar_data_packets, 1808);
    assert_eq!(got.report.lidar_position_packets, 130);

    // LiDAR: the scans that the driver makes of the packets are those measured, point by point.
    let mut decoder = velodyne::Decoder::new(Default::default());
    let mut scans = Vec::new();
    for bytes in got.lidar.iter().filter(|b| b.len() == DATA_PACKET_LEN) {
        scans.extend(decoder.push(&packet(bytes)).expect("good packet"));
    }
    assert!((11..=12).contains(&scans.len()));
    for (k, scan) in scans.iter().enumerate().take(11).skip(1) {
        let expected = rig.scan(simulation.world(), k as u32).expect("points");
        let late_ns = expected.device_ticks.wrapping_sub(scan.device_ticks);
        assert!(late_ns < 1000, "scan {k} is {late_ns} ns off");
        assert_eq!(scan.sample.points.len(), expected.sample.points.len());
        for (a, b) in scan.sample.points.iter().zip(&expected.sample.points) {
            assert_eq!((a.ring, a.intensity), (b.ring, b.intensity));
            assert!(a.time_offset_ns.abs_diff(b.time_offset_ns) <= 1000);
            // The driver turns the rotor by the rounded azimuths' difference between two blocks.
            for (p, q) in a.position_m.iter().zip(b.position_m) {
                assert!((p - q).abs() < 2e-3);
            }
        }
    }
    let positions: Vec<_> = got
        .lidar
        .iter()
        .filter(|b| b.len() != DATA_PACKET_LEN)
        .map(|b| PositionPacket::new(b).expect("position packet"))
        .collect();
    assert_eq!(positions.len(), 130);
    assert!(
        positions
            .iter()
            .all(|p| p.pps_status() == PpsStatus::Locked)
    );
    let second = |k: usize| {
        Rmc::parse(positions[k].nmea())
            .expect("sentence")
            .unix_secs()
    };
    let start_s = rig.start().nanos() / 1_000_000_000;
    assert_eq!(
        [second(0), second(60), second(129)],
        [start_s - 1, start_s, start_s]
    );

    // Cameras: images to the pixel, but for the eight under the trailer.
    let format = FrameFormat {
        width: 320,
        height: 100,
    };
    for (unit, frames) in got.frames.iter().enumerate() {
        let mut decoder = mynt_s::Decoder::new(mynt_s::DecoderConfig {
            format,
            ..Default::default()
        });
        assert_eq!(frames.len(), 12);
        for (k, bytes) in frames.iter().enumerate() {
            let frame = decoder
                .push(&packet(bytes))
                .expect("good frame")
                .expect("a new one");
            for (side, image) in frame.sample.images.into_iter().enumerate() {
                let expected = rig
                    .image(simulation.world(), 2 * unit + side, k as u32)
                    .expect("camera");
                assert_eq!(frame.device_ticks as i64 * 1000, expected.time.nanos());
                assert_eq!(image.exposure_ns, expected.sample.exposure_ns);
                assert_eq!(image.frame_id, expected.sample.frame_id);
                let last = image.pixels.len() - 8;
                assert!(image.pixels[..last] == expected.sample.pixels[..last]);
            }
        }
        // Two full answers of 68 segments, of which two make a sample.
        assert!(got.unit_imu_samples[unit] > 60);
    }

    // IMU: single precision, exact times.
    let mut decoder = xsens::Decoder::new(Default::default());
    got.imu
        .iter()
        .for_each(|bytes| decoder.push(&packet(bytes)));
    for expected in rig.imu() {
        let reading = decoder.next_reading().expect("a packet");
        assert_eq!(
            reading.sample.utc_ns,
            Some(rig.time(expected.offset_ns).nanos())
        );
        assert_eq!(reading.device_ticks as i64, expected.offset_ns / 100_000);
        let sample = reading.sample.sample.expect("inertial data");
        for i in 0..3 {
            let (a, b) = (
                sample.specific_force_m_s2[i],
                expected.sample.specific_force_m_s2[i],
            );
            assert!((a - b).abs() < 1e-5);
            let (a, b) = (
                sample.angular_velocity_rad_s[i],
                expected.sample.angular_velocity_rad_s[i],
            );
            assert!((a - b).abs() < 1e-6);
        }
    }
    assert!(decoder.next_reading().is_none() && decoder.counters().skipped_bytes == 0);
}

#[test]
fn the_bytes_do_not_depend_on_the_run() {
    let (one, other) = (host(&simulation()), host(&simulation()));
    // The two ports of the LiDAR may overtake each other.
    for length in [DATA_PACKET_LEN, POSITION_PACKET_LEN] {
        let of = |host: &Received| -> Stream {
            host.lidar
                .iter()
                .filter(|p| p.len() == length)
                .cloned()
                .collect()
        };
        assert!(of(&one) == of(&other));
    }
    assert!(one.imu.concat() == other.imu.concat());
    assert!(one.frames == other.frames);
}

#[test]
fn a_session_without_host_stops_at_once() {
    let folder = tempfile::tempdir().expect("folder");
    let nowhere = (Ipv4Addr::LOCALHOST, 9).into();
    let endpoints = ScanEndpoints {
        lidar_data: nowhere,
        lidar_position: nowhere,
        camera_sockets: [folder.path().join("a"), folder.path().join("b")],
    };
    let session =
        SimSession::start_scan(&simulation(), &endpoints, Pace::Unlimited, None).expect("devices");
    session.stop_handle().stop();
    let began = Instant::now();
    let report = session.join(&no_progress).expect("nothing went wrong");
    assert_eq!(report, SessionReport::default());
    assert!(began.elapsed() < Duration::from_secs(5));
    assert!(!folder.path().join("a").exists());
}

#[test]
fn a_lidar_whose_host_stops_reading_says_so() {
    let nowhere = (Ipv4Addr::LOCALHOST, 9).into();
    let flow = FlowControl {
        patience: Duration::from_millis(20),
        ..FlowControl::new(Arc::default())
    };
    let lidar = LidarDevice::new(nowhere, nowhere, Some(flow)).expect("port");
    let clock = SimClock::new(1, SKEW_NS, Pace::Unlimited);
    let error = lidar
        .run(&simulation(), &clock, 0)
        .expect_err("nobody reads");
    assert!(matches!(
        error,
        Error::Stalled {
            sent: 64,
            received: 0,
            ..
        }
    ));
}
