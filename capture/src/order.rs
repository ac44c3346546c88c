//! Times that go back, of stamps and of arrivals.

use lsfb_types::Timestamp;

/// A network puts messages in another order by less than this, seconds.
const LATE_SECS: f64 = 0.1;
/// More stamps than this share that equal the one before are no accident: a driver gives several samples the time at which they arrived together.
const MOST_STANDING: f64 = 0.05;

/// The times of one device, in the order in which they came.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Order {
    latest: Option<Timestamp>,
    jumps: usize,
    furthest_secs: f64,
    /// How many equal the one before, of how many.
    standing: usize,
    stamps: usize,
}

impl Order {
    pub(crate) fn note(&mut self, time: Timestamp) {
        let back_secs = self.latest.map_or(0.0, |latest| latest.secs_since(time));
        self.stamps += 1;
        self.standing += usize::from(self.latest == Some(time));
        if back_secs > LATE_SECS {
            self.jumps += 1;
            self.furthest_secs = self.furthest_secs.max(back_secs);
        }
        let is_late = (0.0..=LATE_SECS).contains(&back_secs);
        if !is_late || self.latest.is_none() {
            self.latest = Some(time);
        }
    }

    /// That they go back, where they do.
    pub(crate) fn back(&self) -> Option<String> {
        self.problem().filter(|_| self.jumps > 0)
    }

    /// What is wrong with them, in words that go on from what they are.
    pub(crate) fn problem(&self) -> Option<String> {
        if self.stamps > 2 && self.standing + 1 == self.stamps {
            return Some("are all the same".to_owned());
        }
        let times = match self.jumps {
            0 if self.standing as f64 > MOST_STANDING * self.stamps as f64 => {
                return Some(format!(
                    "repeat the previous one {} times of {}: several got the same time",
                    self.standing, self.stamps
                ));
            }
            0 => return None,
            1 => "once".to_owned(),
            jumps => format!("{jumps} times"),
        };
        Some(format!(
            "go back {times}, by up to {:.1} s",
            self.furthest_secs
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problem(millis: &[i64]) -> Option<String> {
        let mut order = Order::default();
        for ms in millis {
            order.note(Timestamp::from_nanos(ms * 1_000_000));
        }
        order.problem()
    }

    #[test]
    fn stamps_that_go_back_or_stand_still_are_told() {
        assert_eq!(problem(&[0, 50, 40, 100, 150]), None);
        assert_eq!(problem(&[]), None);
        let back = problem(&[5_000, 5_050, 2_050, 2_100, 2_150]);
        assert_eq!(back.as_deref(), Some("go back once, by up to 3.0 s"));
        let again = problem(&[5_000, 2_000, 5_000, 2_000]);
        assert_eq!(again.as_deref(), Some("go back 2 times, by up to 3.0 s"));
        assert!(problem(&[7, 7, 7]).is_some());
        // Four samples of a batch with one stamp; and one message that came twice.
        let batches: Vec<i64> = (0..100).map(|k| 20 * (k / 4)).collect();
        let repeated = problem(&batches).expect("noticed");
        assert!(
            repeated.starts_with("repeat the previous one 75 times of 100"),
            "{repeated}"
        );
        let mut once: Vec<i64> = (0..100).collect();
        once[50] = 49;
        assert_eq!(problem(&once), None);
    }
}
