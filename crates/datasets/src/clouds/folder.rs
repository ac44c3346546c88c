//! A folder of clouds, one file a scan.

use std::cell::Cell;
use std::path::{Path, PathBuf};

use lsfb_recording::cloud::{Cloud, PointTimes, TimesBegin};
use lsfb_recording::sort_naturally;
use lsfb_types::Timestamp;

use super::graph::{cloud_files, is_graph_folder, read_whole};
use super::{endings, format_of, read_cloud};
use crate::Error;

/// Files beside a folder or in it that list when its scans were taken, as KITTI has them.
const LISTS: [&str; 2] = ["times.txt", "timestamps.txt"];

/// Where the times of the scans of a folder come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScanTimes {
    /// Points carry readings of a clock.
    Points,
    /// The names of the files are times since an epoch.
    Names,
    /// A list beside the files.
    List,
    /// Nothing tells: so many scans a second, as was said.
    Rate,
}

/// One scan of a folder.
#[derive(Clone, Debug, PartialEq)]
pub struct FileScan {
    /// Its file.
    pub path: PathBuf,
    /// When the offsets of its points are zero.
    pub time: Timestamp,
    /// Its points.
    pub cloud: Cloud,
}

/// The clouds of a folder in order of name, with numbers by value.
#[derive(Debug)]
pub struct CloudFolder {
    files: Vec<PathBuf>,
    /// Whether they are those of gtsam_points, whose points are three numbers each.
    is_graph: bool,
    stamps: Vec<Timestamp>,
    /// Where the stamps come from, and whether points knew better.
    stamped_by: ScanTimes,
    points_told: Cell<bool>,
}

impl CloudFolder {
    /// Finds the clouds of a folder, whose scans are `rate_hz` a second where nothing tells when they were taken; or takes a single
    /// file.
    pub fn open(path: &Path, rate_hz: f64) -> Result<Self, Error> {
        let is_graph = path.is_dir() && is_graph_folder(path);
        let files = match path.is_dir() {
            true if is_graph => expect_clouds(cloud_files(path)?, path)?,
            true => clouds_in(path)?,
            false => vec![path.to_owned()],
        };
        let stems = files.iter().map(|f| format_of(f).map(|(_, stem)| stem));
        let by_name: Option<Vec<Timestamp>> = stems.map(|stem| named_time(&stem?)).collect();
        let (stamps, stamped_by) = if let Some(stamps) = by_name {
            (stamps, ScanTimes::Names)
        } else if let Some(stamps) = listed(path, files.len()) {
            (stamps, ScanTimes::List)
        } else {
            let by_rate = |i| Timestamp::from_secs_f64(i as f64 / rate_hz);
            ((0..files.len()).map(by_rate).collect(), ScanTimes::Rate)
        };
        Ok(Self {
            files,
            is_graph,
            stamps,
            stamped_by,
            points_told: Cell::new(false),
        })
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.files.len()
    }

    /// Whether there is none: never so.
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }

    /// The scans, each read when its turn comes. One that is not later than the one before it is an error.
    pub fn scans(&self) -> impl Iterator<Item = Result<FileScan, Error>> + '_ {
        let mut last: Option<Timestamp> = None;
        self.files
            .iter()
            .zip(&self.stamps)
            .map(move |(path, stamp)| {
                let cloud = match self.is_graph {
                    true => read_whole(path)?,
                    false => read_cloud(path)?,
                };
                let time = match &cloud.times {
                    // A clock that counts from anything but 1970 is not that of names or of a list, and better than a rate.
                    PointTimes::Field { begins, .. } => match (begins, begins.since_1970()) {
                        (_, Some(time)) => self.told_by_points(time),
                        (TimesBegin::At(time), None) if self.stamped_by == ScanTimes::Rate => {
                            self.told_by_points(*time)
                        }
                        _ => cloud.times.begins(*stamp),
                    },
                    PointTimes::Absent | PointTimes::Unusable { .. } => *stamp,
                };
                if last.is_some_and(|last| time <= last) {
                    return Err(Error::CloudOrder { path: path.clone() });
                }
                last = Some(time);
                Ok(FileScan {
                    path: path.clone(),
                    time,
                    cloud,
                })
            })
    }

    fn told_by_points(&self, time: Timestamp) -> Timestamp {
        self.points_told.set(true);
        time
    }

    /// Where the times of the scans come from: of those that were read so far.
    pub fn scan_times(&self) -> ScanTimes {
        match self.points_told.get() {
            true => ScanTimes::Points,
            false => self.stamped_by,
        }
    }
}

fn clouds_in(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let io = |source| Error::Io {
        path: folder.to_owned(),
        source,
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if path.is_file() && format_of(&path).is_some() {
            files.push(path);
        }
    }
    sort_naturally(&mut files);
    expect_clouds(files, folder)
}

fn expect_clouds(files: Vec<PathBuf>, folder: &Path) -> Result<Vec<PathBuf>, Error> {
    if files.is_empty() {
        return Err(Error::NoClouds {
            path: folder.to_owned(),
            endings: endings(),
        });
    }
    Ok(files)
}

/// The time that a name is: nanoseconds, microseconds or milliseconds since 1970 by its digits, or seconds with a point.
fn named_time(stem: &str) -> Option<Timestamp> {
    let (seconds, fraction) = match stem.split_once('.') {
        Some(parts) => parts,
        None => (stem.get(..10)?, stem.get(10..)?),
    };
    let digits = |text: &str| text.bytes().all(|b| b.is_ascii_digit());
    let known = match stem.contains('.') {
        true => (1..=9).contains(&fraction.len()),
        false => matches!(fraction.len(), 3 | 6 | 9),
    };
    // Seconds of ten digits are the years 2001 to 2286; nine digits of a GPS clock are not taken for a count of scans either.
    let epoch = seconds.len() == 10 && !seconds.starts_with('0');
    if !(known && epoch && digits(seconds) && digits(fraction)) {
        return None;
    }
    let nanos: i64 = format!("{fraction:0<9}").parse().ok()?;
    let seconds: i64 = seconds.parse().ok()?;
    Some(Timestamp::from_nanos(
        seconds.checked_mul(1_000_000_000)?.checked_add(nanos)?,
    ))
}

/// Times of a list with as many lines as there are files: seconds, or a date and a time of day.
fn listed(folder: &Path, files: usize) -> Option<Vec<Timestamp>> {
    let above = folder.parent();
    let places = [Some(folder), above].into_iter().flatten();
    let lists = places.flat_map(|place| LISTS.map(|name| place.join(name)));
    let texts = lists.filter_map(|path| std::fs::read_to_string(path).ok());
    texts
        .filter_map(|text| {
            let lines = text.lines().filter(|line| !line.trim().is_empty());
            lines.map(listed_time).collect::<Option<Vec<_>>>()
        })
        .find(|times| times.len() == files)
}

fn listed_time(line: &str) -> Option<Timestamp> {
    let words: Vec<&str> = line.split_whitespace().collect();
    match words.as_slice() {
        [seconds] => {
            let seconds: f64 = seconds.parse().ok()?;
            (0.0..1e10)
                .contains(&seconds)
                .then(|| Timestamp::from_secs_f64(seconds))
        }
        [date, clock] => {
            let numbers = |text: &str, by: char| -> Option<[f64; 3]> {
                let numbers = text.split(by).map(|w| w.parse().ok());
                numbers.collect::<Option<Vec<f64>>>()?.try_into().ok()
            };
            let [year, month, day] = numbers(date, '-')?;
            let [hours, minutes, seconds] = numbers(clock, ':')?;
            let in_day_s = hours * 3600.0 + minutes * 60.0 + seconds;
            let days = days_since_1970(year as i64, month as i64, day as i64)?;
            Some(Timestamp::from_nanos(days * 86_400_000_000_000).plus_secs(in_day_s))
        }
        _ => None,
    }
}

/// Days from 1 January 1970 of a day of the Gregorian calendar.
fn days_since_1970(year: i64, month: i64, day: i64) -> Option<i64> {
    if !((1970..2300).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day)) {
        return None;
    }
    // Years begin in March, so that the day that some years have more is their last.
    let (year, month) = if month > 2 {
        (year, month - 3)
    } else {
        (year - 1, month + 9)
    };
    let leap_days = year / 4 - year / 100 + year / 400;
    Some(year * 365 + leap_days + (month * 153 + 2) / 5 + day - 1 - 719_468)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_lists_that_are_times_are_read() {
        let at = |nanos| Some(Timestamp::from_nanos(nanos));
        assert_eq!(
            named_time("1644823432123456789"),
            at(1_644_823_432_123_456_789)
        );
        assert_eq!(named_time("1644823432.5"), at(1_644_823_432_500_000_000));
        assert_eq!(
            named_time("1644823432123456"),
            at(1_644_823_432_123_456_000)
        );
        for counted in [
            "0000000017",
            "17",
            "scan_3",
            "00000000000000000017",
            "1644823432",
        ] {
            assert_eq!(named_time(counted), None, "{counted}");
        }
        let found = listed_time("2011-09-26 13:02:25.951199337").expect("a time");
        let expected = Timestamp::from_nanos(1_317_042_145_951_199_337);
        assert!(found.secs_since(expected).abs() < 1e-6);
        assert_eq!(listed_time("1.036224e-01"), at(103_622_400));
        assert_eq!(days_since_1970(2000, 3, 1), Some(11_017));
    }
}
