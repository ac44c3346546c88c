//! What is received, written and lost while a session runs.

mod arrival;
mod expected;
mod meter;
mod monitor;
mod snapshot;
mod stale;

pub(crate) use crate::report::{Ending, StreamReport};
pub(crate) use arrival::arrival_now;
pub(crate) use expected::Expected;
pub(crate) use meter::{Connection, Meter};
pub(crate) use monitor::Monitor;
pub use snapshot::{
    DeviceHealth, HealthFeed, Level, PartHealth, Snapshot, StorageHealth, SyncState,
};
pub(crate) use stale::{Repeats, Says, Stale};
