//! IMU samples as a table of text.

use std::path::Path;

use lsfb_types::{ImuSample, Timestamp};

use crate::Error;

/// Reads EuRoC's table: per line a stamp in nanoseconds, three rad/s, three m/s²; lines that begin with `#` are left out.
pub fn read_imu_table(path: &Path) -> Result<Vec<(Timestamp, ImuSample)>, Error> {
    let text = std::fs::read_to_string(path).map_err(|source| Error::Io {
        path: path.display().to_string(),
        source,
    })?;
    parse(&text).map_err(|problem| Error::Parse {
        path: path.display().to_string(),
        problem,
    })
}

fn parse(text: &str) -> Result<Vec<(Timestamp, ImuSample)>, String> {
    let mut samples = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let expected = || format!("line {}: expected ns,gx,gy,gz,ax,ay,az", number + 1);
        let (stamp, rest) = line.split_once(',').ok_or_else(expected)?;
        let stamp: i64 = stamp.trim().parse().map_err(|_| expected())?;
        let values: Vec<f64> = rest
            .split(',')
            .map(|w| w.trim().parse().ok().filter(|v: &f64| v.is_finite()))
            .collect::<Option<_>>()
            .ok_or_else(expected)?;
        let [gx, gy, gz, ax, ay, az] = values[..] else {
            return Err(expected());
        };
        let sample = ImuSample {
            angular_velocity_rad_s: [gx, gy, gz],
            specific_force_m_s2: [ax, ay, az],
        };
        samples.push((Timestamp::from_nanos(stamp), sample));
    }
    Ok(samples)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_samples_and_names_bad_lines() {
        let samples = parse("#t,w,a\n7, 1,2,3, 4,5,6\n").expect("a table");
        assert_eq!(samples[0].0.nanos(), 7);
        assert_eq!(samples[0].1.specific_force_m_s2, [4.0, 5.0, 6.0]);
        for bad in [
            "7,1,2,3,4,5",
            "x,1,2,3,4,5,6",
            "7,1,2,3,4,5,six",
            "7,1,2,3,4,5,nan",
            "7",
        ] {
            let error = parse(&format!("#\n{bad}")).expect_err(bad);
            assert!(error.starts_with("line 2: "), "{error}");
        }
    }
}
