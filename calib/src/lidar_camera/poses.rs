//! Poses of the board from folders of images and clouds, and from recordings.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lsfb_datasets::read_cloud;
use lsfb_recording::Recording;
use rayon::prelude::*;

use super::{BoardPose, BoardSight};
use crate::camera::{CameraViews, last_number};
use crate::copies::copies;
use crate::detect::Corner;
use crate::{Error, JoinProblem};
use lsfb_perception::statistics::median;

/// Fails where the board is in no image at all.
fn seen_at_all(views: &CameraViews) -> Result<(), Error> {
    if !views.views.is_empty() {
        return Ok(());
    }
    Err(Error::NotJoined {
        first: views.name.clone(),
        second: "lidar".to_owned(),
        cause: JoinProblem::NotSeen {
            images: views.images,
        },
    })
}

/// Joins a camera's views with the PCD files of a folder whose names begin with `prefix` and end with `suffix`: the last
/// number in a name says to which image it belongs.
pub fn poses_from_folder(
    views: &CameraViews,
    folder: &Path,
    prefix: &str,
    suffix: &str,
) -> Result<Vec<BoardPose>, Error> {
    seen_at_all(views)?;
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
                problem: "its name has no number, which says to which image the cloud belongs"
                    .to_owned(),
            });
        };
        if let Some(other) = clouds.insert(number, path.clone()) {
            return Err(Error::Parse {
                path: path.display().to_string(),
                problem: format!(
                    "has the same number as {}: select one of them with FOLDER/PREFIX*SUFFIX",
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
            cause: JoinProblem::NoSameNumber {
                images: views.views.len(),
                clouds: clouds.len(),
            },
        });
    }
    pairs
        .into_par_iter()
        .map(|(number, path)| {
            let cloud = read_cloud(path)?;
            Ok(BoardPose {
                name: format!("{number:03}"),
                sights: vec![BoardSight {
                    instant: number,
                    time_offset_ns: 0,
                    corners: views.views[&number].clone(),
                }],
                scan: cloud.scan,
            })
        })
        .collect()
}

/// How poses are taken from a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordingConfig {
    /// Poses taken at most, the stillest ones.
    pub most: usize,
    /// Added to the camera's stamps it gives the LiDAR's time, seconds.
    pub rig_from_camera_s: f64,
}

/// Corners of two views that show a pose apart from another, median distance in pixels.
const ANOTHER_POSE_PX: f64 = 20.0;
/// Corners that move by less between the images around a scan show a board at rest, median distance in pixels.
const AT_REST_PX: f64 = 1.0;
/// Motion between the images around a scan beyond which it is not followed well enough, as a share of the image's width.
const MOST_MOTION: f64 = 0.06;
/// Images around a scan are at most this far from it, nanoseconds.
const BESIDE_NS: i64 = 150_000_000;

/// A scan with the images around it.
struct Around {
    moved_px: f64,
    scan_ns: i64,
    /// Stamps of the images from the last before the scan to the first after it, and one more on either side, where there is one:
    /// so the motion between them is known better.
    images_ns: Vec<i64>,
}

/// Scans of a recording with the board in the images around them, the stillest first, each of another pose. A board that is
/// held still is best; a rig that is moved slowly before a board, or the other way round, will do.
pub fn poses_from_recording(
    views: &CameraViews,
    recording: &Recording,
    config: &RecordingConfig,
) -> Result<Vec<BoardPose>, Error> {
    seen_at_all(views)?;
    let unreadable = |e: lsfb_recording::Error| Error::Parse {
        path: recording.path().display().to_string(),
        problem: e.to_string(),
    };
    let offset_ns = (config.rig_from_camera_s * 1e9).round() as i64;
    // First only when: a recording's scans do not fit in memory.
    let mut around: Vec<Around> = Vec::new();
    let mut scans = 0;
    for scan in recording.scans().map_err(unreadable)? {
        let scan = scan.map_err(unreadable)?;
        scans += 1;
        let start = scan.time.nanos() - offset_ns;
        let length = scan.sample.points.iter().map(|p| p.time_offset_ns).max();
        let end = start.saturating_add(i64::from(length.unwrap_or(0)));
        around.extend(
            images_around(views, [start, end]).map(|(moved_px, images_ns)| Around {
                moved_px,
                scan_ns: scan.time.nanos(),
                images_ns,
            }),
        );
    }
    let chosen = stillest(views, &mut around, config.most);
    if chosen.is_empty() {
        let (seen, images) = (views.views.len(), views.images);
        let cause = match around.is_empty() {
            true => JoinProblem::NoSameTime {
                scans,
                seen,
                images,
            },
            false => JoinProblem::AlwaysMoving { scans, seen },
        };
        return Err(Error::NotJoined {
            first: views.name.clone(),
            second: "lidar".to_owned(),
            cause,
        });
    }
    let mut poses = Vec::new();
    for scan in recording.scans().map_err(unreadable)? {
        let scan = scan.map_err(unreadable)?;
        let Some(images) = chosen.get(&scan.time.nanos()) else {
            continue;
        };
        let sights = images.iter().map(|image| BoardSight {
            instant: *image,
            time_offset_ns: image + offset_ns - scan.time.nanos(),
            corners: views.views[image].clone(),
        });
        poses.push(BoardPose {
            name: scan.time.to_string(),
            sights: sights.collect(),
            scan: scan.sample,
        });
    }
    Ok(poses)
}

/// Stamps of the images around a span of time, and how far the board moved between them, pixels.
fn images_around(views: &CameraViews, [start, end]: [i64; 2]) -> Option<(f64, Vec<i64>)> {
    let (first, _) = views.views.range(..=start).next_back()?;
    let (last, _) = views.views.range(end..).next()?;
    if start - first > BESIDE_NS || last - end > BESIDE_NS {
        return None;
    }
    let before = views.views.range(..first).next_back().map(|v| *v.0);
    let after = views.views.range(last + 1..).next().map(|v| *v.0);
    let stamps: Vec<i64> = before
        .filter(|b| first - b < BESIDE_NS)
        .into_iter()
        .chain(views.views.range(first..=last).map(|v| *v.0))
        .chain(after.filter(|a| a - last < BESIDE_NS))
        .collect();
    let moved_px = median_distance_px(&views.views[first], &views.views[last])?;
    Some((moved_px, stamps))
}

/// By scan: its images; one of them where the board was at rest.
fn stillest(views: &CameraViews, around: &mut [Around], most: usize) -> BTreeMap<i64, Vec<i64>> {
    around.sort_by(|a, b| {
        let stiller = a.moved_px.total_cmp(&b.moved_px);
        stiller.then(a.scan_ns.cmp(&b.scan_ns))
    });
    let mut chosen: BTreeMap<i64, Vec<i64>> = BTreeMap::new();
    for a in around.iter() {
        let middle = a.images_ns[a.images_ns.len() / 2];
        let another = |seen: &Vec<i64>| {
            let other = seen[seen.len() / 2];
            median_distance_px(&views.views[&other], &views.views[&middle])
                .is_none_or(|d| d > ANOTHER_POSE_PX)
        };
        let slow = a.moved_px < MOST_MOTION * f64::from(views.width);
        if chosen.len() < most && slow && chosen.values().all(another) {
            let images = if a.moved_px < AT_REST_PX {
                vec![middle]
            } else {
                a.images_ns.clone()
            };
            chosen.insert(a.scan_ns, images);
        }
    }
    chosen
}

/// Median distance of the corners that two views share; `None` where they share few.
fn median_distance_px(a: &[Corner], b: &[Corner]) -> Option<f64> {
    let places: BTreeMap<usize, _> = a.iter().map(|c| (c.index, c.pixel)).collect();
    let distances: Vec<f64> = b
        .iter()
        .filter_map(|c| Some((places.get(&c.index)? - c.pixel).norm()))
        .collect();
    match distances.len() {
        8.. => median(distances),
        _ => None,
    }
}

/// Poses with the images of earlier ones, and of which. Scans that follow each other may lie between the same images: such are poses of
/// their own.
pub(super) fn copied(poses: &[&BoardPose]) -> BTreeMap<usize, usize> {
    let corners: Vec<Vec<Corner>> = poses
        .iter()
        .map(|pose| {
            pose.sights
                .iter()
                .flat_map(|s| &s.corners)
                .copied()
                .collect()
        })
        .collect();
    let views = corners.iter().enumerate();
    copies(views.map(|(k, corners)| (k, corners.as_slice())))
        .into_iter()
        .filter(|(k, first)| {
            let (pose, first) = (poses[*k], poses[*first]);
            pose.sights.len() == 1 || pose.scan == first.scan
        })
        .collect()
}
