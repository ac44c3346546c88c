//! Stamps in other units than nanoseconds, told by how far they are apart.

use std::ops::Range;

use crate::{Error, WrongUnit};

/// Rates of IMUs and of cameras that exist, hertz.
pub(crate) const IMU_HZ: Range<f64> = 5.0..50_000.0;
pub(crate) const CAMERA_HZ: Range<f64> = 0.02..1_000.0;

/// Units that stamps come in, and how many nanoseconds one is.
const UNITS: [(&str, f64); 2] = [("microseconds", 1e3), ("milliseconds", 1e6)];

/// Fails where neighbouring stamps are apart as nanoseconds cannot be. `what` names whose they are.
pub(crate) fn expect_nanoseconds(
    what: &str,
    stamps_ns: impl Iterator<Item = i64>,
    rates_hz: Range<f64>,
) -> Result<(), Error> {
    let mut stamps: Vec<i64> = stamps_ns.collect();
    stamps.sort_unstable();
    let mut steps: Vec<i64> = stamps
        .windows(2)
        .map(|w| w[1].saturating_sub(w[0]))
        .filter(|step| *step > 0)
        .collect();
    steps.sort_unstable();
    let Some(&step) = steps.get(steps.len() / 2) else {
        return Ok(());
    };
    let rate_hz = |unit_ns: f64| 1e9 / (step as f64 * unit_ns);
    // What is too slow is a gap, not another unit.
    if rate_hz(1.0) < rates_hz.end {
        return Ok(());
    }
    let unit = UNITS
        .iter()
        .find(|(_, unit_ns)| step > 1 && rates_hz.contains(&rate_hz(*unit_ns)));
    let problem = match unit {
        Some((unit, _)) => WrongUnit::Stamps { step, unit },
        None => WrongUnit::NoStamps { step },
    };
    Err(Error::Unit {
        what: what.to_owned(),
        problem,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(step: i64, rates_hz: Range<f64>) -> String {
        let stamps = (0..50).map(|k| 1_403_636_579 + k * step);
        expect_nanoseconds("cam0", stamps, rates_hz)
            .map_or_else(|e| e.to_string(), |()| String::new())
    }

    #[test]
    fn stamps_in_other_units_are_named() {
        assert_eq!(said(5_000_000, IMU_HZ), "");
        assert_eq!(said(50_000_000, CAMERA_HZ), "");
        // Photographs of a board, one in ten seconds, and a table of a slow sensor.
        assert_eq!(said(10_000_000_000, CAMERA_HZ), "");
        assert_eq!(said(1_000_000_000, IMU_HZ), "");
        assert!(said(5_000, IMU_HZ).contains("microseconds"));
        assert!(said(5, IMU_HZ).contains("milliseconds"));
        assert!(said(50_000, CAMERA_HZ).contains("microseconds"));
        assert!(said(50, CAMERA_HZ).contains("milliseconds"));
        // 1.png, 2.png …: a frame's number once passed for a time.
        assert!(said(1, CAMERA_HZ).contains("numbers that are 1 apart are not stamps"));
    }
}
