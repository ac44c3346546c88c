//! Deskewed scans, reduced to what mapping needs of them, as a recording of their own.
//!
//! An MCAP of ours with the rig in it. `/<lidar>/points` has each scan that found its place, in the LiDAR's frame at one instant, as a rule its last firing (its stamp; times
//! of points are 0): means of short pieces of its rings. `/<lidar>_edges/points` has where its rings bend, three points for each: where the straight pieces meet, the middle
//! of the one before, and the middle of the one behind. The metadata record `lsfb.clouds` says what was found by which settings.
//! Reduction is described at [`SparseScan`].

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lsfb_geometry::{Rig, RigLidar, Se3, Trajectory, Vector3};
use lsfb_perception::lidar::KNOT_NS;
use lsfb_recording::{Recording, Writer, WriterConfig};
use lsfb_types::{LidarPoint, LidarScan, Progress, ProgressFn, Stamped, Timestamp};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::deskewed::Deskewed;
use crate::lidar_features::{LidarFeatureConfig, POINTS_PER_BEND, ScanFeatures, SparseScan};
use crate::odometry::{OdometryConfig, OdometryResult, scan_count};

/// Share of the points that is stored.
pub const STORED_SHARE: f64 = 0.2;
/// What the recording says of itself.
const METADATA: &str = "lsfb.clouds";
/// Added to a LiDAR's name, the name of its edges.
const EDGES: &str = "_edges";
/// Scans worked on at once: bounds the memory.
const BATCH: usize = 32;

/// What was stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StoredReport {
    /// Scans with a pose.
    pub scans: u64,
    /// Their points within the ranges that are used.
    pub points: u64,
    /// Points stored, those of edges included.
    pub stored: u64,
    /// Places where rings bend.
    pub bends: u64,
}

impl StoredReport {
    /// Share of the points that is stored.
    pub fn share(&self) -> f64 {
        self.stored as f64 / self.points.max(1) as f64
    }
}

/// How scans are stored.
#[derive(Clone, Debug, PartialEq)]
pub struct StoringConfig<'a> {
    /// Ranges that are used.
    pub odometry: &'a OdometryConfig,
    /// What is an edge.
    pub features: LidarFeatureConfig,
    /// Share of the points that is stored, from 0 to 1.
    pub share: f64,
    /// What scans are deskewed to.
    pub firing: Firing,
}

/// One firing of a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Firing {
    /// With which it begins.
    First,
    /// In the middle between the others, by time.
    Middle,
    /// With which it ends: the odometry's poses are of then.
    #[default]
    Last,
}

impl Firing {
    /// All there are.
    pub const ALL: [Self; 3] = [Self::First, Self::Middle, Self::Last];

    /// As it is written.
    pub fn key(self) -> &'static str {
        match self {
            Self::First => "first",
            Self::Middle => "middle",
            Self::Last => "last",
        }
    }

    /// When it is in a scan.
    fn of(self, scan: &Stamped<LidarScan>) -> Timestamp {
        let end = end_of(scan);
        match self {
            Self::First => scan.time,
            Self::Middle => scan.time.plus_nanos((end - scan.time) / 2),
            Self::Last => end,
        }
    }
}

/// Stores the scans of a recording that the odometry found a place for, deskewed by its trajectory. Written under another name first, so that a file by this name is
/// always whole.
pub fn store_clouds(
    recording: &Recording,
    odometry: &OdometryResult,
    config: &StoringConfig<'_>,
    path: &Path,
    progress: ProgressFn<'_>,
) -> Result<StoredReport, Error> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let partial = PathBuf::from(partial);
    let stored = store(recording, odometry, config, &partial, progress).and_then(|report| {
        std::fs::rename(&partial, path).map_err(Error::io(path))?;
        Ok(report)
    });
    if stored.is_err() {
        // What failed is the reason to tell.
        let _ = std::fs::remove_file(&partial);
    }
    stored
}

fn store(
    recording: &Recording,
    odometry: &OdometryResult,
    config: &StoringConfig<'_>,
    path: &Path,
    progress: ProgressFn<'_>,
) -> Result<StoredReport, Error> {
    let rig = recording.rig()?;
    let lidar = lidar_of(&rig)?;
    let name = recording.main_lidar();
    let mut writer = Writer::create(path, &WriterConfig::default())?;
    writer.attach_rig(&rig)?;
    writer.write_metadata(METADATA, settings(&config.features, config.share))?;
    let placed: Vec<Timestamp> = odometry.scan_poses.iter().map(|s| s.pose.time).collect();
    let mut report = StoredReport::default();
    let mut waiting: Vec<Stamped<LidarScan>> = Vec::new();
    let total = scan_count(recording);
    let mut flush = |waiting: &mut Vec<Stamped<LidarScan>>, done: u64| -> Result<(), Error> {
        let reduced: Vec<_> = waiting
            .par_iter()
            .map(|scan| {
                let time = config.firing.of(scan);
                let rings = deskewed(scan, time, lidar, &odometry.trajectory, config.odometry)?;
                let sensor = lidar.rig_from_lidar.translation;
                let noise_m = lidar.range_noise_m;
                let share = config.share;
                let reduced = SparseScan::of(&rings, &sensor, noise_m, &config.features, share);
                let points: usize = rings.iter().map(Vec::len).sum();
                Some((time, points as u64, reduced))
            })
            .collect();
        for (time, points, reduced) in reduced.into_iter().flatten() {
            let [surfaces, edges] = messages(&reduced, time, &lidar.rig_from_lidar);
            report.scans += 1;
            report.points += points;
            report.stored += (surfaces.sample.points.len() + edges.sample.points.len()) as u64;
            report.bends += reduced.bends.len() as u64;
            writer.write_scan(&name, &surfaces)?;
            writer.write_scan(&format!("{name}{EDGES}"), &edges)?;
        }
        waiting.clear();
        progress(Progress {
            stage: "storing clouds",
            done,
            total,
        })?;
        Ok(())
    };
    // Damaged ones were told by the odometry.
    for (done, scan) in (0..).zip(recording.scans()?.flatten()) {
        if placed.binary_search(&end_of(&scan)).is_ok() {
            waiting.push(scan);
        }
        if waiting.len() >= BATCH {
            flush(&mut waiting, done)?;
        }
    }
    flush(&mut waiting, total)?;
    writer.finish()?;
    Ok(report)
}

fn lidar_of(rig: &Rig) -> Result<&RigLidar, Error> {
    rig.lidar().ok_or_else(|| Error::SensorMissing {
        sensor: "LiDAR",
        rig: rig.name.clone(),
    })
}

/// Its last firing.
fn end_of(scan: &Stamped<LidarScan>) -> Timestamp {
    let offsets_ns = scan.sample.points.iter().map(|p| p.time_offset_ns);
    scan.time.plus_nanos(offsets_ns.max().unwrap_or(0).into())
}

/// The rings of a scan in the rig at `time`; `None` outside the trajectory.
fn deskewed(
    scan: &Stamped<LidarScan>,
    time: Timestamp,
    lidar: &RigLidar,
    trajectory: &Trajectory,
    config: &OdometryConfig,
) -> Option<Vec<Vec<Vector3<f64>>>> {
    let span_ns = end_of(scan) - scan.time;
    let steps = (0..=span_ns / KNOT_NS).map(|k| k * KNOT_NS);
    let offsets_ns = steps.chain([span_ns]);
    let deskewed = Deskewed::at(time, scan, lidar, trajectory, offsets_ns, config)?;
    Some(deskewed.rings)
}

/// Surfaces and edges, as messages have them.
fn messages(
    reduced: &SparseScan,
    time: Timestamp,
    rig_from_lidar: &Se3,
) -> [Stamped<LidarScan>; 2] {
    let lidar_from_rig = rig_from_lidar.inverse();
    let message = |points: Vec<(u16, Vector3<f64>)>| Stamped {
        time,
        arrival: time,
        device_ticks: 0,
        sample: LidarScan {
            points: points
                .into_iter()
                .map(|(ring, point)| LidarPoint {
                    position_m: (lidar_from_rig * point).map(|c| c as f32).into(),
                    ring,
                    ..LidarPoint::default()
                })
                .collect(),
        },
    };
    let bends = reduced.bends.iter();
    let bends = bends.flat_map(|(ring, bend)| bend.map(|point| (*ring, point)));
    [message(reduced.surfaces.clone()), message(bends.collect())]
}

/// By what edges were found, and how much was kept.
fn settings(features: &LidarFeatureConfig, share: f64) -> BTreeMap<String, String> {
    let entries = [
        ("edge_window_m", features.edge_window_m),
        ("min_crease_deg", features.min_crease_deg),
        ("share", share),
    ];
    let entries = entries.map(|(name, value)| (name.to_owned(), value.to_string()));
    BTreeMap::from(entries)
}

/// Clouds that were stored, to be mapped.
pub struct StoredClouds {
    recording: Recording,
    rig_from_lidar: Se3,
}

/// A scan that was stored.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredScan {
    /// When it is deskewed to.
    pub time: Timestamp,
    /// In the rig then.
    pub reduced: SparseScan,
}

impl StoredClouds {
    /// Opens what [`store_clouds`] wrote of the scans of `scan`; refused where it is damaged, of another rig, or its edges are others than these settings ask for.
    pub fn open(
        path: &Path,
        scan: &Recording,
        features: &LidarFeatureConfig,
        progress: ProgressFn<'_>,
    ) -> Result<Self, Error> {
        let refuse = |reason: String| Error::StoredClouds {
            path: PathBuf::from(path),
            reason,
        };
        let recording = Recording::open(path)?;
        let said = recording.metadata(METADATA).unwrap_or_default();
        if said.is_empty() {
            return Err(refuse(
                "these are not clouds of `lsfb odometry --out-clouds`".to_owned(),
            ));
        }
        for (name, value) in settings(features, 0.0) {
            match said.get(&name) {
                _ if name == "share" => {}
                Some(known) if *known == value => {}
                known => {
                    let known = known.map_or("nothing", String::as_str);
                    return Err(refuse(format!(
                        "its edges were found with {name} = {known}, but the settings say {value}: store the clouds again, or map without them"
                    )));
                }
            }
        }
        let damage = recording.verify(progress)?;
        if let Some(first) = damage.first() {
            let count = damage.len();
            return Err(refuse(format!(
                "it is damaged ({count} places, the first: {first}): store the clouds again"
            )));
        }
        let (rig, of_scan) = (recording.rig()?, scan.rig()?);
        let lidar = lidar_of(&rig)?;
        if lidar != lidar_of(&of_scan)? {
            return Err(refuse(format!(
                "its LiDAR differs from that of {}: store the clouds of this recording",
                scan.path().display()
            )));
        }
        Ok(Self {
            rig_from_lidar: lidar.rig_from_lidar,
            recording,
        })
    }

    /// Where they are.
    pub fn path(&self) -> &Path {
        self.recording.path()
    }

    /// How many scans there are.
    pub fn scan_count(&self) -> u64 {
        scan_count(&self.recording)
    }

    /// Fails where more than half of what should see these scans does not.
    pub(crate) fn expect_scans(&self, without: usize, of: usize) -> Result<(), Error> {
        if 2 * without <= of {
            return Ok(());
        }
        Err(Error::StoredClouds {
            path: self.path().to_owned(),
            reason: format!(
                "{without} of {of} keyframes have no scan: do these clouds belong to another recording, or did the odometry lose track?"
            ),
        })
    }

    /// The scans in the order of their times.
    pub fn scans(
        &self,
    ) -> Result<impl Iterator<Item = Result<StoredScan, lsfb_recording::Error>> + use<'_>, Error>
    {
        let name = self.recording.main_lidar();
        let mut edges = self
            .recording
            .scans_of(&format!("{name}{EDGES}"))?
            .flatten()
            .peekable();
        let surfaces = self.recording.scans_of(&name)?;
        Ok(surfaces.map(move |surfaces| {
            let surfaces = surfaces?;
            while edges.next_if(|e| e.time < surfaces.time).is_some() {}
            let edges = edges.next_if(|e| e.time == surfaces.time);
            let point = |p: &LidarPoint| {
                let in_lidar = Vector3::from(p.position_m.map(f64::from));
                (p.ring, self.rig_from_lidar * in_lidar)
            };
            let edges = edges.map_or_else(Vec::new, |e| e.sample.points);
            let bends = edges.chunks_exact(POINTS_PER_BEND).filter_map(|bend| {
                let points: Vec<_> = bend.iter().map(|p| point(p).1).collect();
                Some((bend.first()?.ring, points.try_into().ok()?))
            });
            Ok(StoredScan {
                time: surfaces.time,
                reduced: SparseScan {
                    surfaces: surfaces.sample.points.iter().map(point).collect(),
                    bends: bends.collect(),
                },
            })
        }))
    }

    /// What a scan adds to the keyframes around it.
    pub fn features(&self, scan: &StoredScan) -> ScanFeatures {
        scan.reduced.features(&self.rig_from_lidar.translation)
    }
}
