//! Devices of which one part falls silent, and the operator who must be told.

use std::net::UdpSocket;
use std::sync::Arc;

use lsfb_capture::health::{Level, Snapshot};
use lsfb_recording::HEALTH;
use lsfb_recording::message::decode_health_value;

use super::live::run_until;
use super::*;

/// An alarm that comes later than this is too late; a busy machine may add to it.
const ALARM_SECS: f64 = 1.0;
const BUSY_SECS: f64 = 1.0;

/// When the data of a LiDAR ended, and everything that was told.
struct DeadLidar {
    died: Instant,
    told: Vec<(Instant, Snapshot)>,
    report: CaptureReport,
    recording: Recording,
}

/// Records a LiDAR whose data packets end after `alive`, while its position packets go on, for `after` more.
fn record_dead_lidar(alive: Duration, after: Duration) -> DeadLidar {
    let folder = tempfile::tempdir().unwrap();
    let imu = mock::imu(None, &[]);
    let config = DevicesConfig {
        lidars: vec![lidar()],
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let [data, position] = session.lidar_addresses()[..] else {
        panic!("two addresses");
    };
    let snapshots = session.health().subscribe();
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let sender = mock::spawn("dead-lidar", move || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let began = Instant::now();
        let mut died = began;
        for n in 0.. {
            if stopped.load(Ordering::Relaxed) {
                break;
            }
            if n % 14 == 0 {
                let bytes = mock::position_packet((n * 664) as u32);
                socket.send_to(&bytes, position).unwrap();
            }
            if began.elapsed() < alive {
                socket.send_to(&mock::lidar_packet(n), data).unwrap();
                died = Instant::now();
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        died
    });
    let out = folder.path().join("scan.mcap");
    let began = Instant::now();
    let mut told = Vec::new();
    let report = run_until(session, &out, || {
        told.extend(snapshots.try_iter().map(|s| (Instant::now(), s)));
        began.elapsed() > alive + after
    });
    stop.store(true, Ordering::Relaxed);
    let recording = Recording::open(&out).unwrap();
    DeadLidar {
        died: sender.join().unwrap(),
        told,
        report,
        recording,
    }
}

/// Its position packets go on: "✓ lidar 0.0 Hz", nothing lost, no alarm, and ever more time until the disk is full.
#[test]
fn a_lidar_without_data_is_shown_as_dead_though_its_position_packets_go_on() {
    let dead = record_dead_lidar(Duration::from_secs(8), Duration::from_secs(4));
    let alarm = dead.told.iter().find(|(at, snapshot)| {
        let lidar = &snapshot.devices[0];
        *at > dead.died && lidar.level == Level::Error && lidar.problem.contains("no data")
    });
    let (at, snapshot) = alarm.expect("an alarm");
    let after = at.duration_since(dead.died).as_secs_f64();
    assert!(after < ALARM_SECS + BUSY_SECS, "{after}");
    assert_eq!(snapshot.level, Level::Error);
    let parts = &snapshot.devices[0].parts;
    let level = |name: &str| parts.iter().find(|part| part.name == name).unwrap().level;
    assert_eq!(
        (level("data"), level("position")),
        (Level::Error, Level::Ok)
    );

    // A device that sends nothing makes no room on the disk: it may come back.
    let secs_to_full = |from: Instant, to: Instant| -> Vec<f64> {
        let between = dead.told.iter().filter(|(at, _)| (from..to).contains(at));
        between
            .filter_map(|(_, s)| s.storage.secs_to_full)
            .collect()
    };
    let second = Duration::from_secs(1);
    let before = secs_to_full(dead.died - second, dead.died);
    let later = secs_to_full(dead.died + 2 * second, dead.died + 4 * second);
    let (before, later) = (before.last().unwrap(), later.last().unwrap());
    assert!(later / before < 1.1, "{before} {later}");

    // In the exit code, by name, and in the recording.
    let lidar = stream(&dead.report, "lidar");
    assert_eq!((lidar.silences, lidar.missing), (1, 0), "{lidar:?}");
    assert!(dead.report.lost > 0);
    assert!(
        lidar.notes.iter().any(|note| note.contains("without data")),
        "{lidar:?}"
    );
    let rates = dead.recording.messages(&format!("{HEALTH}rate")).unwrap();
    let rates: Vec<_> = rates
        .map(|m| decode_health_value(&m.unwrap().bytes).unwrap())
        .filter(|value| value.device == "lidar/data")
        .collect();
    let last = rates.last().unwrap();
    assert_eq!((last.level, last.value), (2, 0.0), "{last:?}");
    assert!(
        rates
            .iter()
            .any(|rate| rate.level == 0 && rate.value > 50.0)
    );
    assert_eq!(stream(&dead.report, "imu0").silences, 0);
}

/// A LiDAR that never sends data is no healthy LiDAR, however many position packets come.
#[test]
fn a_lidar_that_sends_position_packets_only_has_lost_its_data() {
    let dead = record_dead_lidar(Duration::ZERO, Duration::from_secs(2));
    let lidar = stream(&dead.report, "lidar");
    assert!(lidar.received > 10 && lidar.decoded == 0, "{lidar:?}");
    assert!(lidar.silences == 1 && dead.report.lost > 0, "{lidar:?}");
}

/// The IMU inside a camera unit stops answering while the images go on.
#[test]
fn a_camera_whose_imu_falls_silent_is_not_healthy() {
    let folder = tempfile::tempdir().unwrap();
    let front = folder.path().join("front");
    let camera = mock::unit_without_imu(&front);
    let config = DevicesConfig {
        cameras: vec![CameraUnitConfig {
            imu: Some("imu1".to_owned()),
            ..unit(&front, ["cam0", "cam1"])
        }],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let snapshots = session.health().subscribe();
    let images = session.counts().images;
    let out = folder.path().join("scan.mcap");
    let mut alarms = Vec::new();
    let report = run_until(session, &out, || {
        let told = snapshots.try_iter().map(|s| s.devices[0].problem.clone());
        alarms.extend(told.filter(|problem| problem.contains("no imu1")));
        images.load(Ordering::Relaxed) > 40 && !alarms.is_empty()
    });
    drop(camera);
    let found = stream(&report, "cam0+cam1");
    assert!(found.decoded > 40 && found.silences >= 1, "{found:?}");
    assert!(report.lost > 0);
}
