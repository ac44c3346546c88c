//! Whether scans and poses belong together: a wrong trajectory smears walls, and puts them where other scans looked through.

use lsfb_geometry::Vector3;
use lsfb_types::{Finding, Limit, Verdict};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Surface;
use super::render::Sight;

/// A beam meets its surface where it ended if it does so within this, metres.
const SAME_M: f64 = 0.10;
/// Beams that are asked, at most: evenly taken.
const MOST_ASKED: usize = 100_000;
/// Fewer beams tell nothing.
const LEAST_ASKED: usize = 50;
/// Share of the beams that meet a surface elsewhere. In nine simulated places with the true trajectory up to 0.05, people and plants among
/// them; with one that is late by 0.1 s, drifts by 1 m, or is of another walk from 0.11 on (`docs/figures.md`).
const MOST_CONTRADICTED: f64 = 0.10;
const FAR_TOO_MANY: f64 = 0.30;
/// Share of the voxels on planes, likewise 0.69 and more, and up to 0.44.
const LEAST_ON_PLANES: f64 = 0.5;
/// Where so little lies on planes there is no surface left to ask beams about: 0.05 of walks that are a second late.
const HARDLY_ANY_PLANES: f64 = 0.15;

/// A beam of a scan in the world, at the pose that was given.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beam {
    pub sensor: Vector3<f64>,
    pub end: Vector3<f64>,
}

/// How well scans agree with one another at the poses that were given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Agreement {
    /// Share of the voxels with returns that lie on a plane.
    pub on_planes: f64,
    /// Beams, out of some of each scan, that meet a surface.
    pub beams: usize,
    /// Share of them that meet it farther than 10 cm from where they ended: they went through it, or end before it.
    pub contradicted: f64,
}

impl Agreement {
    /// Whether the poses are those of the scans.
    pub fn finding(&self) -> Finding {
        let smeared = self.on_planes < LEAST_ON_PLANES;
        let asked = self.beams >= LEAST_ASKED;
        let verdict = match self.contradicted {
            _ if self.on_planes < HARDLY_ANY_PLANES => Verdict::Fail,
            share if asked && (share > FAR_TOO_MANY || smeared && share > MOST_CONTRADICTED) => {
                Verdict::Fail
            }
            share => Verdict::Warn.unless(asked && !smeared && share <= MOST_CONTRADICTED),
        };
        let what = format!(
            "{:.0} % of {} beams that hit a surface end elsewhere, and {:.0} % of what the scans saw lies on planes",
            100.0 * self.contradicted,
            self.beams,
            100.0 * self.on_planes
        );
        Finding::new("scans-disagree", verdict, "trajectory", what)
            .value(100.0 * self.contradicted, "%")
            .limit(Limit::AtMost(100.0 * MOST_CONTRADICTED))
            .remedy("give the trajectory of this recording by `lsfb map --out-trajectory` or `lsfb odometry`, and check its clock and its frame")
    }
}

impl Surface {
    pub(super) fn agreement_with(&self, on_planes: f64, beams: &[Beam]) -> Agreement {
        let nth = beams.len().div_ceil(MOST_ASKED).max(1);
        let off_m: Vec<f64> = beams
            .par_iter()
            .step_by(nth)
            .filter_map(|beam| {
                let along = beam.end - beam.sensor;
                let length_m = along.norm();
                match self.sight(&beam.sensor, &(along / length_m))? {
                    Sight::Surface(reach_m, _) => Some((reach_m - length_m).abs()),
                    Sight::Unknown => None,
                }
            })
            .collect();
        let elsewhere = off_m.iter().filter(|m| **m > SAME_M).count();
        Agreement {
            on_planes,
            beams: off_m.len(),
            contradicted: elsewhere as f64 / off_m.len().max(1) as f64,
        }
    }
}
