//! How much memory this process takes.

use nix::sys::resource::{UsageWho, getrusage};

/// The most memory that was held at once since the start, or since [`forget_peak`], megabytes; NaN where nobody says.
pub fn peak_rss_mb() -> f64 {
    // Linux counts kibibytes.
    getrusage(UsageWho::RUSAGE_SELF).map_or(f64::NAN, |usage| usage.max_rss() as f64 * 1024.0 / 1e6)
}

/// Counts the peak from now on, where the kernel can (`proc(5)`, `clear_refs`); elsewhere it stays that of the whole process.
pub fn forget_peak() {
    // What cannot be reset is an upper limit.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}
