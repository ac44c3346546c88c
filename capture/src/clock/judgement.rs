//! How good the clocks of a recording are.

use lsfb_types::{Finding, Judgement, Limit, Verdict};

use super::recorded::{ClockReport, DeviceClock};

/// Standard deviation of a device's time beyond which it is worth a look, microseconds: half a millisecond moves an image by a
/// quarter of a pixel while the rig turns at 1 rad/s (500 px of focal length).
const GOOD_SIGMA_US: f64 = 500.0;
/// Recorded stamps that lie further than this from the clock as it is estimated afterwards, after a straight line, are worth a look,
/// milliseconds rms: what is fitted live differs by up to a millisecond where a link jitters by five.
const GOOD_STAMPS_MS: f64 = 5.0;
/// … and beyond this they are wrong: a degree of a turn at 1 rad/s.
const WRONG_STAMPS_MS: f64 = 20.0;

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
            let found = "imported from another program: no host received the data, so that its stamps cannot be checked";
            let finding = Finding::new("import", Verdict::Unknown, "clocks", found);
            return Judgement::new(vec![
                finding.remedy("align it with another recording of the same walk by `lsfb align`"),
            ]);
        }
        if let Some(pace) = self.pace {
            let found = format!(
                "not recorded in real time ({pace:.2} s of the devices' counters per second of arrivals): in a replay or a simulation, arrivals say nothing about clocks"
            );
            let finding = Finding::new("pace", Verdict::Unknown, "clocks", found);
            return Judgement::new(vec![
                finding
                    .value(pace, "")
                    .remedy("record in real time, or trust the devices' own stamps"),
            ]);
        }
        if self.devices.is_empty() {
            let found = "no device has a counter of its own";
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
    .remedy("check what sets it: its PPS and NMEA sentence, a restart, or the host's clock");
    let worst_us = clock.epochs.iter().map(|e| e.sigma_us).fold(0.0, f64::max);
    let limit = Limit::AtMost(GOOD_SIGMA_US);
    let verdict = match clock.epochs.len() {
        0 => Verdict::Unknown,
        _ => Verdict::Warn.unless(limit.holds(worst_us)),
    };
    let found = match verdict {
        Verdict::Unknown => "too few stamps for an estimate".to_owned(),
        _ => format!("standard deviation of its time: {worst_us:.1} µs"),
    };
    let sigma = Finding::new("clock-sigma", verdict, &*clock.device, found)
        .value(worst_us, "µs")
        .limit(limit)
        .remedy("record longer, or synchronise the device by PPS");
    let mut findings = vec![step, sigma, recorded(clock)];
    if clock.mode_changes > 0 {
        let found = format!(
            "locked for part of the recording and fitted for another: changed {}",
            match clock.mode_changes {
                1 => "once".to_owned(),
                n => format!("{n} times"),
            }
        );
        let change = Finding::new("clock-changes", Verdict::Warn, &*clock.device, found)
            .value(clock.mode_changes as f64, "")
            .limit(Limit::AtMost(0.0));
        findings.push(change.remedy("start recording once the device is locked"));
    }
    findings
}

/// Whether the stamps that every later stage reads are those of the clock.
fn recorded(clock: &DeviceClock) -> Finding {
    let scatter_ms = clock.recorded_scatter_us / 1e3;
    let limit_ms = match scatter_ms <= WRONG_STAMPS_MS {
        true => GOOD_STAMPS_MS,
        false => WRONG_STAMPS_MS,
    };
    let limit = Limit::AtMost(limit_ms);
    let verdict = match (clock.epochs.is_empty(), limit.holds(scatter_ms)) {
        (true, _) => Verdict::Unknown,
        (false, true) => Verdict::Pass,
        (false, false) if scatter_ms <= WRONG_STAMPS_MS => Verdict::Warn,
        (false, false) => Verdict::Fail,
    };
    let found = match verdict {
        Verdict::Unknown => "too few stamps to check the recorded ones".to_owned(),
        _ => format!("its recorded stamps agree with the estimate to {scatter_ms:.2} ms rms"),
    };
    Finding::new("recorded-stamps", verdict, &*clock.device, found)
        .value(scatter_ms, "ms")
        .limit(limit)
        .remedy(
            "look at the plot where they differ: lock gained or lost, a wrong second, a restart",
        )
}
