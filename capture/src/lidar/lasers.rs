//! Lasers that see nothing where their neighbours see something: dead ones, or a window that is dirty along a ring.
//!
//! A laser looks between those above and below it. Where both of these have returns all around, it has some as well, whatever there is
//! to see: the sky begins at one ring and goes on above it. Of a sensor with one laser left nothing lies between; but no place lets a
//! single laser of sixteen see all around and the others nothing.

use std::ops::Range;

use lsfb_types::LidarScan;

/// Scans that are looked at together: one to four seconds of them.
pub(crate) const SCANS: usize = 20;
/// A laser sees nothing where it has less than this share of the returns of either neighbour.
const SILENT_SHARE: f64 = 0.02;
/// A neighbour counts where it has this share of the returns of most lasers that have any.
const SEEING_SHARE: f64 = 0.3;
/// Returns in so many scans below which nothing is said.
const LEAST_RETURNS: u64 = 2_000;
/// Share of the lasers that see something below which it is none of the place: even where only the ground is near, a third of them look
/// down on it.
const FEW_SHARE: f64 = 0.2;
/// Share of dead lasers from which on the scans are of little use.
const MANY_SHARE: f64 = 0.25;

/// Returns of each laser, the lowest first.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lasers {
    returns: Vec<u64>,
    scans: usize,
}

/// Lasers that see nothing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Silent {
    /// By their rank from below, from 0.
    pub rings: Vec<usize>,
    /// How many the sensor has, as far as is known.
    pub of: usize,
}

impl Silent {
    /// Whether what is left is of little use.
    pub(crate) fn are_many(&self) -> bool {
        self.rings.len() as f64 >= MANY_SHARE * self.of as f64
    }

    pub(crate) fn words(&self) -> String {
        let Self { rings, of } = self;
        let count = rings.len();
        match count {
            1 => format!(
                "laser {} of {of}, counted from below, sees nothing where its neighbours do",
                rings[0] + 1
            ),
            _ => format!(
                "{count} of its {of} lasers see nothing (counted from below: {})",
                ranges(rings)
            ),
        }
    }
}

/// `1–3, 7`, counted from 1.
fn ranges(rings: &[usize]) -> String {
    let mut found: Vec<Range<usize>> = Vec::new();
    for ring in rings {
        match found.last_mut() {
            Some(last) if last.end == *ring => last.end = ring + 1,
            _ => found.push(*ring..ring + 1),
        }
    }
    let words = found.iter().map(|range| match range.len() {
        1 => format!("{}", range.end),
        _ => format!("{}–{}", range.start + 1, range.end),
    });
    words.collect::<Vec<_>>().join(", ")
}

impl Lasers {
    pub(crate) fn note(&mut self, scan: &LidarScan) {
        self.scans += 1;
        for point in &scan.points {
            let ring = usize::from(point.ring);
            if self.returns.len() <= ring {
                self.returns.resize(ring + 1, 0);
            }
            self.returns[ring] += 1;
        }
    }

    /// Whether there are scans enough to say something.
    pub(crate) fn is_enough(&self) -> bool {
        self.scans >= SCANS
    }

    /// Those that see nothing; `lasers`: how many the sensor has, where that is known.
    pub(crate) fn silent(&self, lasers: Option<usize>) -> Option<Silent> {
        let of = lasers.unwrap_or(0).max(self.returns.len());
        let of_ring = |ring: usize| self.returns.get(ring).copied().unwrap_or(0);
        let mut some: Vec<u64> = self.returns.iter().copied().filter(|n| *n > 0).collect();
        if self.returns.iter().sum::<u64>() < LEAST_RETURNS {
            return None;
        }
        some.sort_unstable();
        let usual = some.get(some.len() / 2).copied()? as f64;
        let sees = |ring: &usize| of_ring(*ring) as f64 >= SEEING_SHARE * usual;
        let seeing = (0..of).filter(sees).count();
        let between = |ring: &usize| {
            let below = (0..*ring).rev().find(sees);
            let above = (ring + 1..of).find(sees);
            let Some((below, above)) = below.zip(above) else {
                return false;
            };
            let least = of_ring(below).min(of_ring(above)) as f64;
            (of_ring(*ring) as f64) < SILENT_SHARE * least
        };
        let is_nothing = |ring: &usize| (of_ring(*ring) as f64) < SILENT_SHARE * usual;
        let rings: Vec<usize> = match lasers {
            Some(lasers) if (seeing as f64) < FEW_SHARE * lasers as f64 => {
                (0..of).filter(is_nothing).collect()
            }
            _ => (0..of).filter(between).collect(),
        };
        (!rings.is_empty()).then_some(Silent { rings, of })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_types::LidarPoint;

    /// Twenty scans of lasers that each have so many returns a scan.
    fn silent(returns: &[usize], lasers: Option<usize>) -> Option<Silent> {
        let mut seen = Lasers::default();
        for _ in 0..SCANS {
            let rings = returns.iter().enumerate();
            let rings = rings.flat_map(|(ring, n)| std::iter::repeat_n(ring as u16, *n));
            let points = rings.map(|ring| LidarPoint {
                ring,
                ..LidarPoint::default()
            });
            seen.note(&LidarScan {
                points: points.collect(),
            });
        }
        assert!(seen.is_enough());
        seen.silent(lasers)
    }

    /// Once fifteen of sixteen could be dead, and all looked healthy.
    #[test]
    fn dead_lasers_are_told_from_the_sky() {
        let all = [1800; 16];
        assert_eq!(silent(&all, Some(16)), None);
        let mut one_left = [0; 16];
        one_left[4] = 1800;
        let found = silent(&one_left, Some(16)).expect("dead");
        assert!(found.are_many());
        assert_eq!(
            found.words(),
            "15 of its 16 lasers see nothing (counted from below: 1–4, 6–16)"
        );
        let mut one_dead = all;
        one_dead[7] = 3;
        let found = silent(&one_dead, Some(16)).expect("dead");
        assert!(!found.are_many());
        assert_eq!(
            found.words(),
            "laser 8 of 16, counted from below, sees nothing where its neighbours do"
        );
        // A field under the sky: what looks above the horizon sees nothing, what grazes the ground hardly anything.
        let mut field = [1800; 16];
        field[6] = 300;
        field[7..].fill(0);
        assert_eq!(silent(&field, Some(16)), None);
        // Rings that nobody told apart, and hardly a return at all.
        assert_eq!(silent(&[28_000], None), None);
        assert_eq!(silent(&[0, 0, 0, 3], Some(16)), None);
    }
}
