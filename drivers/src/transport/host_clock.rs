use std::time::{SystemTime, UNIX_EPOCH};

use lsfb_types::Timestamp;

/// Host time now, for packets that the kernel does not stamp.
pub(crate) fn arrival_now() -> Timestamp {
    // A host clock before 1970 is a host without a clock: zero.
    let since_epoch = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    Timestamp::from_nanos(i64::try_from(since_epoch.as_nanos()).unwrap_or(i64::MAX))
}
