//! Where around a sensor something comes back.

use super::TURN_CENTIDEG;

/// Parts of a turn.
pub const SECTORS: usize = 72;

/// Shots of all lasers by the angle of the rotor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Azimuths {
    /// How often the lasers were fired in each sector, the first one beginning at 0°.
    pub fired: [u64; SECTORS],
    /// How often nothing came back to any of them.
    pub empty: [u64; SECTORS],
}

impl Default for Azimuths {
    fn default() -> Self {
        Self {
            fired: [0; SECTORS],
            empty: [0; SECTORS],
        }
    }
}

impl Azimuths {
    /// What was seen after `before`.
    pub fn since(&self, before: &Self) -> Self {
        let less = |now: &[u64; SECTORS], then: &[u64; SECTORS]| {
            std::array::from_fn(|k| now[k].saturating_sub(then[k]))
        };
        Self {
            fired: less(&self.fired, &before.fired),
            empty: less(&self.empty, &before.empty),
        }
    }

    /// Takes a shot of all lasers to which so many echoes came.
    pub(crate) fn note(&mut self, azimuth_centideg: u16, echoes: usize) {
        let sector =
            usize::from(azimuth_centideg % TURN_CENTIDEG) * SECTORS / usize::from(TURN_CENTIDEG);
        self.fired[sector] += 1;
        self.empty[sector] += u64::from(echoes == 0);
    }
}
