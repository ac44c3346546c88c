//! What the recorder thought of the devices' clocks: all along where everything is read, in the end otherwise.

use lsfb_recording::message::{self, ClockModel};
use lsfb_recording::{CLOCK_MODELS, CdrMessage, Recording};
use lsfb_types::{Finding, Limit, Timestamp, Verdict};

use super::{Depth, DoctorConfig, Findings};
use crate::Error;
use crate::clock::model_topic::{EXCHANGED, HOLDOVER, LOCKED};

/// Share of the recording in which a fitted clock may be less certain: it is when it begins.
const BEGINNING: f64 = 0.2;

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
                Depth::Indexes => recording.last_message(topic)?.into_iter().collect(),
            };
            if messages.is_empty() {
                continue;
            }
            let decoded = messages
                .iter()
                .map(|m| Some((m.time, message::decode_clock_model(&m.bytes).ok()?)));
            let models: Vec<(Timestamp, ClockModel)> = decoded.flatten().collect();
            self.add(judge(device, &models, config));
        }
        Ok(())
    }
}

/// The longest time for which a clock that names the second itself had lost its pulse, and by how much it may have been off then, seconds and nanoseconds.
fn longest_holdover(models: &[(Timestamp, ClockModel)]) -> Option<(f64, f64)> {
    let stretches = models.chunk_by(|a, b| a.1.kind == b.1.kind);
    let stretches = stretches.filter_map(|stretch| {
        let [(first, _), .., (last, model)] = stretch else {
            return None;
        };
        (model.kind == HOLDOVER).then(|| (last.secs_since(*first), model.sigma_ns))
    });
    stretches.max_by(|a, b| a.0.total_cmp(&b.0))
}

fn judge(device: &str, models: &[(Timestamp, ClockModel)], config: &DoctorConfig) -> Finding {
    let subject = format!("clock {device}");
    let finding = |verdict, found: String| Finding::new("clock", verdict, subject, found);
    let Some((_, model)) = models.last() else {
        let found = "what the recorder wrote of it cannot be read";
        return finding(Verdict::Unknown, found.to_owned());
    };
    // One message is the last, and says how it ended.
    let when = match models {
        [_] => " (at the end; --full looks at all of the recording)",
        _ => "",
    };
    let epochs = models
        .iter()
        .map(|(_, model)| model.epoch)
        .max()
        .unwrap_or(1);
    let pulse = "check the cable and the antenna of the GNSS receiver";
    if model.kind == HOLDOVER {
        let sigma_us = model.sigma_ns / 1e3;
        let found = format!("lost its pulse and ran on its own quartz: within {sigma_us:.0} µs");
        let finding = finding(Verdict::Warn, found).value(sigma_us, "µs");
        return finding.remedy(pulse);
    }
    if let Some((secs, sigma_ns)) = longest_holdover(models) {
        let sigma_us = sigma_ns / 1e3;
        let found = format!(
            "lost its pulse for {secs:.0} s at a time and ran on its own quartz: within {sigma_us:.0} µs"
        );
        return finding(Verdict::Warn, found)
            .value(sigma_us, "µs")
            .remedy(pulse);
    }
    if model.kind == LOCKED {
        if epochs <= 1 {
            return finding(Verdict::Pass, format!("names the second itself{when}"));
        }
        let found = format!(
            "names the second itself, and was set {} meanwhile",
            times(epochs - 1)
        );
        return finding(Verdict::Warn, found).remedy("see when and by how much with `lsfb clock`");
    }
    let mut sigmas_us: Vec<f64> = models.iter().map(|(_, m)| m.sigma_ns / 1e3).collect();
    sigmas_us.sort_by(|a, b| b.total_cmp(a));
    let sigma_us = sigmas_us[(BEGINNING * sigmas_us.len() as f64) as usize];
    let by = match model.kind.as_str() {
        EXCHANGED => "by exchanges of times",
        _ => "fitted to arrival",
    };
    let found = format!(
        "{by}: σ {sigma_us:.1} µs{}{when}, skew {:.2} ± {:.2} ppm, {}",
        match models {
            [_] => "",
            _ => " but for a fifth of the time",
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
        .remedy("see what happened with `lsfb clock`")
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

    fn judged(kinds: &[(&str, f64)]) -> Finding {
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
            (Timestamp::from_nanos(k * 1_000_000_000), model)
        });
        let models: Vec<_> = models.collect();
        judge("lidar", &models, &DoctorConfig::default())
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
        assert!(found.what.contains("for 9 s at a time"), "{}", found.what);
        // Uncertain at first, as every fitted clock is; and for half of the time.
        let limit_us = DoctorConfig::default().warn_sigma_us;
        let mut fitted = [("fitted", 0.5 * limit_us); 30];
        fitted[..4].fill(("fitted", 50.0 * limit_us));
        assert_eq!(judged(&fitted).verdict, Verdict::Pass);
        fitted[..15].fill(("fitted", 50.0 * limit_us));
        assert_eq!(judged(&fitted).verdict, Verdict::Warn);
        assert_eq!(judged(&[]).verdict, Verdict::Unknown);
    }
}
