//! Which calibration a recording carries, how old it was, and whether all parts of a recording carry the same.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use lsfb_recording::{RecordedCalibration, Recording};
use lsfb_types::{Finding, Limit, Timestamp, Verdict};
use serde::Serialize;

use super::{DoctorConfig, Findings};
use crate::Error;

const DAY_SECS: f64 = 86_400.0;
/// Digits of a hash that people compare.
const SHORT_HASH: usize = 16;

/// The calibration of a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibrationFound {
    /// Name of the device.
    pub name: String,
    /// SHA-256 of the rig in the recording.
    pub sha256: String,
    /// The hash that the recorder wrote beside it; `None` where it wrote none.
    pub stated_sha256: Option<String>,
    /// End of the recording it was calibrated from, seconds since 1970; `None` where the rig does not say.
    pub calibrated_unix_s: Option<i64>,
    /// From then to the end of this recording, days; negative where it was calibrated afterwards.
    pub age_days: Option<f64>,
}

impl CalibrationFound {
    fn new(found: RecordedCalibration, end: Option<Timestamp>) -> Self {
        let calibrated_unix_s = found.rig.calibrated_unix_s;
        let age_days = calibrated_unix_s.zip(end).map(|(calibrated, end)| {
            let end_s = end.nanos().div_euclid(1_000_000_000);
            end_s.saturating_sub(calibrated) as f64 / DAY_SECS
        });
        Self {
            name: found.rig.name,
            sha256: found.sha256,
            stated_sha256: found.stated_sha256,
            calibrated_unix_s,
            age_days,
        }
    }
}

impl Findings {
    /// The rig, its hash and its age.
    pub(super) fn calibration(
        &mut self,
        recording: &Recording,
        config: &DoctorConfig,
    ) -> Result<Option<CalibrationFound>, Error> {
        let found = match recording.calibration() {
            Ok(found) => found,
            Err(error) => {
                let finding = Finding::new("rig", Verdict::Warn, "rig", error.to_string());
                self.add(finding.remedy("pass one where it is needed: `--rig rig.toml`"));
                return Ok(None);
            }
        };
        let cameras = found.rig.cameras.len();
        let text = format!("{:?} with {cameras} cameras", found.rig.name);
        self.add(Finding::new("rig", Verdict::Pass, "rig", text));
        let found = CalibrationFound::new(found, recording.end_time()?);
        self.age(&found, config);
        if let Some(stated) = &found.stated_sha256
            && *stated != found.sha256
        {
            let text = format!(
                "the recorder wrote hash {}, but the rig has hash {}: the rig was changed afterwards, or the recording was assembled from two",
                short(stated),
                short(&found.sha256)
            );
            self.add(Finding::new(
                "calibration-hash",
                Verdict::Warn,
                "calibration",
                text,
            ));
        }
        self.parts(recording, &found);
        Ok(Some(found))
    }

    fn age(&mut self, found: &CalibrationFound, config: &DoctorConfig) {
        let limit = Limit::AtMost(config.warn_calibration_days);
        let hash = short(&found.sha256);
        let finding = |verdict, text| Finding::new("calibration-age", verdict, "calibration", text);
        if found.calibrated_unix_s.is_none() {
            let text = format!("{hash}, calibrated at an unknown time");
            let remedy = "calibrate with `lsfb calib`, which writes calibrated_unix_s into the rig, or set it by hand";
            return self.add(finding(Verdict::Warn, text).remedy(remedy));
        }
        let Some(days) = found.age_days else {
            let text = format!("{hash}; its age is unknown without measurements");
            return self.add(finding(Verdict::Unknown, text));
        };
        let text = match days.abs() {
            age if age < 1.0 => format!("{hash}, calibrated within a day of this recording"),
            age => format!(
                "{hash}, calibrated {age:.1} days {} the end of this recording",
                if days < 0.0 { "after" } else { "before" }
            ),
        };
        let verdict = Verdict::Warn.unless(limit.holds(days.abs()));
        let finding = finding(verdict, text)
            .value(days.abs(), "days")
            .limit(limit);
        self.add(finding.remedy("check with `lsfb calib verify` whether it still fits"));
    }

    /// Whether the parts of the recording that lie beside this one carry the same calibration.
    fn parts(&mut self, recording: &Recording, found: &CalibrationFound) {
        let parts = other_parts(recording);
        if parts.is_empty() {
            return;
        }
        let other = |part: &Part| match &part.sha256 {
            Some(hash) if *hash == found.sha256 => None,
            Some(hash) => Some(format!("{} carries {}", part.name, short(hash))),
            None => Some(format!("{} has no rig", part.name)),
        };
        let others: Vec<String> = parts.iter().filter_map(other).collect();
        let finding = |verdict, text| {
            Finding::new("calibration-parts", verdict, "calibration of parts", text)
        };
        self.add(if others.is_empty() {
            let text = format!("the same in all {} parts found here", parts.len() + 1);
            finding(Verdict::Pass, text)
        } else {
            let text = format!("{} here, but {}", short(&found.sha256), others.join(", "));
            finding(Verdict::Warn, text)
                .remedy("process each part with the rig that was on the device then")
        });
    }
}

/// The beginning of a hash.
fn short(hash: &str) -> &str {
    hash.get(..SHORT_HASH).unwrap_or(hash)
}

/// Another part of a recording.
struct Part {
    name: String,
    sha256: Option<String>,
}

impl Part {
    fn new(recording: &Recording) -> Self {
        let name = recording.path().file_name().unwrap_or_default();
        Self {
            name: name.to_string_lossy().into_owned(),
            sha256: recording.calibration().ok().map(|c| c.sha256),
        }
    }
}

/// The other parts of a recording, as far as they lie in the same folder and name each other.
fn other_parts(recording: &Recording) -> Vec<Part> {
    let mut parts = Vec::new();
    let mut seen = BTreeSet::from([recording.path().to_owned()]);
    let mut before = named_before(recording);
    while let Some(path) = before.filter(|path| seen.insert(path.clone())) {
        let part = Recording::open(&path).ok();
        parts.extend(part.as_ref().map(Part::new));
        before = part.as_ref().and_then(named_before);
    }
    parts.reverse();
    let mut behind = behind(recording);
    while let Some(part) = behind.filter(|part| seen.insert(part.path().to_owned())) {
        parts.push(Part::new(&part));
        behind = self::behind(&part);
    }
    parts
}

/// The part that a part says it follows, where it is a file of the same folder.
fn named_before(part: &Recording) -> Option<PathBuf> {
    let session = part.metadata("lsfb.session").ok()?;
    let name = Path::new(session.get("previous")?).file_name()?;
    let path = part.path().with_file_name(name);
    path.is_file().then_some(path)
}

/// The part that follows a part: `scan-0002.mcap` behind `scan.mcap`, if it says so too.
fn behind(part: &Recording) -> Option<Recording> {
    let session = part.metadata("lsfb.session").ok()?;
    let number: u32 = session.get("part")?.parse().ok()?;
    let stem = part.path().file_stem()?.to_str()?;
    let stem = match number {
        1 => stem,
        _ => stem.rsplit_once('-')?.0,
    };
    let name = format!("{stem}-{:04}.mcap", number.checked_add(1)?);
    let next = Recording::open(&part.path().with_file_name(name)).ok()?;
    (named_before(&next)? == part.path()).then_some(next)
}
