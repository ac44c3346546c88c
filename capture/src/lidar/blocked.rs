//! A part of the turn from which nothing comes back, though the lasers are fired there: something stands before the window.
//!
//! The sky gives nothing back either. But where it can be seen at all it is seen by half a turn of a sensor that lies on its side, or
//! between things whose outline is that of the place; a cap, a strap or a carrier takes a smaller part with sharp edges, and all around
//! it something is seen.

use lsfb_drivers::lidar::{Azimuths, SECTORS};

/// Shots in a sector that are looked at together: of ten to twenty-five seconds, so that whoever walks past a brink is not asked.
const WINDOW_SHOTS: u64 = 2_000;
/// Shots in a sector from which on something is said of a recording that is shorter: of two to five seconds.
const LEAST_SHOTS: u64 = 400;
/// Share of the shots of a blocked sector that may bring something back, and of those of others that must.
const BLOCKED_SHARE: f64 = 0.005;
const SEEING_SHARE: f64 = 0.9;
/// Sectors at either edge that are neither.
const EDGE: usize = 1;
/// Blocked sectors: less may be a pole, more may be the sky.
const LEAST: usize = 3;
const MOST: usize = SECTORS / 3;

/// From which angle to which nothing is seen, clockwise from above, degrees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Blocked {
    pub from_deg: usize,
    pub to_deg: usize,
}

impl Blocked {
    /// Whether there are shots enough for a window.
    pub(crate) fn is_full(seen: &Azimuths) -> bool {
        seen.fired.iter().any(|fired| *fired >= WINDOW_SHOTS)
    }

    /// Whether there are shots enough to say something.
    pub(crate) fn is_enough(seen: &Azimuths) -> bool {
        seen.fired.iter().any(|fired| *fired >= LEAST_SHOTS)
    }

    pub(crate) fn find(seen: &Azimuths) -> Option<Self> {
        let has_fired = |k: usize| seen.fired[k] >= LEAST_SHOTS;
        let share = |k: usize| {
            let fired = seen.fired[k].max(1) as f64;
            1.0 - seen.empty[k] as f64 / fired
        };
        let is_blocked = |k: usize| has_fired(k) && share(k) <= BLOCKED_SHARE;
        let first =
            (0..SECTORS).find(|k| is_blocked(*k) && !is_blocked((k + SECTORS - 1) % SECTORS))?;
        let count = (0..SECTORS)
            .take_while(|n| is_blocked((first + n) % SECTORS))
            .count();
        if !(LEAST..=MOST).contains(&count) {
            return None;
        }
        let others = (count + EDGE..SECTORS - EDGE).map(|n| (first + n) % SECTORS);
        // Where a field of view is set, nothing is fired outside it.
        let mut fired = others.filter(|k| seen.fired[*k] > 0).peekable();
        fired.peek()?;
        let width_deg = 360 / SECTORS;
        fired.all(|k| share(k) >= SEEING_SHARE).then_some(Self {
            from_deg: first * width_deg,
            to_deg: (first + count) % SECTORS * width_deg,
        })
    }

    pub(crate) fn words(self) -> String {
        let Self { from_deg, to_deg } = self;
        format!(
            "no returns between {from_deg}° and {to_deg}° of its turn: is its window covered there?"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(share_of: impl Fn(usize) -> f64) -> Option<Blocked> {
        let mut seen = Azimuths::default();
        for k in 0..SECTORS {
            seen.fired[k] = 5_000;
            seen.empty[k] = (5_000.0 * (1.0 - share_of(k))) as u64;
        }
        Blocked::find(&seen)
    }

    /// Once a sector that was taped over looked like a sensor in good health.
    #[test]
    fn a_covered_sector_is_told_from_the_sky() {
        assert_eq!(seen(|_| 1.0), None);
        let tape = |k: usize| if (10..16).contains(&k) { 0.0 } else { 1.0 };
        let found = seen(tape).expect("blocked");
        assert_eq!((found.from_deg, found.to_deg), (50, 80));
        // Across the beginning of the turn.
        let strap = |k: usize| if (3..70).contains(&k) { 1.0 } else { 0.0 };
        let found = seen(strap).expect("blocked");
        assert_eq!((found.from_deg, found.to_deg), (350, 15));
        // A sensor on its side under the sky, and one between houses.
        assert_eq!(seen(|k| if k < 35 { 0.0 } else { 1.0 }), None);
        assert_eq!(seen(|k| (k as f64 / 18.0 - 1.0).clamp(0.0, 1.0)), None);
    }
}
