//! How much memory this process takes, and how much there is.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use nix::sys::resource::{UsageWho, getrusage};

/// The most memory that was held at once since the start, or since [`forget_peak`], megabytes; NaN where nobody says.
pub fn peak_rss_mb() -> f64 {
    // Linux counts kibibytes.
    getrusage(UsageWho::RUSAGE_SELF).map_or(f64::NAN, |usage| usage.max_rss() as f64 * 1024.0 / 1e6)
}

/// In how many ways stages run beside one another.
static BESIDE: AtomicUsize = AtomicUsize::new(0);

/// While it lives, stages run beside one another, and none may forget what another held.
pub struct Beside(());

impl Beside {
    pub fn begin() -> Self {
        BESIDE.fetch_add(1, Ordering::Relaxed);
        Self(())
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        BESIDE.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Counts the peak from now on, where the kernel can (`proc(5)`, `clear_refs`) and nothing runs beside; elsewhere it stays that of the whole
/// process.
pub fn forget_peak() {
    if BESIDE.load(Ordering::Relaxed) > 0 {
        return;
    }
    // What cannot be reset is an upper limit.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// What could be taken without swapping, megabytes; `None` where the kernel does not say.
pub fn free_mb() -> Option<u64> {
    let bytes = meminfo_bytes(Path::new("/"), "MemAvailable:")?;
    Some(bytes / 1_000_000)
}

/// A field of `/proc/meminfo` below `root`, bytes.
pub fn meminfo_bytes(root: &Path, field: &str) -> Option<u64> {
    let table = std::fs::read_to_string(root.join("proc/meminfo")).ok()?;
    let line = table.lines().find_map(|line| line.strip_prefix(field))?;
    let kilobytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes * 1024)
}
