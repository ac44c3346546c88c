//! What somebody sees who comes back to where he began, in a walk whose tracks know nothing of it.
//!
//! Landmarks of the beginning and of the end that look alike are the same: a motion that does not drift has them at the same places.

use std::collections::BTreeMap;
use std::path::Path;

use lsfb_geometry::align::{Scale, umeyama};
use lsfb_geometry::{StampedPose, Vector3};
use lsfb_perception::statistics::median;

use super::table::rows;

/// Bytes of a descriptor: bits.
const BYTES: usize = 48;
/// Fewest sights of a landmark.
const FEWEST_SIGHTS: usize = 5;
/// The most similar differs in so much less bits than the second.
const RATIO: f64 = 0.8;
const ROUNDS: usize = 20;

/// A landmark as maplab stores it.
struct Landmark {
    /// Keyframe in whose body frame it is stored, and in which it is about in the middle of its track.
    keyframe: usize,
    point_in_rig: Vector3<f64>,
    seen_at: usize,
    /// Bits that most of its sights have.
    look: [u8; BYTES],
}

impl Landmark {
    fn place(&self, poses: &[StampedPose]) -> Vector3<f64> {
        poses[self.keyframe].world_from_rig * self.point_in_rig
    }
}

/// The same landmarks, seen at the beginning and at the end of a walk.
pub struct Revisit {
    pairs: Vec<(Landmark, Landmark)>,
}

impl Revisit {
    /// Of the landmarks seen during the first and the last keyframes of a map.
    pub fn read(folder: &Path, first: usize, last: usize) -> Self {
        let landmarks = landmarks(folder);
        let end = landmarks.iter().map(|l| l.seen_at + 1).max().unwrap_or(0);
        let (mut begun, mut ended) = (Vec::new(), Vec::new());
        for landmark in landmarks {
            match landmark.seen_at {
                k if k < first => begun.push(landmark),
                k if k + last >= end => ended.push(landmark),
                _ => {}
            }
        }
        let back: Vec<_> = ended.iter().map(|l| most_alike(l, &begun)).collect();
        let forth: Vec<_> = begun.iter().map(|l| most_alike(l, &ended)).collect();
        let mut ended: Vec<_> = ended.into_iter().map(Some).collect();
        let mut pairs = Vec::new();
        for (k, (landmark, found)) in begun.into_iter().zip(forth).enumerate() {
            let (bits, second, other) = found;
            if back.get(other).is_some_and(|b| b.2 == k)
                && f64::from(bits) < RATIO * f64::from(second)
                && let Some(other) = ended[other].take()
            {
                pairs.push((landmark, other));
            }
        }
        Self { pairs }
    }

    /// How far the end of a motion lies from where it should be, metres and degrees, and by how many landmarks.
    pub fn drift(&self, poses: &[StampedPose]) -> (f64, f64, usize) {
        let places = |pair: &(Landmark, Landmark)| (pair.0.place(poses), pair.1.place(poses));
        let all: Vec<_> = self.pairs.iter().map(places).collect();
        let mut kept = all.clone();
        let mut drift = (f64::INFINITY, f64::INFINITY);
        for _ in 0..ROUNDS {
            let (begun, ended): (Vec<_>, Vec<_>) = kept.iter().copied().unzip();
            let alignment = umeyama(&begun, &ended, Scale::Fixed).expect("landmarks");
            let moved = alignment.target_from_source;
            let middle = begun.iter().sum::<Vector3<f64>>() / begun.len() as f64;
            let turn = moved.rotation.angle().to_degrees();
            drift = ((moved * middle - middle).norm(), turn);
            let left = |(a, b): &(Vector3<f64>, Vector3<f64>)| (alignment.apply(a) - b).norm();
            let limit = 3.0 * median(all.iter().map(left).collect()).expect("landmarks");
            kept = all.iter().filter(|p| left(p) <= limit).copied().collect();
        }
        (drift.0, drift.1, kept.len())
    }
}

/// Bits in which the most similar and the second differ, and which it is.
fn most_alike(of: &Landmark, among: &[Landmark]) -> (u32, u32, usize) {
    let mut best = (u32::MAX, u32::MAX, usize::MAX);
    for (k, other) in among.iter().enumerate() {
        let pairs = of.look.iter().zip(&other.look);
        let bits = pairs.map(|(a, b)| (a ^ b).count_ones()).sum();
        best = match bits < best.0 {
            true => (bits, best.0, k),
            false => (best.0, best.1.min(bits), best.2),
        };
    }
    best
}

fn landmarks(folder: &Path) -> Vec<Landmark> {
    let values = std::fs::read(folder.join("descriptors.bin")).expect("descriptors");
    let mut sights: BTreeMap<i64, Vec<(usize, &[u8])>> = BTreeMap::new();
    let keypoints = rows(&folder.join("keypoints.csv.gz"));
    assert_eq!(keypoints.len() * BYTES, values.len());
    for (row, look) in keypoints.iter().zip(values.chunks(BYTES)) {
        let of = sights.entry(row[6] as i64).or_default();
        of.push((row[0] as usize, look));
    }
    let stored = rows(&folder.join("landmarks.csv.gz"));
    let good = stored.iter().filter(|row| row[5] == 2.0);
    let landmarks = good.filter_map(|row| {
        let seen = sights.get(&(row[0] as i64))?;
        let is_set = |byte: usize, bit: usize| {
            let set = seen.iter().filter(|(_, look)| look[byte] >> bit & 1 == 1);
            2 * set.count() > seen.len()
        };
        let byte = |k: usize| (0..8).fold(0, |sum, bit| sum | u8::from(is_set(k, bit)) << bit);
        (seen.len() >= FEWEST_SIGHTS).then(|| Landmark {
            keyframe: row[1] as usize,
            point_in_rig: Vector3::new(row[2], row[3], row[4]),
            seen_at: seen[seen.len() / 2].0,
            look: std::array::from_fn(byte),
        })
    });
    landmarks.collect()
}
