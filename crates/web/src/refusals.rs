//! Whoever was refused is counted, with the reason; who it was is written nowhere.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Counts by reason.
#[derive(Debug, Default)]
pub struct Refusals(Mutex<BTreeMap<&'static str, u64>>);

impl Refusals {
    /// One more, for this reason.
    pub fn count(&self, reason: &'static str) {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *counts.entry(reason).or_default() += 1;
    }

    /// Forgets them: what is counted from now on belongs to another recording.
    pub fn clear(&self) {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clear();
    }

    /// One sentence; `None`: nobody was.
    pub fn sentence(&self) -> Option<String> {
        let counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let words: Vec<String> = counts
            .iter()
            .map(|(reason, count)| format!("{count} × {reason}"))
            .collect();
        (!words.is_empty()).then(|| format!("connections refused or ended: {}", words.join(", ")))
    }
}
