//! A phone's clock by the exchanges of times that were recorded with it: four stamps each, so that the delay of the link is seen from
//! both sides and its constant part falls out.
//!
//! On the way to the host `t2 = time(t1) + delay`, on the way back `t4 = device(t3) + delay`, and no delay is negative: the clock lies
//! below the line under the first pairs and above the line over the second. Both lines follow the shortest delays alone, so that what
//! queues on one side only, as Wi-Fi does, moves neither; the middle between them is the clock where the shortest delays of both
//! ways are equal. By how much they differ no exchange shows: it is bounded by half the shortest round trip. How fast the clock runs
//! its messages tell as well, of which there are far more.
//!
//! [`parts`] tells where the clock was set, [`sequence`] which messages are of which clock.

mod floor;
mod parts;
mod sequence;
#[cfg(test)]
mod tests;

use lsfb_types::Timestamp;

use super::super::{ClockEstimate, StampPair, fit_pairs};
use super::ClockConfig;
use super::lines::{stretches, time_of};
use floor::floor;
use parts::parts;
pub use sequence::StampOrder;

/// Stretches of a clock that have a line of their own: exchanges come once a second.
const WINDOWS: ClockConfig = ClockConfig { window_secs: 300.0 };
/// An exchange that took longer tells nothing, nanoseconds.
const LONGEST_NS: i64 = 10_000_000_000;
/// Nothing arrives before it was measured; by so much the lines may say otherwise beside their standard deviations, nanoseconds.
const EARLY_NS: f64 = 2_000_000.0;
/// A line may be wrong by so many standard deviations.
const EARLY_SIGMAS: f64 = 5.0;
/// A message that took longer had waited on the device, nanoseconds.
const WAITED_NS: i64 = 500_000_000;

/// One exchange: `t1` sent and `t4` received by the device's clock, `t2` received and `t3` sent by the host's, nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exchange {
    /// When the device asked.
    pub t1_ns: i64,
    /// When the host heard it.
    pub t2_ns: i64,
    /// When the host answered.
    pub t3_ns: i64,
    /// When the device heard that.
    pub t4_ns: i64,
}

impl Exchange {
    /// Time on the link in both directions, nanoseconds; negative where stamps cannot be true.
    fn round_trip_ns(&self) -> i64 {
        let device_ns = self.t4_ns.saturating_sub(self.t1_ns);
        device_ns.saturating_sub(self.t3_ns.saturating_sub(self.t2_ns))
    }

    fn is_possible(&self) -> bool {
        let took_ns = self.t4_ns.saturating_sub(self.t1_ns);
        (0..=LONGEST_NS).contains(&took_ns) && self.t3_ns >= self.t2_ns && self.round_trip_ns() >= 0
    }
}

/// Time of a stamp, and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExchangedTime {
    /// On the host's clock.
    pub time: Timestamp,
    /// Standard deviation, nanoseconds, where the shortest delays of both ways are equal.
    pub sigma_ns: f64,
    /// Host seconds per device second around it, less one.
    pub skew: f64,
    /// Standard deviation of that.
    pub sigma_skew: f64,
    /// Counts the times the device's clock began anew, from 1.
    pub epoch: u32,
}

/// A clock between two steps.
#[derive(Clone, Debug)]
struct Epoch {
    /// When the host heard of it first, and answered it last.
    begins: Timestamp,
    ends: Timestamp,
    /// In the order in which the device asked.
    exchanges: Vec<Exchange>,
    /// Of overlapping stretches, in order.
    lines: Vec<ClockEstimate>,
}

/// A device's clock.
#[derive(Clone, Debug)]
pub struct ExchangedClock {
    epochs: Vec<Epoch>,
    /// Exchanges behind it.
    pub exchanges: u64,
    /// Exchanges whose stamps cannot be true, that contradict those around them, or that say nothing beside them.
    pub unusable: u64,
    /// Shortest time on the link in both directions, nanoseconds.
    pub shortest_round_trip_ns: i64,
}

impl ExchangedClock {
    /// The clock behind exchanges in the order of their recording; `None` where there are too few.
    pub fn fit(exchanges: &[Exchange]) -> Option<Self> {
        let parts = parts(exchanges.iter().copied().filter(Exchange::is_possible));
        let epochs: Vec<Epoch> = parts.into_iter().filter_map(Epoch::of).collect();
        let used = || epochs.iter().flat_map(|epoch| &epoch.exchanges);
        let shortest_round_trip_ns = used().map(Exchange::round_trip_ns).min()?;
        let count = used().count();
        Some(Self {
            exchanges: count as u64,
            unusable: exchanges.len().saturating_sub(count) as u64,
            shortest_round_trip_ns,
            epochs,
        })
    }

    /// The same clock, its rate known from the messages of topics and their arrivals as well.
    pub fn with_messages(mut self, topics: &[(Vec<StampPair>, StampOrder)]) -> Self {
        let mut of_epochs: Vec<Vec<(i64, i64)>> = vec![Vec::new(); self.epochs.len()];
        for (messages, order) in topics {
            for (message, found) in messages.iter().zip(self.times(messages, *order)) {
                // What waited says nothing about a rate, and would lengthen the stretch that seems to.
                let found = found.filter(|f| message.arrival - f.time <= WAITED_NS);
                let number = found.and_then(|found| (found.epoch as usize).checked_sub(1));
                if let Some(epoch) = number.and_then(|n| of_epochs.get_mut(n)) {
                    epoch.push((message.device_ns, message.arrival.nanos()));
                }
            }
        }
        for (epoch, pairs) in self.epochs.iter_mut().zip(of_epochs) {
            epoch.lines = lines(&epoch.exchanges, &in_order(pairs.into_iter()));
        }
        self
    }

    /// How often the device's clock began anew.
    pub fn steps(&self) -> usize {
        self.epochs.len().saturating_sub(1)
    }

    /// Time of a stamp by one of its clocks; `None` where that cannot have made it.
    fn time_by(&self, n: usize, device_ns: i64, arrival: Timestamp) -> Option<ExchangedTime> {
        let found = ExchangedTime {
            epoch: u32::try_from(n + 1).ok()?,
            ..self.epochs.get(n)?.time(device_ns)?
        };
        let slack_ns = (EARLY_SIGMAS * found.sigma_ns + EARLY_NS) as i64;
        let before = n.checked_sub(1).and_then(|n| self.epochs.get(n));
        let is_before_it = before.is_some_and(|e| found.time.plus_nanos(slack_ns) < e.ends);
        let next = self.epochs.get(n + 1);
        let is_after_it = next.is_some_and(|e| found.time > e.begins.plus_nanos(slack_ns));
        let is_early = arrival.plus_nanos(slack_ns) < found.time;
        (!is_before_it && !is_after_it && !is_early).then_some(found)
    }
}

impl Epoch {
    fn of(mut exchanges: Vec<Exchange>) -> Option<Self> {
        exchanges.sort_by_key(|e| (e.t1_ns, e.t2_ns));
        exchanges.dedup_by_key(|e| e.t1_ns);
        let lines = lines(&exchanges, &[]);
        (!lines.is_empty()).then_some(Self {
            begins: Timestamp::from_nanos(exchanges.iter().map(|e| e.t2_ns).min()?),
            ends: Timestamp::from_nanos(exchanges.iter().map(|e| e.t3_ns).max()?),
            exchanges,
            lines,
        })
    }

    fn time(&self, device_ns: i64) -> Option<ExchangedTime> {
        let distance = |line: &&ClockEstimate| device_ns.abs_diff(line.reference_device_ns);
        let nearest = self.lines.iter().min_by_key(distance)?;
        Some(ExchangedTime {
            time: time_of(&self.lines, device_ns)?,
            sigma_ns: nearest.sigma_ns_at(device_ns),
            skew: nearest.skew,
            sigma_skew: nearest.sigma_skew,
            epoch: 1,
        })
    }
}

/// The lines of a clock, by exchanges whose `t1` rises and by its messages.
fn lines(exchanges: &[Exchange], messages: &[StampPair]) -> Vec<ClockEstimate> {
    let there: Vec<StampPair> = in_order(exchanges.iter().map(|e| (e.t1_ns, e.t2_ns)));
    let stretches = stretches(&there, &WINDOWS).into_iter();
    let found = stretches.filter_map(|range| {
        let exchanges = exchanges.get(range)?;
        let (first, last) = (exchanges.first()?.t1_ns, exchanges.last()?.t1_ns);
        let from = messages.partition_point(|m| m.device_ns < first);
        let to = messages.partition_point(|m| m.device_ns <= last);
        line(exchanges, messages.get(from..to)?)
    });
    found.collect()
}

/// The line in the middle between the shortest delays of both ways, at the rate that both and the messages tell.
fn line(exchanges: &[Exchange], messages: &[StampPair]) -> Option<ClockEstimate> {
    let there = fit_pairs(&in_order(exchanges.iter().map(|e| (e.t1_ns, e.t2_ns))), 0)?;
    // The device's clock by the host's.
    let back = fit_pairs(&in_order(exchanges.iter().map(|e| (e.t3_ns, e.t4_ns))), 0)?;
    let told = fit_pairs(messages, 0).map(|told| (told.skew, told.sigma_skew));
    let rates = [
        (there.skew, there.sigma_skew),
        (-back.skew, back.sigma_skew),
    ];
    let rates = || rates.into_iter().chain(told);
    let weight: f64 = rates().map(|(_, sigma)| sigma.powi(-2)).sum();
    let skew = rates()
        .map(|(skew, sigma)| skew * sigma.powi(-2))
        .sum::<f64>()
        / weight;
    let sigma_skew = weight.powf(-0.5);
    let (first, last) = (exchanges.first()?, exchanges.last()?);
    let origin_ns = first.t1_ns.midpoint(last.t1_ns);
    let ahead_ns = first.t2_ns.saturating_sub(first.t1_ns);
    // Host less device time beyond that of the first exchange, both by the clock at the origin.
    let beyond_ns = |host_ns: i64, device_ns: i64| {
        let run_ns = device_ns.saturating_sub(origin_ns) as f64;
        host_ns.saturating_sub(device_ns).saturating_sub(ahead_ns) as f64 - skew * run_ns
    };
    let most = floor(
        exchanges
            .iter()
            .map(|e| beyond_ns(e.t2_ns, e.t1_ns))
            .collect(),
    )?;
    let least = floor(
        exchanges
            .iter()
            .map(|e| -beyond_ns(e.t3_ns, e.t4_ns))
            .collect(),
    )?;
    // Ways that take less than no time together contradict each other, by more than their standard deviations know.
    let crossed_ns = (-most.delay_ns - least.delay_ns).max(0.0);
    let lever_ns = last.t1_ns.saturating_sub(first.t1_ns) as f64 / 12.0_f64.sqrt();
    let sigma_ns = most.sigma_ns.hypot(least.sigma_ns).hypot(crossed_ns) / 2.0;
    let offset_ns = (most.delay_ns - least.delay_ns) / 2.0;
    let time_ns = origin_ns
        .saturating_add(ahead_ns)
        .saturating_add(offset_ns as i64);
    Some(ClockEstimate {
        epoch: 1,
        reference_device_ns: origin_ns,
        reference_time: Timestamp::from_nanos(time_ns),
        skew,
        sigma_ns: sigma_ns.hypot(sigma_skew * lever_ns),
        sigma_skew,
        pairs: exchanges.len() as u64,
    })
    .filter(|line| line.skew.is_finite() && line.sigma_ns.is_finite())
}

/// Pairs with rising counters, whatever the order in which they were recorded.
fn in_order(pairs: impl Iterator<Item = (i64, i64)>) -> Vec<StampPair> {
    let mut pairs: Vec<(i64, i64)> = pairs.collect();
    pairs.sort_unstable();
    pairs.dedup_by_key(|(device_ns, _)| *device_ns);
    let pair = |(device_ns, arrival_ns)| StampPair {
        device_ns,
        arrival: Timestamp::from_nanos(arrival_ns),
    };
    pairs.into_iter().map(pair).collect()
}
