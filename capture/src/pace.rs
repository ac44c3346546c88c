//! Whether a recording was made as fast as what it shows happened.
//!
//! A replay or a simulation may run faster or slower than real time: then arrivals say nothing about rates, silences and clocks.

/// By how much the devices' stamps and their arrivals may differ in length in a recording made in real time: seconds, and as a share.
/// Quartzes differ by a ten-thousandth, what a queue holds back at the ends by some tenths of a second.
const TOLERANCE_SECS: f64 = 0.5;
const TOLERANCE_SHARE: f64 = 0.01;
/// Shortest span that is compared, seconds.
const SHORTEST_SECS: f64 = 1.0;

/// How long what a device recorded took, by its stamps and by their arrivals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pace {
    pub stamped_secs: f64,
    pub arrived_secs: f64,
}

impl Pace {
    /// Seconds of stamps per second of arrivals.
    pub(crate) fn factor(self) -> f64 {
        self.stamped_secs / self.arrived_secs.max(1e-9)
    }

    /// Whether it was recorded in real time; `None` where it was too short to tell.
    pub(crate) fn is_real_time(self) -> Option<bool> {
        let longest_secs = self.stamped_secs.max(self.arrived_secs);
        let tolerance_secs = TOLERANCE_SECS.max(TOLERANCE_SHARE * longest_secs);
        let off_secs = (self.stamped_secs - self.arrived_secs).abs();
        (longest_secs >= SHORTEST_SECS).then_some(off_secs <= tolerance_secs)
    }
}

/// The longest of the paces, where all of them say that a recording was not made in real time. One device alone whose stamps run
/// ahead has a clock that was set.
pub(crate) fn not_in_real_time(paces: impl Iterator<Item = Pace>) -> Option<Pace> {
    let mut longest: Option<Pace> = None;
    for pace in paces {
        match pace.is_real_time() {
            None => continue,
            Some(true) => return None,
            Some(false) => {}
        }
        if longest.is_none_or(|l| pace.stamped_secs > l.stamped_secs) {
            longest = Some(pace);
        }
    }
    longest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pace(stamped_secs: f64, arrived_secs: f64) -> Pace {
        Pace {
            stamped_secs,
            arrived_secs,
        }
    }

    /// The demo on a busy machine takes longer than the walk that it shows: "faster than real time" alone misses it.
    #[test]
    fn a_replay_is_known_by_all_its_devices() {
        let fast = [pace(40.0, 1.0), pace(39.0, 1.1)];
        assert_eq!(not_in_real_time(fast.into_iter()), Some(fast[0]));
        let slow = [pace(36.0, 55.8), pace(35.9, 55.7)];
        assert_eq!(not_in_real_time(slow.into_iter()), Some(slow[0]));
        // A clock that was set ahead must not hide the silences of a recording in real time.
        let set = [pace(3636.0, 36.0), pace(36.0, 36.05)];
        assert_eq!(not_in_real_time(set.into_iter()), None);
        assert_eq!(not_in_real_time(std::iter::empty()), None);
        assert_eq!(pace(0.5, 0.1).is_real_time(), None);
        assert_eq!(pace(10.0, 10.2).is_real_time(), Some(true));
    }
}
