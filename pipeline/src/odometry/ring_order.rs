//! Times by azimuth of clouds that are ordered ring by ring, and whether rings are what a sensor saw.
//!
//! A cloud in firing order shows in it when its turn began. Ring by ring it shows that only where all rings begin at one azimuth, and where that is
//! not where sorting by angle would begin them too. And what was deskewed since is no turn any more: then its rings are not at one elevation each,
//! or reach farther round than a turn, or less far.

use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

use lsfb_types::LidarPoint;
use serde::{Deserialize, Serialize};

/// Nearer returns have no azimuth to speak of, metres.
const MIN_HORIZONTAL_M: f32 = 0.3;
/// Fewer rings show no common beginning.
const LEAST_RINGS: usize = 4;
/// Beams of one firing look to different sides by less than this either way: a ring begins so near to where most do, or its first returns are missing, radians.
const MAX_STAGGER_RAD: f64 = 0.1;
/// The ring that reaches farthest round lacks less than this of a turn, or exceeds it by rounding alone, radians.
const MAX_SHORT_RAD: f64 = 0.02;
const MAX_LONG_RAD: f64 = 0.002;
/// Azimuths of a ring that go back by no more are rounded, radians.
const MAX_BACK_RAD: f64 = 1e-4;
/// A ring is a cone: its points are on it, but for so much, radians, and metres near to it.
const MAX_OFF_CONE_RAD: f64 = 0.0026;
const LASER_OFF_M: f64 = 0.01;
/// Lasers are at most so far above or below the origin of their cloud (an Ouster's are 36 mm above that of its base), metres.
const MAX_APEX_M: f64 = 0.1;
/// Times that a cone is laid through the points that are on it.
const CONE_ROUNDS: usize = 2;
/// Share of the points that must be on theirs. Raw clouds of four sensors: all of them; what was deskewed over a step of 12 cm and half a degree: 94 %
/// in a narrow room, and less.
const MIN_ON_CONES: f64 = 0.95;
/// Sorting by angle begins at one of the axes, and the first point lies so near to it, radians.
const NEAR_AXIS_RAD: f64 = 0.01;

/// Why azimuths do not tell when points were measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AzimuthProblem {
    /// Points are neither in the order of a turn nor ring by ring, or not clockwise.
    Order,
    /// Rings are no cones of one turn each: the cloud was deskewed already.
    Moved,
    /// Rings begin at different azimuths.
    Start,
    /// Rings begin at an axis, as after sorting by angle: the turn may have begun elsewhere.
    Sorted,
}

impl AzimuthProblem {
    /// As a half-sentence.
    pub(super) fn sentence(self) -> &'static str {
        match self {
            Self::Order => {
                "points are neither in firing order nor ring by ring, clockwise seen from above"
            }
            Self::Moved => {
                "their rings are not a turn at one elevation each, as if they had been deskewed already"
            }
            Self::Start => {
                "their rings begin at different azimuths, so when the turn began is unknown"
            }
            Self::Sorted => {
                "their rings begin at an axis, as sorted points do, so when the turn began is unknown"
            }
        }
    }
}

/// A ring in the order of its points.
struct Ring {
    /// Indices of its points.
    points: Vec<usize>,
    /// Azimuth of its first point that has one, clockwise, radians.
    first_rad: f64,
    /// How far each point is round from there, radians.
    turned_rad: Vec<f64>,
}

impl Ring {
    /// `None` where its points are not in the order of a clockwise turn.
    fn of(points: Vec<usize>, cloud: &[LidarPoint]) -> Option<Self> {
        let azimuths = points.iter().map(|i| azimuth_rad(cloud.get(*i)?));
        let azimuths: Vec<Option<f64>> = azimuths.collect();
        let first_rad = azimuths.iter().copied().flatten().next()?;
        let (mut last, mut turned) = (first_rad, 0.0_f64);
        let mut turned_rad = Vec::with_capacity(points.len());
        for azimuth in azimuths {
            if let Some(azimuth) = azimuth {
                let step = (azimuth - last + PI).rem_euclid(TAU) - PI;
                if step < -MAX_BACK_RAD {
                    return None;
                }
                turned += step.max(0.0);
                last = azimuth;
            }
            turned_rad.push(turned);
        }
        Some(Self {
            points,
            first_rad,
            turned_rad,
        })
    }

    fn span_rad(&self) -> f64 {
        self.turned_rad.last().copied().unwrap_or(0.0)
    }
}

/// Nanoseconds after the beginning of the turn for each point of a cloud that is ordered ring by ring, one turn in `period_ns`, clockwise seen from above.
pub(super) fn times_by_ring(
    points: &[LidarPoint],
    period_ns: i64,
) -> Result<Vec<u32>, AzimuthProblem> {
    let rings = split(points).into_iter();
    let rings: Option<Vec<Ring>> = rings.map(|ring| Ring::of(ring, points)).collect();
    let rings = rings.filter(|rings| rings.len() >= LEAST_RINGS);
    let rings = rings.ok_or(AzimuthProblem::Order)?;
    let span_rad = rings.iter().map(Ring::span_rad).fold(0.0, f64::max);
    let is_turn = (TAU - MAX_SHORT_RAD..=TAU + MAX_LONG_RAD).contains(&span_rad);
    if !is_turn || !are_cones(rings.iter().map(|ring| ring.points.as_slice()), points) {
        return Err(AzimuthProblem::Moved);
    }
    let start_rad = start_rad(&rings).ok_or(AzimuthProblem::Start)?;
    let behind_axis_rad = start_rad.rem_euclid(FRAC_PI_2);
    if behind_axis_rad.min(FRAC_PI_2 - behind_axis_rad) < NEAR_AXIS_RAD {
        return Err(AzimuthProblem::Sorted);
    }
    let mut times_ns = vec![0; points.len()];
    for ring in &rings {
        // The earliest of all is late by rounding alone.
        let late_rad = (ring.first_rad - start_rad + MAX_BACK_RAD).rem_euclid(TAU);
        let late_rad = (late_rad - MAX_BACK_RAD).max(0.0);
        if late_rad + ring.span_rad() > TAU + MAX_STAGGER_RAD {
            return Err(AzimuthProblem::Start);
        }
        for (index, turned_rad) in ring.points.iter().zip(&ring.turned_rad) {
            if let Some(time_ns) = times_ns.get_mut(*index) {
                *time_ns = ((late_rad + turned_rad) / TAU * period_ns as f64).round() as u32;
            }
        }
    }
    Ok(times_ns)
}

/// Whether the rings of a cloud in firing order are at one elevation each, as a sensor sees them and a cloud that was deskewed does not show them. `None`
/// where points carry no numbers of rings: nothing tells then.
pub(super) fn rings_are_cones(points: &[LidarPoint]) -> Option<bool> {
    let rings = numbered(points)?;
    Some(are_cones(rings.iter().map(Vec::as_slice), points))
}

/// The rings by the numbers of their points; `None` where they carry none.
fn numbered(points: &[LidarPoint]) -> Option<Vec<Vec<usize>>> {
    if points.iter().all(|p| p.ring == 0) {
        return None;
    }
    let mut rings: BTreeMap<u16, Vec<usize>> = BTreeMap::new();
    for (index, point) in points.iter().enumerate() {
        rings.entry(point.ring).or_default().push(index);
    }
    Some(rings.into_values().collect())
}

/// The rings, by the numbers of their points where they carry any, else by where the elevation jumps.
fn split(points: &[LidarPoint]) -> Vec<Vec<usize>> {
    if let Some(rings) = numbered(points) {
        return rings;
    }
    let mut rings: Vec<Vec<usize>> = Vec::new();
    let mut last_rad = f64::INFINITY;
    for (index, point) in points.iter().enumerate() {
        let elevation_rad = elevation_rad(point);
        match rings.last_mut() {
            Some(ring) if (elevation_rad - last_rad).abs() < MAX_OFF_CONE_RAD => ring.push(index),
            _ => rings.push(vec![index]),
        }
        last_rad = elevation_rad;
    }
    rings
}

/// Clockwise seen from above; `None` of points that are too near to have one.
pub(super) fn azimuth_rad(point: &LidarPoint) -> Option<f64> {
    let [x, y, _] = point.position_m;
    (x.hypot(y) > MIN_HORIZONTAL_M).then(|| -f64::from(y).atan2(f64::from(x)))
}

fn elevation_rad(point: &LidarPoint) -> f64 {
    let [x, y, z] = point.position_m.map(f64::from);
    z.atan2(x.hypot(y))
}

/// Whether the points of each ring are on one cone: a carrier that sways, or passes what is near, spoils that in clouds that were deskewed.
fn are_cones<'a>(rings: impl Iterator<Item = &'a [usize]>, points: &[LidarPoint]) -> bool {
    let (mut on, mut all) = (0, 0);
    for ring in rings {
        let of_ring = ring.iter().filter_map(|i| points.get(*i));
        let profile: Vec<Profile> = of_ring.filter_map(Profile::of).collect();
        on += Cone::of(&profile).count(&profile);
        all += profile.len();
    }
    on as f64 >= MIN_ON_CONES * all as f64
}

/// A point as seen from the side, metres.
#[derive(Clone, Copy)]
struct Profile {
    horizontal_m: f64,
    up_m: f64,
    range_m: f64,
}

impl Profile {
    /// `None` of points that are too near to tell, as those of returns that are missing.
    fn of(point: &LidarPoint) -> Option<Self> {
        azimuth_rad(point)?;
        let [x, y, z] = point.position_m.map(f64::from);
        Some(Self {
            horizontal_m: x.hypot(y),
            up_m: z,
            range_m: x.hypot(y).hypot(z),
        })
    }
}

/// What the rays of a laser sweep, about the vertical.
#[derive(Clone, Copy)]
struct Cone {
    /// Where it begins: the origin of a cloud is not always where its lasers are.
    apex_m: f64,
    slope: f64,
}

impl Cone {
    /// By least squares of angles; points that are off it count for nothing the next time.
    fn of(profile: &[Profile]) -> Self {
        let mut cone = Self::among(profile, |_| true);
        for _ in 0..CONE_ROUNDS {
            cone = Self::among(profile, |point| cone.has(point));
        }
        cone
    }

    fn among(profile: &[Profile], counts: impl Fn(&Profile) -> bool) -> Self {
        let weighted = || {
            let counted = profile.iter().filter(|point| counts(point));
            counted.map(|p| (p.range_m.powi(-2), p.horizontal_m, p.up_m))
        };
        let sum = |of: fn(f64, f64) -> f64| weighted().map(|(w, h, u)| w * of(h, u)).sum::<f64>();
        let (w, h, u) = (sum(|_, _| 1.0), sum(|h, _| h), sum(|_, u| u));
        let (hh, hu) = (sum(|h, _| h * h), sum(|h, u| h * u));
        // At one distance all heights of the apex are as good.
        let of_line = (u * hh - h * hu) / (w * hh - h * h).max(f64::MIN_POSITIVE);
        let apex_m = of_line.clamp(-MAX_APEX_M, MAX_APEX_M);
        Self {
            apex_m,
            slope: (hu - apex_m * h) / hh.max(f64::MIN_POSITIVE),
        }
    }

    fn has(&self, point: &Profile) -> bool {
        let off_m = (point.up_m - self.apex_m - self.slope * point.horizontal_m).abs();
        off_m / self.slope.hypot(1.0) < MAX_OFF_CONE_RAD * point.range_m + LASER_OFF_M
    }

    fn count(&self, profile: &[Profile]) -> usize {
        profile.iter().filter(|point| self.has(point)).count()
    }
}

/// Where the first of the rings begin, clockwise, radians; `None` where less than half of them begin near to one azimuth.
fn start_rad(rings: &[Ring]) -> Option<f64> {
    let off = |ring: &Ring, from_rad: f64| (ring.first_rad - from_rad + PI).rem_euclid(TAU) - PI;
    let near = |from_rad: f64| {
        let offs = rings.iter().map(move |ring| off(ring, from_rad));
        offs.filter(|off| off.abs() < MAX_STAGGER_RAD)
    };
    let (count, usual_rad) = rings
        .iter()
        .map(|ring| (near(ring.first_rad).count(), ring.first_rad))
        .max_by_key(|(count, _)| *count)?;
    let earliest = near(usual_rad).fold(0.0, f64::min);
    (2 * count >= rings.len()).then_some(usual_rad + earliest)
}

#[cfg(test)]
mod tests {
    use rand::seq::SliceRandom;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const PERIOD_NS: i64 = 100_000_000;
    const COLUMNS: u32 = 900;

    /// A room as 16 rings see it that begin there, ring by ring: each point with when it was measured. Some first returns are missing.
    fn cloud(start_rad: f64, numbered: bool) -> Vec<(LidarPoint, u32)> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut points = Vec::new();
        for ring in 0..16_u16 {
            let elevation = f64::from(2 * i32::from(ring) - 15).to_radians();
            let missing = if ring % 3 == 2 { 40 } else { 0 };
            for column in missing..COLUMNS {
                let azimuth = start_rad + TAU * f64::from(column) / f64::from(COLUMNS);
                let range_m = 3.0 + 2.0 * (3.0 * azimuth).sin() + 0.02 * rng.random::<f64>();
                let ray = [
                    elevation.cos() * azimuth.cos(),
                    -elevation.cos() * azimuth.sin(),
                    elevation.sin(),
                ];
                let point = LidarPoint {
                    position_m: ray.map(|c| (c * range_m) as f32),
                    ring: if numbered { ring } else { 0 },
                    ..LidarPoint::default()
                };
                points.push((point, column * (PERIOD_NS as u32 / COLUMNS)));
            }
        }
        points
    }

    fn times(cloud: &[(LidarPoint, u32)]) -> Result<Vec<u32>, AzimuthProblem> {
        let points: Vec<LidarPoint> = cloud.iter().map(|(point, _)| *point).collect();
        times_by_ring(&points, PERIOD_NS)
    }

    /// They were not deskewed at all.
    #[test]
    fn rings_with_a_common_start_are_timed() {
        for numbered in [true, false] {
            let cloud = cloud(2.0, numbered);
            let found = times(&cloud).expect("times");
            for ((_, expected), found) in cloud.iter().zip(&found) {
                assert!(found.abs_diff(*expected) < 50_000, "{expected} {found}");
            }
        }
    }

    /// An Ouster's cloud in the frame of its base, 36 mm below its lasers, was taken for one that was deskewed.
    #[test]
    fn rings_whose_lasers_are_not_at_the_origin_are_cones() {
        let mut cloud = cloud(2.0, true);
        for (point, _) in &mut cloud {
            point.position_m[2] += 0.036;
        }
        assert!(times(&cloud).is_ok());
        // Returns that are missing.
        let points = cloud.iter().map(|(point, _)| *point);
        let mut points: Vec<LidarPoint> = points.collect();
        for point in points.iter_mut().step_by(5) {
            point.position_m = [0.0; 3];
        }
        assert_eq!(rings_are_cones(&points), Some(true));
    }

    /// Naively each of these was given times: half a turn off, or over motion that was undone already.
    #[test]
    fn clouds_that_tell_no_start_or_were_deskewed_are_not() {
        for start_rad in [0.0, PI, -FRAC_PI_2] {
            assert_eq!(
                times(&cloud(start_rad, true)).err(),
                Some(AzimuthProblem::Sorted)
            );
        }
        let change = |change: &dyn Fn(f64, &mut LidarPoint)| {
            let mut changed = cloud(2.0, true);
            for (point, time_ns) in &mut changed {
                change(f64::from(*time_ns) / PERIOD_NS as f64, point);
            }
            times(&changed).err()
        };
        // Each ring cut where it likes.
        let mut cut = cloud(2.0, true);
        let mut rings: Vec<Vec<_>> = cut
            .chunk_by(|a, b| a.0.ring == b.0.ring)
            .map(Vec::from)
            .collect();
        for (k, ring) in rings.iter_mut().enumerate() {
            let by = 50 * k % ring.len();
            ring.rotate_left(by);
        }
        cut = rings.concat();
        assert_eq!(times(&cut).err(), Some(AzimuthProblem::Start));
        // Counter-clockwise, as KITTI's, and shuffled.
        let mirrored = change(&|_, p| p.position_m[1] = -p.position_m[1]);
        assert_eq!(mirrored, Some(AzimuthProblem::Order));
        let mut shuffled = cloud(2.0, true);
        shuffled.shuffle(&mut ChaCha8Rng::seed_from_u64(1));
        assert_eq!(times(&shuffled).err(), Some(AzimuthProblem::Order));
        // Deskewed: of a carrier that turned by 4° about the vertical, and of one that walked and pitched by a degree.
        let turned = change(&|share, p| {
            let [x, y, z] = p.position_m.map(f64::from);
            let (sin, cos) = (0.07 * share).sin_cos();
            p.position_m = [cos * x - sin * y, sin * x + cos * y, z].map(|c| c as f32);
        });
        assert_eq!(turned, Some(AzimuthProblem::Moved));
        let walked = change(&|share, p| {
            let [x, y, z] = p.position_m.map(f64::from);
            let (sin, cos) = (0.017 * share).sin_cos();
            let x = x + 0.12 * share;
            p.position_m = [cos * x + sin * z, y, cos * z - sin * x].map(|c| c as f32);
        });
        assert_eq!(walked, Some(AzimuthProblem::Moved));
    }
}
