//! What a LiDAR that sends and turns sees too little of: lasers that are dead, a part of its turn that is covered.

use lsfb_drivers::lidar::Azimuths;
use lsfb_types::LidarScan;

use super::blocked::Blocked;
use super::lasers::{Lasers, Seeing, Silent};

/// Looks at the scans of one sensor, a few seconds at a time.
#[derive(Debug, Default)]
pub(crate) struct Sight {
    window: Lasers,
    /// How many lasers the sensor has, where that is known.
    lasers: Option<usize>,
    /// Lasers that saw nothing in the last window, and in the worst one.
    silent: Option<Silent>,
    worst: Option<Silent>,
    /// How many lasers saw something when the fewest did, of how many; `None` before something could be said.
    seeing: Option<(usize, usize)>,
    /// How often so many lasers saw nothing that the scans were of little use.
    stretches: u64,
    /// What it had seen by angle when the window of its turn began, and until now.
    before: Azimuths,
    until: Azimuths,
    /// A part of the turn that is covered now, and one that ever was.
    blocked: Option<Blocked>,
    ever_blocked: Option<Blocked>,
    is_turn_judged: bool,
}

impl Sight {
    /// Takes a scan of a sensor that has so many lasers, where that is known, and what it has seen by angle until now.
    pub(crate) fn note(&mut self, scan: &LidarScan, lasers: Option<usize>, seen: &Azimuths) {
        self.lasers = lasers;
        self.window.note(scan);
        if self.window.is_full() {
            self.judge_lasers();
        }
        self.until = *seen;
        if Blocked::is_full(&self.until.since(&self.before)) {
            self.judge_turn();
        }
    }

    /// Nothing more comes: what is shorter than a window is judged as far as it goes, where there was none.
    pub(crate) fn finish(&mut self) {
        if self.seeing.is_none() && self.silent.is_none() {
            self.judge_lasers();
        }
        if !self.is_turn_judged && Blocked::is_enough(&self.until) {
            self.judge_turn();
        }
    }

    fn judge_lasers(&mut self) {
        let was_poor = self.is_poor();
        self.silent = match std::mem::take(&mut self.window).judge(self.lasers) {
            Seeing::NotJudged => None,
            Seeing::Well { seeing, of } => {
                let fewest = self.seeing.map_or(seeing, |(fewest, _)| fewest.min(seeing));
                self.seeing = Some((fewest, of));
                None
            }
            Seeing::Silent(silent) => Some(silent),
        };
        self.stretches += u64::from(self.is_poor() && !was_poor);
        let count = |silent: &Option<Silent>| silent.as_ref().map_or(0, |s| s.rings.len());
        if count(&self.silent) > count(&self.worst) {
            self.worst = self.silent.clone();
        }
    }

    fn judge_turn(&mut self) {
        self.is_turn_judged = true;
        self.blocked = Blocked::find(&self.until.since(&self.before));
        self.ever_blocked = self.ever_blocked.or(self.blocked);
        self.before = self.until;
    }

    /// Whether the scans are of little use.
    pub(crate) fn is_poor(&self) -> bool {
        self.silent.as_ref().is_some_and(Silent::are_many)
    }

    pub(crate) fn stretches(&self) -> u64 {
        self.stretches
    }

    /// What it sees too little of now.
    pub(crate) fn problem(&self) -> Option<String> {
        let of_lasers = self.silent.as_ref().map(Silent::words);
        of_lasers.or_else(|| self.blocked.map(Blocked::words))
    }

    /// The lasers that saw nothing when most of them did not.
    pub(crate) fn worst(&self) -> Option<&Silent> {
        self.worst.as_ref()
    }

    /// How many lasers saw something when the fewest did, and of how many, where none was silent between others; `None`: not judged.
    pub(crate) fn seeing(&self) -> Option<(usize, usize)> {
        self.seeing
    }

    /// The part of its turn from which nothing came back for a while.
    pub(crate) fn ever_blocked(&self) -> Option<Blocked> {
        self.ever_blocked
    }

    /// Whether it was looked for such a part.
    pub(crate) fn is_turn_judged(&self) -> bool {
        self.is_turn_judged
    }
}

#[cfg(test)]
mod tests {
    use lsfb_drivers::lidar::SECTORS;

    use super::*;

    /// Since the beginning most shots of that sector had come back: once a strap that slipped down later was never told.
    #[test]
    fn a_part_of_the_turn_that_is_covered_later_is_told_and_may_be_free_again() {
        let mut sight = Sight::default();
        let mut seen = Azimuths::default();
        let mut turn = |sight: &mut Sight, is_covered: bool, turns: usize| {
            for _ in 0..turns {
                for sector in 0..SECTORS {
                    seen.fired[sector] += 25;
                    let is_dark = is_covered && (10..16).contains(&sector);
                    seen.empty[sector] += if is_dark { 25 } else { 0 };
                }
                sight.note(&LidarScan::default(), Some(32), &seen);
            }
            sight.problem().is_some()
        };
        assert!(!turn(&mut sight, false, 600));
        assert!(turn(&mut sight, true, 160));
        assert!(!turn(&mut sight, false, 160));
        let told = sight.ever_blocked().expect("it was covered");
        assert_eq!((told.from_deg, told.to_deg), (50, 80));
    }
}
