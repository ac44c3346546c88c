//! Output that is taken away while it is written.

use lsfb_capture::health::Level;
use lsfb_tests::{Lacks, skip};

use super::live::run_until;
use super::*;

/// Records an IMU, does `harm` to the file after a while, and goes on until the operator was told and for some samples more.
fn record_with(harm: impl Fn(&Path)) -> (tempfile::TempDir, CaptureReport, Duration) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("walk/scan.mcap");
    let (report, after) = record_to(&out, None, || harm(&out));
    (folder, report, after)
}

/// The same to `out`, going on in the folder `second` where there is one.
fn record_to(out: &Path, second: Option<&Path>, harm: impl Fn()) -> (CaptureReport, Duration) {
    let imu = mock::imu(None, &[]);
    let mut config = DevicesConfig {
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    config.recorder.second_folder = second.map(Path::to_owned);
    let session = Session::open(&config).unwrap();
    let snapshots = session.health().subscribe();
    let samples = session.counts().imu_samples;
    let mut harmed = None;
    let mut told = None;
    let mut enough = u64::MAX;
    let report = run_until(session, out, || {
        let count = samples.load(Ordering::Relaxed);
        if harmed.is_none() && count > 100 {
            harm();
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
    (report, after)
}

/// Exit 0, "0 lost", and no file: today's answer to `rm`.
#[test]
fn a_file_that_is_removed_while_it_is_written_is_told_and_followed_by_another() {
    let (folder, report, after) = record_with(|out| std::fs::remove_file(out).unwrap());
    assert!(after < Duration::from_millis(2_000), "{after:?}");
    assert!(report.lost > 50, "{report:?}");
    assert!(
        report.warnings[0].contains("scan.mcap was deleted"),
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

/// Set in a process that has a mount namespace of its own.
const MAY_MOUNT: &str = "LSFB_TEST_MAY_MOUNT";
/// Ways to get one: as root, and as anybody where the kernel allows it.
const NAMESPACES: [&[&str]; 2] = [&["--mount"], &["--mount", "--map-root-user"]];

fn succeeds(program: &str, arguments: &[&str]) -> bool {
    let mut command = std::process::Command::new(program);
    command.args(arguments).stdout(std::process::Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

/// A drive that is pulled out: the open file goes on taking what is written, and nobody will find it.
#[test]
fn a_disk_that_is_unmounted_while_it_is_written_is_told_and_followed_by_another() {
    let test =
        "output::a_disk_that_is_unmounted_while_it_is_written_is_told_and_followed_by_another";
    if std::env::var_os(MAY_MOUNT).is_none() {
        let mut ways = NAMESPACES.iter();
        let Some(way) = ways.find(|way| succeeds("unshare", &[way, &["true"][..]].concat())) else {
            skip(test, Lacks::Program, "no mount namespace can be had");
            return;
        };
        let own = std::env::current_exe().unwrap();
        let mut command = std::process::Command::new("unshare");
        command.args(*way).arg(own).args(["--exact", test]);
        let output = command.env(MAY_MOUNT, "").output().unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(
            output.status.success() && said.contains("1 passed"),
            "{said}"
        );
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let disk = folder.path().join("disk");
    std::fs::create_dir(&disk).unwrap();
    let path = disk.to_str().unwrap();
    let second = folder.path().join("second");
    for (second, next) in [
        (Some(second.as_path()), second.join("scan-0002.mcap")),
        (None, disk.join("scan-0002.mcap")),
    ] {
        assert!(succeeds("mount", &["-t", "tmpfs", "none", path]));
        let unmount = || assert!(succeeds("umount", &["--lazy", path]));
        let (report, after) = record_to(&disk.join("scan.mcap"), second, unmount);
        assert!(after < Duration::from_millis(2_000), "{after:?}");
        assert_eq!((report.lost, &report.failure), (1, &None), "{report:?}");
        assert!(report.warnings[0].contains("unmounted"), "{report:?}");
        assert_eq!(report.parts, std::slice::from_ref(&next));
        assert!(Recording::open(&next).unwrap().imu().unwrap().count() > 50);
    }
}
