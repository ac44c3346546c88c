//! What a walk's device measured besides images and motion, held against the trajectory that these gave.

use lsfb_eval::barometer::{BarometerAgreement, barometer_agreement};
use lsfb_eval::radio::{
    KnownPlace, PlacedReading, PlacingConfig, RadioAgreement, RadioAgreementConfig, place,
    radio_agreement,
};
use lsfb_pipeline::ground_truth::GroundTruth;
use lsfb_recording::Recording;
use lsfb_types::{Finding, Verdict};
use serde::{Deserialize, Serialize};

use crate::refused::Refused;

/// Readings between poses that are farther apart in time have no place, seconds.
const LONGEST_GAP_SECS: f64 = 1.0;

/// What barometer and radio say of a trajectory, where they were recorded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Surroundings {
    pub barometer: Option<BarometerAgreement>,
    pub radio: Option<RadioAgreement>,
}

impl Surroundings {
    /// Looks at a walk and its trajectory; `others` is what other walks heard, at its places. An error where the walk heard other radio, and so
    /// was elsewhere.
    pub fn of(
        walk: &Recording,
        found: &GroundTruth,
        others: Option<&[PlacedReading]>,
    ) -> anyhow::Result<Self> {
        let up = -found.gravity_m_s2;
        let radio = others
            .map(|others| radio(walk, found, others))
            .transpose()?;
        if let Some(radio) = radio.as_ref().filter(|radio| radio.elsewhere().is_some()) {
            let failed = radio.finding();
            let refused = Finding {
                verdict: Verdict::Fail,
                subject: walk.path().display().to_string(),
                what: format!(
                    "the walk received other Wi-Fi and Bluetooth signals than other walks did where \
                     its images and the map place it: it was elsewhere, and no pose is given: {}",
                    failed.what
                ),
                ..failed
            };
            return Err(Refused(refused).into());
        }
        Ok(Self {
            barometer: barometer_agreement(walk, &found.trajectory, &up)?,
            radio,
        })
    }

    /// As the command says it.
    pub fn findings(&self) -> impl Iterator<Item = Finding> {
        let barometer = self.barometer.iter().map(BarometerAgreement::finding);
        barometer.chain(self.radio.iter().map(RadioAgreement::finding))
    }
}

fn radio(
    walk: &Recording,
    found: &GroundTruth,
    others: &[PlacedReading],
) -> anyhow::Result<RadioAgreement> {
    let poses = found.trajectory.poses().iter();
    let known: Vec<KnownPlace> = poses
        .map(|pose| KnownPlace {
            time: pose.time,
            position_m: pose.world_from_rig.translation,
            sigma_m: None,
        })
        .collect();
    let config = PlacingConfig {
        longest_gap_secs: LONGEST_GAP_SECS,
        ..PlacingConfig::default()
    };
    let heard = place(walk, &known, &config)?;
    let agreement = radio_agreement(&heard.readings, others, &RadioAgreementConfig::default())?;
    Ok(agreement)
}
