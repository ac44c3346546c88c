//! Clocks estimated again from the stamps that a recording keeps: nothing here depends on what was believed while it was
//! made.

use lsfb_drivers::any_lidar::device_ns;
use lsfb_drivers::xsens::model::SAMPLE_TIME_FINE_NS;
use lsfb_recording::message::{self, ClockModel};
use lsfb_recording::{CLOCK_MODELS, DEVICE_TIME, Recording};
use lsfb_types::{Bounds, Progress, ProgressFn, Timestamp};
use serde::{Deserialize, Serialize};

use super::model_topic::{HOLDOVER, LOCKED};
use super::{ClockEstimate, OneWayClock, StampPair, Unwrap, fit_pairs};
use crate::{Error, topics};

/// Points of a plot, at most, per device.
const PLOTTED: usize = 4_000;
const HOUR_NS: i64 = 3_600_000_000_000;

/// How clocks are estimated from a recording.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClockConfig {
    /// Length of the stretches that get a line of their own, seconds; neighbours overlap by half. Temperature bends the
    /// line of a quartz by some 30 µs in two minutes.
    pub window_secs: f64,
}

impl Default for ClockConfig {
    fn default() -> Self {
        Self { window_secs: 120.0 }
    }
}

lsfb_types::bounds! {
    ClockConfig {
        window_secs: number(Bounds::AT_LEAST_ONE),
    }
}

/// A stretch between two steps of a clock.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockEpoch {
    /// First counter value, nanoseconds.
    pub device_start_ns: i64,
    /// Its arrival, nanoseconds UTC.
    pub arrival_start_ns: i64,
    /// How far the clock stepped to get here, nanoseconds; 0 for the first.
    pub step_ns: i64,
    /// Host seconds per device second over the whole epoch, less one, parts per million.
    pub skew_ppm: f64,
    /// Its standard deviation, parts per million.
    pub sigma_skew_ppm: f64,
    /// Standard deviation of the offset in the middle of the epoch, microseconds.
    pub sigma_us: f64,
    /// Pairs of stamps.
    pub pairs: u64,
}

/// Arrival against the estimated clock, for the plot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ResidualSample {
    /// Seconds since the first arrival of the recording.
    pub secs: f64,
    /// Arrival less estimated time, milliseconds: the delay beyond the shortest.
    pub delay_ms: f64,
    /// Recorded synchronized time less estimated time, microseconds.
    pub recorded_less_estimated_us: f64,
}

/// One device's clock.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeviceClock {
    /// Name of the device.
    pub device: String,
    /// Whether its recorded stamps come from a lock to UTC instead of a fit.
    pub locked: bool,
    /// Pairs of stamps.
    pub pairs: u64,
    /// One entry per epoch; more than one means that the counter or the host's clock was set.
    pub epochs: Vec<ClockEpoch>,
    /// Median delay beyond the shortest, milliseconds.
    pub delay_p50_ms: f64,
    /// 99 % are not later than this, milliseconds.
    pub delay_p99_ms: f64,
    /// Recorded synchronized time against the estimate, rms after its mean, microseconds.
    pub recorded_rms_us: f64,
    /// Mean of that: for a locked device the constant transport delay, with the opposite sign.
    pub recorded_mean_us: f64,
    /// Thinned, in order of time.
    pub samples: Vec<ResidualSample>,
}

/// The clocks of a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockReport {
    /// Seconds of the devices' counters per second of arrivals where the recording was not made in real time; `None` where it was.
    /// There arrivals say nothing about clocks, and no device is listed.
    pub pace: Option<f64>,
    /// One entry per device with a counter.
    pub devices: Vec<DeviceClock>,
}

/// A recorded triple of stamps.
#[derive(Clone, Copy)]
struct Triple {
    device_ns: i64,
    arrival: Timestamp,
    recorded: Timestamp,
}

/// Estimates the clock of every device that has a counter.
pub fn estimate_clocks(
    recording: &Recording,
    config: &ClockConfig,
    progress: ProgressFn<'_>,
) -> Result<ClockReport, Error> {
    config.check_bounds("clock")?;
    let start = recording
        .arrival_range()
        .map_or(Timestamp::default(), |range| range.start);
    let models = recorded_models(recording)?;
    let names = devices(recording);
    let mut counted = Vec::new();
    for (done, source) in names.iter().enumerate() {
        progress(Progress {
            stage: "estimating clocks",
            done: done as u64,
            total: names.len() as u64,
        })?;
        let model = models.iter().rev().find(|m| m.device == source.name());
        let triples = source.triples(recording, model)?;
        if triples.len() < 3 {
            continue;
        }
        let counter = Counter {
            device: source.name(),
            locked: model.is_some_and(|model| [LOCKED, HOLDOVER].contains(&&*model.kind)),
            tick_ns: source.tick_ns(model),
        };
        counted.push((counter, triples));
    }
    let told = || counted.iter().filter_map(|(_, triples)| passage(triples));
    let unreal = told().next().is_some() && told().all(|p| !p.is_real_time);
    let pace = told().map(|p| p.factor).reduce(f64::min).filter(|_| unreal);
    let clocks = counted.into_iter().filter(|_| pace.is_none());
    Ok(ClockReport {
        pace,
        devices: clocks
            .map(|(counter, triples)| estimate(counter, &triples, start, config))
            .collect(),
    })
}

/// Parts of a recording that are compared at most, at least a second each, and how many are needed.
const MOST_PARTS: usize = 16;
const LEAST_PARTS: usize = 3;
/// What the least delay of a part differs by from that of the part before, at most: seconds, and as a share of the time between.
const SAME_DELAY_SECS: f64 = 0.03;
const SAME_DELAY_SHARE: f64 = 0.003;

/// How time passed on a counter and at its arrivals.
struct Passage {
    is_real_time: bool,
    /// Seconds of the counter per second of arrivals, in the middle one of the parts.
    factor: f64,
}

/// In real time the least delay of each part of a recording is that of the part before but for the few in which a clock was set;
/// a replay has hardly two alike. `None` where the recording is too short to tell.
fn passage(triples: &[Triple]) -> Option<Passage> {
    let (first, last) = (triples.first()?, triples.last()?);
    let since = |t: &Triple| {
        let counted_ns = t.device_ns.saturating_sub(first.device_ns);
        (
            counted_ns as f64 * 1e-9,
            t.arrival.secs_since(first.arrival),
        )
    };
    let (counted_secs, arrived_secs) = since(last);
    let parts = (counted_secs.max(arrived_secs) as usize).min(MOST_PARTS);
    if parts < LEAST_PARTS || triples.len() < 2 * parts {
        return None;
    }
    let (mut least_delays, mut factors) = (Vec::new(), Vec::new());
    for part in triples.chunks(triples.len() / parts) {
        let delays = part
            .iter()
            .map(since)
            .map(|(counted, arrived)| arrived - counted);
        let (from, to) = (since(part.first()?), since(part.last()?));
        least_delays.push((from.1, delays.fold(f64::INFINITY, f64::min)));
        factors.push((to.0 - from.0) / (to.1 - from.1).max(1e-9));
    }
    let differ = |pair: &&[(f64, f64)]| {
        let tolerance_secs = SAME_DELAY_SECS + SAME_DELAY_SHARE * (pair[1].0 - pair[0].0);
        (pair[1].1 - pair[0].1).abs() > tolerance_secs
    };
    let different = least_delays.windows(2).filter(differ).count();
    factors.sort_by(f64::total_cmp);
    Some(Passage {
        is_real_time: 3 * different <= 2 * (least_delays.len() - 1),
        factor: factors[factors.len() / 2],
    })
}

fn recorded_models(recording: &Recording) -> Result<Vec<ClockModel>, Error> {
    let mut models = Vec::new();
    for topic in recording.topics() {
        if topic.topic.starts_with(CLOCK_MODELS) {
            for item in recording.messages(&topic.topic)? {
                // What is damaged is missing; the stamps themselves are elsewhere.
                if let Ok(found) = item
                    && let Ok(model) = message::decode_clock_model(&found.bytes)
                {
                    models.push(model);
                }
            }
        }
    }
    Ok(models)
}

/// What is known of a counter beside its values.
struct Counter {
    device: String,
    locked: bool,
    tick_ns: u64,
}

/// Where counters are found.
enum Source {
    Lidar(String),
    Camera(String),
    Imu(String),
    Sidecar(String),
}

fn devices(recording: &Recording) -> Vec<Source> {
    let mut found = Vec::new();
    // A LiDAR's counter is in its packets; beside its scans it is repeated.
    let is_lidar = |name: &str| {
        let points = format!("{name}/points");
        recording.topics().iter().any(|t| t.topic == points)
    };
    for topic in recording.topics() {
        match topic.topic.as_str() {
            _ if message::holds_lidar_packets(&topic.schema) => {
                found.push(Source::Lidar(topic.topic.clone()));
            }
            name => {
                if let Some(channel) = name.strip_suffix(DEVICE_TIME) {
                    // What waited to be sent says nothing about a clock; that of its app is told by the others.
                    if !topics::is_occasional(channel) {
                        found.push(Source::Sidecar(name.to_owned()));
                    }
                } else if let Some(camera) = name.strip_suffix("/frame_meta") {
                    found.push(Source::Camera(format!("{camera}/image")));
                } else if let Some(imu) = name.strip_suffix("/time_ref").filter(|n| !is_lidar(n)) {
                    found.push(Source::Imu(imu.to_owned()));
                }
            }
        }
    }
    found
}

impl Source {
    fn name(&self) -> String {
        match self {
            Self::Lidar(topic) => topic
                .trim_start_matches('/')
                .trim_end_matches("/packets")
                .to_owned(),
            Self::Camera(topic) => topic
                .trim_start_matches('/')
                .trim_end_matches("/image")
                .to_owned(),
            Self::Imu(topic) => topic.trim_start_matches('/').to_owned(),
            Self::Sidecar(topic) => topic
                .trim_start_matches('/')
                .trim_end_matches(DEVICE_TIME)
                .to_owned(),
        }
    }

    /// One tick of the counter, nanoseconds. Without a recorded model an IMU is an Xsens unit.
    fn tick_ns(&self, model: Option<&ClockModel>) -> u64 {
        match self {
            Self::Lidar(_) | Self::Camera(_) => 1_000,
            Self::Imu(_) => model.map_or(SAMPLE_TIME_FINE_NS, |model| model.tick_ns),
            Self::Sidecar(_) => 1,
        }
    }

    fn triples(
        &self,
        recording: &Recording,
        model: Option<&ClockModel>,
    ) -> Result<Vec<Triple>, Error> {
        let mut triples = Vec::new();
        match self {
            Self::Lidar(topic) => {
                let mut unwrap = Unwrap::default();
                for packet in recording.packets_on(topic)?.flatten() {
                    let Some(toh_ns) = device_ns(&packet.packet.bytes) else {
                        continue;
                    };
                    let device_ns = unwrap.unwrap(toh_ns.rem_euclid(HOUR_NS), HOUR_NS);
                    triples.push(Triple {
                        device_ns,
                        arrival: packet.packet.arrival,
                        recorded: packet.time,
                    });
                }
                // The revolution's time belongs to its first packet only.
                let mut last = None;
                for triple in &mut triples {
                    if last.replace(triple.recorded) == Some(triple.recorded) {
                        triple.recorded = Timestamp::default();
                    }
                }
            }
            Self::Camera(topic) => {
                for meta in recording.frame_meta(topic)?.flatten() {
                    triples.push(Triple {
                        device_ns: meta.device_ticks.cast_signed().saturating_mul(1_000),
                        arrival: meta.arrival,
                        recorded: meta.time,
                    });
                }
            }
            Self::Imu(imu) => {
                let tick_ns = i64::try_from(self.tick_ns(model)).unwrap_or(1);
                let period = match i64::try_from(model.map_or(1 << 32, |m| m.period_ticks)) {
                    Ok(0) | Err(_) => i64::MAX,
                    Ok(period) => period,
                };
                let topic = format!("{imu}/time_ref");
                triples = references(recording, &topic, tick_ns, period)?;
            }
            Self::Sidecar(topic) => triples = references(recording, topic, 1, i64::MAX)?,
        }
        Ok(triples)
    }
}

/// Counters that travel as time references.
fn references(
    recording: &Recording,
    topic: &str,
    tick_ns: i64,
    period: i64,
) -> Result<Vec<Triple>, Error> {
    let mut unwrap = Unwrap::default();
    let mut triples = Vec::new();
    for found in recording.messages(topic)?.flatten() {
        let Ok(reference) = message::decode_time_reference(&found.bytes) else {
            continue;
        };
        let ticks = unwrap.unwrap(reference.device_ticks.cast_signed(), period);
        triples.push(Triple {
            device_ns: ticks.saturating_mul(tick_ns),
            arrival: found.arrival,
            recorded: found.time,
        });
    }
    Ok(triples)
}

fn estimate(
    counter: Counter,
    triples: &[Triple],
    start: Timestamp,
    config: &ClockConfig,
) -> DeviceClock {
    // The online clock finds the steps; the lines between them are drawn anew with all there is.
    let mut online = OneWayClock::ticking(counter.tick_ns);
    for triple in triples {
        online.push(triple.device_ns, triple.arrival);
    }
    let mut bounds = vec![(0, 0)];
    for step in online.steps() {
        let from = bounds.last().map_or(0, |(at, _)| *at);
        let found = triples
            .iter()
            .skip(from)
            .position(|t| t.device_ns == step.device_ns && t.arrival == step.arrival);
        if let Some(at) = found {
            bounds.push((from + at, step.step_ns));
        }
    }
    let mut epochs = Vec::new();
    let mut estimated = Vec::with_capacity(triples.len());
    for (n, (from, step_ns)) in bounds.iter().enumerate() {
        let to = bounds.get(n + 1).map_or(triples.len(), |(to, _)| *to);
        let part = triples.get(*from..to).unwrap_or_default();
        let pairs = rising(part);
        let whole = fit_pairs(&pairs, counter.tick_ns);
        if let (Some(first), Some(whole)) = (part.first(), whole) {
            epochs.push(ClockEpoch {
                device_start_ns: first.device_ns,
                arrival_start_ns: first.arrival.nanos(),
                step_ns: *step_ns,
                skew_ppm: whole.skew * 1e6,
                sigma_skew_ppm: whole.sigma_skew * 1e6,
                sigma_us: whole.sigma_ns / 1e3,
                pairs: whole.pairs,
            });
        }
        let lines = windows(&pairs, counter.tick_ns, config);
        estimated.extend(part.iter().map(|t| time_of(&lines, t.device_ns)));
    }
    summarize(counter, triples, &estimated, epochs, start)
}

/// Pairs whose counter advances; batches repeat none, late ones say nothing.
fn rising(triples: &[Triple]) -> Vec<StampPair> {
    let mut last = None;
    triples
        .iter()
        .filter(|t| {
            let rises = last.is_none_or(|last| t.device_ns > last);
            if rises {
                last = Some(t.device_ns);
            }
            rises
        })
        .map(|t| StampPair {
            device_ns: t.device_ns,
            arrival: t.arrival,
        })
        .collect()
}

/// Lines of overlapping stretches, in order.
fn windows(pairs: &[StampPair], tick_ns: u64, config: &ClockConfig) -> Vec<ClockEstimate> {
    let window_ns = ((config.window_secs.max(1.0)) * 1e9) as i64;
    let (Some(first), Some(last)) = (pairs.first(), pairs.last()) else {
        return Vec::new();
    };
    let mut lines = Vec::new();
    let mut start = first.device_ns;
    loop {
        let end = start.saturating_add(window_ns);
        let from = pairs.partition_point(|p| p.device_ns < start);
        // A last stretch that would be short belongs to the one before.
        let is_last = last.device_ns.saturating_sub(end) < window_ns / 2;
        let to = if is_last {
            pairs.len()
        } else {
            pairs.partition_point(|p| p.device_ns < end)
        };
        lines.extend(fit_pairs(pairs.get(from..to).unwrap_or_default(), tick_ns));
        if is_last {
            return lines;
        }
        start = start.saturating_add(window_ns / 2);
        // A counter that jumped far ahead leaves nothing in between.
        if let Some(next) = pairs.get(to)
            && next.device_ns > start.saturating_add(window_ns)
        {
            start = next.device_ns;
        }
    }
}

/// Between two lines the weight goes over from one to the other.
fn time_of(lines: &[ClockEstimate], device_ns: i64) -> Option<Timestamp> {
    let after = lines.partition_point(|line| line.reference_device_ns <= device_ns);
    let (before, next) = (
        after.checked_sub(1).and_then(|n| lines.get(n)),
        lines.get(after),
    );
    match (before, next) {
        (Some(a), Some(b)) => {
            let span = b.reference_device_ns.saturating_sub(a.reference_device_ns);
            let run = device_ns.saturating_sub(a.reference_device_ns);
            let share = run as f64 / span.max(1) as f64;
            let (early, late) = (a.time(device_ns), b.time(device_ns));
            Some(early.plus_nanos(((late - early) as f64 * share) as i64))
        }
        (Some(line), None) | (None, Some(line)) => Some(line.time(device_ns)),
        (None, None) => None,
    }
}

fn summarize(
    counter: Counter,
    triples: &[Triple],
    estimated: &[Option<Timestamp>],
    epochs: Vec<ClockEpoch>,
    start: Timestamp,
) -> DeviceClock {
    let mut samples = Vec::with_capacity(triples.len());
    let mut recorded_us = Vec::new();
    for (triple, time) in triples.iter().zip(estimated) {
        let Some(time) = time else { continue };
        let known = triple.recorded != Timestamp::default();
        let difference_us = if known {
            (triple.recorded - *time) as f64 / 1e3
        } else {
            f64::NAN
        };
        if known {
            recorded_us.push(difference_us);
        }
        samples.push(ResidualSample {
            secs: triple.arrival.secs_since(start),
            delay_ms: (triple.arrival - *time) as f64 / 1e6,
            recorded_less_estimated_us: difference_us,
        });
    }
    let mut delays: Vec<f64> = samples.iter().map(|s| s.delay_ms).collect();
    delays.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let at = (delays.len() as f64 * share) as usize;
        delays
            .get(at.min(delays.len().saturating_sub(1)))
            .copied()
            .unwrap_or(0.0)
    };
    let count = recorded_us.len().max(1) as f64;
    let mean = recorded_us.iter().sum::<f64>() / count;
    let variance = recorded_us.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / count;
    let stride = samples.len().div_ceil(PLOTTED).max(1);
    DeviceClock {
        device: counter.device,
        locked: counter.locked,
        pairs: triples.len() as u64,
        epochs,
        delay_p50_ms: quantile(0.5),
        delay_p99_ms: quantile(0.99),
        recorded_rms_us: variance.sqrt(),
        recorded_mean_us: mean,
        samples: samples.into_iter().step_by(stride).collect(),
    }
}
