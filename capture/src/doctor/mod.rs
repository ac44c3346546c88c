//! Is this recording good? Findings with limits, from the indexes first: fast whatever the size of the file.
//!
//! What was not read is said: the verdict rests on nothing else than what is listed.

mod calibration;
mod clocks;
mod devices;
mod file;
mod images;
mod imported;
mod inertial;
mod interrupted;
mod pace;
mod rhythm;
mod sight;
mod stamps;
mod stream;
mod topics;
mod wifi;

use lsfb_recording::Recording;
use lsfb_types::{Bounds, Finding, Judgement, ProgressFn};
use serde::{Deserialize, Serialize};

pub use calibration::CalibrationFound;

use crate::Error;
use stream::Stream;

/// What is good enough.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DoctorConfig {
    /// A silence of so many periods of a topic is worth a look.
    pub warn_gap_periods: f64,
    /// A silence longer than this lost data, seconds.
    pub fail_gap_secs: f64,
    /// Share of the messages that a device's own period promises below which its rate is worth a look.
    pub warn_rate_share: f64,
    /// Share of the rate that the recorder wrote of a device below which its stream has failed.
    pub fail_rate_share: f64,
    /// Stamps of devices that lie further from their arrivals than those of others, or than this where there are none, are worth a
    /// look, seconds.
    pub warn_stamp_offset_secs: f64,
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
            warn_rate_share: 0.9,
            fail_rate_share: 0.6,
            warn_stamp_offset_secs: 1.0,
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
        warn_rate_share: number(Bounds::NOT_NEGATIVE),
        fail_rate_share: number(Bounds::NOT_NEGATIVE),
        warn_stamp_offset_secs: number(Bounds::POSITIVE),
        warn_sigma_us: number(Bounds::NOT_NEGATIVE),
        warn_calibration_days: number(Bounds::NOT_NEGATIVE),
        read: any,
    }
}

/// The diagnosis of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosis {
    /// The verdict and what it rests on.
    pub judgement: Judgement,
    /// What was looked at.
    pub facts: Facts,
}

/// What a recording is, whether it is good or not.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Facts {
    /// Size of the file, bytes.
    pub bytes: u64,
    /// From the first to the last arrival, seconds.
    pub duration_secs: f64,
    /// Messages on all topics, as far as the indexes hold them.
    pub messages: u64,
    /// The calibration it carries; `None` where there is no rig in it.
    pub calibration: Option<CalibrationFound>,
}

impl Diagnosis {
    /// What was judged, in a few words.
    pub fn summary(&self) -> String {
        format!(
            "{:.1} MB, {:.1} s, {} messages",
            self.facts.bytes as f64 / 1e6,
            self.facts.duration_secs,
            self.facts.messages
        )
    }
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
    findings.counts(recording, &arrivals);
    findings.checksums(recording, config, progress)?;
    findings.part(recording);
    let calibration = findings.calibration(recording, config)?;
    let streams = Stream::all(recording, &arrivals, config)?;
    findings.devices(recording, &streams);
    findings.sight(recording, config)?;
    findings.images(recording, config)?;
    findings.inertial(recording, config)?;
    findings.pace(&streams);
    let import = imported::entries(recording);
    if import.is_none() {
        findings.stamps(&streams, config);
    }
    findings.topics(recording, &streams, &arrivals, config);
    match import {
        Some(import) => findings.imported(&import),
        None => findings.losses(recording),
    }
    findings.clocks(recording, config)?;
    findings.wifi(recording);
    let duration_secs = recording
        .arrival_range()
        .map_or(0.0, |range| range.end.secs_since(range.start));
    Ok(Diagnosis {
        judgement: Judgement::new(findings.0),
        facts: Facts {
            bytes,
            duration_secs,
            messages: arrivals.iter().map(|a| a.times.len() as u64).sum(),
            calibration,
        },
    })
}

/// Looks at what the IMUs of a recording measured, all of it, and at nothing else.
pub fn examine_imus(recording: &Recording) -> Result<Judgement, lsfb_recording::Error> {
    let config = DoctorConfig {
        read: Depth::Everything,
        ..DoctorConfig::default()
    };
    let mut findings = Findings(Vec::new());
    findings.inertial(recording, &config)?;
    Ok(Judgement::new(findings.0))
}

/// What was found so far; each file of this module adds its own.
struct Findings(Vec<Finding>);

impl Findings {
    fn add(&mut self, finding: Finding) {
        self.0.push(finding);
    }
}

#[cfg(test)]
mod tests;
