//! The odometry on live streams gives what the batch gives.

use super::room::{self, Room};
use super::*;

fn rig() -> lsfb_geometry::Rig {
    lsfb_geometry::Rig {
        imus: lsfb_geometry::RigImu::from(room::imu()).alone(),
        lidars: room::lidar().alone(),
        ..lsfb_geometry::Rig::empty("room")
    }
}

#[test]
fn a_live_run_and_a_batch_run_agree_bit_for_bit() {
    let room = Room::furnished();
    // Long enough for the walk to be begun again with the bias that its motion tells.
    let samples = room::imu_samples(9.5, 3);
    let scans: Vec<_> = (8..86)
        .map(|i| room::scan(&room, 0.1 * f64::from(i), 100 + i as u64))
        .collect();
    let config = OdometryConfig::default();

    // As `run_odometry` does: inertial samples half a second ahead.
    let mut batch = Odometry::new(&config, &room::lidar(), Some(&room::imu())).unwrap();
    let mut waiting = samples.iter().peekable();
    let mut expected = Vec::new();
    for scan in &scans {
        let ahead = scan.time.plus_nanos(500_000_000);
        while let Some(sample) = waiting.next_if(|s| s.time <= ahead) {
            batch.push_imu(sample);
        }
        expected.push(batch.push_scan(scan).unwrap());
    }

    assert!(expected.iter().any(|step| step.anew.len() > 40));

    // Live, the IMU lags 30 ms behind the scans, or runs 200 ms ahead.
    for lag_ns in [30_000_000, -200_000_000] {
        let mut live = OnlineOdometry::new(&config, &rig()).unwrap();
        let mut found = Vec::new();
        let mut scans = scans.iter().peekable();
        for sample in &samples {
            let now = sample.time.plus_nanos(lag_ns);
            while let Some(scan) = scans.next_if(|s| s.time.plus_nanos(100_000_000) <= now) {
                live.push_scan(scan.clone());
            }
            live.push_imu(sample);
            while let Some(step) = live.next_step() {
                found.push(step.unwrap());
            }
        }
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(&expected) {
            assert_eq!(found, expected);
        }
    }
}

#[test]
fn an_imu_that_falls_silent_does_not_hold_the_scans_for_ever() {
    let room = Room::furnished();
    let mut live = OnlineOdometry::new(&OdometryConfig::default(), &rig()).unwrap();
    for sample in &room::imu_samples(1.2, 3) {
        live.push_imu(sample);
    }
    let mut steps = 0;
    for i in 10..30 {
        live.push_scan(room::scan(&room, 0.1 * f64::from(i), 1));
        while let Some(step) = live.next_step() {
            step.unwrap();
            steps += 1;
        }
    }
    assert_eq!(steps, 15);
}
