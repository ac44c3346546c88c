//! How often images matched a map well enough, by the paper's rule.

use serde::Serialize;

/// A frame succeeded where it matched more features of the map than this (Liu et al., section VI-A).
const MATCHES: f64 = 30.0;

/// Success rate of localization: it says how often a map was recognised, and not whether the pose is right.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SuccessRate {
    /// Frames tried, with a pose or without.
    pub frames: usize,
    /// Frames with more than 30 matches.
    pub succeeded: usize,
    /// Frames whose pose the program vouches for.
    pub localized: usize,
}

impl SuccessRate {
    /// Counts one more frame.
    pub(crate) fn add(&mut self, matches: f64, is_localized: bool) {
        self.frames += 1;
        self.succeeded += usize::from(matches > MATCHES);
        self.localized += usize::from(is_localized);
    }

    /// Share of all frames that succeeded, 0 to 1.
    pub fn rate(&self) -> f64 {
        self.succeeded as f64 / self.frames.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames without a match count: leaving them out would say 100 %.
    #[test]
    fn more_than_thirty_of_all_frames() {
        let mut found = SuccessRate::default();
        for (matches, is_localized) in [(0.0, false), (30.0, true), (31.0, true), (500.0, false)] {
            found.add(matches, is_localized);
        }
        assert_eq!((found.frames, found.succeeded, found.localized), (4, 2, 2));
        assert_eq!(found.rate(), 0.5);
    }
}
