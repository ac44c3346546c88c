//! Scans and walks of a dataset: simulated in a folder beside it, then moved to their places, each once.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use lsfb_eval::dataset::{
    DatasetFolder, DatasetPlan, Device, Environment, PlannedSequence, QueryEntry,
};
use lsfb_geometry::Rig;
use lsfb_recording::sha256_of;
use lsfb_sim::{PaperMotion, Place, SimConfig, Simulation};
use serde::{Deserialize, Serialize};

use crate::context::Context;
use crate::simulated::{Layout, WalkTold};
use crate::standing;
use crate::twin_session::{Wanted, beside_the_scan, smaller};

/// A scan takes so many times as long as the shortest walk at least: on a way of few steps nobody can walk.
const LEAST_SCAN: f64 = 4.0;
/// Name of the backpack's rig.
const BACKPACK: &str = "backpack";

/// All that decides what is packed, kept beside the dataset.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    pub seed: u64,
    pub scale_percent: f64,
    /// Shortest walk, seconds.
    pub min_secs: f64,
    pub small_images: bool,
    pub sequences: Vec<String>,
}

/// What a dataset is to hold.
pub enum Wish<'a> {
    Scan(&'a Environment),
    Walk(&'a PlannedSequence<'a>),
}

impl<'a> Wish<'a> {
    /// The scan of an environment.
    pub fn scan(environment: &'a Environment) -> Self {
        Self::Scan(environment)
    }

    /// The walk of a sequence.
    pub fn walk(sequence: &'a PlannedSequence<'a>) -> Self {
        Self::Walk(sequence)
    }

    fn name(&self) -> &str {
        match self {
            Self::Scan(environment) => &environment.name,
            Self::Walk(sequence) => &sequence.name,
        }
    }
}

/// Files of a dataset, by their paths in it, as they were packed.
#[derive(Serialize, Deserialize)]
struct Packed {
    sha256: BTreeMap<PathBuf, String>,
}

/// Where a dataset comes from and goes to.
pub struct Contents<'a> {
    pub folder: &'a DatasetFolder,
    /// Beside it: what is made, and what says that it is.
    pub making: &'a Path,
    pub settings: &'a Settings,
    pub plan: &'a DatasetPlan,
    pub context: &'a Context,
}

impl Contents<'_> {
    /// A walk as `dataset.toml` has it.
    pub fn entry(&self, sequence: &PlannedSequence<'_>) -> QueryEntry {
        let motion = sequence.motion;
        let duration_s = self.duration_s(sequence);
        let share = duration_s / sequence.duration_s;
        QueryEntry {
            name: sequence.name.clone(),
            motion: motion.name.clone(),
            environment: motion.environment.clone(),
            device: sequence.device,
            gait: motion.gait,
            gaze: motion.gaze,
            frames: (duration_s * self.plan.rate_hz).floor() as u32,
            length_m: sequence.length_m * share,
            description: motion.description.clone(),
        }
    }

    /// How long a walk is at the scale.
    fn duration_s(&self, sequence: &PlannedSequence<'_>) -> f64 {
        let whole_s = sequence.duration_s;
        let scaled_s = 0.01 * self.settings.scale_percent * whole_s;
        scaled_s.max(self.settings.min_secs.min(whole_s))
    }

    /// Makes and packs it unless it is packed. `last` is as [`Wanted::record`] has it.
    pub fn pack(&self, wish: &Wish<'_>, last: &mut Option<Arc<Simulation>>) -> anyhow::Result<()> {
        let config = self.config(wish)?;
        let rig = stated_rig(&config, wish);
        let told = WalkTold {
            // In the recording, where a seed would give the truth away.
            session: wish.name().to_owned(),
            identifiers_key: Some(&self.making.join("identifiers.key")),
        };
        let wanted = match wish {
            Wish::Scan(_) => Wanted::scan(&config),
            Wish::Walk(_) => Wanted::walk(&config),
        };
        let wanted = Wanted {
            rig: Some(&rig),
            told: Some(&told),
            ..wanted
        };
        let list = self.making.join(format!("{}.json", wish.name()));
        let made_from = wanted.made_from();
        let before: Option<Packed> = self.context.standing(&[&list], &made_from);
        if before.is_some_and(|packed| packed.is_in(self.folder.path())) {
            return Ok(());
        }
        standing::forget(&[&list])?;
        let layout = Layout::create(&self.making.join(wish.name()))?;
        let lost = wanted.record(&layout, self.context, last, || {})?;
        anyhow::ensure!(
            lost == 0,
            "{}: {lost} messages were lost during recording: run the command again",
            wish.name()
        );
        self.calibration(wish, &rig)?;
        let [recording, _, truth] = wanted.files(&layout);
        let [to_recording, to_truth] = self.places(wish);
        let mut sha256 = BTreeMap::new();
        for (from, to) in [(truth, to_truth), (recording, to_recording)] {
            let around = to.parent().unwrap_or(self.folder.path());
            std::fs::create_dir_all(around).with_context(|| around.display().to_string())?;
            std::fs::rename(&from, &to).with_context(|| to.display().to_string())?;
            let below = to.strip_prefix(self.folder.path())?.to_owned();
            sha256.insert(below, sha256_of(&to)?);
        }
        let packed = Packed { sha256 };
        crate::files::write(&list, serde_json::to_vec_pretty(&packed)?)?;
        standing::finish(&[&list], &[], &made_from, &packed)?;
        let made = self.making.join(wish.name());
        std::fs::remove_dir_all(&made).with_context(|| made.display().to_string())
    }

    fn config(&self, wish: &Wish<'_>) -> anyhow::Result<SimConfig> {
        let (environment, motion, device) = match wish {
            Wish::Scan(environment) => (&environment.name, None, lsfb_sim::Device::Glasses),
            Wish::Walk(sequence) => {
                let motion = PaperMotion::named(&sequence.motion.name);
                let motion = motion.with_context(|| format!("no motion {}", sequence.name))?;
                let device = match sequence.device {
                    Device::Android => lsfb_sim::Device::Android,
                    Device::Iphone => lsfb_sim::Device::Iphone,
                    Device::Glasses => lsfb_sim::Device::Glasses,
                };
                (&sequence.motion.environment, Some(motion), device)
            }
        };
        let place = Place::named(environment).with_context(|| format!("no place {environment}"))?;
        let mut config = beside_the_scan(place, motion, device, self.settings.seed);
        if self.settings.small_images {
            smaller(&mut config);
        }
        if self.settings.scale_percent < 100.0 {
            let all = self.plan.sequences();
            let here = all.iter().filter(|s| s.motion.environment == *environment);
            let longest_s = here.map(|s| self.duration_s(s)).fold(0.0, f64::max);
            config.scan.duration_s = longest_s.max(LEAST_SCAN * self.settings.min_secs);
        }
        if let Wish::Walk(sequence) = wish {
            config.glasses.duration_s = self.duration_s(sequence);
        }
        Ok(config)
    }

    /// Its recording and its truth in the dataset.
    fn places(&self, wish: &Wish<'_>) -> [PathBuf; 2] {
        let (folder, name) = (self.folder, wish.name());
        match wish {
            Wish::Scan(_) => [folder.scan(name), folder.scan_truth(name)],
            Wish::Walk(_) => [folder.walk(name), folder.walk_truth(name)],
        }
    }

    /// Writes the rig of the device, which is the same in all its recordings.
    fn calibration(&self, wish: &Wish<'_>, rig: &Rig) -> anyhow::Result<()> {
        let path = match wish {
            Wish::Scan(_) => self.folder.calibration(BACKPACK),
            Wish::Walk(sequence) => self.folder.calibration_of(sequence.device),
        };
        let around = path.parent().unwrap_or(self.folder.path());
        std::fs::create_dir_all(around).with_context(|| around.display().to_string())?;
        crate::files::write(&path, rig.to_toml())
    }
}

impl Packed {
    fn is_in(&self, folder: &Path) -> bool {
        let is_same = |(name, sum): (&PathBuf, &String)| {
            sha256_of(&folder.join(name)).is_ok_and(|own| own == *sum)
        };
        self.sha256.iter().all(is_same)
    }
}

/// The true rig, with the shutter's readout, as a data sheet gives it.
fn stated_rig(config: &SimConfig, wish: &Wish<'_>) -> Rig {
    let (mut rig, cameras) = match wish {
        Wish::Scan(_) => (lsfb_sim::rigs::backpack(config), &config.scan_cameras),
        Wish::Walk(_) => (lsfb_sim::rigs::walker(config), &config.glasses_cameras),
    };
    for camera in rig.cameras.values_mut() {
        // A rig counts to below the last row, the simulation to the last row.
        let rows = f64::from(cameras.height);
        camera.timing.readout_s = 1e-9 * f64::from(cameras.readout_ns) * rows / (rows - 1.0);
    }
    rig
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The plan is for eval, which knows no simulator: both must mean the same.
    #[test]
    fn the_simulator_walks_what_is_planned() {
        let plan = DatasetPlan::paper().expect("plan");
        for sequence in plan.sequences() {
            let motion =
                PaperMotion::named(&sequence.motion.name).expect("a motion of the simulator");
            let place =
                Place::named(&sequence.motion.environment).expect("a place of the simulator");
            assert_eq!(motion.place, place, "{}", sequence.name);
            let device = sequence.device as usize;
            assert_eq!(motion.frames[device], sequence.frames, "{}", sequence.name);
            assert_eq!(
                motion.length_m[device], sequence.length_m,
                "{}",
                sequence.name
            );
        }
        for environment in &plan.environments {
            let place = Place::named(&environment.name).expect("a place of the simulator");
            let mut sides = [place.size_m(), environment.size_m];
            sides.iter_mut().for_each(|s| s.sort_by(f64::total_cmp));
            assert_eq!(sides[0], sides[1], "{}", environment.name);
        }
    }
}
