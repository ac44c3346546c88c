//! Why corners miss: what other than noise explains the errors that an adjustment left.
//!
//! One Gauss–Newton step with unknowns that the adjustment did not have: other gaps between tags, a board stretched, sheared or
//! bent, a lens of any radial profile, a shutter that rolls. The views' poses and the lens move along; what each cause alone
//! takes off the squares is its share. With the normal matrix `[N C; Cᵀ M]` of poses and lens (N) and a cause (M), and the
//! gradients `n` and `m`, that is `(m − Cᵀ N⁻¹ n)ᵀ (M − Cᵀ N⁻¹ C)⁻¹ (m − Cᵀ N⁻¹ n)`.

mod causes;
mod deformation;
mod field;
mod one_lens;
mod own_lens;
mod sums;

use lsfb_geometry::{Camera, Se3, Vector2, Vector3};
use lsfb_types::{Finding, Limit, Verdict};
use nalgebra::DMatrix;
use serde::Serialize;

use crate::board::Target;
use causes::Explained;
pub(crate) use field::{FREED, Field, Unmodelled, moved_by_field};
use one_lens::OtherLens;
use sums::Sums;

/// Root mean square of the errors above which a calibration is warned of, pixels. Corners leave 0.16 to 0.21 px on TUM VI's and
/// OpenCV's images and 0.43 px on the worst recording known to be good (camodocal, by hand): above 0.6 px more than half of the squares are
/// not the detector's even by that one.
pub(crate) const WORRYING_RMS_PX: f64 = 0.6;
/// And above which it fails, pixels: seven of eight parts of the squares are then another board's, lens's or shutter's.
pub(crate) const FAILED_RMS_PX: f64 = 1.2;
/// Share of the squares from which on a cause gets the blame, and from which on it is named although corners are met well.
const BLAME: f64 = 0.3;
const MOST: f64 = 0.5;
/// Where corners are met well, a cause that moves them by less harms nothing that standard deviations do not hold, pixels, rms.
const LEAST_MOVED_PX: f64 = 0.1;
/// Ratio of errors between outer and inner thirds that is worth a word.
const GROWS: f64 = 1.5;
const CORRECT_IT: &str = "measure the board, correct its description, and calibrate again";
/// A readout time is clear from so many standard deviations on, and worth a word from here on, seconds: at half a metre a second and a metre
/// away a lens of 500 px is then half a pixel off.
const CLEAR_SHUTTER: f64 = 6.0;
const LEAST_READOUT_S: f64 = 2e-3;
/// Views that are looked at at most, spread over all.
const MAX_VIEWS: usize = 240;

/// One view as an adjustment leaves it.
pub(crate) struct AdjustedView {
    pub camera_from_target: Se3,
    pub corners: Vec<AdjustedCorner>,
}

pub(crate) struct AdjustedCorner {
    /// On the board as it is believed to be.
    pub point: Vector3<f64>,
    pub pixel: Vector2<f64>,
    /// How fast it moves over the image, pixels per second; zero where that is not known.
    pub velocity_px_s: Vector2<f64>,
}

/// How a board that may be bent and stretched would be, and what that would do to the focal length.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct BoardDeformation {
    /// How far a corner lies out of the board's plane at most, metres.
    pub bend_m: f64,
    /// Its standard deviation, metres.
    pub bend_sigma_m: f64,
    /// What the focal length would change by, as a share of it.
    pub focal_change: f64,
    /// What that adds to the focal length's standard deviation, as a share of it.
    pub focal_sigma: f64,
    /// Whether the views make such a board likely: with one that is flat, once in a thousand recordings. It is then in the
    /// standard deviations of the lens.
    pub is_likely: bool,
}

/// A [`BoardDeformation`], and what it makes of a lens that was found with a flat board.
pub(crate) struct Deformation {
    pub board: BoardDeformation,
    /// Added to the covariance of the lens parameters; zero where the board is likely to be flat.
    pub lens_covariance: DMatrix<f64>,
}

/// What the errors of one camera say.
pub(crate) struct Diagnosis<'a> {
    target: &'a Target,
    camera: &'a Camera,
    sums: Sums,
    places: Places,
}

impl<'a> Diagnosis<'a> {
    /// Of a camera's views as an adjustment leaves them.
    pub fn new(target: &'a Target, camera: &'a Camera, views: Vec<AdjustedView>) -> Self {
        let mut diagnosis = Self {
            target,
            camera,
            sums: Sums::new(target),
            places: Places::default(),
        };
        for view in views.iter().step_by(spread_over(views.len())) {
            diagnosis.sums.add(target, camera, view);
            diagnosis.places.add(target, camera, view);
        }
        diagnosis
    }

    /// How well corners are met, and what else than noise explains that they miss by `rms_px`.
    pub fn finding(&self, camera: &str, rms_px: f64) -> Finding {
        let (verdict, what, remedy) = self.words(rms_px);
        Finding::new("fit", verdict, camera, what)
            .value(rms_px, "px")
            .limit(Limit::AtMost(match verdict {
                Verdict::Fail => FAILED_RMS_PX,
                _ => WORRYING_RMS_PX,
            }))
            .remedy(remedy)
    }

    fn words(&self, rms_px: f64) -> (Verdict, String, &'static str) {
        let limit = |limit: f64| Limit::AtMost(limit).holds(rms_px);
        let worse = Verdict::Fail
            .unless(limit(FAILED_RMS_PX))
            .max(Verdict::Warn);
        let met = format!("reprojection error is {rms_px:.2} px");
        if let Some(times) = self.sums.off_their_stamps() {
            return (
                worse,
                format!("{met}, but {}", explained(&times)),
                "stamp images when they are taken; `lsfb clock` compares clocks",
            );
        }
        let cause = self.sums.explain(self.target, self.camera);
        if limit(WORRYING_RMS_PX) {
            let is_worth_a_word =
                |e: &Explained| e.share >= MOST && rms_px * e.share.sqrt() >= LEAST_MOVED_PX;
            return match cause.filter(is_worth_a_word) {
                None => (Verdict::Pass, met, ""),
                Some(e) => (
                    Verdict::Warn,
                    format!("{met}, but {}", explained(&e)),
                    CORRECT_IT,
                ),
            };
        }
        let cause = cause.filter(|e| e.share >= BLAME).map_or_else(
            || "likely causes are a wrong size or spacing of the tags, another lens model, or a rolling shutter".to_owned(),
            |e| explained(&e),
        );
        let what = format!(
            "reprojection error is {rms_px:.2} px (detectors reach 0.1 to 0.4 px), {}; {cause}",
            self.places.words()
        );
        (worse, what, CORRECT_IT)
    }

    /// Gaps between tags that are clearly others than the board's file says, where they explain what [`Diagnosis::finding`] blames:
    /// nothing that rests on the board holds then.
    pub fn another_gap(&self, camera: &str, rms_px: f64) -> Option<Finding> {
        let least = if rms_px > WORRYING_RMS_PX {
            BLAME
        } else {
            MOST
        };
        let cause = self.sums.explain(self.target, self.camera)?;
        if !cause.is_another_gap || cause.share < least {
            return None;
        }
        let what = format!("it is not the specified board: {}", explained(&cause));
        let finding = Finding::new("tag-gaps", Verdict::Fail, camera, what)
            .value(100.0 * cause.share, "%")
            .limit(Limit::AtMost(100.0 * least));
        Some(finding.remedy(CORRECT_IT))
    }

    /// A shutter that clearly rolls, where it was taken for a global one; `variance` is that of a corner in one direction, px².
    pub fn rolling_shutter(&self, camera: &str, variance: f64) -> Option<Finding> {
        let found = self.sums.shutter(self.camera, variance)?;
        let is_clear = found.readout_s.abs() > CLEAR_SHUTTER * found.sigma_s;
        if !is_clear || found.readout_s.abs() < LEAST_READOUT_S {
            return None;
        }
        let what = format!(
            "rolling shutter detected ({:.1} ± {:.1} ms readout); the lens is less accurate than its standard deviations",
            1e3 * found.readout_s,
            1e3 * found.sigma_s
        );
        let finding = Finding::new("rolling-shutter", Verdict::Warn, camera, what)
            .value(1e3 * found.readout_s, "ms")
            .sigma(1e3 * found.sigma_s)
            .limit(Limit::AtMost(1e3 * LEAST_READOUT_S));
        Some(finding.remedy(
            "set the camera's readout_s in the rig (--rig), or hold board and camera still for each image",
        ))
    }

    /// Views that were taken through another lens than the rest; `names` are those of the views that were given.
    pub fn another_lens(&self, camera: &str, names: &[String]) -> Option<Finding> {
        let every = spread_over(names.len());
        let names: Vec<&str> = names.iter().step_by(every).map(String::as_str).collect();
        let other = OtherLens::find(self.camera, &self.sums.by_view)?;
        Some(other.finding(camera, self.camera, &names))
    }

    /// A lens that was given, where one of its model fits these views clearly better.
    pub fn given_lens(&self, camera: &str) -> Option<Finding> {
        self.sums.given_lens(camera, self.camera)
    }

    /// The lens that these views have for themselves, where the one that was given does not fit them.
    pub fn lens_of_its_own(&self) -> Option<Camera> {
        self.sums.lens_of_its_own(self.camera)
    }

    /// What moves pixels that the models of lens and board do not know of; zero where it could be noise. `variance` is that of a
    /// corner in one direction, px².
    pub fn field(&self, variance: f64) -> Field {
        let found = self.sums.field(self.camera, variance);
        found.unwrap_or_else(Field::zeros)
    }

    /// The same with the deformations of a board that was taken to be flat.
    pub fn unmodelled(&self, variance: f64) -> Unmodelled {
        let found = self.sums.unmodelled(self.camera, variance);
        found.unwrap_or_else(Unmodelled::none)
    }

    /// The board as it would be if it were not what its file says; `variance` is that of a corner in one direction, px².
    pub fn board(&self, variance: f64) -> Deformation {
        self.sums.board(self.target, self.camera, variance)
    }
}

/// Every how many of so many views is looked at.
fn spread_over(views: usize) -> usize {
    views.div_ceil(MAX_VIEWS).max(1)
}

fn explained(e: &Explained) -> String {
    format!(
        "{:.0} % of the squared residuals would be explained by {}",
        e.share * 100.0,
        e.words
    )
}

/// A pixel from the middle of the image, and how far that is as a share of half the diagonal.
fn from_middle(camera: &Camera, pixel: &Vector2<f64>) -> (Vector2<f64>, f64) {
    let half = Vector2::new(f64::from(camera.width), f64::from(camera.height)) * 0.5;
    let from = pixel - half;
    (from, from.norm() / half.norm().max(1.0))
}

/// Squared errors with where they are.
#[derive(Default)]
struct Places {
    /// Share of the way from the middle of the image, of the board, and speed, each beside the square.
    image: Vec<[f64; 2]>,
    board: Vec<[f64; 2]>,
    speed: Vec<[f64; 2]>,
}

impl Places {
    fn add(&mut self, target: &Target, camera: &Camera, view: &AdjustedView) {
        let [width, height] = target.corners_size();
        for corner in &view.corners {
            let Some(seen) = camera.project(&(view.camera_from_target * corner.point)) else {
                continue;
            };
            let square = (seen - corner.pixel).norm_squared();
            let on_board = Vector2::new(
                2.0 * corner.point.x / width.max(1e-9) - 1.0,
                2.0 * corner.point.y / height.max(1e-9) - 1.0,
            );
            self.image
                .push([from_middle(camera, &corner.pixel).1, square]);
            self.board.push([on_board.amax(), square]);
            self.speed.push([corner.velocity_px_s.norm(), square]);
        }
    }

    /// Where errors grow, in words.
    fn words(&self) -> String {
        let mut grows = Vec::new();
        for (places, from, to) in [
            (&self.image, "in the middle of the image", "at its border"),
            (&self.board, "in the middle of the board", "at its edge"),
            (&self.speed, "in slow views", "in fast ones"),
        ] {
            let [inner, outer] = inner_and_outer_px(places);
            if outer > GROWS * inner {
                grows.push(format!("{inner:.2} px {from} to {outer:.2} px {to}"));
            }
        }
        if grows.is_empty() {
            "equally large in all parts of image and board".to_owned()
        } else {
            format!("growing from {}", grows.join(", from "))
        }
    }
}

/// Root mean squares of the first and the last third by place.
fn inner_and_outer_px(places: &[[f64; 2]]) -> [f64; 2] {
    let mut places = places.to_vec();
    places.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let third = places.len() / 3;
    let rms = |part: &[[f64; 2]]| {
        (part.iter().map(|p| p[1]).sum::<f64>() / part.len().max(1) as f64).sqrt()
    };
    // All at one place say nothing.
    if places.first().map(|p| p[0]) == places.last().map(|p| p[0]) {
        return [0.0; 2];
    }
    [rms(&places[..third]), rms(&places[places.len() - third..])]
}

#[cfg(test)]
mod tests;
