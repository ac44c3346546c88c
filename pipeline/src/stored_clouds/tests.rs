//! Clouds of a walk through a room in closed form, written, read, and refused.

use lsfb_geometry::RigImu;
use lsfb_types::no_progress;

use super::*;
use crate::odometry::run_odometry;
use crate::odometry::tests::room::{self, Room};

fn rig() -> Rig {
    Rig {
        imus: RigImu::from(room::imu()).alone(),
        lidars: room::lidar().alone(),
        ..Rig::empty("backpack")
    }
}

fn record(path: &Path, rig: &Rig) -> Recording {
    let room = Room::furnished();
    let mut writer = Writer::create(path, &WriterConfig::default()).expect("create");
    writer.attach_rig(rig).expect("rig");
    for sample in room::imu_samples(3.0, 7) {
        writer.write_imu("imu0", &sample).expect("imu");
    }
    for i in 0..20 {
        let scan = room::scan(&room, i as f64 * 0.1, i);
        writer.write_scan("lidar", &scan).expect("scan");
    }
    writer.finish().expect("finish");
    Recording::open(path).expect("recording")
}

/// Of a scan that is deskewed to its time.
fn lies_in_the_room(stored: &StoredScan) {
    let at_s = stored.time.secs_since(room::time(0.0));
    let world_from_rig = room::world_from_rig(at_s);
    let room = Room::furnished();
    let off = stored.reduced.surfaces.iter();
    let off = off.map(|(_, p)| room.distance_to_surface(&(world_from_rig * *p)));
    let far = off.filter(|off| *off > 0.1).count();
    assert!(100 * far < stored.reduced.surfaces.len(), "{far} off");
}

fn reason(opened: Result<StoredClouds, Error>) -> String {
    opened.err().expect("refused").to_string()
}

#[test]
fn what_is_stored_is_read_and_what_does_not_belong_is_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let at = |name: &str| folder.path().join(name);
    let scan = record(&at("scan.mcap"), &rig());
    let config = OdometryConfig::default();
    let odometry = run_odometry(&scan, &config, &no_progress).expect("a walk");
    let storing = StoringConfig {
        odometry: &config,
        features: LidarFeatureConfig::default(),
        share: STORED_SHARE,
        firing: Firing::Last,
    };
    let path = at("clouds.mcap");
    let report = store_clouds(&scan, &odometry, &storing, &path, &no_progress).expect("stored");
    assert_eq!(report.scans, odometry.scan_poses.len() as u64);
    assert!(
        report.share() <= STORED_SHARE && report.share() > 0.1,
        "{report:?}"
    );

    let features = LidarFeatureConfig::default();
    let clouds = StoredClouds::open(&path, &scan, &features, &no_progress).expect("opened");
    let read: Vec<StoredScan> = clouds.scans().expect("scans").flatten().collect();
    assert_eq!(read.len() as u64, report.scans);
    for (stored, placed) in read.iter().zip(&odometry.scan_poses) {
        assert_eq!(stored.time, placed.pose.time);
        assert!(stored.reduced.bends.len() > 20);
        lies_in_the_room(stored);
    }

    // Where the rig was earlier in each scan.
    for (firing, before_end_ns) in [(Firing::First, 99_888_888), (Firing::Middle, 49_944_444)] {
        let storing = StoringConfig {
            firing,
            ..storing.clone()
        };
        let path = at(firing.key());
        store_clouds(&scan, &odometry, &storing, &path, &no_progress).expect("stored");
        let clouds = StoredClouds::open(&path, &scan, &features, &no_progress).expect("opened");
        let read: Vec<StoredScan> = clouds.scans().expect("scans").flatten().collect();
        assert_eq!(read.len(), odometry.scan_poses.len());
        for (stored, placed) in read.iter().zip(&odometry.scan_poses) {
            assert_eq!(placed.pose.time - stored.time, before_end_ns);
            lies_in_the_room(stored);
        }
    }

    let other = LidarFeatureConfig {
        edge_window_m: 0.5,
        ..LidarFeatureConfig::default()
    };
    let said = reason(StoredClouds::open(&path, &scan, &other, &no_progress));
    assert!(said.contains("edge_window_m = 0.3"), "{said}");
    let said = reason(StoredClouds::open(
        scan.path(),
        &scan,
        &features,
        &no_progress,
    ));
    assert!(said.contains("--out-clouds"), "{said}");
    let mut moved = rig();
    for lidar in moved.lidars.values_mut() {
        lidar.rig_from_lidar.translation.z += 0.01;
    }
    let elsewhere = record(&at("elsewhere.mcap"), &moved);
    let said = reason(StoredClouds::open(
        &path,
        &elsewhere,
        &features,
        &no_progress,
    ));
    assert!(said.contains("LiDAR"), "{said}");
    let mut bytes = std::fs::read(&path).expect("bytes");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x55;
    std::fs::write(at("bad.mcap"), bytes).expect("written");
    let said = reason(StoredClouds::open(
        &at("bad.mcap"),
        &scan,
        &features,
        &no_progress,
    ));
    assert!(said.contains("damaged"), "{said}");
    assert!(clouds.expect_scans(5, 9).is_err() && clouds.expect_scans(4, 9).is_ok());
}
