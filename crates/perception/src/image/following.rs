//! Corners followed through many images of a camera, and into a second camera beside it, with numbers that stay.

use std::collections::BTreeMap;

use lsfb_geometry::{Camera, Se3, UnitQuaternion, Vector2, Vector3};
use lsfb_types::Image;
use nalgebra::Matrix2;

use super::corners::corners;
use super::gray::Gray;
use super::tracking::{FAINT, there_and_back};

/// Levels of the pyramid at most, and the narrowest one, pixels.
const LEVELS: u32 = 4;
const LEAST_WIDTH: u32 = 60;
/// A new corner keeps this far from those that are followed, as a share of the image's width.
const APART: f64 = 0.03;
/// Shares of the width that a point may move beyond what the turn explains from one image to the next.
const FARTHEST: f64 = 0.12;
/// Inverse distances at which a corner is looked for in a second camera, 1/m.
const INVERSE_DISTANCES: [f64; 6] = [0.0, 0.15, 0.35, 0.7, 1.2, 2.0];
/// Sine of the angle to its epipolar plane that a corner in a second camera may have.
const OFF_PLANE: f64 = 4e-3;

/// An image at several sizes, each half as wide as the one before.
#[derive(Clone, Debug)]
pub struct Pyramid {
    levels: Vec<Gray>,
}

impl Pyramid {
    /// Of an image of the camera's size.
    pub fn new(image: &Image, camera: &Camera) -> Self {
        let factors = (0..LEVELS).map(|k| 1 << k);
        let levels = factors
            .filter(|f| *f == 1 || image.width / f >= LEAST_WIDTH)
            .map(|f| Gray::reduced(image, camera, f).smoothed());
        Self {
            levels: levels.collect(),
        }
    }

    fn camera(&self) -> Option<&Camera> {
        self.levels.first().map(|fine| &fine.camera)
    }

    /// Where a corner of this image lies in another; `start` says about where. `None` where it does not come back.
    fn find(
        &self,
        other: &Self,
        corner: &Vector2<f64>,
        start: &Vector2<f64>,
        levels: usize,
        warp: &Matrix2<f64>,
    ) -> Option<Vector2<f64>> {
        there_and_back(&self.levels, &other.levels, corner, start, levels, warp)
    }
}

/// Follows corners through the images of one camera.
///
/// Patches are compared from one image to the next, there and back; brightness and contrast of each are left aside, and what the gyroscope
/// says of the turn is where the search begins.
#[derive(Clone, Debug, Default)]
pub struct Follower {
    last: Option<Pyramid>,
    /// By number: where it is now, pixels.
    followed: BTreeMap<u32, Vector2<f64>>,
    next: u32,
}

impl Follower {
    /// Takes the next image. `next_from_last` turns directions of the last image into this one; without it none is assumed. `taken` are
    /// places where no new corners are wanted.
    pub fn advance(
        &mut self,
        image: Pyramid,
        next_from_last: Option<&UnitQuaternion<f64>>,
        taken: &[Vector2<f64>],
    ) {
        if let Some(last) = self.last.take() {
            let still = self.followed.iter().filter_map(|(number, corner)| {
                let start = turned(&last, &image, corner, next_from_last)?;
                let warp = warp(&last, &image, corner, next_from_last)?;
                let there = last.find(&image, corner, &start, last.levels.len(), &warp)?;
                let near_px = FARTHEST * image.levels.first()?.width() as f64;
                ((there - start).norm() < near_px).then_some((*number, there))
            });
            self.followed = still.collect();
        }
        if let Some(fine) = image.levels.first() {
            let apart_px = APART * fine.width() as f64;
            for corner in corners(fine, FAINT) {
                let free = |other: &Vector2<f64>| (other - corner).norm() > apart_px;
                if self.followed.values().all(free) && taken.iter().all(free) {
                    self.followed.insert(self.next, corner);
                    self.next += 1;
                }
            }
        }
        self.last = Some(image);
    }

    /// The corners of the last image by number, pixels.
    pub fn corners(&self) -> impl Iterator<Item = (u32, Vector2<f64>)> + '_ {
        self.followed
            .iter()
            .map(|(number, pixel)| (*number, *pixel))
    }

    /// The same corners in an image that a second camera took at the same time; those that it does not show are left out.
    pub fn seen_beside(
        &self,
        image: &Pyramid,
        second_from_first: &Se3,
    ) -> Vec<(u32, Vector2<f64>)> {
        let Some(last) = &self.last else {
            return Vec::new();
        };
        let found = self.followed.iter();
        found
            .filter_map(|(number, corner)| {
                Some((*number, beside(last, image, corner, second_from_first)?))
            })
            .collect()
    }
}

/// Where the turn alone would move a pixel.
fn turned(
    last: &Pyramid,
    next: &Pyramid,
    pixel: &Vector2<f64>,
    next_from_last: Option<&UnitQuaternion<f64>>,
) -> Option<Vector2<f64>> {
    let Some(turn) = next_from_last else {
        return Some(*pixel);
    };
    next.camera()?
        .project(&(turn * last.camera()?.unproject(pixel)?))
}

/// How the turn alone changes the patch around a pixel: pixels there by pixels here, by differences.
fn warp(
    last: &Pyramid,
    next: &Pyramid,
    pixel: &Vector2<f64>,
    next_from_last: Option<&UnitQuaternion<f64>>,
) -> Option<Matrix2<f64>> {
    let at = |x: f64, y: f64| turned(last, next, &(pixel + Vector2::new(x, y)), next_from_last);
    let by_x = (at(1.0, 0.0)? - at(-1.0, 0.0)?) * 0.5;
    let by_y = (at(0.0, 1.0)? - at(0.0, -1.0)?) * 0.5;
    Some(Matrix2::from_columns(&[by_x, by_y]))
}

/// A corner in a second camera: the place near its epipolar line that comes back, begun at several distances.
fn beside(
    first: &Pyramid,
    second: &Pyramid,
    corner: &Vector2<f64>,
    second_from_first: &Se3,
) -> Option<Vector2<f64>> {
    let ray: Vector3<f64> = first.camera()?.unproject(corner)?.normalize();
    let turned = second_from_first.rotation * ray;
    let normal = second_from_first
        .translation
        .cross(&turned)
        .try_normalize(1e-9)?;
    INVERSE_DISTANCES.iter().find_map(|per_m| {
        let start = second
            .camera()?
            .project(&(turned + second_from_first.translation * *per_m))?;
        let there = first.find(second, corner, &start, 2, &Matrix2::identity())?;
        let seen = second.camera()?.unproject(&there)?.normalize();
        (seen.dot(&normal).abs() < OFF_PLANE).then_some(there)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(camera: &Camera, pixels: Vec<u8>) -> Image {
        Image {
            width: camera.width,
            height: camera.height,
            pixels,
            exposure_ns: 0,
            frame_id: 0,
        }
    }

    /// A wall 3 m away with blots of no period, as a camera at `x_m` that is turned about its vertical axis sees it.
    fn wall(camera: &Camera, x_m: f64, yaw: f64) -> Image {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw);
        let pixels = (0..camera.height).flat_map(|v| (0..camera.width).map(move |u| (u, v)));
        let value = |(u, v): (u32, u32)| {
            let ray = camera.unproject(&Vector2::new(f64::from(u), f64::from(v)));
            let ray = turn * ray.expect("a pinhole");
            let (x, y) = (x_m + 3.0 * ray.x / ray.z, 3.0 * ray.y / ray.z);
            let blots =
                (7.0 * x + 3.0 * (2.3 * y).sin()).sin() * (6.1 * y + 2.0 * (1.7 * x).cos()).sin();
            (128.0 + 110.0 * blots) as u8
        };
        image(camera, pixels.map(value).collect())
    }

    #[test]
    fn corners_keep_their_numbers_through_a_turn_and_into_a_second_camera() {
        let camera = Camera::pinhole(320, 240, [200.0; 2], [159.5, 119.5]);
        let mut follower = Follower::default();
        let step = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -0.06);
        let at = |k: usize| wall(&camera, 0.02 * k as f64, 0.06 * k as f64);
        follower.advance(Pyramid::new(&at(0), &camera), None, &[]);
        let begun: BTreeMap<u32, Vector2<f64>> = follower.corners().collect();
        assert!(begun.len() > 60, "{} corners", begun.len());
        for k in 1..5 {
            follower.advance(Pyramid::new(&at(k), &camera), Some(&step), &[]);
        }
        let still: Vec<_> = follower
            .corners()
            .filter(|(n, _)| begun.contains_key(n))
            .collect();
        assert!(still.len() > 25, "{} of {}", still.len(), begun.len());
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.24);
        let off_px = still.iter().map(|(number, pixel)| {
            let ray = camera.unproject(&begun[number]).expect("a pinhole");
            let point = ray * (3.0 / ray.z) - Vector3::new(0.08, 0.0, 0.0);
            let expected = camera.project(&(turn.inverse() * point));
            (expected.expect("in front") - pixel).norm()
        });
        let mut off_px: Vec<f64> = off_px.collect();
        off_px.sort_by(f64::total_cmp);
        // At the border, where the turn distorts most, small errors of each step add up.
        assert!(off_px[off_px.len() / 2] < 0.2, "{off_px:?}");
        assert!(off_px[off_px.len() * 9 / 10] < 1.0, "{off_px:?}");
        // A second camera 10 cm to the right, and one that looks elsewhere.
        let right = Pyramid::new(&wall(&camera, 0.08 + 0.1 * 0.24f64.cos(), 0.24), &camera);
        let beside = Se3::new(UnitQuaternion::identity(), Vector3::new(-0.1, 0.0, 0.0));
        let seen = follower.seen_beside(&right, &beside);
        assert!(2 * seen.len() > still.len(), "{} seen", seen.len());
        let blank = image(&camera, vec![90; 320 * 240]);
        assert!(
            follower
                .seen_beside(&Pyramid::new(&blank, &camera), &beside)
                .is_empty()
        );
        follower.advance(Pyramid::new(&blank, &camera), None, &[]);
        assert_eq!(follower.corners().count(), 0);
    }
}
