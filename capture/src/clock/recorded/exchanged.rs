//! A phone's clock by the exchanges of times that were recorded with it: four stamps each, so that the delay of the link is seen from
//! both sides and its constant part falls out.
//!
//! On the way to the host `t2 = time(t1) + delay`, on the way back `t4 = device(t3) + delay`, and no delay is negative: the clock lies
//! below the line under the first pairs and above the line over the second. Both lines follow the shortest delays alone, so that what
//! queues on one side only, as Wi-Fi does, moves neither; the middle between them is the clock where the shortest delays of both
//! ways are equal. By how much they differ no exchange shows: it is bounded by half the shortest round trip.

use lsfb_types::Timestamp;

use super::super::{ClockEstimate, StampPair};
use super::ClockConfig;
use super::lines::{time_of, windows};

/// Stretches of a clock that have a line of their own: exchanges come once a second.
const WINDOWS: ClockConfig = ClockConfig { window_secs: 300.0 };
/// Exchanges from which a line is drawn.
const FEWEST: usize = 5;
/// A phone whose clock steps back by more was started again.
const RESET_NS: i64 = 750_000_000;
/// Two offsets that contradict each other by more are of clocks that were set in between.
const STEP_NS: i64 = 500_000_000;

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

    /// Host time less device time, as if both ways had taken equally long, nanoseconds.
    fn offset_ns(&self) -> i64 {
        let there = i128::from(self.t2_ns) - i128::from(self.t1_ns);
        let back = i128::from(self.t3_ns) - i128::from(self.t4_ns);
        i64::try_from((there + back) / 2).unwrap_or(i64::MAX)
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
    /// When the host heard of it first.
    begins: Timestamp,
    /// Under the pairs of the way to the host, over its shortest delay.
    there: Vec<ClockEstimate>,
    /// Of the way back: the device's clock by the host's.
    back: Vec<ClockEstimate>,
}

/// A device's clock.
#[derive(Clone, Debug)]
pub struct ExchangedClock {
    epochs: Vec<Epoch>,
    /// Exchanges behind it.
    pub exchanges: u64,
    /// Exchanges whose stamps cannot be true, and those of epochs with too few.
    pub unusable: u64,
    /// Shortest time on the link in both directions, nanoseconds.
    pub shortest_round_trip_ns: i64,
}

impl ExchangedClock {
    /// The clock behind exchanges in the order of their recording; `None` where there are too few.
    pub fn fit(exchanges: &[Exchange]) -> Option<Self> {
        let usable: Vec<Exchange> = exchanges
            .iter()
            .copied()
            .filter(|e| e.round_trip_ns() >= 0 && e.t3_ns >= e.t2_ns)
            .collect();
        let begins_anew = |a: &Exchange, b: &Exchange| {
            let slack_ns = STEP_NS
                .saturating_add(a.round_trip_ns())
                .saturating_add(b.round_trip_ns());
            b.t1_ns < a.t1_ns.saturating_sub(RESET_NS)
                || (i128::from(b.offset_ns()) - i128::from(a.offset_ns())).abs()
                    > i128::from(slack_ns)
        };
        let parts = usable.chunk_by(|a, b| !begins_anew(a, b));
        let epochs: Vec<(Epoch, usize)> = parts
            .filter_map(|part| Some((epoch(part)?, part.len())))
            .collect();
        let used: usize = epochs.iter().map(|(_, count)| count).sum();
        let shortest_round_trip_ns = usable.iter().map(Exchange::round_trip_ns).min()?;
        (!epochs.is_empty()).then(|| Self {
            epochs: epochs.into_iter().map(|(epoch, _)| epoch).collect(),
            exchanges: used as u64,
            unusable: (exchanges.len() - used) as u64,
            shortest_round_trip_ns,
        })
    }

    /// How often the device's clock began anew.
    pub fn steps(&self) -> usize {
        self.epochs.len().saturating_sub(1)
    }

    /// Time of a stamp that arrived then.
    pub fn time(&self, device_ns: i64, arrival: Timestamp) -> Option<ExchangedTime> {
        let begun = self.epochs.partition_point(|e| e.begins <= arrival);
        // What came before the first exchange is of its clock.
        let number = begun.saturating_sub(1);
        let epoch = self.epochs.get(number)?;
        let late = time_of(&epoch.there, device_ns)?;
        // The way back gives the device's clock by the host's: its inverse lies where it gives the stamp. Clocks run alike to 200 ppm,
        // so that one step reaches it.
        let said = time_of(&epoch.back, late.nanos())?.nanos();
        let early = late.plus_nanos(device_ns.saturating_sub(said));
        let there = nearest(&epoch.there, device_ns)?;
        let back = nearest(&epoch.back, late.nanos())?;
        let half = |a: f64, b: f64| a.hypot(b) / 2.0;
        Some(ExchangedTime {
            time: early.plus_nanos((late - early) / 2),
            sigma_ns: half(there.sigma_ns_at(device_ns), back.sigma_ns_at(late.nanos())),
            skew: (there.skew - back.skew) / 2.0,
            sigma_skew: half(there.sigma_skew, back.sigma_skew),
            epoch: u32::try_from(number + 1).unwrap_or(u32::MAX),
        })
    }
}

fn epoch(exchanges: &[Exchange]) -> Option<Epoch> {
    if exchanges.len() < FEWEST {
        return None;
    }
    let there = exchanges.iter().map(|e| (e.t1_ns, e.t2_ns));
    let back = exchanges.iter().map(|e| (e.t3_ns, e.t4_ns));
    let epoch = Epoch {
        begins: Timestamp::from_nanos(exchanges.first()?.t2_ns),
        there: windows(&in_order(there), 0, &WINDOWS),
        back: windows(&in_order(back), 0, &WINDOWS),
    };
    (!epoch.there.is_empty() && !epoch.back.is_empty()).then_some(epoch)
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

fn nearest(lines: &[ClockEstimate], counter_ns: i64) -> Option<&ClockEstimate> {
    let distance = |line: &&ClockEstimate| counter_ns.abs_diff(line.reference_device_ns);
    lines.iter().min_by_key(distance)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOST_START_NS: i64 = 1_772_359_200_000_000_000;
    const DEVICE_START_NS: i64 = 77_000_000_000;
    const SKEW: f64 = 37e-6;

    /// Random numbers between 0 and 1 (SplitMix64).
    struct Random(u64);

    impl Random {
        fn unit(&mut self) -> f64 {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = self.0;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
        }

        fn exponential_ns(&mut self, mean_ms: f64) -> i64 {
            (-(1.0 - self.unit()).ln() * mean_ms * 1e6) as i64
        }

        /// 5 ms in the middle, and now and then a queue of 20 ms and more.
        fn delay_ns(&mut self, queue_share: f64, queue_ms: f64) -> i64 {
            let queue_ns = match self.unit() < queue_share {
                true => self.exponential_ns(queue_ms),
                false => 0,
            };
            2_000_000 + self.exponential_ns(3.0) + queue_ns
        }
    }

    fn device_ns(host_ns: i64) -> i64 {
        let run_ns = (host_ns - HOST_START_NS) as f64;
        DEVICE_START_NS + (run_ns * (1.0 - SKEW)) as i64
    }

    /// Ten at the beginning, then one a second.
    fn walk(seed: u64, secs: i64, up: [f64; 2], down: [f64; 2]) -> Vec<Exchange> {
        let mut random = Random(seed);
        let begun = (0..10)
            .map(|n| n * 50_000_000)
            .chain((1..secs).map(|s| s * 1_000_000_000));
        begun
            .map(|after_ns| {
                let asked = HOST_START_NS + after_ns;
                let heard = asked + random.delay_ns(up[0], up[1]);
                let answered = heard + random.exponential_ns(0.2);
                let back = answered + random.delay_ns(down[0], down[1]);
                Exchange {
                    t1_ns: device_ns(asked),
                    t2_ns: heard,
                    t3_ns: answered,
                    t4_ns: device_ns(back),
                }
            })
            .collect()
    }

    /// Largest error over a walk, milliseconds, and that in standard deviations, squared and averaged.
    fn judged(exchanges: &[Exchange], secs: i64) -> (f64, f64) {
        let clock = ExchangedClock::fit(exchanges).expect("a clock");
        let instants: Vec<i64> = (0..secs)
            .map(|s| HOST_START_NS + s * 1_000_000_000)
            .collect();
        let (mut worst_ms, mut square) = (0.0_f64, 0.0);
        for host_ns in &instants {
            let arrival = Timestamp::from_nanos(host_ns + 5_000_000);
            let found = clock.time(device_ns(*host_ns), arrival).expect("a time");
            let error_ns = (found.time.nanos() - host_ns) as f64;
            worst_ms = worst_ms.max(error_ns.abs() / 1e6);
            square += (error_ns / found.sigma_ns).powi(2) / instants.len() as f64;
        }
        (worst_ms, square)
    }

    /// What queues on one side alone moves a mean by 10 ms, and the clock by less than half a millisecond.
    #[test]
    fn wifi_with_queues_on_one_side_leaves_half_a_millisecond_and_sigma_is_honest() {
        for (case, up, down) in [
            ("equal queues", [0.2, 20.0], [0.2, 20.0]),
            ("queues on the way up", [0.5, 40.0], [0.05, 20.0]),
            ("queues on the way down", [0.05, 20.0], [0.5, 40.0]),
        ] {
            let seeds = 0..20;
            let walks = seeds.map(|seed| judged(&walk(seed, 120, up, down), 120));
            let walks: Vec<(f64, f64)> = walks.collect();
            let worst_ms = walks.iter().map(|w| w.0).fold(0.0, f64::max);
            let normalized = (walks.iter().map(|w| w.1).sum::<f64>() / walks.len() as f64).sqrt();
            assert!(worst_ms <= 0.5, "{case}: {worst_ms} ms");
            assert!((0.3..=1.5).contains(&normalized), "{case}: {normalized}");
        }
    }

    #[test]
    fn what_the_ways_differ_by_at_least_is_within_the_bound_that_is_stated() {
        let mut exchanges = walk(3, 120, [0.1, 20.0], [0.1, 20.0]);
        // Each request takes 1.5 ms longer, and each answer as much less: no exchange shows it.
        for exchange in &mut exchanges {
            exchange.t2_ns += 1_500_000;
            exchange.t3_ns += 1_500_000;
        }
        let clock = ExchangedClock::fit(&exchanges).expect("a clock");
        let host_ns = HOST_START_NS + 60_000_000_000;
        let found = clock
            .time(device_ns(host_ns), Timestamp::from_nanos(host_ns))
            .expect("a time");
        let error_ns = (found.time.nanos() - host_ns).abs();
        assert!(error_ns > 1_000_000, "{error_ns}");
        assert!(error_ns <= clock.shortest_round_trip_ns / 2, "{error_ns}");
    }

    #[test]
    fn a_phone_that_was_started_again_has_two_clocks() {
        let mut exchanges = walk(1, 60, [0.1, 20.0], [0.1, 20.0]);
        let later_ns = 100_000_000_000;
        let restarted = walk(2, 60, [0.1, 20.0], [0.1, 20.0]);
        exchanges.extend(restarted.into_iter().map(|e| Exchange {
            t2_ns: e.t2_ns + later_ns,
            t3_ns: e.t3_ns + later_ns,
            ..e
        }));
        let clock = ExchangedClock::fit(&exchanges).expect("a clock");
        assert_eq!(clock.steps(), 1);
        for (after_ns, epoch) in [(30_000_000_000, 1), (later_ns + 30_000_000_000, 2)] {
            let host_ns = HOST_START_NS + after_ns;
            let device_ns = device_ns(HOST_START_NS + 30_000_000_000);
            let found = clock
                .time(device_ns, Timestamp::from_nanos(host_ns))
                .expect("a time");
            assert_eq!(found.epoch, epoch);
            assert!((found.time.nanos() - host_ns).abs() < 500_000);
        }
    }

    #[test]
    fn stamps_that_cannot_be_true_are_left_out_and_counted() {
        let mut exchanges = walk(5, 60, [0.1, 20.0], [0.1, 20.0]);
        let good = exchanges.len() as u64;
        let extremes = [i64::MIN, -1, 0, i64::MAX];
        for t1_ns in extremes {
            for t4_ns in extremes {
                let answered = HOST_START_NS + 30_000_000_000;
                exchanges.push(Exchange {
                    t1_ns,
                    t2_ns: answered,
                    t3_ns: answered,
                    t4_ns,
                });
            }
        }
        let clock = ExchangedClock::fit(&exchanges).expect("a clock");
        assert!(
            clock.exchanges >= good && clock.exchanges + clock.unusable == good + 16,
            "{clock:?}"
        );
        let host_ns = HOST_START_NS + 20_000_000_000;
        let found = clock
            .time(device_ns(host_ns), Timestamp::from_nanos(host_ns))
            .expect("a time");
        assert!((found.time.nanos() - host_ns).abs() < 500_000);
        assert!(ExchangedClock::fit(&exchanges[..3]).is_none());
        assert!(ExchangedClock::fit(&[]).is_none());
    }
}
