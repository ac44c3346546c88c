//! Simulated Wi-Fi between a rig and a phone whose clock is known to the nanosecond.

use super::*;

const HOST_START_NS: i64 = 1_772_359_200_000_000_000;
const DEVICE_START_NS: i64 = 77_000_000_000;
const SECOND_NS: i64 = 1_000_000_000;
/// The phone's quartz is slow.
const SKEW: f64 = 50e-6;
/// How often the exchanges in a queue, and mean time in it, milliseconds.
type Queue = [f64; 2];
const SHORT_QUEUES: Queue = [0.1, 20.0];

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
    fn delay_ns(&mut self, [share, mean_ms]: Queue) -> i64 {
        let queue_ns = match self.unit() < share {
            true => self.exponential_ns(mean_ms),
            false => 0,
        };
        2_000_000 + self.exponential_ns(3.0) + queue_ns
    }
}

fn device_ns(host_ns: i64) -> i64 {
    let run_ns = (host_ns - HOST_START_NS) as f64;
    DEVICE_START_NS + (run_ns * (1.0 - SKEW)) as i64
}

/// What a walk leaves behind: exchanges, ten at the beginning, then one a second; and messages, fifty a second.
struct Walk {
    exchanges: Vec<Exchange>,
    messages: Vec<StampPair>,
}

impl Walk {
    fn new(seed: u64, secs: i64, up: Queue, down: Queue) -> Self {
        let mut random = Random(seed);
        let begun = (0..10)
            .map(|n| n * 50_000_000)
            .chain((1..secs).map(|s| s * SECOND_NS));
        let exchange = |after_ns| {
            let asked = HOST_START_NS + after_ns;
            let heard = asked + random.delay_ns(up);
            let answered = heard + random.exponential_ns(0.2);
            let back = answered + random.delay_ns(down);
            Exchange {
                t1_ns: device_ns(asked),
                t2_ns: heard,
                t3_ns: answered,
                t4_ns: device_ns(back),
            }
        };
        let exchanges = begun.map(exchange).collect();
        let measured = (0..secs * 50).map(|n| HOST_START_NS + n * 20_000_000);
        let messages = measured.map(|measured| StampPair {
            device_ns: device_ns(measured),
            arrival: Timestamp::from_nanos(measured + 3_000_000 + random.delay_ns(up)),
        });
        Self {
            exchanges,
            messages: messages.collect(),
        }
    }

    /// Nobody hears the phone meanwhile; what it measured comes afterwards, three times as fast.
    fn without_link(mut self, from_secs: i64, to_secs: i64) -> Self {
        let (from, to) = (
            Timestamp::from_nanos(HOST_START_NS + from_secs * SECOND_NS),
            Timestamp::from_nanos(HOST_START_NS + to_secs * SECOND_NS),
        );
        self.exchanges
            .retain(|e| !(from.nanos()..to.nanos()).contains(&e.t2_ns));
        for message in &mut self.messages {
            let waited = (message.arrival - from) / 3;
            if message.arrival >= from {
                message.arrival = message.arrival.max(to.plus_nanos(waited));
            }
        }
        self
    }

    /// The phone's clock is set by so much, so long after the beginning.
    fn with_clock_set(mut self, after_ns: i64, by_ns: i64) -> Self {
        let set_ns = device_ns(HOST_START_NS + after_ns);
        let stamps = self.exchanges.iter_mut();
        let stamps = stamps.flat_map(|e| [&mut e.t1_ns, &mut e.t4_ns]);
        let measured = self.messages.iter_mut().map(|m| &mut m.device_ns);
        for stamp in stamps.chain(measured).filter(|stamp| **stamp >= set_ns) {
            *stamp += by_ns;
        }
        self
    }

    fn clock(&self) -> ExchangedClock {
        let clock = ExchangedClock::fit(&self.exchanges).expect("a clock");
        clock.with_messages(&[(self.messages.clone(), StampOrder::Rising)])
    }

    /// Errors of the times of messages and their standard deviations, milliseconds, in order; `None`: it has none. `truth`: the same
    /// walk, whose clock was never set.
    fn errors_ms(&self, truth: &Walk) -> Vec<Option<(f64, f64)>> {
        let times = self.clock().times(&self.messages, StampOrder::Rising);
        let each = times.into_iter().zip(&truth.messages);
        each.map(|(found, truth)| {
            let run_ns = (truth.device_ns - DEVICE_START_NS) as f64 / (1.0 - SKEW);
            let found = found?;
            let error_ns = (found.time.nanos() - HOST_START_NS) as f64 - run_ns;
            Some((error_ns / 1e6, found.sigma_ns / 1e6))
        })
        .collect()
    }
}

/// Time of one message.
fn time_of_one(
    clock: &ExchangedClock,
    device_ns: i64,
    arrival: Timestamp,
) -> Option<ExchangedTime> {
    let message = StampPair { device_ns, arrival };
    let times = clock.times(&[message], StampOrder::Rising);
    times.into_iter().next().flatten()
}

/// Largest error of a walk, milliseconds, and its squares by their standard deviations in the mean.
fn judged(walk: &Walk) -> (f64, f64) {
    let errors: Vec<(f64, f64)> = walk.errors_ms(walk).into_iter().flatten().collect();
    assert_eq!(errors.len(), walk.messages.len());
    let worst_ms = errors.iter().map(|(error, _)| error.abs());
    let squares = errors.iter().map(|(error, sigma)| (error / sigma).powi(2));
    (
        worst_ms.fold(0.0, f64::max),
        squares.sum::<f64>() / errors.len() as f64,
    )
}

/// What queues on one side alone moves a mean by 10 ms, and the clock by less than half a millisecond.
#[test]
fn wifi_with_queues_on_one_side_leaves_half_a_millisecond_and_sigma_is_honest() {
    for (case, up, down) in [
        ("equal queues", [0.2, 20.0], [0.2, 20.0]),
        ("queues on the way up", [0.5, 40.0], [0.05, 20.0]),
        ("queues on the way down", [0.05, 20.0], [0.5, 40.0]),
    ] {
        for (secs, without_link) in [(120, None), (180, Some((60, 120)))] {
            let walk = |seed| match without_link {
                None => Walk::new(seed, secs, up, down),
                Some((from, to)) => Walk::new(seed, secs, up, down).without_link(from, to),
            };
            let walks: Vec<(f64, f64)> = (0..24).map(|seed| judged(&walk(seed))).collect();
            let worst_ms = walks.iter().map(|w| w.0).fold(0.0, f64::max);
            let normalized = (walks.iter().map(|w| w.1).sum::<f64>() / walks.len() as f64).sqrt();
            println!("{case}, {secs} s: {worst_ms:.3} ms, {normalized:.2} σ");
            assert!(worst_ms <= 0.5, "{case}, {secs} s: {worst_ms} ms");
            assert!(
                (0.4..=1.25).contains(&normalized),
                "{case}, {secs} s: {normalized}"
            );
        }
    }
}

#[test]
fn what_the_ways_differ_by_at_least_is_within_the_bound_that_is_stated() {
    let mut walk = Walk::new(3, 120, SHORT_QUEUES, SHORT_QUEUES);
    // Each request takes 1.5 ms longer, and each answer as much less: no exchange shows it.
    for exchange in &mut walk.exchanges {
        exchange.t2_ns += 1_500_000;
        exchange.t3_ns += 1_500_000;
    }
    let bound_ms = walk.clock().shortest_round_trip_ns as f64 / 2e6;
    let (worst_ms, _) = judged(&walk);
    assert!(worst_ms > 1.0 && worst_ms <= bound_ms, "{worst_ms}");
}

/// Believed by arrival alone, what came before the first exchange of the new clock would be read by the old one, and wrong by the step.
#[test]
fn a_clock_that_was_set_reads_no_stamp_wrongly() {
    for by_ms in [
        -60_000, -10_000, -700, -300, -60, 60, 300, 700, 10_000, 60_000,
    ] {
        let truth = Walk::new(7, 90, SHORT_QUEUES, SHORT_QUEUES);
        let walk = Walk::new(7, 90, SHORT_QUEUES, SHORT_QUEUES);
        let walk = walk.with_clock_set(45_437_000_000, by_ms * 1_000_000);
        assert_eq!(walk.clock().steps(), 1, "{by_ms} ms");
        let errors = walk.errors_ms(&truth);
        let wrong = |e: &&Option<(f64, f64)>| e.is_some_and(|(error, _)| error.abs() > 1.0);
        let none = errors.iter().filter(|e| e.is_none()).count();
        assert_eq!(errors.iter().filter(wrong).count(), 0, "{by_ms} ms");
        assert!(none <= 5, "{by_ms} ms: {none}");
    }
}

/// While the phone was alone its clock was set: what waited on it is of two clocks, and none of it is read wrongly.
#[test]
fn a_clock_that_was_set_while_nobody_listened_reads_no_stamp_wrongly() {
    for by_ms in [-30_000, -10_000, 10_000, 30_000] {
        let walk = || Walk::new(9, 180, SHORT_QUEUES, SHORT_QUEUES).without_link(60, 100);
        let errors = walk()
            .with_clock_set(80 * SECOND_NS, by_ms * 1_000_000)
            .errors_ms(&walk());
        let wrong = |e: &&Option<(f64, f64)>| e.is_some_and(|(error, _)| error.abs() > 1.0);
        assert_eq!(errors.iter().filter(wrong).count(), 0, "{by_ms} ms");
        let found = errors.iter().flatten().count();
        assert!(found > 6_500, "{by_ms} ms: {found}");
    }
}

#[test]
fn a_phone_that_was_started_again_has_two_clocks() {
    let mut walk = Walk::new(1, 60, SHORT_QUEUES, SHORT_QUEUES);
    let later_ns = 100 * SECOND_NS;
    let restarted = Walk::new(2, 60, SHORT_QUEUES, SHORT_QUEUES).exchanges;
    walk.exchanges
        .extend(restarted.into_iter().map(|e| Exchange {
            t2_ns: e.t2_ns + later_ns,
            t3_ns: e.t3_ns + later_ns,
            ..e
        }));
    let clock = ExchangedClock::fit(&walk.exchanges).expect("a clock");
    assert_eq!(clock.steps(), 1);
    // It was switched off for 40 s: fifty messages a second before, and the same after.
    let mut messages = walk.messages.clone();
    let again = walk.messages.iter().map(|m| StampPair {
        arrival: m.arrival.plus_nanos(later_ns),
        ..*m
    });
    messages.extend(again);
    let times = clock.times(&messages, StampOrder::Rising);
    for (n, found) in times.iter().enumerate() {
        let found = found.expect("a time");
        let is_second = n >= walk.messages.len();
        let after_ns = (n % walk.messages.len()) as i64 * 20_000_000;
        let truth_ns = HOST_START_NS + after_ns + i64::from(is_second) * later_ns;
        assert_eq!(found.epoch, 1 + u32::from(is_second));
        assert!((found.time.nanos() - truth_ns).abs() < 2_000_000, "{n}");
    }
    // One alone may have been measured before as well as after, as it arrived long after both.
    let device_ns = device_ns(HOST_START_NS + 30 * SECOND_NS);
    let late = Timestamp::from_nanos(HOST_START_NS + later_ns + 50 * SECOND_NS);
    assert_eq!(time_of_one(&clock, device_ns, late), None);
}

#[test]
fn a_stamp_from_after_its_arrival_has_no_time() {
    let clock = Walk::new(4, 60, SHORT_QUEUES, SHORT_QUEUES).clock();
    let arrival = Timestamp::from_nanos(HOST_START_NS + 30 * SECOND_NS);
    let ahead = device_ns(arrival.nanos() + 10_000_000);
    assert_eq!(time_of_one(&clock, ahead, arrival), None);
    assert_eq!(time_of_one(&clock, i64::MAX, arrival), None);
}

#[test]
fn stamps_that_cannot_be_true_are_left_out_and_counted() {
    let mut walk = Walk::new(5, 60, SHORT_QUEUES, SHORT_QUEUES);
    let good = walk.exchanges.len();
    let extremes = [i64::MIN, -1, 0, i64::MAX];
    let answered = HOST_START_NS + 30 * SECOND_NS;
    for (n, t1_ns) in extremes.into_iter().enumerate() {
        for t4_ns in extremes {
            let wrong = Exchange {
                t1_ns,
                t2_ns: answered,
                t3_ns: answered,
                t4_ns,
            };
            walk.exchanges.insert(10 + 7 * n, wrong);
        }
    }
    let clock = walk.clock();
    assert_eq!(clock.steps(), 0);
    assert_eq!((clock.exchanges, clock.unusable), (good as u64, 16));
    let (worst_ms, _) = judged(&walk);
    assert!(worst_ms < 0.5, "{worst_ms}");
    assert!(ExchangedClock::fit(&walk.exchanges[..4]).is_none());
    assert!(ExchangedClock::fit(&[]).is_none());
}
