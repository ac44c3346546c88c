//! Sessions that are stopped or killed, whose devices go away, or whose listeners are slow.

use super::*;

#[test]
fn a_stop_closes_the_file_within_200_ms() {
    // A busy machine may delay any one attempt.
    let attempts: Vec<Duration> = (0..3)
        .map(|_| stopped_session())
        .take_while(|took| took.as_millis() >= 200)
        .collect();
    assert!(attempts.len() < 3, "{attempts:?}");
}

/// Runs a session of every kind of device, stops it, checks what was recorded, and tells how long closing took.
fn stopped_session() -> Duration {
    let folder = tempfile::tempdir().unwrap();
    let front = folder.path().join("front");
    let unit_thread = mock::stereo_unit(&front, 0, None, Farewell::Sudden);
    let imu = mock::imu(None, &[]);
    let config = DevicesConfig {
        lidars: vec![lidar()],
        cameras: vec![unit(&front, ["cam0", "cam1"])],
        imus: vec![line(&imu.path)],
        sidecar: Some(mock::sidecar(folder.path())),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let lidar = mock::send_lidar(
        &session.lidar_addresses(),
        &session.counts(),
        1_000_000,
        Duration::from_micros(663),
    );
    let out = folder.path().join("scan.mcap");
    let stop = AtomicBool::new(false);
    let counts = session.counts();
    let (report, took) = std::thread::scope(|scope| {
        let running = std::thread::Builder::new()
            .name("session".to_owned())
            .spawn_scoped(scope, || session.run(&out, &until(&stop)).unwrap())
            .unwrap();
        live::wait_until("every device is at work", || {
            let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
            count(&counts.lidar_packets) > 900
                && count(&counts.imu_samples) > 80
                && count(&counts.images) > 4
        });
        stop.store(true, Ordering::Release);
        let asked = Instant::now();
        let report = running.join().unwrap();
        (report, asked.elapsed())
    });
    let recording = Recording::open(&out).unwrap();
    assert!(recording.damage().is_empty());
    assert_eq!(
        recording.images("cam1").unwrap().count() as u64,
        stream(&report, "cam0+cam1").decoded / 2
    );
    assert_eq!(
        recording.imu().unwrap().count() as u64,
        stream(&report, "imu0").decoded
    );
    assert!(recording.scans().unwrap().count() > 3);
    assert!(stream(&report, "imu0").decoded > 50, "{report:?}");
    // The glasses never came; that is no device of this rig gone wrong, but it is named.
    assert!(
        matches!(&stream(&report, "sidecar").ending, Ending::Lost(why) if why.contains("sidecar"))
    );
    drop((lidar, unit_thread, imu));
    took
}

#[test]
fn devices_that_go_away_send_garbage_or_nothing_are_named_and_the_rest_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let (front, rear) = (folder.path().join("front"), folder.path().join("rear"));
    let units = [
        mock::stereo_unit(&front, 0, Some(4), Farewell::Sudden),
        mock::stereo_unit(&rear, 0, Some(30), Farewell::Orderly),
    ];
    // A preamble that leads nowhere, and then some.
    let imu = mock::imu(Some(1_000), &[0xFA, 0xFF, 0x36, 0x04, 1, 2, 3, 4, 5]);
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        lidars: vec![lidar()],
        cameras: vec![
            unit(&front, ["cam0", "cam1"]),
            unit(&rear, ["cam2", "cam3"]),
        ],
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let out = folder.path().join("scan.mcap");
    let report = run(Session::open(&config).unwrap(), &out);
    units.into_iter().for_each(|unit| unit.join().unwrap());
    imu.thread.join().unwrap();

    assert!(
        matches!(&stream(&report, "cam0+cam1").ending, Ending::Lost(why) if why.contains("front")),
        "{report:?}"
    );
    assert_eq!(stream(&report, "cam2+cam3").ending, Ending::EndOfStream);
    assert_eq!(stream(&report, "cam2+cam3").decoded, 60);
    assert_eq!(
        (report.groups.complete, report.groups.incomplete),
        (4, 26),
        "{report:?}"
    );
    let imu = stream(&report, "imu0");
    assert_eq!((imu.decoded, imu.missing), (1_000, 0));
    assert_eq!(imu.bad, 10, "{imu:?}");
    // The LiDAR's cable was never plugged in.
    assert!(
        matches!(&stream(&report, "lidar").ending, Ending::Lost(why) if why.contains("no data"))
    );
    assert!(report.lost >= 3);
    let recording = Recording::open(&out).unwrap();
    assert_eq!(recording.images("cam3").unwrap().count(), 30);
    assert_eq!(recording.imu().unwrap().count(), 1_000);
}

#[test]
fn a_recording_of_a_process_that_was_killed_opens() {
    let folder = tempfile::tempdir().unwrap();
    let imu = mock::imu(None, &[]);
    let config = DevicesConfig {
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let out = folder.path().join("scan.mcap");
    let stop = AtomicBool::new(false);
    let samples = session.counts().imu_samples;
    std::thread::scope(|scope| {
        std::thread::Builder::new()
            .name("session".to_owned())
            .spawn_scoped(scope, || session.run(&out, &until(&stop)).unwrap())
            .unwrap();
        live::wait_until("samples", || samples.load(Ordering::Relaxed) > 200);
        // What has arrived is in the file after this.
        std::thread::sleep(Duration::from_secs(1));
        // What a kill leaves behind is what is in the file now.
        let torn = folder.path().join("torn.mcap");
        std::fs::copy(&out, &torn).unwrap();
        stop.store(true, Ordering::Release);
        let recording = Recording::open(&torn).unwrap();
        assert!(recording.imu().unwrap().filter(Result::is_ok).count() > 100);
    });
}

/// The tap never slows the recorder.
#[test]
fn a_blocked_tap_loses_nothing_in_the_recording() {
    const FRAMES: u16 = 40;
    const SAMPLES: u32 = 4_000;
    let folder = tempfile::tempdir().unwrap();
    let front = folder.path().join("front");
    let camera = mock::stereo_unit(&front, 7, Some(FRAMES), Farewell::Orderly);
    let imu = mock::imu(Some(SAMPLES), &[]);
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        cameras: vec![unit(&front, ["cam0", "cam1"])],
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let mut session = Session::open(&config).unwrap();
    // Held, and never read.
    let tap = session.tap();
    let out = folder.path().join("scan.mcap");
    let report = run(session, &out);
    camera.join().unwrap();
    imu.thread.join().unwrap();
    assert!(tap.missed() > 0, "the queue was never full");
    assert_eq!(report.lost, 0, "{report:?}");
    assert_eq!(stream(&report, "imu0").decoded, u64::from(SAMPLES));
    assert_eq!(stream(&report, "cam0+cam1").decoded, 2 * u64::from(FRAMES));
    let recording = Recording::open(&out).unwrap();
    assert_eq!(recording.imu().unwrap().count(), SAMPLES as usize);
    for camera in ["cam0", "cam1"] {
        let images = recording.images(camera).unwrap();
        assert_eq!(images.count(), usize::from(FRAMES));
    }
    // What had room is still there, in order, and ends with the recording.
    let mut samples = 0;
    while let Ok(entry) = tap.next(Duration::ZERO) {
        samples += u32::from(matches!(entry, Some(Tapped::Imu { .. })));
    }
    assert!(samples > 100, "{samples}");
}
