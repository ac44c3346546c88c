//! The host's clock, which arrivals are stamped by.

use std::time::{SystemTime, UNIX_EPOCH};

use lsfb_types::Timestamp;

/// What something that arrives now is stamped.
pub(crate) fn arrival_now() -> Timestamp {
    let since = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    Timestamp::from_nanos(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}
