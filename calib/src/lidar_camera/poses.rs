//! Poses of the board from folders of images and clouds, and from recordings.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lsfb_recording::{Recording, read_pcd};
use rayon::prelude::*;

use super::BoardPose;
use crate::Error;
use crate::camera::{CameraViews, last_number};
use crate::detect::Corner;

/// Joins a camera's views with the PCD files of a folder whose names begin with `prefix` and end with `suffix`: the last
/// number in a name says to which image it belongs.
pub fn poses_from_folder(
    views: &CameraViews,
    folder: &Path,
    prefix: &str,
    suffix: &str,
) -> Result<Vec<BoardPose>, Error> {
    let io = |source| Error::Io {
        path: folder.display().to_string(),
        source,
    };
    let mut clouds: BTreeMap<i64, PathBuf> = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let is_pcd = path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("pcd"));
        let inner = name
            .strip_prefix(prefix)
            .and_then(|n| n.strip_suffix(suffix));
        if !is_pcd || inner.is_none() {
            continue;
        }
        let Some(number) = last_number(&path) else {
            return Err(Error::Parse {
                path: path.display().to_string(),
                problem: "no number in its name: it says to which image the cloud belongs"
                    .to_owned(),
            });
        };
        if let Some(other) = clouds.insert(number, path.clone()) {
            return Err(Error::Parse {
                path: path.display().to_string(),
                problem: format!(
                    "has the same number as {}: name the ones that count with FOLDER/PREFIX*SUFFIX",
                    other.display()
                ),
            });
        }
    }
    let pairs: Vec<(i64, &PathBuf)> = clouds
        .iter()
        .filter(|(number, _)| views.views.contains_key(number))
        .map(|(number, path)| (*number, path))
        .collect();
    if pairs.is_empty() {
        return Err(Error::NotJoined {
            first: views.name.clone(),
            second: folder.display().to_string(),
            problem: format!(
                "{} images with the board and {} clouds, but none with the same number",
                views.views.len(),
                clouds.len()
            ),
        });
    }
    pairs
        .into_par_iter()
        .map(|(number, path)| {
            let scan = read_pcd(path).map_err(|e| Error::Parse {
                path: path.display().to_string(),
                problem: e.to_string(),
            })?;
            Ok(BoardPose {
                name: format!("{number:03}"),
                corners: views.views[&number].clone(),
                scan,
            })
        })
        .collect()
}

/// Corners of two views that show a pose apart from another, median distance in pixels.
const ANOTHER_POSE_PX: f64 = 20.0;
/// Corners that move by less between the images around a scan show a board at rest, median distance in pixels.
const AT_REST_PX: f64 = 1.0;
/// Images around a scan are at most this far from it, nanoseconds.
const BESIDE_NS: i64 = 150_000_000;

/// Scans of a recording during which the board was at rest in the camera's images, the stillest first, each of another pose,
/// `most` of them.
pub fn poses_from_recording(
    views: &CameraViews,
    recording: &Recording,
    most: usize,
) -> Result<Vec<BoardPose>, Error> {
    let unreadable = |e: lsfb_recording::Error| Error::Parse {
        path: recording.path().display().to_string(),
        problem: e.to_string(),
    };
    // First only when: a recording's scans do not fit in memory.
    let mut still: Vec<(f64, i64, i64)> = Vec::new();
    let mut count = 0;
    for scan in recording.scans().map_err(unreadable)? {
        let scan = scan.map_err(unreadable)?;
        count += 1;
        let start = scan.time.nanos();
        let length = scan.sample.points.iter().map(|p| p.time_offset_ns).max();
        let end = start.saturating_add(i64::from(length.unwrap_or(0)));
        let before = views.views.range(..=start).next_back();
        let after = views.views.range(end..).next();
        let (Some((t0, a)), Some((t1, b))) = (before, after) else {
            continue;
        };
        if start - t0 > BESIDE_NS || t1 - end > BESIDE_NS {
            continue;
        }
        if let Some(moved) = median_distance_px(a, b).filter(|m| *m < AT_REST_PX) {
            still.push((moved, start, if start - t0 < t1 - end { *t0 } else { *t1 }));
        }
    }
    still.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut chosen: BTreeMap<i64, i64> = BTreeMap::new();
    for (_, scan, image) in &still {
        let other = chosen.values().all(|seen| {
            median_distance_px(&views.views[seen], &views.views[image])
                .is_none_or(|d| d > ANOTHER_POSE_PX)
        });
        if other && chosen.len() < most {
            chosen.insert(*scan, *image);
        }
    }
    if chosen.is_empty() {
        return Err(Error::NotJoined {
            first: views.name.clone(),
            second: "lidar".to_owned(),
            problem: format!(
                "{count} scans and {} images with the board, but the board is never at rest: hold it still for two seconds in each pose",
                views.views.len()
            ),
        });
    }
    let mut poses = Vec::new();
    for scan in recording.scans().map_err(unreadable)? {
        let scan = scan.map_err(unreadable)?;
        if let Some(image) = chosen.get(&scan.time.nanos()) {
            poses.push(BoardPose {
                name: scan.time.to_string(),
                corners: views.views[image].clone(),
                scan: scan.sample,
            });
        }
    }
    Ok(poses)
}

/// Median distance of the corners that two views share; `None` where they share few.
fn median_distance_px(a: &[Corner], b: &[Corner]) -> Option<f64> {
    let places: BTreeMap<usize, _> = a.iter().map(|c| (c.index, c.pixel)).collect();
    let mut distances: Vec<f64> = b
        .iter()
        .filter_map(|c| Some((places.get(&c.index)? - c.pixel).norm()))
        .collect();
    distances.sort_by(f64::total_cmp);
    (distances.len() >= 8).then(|| distances[distances.len() / 2])
}
