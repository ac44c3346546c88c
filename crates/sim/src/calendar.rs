//! When it all takes place: on the simulation's own calendar, never the host's clock.

use lsfb_types::Timestamp;

/// When the scan begins: 2026-03-01T10:00:00Z.
pub const EPOCH: Timestamp = Timestamp::from_nanos(1_772_359_200_000_000_000);
/// When the walk with the glasses begins: ten minutes later.
pub const GLASSES_EPOCH: Timestamp = Timestamp::from_nanos(1_772_359_800_000_000_000);
