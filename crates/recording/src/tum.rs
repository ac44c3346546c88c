//! Trajectory files in TUM format: `t x y z qx qy qz qw` on each line, `t` in seconds.

use std::fmt::Write as _;
use std::ops::Range;
use std::path::Path;

use lsfb_geometry::{Se3, StampedPose, Trajectory, UnitQuaternion, Vector3};
use lsfb_types::Timestamp;
use nalgebra::Quaternion;

use crate::error::Error;

const COLUMNS: usize = 8;
/// A quaternion of another length has no direction worth normalising, or no length.
const QUATERNION_NORMS: Range<f64> = 1e-3..1e3;

/// Reads a trajectory. Lines that are empty or start with `#` are skipped; stamps are taken to the nanosecond; quaternions
/// are normalised. Poses are sorted by time, and of poses with one stamp the first is kept.
pub fn read_tum(path: &Path) -> Result<Trajectory, Error> {
    let text = std::fs::read_to_string(path).map_err(|source| Error::Io {
        path: path.to_owned(),
        action: "read the trajectory",
        source,
    })?;
    let mut poses = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let pose = parse_line(line).map_err(|reason| Error::TrajectoryLine {
            path: path.to_owned(),
            line: index + 1,
            reason,
        })?;
        poses.push(pose);
    }
    Ok(Trajectory::new(poses))
}

/// Writes a trajectory, stamps with nine decimals and poses so that they read back bit by bit. A file of that name is
/// replaced in one step.
pub fn write_tum(path: &Path, trajectory: &Trajectory) -> Result<(), Error> {
    let mut text = String::from("# timestamp_s tx_m ty_m tz_m qx qy qz qw\n");
    for pose in trajectory.poses() {
        let t = &pose.world_from_rig.translation;
        let q = pose.world_from_rig.rotation.quaternion();
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "{} {} {} {} {} {} {} {}",
            pose.time, t.x, t.y, t.z, q.i, q.j, q.k, q.w
        );
    }
    crate::provenance::replace_file(path, text.as_bytes())
}

fn parse_line(line: &str) -> Result<StampedPose, String> {
    let columns: Vec<&str> = line
        .split([' ', '\t', ','])
        .filter(|c| !c.is_empty())
        .collect();
    let [stamp, numbers @ ..] = columns.as_slice() else {
        return Err("no columns".to_owned());
    };
    if columns.len() != COLUMNS {
        return Err(format!(
            "{} columns, expected {COLUMNS}: t x y z qx qy qz qw",
            columns.len()
        ));
    }
    let time = parse_stamp(stamp).ok_or_else(|| format!("`{stamp}` is not a time in seconds"))?;
    let mut values = [0.0f64; COLUMNS - 1];
    for (value, text) in values.iter_mut().zip(numbers) {
        *value = text
            .parse()
            .map_err(|_| format!("`{text}` is not a number"))?;
        if !value.is_finite() {
            return Err(format!("`{text}` is not finite"));
        }
    }
    let [x, y, z, qx, qy, qz, qw] = values;
    let q = Quaternion::new(qw, qx, qy, qz);
    if !QUATERNION_NORMS.contains(&q.norm()) {
        return Err(format!("quaternion has norm {}, expected 1", q.norm()));
    }
    Ok(StampedPose {
        time,
        world_from_rig: Se3::new(unit_quaternion(q), Vector3::new(x, y, z)),
    })
}

/// Leaves a quaternion that is of unit length already as it is, so that writing and reading changes no bit.
fn unit_quaternion(q: Quaternion<f64>) -> UnitQuaternion<f64> {
    if (q.norm_squared() - 1.0).abs() < 1e-14 {
        UnitQuaternion::new_unchecked(q)
    } else {
        UnitQuaternion::new_normalize(q)
    }
}

/// Seconds with any number of decimals, exactly; beyond nanoseconds they are rounded. Exponents (`1.5e9`) go through `f64`.
fn parse_stamp(text: &str) -> Option<Timestamp> {
    if text.contains(['e', 'E']) {
        let secs: f64 = text.parse().ok()?;
        return (secs.abs() < 9e9).then(|| Timestamp::from_secs_f64(secs));
    }
    let (sign, magnitude) = match text.strip_prefix('-') {
        Some(rest) => (-1, rest),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    let (whole, decimals) = magnitude.split_once('.').unwrap_or((magnitude, ""));
    let is_digits = |s: &str| s.bytes().all(|b| b.is_ascii_digit());
    if (whole.is_empty() && decimals.is_empty()) || !is_digits(whole) || !is_digits(decimals) {
        return None;
    }
    let secs: i64 = if whole.is_empty() {
        0
    } else {
        whole.parse().ok()?
    };
    let mut nanos = 0;
    for place in 0..9 {
        nanos = nanos * 10
            + decimals
                .as_bytes()
                .get(place)
                .map_or(0, |b| i64::from(b - b'0'));
    }
    if decimals.as_bytes().get(9).is_some_and(|b| *b >= b'5') {
        nanos += 1;
    }
    let total = secs.checked_mul(1_000_000_000)?.checked_add(nanos)?;
    Some(Timestamp::from_nanos(sign * total))
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::Vector6;

    fn file(text: &str) -> (tempfile::TempDir, std::path::PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("walk.tum");
        std::fs::write(&path, text).unwrap();
        (dir, path)
    }

    #[test]
    fn writing_and_reading_changes_no_bit() {
        let poses = (0..50).map(|i| StampedPose {
            time: Timestamp::from_nanos(1_772_359_200_000_000_001 + i * 99_999_999),
            world_from_rig: Se3::exp(&(Vector6::new(0.1, -0.2, 0.3, 1.0, 2.0, -0.5) * i as f64)),
        });
        let trajectory = Trajectory::new(poses.collect());
        let (_dir, path) = file("");
        write_tum(&path, &trajectory).unwrap();
        assert_eq!(read_tum(&path).unwrap(), trajectory);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(
            text.lines()
                .nth(1)
                .is_some_and(|l| l.starts_with("1772359200.000000001 "))
        );
    }

    #[test]
    fn stamps_are_exact_to_the_nanosecond() {
        let nanos = |text| parse_stamp(text).map(Timestamp::nanos);
        assert_eq!(
            nanos("1305031102.175304000"),
            Some(1_305_031_102_175_304_000)
        );
        assert_eq!(nanos("1305031102.1753"), Some(1_305_031_102_175_300_000));
        assert_eq!(
            nanos("1403636579763555584"),
            None,
            "nanoseconds are no seconds"
        );
        assert_eq!(nanos("12"), Some(12_000_000_000));
        assert_eq!(nanos(".5"), Some(500_000_000));
        assert_eq!(nanos("-0.25"), Some(-250_000_000));
        assert_eq!(nanos("1.0000000005"), Some(1_000_000_001));
        assert_eq!(nanos("1.403636580e+09"), Some(1_403_636_580_000_000_000));
        for wrong in ["", ".", "-", "1.2.3", "0x10", "nan", "1e400", "1,5x"] {
            assert_eq!(nanos(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn comments_are_skipped_and_quaternions_normalised() {
        let (_dir, path) = file("# t x y z\n\n 2 1 2 3 0 0 0 2 \r\n1,4,5,6,0,0,2,0\n");
        let trajectory = read_tum(&path).unwrap();
        let [a, b] = trajectory.poses() else { panic!() };
        assert_eq!(a.time.nanos(), 1_000_000_000);
        assert_eq!(a.world_from_rig.translation, Vector3::new(4.0, 5.0, 6.0));
        assert_eq!(a.world_from_rig.rotation.quaternion().k, 1.0);
        assert_eq!(b.world_from_rig.rotation, UnitQuaternion::identity());
    }

    #[test]
    fn a_wrong_line_is_named() {
        for (line, reason) in [
            ("1 2 3", "3 columns, expected 8"),
            ("1 0 0 0 0 0 0 0", "norm 0"),
            ("1 0 0 0 0 0 0 4e160", "norm inf"),
            ("1 0 0 inf 0 0 0 1", "not finite"),
            ("1 0 0 nan 0 0 0 1", "not finite"),
            ("1 0 0 x 0 0 0 1", "`x` is not a number"),
            ("t 0 0 0 0 0 0 1", "`t` is not a time"),
        ] {
            let (_dir, path) = file(&format!("# head\n0 0 0 0 0 0 0 1\n{line}\n"));
            let message = read_tum(&path).unwrap_err().to_string();
            assert!(
                message.contains("walk.tum: line 3:") && message.contains(reason),
                "{message}"
            );
        }
        let missing = read_tum(Path::new("nowhere.tum")).unwrap_err().to_string();
        assert!(missing.contains("nowhere.tum"));
    }
}
