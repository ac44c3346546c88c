//! What the recorder thought of the devices' clocks in the end.

use lsfb_recording::message::{self, ClockModel};
use lsfb_recording::{CLOCK_MODELS, Recording};
use lsfb_types::{Finding, Limit, Verdict};

use super::{DoctorConfig, Findings};
use crate::Error;
use crate::clock::model_topic::EXCHANGED;

impl Findings {
    pub(super) fn clocks(
        &mut self,
        recording: &Recording,
        config: &DoctorConfig,
    ) -> Result<(), Error> {
        let topics: Vec<_> = recording
            .topics()
            .iter()
            .filter(|t| t.topic.starts_with(CLOCK_MODELS))
            .collect();
        for topic in topics {
            let Some(last) = recording.last_message(&topic.topic)? else {
                continue;
            };
            if let Ok(model) = message::decode_clock_model(&last.bytes) {
                self.add(judge(&model, config));
            }
        }
        Ok(())
    }
}

fn judge(model: &ClockModel, config: &DoctorConfig) -> Finding {
    let subject = format!("clock {}", model.device);
    let finding = |verdict, found: String| Finding::new("clock", verdict, subject, found);
    if model.kind == "locked" {
        if model.epoch <= 1 {
            return finding(Verdict::Pass, "names the second itself".to_owned());
        }
        let found = format!(
            "names the second itself, and was set {} meanwhile",
            times(model.epoch - 1)
        );
        return finding(Verdict::Warn, found).remedy("see when and by how much with `lsfb clock`");
    }
    let sigma_us = model.sigma_ns / 1e3;
    if model.kind == "holdover" {
        let found = format!("lost its pulse and ran on its own quartz: within {sigma_us:.0} µs");
        let finding = finding(Verdict::Warn, found).value(sigma_us, "µs");
        return finding.remedy("check the cable and the antenna of the GNSS receiver");
    }
    let by = match model.kind.as_str() {
        EXCHANGED => "by exchanges of times",
        _ => "fitted to arrival",
    };
    let found = format!(
        "{by}: σ {sigma_us:.1} µs, skew {:.2} ± {:.2} ppm, {}",
        model.skew * 1e6,
        model.sigma_skew * 1e6,
        match model.epoch {
            0 | 1 => "never set".to_owned(),
            epochs => format!("set {} meanwhile", times(epochs - 1)),
        }
    );
    let limit = Limit::AtMost(config.warn_sigma_us);
    let is_good = model.epoch <= 1 && limit.holds(sigma_us);
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
