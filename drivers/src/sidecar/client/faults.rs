//! What goes wrong on the way, made on purpose and at random: a rig must have every message once all the same.

use std::thread;
use std::time::Duration;

use super::SidecarClient;
use crate::Error;

/// One message in so many meets a fault.
const EVERY: u64 = 24;
/// Most bytes after which a connection is cut.
const MAX_BYTES: u64 = 4_096;
/// An app that does not read for a while.
const PAUSE: Duration = Duration::from_millis(40);

/// Random numbers, the same for the same seed (SplitMix64).
#[derive(Clone, Debug)]
pub(super) struct Faults(u64);

impl Faults {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }
}

impl SidecarClient {
    /// Perhaps one fault.
    pub(super) fn suffer(&mut self) -> Result<(), Error> {
        let Some(faults) = &mut self.faults else {
            return Ok(());
        };
        if !faults.next().is_multiple_of(EVERY) {
            return Ok(());
        }
        let (kind, bytes) = (faults.next() % 5, faults.next() % MAX_BYTES);
        match kind {
            0 => self.cut_after(bytes),
            1 => self.repeat_last()?,
            2 => self.send_damaged()?,
            // A number far ahead.
            3 => self.send_ahead(bytes)?,
            _ => thread::sleep(PAUSE),
        }
        Ok(())
    }
}
