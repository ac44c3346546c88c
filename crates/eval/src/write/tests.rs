use lsfb_geometry::{Se3, Vector6};
use lsfb_types::Timestamp;

use super::*;
use crate::{ReadOptions, read_trajectory};

const FORMATS: [TrajectoryFormat; 6] = [
    TrajectoryFormat::Tum,
    TrajectoryFormat::Euroc,
    TrajectoryFormat::Kitti,
    TrajectoryFormat::Csv,
    TrajectoryFormat::Kapture,
    TrajectoryFormat::Mcap,
];

/// Turned about all axes, at stamps of this century that no `f64` of seconds holds.
fn walk() -> TrajectoryFile {
    let poses = (0..200).map(|i| {
        let t = 0.05 * f64::from(i);
        StampedPose {
            time: Timestamp::from_nanos(1_772_359_200_000_000_001 + i64::from(i) * 49_999_999),
            world_from_rig: Se3::exp(&Vector6::new(
                0.3 * t.sin(),
                0.2 * (1.7 * t).cos(),
                t - 4.0,
                30.0 * t.cos(),
                -17.0 * t,
                1e-7 * t,
            )),
        }
    });
    TrajectoryFile::of_poses(poses.collect())
}

fn options(format: TrajectoryFormat, out: &Path) -> ReadOptions {
    ReadOptions {
        times: (format == TrajectoryFormat::Kitti).then(|| format.files(out).remove(1)),
        ..ReadOptions::default()
    }
}

#[test]
fn what_is_written_reads_back() {
    let folder = tempfile::tempdir().expect("folder");
    let walk = walk();
    for format in FORMATS {
        let out = folder.path().join(format!("{format:?}"));
        let written = write_trajectory(&walk, format, &out).expect("written");
        assert_eq!(written.poses, 200);
        assert!(written.files.iter().all(|f| f.is_file()), "{written:?}");
        let read = read_trajectory(&out, &options(format, &out)).expect("read");
        assert!(read.findings.is_empty(), "{format:?}: {:?}", read.findings);
        assert_eq!(read.poses.len(), 200, "{format:?}");
        for (was, is) in walk.poses.iter().zip(&read.poses) {
            assert_eq!(was.time, is.time, "{format:?}");
            let off = (was.world_from_rig.inverse() * is.world_from_rig).log();
            // Kapture has the inverse, KITTI the matrix of a rotation.
            assert!(off.amax() < 1e-12, "{format:?}: {off}");
        }
    }
}

#[test]
fn covariances_go_where_there_is_a_place_for_them() {
    let folder = tempfile::tempdir().expect("folder");
    let mut walk = walk();
    let covariance = |i: usize| {
        let root = Matrix6::from_fn(|r, c| 0.01 * (((7 * r + 3 * c + i) % 11) as f64 - 5.0));
        root * root.transpose() + Matrix6::identity() * 1e-4
    };
    walk.covariances = (0..walk.poses.len()).map(covariance).collect();
    let out = folder.path().join("walk.mcap");
    let written = write_trajectory(&walk, TrajectoryFormat::Mcap, &out).expect("written");
    assert_eq!(written.covariances_left_out, 0);
    let read = read_trajectory(&out, &ReadOptions::default()).expect("read");
    for (was, is) in walk.covariances.iter().zip(&read.covariances) {
        assert!((was - is).amax() < 1e-15, "{}", was - is);
    }
    assert_eq!(read.covariances.len(), 200);
    let out = folder.path().join("walk.tum");
    let written = write_trajectory(&walk, TrajectoryFormat::Tum, &out).expect("written");
    assert_eq!(written.covariances_left_out, 200);
}

#[test]
fn positions_alone_have_no_rotations_made_up() {
    let folder = tempfile::tempdir().expect("folder");
    let mut walk = walk();
    walk.orientations = Orientations::Missing;
    for format in FORMATS {
        let out = folder.path().join(format!("{format:?}"));
        let written = write_trajectory(&walk, format, &out);
        if format == TrajectoryFormat::Csv {
            written.expect("written");
            let read = read_trajectory(&out, &ReadOptions::default()).expect("read");
            assert_eq!(read.orientations, Orientations::Missing);
            let places = |f: &TrajectoryFile| -> Vec<_> {
                let poses = f.poses.iter();
                poses.map(|p| p.world_from_rig.translation).collect()
            };
            assert_eq!(places(&read), places(&walk));
            continue;
        }
        let error = written.expect_err("no rotations").to_string();
        assert!(error.contains("only positions"), "{error}");
        assert!(!out.exists(), "{format:?}");
    }
}

#[test]
fn repeated_stamps_are_counted_and_old_ones_refused_by_bags() {
    let folder = tempfile::tempdir().expect("folder");
    let out = folder.path().join("walk");
    let mut walk = walk();
    let again = walk.poses[7];
    walk.poses.insert(8, again);
    for format in FORMATS {
        let out = folder.path().join(format!("{format:?}"));
        let written = write_trajectory(&walk, format, &out).expect("written");
        assert_eq!((written.poses, written.repeated_stamps), (200, 1));
    }
    walk.poses[0].time = Timestamp::from_nanos(-1);
    let error = write_trajectory(&walk, TrajectoryFormat::Mcap, &out);
    let error = error.expect_err("before 1970").to_string();
    assert!(error.contains("outside 1970"), "{error}");
    let left: Vec<_> = std::fs::read_dir(folder.path()).expect("folder").collect();
    assert_eq!(left.len(), FORMATS.len() + 1, "{left:?}");
    let nothing = TrajectoryFile::of_poses(Vec::new());
    let error = write_trajectory(&nothing, TrajectoryFormat::Tum, &out);
    assert!(error.is_err() && !out.exists());
}
