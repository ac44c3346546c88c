//! Places that somebody marked in images of a map, and the distances between them (Table II of the paper).
//!
//! The pixels are somebody's clicks: nothing of the map was made from them, so that distances between them, held against a tape, judge it.

mod file;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use lsfb_geometry::{Matrix3, Matrix6, RigCamera, Se3, Trajectory, Vector2, Vector3, so3};
use lsfb_types::{Bounds, Finding, Timestamp, Verdict};
use serde::{Deserialize, Serialize};

use super::HdMap;
use crate::features::triangulation::{
    TriangulatedPoint, TriangulationConfig, TriangulationFailure, View, triangulate,
};
use crate::worst_sigma::worst_sigma;

pub use file::{read_clicks, read_control_points};

/// An image and a keyframe are of one moment when their times differ by less, nanoseconds.
pub(crate) const SAME_MOMENT_NS: i64 = 1_000_000;
/// Clicks farther from where the others have the mark, in standard deviations of a click, are of something else.
pub(crate) const FAR_CLICK_SIGMAS: f64 = 6.0;
/// Rays that meet at a smaller angle give no distance, degrees.
const MIN_PARALLAX_DEG: f64 = 1.5;
/// Any two rays that meet agree along them: with three, a wrong click is seen.
const CHECKED_CLICKS: usize = 3;

/// A pixel in which somebody saw a mark.
#[derive(Clone, Debug, PartialEq)]
pub struct Click {
    /// Name of the mark.
    pub mark: String,
    /// Name of the camera on the rig.
    pub camera: String,
    /// Stamp of the image.
    pub time: Timestamp,
    /// Where, pixels.
    pub pixel: Vector2<f64>,
}

/// A mark whose place in a site's frame somebody surveyed.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlPoint {
    /// Name of the mark.
    pub mark: String,
    /// Where it is in the frame of the site, whose z points upwards, metres.
    pub place_m: Vector3<f64>,
    /// Standard deviation of that along each axis, metres.
    pub sigmas_m: Vector3<f64>,
}

/// How marks are placed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MarkConfig {
    /// How well somebody clicks, pixels in each direction, 1 σ; where the clicks scatter more, that is taken.
    pub click_sigma_px: f64,
}

impl Default for MarkConfig {
    fn default() -> Self {
        Self {
            click_sigma_px: 0.5,
        }
    }
}

lsfb_types::bounds! {
    MarkConfig {
        click_sigma_px: number(Bounds::POSITIVE),
    }
}

/// A mark in the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlacedMark {
    /// Its name.
    pub name: String,
    /// Where it is in the map's world, in the map's unit (metres).
    pub place_m: [f64; 3],
    /// What the scatter of clicks says of that, and what the covariance of the keyframes that saw it adds, relative to the first keyframe of the map:
    /// in the map's unit, squared, row by row.
    pub covariance_m2: [[f64; 3]; 3],
    /// Whether that of the keyframes is in it: unknown in maps whose poses were given, or that were merged.
    pub with_poses: bool,
    /// Clicks that agree.
    pub clicks: usize,
    /// Clicks that do not, and are left out.
    pub left_out: usize,
    /// Root mean square distance of the clicks from where the mark is seen, pixels.
    pub reprojection_rms_px: f64,
    /// Largest angle between two of the rays, degrees.
    pub parallax_deg: f64,
}

/// A mark that has no place.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnplacedMark {
    /// Its name.
    pub name: String,
    /// Why.
    pub reason: String,
}

/// Marks in a map.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlacedMarks {
    /// By name.
    pub marks: Vec<PlacedMark>,
    /// Those that have no place.
    pub unplaced: Vec<UnplacedMark>,
    /// Clicks in images of which neither map nor trajectory knows the pose, or of cameras that the map does not have.
    pub clicks_without_pose: usize,
    /// How well was clicked, pixels in each direction, 1 σ.
    pub click_sigma_px: f64,
}

impl PlacedMarks {
    /// Marks without a place, and clicks that say less than they could.
    pub fn findings(&self) -> Vec<Finding> {
        let unplaced = self.unplaced.iter().map(|mark| {
            let what = format!("could not be placed: {}", mark.reason);
            Finding::new("mark-unplaced", Verdict::Warn, &*mark.name, what)
                .remedy("click it again, in three images or more, from several sides")
        });
        let clicked = self.marks.iter().flat_map(|mark| {
            let found = [mark.left_out_clicks(), mark.unchecked()];
            found.into_iter().flatten()
        });
        let without_pose = (self.clicks_without_pose > 0).then(|| {
            let what = format!(
                "{} clicks are in images without a known pose, or of a camera that the map does not have",
                self.clicks_without_pose
            );
            Finding::new("clicks-without-pose", Verdict::Warn, "marks", what).remedy(
                "give the trajectory of the map (--trajectory), or click in images of its keyframes",
            )
        });
        unplaced.chain(clicked).chain(without_pose).collect()
    }
}

impl PlacedMark {
    fn left_out_clicks(&self) -> Option<Finding> {
        let what = format!(
            "{} of its {} clicks disagree with the others and are not used",
            self.left_out,
            self.left_out + self.clicks
        );
        let finding = Finding::new("mark-clicks", Verdict::Warn, &*self.name, what)
            .remedy("check the clicks in those images; if they are right, the map is bent there");
        (self.left_out > 0).then_some(finding)
    }

    fn unchecked(&self) -> Option<Finding> {
        let what = "has only two clicks: a wrong one would not be noticed";
        let finding = Finding::new("mark-unchecked", Verdict::Warn, &*self.name, what)
            .remedy("click it in a third image");
        (!self.is_checked()).then_some(finding)
    }

    /// Standard deviation in the direction in which its place is known worst.
    pub fn worst_sigma_m(&self) -> f64 {
        worst_sigma(&self.covariance())
    }

    /// Whether a click on something else would have been seen.
    pub fn is_checked(&self) -> bool {
        self.clicks >= CHECKED_CLICKS
    }

    /// Distance to another mark and its standard deviation. What both places have in common (they stand in one map) is not taken off, so that of
    /// marks near to one another it is too large.
    pub fn distance_to(&self, other: &Self) -> [f64; 2] {
        let between = Vector3::from(other.place_m) - Vector3::from(self.place_m);
        let Some(along) = between.try_normalize(0.0) else {
            return [0.0, self.worst_sigma_m().hypot(other.worst_sigma_m())];
        };
        let variance = along.dot(&((self.covariance() + other.covariance()) * along));
        [between.norm(), variance.max(0.0).sqrt()]
    }

    /// It is symmetric: rows are columns.
    fn covariance(&self) -> Matrix3<f64> {
        Matrix3::from(self.covariance_m2)
    }
}

/// A click whose image has a pose.
struct Sight<'a> {
    mounted: &'a RigCamera,
    world_from_rig: Se3,
    /// Of that pose, `[rotation, translation]` in its tangent; `None` where it is unknown.
    covariance: Option<Matrix6<f64>>,
    pixel: Vector2<f64>,
}

/// A mark before it is known how well was clicked.
struct Met {
    name: String,
    place: Vector3<f64>,
    /// Σ Jᵀ J, px² per unit².
    information: Matrix3<f64>,
    /// What the poses add to the covariance.
    of_poses: Option<Matrix3<f64>>,
    squares_px2: f64,
    clicks: usize,
    left_out: usize,
    parallax_rad: f64,
}

impl HdMap {
    /// Places marks by the clicks on them: in images of keyframes, and with a trajectory in the map's world in any image within it.
    pub fn place_marks(
        &self,
        clicks: &[Click],
        trajectory: Option<&Trajectory>,
        config: &MarkConfig,
    ) -> PlacedMarks {
        let mut placed = PlacedMarks::default();
        let mut sights: BTreeMap<&str, Vec<Sight>> = BTreeMap::new();
        let times = self.keyframe_times();
        for click in clicks {
            let of_mark = sights.entry(&click.mark).or_default();
            match self.sight(click, &times, trajectory) {
                Some(sight) => of_mark.push(sight),
                None => placed.clicks_without_pose += 1,
            }
        }
        let mut met = Vec::new();
        for (name, sights) in sights {
            match meet(name, &sights, config) {
                Ok(mark) => met.push(mark),
                Err(reason) => placed.unplaced.push(UnplacedMark {
                    name: name.to_owned(),
                    reason,
                }),
            }
        }
        // Two numbers a click, three are spent on the place of a mark.
        let (squares, spare) = met.iter().fold((0.0, 0), |(squares, spare), m| {
            (squares + m.squares_px2, spare + 2 * m.clicks - 3)
        });
        let scatter_px = (squares / f64::max(spare as f64, 1.0)).sqrt();
        let sigma_px = scatter_px.max(config.click_sigma_px);
        placed.click_sigma_px = sigma_px;
        placed.marks = met.into_iter().filter_map(|m| m.placed(sigma_px)).collect();
        placed
    }

    /// Times of the keyframes with their numbers, in order of time.
    fn keyframe_times(&self) -> Vec<(Timestamp, u32)> {
        let mut times: Vec<_> = self.keyframes().map(|k| k.time).zip(0..).collect();
        times.sort_unstable();
        times
    }

    fn sight(
        &self,
        click: &Click,
        times: &[(Timestamp, u32)],
        trajectory: Option<&Trajectory>,
    ) -> Option<Sight<'_>> {
        let mounted = self.rig().cameras.get(&click.camera)?;
        let offset_ns = (mounted.timing.rig_from_camera_s * 1e9).round() as i64;
        let time = click.time + offset_ns;
        let after = times.partition_point(|(t, _)| *t < time);
        let around = [after.checked_sub(1), Some(after)];
        let around = around.into_iter().flatten().filter_map(|i| times.get(i));
        let (nearest, keyframe) = *around.min_by_key(|(t, _)| (*t - time).abs())?;
        // Merged maps of images without times have stamps twice: which of them is meant?
        let alike = times[times.partition_point(|(t, _)| *t < nearest)..].iter();
        let is_only = alike.take_while(|(t, _)| *t == nearest).count() == 1;
        let world_from_rig = match (nearest - time).abs() < SAME_MOMENT_NS {
            true => is_only.then(|| self.keyframe(keyframe))??.world_from_rig,
            false => trajectory?.at(time)?,
        };
        Some(Sight {
            mounted,
            world_from_rig,
            // Between two keyframes the trajectory follows them.
            covariance: self.keyframe_covariance(keyframe),
            pixel: click.pixel,
        })
    }
}

fn meet(name: &str, sights: &[Sight], config: &MarkConfig) -> Result<Met, String> {
    let views: Vec<View> = sights
        .iter()
        .map(|s| View {
            camera: &s.mounted.camera,
            world_from_camera: s.world_from_rig * s.mounted.rig_from_camera,
            pixel: s.pixel,
        })
        .collect();
    let found = meet_of_clicks(&views, FAR_CLICK_SIGMAS * config.click_sigma_px)?;
    let place = found.point_in_world;
    let mut met = Met {
        name: name.to_owned(),
        place,
        information: Matrix3::zeros(),
        of_poses: Some(Matrix3::zeros()),
        squares_px2: 0.0,
        clicks: found.inliers.len(),
        left_out: views.len() - found.inliers.len(),
        parallax_rad: found.parallax_rad,
    };
    let share = 1.0 / met.clicks as f64;
    for &index in &found.inliers {
        let (view, sight) = (&views[index], &sights[index]);
        let camera_from_world = view.world_from_camera.inverse();
        let Some(seen) = view
            .camera
            .project_with_jacobian(&(camera_from_world * place))
        else {
            continue;
        };
        let by_place = seen.pixel_by_point * camera_from_world.rotation_matrix();
        met.information += by_place.tr_mul(&by_place);
        met.squares_px2 += (seen.pixel - view.pixel).norm_squared();
        // All keyframes that saw it are taken to be off together: no number of images lessens that.
        let moved = sight
            .covariance
            .map(|c| carried(&sight.world_from_rig, &c, &place) * share);
        met.of_poses = met.of_poses.zip(moved).map(|(sum, c)| sum + c);
    }
    Ok(met)
}

/// Where clicks on one mark meet: those farther from it than `far_px` are left out. An error says why they do not.
pub(crate) fn meet_of_clicks(views: &[View], far_px: f64) -> Result<TriangulatedPoint, String> {
    if views.len() < 2 {
        return Err(format!(
            "{} of its clicks are in images with a known pose, but two are needed",
            views.len()
        ));
    }
    let triangulation = TriangulationConfig {
        min_parallax_deg: MIN_PARALLAX_DEG,
        max_reprojection_px: far_px,
        min_views: 2,
        min_depth_m: 0.0,
    };
    let found = triangulate(views, &triangulation).map_err(|failure| match failure {
        TriangulationFailure::TooFewViews => {
            format!(
                "no two of its {} clicks agree within {far_px:.1} px",
                views.len()
            )
        }
        TriangulationFailure::TooLittleParallax => format!(
            "its rays meet at less than {MIN_PARALLAX_DEG}°: click it in images taken farther apart"
        ),
        TriangulationFailure::NotInFront => "its rays meet behind the cameras".to_owned(),
    })?;
    // Of many clicks a few that happen to agree are no mark.
    if 2 * found.inliers.len() < views.len() {
        return Err(format!(
            "only {} of its {} clicks agree within {far_px:.1} px: they are on different objects, or the map is bent there",
            found.inliers.len(),
            views.len()
        ));
    }
    Ok(found)
}

/// Covariance of a place that moves with a rig.
fn carried(world_from_rig: &Se3, covariance: &Matrix6<f64>, place: &Vector3<f64>) -> Matrix3<f64> {
    let in_rig = world_from_rig.inverse() * *place;
    let by_rotation = -so3::hat(&in_rig);
    let rotation = covariance.fixed_view::<3, 3>(0, 0);
    let mixed = covariance.fixed_view::<3, 3>(0, 3);
    let translation = covariance.fixed_view::<3, 3>(3, 3);
    let cross = by_rotation * mixed;
    let in_rig =
        by_rotation * rotation * by_rotation.transpose() + cross + cross.transpose() + translation;
    let turn = world_from_rig.rotation_matrix();
    turn * in_rig * turn.transpose()
}

impl Met {
    /// `None` where the clicks do not determine the place.
    fn placed(self, sigma_px: f64) -> Option<PlacedMark> {
        let of_clicks = self.information.try_inverse()? * sigma_px.powi(2);
        let covariance = of_clicks + self.of_poses.unwrap_or_else(Matrix3::zeros);
        Some(PlacedMark {
            name: self.name,
            place_m: self.place.into(),
            covariance_m2: ((covariance + covariance.transpose()) * 0.5).into(),
            with_poses: self.of_poses.is_some(),
            clicks: self.clicks,
            left_out: self.left_out,
            reprojection_rms_px: (self.squares_px2 / self.clicks as f64).sqrt(),
            parallax_deg: self.parallax_rad.to_degrees(),
        })
    }
}
