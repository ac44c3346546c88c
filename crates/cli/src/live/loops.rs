//! The thread that looks for places that the walk comes back to.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use anyhow::Context as _;
use lsfb_geometry::Rig;
use lsfb_pipeline::loops::{OnlineLoop, OnlineLoops};
use lsfb_pipeline::odometry::{OdometryConfig, OdometryStep};

/// Scans that wait while one is looked for: some seconds. What comes then is passed over, and loops are sought among the rest.
const QUEUE_STEPS: usize = 64;
/// Loops that wait.
const QUEUE_LOOPS: usize = 64;

struct Work {
    step: OdometryStep,
    /// Whether the walk began again with a step that was passed over before this one.
    begins_again: bool,
}

/// Looks for loops of one recording, beside the odometry.
pub struct LoopsThread {
    work: SyncSender<Work>,
    found: Receiver<OnlineLoop>,
    /// Whether the walk began again with a step that was passed over since.
    begins_again: bool,
    unsearched: Arc<AtomicU64>,
    /// Scans taken that the thread is not done with.
    waiting: Arc<AtomicU64>,
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl LoopsThread {
    /// Starts it for a rig with a LiDAR; `None` without one.
    pub fn start(rig: &Rig) -> anyhow::Result<Option<Self>> {
        let Some(lidar) = rig.lidar() else {
            return Ok(None);
        };
        let mut loops = OnlineLoops::new(&OdometryConfig::default(), lidar)?;
        let (work, queue) = sync_channel::<Work>(QUEUE_STEPS);
        let (done, found) = sync_channel(QUEUE_LOOPS);
        let end = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&end);
        let unsearched = Arc::new(AtomicU64::new(0));
        let failed = Arc::clone(&unsearched);
        let waiting = Arc::new(AtomicU64::new(0));
        let waits = Arc::clone(&waiting);
        let run = move || {
            for work in queue {
                if ends.load(Ordering::Relaxed) {
                    return;
                }
                if work.begins_again {
                    loops.begin_again();
                }
                // A graph that cannot be solved tells of no loop; the next scan has another.
                let found = loops.push(&work.step);
                waits.fetch_sub(1, Ordering::Relaxed);
                let Ok(found) = found else {
                    failed.fetch_add(1, Ordering::Relaxed);
                    continue;
                };
                for found in found {
                    if done.send(found).is_err() {
                        return;
                    }
                }
            }
        };
        let thread = std::thread::Builder::new()
            .name("live-loops".to_owned())
            .spawn(run)
            .context("cannot start the thread that looks for loops")?;
        Ok(Some(Self {
            work,
            found,
            begins_again: false,
            unsearched,
            waiting,
            end,
            thread: Some(thread),
        }))
    }

    /// Takes what a scan gave, or passes it over where there is too much to look at.
    pub fn push(&mut self, step: OdometryStep) {
        let begins_again = self.begins_again;
        let is_first = step.begins_again();
        let scans = 1 + step.anew.len() as u64;
        // Counted before the thread may be done with it.
        self.waiting.fetch_add(1, Ordering::Relaxed);
        let sent = self.work.try_send(Work { step, begins_again });
        let is_passed_over = sent.is_err();
        self.waiting
            .fetch_sub(u64::from(is_passed_over), Ordering::Relaxed);
        self.begins_again = is_passed_over && (begins_again || is_first);
        self.unsearched
            .fetch_add(u64::from(is_passed_over) * scans, Ordering::Relaxed);
    }

    /// Scans that were passed over, or of which the search failed: loops there are not known of.
    pub fn unsearched(&self) -> u64 {
        self.unsearched.load(Ordering::Relaxed)
    }

    /// Scans that wait, or are looked at: at the end of a walk loops there are not known of either.
    pub fn waiting(&self) -> u64 {
        self.waiting.load(Ordering::Relaxed)
    }

    /// The next loop, if there is one.
    pub fn next_loop(&self) -> Option<OnlineLoop> {
        self.found.try_recv().ok()
    }
}

impl Drop for LoopsThread {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        // Both channels closed: the thread ends after the scan that it looks at.
        let (work, _) = sync_channel(0);
        self.work = work;
        let (_, found) = sync_channel(0);
        self.found = found;
        if let Some(thread) = self.thread.take() {
            // A panic there has been reported by the panic hook already.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use lsfb_pipeline::odometry::StepOutcome;

    use super::super::odometry::tests::live;
    use super::*;

    /// Of a search that was behind all the time, or had ended, no loops were said to be there.
    #[test]
    fn scans_that_are_passed_over_are_counted() {
        let (work, waiting) = sync_channel(1);
        let (_, found) = sync_channel(1);
        let mut loops = LoopsThread {
            work,
            found,
            begins_again: false,
            unsearched: Arc::default(),
            waiting: Arc::default(),
            end: Arc::default(),
            thread: None,
        };
        let mut push = |ms: i64, outcome| {
            loops.push(live(ms, outcome, Instant::now()).step);
            loops.unsearched()
        };
        assert_eq!(push(100, StepOutcome::First), 0);
        // Nobody takes the first.
        assert_eq!(push(200, StepOutcome::First), 1);
        assert!(!waiting.recv().expect("the first").begins_again);
        assert_eq!(push(300, StepOutcome::Registered), 1);
        assert!(waiting.recv().expect("the third").begins_again);
        drop(waiting);
        assert_eq!(push(400, StepOutcome::Registered), 2);
        // Nobody was done with the first and the third, nor said that these were not looked at.
        assert_eq!(loops.waiting(), 2);
    }
}
