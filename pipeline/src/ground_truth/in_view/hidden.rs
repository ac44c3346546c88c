//! What the walk itself sees nearer than a point of the map, and so in front of it.
//!
//! Beside the scanner's path, or behind somebody who stands there, a point that is where it was mapped may be hidden. The walk says so: what it
//! sees around the point's pixel is nearer than the point. Where it sees things as far away as the point, or farther, or nothing at all, nothing
//! hides it. Where all it sees is farther, what stood there has gone.

use std::collections::BTreeMap;
use std::iter::Sum;

use lsfb_geometry::{Vector2, Vector3};

use super::super::estimate::Estimate;
use super::super::walk::{LocalPoint, Walk};

/// Things this near to a point's pixel say what is in front of it, pixels.
const AROUND_PX: f64 = 50.0;
/// So many of them do, the nearest ones.
const NEIGHBOURS: usize = 4;
/// What is nearer than this share of a point's distance is in front of it.
const IN_FRONT_SHARE: f64 = 0.88;

/// Something that an image shows at a known distance.
struct Sight {
    pixel: Vector2<f64>,
    away_m: f64,
}

/// What some of a walk's images show at known distances: points of the map that were recognised, and the walk's own.
pub(super) struct Sights {
    /// By frame and camera.
    by_image: BTreeMap<(usize, usize), Vec<Sight>>,
}

impl Sights {
    /// Of these frames.
    pub fn of(
        walk: &Walk,
        estimate: &Estimate,
        points: &[LocalPoint],
        frames: impl IntoIterator<Item = usize>,
    ) -> Self {
        let cameras = 0..walk.cameras.len();
        let images = frames
            .into_iter()
            .flat_map(|k| cameras.clone().map(move |camera| (k, camera)));
        let mut by_image: BTreeMap<(usize, usize), Vec<Sight>> =
            images.map(|image| (image, Vec::new())).collect();
        let sight =
            |(frame, camera): (usize, usize), pixel: Vector2<f64>, point_in_world: Vector3<f64>| {
                let centre = estimate
                    .world_from_camera(frame, camera, pixel.y)
                    .translation;
                let away_m = (point_in_world - centre).norm();
                Sight { pixel, away_m }
            };
        for point in points.iter().filter(|p| p.is_determined()) {
            for seen in point.observations.iter().filter(|seen| seen.used) {
                let image = (seen.frame, seen.camera);
                if let Some(sights) = by_image.get_mut(&image) {
                    sights.push(sight(image, seen.pixel, point.point_in_world));
                }
            }
        }
        for (&image, sights) in &mut by_image {
            let (frame, camera) = image;
            let seen = walk.frames[frame].fixed.iter();
            let seen = seen.filter(|seen| seen.camera == camera);
            sights.extend(seen.map(|seen| sight(image, seen.pixel, seen.point_in_world)));
        }
        Self { by_image }
    }

    /// What an image shows around a pixel, beside something that is so far away there.
    pub fn around(&self, frame: usize, camera: usize, pixel: &Vector2<f64>, away_m: f64) -> Around {
        let sights = self.by_image.get(&(frame, camera)).into_iter().flatten();
        let mut around: Vec<(f64, f64)> = sights
            .map(|sight| ((sight.pixel - pixel).norm(), sight.away_m))
            .filter(|(apart_px, _)| *apart_px <= AROUND_PX)
            .collect();
        around.sort_by(|a, b| a.0.total_cmp(&b.0));
        around.truncate(NEIGHBOURS);
        let in_front = around.iter().filter(|s| s.1 < IN_FRONT_SHARE * away_m);
        let behind = around.iter().filter(|s| away_m < IN_FRONT_SHARE * s.1);
        Around {
            in_front: in_front.count(),
            behind: behind.count(),
            all: around.len(),
        }
    }
}

/// How much of what is nearest to a pixel is in front of something, and how much behind it; in one image, or in several.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Around {
    pub in_front: usize,
    pub behind: usize,
    pub all: usize,
}

impl Around {
    /// Whether half or more of it is in front.
    pub fn hides(&self) -> bool {
        2 * self.in_front >= self.all.max(1)
    }
}

impl Sum for Around {
    fn sum<I: Iterator<Item = Self>>(looks: I) -> Self {
        looks.fold(Self::default(), |sum, look| Self {
            in_front: sum.in_front + look.in_front,
            behind: sum.behind + look.behind,
            all: sum.all + look.all,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn around(sights: &[(f64, f64)]) -> Around {
        let sights = sights.iter().map(|&(x, away_m)| Sight {
            pixel: Vector2::new(x, 100.0),
            away_m,
        });
        let by_image = BTreeMap::from([((3, 1), sights.collect())]);
        Sights { by_image }.around(3, 1, &Vector2::new(100.0, 100.0), 10.0)
    }

    fn hides(sights: &[(f64, f64)]) -> bool {
        around(sights).hides()
    }

    #[test]
    fn what_is_behind_is_seen_through_where_a_thing_was() {
        let seen = around(&[(110.0, 4.0), (90.0, 10.1), (105.0, 12.0), (99.0, 11.5)]);
        let expected = Around {
            in_front: 1,
            behind: 2,
            all: 4,
        };
        assert_eq!(seen, expected);
        assert_eq!(around(&[]), Around::default());
    }

    /// Of 53 points of a right walk that had nearer things around them a quarter was found, as of points that are not there; of the others 82 %.
    #[test]
    fn a_point_is_hidden_where_half_of_what_is_around_is_nearer() {
        assert!(!hides(&[]), "nothing is seen there");
        assert!(hides(&[(110.0, 4.0)]));
        assert!(!hides(&[(110.0, 9.5)]), "beside it");
        assert!(!hides(&[(110.0, 30.0)]), "seen through where it was");
        assert!(!hides(&[(151.0, 4.0)]), "far aside");
        assert!(hides(&[(110.0, 4.0), (90.0, 4.1), (105.0, 10.0)]));
        assert!(!hides(&[(110.0, 4.0), (90.0, 10.1), (105.0, 10.0)]));
        assert!(hides(&[(110.0, 4.0), (105.0, 10.0)]));
        let nearest_decide = [4.0, 4.0, 10.0, 10.0, 10.0, 10.0].into_iter();
        let nearest_decide: Vec<_> = (101..).map(f64::from).zip(nearest_decide).collect();
        assert!(hides(&nearest_decide));
    }
}
