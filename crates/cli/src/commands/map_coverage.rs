//! Whether enough of a map is seen from everywhere on the way.

use lsfb_geometry::StampedPose;
use lsfb_pipeline::hd_map::HdMap;
use lsfb_pipeline::mapping::MappingReport;
use lsfb_types::{Finding, Limit, Verdict};

/// A keyframe with fewer observations of map points than this could hardly be found in its own map.
pub const MIN_OBSERVATIONS_PER_KEYFRAME: u64 = 30;

/// What every reader of a map should know: warnings of its odometry and its mapping, and where nobody would be found.
pub fn findings(map: &HdMap, report: &MappingReport) -> Vec<Finding> {
    let mut findings = report.findings();
    findings.push(coverage(map));
    findings
}

/// Whether enough of the map is seen from everywhere on the way.
pub fn coverage(map: &HdMap) -> Finding {
    Coverage::of(map).finding()
}

/// How many observations of map points each keyframe has.
pub struct Coverage {
    pub keyframes: Vec<StampedPose>,
    /// Of each keyframe.
    pub observations: Vec<u64>,
    /// Observations of each point.
    pub track_lengths: Vec<u64>,
    /// Keyframes that see too little.
    pub weak: Vec<StampedPose>,
}

impl Coverage {
    /// Of a map.
    pub fn of(map: &HdMap) -> Self {
        let keyframes: Vec<StampedPose> = map.keyframes().collect();
        let mut observations = vec![0; keyframes.len()];
        let mut track_lengths = vec![0; map.point_count()];
        for (point, length) in track_lengths.iter_mut().enumerate() {
            for seen in map.observations(point as u32) {
                *length += 1;
                if let Some(count) = observations.get_mut(seen.keyframe as usize) {
                    *count += 1;
                }
            }
        }
        let of_keyframe = keyframes.iter().zip(&observations);
        let is_weak = |(_, count): &(&StampedPose, &u64)| **count < MIN_OBSERVATIONS_PER_KEYFRAME;
        let weak = of_keyframe.filter(is_weak).map(|(pose, _)| *pose).collect();
        Self {
            keyframes,
            observations,
            track_lengths,
            weak,
        }
    }

    /// Whether enough of the map is seen from everywhere on the way.
    pub fn finding(&self) -> Finding {
        let (weak, all) = (self.weak.len(), self.keyframes.len());
        let limit = MIN_OBSERVATIONS_PER_KEYFRAME;
        match self.weak.first() {
            None => Finding::new(
                "coverage",
                Verdict::Pass,
                "coverage",
                format!("each of {all} keyframes sees at least {limit} map points"),
            ),
            Some(first) => {
                let place = first.world_from_rig.translation;
                Finding::new(
                    "coverage",
                    Verdict::Warn,
                    "coverage",
                    format!(
                        "{weak} of {all} keyframes see fewer than {limit} map points, the first at ({:.1}, {:.1}, {:.1})",
                        place.x, place.y, place.z
                    ),
                )
                .remedy("walk there more slowly, with light and texture in view; walks cannot be localized there")
            }
        }
        .value(weak as f64, "")
        .limit(Limit::AtMost(0.0))
    }
}
