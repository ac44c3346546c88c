//! Devices that go on sending and say nothing new: the same image again and again, scans without a single return.

use lsfb_types::Timestamp;

/// Nothing new for so long is a problem, seconds …
const PROBLEM_SECS: f64 = 1.0;
/// … and for so many samples: a camera may take one image a second.
const PROBLEM_SAMPLES: u64 = 3;

/// What a device sends, sample by sample: new, or the same as before.
#[derive(Clone, Debug)]
pub(crate) struct Stale {
    /// How many samples must say nothing.
    least_samples: u64,
    /// Arrival of the last sample that said something new.
    news: Option<Timestamp>,
    samples: u64,
    stretches: u64,
    is_problem: bool,
}

impl Default for Stale {
    fn default() -> Self {
        Self::after(PROBLEM_SAMPLES)
    }
}

impl Stale {
    /// Of a device for which so many samples without news are usual, however slowly they come.
    pub(crate) fn after(least_samples: u64) -> Self {
        Self {
            least_samples,
            news: None,
            samples: 0,
            stretches: 0,
            is_problem: false,
        }
    }

    /// Takes a sample that arrived then.
    pub(crate) fn note(&mut self, says: Says, arrival: Timestamp) {
        let news = *self.news.get_or_insert(arrival);
        match says {
            Says::News => {
                self.news = Some(arrival);
                self.samples = 0;
                self.is_problem = false;
            }
            Says::NothingNew => {
                self.samples += 1;
                let is_long = arrival.secs_since(news) > PROBLEM_SECS;
                if is_long && self.samples >= self.least_samples && !self.is_problem {
                    self.is_problem = true;
                    self.stretches += 1;
                }
            }
        }
    }

    /// Whether it has said nothing new for too long.
    pub(crate) fn is_problem(&self) -> bool {
        self.is_problem
    }

    /// How often that happened.
    pub(crate) fn stretches(&self) -> u64 {
        self.stretches
    }
}

/// Whether a sample says something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Says {
    News,
    NothingNew,
}

impl Says {
    pub(crate) fn news_if(is_new: bool) -> Self {
        match is_new {
            true => Self::News,
            false => Self::NothingNew,
        }
    }
}

/// Whether samples differ from the one before them.
#[derive(Clone, Debug)]
pub(crate) struct Repeats<T> {
    last: Option<T>,
    stale: Stale,
}

impl<T> Default for Repeats<T> {
    fn default() -> Self {
        Self {
            last: None,
            stale: Stale::default(),
        }
    }
}

impl<T: PartialEq> Repeats<T> {
    /// Takes a sample that arrived then.
    pub(crate) fn note(&mut self, sample: T, arrival: Timestamp) {
        let is_new = self.last.as_ref() != Some(&sample);
        self.stale.note(Says::news_if(is_new), arrival);
        self.last = Some(sample);
    }

    pub(crate) fn stale(&self) -> &Stale {
        &self.stale
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn note(repeats: &mut Repeats<u32>, from_ms: i64, to_ms: i64, of: impl Fn(i64) -> u32) {
        for ms in (from_ms..to_ms).step_by(50) {
            repeats.note(of(ms), Timestamp::from_nanos(ms * 1_000_000));
        }
    }

    #[test]
    fn a_sample_that_is_repeated_for_more_than_a_second_is_counted_once() {
        let mut repeats = Repeats::default();
        note(&mut repeats, 0, 1_000, |ms| ms as u32);
        note(&mut repeats, 1_000, 1_900, |_| 7);
        assert!(!repeats.stale().is_problem());
        note(&mut repeats, 1_900, 6_000, |_| 7);
        assert!(repeats.stale().is_problem());
        note(&mut repeats, 6_000, 8_000, |ms| ms as u32);
        assert!(!repeats.stale().is_problem());
        assert_eq!(repeats.stale().stretches(), 1);
    }

    /// A turn of a LiDAR is a few hundred packets, and takes long where they come slowly, as simulated ones do on a busy machine.
    #[test]
    fn packets_of_one_turn_may_take_their_time() {
        let mut stale = Stale::after(750);
        let mut note = |from: i64, to: i64, says: Says| {
            for n in from..to {
                stale.note(says, Timestamp::from_nanos(n * 10_000_000));
            }
            stale.is_problem()
        };
        assert!(!note(0, 1, Says::News));
        assert!(!note(1, 300, Says::NothingNew), "three seconds for a turn");
        assert!(!note(300, 301, Says::News));
        assert!(note(301, 1_200, Says::NothingNew), "no turn ends");
    }

    /// One image a second of a scene that rests may be the same once.
    #[test]
    fn a_slow_device_needs_more_than_a_second() {
        let mut stale = Stale::default();
        for n in 0..10 {
            let says = Says::news_if(n % 2 == 0);
            stale.note(says, Timestamp::from_nanos(n * 1_200_000_000));
        }
        assert_eq!(stale.stretches(), 0);
    }
}
