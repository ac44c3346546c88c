//! The clock that the devices of a session share.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

/// How fast simulated time runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pace {
    /// As fast as the slowest device and its host can.
    #[default]
    Unlimited,
    /// This many simulated seconds per second at most.
    RealTimes(f64),
}

/// Offset of a device that has nothing more to send.
const FINISHED: i64 = i64::MAX;
/// Offset of a device without host.
const WAITING: i64 = -1;

/// Simulated time: each device announces how far it is, and waits for the others.
#[derive(Debug)]
pub(crate) struct SimClock {
    state: Mutex<ClockState>,
    moved: Condvar,
    skew_ns: i64,
    pace: Pace,
}

#[derive(Debug)]
struct ClockState {
    offsets_ns: Vec<i64>,
    began: Option<Instant>,
    stopped: bool,
}

/// A device that waits for the time of day looks this often.
const LONGEST_WAIT: Duration = Duration::from_millis(2);

/// Whether a device may send what it has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Readiness {
    Ready,
    Early,
    Stopped,
}

/// What a device is to do after waiting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Turn {
    Go,
    Stop,
}

impl SimClock {
    /// For `devices` devices, none more than `skew_ns` ahead of another.
    pub(crate) fn new(devices: usize, skew_ns: i64, pace: Pace) -> Self {
        Self {
            state: Mutex::new(ClockState {
                offsets_ns: vec![WAITING; devices],
                began: None,
                stopped: false,
            }),
            moved: Condvar::new(),
            skew_ns,
            pace,
        }
    }

    /// Announces that `device` is about to send what belongs to `offset_ns`, and waits until it may.
    pub(crate) fn reach(&self, device: usize, offset_ns: i64) -> Turn {
        let mut state = self.lock();
        self.announce(&mut state, device, offset_ns);
        loop {
            match self.readiness(&mut state, offset_ns) {
                Readiness::Ready => return Turn::Go,
                Readiness::Stopped => return Turn::Stop,
                Readiness::Early => {
                    let woken = self.moved.wait_timeout(state, LONGEST_WAIT);
                    state = woken.unwrap_or_else(PoisonError::into_inner).0;
                }
            }
        }
    }

    fn announce(&self, state: &mut ClockState, device: usize, offset_ns: i64) {
        if state.offsets_ns[device] < offset_ns {
            state.offsets_ns[device] = offset_ns;
            self.moved.notify_all();
        }
    }

    fn readiness(&self, state: &mut ClockState, offset_ns: i64) -> Readiness {
        if state.stopped {
            return Readiness::Stopped;
        }
        let slowest = state.slowest();
        if slowest < 0 || offset_ns > slowest.saturating_add(self.skew_ns) {
            return Readiness::Early;
        }
        let began = *state.began.get_or_insert_with(Instant::now);
        if self.is_due(began, offset_ns) {
            Readiness::Ready
        } else {
            Readiness::Early
        }
    }

    /// Announces like [`SimClock::reach`], but only looks.
    pub(crate) fn poll(&self, device: usize, offset_ns: i64) -> Readiness {
        let mut state = self.lock();
        self.announce(&mut state, device, offset_ns);
        self.readiness(&mut state, offset_ns)
    }

    /// The device has sent everything, or failed: nobody waits for it any more.
    pub(crate) fn finish(&self, device: usize) {
        self.lock().offsets_ns[device] = FINISHED;
        self.moved.notify_all();
    }

    /// Ends every wait.
    pub(crate) fn stop(&self) {
        self.lock().stopped = true;
        self.moved.notify_all();
    }

    /// Whether the session was stopped.
    pub(crate) fn is_stopped(&self) -> bool {
        self.lock().stopped
    }

    /// How far the slowest device is, nanoseconds; `None` when all have finished.
    pub(crate) fn slowest_ns(&self) -> Option<i64> {
        let slowest = self.lock().slowest();
        (slowest != FINISHED).then_some(slowest.max(0))
    }

    fn is_due(&self, began: Instant, offset_ns: i64) -> bool {
        match self.pace {
            Pace::Unlimited => true,
            Pace::RealTimes(factor) => {
                began.elapsed().as_secs_f64() * factor >= offset_ns as f64 * 1e-9
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, ClockState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ClockState {
    fn slowest(&self) -> i64 {
        self.offsets_ns.iter().copied().min().unwrap_or(FINISHED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::thread;

    #[test]
    fn nobody_runs_ahead_and_nobody_waits_for_who_has_finished() {
        let clock = Arc::new(SimClock::new(2, 100, Pace::Unlimited));
        let fast = {
            let clock = Arc::clone(&clock);
            let run = move || {
                for offset in (0..=1000).step_by(10) {
                    assert_eq!(clock.reach(0, offset), Turn::Go);
                    assert!(clock.slowest_ns().expect("running") + 100 >= offset);
                }
                clock.finish(0);
            };
            thread::Builder::new()
                .name("fast".into())
                .spawn(run)
                .expect("thread")
        };
        for offset in (0..500).step_by(50) {
            thread::yield_now();
            assert_eq!(clock.reach(1, offset), Turn::Go);
        }
        clock.finish(1);
        fast.join().expect("no panic");
        assert_eq!(clock.slowest_ns(), None);
    }

    #[test]
    fn stopping_frees_who_waits() {
        let clock = Arc::new(SimClock::new(2, 100, Pace::Unlimited));
        let waiting = {
            let clock = Arc::clone(&clock);
            let run = move || clock.reach(0, 0);
            thread::Builder::new()
                .name("waiting".into())
                .spawn(run)
                .expect("thread")
        };
        clock.stop();
        assert_eq!(waiting.join().expect("no panic"), Turn::Stop);
    }

    #[test]
    fn real_time_is_not_outrun() {
        let clock = SimClock::new(1, 100, Pace::RealTimes(2.0));
        assert_eq!(clock.reach(0, 0), Turn::Go);
        let began = Instant::now();
        assert_eq!(clock.poll(0, 20_000_000), Readiness::Early);
        assert_eq!(clock.reach(0, 20_000_000), Turn::Go);
        assert!(began.elapsed() >= Duration::from_micros(9_900));
    }
}
