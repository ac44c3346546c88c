//! Parts of a map that are drawn again, larger, as those of Fig. 1 of the paper are.

use std::collections::{BTreeMap, BTreeSet};

use super::Track;

/// Most that are chosen.
const MOST: usize = 3;
/// Side of a chosen one, as a share of how far the trajectories extend.
const SHARE: f64 = 0.2;
/// Trajectories that extend by less need no larger drawing, metres.
const LEAST_EXTENT_M: f64 = 5.0;

/// A square seen from above.
#[derive(Clone, Debug, PartialEq)]
pub struct Inset {
    /// What stands at its corner: (b), (c), as (a) is the whole.
    pub name: String,
    /// Its middle, metres.
    pub middle_m: [f64; 2],
    /// Its side, metres.
    pub side_m: f64,
}

impl Inset {
    /// Squares in the order of a figure: the first is (b).
    pub fn named(squares: impl IntoIterator<Item = ([f64; 2], f64)>) -> Vec<Self> {
        let letters = 'b'..='z';
        let named = squares.into_iter().zip(letters);
        named
            .map(|((middle_m, side_m), letter)| Self {
                name: format!("({letter})"),
                middle_m,
                side_m,
            })
            .collect()
    }

    /// Where most of the trajectories pass, and of equally many the most poses lie: up to three squares that lie apart.
    pub fn chosen(tracks: &[Track]) -> Vec<Self> {
        let places: Vec<(usize, [f64; 2])> = tracks
            .iter()
            .enumerate()
            .flat_map(|(i, track)| {
                let poses = track.estimate.poses().iter();
                poses.map(move |p| {
                    let at = p.world_from_rig.translation;
                    (i, [at.x, at.y])
                })
            })
            .filter(|(_, at)| at.iter().all(|v| v.is_finite()))
            .collect();
        let extent = |axis: usize| {
            let values = places.iter().map(|(_, at)| at[axis]);
            let (low, high) = values.fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
            high - low
        };
        let extent_m = extent(0).max(extent(1));
        if !(extent_m >= LEAST_EXTENT_M) {
            return Vec::new();
        }
        let side_m = SHARE * extent_m;
        // Squares on a grid of half their side: each pose is in four of them.
        let step_m = 0.5 * side_m;
        let mut squares: BTreeMap<(i64, i64), (BTreeSet<usize>, usize)> = BTreeMap::new();
        for (track, at) in &places {
            let cell = at.map(|v| (v / step_m).floor() as i64);
            for square in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let first = (cell[0] - square.0, cell[1] - square.1);
                let (walks, poses) = squares.entry(first).or_default();
                walks.insert(*track);
                *poses += 1;
            }
        }
        let mut ranked: Vec<_> = squares
            .into_iter()
            .map(|(square, (walks, poses))| ((walks.len(), poses), square))
            .collect();
        // Stable: of equal ones that nearest to the origin of the grid.
        ranked.sort_by_key(|(count, ..)| std::cmp::Reverse(*count));
        let mut chosen: Vec<(i64, i64)> = Vec::new();
        for (_, square) in ranked {
            let is_apart =
                |c: &(i64, i64)| (c.0 - square.0).abs() > 2 || (c.1 - square.1).abs() > 2;
            if chosen.len() < MOST && chosen.iter().all(is_apart) {
                chosen.push(square);
            }
        }
        let middle = |c: (i64, i64)| [(c.0 + 1) as f64 * step_m, (c.1 + 1) as f64 * step_m];
        Self::named(chosen.into_iter().map(|c| (middle(c), side_m)))
    }

    /// Lowest and highest coordinate on both axes.
    pub(super) fn ranges(&self) -> [[f64; 2]; 2] {
        let half = 0.5 * self.side_m;
        self.middle_m.map(|m| [m - half, m + half])
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Se3, StampedPose, Trajectory, Vector3};
    use lsfb_types::Timestamp;

    use super::*;

    fn track(place: impl Fn(f64) -> [f64; 2]) -> Track {
        let pose = |i: u32| {
            let [x, y] = place(f64::from(i) / 500.0);
            StampedPose {
                time: Timestamp::from_secs_f64(f64::from(i)),
                world_from_rig: Se3::new(Default::default(), Vector3::new(x, y, 1.5)),
            }
        };
        Track {
            name: "walk".to_owned(),
            series: None,
            estimate: Trajectory::new((0..500).map(pose).collect()),
            truth: None,
            errors: Vec::new(),
        }
    }

    #[test]
    fn insets_are_where_the_walks_meet() {
        // A cross, whose middle is the one place where both are.
        let tracks = [track(|t| [40.0 * t, 20.0]), track(|t| [20.0, 40.0 * t])];
        let chosen = Inset::chosen(&tracks);
        assert_eq!(chosen.len(), 3);
        assert_eq!(chosen[0].name, "(b)");
        let [x, y] = chosen[0].ranges();
        assert!(x[0] < 20.0 && x[1] > 20.0 && y[0] < 20.0 && y[1] > 20.0);
        for (i, one) in chosen.iter().enumerate() {
            for other in &chosen[..i] {
                let apart = |k: usize| (one.middle_m[k] - other.middle_m[k]).abs();
                assert!(apart(0).max(apart(1)) > one.side_m, "{one:?} {other:?}");
            }
        }
        // Nothing to enlarge, and nothing at all.
        assert!(Inset::chosen(&[track(|t| [3.0 * t, 0.0])]).is_empty());
        assert!(Inset::chosen(&[]).is_empty());
        let lost = track(|t| [f64::NAN * t, 0.0]);
        assert!(Inset::chosen(&[lost]).is_empty());
    }
}
