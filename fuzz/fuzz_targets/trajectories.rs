//! Trajectories as other programs write them: tables of any kind with or without names, KITTI poses with and without a file of times,
//! kapture, gzipped.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_eval::{ReadOptions, read_poses, read_trajectory};
use lsfb_geometry::StampedPose;
use lsfb_recording::{read_tum, write_tum};

fn assert_poses(poses: &[StampedPose]) {
    for pose in poses {
        let turn = &pose.world_from_rig.rotation;
        assert!((turn.norm() - 1.0).abs() < 1e-9, "{turn}");
        let shift = &pose.world_from_rig.translation;
        assert!(shift.iter().all(|v| v.is_finite()), "{shift}");
    }
}

fuzz_target!(|data: &[u8]| {
    let name = |what| std::env::temp_dir().join(format!("lsfb-fuzz-{}-{what}", std::process::id()));
    // What follows the first zero is the file of times.
    let zero = data.iter().position(|byte| *byte == 0 && data[0] != 0x1f);
    let (poses, times) = data.split_at(zero.unwrap_or(data.len()));
    let (path, times_path) = (name("poses"), name("times"));
    std::fs::write(&path, poses).expect("a scratch file");
    if let Ok(file) = read_trajectory(&path, &ReadOptions::default()) {
        assert_poses(&file.poses);
        assert!(file.poses.windows(2).all(|w| w[0].time <= w[1].time));
        assert!(file.covariances.is_empty() || file.covariances.len() == file.poses.len());
    }
    if !times.is_empty() {
        std::fs::write(&times_path, &times[1..]).expect("a scratch file");
        let options = ReadOptions {
            times: Some(times_path.clone()),
            ..ReadOptions::default()
        };
        if let Ok(file) = read_trajectory(&path, &options) {
            assert_poses(&file.poses);
        }
    }
    if let Ok(trajectory) = read_tum(&path) {
        assert_poses(trajectory.poses());
        write_tum(&path, &trajectory).expect("a scratch file");
        assert_eq!(read_tum(&path).expect("it was written"), trajectory);
        assert_poses(&read_poses(&path).unwrap_or_default());
    }
});
