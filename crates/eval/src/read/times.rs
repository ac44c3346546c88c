//! The stamps of rows that have none, in a file of their own: KITTI's `times.txt`.

use std::path::Path;

use lsfb_types::{StampUnit, Timestamp};

use super::stamp_times;
use super::text;
use crate::Error;

/// One stamp per line, as many as `rows` of `poses`, and what is to be said of their unit.
pub(super) fn read(
    path: &Path,
    poses: &Path,
    rows: usize,
    unit: Option<StampUnit>,
) -> Result<(Vec<Timestamp>, Option<String>), Error> {
    let text = text::read(path)?;
    let (lines, _) = text::lines(&text);
    if lines.len() != rows {
        return Err(Error::NotATrajectory {
            path: path.to_owned(),
            what: format!(
                "{} stamps for the {rows} poses of {}",
                lines.len(),
                poses.display()
            ),
        });
    }
    let stamps: Vec<(usize, &str)> = lines.iter().map(|l| (l.number, l.text)).collect();
    stamp_times(path, &stamps, unit)
}

/// Refuses a file of times beside poses that have stamps.
pub(super) fn expect_none(path: &Path, times: Option<&Path>) -> Result<(), Error> {
    match times {
        None => Ok(()),
        Some(times) => Err(Error::NotATrajectory {
            path: path.to_owned(),
            what: format!(
                "has its own stamps; leave out {}, which is for rows without (KITTI's matrices)",
                times.display()
            ),
        }),
    }
}
