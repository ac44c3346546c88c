//! How much memory this process takes, and how much there is.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use nix::sys::resource::{UsageWho, getrusage};

/// The most memory that was held at once since the start, or since a stage began that ran alone ([`peak_of`]), megabytes; NaN where nobody says.
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

/// The most memory that the program held during a stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Megabytes; NaN where nobody says.
    pub mb: f64,
    /// Whether other stages ran beside it, whose memory is in this.
    pub is_shared: bool,
}

/// How often a stage that has others beside it is looked at.
const SAMPLE_PERIOD: Duration = Duration::from_millis(50);

/// Runs a stage. Alone, its peak is the kernel's (`proc(5)`, `clear_refs`; where that cannot be reset, that of the whole process). Beside others,
/// that of the kernel may be of before: then what is held is sampled.
pub fn peak_of<T>(run: impl FnOnce() -> T) -> (T, Peak) {
    if BESIDE.load(Ordering::Relaxed) == 0 {
        // What cannot be reset is an upper limit.
        let _ = std::fs::write("/proc/self/clear_refs", "5");
        let result = run();
        let mb = peak_rss_mb();
        let is_shared = false;
        return (result, Peak { mb, is_shared });
    }
    let (ended, wait) = std::sync::mpsc::sync_channel::<()>(0);
    let (result, mb) = std::thread::scope(|scope| {
        let sampler = std::thread::Builder::new().name("memory".to_owned());
        let sampler = sampler.spawn_scoped(scope, move || {
            let mut most_mb = f64::NAN;
            loop {
                most_mb = rss_mb().map_or(most_mb, |mb| most_mb.max(mb));
                if wait.recv_timeout(SAMPLE_PERIOD) != Err(RecvTimeoutError::Timeout) {
                    return most_mb;
                }
            }
        });
        let result = run();
        drop(ended);
        let most_mb = sampler.ok().and_then(|sampler| sampler.join().ok());
        (result, most_mb.unwrap_or(f64::NAN))
    });
    let is_shared = true;
    (result, Peak { mb, is_shared })
}

/// What the process holds now, megabytes; `None` where the kernel does not say.
fn rss_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes: f64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes * 1024.0 / 1e6)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The kernel's peak is that of the process: what one stage held would be counted to all later ones.
    #[test]
    fn a_stage_beside_others_has_not_the_peak_of_those_before_it() {
        let _beside = Beside::begin();
        let (held, large) = peak_of(|| {
            let held = std::hint::black_box(vec![1_u8; 400_000_000]);
            std::thread::sleep(4 * SAMPLE_PERIOD);
            held
        });
        drop(held);
        let ((), small) = peak_of(|| ());
        assert!(large.is_shared && small.is_shared);
        assert!(large.mb - small.mb > 200.0, "{large:?} {small:?}");
        assert!(small.mb > 0.0, "{small:?}");
    }
}
