//! How good the clocks of a recording are.

use lsfb_types::{Finding, Judgement, Limit, Verdict};

use super::recorded::{ClockReport, DeviceClock};

/// Standard deviation of a device's time beyond which it is worth a look, microseconds: half a millisecond moves an image by a
/// quarter of a pixel while the rig turns at 1 rad/s (500 px of focal length).
const GOOD_SIGMA_US: f64 = 500.0;

impl ClockReport {
    /// What was judged, in a few words.
    pub fn summary(&self) -> String {
        match self.devices.len() {
            1 => "1 clock".to_owned(),
            n => format!("{n} clocks"),
        }
    }

    /// Whether each clock ran through, and how well its time is known.
    pub fn judgement(&self) -> Judgement {
        if self.imported {
            let found = "imported from another program: no host received it, so that its stamps stand alone";
            let finding = Finding::new("import", Verdict::Unknown, "clocks", found);
            return Judgement::new(vec![
                finding.remedy("align it with another recording of the same walk by `lsfb align`"),
            ]);
        }
        if let Some(pace) = self.pace {
            let found = format!(
                "not recorded in real time ({pace:.2} s of the devices' counters per second of arrivals), a replay or a simulation: arrivals say nothing about clocks"
            );
            let finding = Finding::new("pace", Verdict::Unknown, "clocks", found);
            return Judgement::new(vec![
                finding
                    .value(pace, "")
                    .remedy("record in real time, or trust the devices' own stamps"),
            ]);
        }
        if self.devices.is_empty() {
            let found = "no device with a counter of its own";
            let finding = Finding::new("devices", Verdict::Unknown, "clocks", found);
            return Judgement::new(vec![finding]);
        }
        Judgement::new(self.devices.iter().flat_map(judged).collect())
    }
}

fn judged(clock: &DeviceClock) -> Vec<Finding> {
    let steps = clock.epochs.len().saturating_sub(1);
    let found = match clock.epochs.get(1) {
        None => "never set".to_owned(),
        Some(first) => format!(
            "jumped {}, the first time by {:.3} s",
            match steps {
                1 => "once".to_owned(),
                2 => "twice".to_owned(),
                n => format!("{n} times"),
            },
            first.step_ns as f64 / 1e9
        ),
    };
    let step = Finding::new(
        "clock-steps",
        Verdict::Warn.unless(steps == 0),
        &*clock.device,
        found,
    )
    .value(steps as f64, "")
    .limit(Limit::AtMost(0.0))
    .remedy("check what sets it: its pulse and sentence, a restart, or the host's clock");
    let worst_us = clock.epochs.iter().map(|e| e.sigma_us).fold(0.0, f64::max);
    let limit = Limit::AtMost(GOOD_SIGMA_US);
    let verdict = match clock.epochs.len() {
        0 => Verdict::Unknown,
        _ => Verdict::Warn.unless(limit.holds(worst_us)),
    };
    let found = match verdict {
        Verdict::Unknown => "too few stamps to estimate it".to_owned(),
        _ => format!("its time is known to {worst_us:.1} µs"),
    };
    let sigma = Finding::new("clock-sigma", verdict, &*clock.device, found)
        .value(worst_us, "µs")
        .limit(limit)
        .remedy("record longer, or synchronise the device by a pulse");
    vec![step, sigma]
}
