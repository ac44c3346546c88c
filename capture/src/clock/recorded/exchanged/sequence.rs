//! Which clock of a device stamped which message: a device measures by one clock after the other, and sends in the order in which it
//! measured, also what had to wait.

use super::super::super::StampPair;
use super::{ExchangedClock, ExchangedTime};

/// A topic whose stamps fall by more is measured by the next clock, nanoseconds.
const FALL_NS: i64 = 750_000_000;
/// Exchanges come once a second: where there were none for longer, messages waited, nanoseconds.
const SILENCE_NS: i64 = 3_000_000_000;

/// In which order the messages of a topic were measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampOrder {
    /// One after the other, as those of a sensor.
    Rising,
    /// In any, as the findings of a radio scan.
    Any,
}

impl ExchangedClock {
    /// Times of the messages of a topic, in the order in which they were sent. `None` where no clock of the device can have made a
    /// stamp, as the message would have arrived before it was measured or was made while another clock ran, and where two can.
    pub fn times(&self, messages: &[StampPair], order: StampOrder) -> Vec<Option<ExchangedTime>> {
        let possible: Vec<Vec<ExchangedTime>> =
            messages.iter().map(|m| self.possible(*m)).collect();
        let falls = |n: usize| {
            let pair = n.checked_sub(1).and_then(|m| messages.get(m..=n));
            order == StampOrder::Rising
                && pair.is_some_and(|p| p[1].device_ns < p[0].device_ns.saturating_sub(FALL_NS))
        };
        let mut first = vec![None; possible.len()];
        let mut epoch = 0;
        for (n, (found, first)) in possible.iter().zip(&mut first).enumerate() {
            let least = epoch + u32::from(falls(n));
            *first = found.iter().map(|f| f.epoch).find(|e| *e >= least);
            epoch = first.unwrap_or(epoch);
        }
        let mut times = Vec::with_capacity(possible.len());
        let mut epoch = u32::MAX;
        for (n, (found, first)) in possible.iter().zip(first).enumerate().rev() {
            let most = epoch - u32::from(falls(n + 1) && epoch > 0);
            let last = found.iter().rev().map(|f| f.epoch).find(|e| *e <= most);
            epoch = last.unwrap_or(epoch);
            times.push(first.zip(last).and_then(|(first, last)| {
                if first == last {
                    return found.iter().find(|f| f.epoch == first).copied();
                }
                let of_either = found.iter().filter(|f| (first..=last).contains(&f.epoch));
                self.latest_of_a_link(of_either, first, last)
            }));
        }
        times.reverse();
        times
    }

    /// While the device was heard all the time nothing waited: the message is of the clock by which it took least long.
    fn latest_of_a_link<'a>(
        &self,
        found: impl Iterator<Item = &'a ExchangedTime>,
        first: u32,
        last: u32,
    ) -> Option<ExchangedTime> {
        let epochs = self
            .epochs
            .get(first.checked_sub(1)? as usize..last as usize)?;
        let was_heard = |pair: &[super::Epoch]| pair[1].begins - pair[0].ends <= SILENCE_NS;
        let latest = found.max_by_key(|f| f.time).copied();
        latest.filter(|_| epochs.windows(2).all(was_heard))
    }

    /// The times that clocks of the device give, in the order of the clocks.
    fn possible(&self, message: StampPair) -> Vec<ExchangedTime> {
        let epochs = 0..self.epochs.len();
        epochs
            .filter_map(|n| self.time_by(n, message.device_ns, message.arrival))
            .collect()
    }
}
