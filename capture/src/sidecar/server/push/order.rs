//! Batches of a session in their order: they overtake each other on the way, and what does not come is not waited for long.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use lsfb_drivers::sidecar::sensor_logger::PushedBody;

/// How long a batch is waited for that later ones have overtaken.
const WAIT: Duration = Duration::from_secs(2);
/// Batches that wait for an earlier one at most.
const MAX_HELD: usize = 64;
/// Who joins a session this early waits for its beginning.
const BEGINNING: u64 = 8;
/// Numbers that were given up, remembered at most: one that comes after all is told from a repetition.
const MAX_REMEMBERED: u64 = 4_096;

/// What becomes of a batch.
#[derive(Debug, PartialEq)]
pub(super) enum Taken {
    /// These are next, in this order.
    Next(Vec<PushedBody>),
    /// It waits for earlier ones.
    Held,
    /// It was taken before.
    Repeated,
    /// It was given up before it came.
    Late,
}

/// The batches of one session.
#[derive(Debug, Default)]
pub(super) struct Order {
    next: Option<u64>,
    held: BTreeMap<u64, (Instant, PushedBody)>,
    given_up: u64,
    remembered: BTreeSet<u64>,
}

impl Order {
    /// Number of the first batch, where the session began without us.
    pub(super) fn joined_at(&self, first: u64) -> Option<u64> {
        (self.next.is_none() && first >= BEGINNING).then_some(first)
    }

    pub(super) fn take(&mut self, body: PushedBody, now: Instant) -> Taken {
        let number = body.message_id;
        let joined = if number < BEGINNING { 0 } else { number };
        let next = *self.next.get_or_insert(joined);
        if number < next {
            return match self.remembered.remove(&number) {
                true => Taken::Late,
                false => Taken::Repeated,
            };
        }
        if self.held.contains_key(&number) {
            return Taken::Repeated;
        }
        self.held.insert(number, (now, body));
        if self.held.len() > MAX_HELD {
            self.give_up();
        }
        let ready = self.ready();
        match ready.is_empty() {
            true => Taken::Held,
            false => Taken::Next(ready),
        }
    }

    /// What need not wait any longer, though earlier batches are missing.
    pub(super) fn overdue(&mut self, now: Instant) -> Vec<PushedBody> {
        let waits_since = self.held.values().map(|(since, _)| *since).min();
        if waits_since.is_none_or(|since| now.duration_since(since) < WAIT) {
            return Vec::new();
        }
        self.give_up();
        self.ready()
    }

    /// Batches that are not here, or were not recorded yet.
    pub(super) fn missing(&self) -> u64 {
        let next = self.next.unwrap_or_default();
        let open = self
            .held
            .keys()
            .next_back()
            .map_or(0, |last| last.saturating_sub(next).saturating_add(1));
        self.given_up.saturating_add(open)
    }

    /// Those before the first that waits are not waited for.
    fn give_up(&mut self) {
        let first = self.held.keys().next().copied();
        if let (Some(first), Some(next)) = (first, self.next.as_mut()) {
            self.given_up = self.given_up.saturating_add(first - *next);
            let remembered = first.saturating_sub(MAX_REMEMBERED).max(*next);
            self.remembered.extend(remembered..first);
            while self.remembered.len() as u64 > MAX_REMEMBERED {
                self.remembered.pop_first();
            }
            *next = first;
        }
    }

    fn ready(&mut self) -> Vec<PushedBody> {
        let mut ready = Vec::new();
        while let Some(next) = self.next
            && let Some((_, body)) = self.held.remove(&next)
        {
            ready.push(body);
            // The last number of all has none after it.
            self.next = Some(next.saturating_add(1));
        }
        ready
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body(message_id: u64) -> PushedBody {
        PushedBody {
            message_id,
            ..PushedBody::default()
        }
    }

    fn numbers(taken: Taken) -> Vec<u64> {
        match taken {
            Taken::Next(bodies) => bodies.iter().map(|body| body.message_id).collect(),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn batches_that_overtake_each_other_come_in_order_once_and_gaps_are_counted() {
        let (mut order, start) = (Order::default(), Instant::now());
        assert_eq!(order.take(body(1), start), Taken::Held);
        assert_eq!(numbers(order.take(body(0), start)), [0, 1]);
        assert_eq!(order.take(body(1), start), Taken::Repeated);
        assert_eq!(order.take(body(4), start), Taken::Held);
        assert_eq!(order.take(body(4), start), Taken::Repeated);
        assert_eq!(order.missing(), 3);
        assert!(order.overdue(start).is_empty());
        let later = order.overdue(start + WAIT);
        assert_eq!(later.len(), 1);
        assert_eq!(order.missing(), 2);
        assert_eq!(order.take(body(3), start), Taken::Late);
        assert_eq!(order.take(body(3), start), Taken::Repeated);
        assert_eq!(numbers(order.take(body(5), start)), [5]);
    }

    #[test]
    fn a_number_beyond_all_costs_nothing() {
        let (mut order, start) = (Order::default(), Instant::now());
        assert_eq!(numbers(order.take(body(0), start)), [0]);
        assert_eq!(order.take(body(u64::MAX - 1), start), Taken::Held);
        assert_eq!(order.overdue(start + WAIT).len(), 1);
        assert_eq!(order.missing(), u64::MAX - 2);
        assert_eq!(Order::default().joined_at(7), None);
        assert_eq!(Order::default().joined_at(900), Some(900));
    }
}
