//! Is this recording good? Verdicts with thresholds, from the indexes first: fast whatever the size of the file.

mod calibration;

use lsfb_recording::message::{self, ClockModel};
use lsfb_recording::{CLOCK_MODELS, Recording, TopicArrivals};
use lsfb_types::{Bounds, ProgressFn, Timestamp};
use serde::{Deserialize, Serialize};

pub use calibration::CalibrationFound;

use crate::{Error, topics};

/// How good something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum Verdict {
    /// As it should be.
    Pass,
    /// Usable; somebody should look at it.
    Warn,
    /// Data was lost, or cannot be used.
    Fail,
}

/// What is good enough.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DoctorConfig {
    /// A silence of so many periods of a topic is worth a look.
    pub warn_gap_periods: f64,
    /// A silence longer than this lost data, seconds.
    pub fail_gap_secs: f64,
    /// Fitted clocks less certain than this are worth a look, microseconds.
    pub warn_sigma_us: f64,
    /// A calibration further than this from the recording is worth a look, days. A rig that is carried is knocked, and taken
    /// apart between campaigns: after a month it should have been calibrated or verified again.
    pub warn_calibration_days: f64,
    /// Whether every byte is read and its checksum compared.
    pub read: Depth,
}

/// How much is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Depth {
    /// The indexes.
    #[default]
    Indexes,
    /// Everything.
    Everything,
}

impl Default for DoctorConfig {
    fn default() -> Self {
        Self {
            warn_gap_periods: 3.0,
            fail_gap_secs: 1.0,
            warn_sigma_us: 500.0,
            warn_calibration_days: 30.0,
            read: Depth::default(),
        }
    }
}

lsfb_types::bounds! {
    DoctorConfig {
        warn_gap_periods: number(Bounds::POSITIVE),
        fail_gap_secs: number(Bounds::POSITIVE),
        warn_sigma_us: number(Bounds::NOT_NEGATIVE),
        warn_calibration_days: number(Bounds::NOT_NEGATIVE),
        read: any,
    }
}

/// One line of the diagnosis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// What was looked at.
    pub subject: String,
    /// The verdict.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// What would have been good enough; empty where there is no number.
    pub threshold: String,
}

/// The diagnosis of a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Diagnosis {
    /// The worst of all verdicts.
    pub verdict: Verdict,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// From the first to the last arrival, seconds.
    pub duration_secs: f64,
    /// Messages on all topics.
    pub messages: u64,
    /// The calibration it carries; `None` where there is no rig in it.
    pub calibration: Option<CalibrationFound>,
    /// One entry per line.
    pub findings: Vec<Finding>,
}

/// Looks at a recording.
pub fn examine(
    recording: &Recording,
    config: &DoctorConfig,
    progress: ProgressFn<'_>,
) -> Result<Diagnosis, Error> {
    config.check_bounds("doctor")?;
    let path = recording.path();
    let bytes = std::fs::metadata(path)
        .map_err(|cause| Error::Io {
            path: path.to_owned(),
            cause,
        })?
        .len();
    let arrivals = recording.arrivals(progress)?;
    let mut findings = Findings(Vec::new());
    findings.file(recording, &arrivals);
    if config.read == Depth::Everything {
        findings.checksums(recording, progress)?;
    }
    findings.part(recording);
    let calibration = findings.calibration(recording, config)?;
    findings.topics(&arrivals, config);
    findings.losses(recording);
    findings.clocks(recording, config)?;
    let duration_secs = recording
        .arrival_range()
        .map_or(0.0, |range| range.end.secs_since(range.start));
    Ok(Diagnosis {
        verdict: findings
            .0
            .iter()
            .map(|f| f.verdict)
            .max()
            .unwrap_or(Verdict::Pass),
        bytes,
        duration_secs,
        messages: arrivals.iter().map(|a| a.times.len() as u64).sum(),
        calibration,
        findings: findings.0,
    })
}

struct Findings(Vec<Finding>);

impl Findings {
    fn add(&mut self, subject: &str, verdict: Verdict, found: String, threshold: &str) {
        self.0.push(Finding {
            subject: subject.to_owned(),
            verdict,
            found,
            threshold: threshold.to_owned(),
        });
    }

    /// Whether the file is whole, and where in time what is missing was.
    fn file(&mut self, recording: &Recording, arrivals: &[TopicArrivals]) {
        let last = arrivals.iter().filter_map(|a| a.times.last()).max();
        let until = last.map_or(String::new(), |last| {
            format!("; the last message arrived at {}", utc(*last))
        });
        if recording.damage().is_empty() {
            let found = "whole: index and end are there".to_owned();
            return self.add("file", Verdict::Pass, found, "");
        }
        for damage in recording.damage() {
            let at_end = damage.reason.contains("breaks off") || damage.reason.contains("no end");
            let found = if at_end {
                format!(
                    "{damage}{until}; at most one second behind it is missing. `lsfb recover` makes it whole"
                )
            } else {
                format!("{damage}. `lsfb recover` takes what is left")
            };
            self.add("file", Verdict::Fail, found, "no damage");
        }
    }

    fn checksums(&mut self, recording: &Recording, progress: ProgressFn<'_>) -> Result<(), Error> {
        let known = recording.damage().len();
        let damage = recording.verify(progress)?;
        if damage.len() == known {
            let found = "every chunk unpacks and has its checksum".to_owned();
            self.add("checksums", Verdict::Pass, found, "");
        }
        for found in damage.iter().filter(|d| !recording.damage().contains(d)) {
            self.add("checksums", Verdict::Fail, found.to_string(), "none wrong");
        }
        Ok(())
    }

    fn part(&mut self, recording: &Recording) {
        let session = recording.metadata("lsfb.session").unwrap_or_default();
        let (Some(part), Some(previous)) = (session.get("part"), session.get("previous")) else {
            return;
        };
        let found = format!("number {part} of a recording, behind {previous}");
        self.add("part", Verdict::Pass, found, "");
    }

    /// Rate and silences of each topic that a sensor fills steadily.
    fn topics(&mut self, arrivals: &[TopicArrivals], config: &DoctorConfig) {
        let sensors: Vec<_> = arrivals.iter().filter(|a| is_steady(&a.topic)).collect();
        if sensors.is_empty() {
            let found = "no camera, LiDAR or IMU in it".to_owned();
            self.add("sensors", Verdict::Fail, found, "at least one");
        }
        let start = sensors.iter().filter_map(|a| a.times.first()).min();
        let end = sensors.iter().filter_map(|a| a.times.last()).max();
        let (Some(start), Some(end)) = (start, end) else {
            return;
        };
        for sensor in &sensors {
            let rhythm = Rhythm::of(&sensor.times, *start, *end);
            let threshold = format!(
                "no silence of {:.0} periods; none of {} s",
                config.warn_gap_periods, config.fail_gap_secs
            );
            let verdict =
                if rhythm.longest_secs >= config.fail_gap_secs.max(3.0 * rhythm.period_secs) {
                    Verdict::Fail
                } else if rhythm.longest_secs >= config.warn_gap_periods * rhythm.period_secs
                    && rhythm.longest_secs > 0.02
                {
                    Verdict::Warn
                } else {
                    Verdict::Pass
                };
            let mut found = format!(
                "{} messages, {:.1} Hz, longest silence {:.0} ms",
                sensor.times.len(),
                1.0 / rhythm.period_secs,
                rhythm.longest_secs * 1e3
            );
            if verdict != Verdict::Pass {
                let at = rhythm.longest_at.secs_since(*start);
                found += &format!(
                    " at {} ({at:.1} s after the start), {} silences like it",
                    utc(rhythm.longest_at),
                    rhythm.silences(config.warn_gap_periods)
                );
            }
            self.add(&sensor.topic, verdict, found, &threshold);
        }
        // What comes when there is something to hear has no rhythm to miss.
        for heard in arrivals.iter().filter(|a| topics::is_occasional(&a.topic)) {
            let rhythm = Rhythm::of(&heard.times, *start, *end);
            let found = format!(
                "{} messages, longest silence {:.1} s",
                heard.times.len(),
                rhythm.longest_secs
            );
            self.add(&heard.topic, Verdict::Pass, found, "");
        }
    }

    /// What the recorder itself counted.
    fn losses(&mut self, recording: &Recording) {
        let Ok(bytes) = recording.attachment("health.json") else {
            let found =
                "no report of the recorder: it was interrupted, or another program wrote this";
            return self.add(
                "losses",
                Verdict::Warn,
                found.to_owned(),
                "health.json attached",
            );
        };
        let health: serde_json::Value = serde_json::from_slice(&bytes).unwrap_or_default();
        let lost = health.get("lost").and_then(serde_json::Value::as_u64);
        match lost {
            Some(0) => {
                self.add("losses", Verdict::Pass, "0 lost".to_owned(), "0");
            }
            Some(lost) => {
                let mut parts = Vec::new();
                let streams = health.get("streams").and_then(|s| s.as_array());
                for stream in streams.into_iter().flatten() {
                    let count = |key: &str| stream.get(key).and_then(serde_json::Value::as_u64);
                    let name = stream.get("name").and_then(|n| n.as_str()).unwrap_or("?");
                    for key in ["bad", "missing", "dropped", "interruptions"] {
                        if let Some(count) = count(key).filter(|c| *c > 0) {
                            parts.push(format!("{name}: {count} {key}"));
                        }
                    }
                    if let Some(why) = stream.get("ending").and_then(|e| e.get("lost")) {
                        parts.push(format!("{name}: {}", why.as_str().unwrap_or("lost")));
                    }
                }
                let groups = health
                    .get("groups")
                    .and_then(|g| g.get("incomplete"))
                    .and_then(serde_json::Value::as_u64);
                if let Some(groups) = groups.filter(|g| *g > 0) {
                    parts.push(format!("{groups} triggers without all images"));
                }
                let found = format!("{lost} lost ({})", parts.join("; "));
                self.add("losses", Verdict::Fail, found, "0");
            }
            None => {
                let found = "health.json does not say what was lost".to_owned();
                self.add("losses", Verdict::Warn, found, "0");
            }
        }
    }

    fn clocks(&mut self, recording: &Recording, config: &DoctorConfig) -> Result<(), Error> {
        let topics: Vec<_> = recording
            .topics()
            .iter()
            .filter(|t| t.topic.starts_with(CLOCK_MODELS))
            .collect();
        for topic in topics {
            let Some(last) = recording.last_message(&topic.topic)? else {
                continue;
            };
            let Ok(model) = message::decode_clock_model(&last.bytes) else {
                continue;
            };
            let (verdict, found) = judge_clock(&model, config);
            let threshold = format!("locked, or σ ≤ {:.0} µs and no step", config.warn_sigma_us);
            self.add(
                &format!("clock {}", model.device),
                verdict,
                found,
                &threshold,
            );
        }
        Ok(())
    }
}

fn judge_clock(model: &ClockModel, config: &DoctorConfig) -> (Verdict, String) {
    if model.kind == "locked" {
        return match model.epoch {
            0 | 1 => (Verdict::Pass, "names the second itself".to_owned()),
            epochs => (
                Verdict::Warn,
                format!(
                    "names the second itself, and was set {} times meanwhile: `lsfb clock` says when and by how much",
                    epochs - 1
                ),
            ),
        };
    }
    let sigma_us = model.sigma_ns / 1e3;
    if model.kind == "holdover" {
        let found = format!("lost its pulse and ran on its own quartz: within {sigma_us:.0} µs");
        return (Verdict::Warn, found);
    }
    let found = format!(
        "fitted to arrival: σ {sigma_us:.1} µs, skew {:.2} ± {:.2} ppm, {} epochs",
        model.skew * 1e6,
        model.sigma_skew * 1e6,
        model.epoch
    );
    let good = model.epoch <= 1 && sigma_us <= config.warn_sigma_us;
    (if good { Verdict::Pass } else { Verdict::Warn }, found)
}

/// Topics that a sensor fills at a steady rate.
fn is_steady(topic: &str) -> bool {
    [
        "/image",
        "/data_raw",
        "/packets",
        "/points",
        "/imu",
        "/mag",
        "/pressure",
    ]
    .iter()
    .any(|end| topic.ends_with(end))
}

/// How steadily messages came.
struct Rhythm<'a> {
    times: &'a [Timestamp],
    period_secs: f64,
    longest_secs: f64,
    longest_at: Timestamp,
}

impl<'a> Rhythm<'a> {
    /// Between the first and the last arrival of any sensor: one that stopped early is silent until the end.
    fn of(times: &'a [Timestamp], start: Timestamp, end: Timestamp) -> Self {
        let span = times
            .last()
            .zip(times.first())
            .map_or(0.0, |(last, first)| last.secs_since(*first));
        let period_secs = if times.len() > 1 && span > 0.0 {
            span / (times.len() - 1) as f64
        } else {
            end.secs_since(start).max(1e-3)
        };
        let mut longest_secs = 0.0;
        let mut longest_at = start;
        let mut last = start;
        for time in times.iter().chain([&end]) {
            let silence = time.secs_since(last);
            if silence > longest_secs {
                (longest_secs, longest_at) = (silence, last);
            }
            last = *time;
        }
        Self {
            times,
            period_secs,
            longest_secs,
            longest_at,
        }
    }

    fn silences(&self, periods: f64) -> usize {
        self.times
            .iter()
            .zip(self.times.iter().skip(1))
            .filter(|(a, b)| b.secs_since(**a) >= periods * self.period_secs)
            .count()
    }
}

/// Time of day and seconds since 1970, as both are looked for.
fn utc(time: Timestamp) -> String {
    let secs = time.nanos().div_euclid(1_000_000_000);
    let millis = time.nanos().rem_euclid(1_000_000_000) / 1_000_000;
    let of_day = secs.rem_euclid(86_400);
    format!(
        "{:02}:{:02}:{:02}.{millis:03} UTC ({secs}.{millis:03} s)",
        of_day / 3600,
        of_day / 60 % 60,
        of_day % 60
    )
}
