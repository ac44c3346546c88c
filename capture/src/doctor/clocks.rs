//! What the recorder thought of the devices' clocks: all along where everything is read, in the beginning and the end otherwise.

use lsfb_recording::message::{self, ClockModel};
use lsfb_recording::{CLOCK_MODELS, CdrMessage, Recording};
use lsfb_types::{Finding, Limit, Timestamp, Verdict};

use super::{Depth, DoctorConfig, Findings};
use crate::Error;
use crate::clock::model_topic::{EXCHANGED, HOLDOVER, LOCKED, names_the_second};

/// Share of the recording in which a fitted clock may be less certain: it is when it begins.
const BEGINNING: f64 = 0.2;
/// Stamps that move by more where a clock is read in another way are wrong on one of the sides: a hundredth of a second is half a degree
/// of a turn at 1 rad/s, and more than what moves arrivals of a device from second to second.
const MOST_STEP_SECS: f64 = 0.01;

/// What the recorder wrote of a clock, when it was so and when that arrived.
struct Told {
    time: Timestamp,
    arrival: Timestamp,
    model: ClockModel,
}

impl Told {
    fn read(message: &CdrMessage) -> Option<Self> {
        Some(Self {
            time: message.time,
            arrival: message.arrival,
            model: message::decode_clock_model(&message.bytes).ok()?,
        })
    }
}

impl Findings {
    pub(super) fn clocks(
        &mut self,
        recording: &Recording,
        config: &DoctorConfig,
    ) -> Result<(), Error> {
        let topics = recording.topics().iter();
        let topics = topics.filter_map(|t| Some((&*t.topic, t.topic.strip_prefix(CLOCK_MODELS)?)));
        for (topic, device) in topics {
            let messages: Vec<CdrMessage> = match config.read {
                // What is damaged is said elsewhere.
                Depth::Everything => recording.messages(topic)?.filter_map(Result::ok).collect(),
                Depth::Indexes => {
                    let first = recording.messages(topic)?.next();
                    let last = recording.last_message(topic)?;
                    first.and_then(Result::ok).into_iter().chain(last).collect()
                }
            };
            if messages.is_empty() {
                continue;
            }
            let told: Vec<Told> = messages.iter().filter_map(Told::read).collect();
            let judged = match config.read {
                Depth::Everything => &told[..],
                Depth::Indexes => &told[told.len().saturating_sub(1)..],
            };
            self.add(judge(device, judged, config));
            self.0.extend(judge_changes(device, &told));
        }
        Ok(())
    }
}

/// Whether a clock was read in another way from some time on, and by how much its stamps moved then.
fn judge_changes(device: &str, told: &[Told]) -> Option<Finding> {
    let stretches: Vec<&[Told]> = told
        .chunk_by(|a, b| names_the_second(&a.model.kind) == names_the_second(&b.model.kind))
        .collect();
    // Of each stretch the message that was on its way for the shortest time.
    let ahead_secs = |stretch: &[Told]| {
        let ahead = stretch.iter().map(|t| t.time.secs_since(t.arrival));
        ahead.fold(f64::NEG_INFINITY, f64::max)
    };
    let steps = stretches.windows(2).map(|pair| {
        let step_secs = ahead_secs(pair[1]) - ahead_secs(pair[0]);
        (&pair[0][0].model.kind, &pair[1][0].model.kind, step_secs)
    });
    let (before, after, step_secs) = steps.max_by(|a, b| a.2.abs().total_cmp(&b.2.abs()))?;
    let limit = Limit::AtMost(MOST_STEP_SECS);
    let verdict = match limit.holds(step_secs.abs()) {
        true => Verdict::Warn,
        false => Verdict::Fail,
    };
    let found = format!(
        "went from {before} to {after} during the recording, and its stamps moved by {step_secs:+.3} s{}",
        match stretches.len() {
            2 => String::new(),
            n => format!(", with {} changes in total", n - 1),
        }
    );
    let finding = Finding::new("clock-changes", verdict, format!("clock {device}"), found)
        .value(step_secs.abs(), "s")
        .limit(limit);
    Some(finding.remedy(
        "start recording once the device is locked, and keep this machine on UTC with chrony: stamps before and after are not consistent",
    ))
}

/// The longest time for which a clock that names the second itself had lost its pulse, and by how much it may have been off then, seconds and nanoseconds.
fn longest_holdover(told: &[Told]) -> Option<(f64, f64)> {
    let mut longest: Option<(f64, f64)> = None;
    let mut from = 0;
    for stretch in told.chunk_by(|a, b| a.model.kind == b.model.kind) {
        let first = stretch.first()?;
        let last = stretch.last()?;
        from += stretch.len();
        if first.model.kind != HOLDOVER {
            continue;
        }
        // Until the next one says otherwise.
        let end = told.get(from).unwrap_or(last);
        let secs = end.time.secs_since(first.time);
        if longest.is_none_or(|(longest_secs, _)| secs > longest_secs) {
            longest = Some((secs, last.model.sigma_ns));
        }
    }
    longest
}

fn judge(device: &str, told: &[Told], config: &DoctorConfig) -> Finding {
    let subject = format!("clock {device}");
    let finding = |verdict, found: String| Finding::new("clock", verdict, subject, found);
    let Some(Told { model, .. }) = told.last() else {
        let found = "the recorder's data about it cannot be read";
        return finding(Verdict::Unknown, found.to_owned());
    };
    // One message is the last, and says how it ended.
    let when = match told {
        [_] => " (at the end; --full checks the whole recording)",
        _ => "",
    };
    let epochs = told.iter().map(|t| t.model.epoch).max().unwrap_or(1);
    let pulse = "check the cable and the antenna of the GNSS receiver";
    if model.kind == HOLDOVER {
        let sigma_us = model.sigma_ns / 1e3;
        let found = format!("lost its PPS and ran on its own quartz: within {sigma_us:.0} µs");
        let finding = finding(Verdict::Warn, found).value(sigma_us, "µs");
        return finding.remedy(pulse);
    }
    if let Some((secs, sigma_ns)) = longest_holdover(told) {
        let sigma_us = sigma_ns / 1e3;
        let found = format!(
            "lost its PPS for up to {secs:.1} s and ran on its own quartz: within {sigma_us:.0} µs"
        );
        return finding(Verdict::Warn, found)
            .value(sigma_us, "µs")
            .remedy(pulse);
    }
    if model.kind == LOCKED {
        if epochs <= 1 {
            return finding(Verdict::Pass, format!("locked to UTC{when}"));
        }
        let found = format!(
            "locked to UTC, but was set {} in between",
            times(epochs - 1)
        );
        return finding(Verdict::Warn, found).remedy("run `lsfb clock` for details");
    }
    let mut sigmas_us: Vec<f64> = told.iter().map(|t| t.model.sigma_ns / 1e3).collect();
    sigmas_us.sort_by(|a, b| b.total_cmp(a));
    let sigma_us = sigmas_us[(BEGINNING * sigmas_us.len() as f64) as usize];
    let by = match model.kind.as_str() {
        EXCHANGED => "from clock exchanges",
        _ => "fitted to arrivals",
    };
    let found = format!(
        "{by}: σ {sigma_us:.1} µs{}{when}, skew {:.2} ± {:.2} ppm, {}",
        match told {
            [_] => "",
            _ => " except for a fifth of the time",
        },
        model.skew * 1e6,
        model.sigma_skew * 1e6,
        match epochs {
            0 | 1 => "never set".to_owned(),
            epochs => format!("set {} meanwhile", times(epochs - 1)),
        }
    );
    let limit = Limit::AtMost(config.warn_sigma_us);
    let is_good = epochs <= 1 && limit.holds(sigma_us);
    finding(Verdict::Warn.unless(is_good), found)
        .value(sigma_us, "µs")
        .limit(limit)
        .remedy("run `lsfb clock` for details")
}

fn times(count: u32) -> String {
    match count {
        1 => "once".to_owned(),
        2 => "twice".to_owned(),
        n => format!("{n} times"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(kinds: &[(&str, f64)], late_ns: impl Fn(i64) -> i64) -> Vec<Told> {
        let models = (0..).zip(kinds).map(|(k, (kind, sigma_us))| {
            let model = ClockModel {
                device: "lidar".to_owned(),
                kind: (*kind).to_owned(),
                epoch: 1,
                reference_device_ns: 0,
                reference_time_ns: 0,
                skew: 0.0,
                sigma_ns: sigma_us * 1e3,
                sigma_skew: 0.0,
                pairs: 1,
                tick_ns: 1,
                period_ticks: 0,
            };
            let time = Timestamp::from_nanos(k * 1_000_000_000);
            Told {
                time,
                arrival: time.plus_nanos(late_ns(k)),
                model,
            }
        });
        models.collect()
    }

    fn judged(kinds: &[(&str, f64)]) -> Finding {
        judge("lidar", &told(kinds, |_| 0), &DoctorConfig::default())
    }

    #[test]
    fn a_clock_is_judged_all_along() {
        let locked = [(LOCKED, 1.0); 30];
        assert_eq!(judged(&locked).verdict, Verdict::Pass);
        // A roof on the way.
        let mut roof = locked;
        roof[10..20].fill((HOLDOVER, 300.0));
        let found = judged(&roof);
        assert_eq!(found.verdict, Verdict::Warn);
        assert!(found.what.contains("for up to 10.0 s"), "{}", found.what);
        // Uncertain at first, as every fitted clock is; and for half of the time.
        let limit_us = DoctorConfig::default().warn_sigma_us;
        let mut fitted = [("fitted", 0.5 * limit_us); 30];
        fitted[..4].fill(("fitted", 50.0 * limit_us));
        assert_eq!(judged(&fitted).verdict, Verdict::Pass);
        fitted[..15].fill(("fitted", 50.0 * limit_us));
        assert_eq!(judged(&fitted).verdict, Verdict::Warn);
        assert_eq!(judged(&[]).verdict, Verdict::Unknown);
    }

    /// A lock that was lost for one message was none.
    #[test]
    fn a_short_holdover_is_told() {
        let mut clock = [(LOCKED, 1.0); 30];
        clock[12] = (HOLDOVER, 2.0);
        let found = judged(&clock);
        assert_eq!(found.verdict, Verdict::Warn);
        assert!(found.what.contains("for up to 1.0 s"), "{}", found.what);
    }

    /// The last model says "locked", and so it passed.
    #[test]
    fn a_clock_that_is_read_in_another_way_on_the_way_does_not_pass() {
        let mut kinds = [("fitted", 20.0); 30];
        kinds[10..].fill((LOCKED, 1.0));
        let jitter = |k: i64| 300_000 + k % 3 * 2_000_000;
        let found = judge_changes("lidar", &told(&kinds, jitter)).expect("a finding");
        assert_eq!(found.verdict, Verdict::Warn, "{}", found.what);
        let ahead = |k: i64| jitter(k) - if k < 10 { 0 } else { 400_000_000 };
        let found = judge_changes("lidar", &told(&kinds, ahead)).expect("a finding");
        assert_eq!(found.verdict, Verdict::Fail, "{}", found.what);
        assert!(
            found.what.contains("from fitted to locked"),
            "{}",
            found.what
        );
        assert!((found.value.unwrap_or_default() - 0.4).abs() < 1e-3);
        // A pulse that is lost, and comes back, leaves the second as it is.
        kinds.fill((LOCKED, 1.0));
        kinds[10..20].fill((HOLDOVER, 300.0));
        assert_eq!(judge_changes("lidar", &told(&kinds, jitter)), None);
    }
}
