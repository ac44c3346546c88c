//! Control points: marks whose places in a site's frame were surveyed, and that somebody clicked in images.
//!
//! Once the map rests without them, each mark is placed by its clicks, and the survey is held against these places
//! (`snooping`): a blundered mark is named before anything is bent. Those that agree become terms of Eq. (4), a point each that is seen where it was clicked and lies
//! where it was surveyed, through a transform from the map's world to the site that is searched as well. Images between keyframes have the pose that the trajectory
//! has there, so that marks pull where they were seen.

mod prepared;
mod report;
mod snooping;
#[cfg(test)]
mod tests;

use lsfb_geometry::Vector3;
use lsfb_types::Bounds;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::hd_map::{Click, ControlPoint, MarkConfig};
use crate::{Error, Refusal};

pub(super) use prepared::{ControlBlocks, ControlTerms, Hold, Marks, SolvedControl, add_control};
pub use report::{ControlMark, ControlReport};

/// Fewer do not say how a map lies in a site.
const FEWEST: usize = 3;
/// So many tell by how much a map is worse known than it says.
const TELLING: usize = 5;
/// The share of the largest factor that fewer are believed.
const SHARE_OF_FEW: f64 = 0.2;
/// Marks whose distances from one line are less than this share of those along it leave the turn about it free.
const LEAST_WIDTH: f64 = 0.02;
/// Coordinates beyond this are shifted to near zero, by whole kilometres: single precision knows 1 mm there.
const LARGE_M: f64 = 1e4;
const SHIFT_STEP_M: f64 = 1e3;

/// How control points hold a map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControlConfig {
    /// How well marks are clicked, pixels in each direction, 1 σ; where the clicks scatter more, that is taken.
    pub click_sigma_px: f64,
    /// A control point that is so many standard deviations from where the others have it is a blunder, and does not hold the map.
    pub blunder_sigmas: f64,
    /// A map may be so many times worse known than it says of itself, where five control points and more agree that it is (with fewer a fifth of that); beyond, they do
    /// not hold it at all: there is more wrong than single marks.
    pub max_map_factor: f64,
}

impl Default for ControlConfig {
    fn default() -> Self {
        Self {
            click_sigma_px: MarkConfig::default().click_sigma_px,
            blunder_sigmas: 5.0,
            max_map_factor: 20.0,
        }
    }
}

lsfb_types::bounds! {
    ControlConfig {
        click_sigma_px: number(Bounds::POSITIVE),
        blunder_sigmas: number(Bounds::POSITIVE),
        max_map_factor: number(Bounds::AT_LEAST_ONE),
    }
}

/// Surveyed marks and the clicks on them.
#[derive(Clone, Debug)]
pub struct Control {
    points: Vec<ControlPoint>,
    clicks: Vec<Click>,
    origin_m: Vector3<f64>,
}

impl Control {
    /// The control points that were clicked twice or more; clicks on other marks are left aside. Fewer than three, or such that lie on one line,
    /// do not say how a map lies in the site, and are an error that says so.
    pub fn new(points: Vec<ControlPoint>, clicks: &[Click]) -> Result<Self, Error> {
        let count = |point: &ControlPoint| clicks.iter().filter(|c| c.mark == point.mark).count();
        let all = points.len();
        let points: Vec<ControlPoint> = points.into_iter().filter(|p| count(p) >= 2).collect();
        if points.len() < FEWEST {
            return Err(Refusal::FewControlPoints {
                clicked: points.len(),
                all,
                needed: FEWEST,
            }
            .into());
        }
        let places: Vec<Vector3<f64>> = points.iter().map(|p| p.place_m).collect();
        let [length_m, width_m] = extent_m(&places);
        if width_m < LEAST_WIDTH * length_m || length_m == 0.0 {
            return Err(Refusal::ControlPointsOnALine {
                count: points.len(),
                width_m,
                length_m,
            }
            .into());
        }
        let middle = places.iter().sum::<Vector3<f64>>() / places.len() as f64;
        let shift = |m: f64| match m.abs() > LARGE_M {
            true => (m / SHIFT_STEP_M).round() * SHIFT_STEP_M,
            false => 0.0,
        };
        let is_control = |click: &&Click| points.iter().any(|p| p.mark == click.mark);
        Ok(Self {
            clicks: clicks.iter().filter(is_control).cloned().collect(),
            points,
            origin_m: middle.map(shift),
        })
    }
}

impl Control {
    /// Adds all of it to a hash of what a map is made from.
    pub(super) fn add_to(&self, hash: &mut Sha256) {
        let numbers = |values: &[f64], hash: &mut Sha256| {
            values.iter().for_each(|v| hash.update(v.to_le_bytes()));
        };
        for point in &self.points {
            hash.update(&point.mark);
            numbers(point.place_m.as_slice(), hash);
            numbers(point.sigmas_m.as_slice(), hash);
        }
        for click in &self.clicks {
            hash.update(&click.mark);
            hash.update(&click.camera);
            hash.update(click.time.nanos().to_le_bytes());
            numbers(click.pixel.as_slice(), hash);
        }
    }
}

/// Root mean square distances of points along their longest axis and along the next.
fn extent_m(places: &[Vector3<f64>]) -> [f64; 2] {
    let count = places.len().max(1) as f64;
    let middle = places.iter().sum::<Vector3<f64>>() / count;
    let mut spread = DMatrix::zeros(3, 3);
    for place in places {
        let off = place - middle;
        spread += off * off.transpose() / count;
    }
    let mut axes: Vec<f64> = spread.symmetric_eigenvalues().iter().copied().collect();
    axes.sort_by(|a, b| b.total_cmp(a));
    [axes[0], axes[1]].map(|square| square.max(0.0).sqrt())
}
