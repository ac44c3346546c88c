//! What a LiDAR that sends and turns sees too little of: lasers that are dead, a part of its turn that is covered.

use lsfb_drivers::lidar::Azimuths;
use lsfb_types::LidarScan;

use super::blocked::Blocked;
use super::lasers::{Lasers, Silent};

/// Looks at the scans of one sensor, a few seconds at a time.
#[derive(Debug, Default)]
pub(crate) struct Sight {
    window: Lasers,
    /// Lasers that saw nothing in the last window, and in the worst one.
    silent: Option<Silent>,
    worst: Option<Silent>,
    /// How often so many lasers saw nothing that the scans were of little use.
    stretches: u64,
    blocked: Option<Blocked>,
}

impl Sight {
    /// Takes a scan of a sensor that has so many lasers, where that is known, and what it has seen by angle until now.
    pub(crate) fn note(&mut self, scan: &LidarScan, lasers: Option<usize>, seen: &Azimuths) {
        self.window.note(scan);
        if !self.window.is_enough() {
            return;
        }
        let was_poor = self.is_poor();
        self.silent = std::mem::take(&mut self.window).silent(lasers);
        self.stretches += u64::from(self.is_poor() && !was_poor);
        let count = |silent: &Option<Silent>| silent.as_ref().map_or(0, |s| s.rings.len());
        if count(&self.silent) > count(&self.worst) {
            self.worst = self.silent.clone();
        }
        self.blocked = Blocked::find(seen);
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

    /// The part of its turn from which nothing came back.
    pub(crate) fn blocked(&self) -> Option<Blocked> {
        self.blocked
    }
}
