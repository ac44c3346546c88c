//! What work costs.

use nix::time::{ClockId, clock_gettime};

/// CPU time of this thread so far, milliseconds; of work that is to be measured it must be the only one.
pub fn cpu_ms() -> anyhow::Result<f64> {
    let time = clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID)?;
    Ok(1e3 * time.tv_sec() as f64 + 1e-6 * time.tv_nsec() as f64)
}
