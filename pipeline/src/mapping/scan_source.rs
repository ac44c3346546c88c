//! Where mapping has its scans from: the recording, or clouds that the odometry stored.

use lsfb_geometry::{RigLidar, Se3, Trajectory};
use lsfb_perception::lidar::KNOT_NS;
use lsfb_recording::Recording;
use lsfb_types::{LidarScan, Stamped, Timestamp};

use super::MappingConfig;
use crate::Error;
use crate::deskewed::Deskewed;
use crate::lidar_features::ScanFeatures;
use crate::stored_clouds::{StoredClouds, StoredScan};

/// Poses a scan is deskewed by: up to 0.2 s, the slowest revolution.
const SCAN_KNOTS: i64 = 40;

/// Scans of a walk.
#[derive(Clone, Copy)]
pub(super) enum ScanSource<'a> {
    /// As they were recorded.
    Recorded(&'a Recording),
    /// Deskewed and reduced.
    Stored(&'a StoredClouds),
}

/// One of them.
pub(super) enum TakenScan<'a> {
    Recorded(Stamped<LidarScan>),
    Stored(&'a StoredClouds, StoredScan),
}

impl<'a> ScanSource<'a> {
    /// All, in the order of their times.
    pub fn scans(
        self,
    ) -> Result<Box<dyn Iterator<Item = Result<TakenScan<'a>, lsfb_recording::Error>> + 'a>, Error>
    {
        Ok(match self {
            Self::Recorded(recording) => {
                let scans = recording.scans()?;
                Box::new(scans.map(|scan| scan.map(TakenScan::Recorded)))
            }
            Self::Stored(clouds) => {
                let scans = clouds.scans()?;
                Box::new(scans.map(|scan| scan.map(|scan| TakenScan::Stored(clouds, scan))))
            }
        })
    }
}

impl TakenScan<'_> {
    /// Its stamp.
    pub fn time(&self) -> Timestamp {
        match self {
            Self::Recorded(scan) => scan.time,
            Self::Stored(_, scan) => scan.time,
        }
    }

    /// Its features at one instant; `None` outside the trajectory.
    pub fn at_one_instant(
        &self,
        lidar: &RigLidar,
        trajectory: &Trajectory,
        config: &MappingConfig,
    ) -> Option<MiddleScan> {
        match self {
            Self::Recorded(scan) => deskewed(scan, lidar, trajectory, config),
            Self::Stored(clouds, scan) => Some(MiddleScan {
                time: scan.time,
                world_from_rig: trajectory.at(scan.time)?,
                features: clouds.features(scan),
            }),
        }
    }
}

/// A scan deskewed to its middle, or to its end where it was stored.
pub(super) struct MiddleScan {
    pub time: Timestamp,
    pub world_from_rig: Se3,
    pub features: ScanFeatures,
}

/// `None` outside the trajectory.
fn deskewed(
    scan: &Stamped<LidarScan>,
    lidar: &RigLidar,
    trajectory: &Trajectory,
    config: &MappingConfig,
) -> Option<MiddleScan> {
    let last = scan.sample.points.last().map_or(0, |p| p.time_offset_ns);
    let time = scan.time.plus_nanos(i64::from(last / 2));
    let offsets_ns = (0..=SCAN_KNOTS).map(|i| i * KNOT_NS);
    let deskewed = Deskewed::at(time, scan, lidar, trajectory, offsets_ns, &config.odometry)?;
    Some(MiddleScan {
        time,
        world_from_rig: deskewed.world_from_rig,
        features: ScanFeatures::extract(
            &deskewed.rings,
            &lidar.rig_from_lidar.translation,
            lidar.range_noise_m,
            &config.lidar_features,
        ),
    })
}
