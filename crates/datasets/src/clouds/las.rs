//! LAS and LAZ files, as surveying software writes them.

use std::io::Cursor;

use lsfb_recording::cloud::MAX_POINTS;

use super::Packed;

/// Points unpacked at a time.
const BATCH: u64 = 65_536;
/// Where a header of version 1.4 counts records behind the points: nothing in them is needed, and their lengths are believed.
const VERSION_MINOR_AT: usize = 25;
const COUNT_BEHIND_AT: std::ops::Range<usize> = 243..247;

pub(super) fn parse(mut bytes: Vec<u8>) -> Result<Packed, String> {
    let said = |error: las::Error| error.to_string();
    if bytes.get(VERSION_MINOR_AT).is_some_and(|minor| *minor >= 4)
        && let Some(count) = bytes.get_mut(COUNT_BEHIND_AT)
    {
        count.fill(0);
    }
    let mut reader = las::Reader::new(Cursor::new(bytes)).map_err(said)?;
    let points = reader.header().number_of_points();
    if points > MAX_POINTS as u64 {
        return Err(format!("{points} points; a scan has at most {MAX_POINTS}"));
    }
    let mut data = Vec::new();
    let mut is_timed = false;
    let mut left = points;
    while left > 0 {
        let batch = reader.read_points(left.min(BATCH)).map_err(said)?;
        let read = batch.len() as u64;
        if read == 0 {
            return Err(format!(
                "{} points, but the header says {points}",
                points - left
            ));
        }
        left -= read.min(left);
        is_timed = batch.gps_time().is_some();
        let mut times = batch.gps_time();
        let places = batch.x().zip(batch.y()).zip(batch.z());
        for (((x, y), z), intensity) in places.zip(batch.intensity()) {
            let time = times.as_mut().and_then(Iterator::next);
            let numbers = [x, y, z, f64::from(intensity)].into_iter().chain(time);
            data.extend(numbers.flat_map(f64::to_le_bytes));
        }
    }
    let names = ["x", "y", "z", "intensity", "gps_time"];
    let used = if is_timed { 5 } else { 4 };
    Ok(Packed::of_doubles(names.into_iter().take(used), data))
}
