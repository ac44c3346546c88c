//! The machine: processor and memory.

use std::path::Path;

use lsfb_types::{Finding, Limit, Verdict};

use super::{at_least, check, folders, read};
use crate::memory::meminfo_bytes;

const GOOD_MEMORY_BYTES: u64 = 2 << 30;

pub(super) fn governor(root: &Path) -> Finding {
    let name = "processor speed";
    let cores = folders(root, "sys/devices/system/cpu");
    let governors: Vec<String> = cores
        .iter()
        .filter_map(|core| read(core, "cpufreq/scaling_governor"))
        .collect();
    if governors.is_empty() {
        return check(name, Verdict::Pass, "fixed (no frequency scaling)", "");
    }
    let slow: Vec<_> = governors.iter().filter(|g| *g != "performance").collect();
    let found = match slow.first() {
        None => check(name, Verdict::Pass, "governor performance", ""),
        Some(governor) => check(
            name,
            Verdict::Warn,
            format!(
                "governor {governor} on {} of {} cores",
                slow.len(),
                governors.len()
            ),
            "sudo cpupower frequency-set -g performance",
        ),
    };
    found
        .value(slow.len() as f64, "cores")
        .limit(Limit::AtMost(0.0))
}

pub(super) fn memory(root: &Path) -> Finding {
    let free = meminfo_bytes(root, "MemAvailable:").unwrap_or_default();
    check(
        "memory",
        at_least(
            free as f64,
            GOOD_MEMORY_BYTES as f64,
            0.5 * GOOD_MEMORY_BYTES as f64,
        ),
        format!("{:.1} GB free", free as f64 / 1e9),
        "close other programs",
    )
    .value((free as f64 / 1e8).round() / 10.0, "GB")
    .limit(Limit::AtLeast(GOOD_MEMORY_BYTES as f64 / 1e9))
}
