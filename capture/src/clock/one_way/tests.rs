use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

const START: i64 = 1_772_359_200_000_000_000;
const SHORTEST_NS: i64 = 300_000;

/// What lies between a device and the host, beside the shortest delay.
#[derive(Clone, Copy, Debug)]
enum Delays {
    /// ±5 ms, evenly.
    Even,
    /// A millisecond on average, and now and then 30 ms.
    Queue,
    /// Two queues in a row: the shortest delays are rare.
    TwoQueues,
}

impl Delays {
    fn draw_ns(self, rng: &mut ChaCha8Rng) -> i64 {
        let even = |rng: &mut ChaCha8Rng| rng.random::<f64>();
        let tail = |rng: &mut ChaCha8Rng| -(1.0 - even(rng)).ln();
        let ms = match self {
            Self::Even => 10.0 * even(rng),
            Self::Queue if even(rng) < 0.01 => 30.0 * even(rng),
            Self::Queue => tail(rng),
            Self::TwoQueues => 2.0 * even(rng) + 2.0 * even(rng),
        };
        (ms * 1e6) as i64
    }
}

#[derive(Clone, Copy, Debug)]
struct Case {
    seed: u64,
    rate_hz: i64,
    skew: f64,
    secs: i64,
    delays: Delays,
    /// Samples handed over together, as a polled device does.
    batch: i64,
    /// Once in a while nothing comes for this long, and then everything at once.
    gap_ms: i64,
}

impl Case {
    fn new(seed: u64, rate_hz: i64, skew: f64, secs: i64, delays: Delays) -> Self {
        Self {
            seed,
            rate_hz,
            skew,
            secs,
            delays,
            batch: 1,
            gap_ms: 0,
        }
    }

    /// Counter values and arrivals, and the truth that belongs to each.
    fn run(&self) -> Vec<(StampPair, i64)> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let mut pairs = Vec::new();
        let mut earliest = 0;
        let mut stall_until = 0;
        for first in (0..self.secs * self.rate_hz).step_by(self.batch as usize) {
            let last = first + self.batch - 1;
            let sent = |n: i64| n * 1_000_000_000 / self.rate_hz;
            let ready = sent(last) + SHORTEST_NS + self.delays.draw_ns(&mut rng);
            if self.gap_ms > 0 && rng.random::<f64>() < self.batch as f64 / self.rate_hz as f64 {
                stall_until = sent(last) + self.gap_ms * 1_000_000;
            }
            // A line keeps its order.
            let arrival = ready.max(stall_until).max(earliest);
            earliest = arrival;
            for n in first..=last {
                let true_ns = sent(n);
                let device_ns = true_ns + (true_ns as f64 * self.skew) as i64;
                let arrival = Timestamp::from_nanos(START + arrival);
                pairs.push((StampPair { device_ns, arrival }, true_ns));
            }
        }
        pairs
    }
}

/// Estimated less true time, the shortest delay taken off.
fn error_ns(estimated: Timestamp, true_ns: i64) -> i64 {
    estimated.nanos() - START - true_ns - SHORTEST_NS
}

/// 50 µs and 0.1 ppm, live, from the first minute on; the constant part of the delay is not the clock's to know.
#[test]
fn offset_and_skew_are_found_under_jitter_gaps_and_batches() {
    let mut worst_ns = 0;
    let mut worst_skew: f64 = 0.0;
    for seed in 0..6 {
        for (skew, batch, gap_ms) in [(50e-6, 1, 0), (-50e-6, 5, 45), (20e-6, 1, 45)] {
            let case = Case {
                batch,
                gap_ms,
                ..Case::new(seed, 200, skew, 150, Delays::Even)
            };
            let mut clock = OneWayClock::default();
            let run = case.run();
            for (pair, true_ns) in &run {
                clock.push(pair.device_ns, pair.arrival);
                if *true_ns > 60_000_000_000 {
                    worst_ns = worst_ns.max(error_ns(clock.time(pair.device_ns), *true_ns).abs());
                }
            }
            assert_eq!(clock.epochs(), 1, "{case:?}");
            // The skew from all of it, as `lsfb clock` does.
            let pairs: Vec<StampPair> = run.iter().map(|(pair, _)| *pair).collect();
            let fitted = fit_pairs(&pairs, 0).unwrap();
            // Device seconds are longer where the counter is fast.
            let true_skew = 1.0 / (1.0 + skew) - 1.0;
            worst_skew = worst_skew.max((fitted.skew - true_skew).abs());
        }
    }
    assert!(worst_ns < 50_000, "{worst_ns} ns");
    assert!(worst_skew < 0.1e-6, "{worst_skew}");
    println!(
        "worst of 18 clocks: {worst_ns} ns, {:.3} ppm",
        worst_skew * 1e6
    );
}

/// Cameras at 20 Hz: five minutes fitted at once, as `lsfb clock` does.
#[test]
fn a_slow_device_is_known_as_well_from_five_minutes() {
    for seed in 0..8 {
        let case = Case::new(100 + seed, 20, 50e-6, 300, Delays::Even);
        let run = case.run();
        let pairs: Vec<StampPair> = run.iter().map(|(pair, _)| *pair).collect();
        let fitted = fit_pairs(&pairs, 0).unwrap();
        for (pair, true_ns) in &run {
            let error = error_ns(fitted.time(pair.device_ns), *true_ns);
            assert!(error.abs() < 50_000, "seed {seed}: {error} ns");
        }
        let true_skew = 1.0 / (1.0 + 50e-6) - 1.0;
        assert!((fitted.skew - true_skew).abs() < 0.1e-6, "seed {seed}");
    }
}

/// The reported σ covers: 95 % of the errors are within 1.96 σ, whatever the delays are like.
#[test]
fn sigma_is_honest() {
    for delays in [Delays::Even, Delays::Queue, Delays::TwoQueues] {
        let (mut offsets, mut skews, mut ends) = (0, 0, 0);
        const RUNS: u64 = 300;
        for seed in 0..RUNS {
            let case = Case::new(1_000 + seed, 100, 30e-6, 30, delays);
            let run = case.run();
            let pairs: Vec<StampPair> = run.iter().map(|(pair, _)| *pair).collect();
            let fitted = fit_pairs(&pairs, 0).unwrap();
            let within = |error: f64, sigma: f64| u64::from(error.abs() <= 1.96 * sigma);
            let middle = run.len() / 2;
            for (at, covered) in [(middle, &mut offsets), (run.len() - 1, &mut ends)] {
                let (pair, true_ns) = run[at];
                let error = error_ns(fitted.time(pair.device_ns), true_ns) as f64;
                *covered += within(error, fitted.sigma_ns_at(pair.device_ns));
            }
            let true_skew = 1.0 / (1.0 + 30e-6) - 1.0;
            skews += within(fitted.skew - true_skew, fitted.sigma_skew);
        }
        let percent = |covered: u64| covered as f64 * 100.0 / RUNS as f64;
        println!(
            "{delays:?}: coverage of the offset {:.1} %, at the end {:.1} %, of the skew {:.1} %",
            percent(offsets),
            percent(ends),
            percent(skews)
        );
        for covered in [offsets, skews, ends] {
            // Three standard deviations of a share of 300 around 95 %.
            assert!(
                (91.0..=98.9).contains(&percent(covered)),
                "{delays:?}: {offsets} {ends} {skews}"
            );
        }
    }
}

#[test]
fn a_step_is_located_and_the_clock_found_again() {
    for (seed, step_ns) in [(1, 1_000_000_000), (2, -1_000_000_000)] {
        let case = Case::new(seed, 200, 50e-6, 120, Delays::Even);
        let mut clock = OneWayClock::default();
        let step_at = 60_000_000_000;
        let mut first_after = None;
        for (pair, true_ns) in case.run() {
            // The host's clock is set.
            let stepped = if true_ns >= step_at { step_ns } else { 0 };
            if true_ns >= step_at && first_after.is_none() {
                first_after = Some(pair.device_ns);
            }
            clock.push(pair.device_ns, pair.arrival.plus_nanos(stepped));
            if true_ns > step_at + 30_000_000_000 {
                let error = error_ns(clock.time(pair.device_ns), true_ns) - step_ns;
                assert!(error.abs() < 50_000, "{error}");
            }
        }
        assert_eq!(clock.epochs(), 2);
        let step = clock.steps()[0];
        assert_eq!(Some(step.device_ns), first_after, "located to the sample");
        assert!((step.step_ns - step_ns).abs() < 12_000_000, "{step:?}");
    }
}

#[test]
fn a_silence_and_a_queue_that_empties_at_once_are_no_step() {
    let case = Case::new(9, 200, 40e-6, 100, Delays::Queue);
    let mut clock = OneWayClock::default();
    let mut worst = 0;
    for (pair, true_ns) in case.run() {
        let secs = true_ns / 1_000_000_000;
        if (50..55).contains(&secs) {
            continue;
        }
        // Three seconds wait in a queue and come within 15 ms.
        let arrival = if (70..73).contains(&secs) {
            Timestamp::from_nanos(START + 73_000_000_000 + (true_ns - 70_000_000_000) / 200)
        } else {
            pair.arrival
        };
        clock.push(pair.device_ns, arrival);
        if true_ns > 30_000_000_000 {
            worst = worst.max(error_ns(clock.time(pair.device_ns), true_ns).abs());
        }
    }
    assert_eq!(clock.epochs(), 1);
    assert!(worst < 50_000, "{worst}");
}

#[test]
fn a_clock_that_is_set_begins_a_new_fit() {
    let mut clock = OneWayClock::default();
    let at = |millis: i64| Timestamp::from_nanos(START + millis * 1_000_000);
    let check = |clock: &OneWayClock, epochs: u32, device_ns: i64, expected: Timestamp| {
        let error = clock.time(device_ns) - expected;
        assert_eq!(clock.epochs(), epochs);
        assert!(error.abs() < 2_000, "{error} ns");
    };
    for n in 0..1000 {
        clock.push(50_000_000_000 + n * 5_000_000, at(n * 5));
    }
    // The device is restarted.
    for n in 0..1000 {
        clock.push(n * 5_000_000, at(8_000 + n * 5));
    }
    check(&clock, 2, 999 * 5_000_000, at(8_000 + 999 * 5));
    // The host's clock is set forward by ten seconds: late without end, so a new fit after half a second.
    for n in 1000..2000 {
        clock.push(n * 5_000_000, at(18_000 + n * 5));
    }
    check(&clock, 3, 1999 * 5_000_000, at(18_000 + 1999 * 5));
    // And back: at once.
    for n in 2000..2100 {
        clock.push(n * 5_000_000, at(9_000 + n * 5));
    }
    check(&clock, 4, 2099 * 5_000_000, at(9_000 + 2099 * 5));
}

#[test]
fn extreme_values_do_not_panic() {
    let mut clock = OneWayClock::default();
    assert_eq!(clock.time(5), Timestamp::default());
    for device_ns in [0, i64::MAX, 1, i64::MIN, 17, i64::MAX - 3] {
        for nanos in [0, i64::MAX, i64::MIN, 5] {
            clock.push(device_ns, Timestamp::from_nanos(nanos));
            let _ = (clock.time(device_ns), clock.time(-1), clock.skew());
            let _ = clock.estimate().map(|e| e.sigma_ns_at(device_ns));
        }
    }
}

/// A counter that is set back or forward by whole seconds and what is next to them, at rates of every device.
#[test]
fn a_counter_that_is_set_is_noticed_with_the_first_sample_after_it() {
    for step_ms in [-1_000, 1_000, -999, 999, -1_001, -2_000, -5_000, 3_000] {
        for (seed, rate_hz, delays) in [
            (1, 10, Delays::Queue),
            (2, 20, Delays::Even),
            (3, 200, Delays::Even),
            (4, 1_000, Delays::Queue),
        ] {
            let case = Case::new(seed, rate_hz, 20e-6, 20, delays);
            let mut clock = OneWayClock::default();
            let mut first_after = None;
            for (pair, true_ns) in case.run() {
                let is_after = true_ns >= 10_000_000_000;
                let device_ns = pair.device_ns + i64::from(is_after) * step_ms * 1_000_000;
                if is_after {
                    first_after.get_or_insert(device_ns);
                }
                clock.push(device_ns, pair.arrival);
                // No stamp is off by the step, not even the first one.
                let error = error_ns(clock.time(device_ns), true_ns);
                assert!(error.abs() < 50_000_000, "{step_ms} ms, {case:?}: {error}");
            }
            assert_eq!(clock.epochs(), 2, "{step_ms} ms, {case:?}");
            let step = clock.steps()[0];
            assert_eq!(Some(step.device_ns), first_after, "{step_ms} ms, {case:?}");
            let size_error_ns = step.step_ns + step_ms * 1_000_000;
            assert!(
                (-1_000_000..45_000_000).contains(&size_error_ns),
                "{step_ms} ms, {case:?}: {size_error_ns}"
            );
        }
    }
}

/// Steps back that could be disorder are told by what follows, and located all the same.
#[test]
fn a_small_step_back_is_located_too() {
    for step_ms in [-600, -300, -120] {
        let case = Case::new(5, 100, 20e-6, 20, Delays::Queue);
        let mut clock = OneWayClock::default();
        let mut first_after = None;
        for (pair, true_ns) in case.run() {
            let is_after = true_ns >= 10_000_000_000;
            let device_ns = pair.device_ns + i64::from(is_after) * step_ms * 1_000_000;
            if is_after {
                first_after.get_or_insert(device_ns);
            }
            clock.push(device_ns, pair.arrival);
        }
        assert_eq!(clock.epochs(), 2, "{step_ms} ms");
        assert_eq!(Some(clock.steps()[0].device_ns), first_after);
        let last = case.run().last().copied().unwrap();
        let device_ns = last.0.device_ns + step_ms * 1_000_000;
        assert!(error_ns(clock.time(device_ns), last.1).abs() < 200_000);
    }
}

#[test]
fn packets_in_disorder_are_no_step() {
    let case = Case::new(6, 1_000, 20e-6, 20, Delays::Queue);
    let mut clock = OneWayClock::default();
    let mut run = case.run();
    for n in (10..run.len()).step_by(37) {
        // Overtaken by up to eight others.
        let arrivals: Vec<Timestamp> = run[n - 8..=n].iter().map(|(p, _)| p.arrival).collect();
        run[n - 8..=n].rotate_left(1);
        for ((pair, _), arrival) in run[n - 8..=n].iter_mut().zip(arrivals) {
            pair.arrival = arrival;
        }
    }
    for (pair, _) in &run {
        clock.push(pair.device_ns, pair.arrival);
    }
    assert_eq!(clock.epochs(), 1);
}

/// The same for counters of coarse ticks, 300 clocks each. Half a tick, by which a counter that slips is late on average, is a
/// constant of the transport, and the line does not know it.
#[test]
fn sigma_is_honest_for_coarse_ticks() {
    const RUNS: u64 = 300;
    for (tick_ms, rate_hz, secs) in [
        (1, 100, 30),
        (1, 37, 30),
        (1, 100, 120),
        (10, 100, 30),
        (10, 37, 30),
        (10, 20, 120),
    ] {
        let tick_ns = tick_ms * 1_000_000;
        let (mut offsets, mut skews, mut ends) = (0, 0, 0);
        for seed in 0..RUNS {
            let mut rng = ChaCha8Rng::seed_from_u64(50_000 + seed);
            let skew = 100e-6 * (rng.random::<f64>() - 0.5);
            let phase_ns = (rng.random::<f64>() * 1e9) as i64;
            let run = Case::new(2_000 + seed, rate_hz, skew, secs, Delays::Queue).run();
            let exact: Vec<i64> = run.iter().map(|(p, _)| p.device_ns + phase_ns).collect();
            let counted = |exact: i64| exact.div_euclid(tick_ns) * tick_ns;
            let mut pairs: Vec<StampPair> = run
                .iter()
                .zip(&exact)
                .map(|((pair, _), exact)| StampPair {
                    device_ns: counted(*exact),
                    ..*pair
                })
                .collect();
            pairs.dedup_by_key(|pair| pair.device_ns);
            let fitted = fit_pairs(&pairs, tick_ns.cast_unsigned()).unwrap();
            let advance = |k: usize| pairs[k + 1].device_ns - pairs[k].device_ns;
            let slips = (1..pairs.len() - 1).any(|k| advance(k) != advance(0));
            let constant_ns = if slips { tick_ns / 2 } else { 0 };
            let within = |error: f64, sigma: f64| u64::from(error.abs() <= 1.96 * sigma);
            for (at, covered) in [(run.len() / 2, &mut offsets), (run.len() - 1, &mut ends)] {
                let device_ns = counted(exact[at]);
                let error = error_ns(fitted.time(device_ns), run[at].1) + constant_ns;
                *covered += within(error as f64, fitted.sigma_ns_at(device_ns));
            }
            let true_skew = 1.0 / (1.0 + skew) - 1.0;
            skews += within(fitted.skew - true_skew, fitted.sigma_skew);
        }
        let percent = |covered: u64| covered as f64 * 100.0 / RUNS as f64;
        println!(
            "{tick_ms} ms, {rate_hz} Hz, {secs} s: coverage of the offset {:.1} %, at the end {:.1} %, of the skew {:.1} %",
            percent(offsets),
            percent(ends),
            percent(skews)
        );
        // What is uniform within a tick is never further than 1.73 σ, so that more than 95 % may be covered.
        for covered in [offsets, skews, ends] {
            assert!(
                percent(covered) >= 92.0,
                "{tick_ms} ms, {rate_hz} Hz: {offsets} {ends} {skews}"
            );
        }
    }
}
