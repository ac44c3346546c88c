//! Output that is taken away while it is written.

use lsfb_capture::health::Level;

use super::live::run_until;
use super::*;

/// Records an IMU, does `harm` to the file after a while, and goes on until the operator was told and for some samples more.
fn record_with(harm: impl Fn(&Path)) -> (tempfile::TempDir, CaptureReport, Duration) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("walk/scan.mcap");
    let imu = mock::imu(None, &[]);
    let config = DevicesConfig {
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let snapshots = session.health().subscribe();
    let samples = session.counts().imu_samples;
    let mut harmed = None;
    let mut told = None;
    let mut enough = u64::MAX;
    let report = run_until(session, &out, || {
        let count = samples.load(Ordering::Relaxed);
        if harmed.is_none() && count > 100 {
            harm(&out);
            harmed = Some(Instant::now());
        }
        let alarmed = snapshots
            .try_iter()
            .any(|s| s.storage.level == Level::Error);
        if told.is_none() && alarmed {
            told = Some(Instant::now());
            enough = count + 100;
        }
        count > enough
    });
    let after = told.unwrap().duration_since(harmed.unwrap());
    (folder, report, after)
}

/// Exit 0, "0 lost", and no file: today's answer to `rm`.
#[test]
fn a_file_that_is_removed_while_it_is_written_is_told_and_followed_by_another() {
    let (folder, report, after) = record_with(|out| std::fs::remove_file(out).unwrap());
    assert!(after < Duration::from_millis(2_000), "{after:?}");
    assert!(report.lost > 50, "{report:?}");
    assert!(
        report.warnings[0].contains("scan.mcap was removed"),
        "{report:?}"
    );
    let next = folder.path().join("walk/scan-0002.mcap");
    assert_eq!(report.parts.as_slice(), std::slice::from_ref(&next));
    assert!(Recording::open(&next).unwrap().imu().unwrap().count() > 50);
}

#[test]
fn a_file_that_is_renamed_while_it_is_written_is_closed_and_followed_by_another() {
    let elsewhere = |out: &Path| out.with_file_name("elsewhere.mcap");
    let (folder, report, _) = record_with(|out| {
        std::fs::rename(out, elsewhere(out)).unwrap();
        // And something that is none of ours lies in the way.
        std::fs::write(out.with_file_name("scan-0002.mcap"), "taken").unwrap();
    });
    assert_eq!(report.lost, 1, "{report:?}");
    assert!(report.warnings[0].contains("renamed"), "{report:?}");
    let walk = folder.path().join("walk");
    assert_eq!(report.parts, [walk.join("scan-0003.mcap")]);
    let samples = |name: &str| {
        let recording = Recording::open(&walk.join(name)).unwrap();
        assert!(recording.damage().is_empty());
        recording.imu().unwrap().count() as u64
    };
    let all = samples("elsewhere.mcap") + samples("scan-0003.mcap");
    assert_eq!(all, stream(&report, "imu0").decoded);
}

#[test]
fn a_folder_that_is_removed_with_the_file_is_made_again() {
    let (folder, report, _) = record_with(|out| {
        std::fs::remove_dir_all(out.parent().unwrap()).unwrap();
    });
    assert!(report.lost > 50 && report.failure.is_none(), "{report:?}");
    assert_eq!(report.parts, [folder.path().join("walk/scan-0002.mcap")]);
}
