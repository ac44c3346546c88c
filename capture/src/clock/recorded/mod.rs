//! Clocks estimated again from the stamps that a recording keeps: nothing here depends on what was believed while it was
//! made.

mod exchanged;
mod lines;
mod passage;
mod source;

use lsfb_recording::message::{self, ClockModel};
use lsfb_recording::{CLOCK_MODELS, Recording};
use lsfb_types::{Bounds, Progress, ProgressFn, Timestamp};
use serde::{Deserialize, Serialize};

use super::model_topic::names_the_second;
use super::{OneWayClock, fit_pairs};
use crate::Error;
pub use exchanged::{Exchange, ExchangedClock, ExchangedTime, StampOrder};
use lines::{rising, time_of, windows};
use passage::passage;
use source::{Triple, devices};

/// Metadata of a recording that was made of files of another program.
const IMPORT: &str = "lsfb.import";
/// Points of a plot, at most, per device.
const PLOTTED: usize = 4_000;

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
    /// The same after a straight line, which a host whose clock has a rate of its own explains, microseconds.
    pub recorded_scatter_us: f64,
    /// How often its stamps were made in another way from then on: locked where they had been fitted, or fitted where they had been locked.
    pub mode_changes: u64,
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
    /// Whether it is an import: no host received it, arrivals are the devices' stamps again, and no device is listed.
    pub imported: bool,
    /// One entry per device with a counter.
    pub devices: Vec<DeviceClock>,
}

/// Estimates the clock of every device that has a counter.
pub fn estimate_clocks(
    recording: &Recording,
    config: &ClockConfig,
    progress: ProgressFn<'_>,
) -> Result<ClockReport, Error> {
    config.check_bounds("clock")?;
    if is_import(recording) {
        return Ok(ClockReport {
            pace: None,
            imported: true,
            devices: Vec::new(),
        });
    }
    let start = recording
        .arrival_range()
        .map_or(Timestamp::default(), |range| range.start);
    let models = recorded_models(recording)?;
    let sources = devices(recording);
    let mut counted = Vec::new();
    for (done, source) in sources.iter().enumerate() {
        progress(Progress {
            stage: "estimating clocks",
            done: done as u64,
            total: sources.len() as u64,
        })?;
        let device = source.name();
        let own: Vec<&ClockModel> = models.iter().filter(|m| m.device == device).collect();
        let model = own.last().copied();
        let mode_changes = own
            .windows(2)
            .filter(|pair| names_the_second(&pair[0].kind) != names_the_second(&pair[1].kind))
            .count() as u64;
        let triples = source.triples(recording, model)?;
        if triples.len() < 3 {
            continue;
        }
        let counter = Counter {
            device,
            locked: model.is_some_and(|model| names_the_second(&model.kind)),
            mode_changes,
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
        imported: false,
        devices: clocks
            .map(|(counter, triples)| estimate(counter, &triples, start, config))
            .collect(),
    })
}

/// Whether `lsfb import` wrote a recording.
fn is_import(recording: &Recording) -> bool {
    let import = recording.metadata(IMPORT);
    import.is_ok_and(|entries| !entries.is_empty())
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
    mode_changes: u64,
    tick_ns: u64,
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
            recorded_us.push([triple.arrival.secs_since(start), difference_us]);
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
    let [mean_secs, mean] = [0, 1].map(|k| recorded_us.iter().map(|p| p[k]).sum::<f64>() / count);
    let moment = |of: &dyn Fn(f64, f64) -> f64| {
        let moments = recorded_us.iter();
        moments
            .map(|[t, d]| of(t - mean_secs, d - mean))
            .sum::<f64>()
            / count
    };
    let variance = moment(&|_, d| d * d);
    let (spread, shared) = (moment(&|t, _| t * t), moment(&|t, d| t * d));
    let explained = if spread > 0.0 {
        shared * shared / spread
    } else {
        0.0
    };
    let stride = samples.len().div_ceil(PLOTTED).max(1);
    DeviceClock {
        device: counter.device,
        locked: counter.locked,
        pairs: triples.len() as u64,
        epochs,
        delay_p50_ms: quantile(0.5),
        delay_p99_ms: quantile(0.99),
        recorded_rms_us: variance.sqrt(),
        recorded_scatter_us: (variance - explained).max(0.0).sqrt(),
        mode_changes: counter.mode_changes,
        recorded_mean_us: mean,
        samples: samples.into_iter().step_by(stride).collect(),
    }
}
