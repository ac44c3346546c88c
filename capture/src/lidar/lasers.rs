//! Lasers that see nothing where their neighbours see something: dead ones, or a window that is dirty along a ring.
//!
//! A laser looks between those above and below it. Where both of these have returns all around, it has some as well, whatever there is
//! to see: the sky begins at one ring and goes on above it. Of a sensor with one laser left nothing lies between; but no place lets a
//! single laser of sixteen see all around and the others nothing.
//!
//! That holds for a single turn as well: who stands still sees the same with each. Nothing is said of one or two parts of a turn, or
//! of lasers that hardly see anything.

use std::ops::Range;

use lsfb_types::{LidarPoint, LidarScan};

/// Scans that are looked at together: one to four seconds of them.
pub(crate) const SCANS: usize = 20;
/// A laser sees nothing where it has less than this share of the returns of either neighbour.
const SILENT_SHARE: f64 = 0.02;
/// A neighbour counts where it has this share of the returns of most lasers that have any.
const SEEING_SHARE: f64 = 0.3;
/// Returns of the usual laser below which nothing is said: of fewer, the share that a silent one may have is less than one.
const LEAST_RETURNS: f64 = 100.0;
/// Eighths of a turn in which something must be seen where a window is not full: a shelf or a windowsill fills less than half of it.
const LEAST_EIGHTHS: usize = 4;
/// Share of the lasers that see something below which it is none of the place: even where only the ground is near, a third of them look
/// down on it.
const FEW_SHARE: f64 = 0.2;
/// Share of dead lasers from which on the scans are of little use.
const MANY_SHARE: f64 = 0.25;

/// Returns of each laser, the lowest first.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lasers {
    returns: Vec<u64>,
    /// Returns in each eighth of the turn.
    eighths: [u64; 8],
    scans: usize,
}

/// What the scans say of the lasers.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Seeing {
    /// Too little came back, or from too small a part of the turn.
    NotJudged,
    /// None is silent between others: so many of so many have returns.
    Well { seeing: usize, of: usize },
    /// These see nothing.
    Silent(Silent),
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
                "laser {} of {of}, counted from below, has no returns where its neighbours do",
                rings[0] + 1
            ),
            _ => format!(
                "{count} of its {of} lasers have no returns (counted from below: {})",
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
            self.eighths[eighth(point)] += 1;
        }
    }

    /// Whether a window is full.
    pub(crate) fn is_full(&self) -> bool {
        self.scans >= SCANS
    }

    /// What they say; `lasers`: how many the sensor has, where that is known.
    pub(crate) fn judge(&self, lasers: Option<usize>) -> Seeing {
        let of = lasers.unwrap_or(0).max(self.returns.len());
        let of_ring = |ring: usize| self.returns.get(ring).copied().unwrap_or(0);
        let mut some: Vec<u64> = self.returns.iter().copied().filter(|n| *n > 0).collect();
        some.sort_unstable();
        let usual = some.get(some.len() / 2).map_or(0.0, |n| *n as f64);
        let eighths = self.eighths.iter().filter(|n| **n > 0).count();
        let is_enough = self.is_full() || eighths >= LEAST_EIGHTHS;
        // One laser is one, or several that nobody told apart.
        if usual < LEAST_RETURNS || !is_enough || of < 2 {
            return Seeing::NotJudged;
        }
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
        let rings: Vec<usize> = match (seeing as f64) < FEW_SHARE * of as f64 {
            true => (0..of).filter(is_nothing).collect(),
            false => (0..of).filter(between).collect(),
        };
        match rings.is_empty() {
            true => Seeing::Well {
                seeing: of - (0..of).filter(is_nothing).count(),
                of,
            },
            false => Seeing::Silent(Silent { rings, of }),
        }
    }
}

/// In which eighth of the turn a point lies.
fn eighth(point: &LidarPoint) -> usize {
    let [x, y, _] = point.position_m;
    usize::from(x < 0.0) + 2 * usize::from(y < 0.0) + 4 * usize::from(x.abs() < y.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A scan of lasers that each have so many returns, all around or in this share of the turn.
    fn scan(returns: &[usize], turn: f32) -> LidarScan {
        let rings = returns.iter().enumerate();
        let of_ring = |(ring, count): (usize, &usize)| {
            let count = *count;
            (0..count).map(move |n| {
                let azimuth = n as f32 / count as f32 * turn * std::f32::consts::TAU;
                LidarPoint {
                    position_m: [azimuth.cos(), azimuth.sin(), 0.0],
                    ring: ring as u16,
                    ..LidarPoint::default()
                }
            })
        };
        LidarScan {
            points: rings.flat_map(of_ring).collect(),
        }
    }

    fn seen(scans: usize, scan: &LidarScan, lasers: Option<usize>) -> Seeing {
        let mut seen = Lasers::default();
        (0..scans).for_each(|_| seen.note(scan));
        seen.judge(lasers)
    }

    fn silent(returns: &[usize], lasers: Option<usize>) -> Option<Silent> {
        match seen(SCANS, &scan(returns, 1.0), lasers) {
            Seeing::Silent(silent) => Some(silent),
            _ => None,
        }
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
            "15 of its 16 lasers have no returns (counted from below: 1–4, 6–16)"
        );
        let mut one_dead = all;
        one_dead[7] = 3;
        let found = silent(&one_dead, Some(16)).expect("dead");
        assert!(!found.are_many());
        assert_eq!(
            found.words(),
            "laser 8 of 16, counted from below, has no returns where its neighbours do"
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

    /// A capture of three turns is short, and as clear. Once nothing was said of fewer than twenty.
    #[test]
    fn a_single_turn_tells_dead_lasers() {
        let mut one_left = [0; 32];
        one_left[7] = 1800;
        let dead =
            |seen: Seeing| matches!(seen, Seeing::Silent(silent) if silent.rings.len() == 31);
        assert!(dead(seen(1, &scan(&one_left, 1.0), Some(32))));
        assert!(dead(seen(1, &scan(&one_left, 0.6), Some(32))));
        // Of which sensor the cloud is, nobody said: there are eight at least.
        let eight = seen(1, &scan(&one_left[..8], 1.0), None);
        assert!(matches!(eight, Seeing::Silent(silent) if silent.of == 8));
        let well = Seeing::Well { seeing: 32, of: 32 };
        assert_eq!(seen(1, &scan(&[1800; 32], 1.0), Some(32)), well);
        // A part of a turn may lie before a shelf; a laser with few returns may have none by chance.
        for (returns, turn) in [(one_left, 0.3), ([20; 32], 1.0)] {
            assert_eq!(seen(1, &scan(&returns, turn), Some(32)), Seeing::NotJudged);
        }
        assert_eq!(seen(3, &scan(&[28_000], 1.0), None), Seeing::NotJudged);
    }
}
