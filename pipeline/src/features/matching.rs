//! Which features of two images show the same thing.

use lsfb_geometry::{Se3, Vector2, Vector3};
use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

use super::{DESCRIPTOR_LEN, Descriptor, KeypointGrid};

/// A pair of features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Match {
    /// Index in the first set.
    pub first: u32,
    /// Index in the second set.
    pub second: u32,
    /// Squared distance of the descriptors, in their own units.
    pub distance_squared: u32,
}

/// Configuration of descriptor matching.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MatchConfig {
    /// Largest distance of the best to the second best.
    pub max_ratio: f32,
    /// Largest distance, in units of the descriptor's norm: 0 identical, √2 nothing in common.
    pub max_distance: f32,
}

impl Default for MatchConfig {
    fn default() -> Self {
        Self {
            max_ratio: 0.85,
            max_distance: 0.8,
        }
    }
}

lsfb_types::bounds! {
    MatchConfig {
        max_ratio: number(Bounds::NOT_NEGATIVE),
        max_distance: number(Bounds::NOT_NEGATIVE),
    }
}

impl MatchConfig {
    fn accepts(&self, best: u32, second: u32) -> bool {
        let limit = self.max_distance * DESCRIPTOR_NORM;
        (best as f32) <= limit * limit
            && (second == NONE || (best as f32) < self.max_ratio * self.max_ratio * second as f32)
    }
}

/// Norm of a descriptor before rounding.
pub(crate) const DESCRIPTOR_NORM: f32 = 512.0;
const NONE: u32 = u32::MAX;

/// Descriptors of one image, widened once for fast distances.
#[derive(Clone, Debug, Default)]
pub struct DescriptorSet {
    values: Vec<[i16; DESCRIPTOR_LEN]>,
    squared_norms: Vec<i32>,
}

impl DescriptorSet {
    /// Widens descriptors.
    pub fn new(descriptors: &[Descriptor]) -> Self {
        let values: Vec<_> = descriptors.iter().map(|d| d.map(i16::from)).collect();
        let squared_norms = values.iter().map(|v| dot(v, v)).collect();
        Self {
            values,
            squared_norms,
        }
    }

    /// Number of descriptors.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Squared distance of descriptor `index` to descriptor `other_index` of `other`.
    pub fn distance_squared(&self, index: usize, other: &Self, other_index: usize) -> u32 {
        let product = dot(&self.values[index], &other.values[other_index]);
        let sum = self.squared_norms[index] + other.squared_norms[other_index];
        (sum - 2 * product).max(0) as u32
    }
}

/// Written so that the compiler multiplies and adds pairs of sixteen-bit lanes.
fn dot(a: &[i16; DESCRIPTOR_LEN], b: &[i16; DESCRIPTOR_LEN]) -> i32 {
    a.iter()
        .zip(b)
        .map(|(x, y)| i32::from(*x) * i32::from(*y))
        .sum()
}

/// Squared distance of two descriptors. A loop, and inlined everywhere, so that it is compiled for the vector units of the function around
/// it: pairs of sixteen-bit lanes are multiplied and added at once.
#[inline(always)]
pub fn distance_squared(a: &Descriptor, b: &Descriptor) -> u32 {
    let mut sum = 0;
    for (x, y) in a.iter().zip(b) {
        let difference = i16::from(*x) - i16::from(*y);
        sum += i32::from(difference) * i32::from(difference);
    }
    sum as u32
}

/// The best and the second best of a search.
#[derive(Clone, Copy)]
struct Nearest {
    index: u32,
    best: u32,
    second: u32,
}

impl Nearest {
    const EMPTY: Self = Self {
        index: NONE,
        best: NONE,
        second: NONE,
    };

    fn offer(&mut self, index: u32, distance: u32) {
        if distance < self.best {
            self.second = self.best;
            self.best = distance;
            self.index = index;
        } else if distance < self.second {
            self.second = distance;
        }
    }
}

/// Pairs that are each other's nearest and pass the ratio test both ways, by first index.
pub fn match_mutual(
    first: &DescriptorSet,
    second: &DescriptorSet,
    config: &MatchConfig,
) -> Vec<Match> {
    let mut table = Table::new(first.len(), second.len());
    for i in 0..first.len() {
        for j in 0..second.len() {
            table.offer(i, j, first.distance_squared(i, second, j));
        }
    }
    table.matches(config)
}

/// Nearest neighbours in both directions.
struct Table {
    of_first: Vec<Nearest>,
    of_second: Vec<Nearest>,
}

impl Table {
    fn new(first: usize, second: usize) -> Self {
        Self {
            of_first: vec![Nearest::EMPTY; first],
            of_second: vec![Nearest::EMPTY; second],
        }
    }

    fn offer(&mut self, i: usize, j: usize, distance: u32) {
        self.of_first[i].offer(j as u32, distance);
        self.of_second[j].offer(i as u32, distance);
    }

    fn matches(&self, config: &MatchConfig) -> Vec<Match> {
        let mut matches = Vec::new();
        for (i, forward) in self.of_first.iter().enumerate() {
            let Some(backward) = self.of_second.get(forward.index as usize) else {
                continue;
            };
            if backward.index == i as u32
                && config.accepts(forward.best, forward.second)
                && config.accepts(backward.best, backward.second)
            {
                matches.push(Match {
                    first: i as u32,
                    second: forward.index,
                    distance_squared: forward.best,
                });
            }
        }
        matches
    }
}

/// One image's part in [`match_epipolar`]: descriptors and the unit viewing ray of each. A ray of zeros (a pixel that
/// the lens model cannot invert) matches nothing.
#[derive(Clone, Copy, Debug)]
pub struct RayFeatures<'a> {
    /// The descriptors.
    pub descriptors: &'a DescriptorSet,
    /// Unit rays in the camera frame, one per descriptor.
    pub rays: &'a [Vector3<f64>],
}

/// [`match_mutual`] among the pairs whose rays meet: within `max_angle_rad` of the epipolar plane and in front of both
/// cameras. `second_from_first` must be metric only up to scale.
pub fn match_epipolar(
    first: RayFeatures,
    second: RayFeatures,
    second_from_first: &Se3,
    max_angle_rad: f64,
    config: &MatchConfig,
) -> Vec<Match> {
    let baseline = second_from_first.translation;
    let mut table = Table::new(first.descriptors.len(), second.descriptors.len());
    let [xs, ys, zs] = [0, 1, 2].map(|axis| {
        let component = |r: &Vector3<f64>| r[axis] as f32;
        second.rays.iter().map(component).collect::<Vec<f32>>()
    });
    let max_sine = max_angle_rad.sin();
    let mut off_plane = vec![0.0f32; second.rays.len()];
    for (i, ray) in first.rays.iter().enumerate() {
        if ray.norm_squared() < 0.5 {
            continue;
        }
        let turned = second_from_first.rotation * ray;
        let normal = baseline.cross(&turned);
        let length = normal.norm();
        // A ray along the baseline lies in every epipolar plane.
        let along_baseline = length <= max_sine * baseline.norm();
        let n = if along_baseline {
            Vector3::zeros()
        } else {
            normal / length
        };
        let [nx, ny, nz] = [n.x as f32, n.y as f32, n.z as f32];
        for (off, ((x, y), z)) in off_plane.iter_mut().zip(xs.iter().zip(&ys).zip(&zs)) {
            *off = (nx * x + ny * y + nz * z).abs();
        }
        for (j, off) in off_plane.iter().enumerate() {
            if *off <= max_sine as f32 && in_front(&turned, &second.rays[j], &baseline, max_sine) {
                let distance = first.descriptors.distance_squared(i, second.descriptors, j);
                table.offer(i, j, distance);
            }
        }
    }
    table.matches(config)
}

/// Whether `origin + λ turned = μ ray` has λ, μ > 0, or the rays are too parallel to say.
fn in_front(turned: &Vector3<f64>, ray: &Vector3<f64>, origin: &Vector3<f64>, sine: f64) -> bool {
    if ray.norm_squared() < 0.5 {
        return false;
    }
    let across = ray.cross(turned);
    if across.norm() <= sine {
        return turned.dot(ray) > 0.0;
    }
    across.dot(&origin.cross(turned)) > 0.0 && across.dot(&origin.cross(ray)) > 0.0
}

/// Something expected at a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Prediction<'a> {
    /// Where it should be seen.
    pub pixel: Vector2<f64>,
    /// What it should look like: any of these.
    pub descriptors: &'a [Descriptor],
}

/// Matches predictions (`first`) to the keypoints (`second`) within `radius_px` of them; each keypoint is used at most
/// once, by the prediction that looks most like it.
pub fn match_projected(
    predictions: &[Prediction],
    keypoints: &KeypointGrid,
    descriptors: &[Descriptor],
    radius_px: f64,
    config: &MatchConfig,
) -> Vec<Match> {
    let mut table = Table::new(predictions.len(), descriptors.len());
    for (i, prediction) in predictions.iter().enumerate() {
        for j in keypoints.within(&prediction.pixel, radius_px) {
            let Some(seen) = descriptors.get(j as usize) else {
                continue;
            };
            let like = prediction
                .descriptors
                .iter()
                .map(|d| distance_squared(d, seen));
            if let Some(distance) = like.min() {
                table.of_first[i].offer(j, distance);
                // A keypoint may lie near many predictions of similar look: only the best counts, without ratio.
                let nearest = &mut table.of_second[j as usize];
                if distance < nearest.best {
                    nearest.best = distance;
                    nearest.index = i as u32;
                }
            }
        }
    }
    table.matches(config)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::Keypoint;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn random_descriptor(rng: &mut ChaCha8Rng) -> Descriptor {
        std::array::from_fn(|_| (rng.next_u32() % 90) as u8)
    }

    fn noisy(descriptor: &Descriptor, rng: &mut ChaCha8Rng) -> Descriptor {
        descriptor.map(|v| v.saturating_add((rng.next_u32() % 9) as u8))
    }

    #[test]
    fn finds_a_permutation_and_refuses_the_ambiguous() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let first: Vec<Descriptor> = (0..50).map(|_| random_descriptor(&mut rng)).collect();
        let mut second: Vec<Descriptor> = first.iter().rev().map(|d| noisy(d, &mut rng)).collect();
        // Descriptor 0 of the first set now has two equally good partners.
        second.push(second[49]);
        let found = match_mutual(
            &DescriptorSet::new(&first),
            &DescriptorSet::new(&second),
            &MatchConfig::default(),
        );
        let pairs: Vec<(u32, u32)> = found.iter().map(|m| (m.first, m.second)).collect();
        let expected: Vec<(u32, u32)> = (1..50).map(|i| (i, 49 - i)).collect();
        assert_eq!(pairs, expected);
        assert!(found.iter().all(|m| {
            m.distance_squared
                == distance_squared(&first[m.first as usize], &second[m.second as usize])
        }));
    }

    #[test]
    fn epipolar_geometry_separates_what_looks_alike() {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let second_from_first = Se3::exp(&[0.02, 0.1, -0.03, 0.4, 0.05, 0.1].into());
        let look = random_descriptor(&mut rng);
        let points: Vec<Vector3<f64>> = (0..40)
            .map(|i| {
                Vector3::new(
                    0.3 * f64::from(i % 8) - 1.0,
                    0.4 * f64::from(i / 8) - 1.0,
                    3.0,
                )
            })
            .collect();
        let first_rays: Vec<_> = points.iter().map(|p| p.normalize()).collect();
        let second_rays: Vec<_> = points
            .iter()
            .map(|p| (second_from_first * *p).normalize())
            .collect();
        // Points in one epipolar plane differ in look; all planes share the same set of looks.
        let looks: Vec<Descriptor> = (0..40)
            .map(|i| {
                std::array::from_fn(|k| {
                    if k / 16 == i % 8 {
                        200 - look[k]
                    } else {
                        look[k]
                    }
                })
            })
            .collect();
        let set = DescriptorSet::new(&looks);
        let config = MatchConfig::default();
        assert!(match_mutual(&set, &set, &config).is_empty());
        let first = RayFeatures {
            descriptors: &set,
            rays: &first_rays,
        };
        let second = RayFeatures {
            descriptors: &set,
            rays: &second_rays,
        };
        let found = match_epipolar(first, second, &second_from_first, 0.004, &config);
        assert!(found.len() >= 30, "{}", found.len());
        assert!(found.iter().all(|m| m.first == m.second));
    }

    #[test]
    fn projections_find_their_keypoints() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let looks: Vec<Descriptor> = (0..30).map(|_| random_descriptor(&mut rng)).collect();
        let keypoints: Vec<Keypoint> = (0..30)
            .map(|i| Keypoint {
                pixel: [20.0 * i as f32 + 5.0, 100.0],
                scale_px: 2.0,
                angle_rad: 0.0,
                response: 0.1,
            })
            .collect();
        let grid = KeypointGrid::new(&keypoints, 640, 400, 16.0);
        let predictions: Vec<Prediction> = (0..30)
            .map(|i| Prediction {
                pixel: Vector2::new(20.0 * i as f64 + 9.0, 103.0),
                descriptors: &looks[i..=i],
            })
            .collect();
        let found = match_projected(&predictions, &grid, &looks, 6.0, &MatchConfig::default());
        assert_eq!(found.len(), 30);
        assert!(
            found
                .iter()
                .all(|m| m.first == m.second && m.distance_squared == 0)
        );
        assert!(
            match_projected(&predictions, &grid, &looks, 4.0, &MatchConfig::default()).is_empty()
        );
    }
}
