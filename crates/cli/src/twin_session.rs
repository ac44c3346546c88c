//! Scans and walks in the twin: their settings, and their recordings, which are made once.

use std::path::PathBuf;
use std::sync::Arc;

use lsfb_geometry::Rig;
use lsfb_recording::Provenance;
use lsfb_sim::{Device, PaperMotion, Place, SimConfig, Simulation, Walker};

use crate::context::Context;
use crate::simulated::{self, Layout, WalkTold};
use crate::standing;

/// How far walks go from the scanner's path at most, metres.
const OFF_PATH_M: f64 = 6.0;

/// Settings of a scan of a place, and of a walk beside the scanner's path, held at another height with each seed.
pub fn beside_the_scan(
    place: Place,
    motion: Option<&PaperMotion>,
    device: Device,
    seed: u64,
) -> SimConfig {
    let mut config = match motion {
        Some(motion) => SimConfig::for_motion(motion, device),
        None => SimConfig::for_place(place, device),
    };
    config.seed = seed;
    config.off_path_m = OFF_PATH_M;
    // Phones are held before the chest, glasses worn; nobody is as tall as the scanner's mast.
    let held_m = match device {
        Device::Android => 1.35,
        Device::Iphone => 1.45,
        Device::Glasses => 1.62,
    };
    config.glasses.height_m = held_m + 0.04 * (seed % 5) as f64 - 0.08;
    config
}

/// Smaller images, coarser surfaces, and of the scanner's images as many as a map takes.
pub fn smaller(config: &mut SimConfig) {
    config.texel_m = 0.004;
    (config.scan_cameras.width, config.scan_cameras.height) = (480, 304);
    config.scan_cameras.rate_hz = 5;
    let cameras = &mut config.glasses_cameras;
    cameras.height = cameras.height * 3 / 4;
    cameras.width = cameras.width * 3 / 4;
}

/// One of the two recordings of a simulated session.
pub struct Wanted<'a> {
    /// Settings of the session.
    pub config: &'a SimConfig,
    /// Which of its recordings.
    pub walker: Walker,
    /// The rig that the device states; without, the true one.
    pub rig: Option<&'a Rig>,
    /// What the recording of a walk says besides; without, what `lsfb sim` says.
    pub told: Option<&'a WalkTold<'a>>,
}

impl<'a> Wanted<'a> {
    /// The scan of a session, with the true rig.
    pub fn scan(config: &'a SimConfig) -> Self {
        Self {
            config,
            walker: Walker::Backpack,
            rig: None,
            told: None,
        }
    }

    /// The walk of a session, with the true rig.
    pub fn walk(config: &'a SimConfig) -> Self {
        Self {
            walker: Walker::Glasses,
            ..Self::scan(config)
        }
    }

    /// The recording, the rig that it states, and the true trajectory.
    pub fn files(&self, layout: &Layout) -> [PathBuf; 3] {
        let [recording, rig, truth] = match self.walker {
            Walker::Backpack => ["scan.mcap", "backpack.toml", "truth_scan.tum"],
            Walker::Glasses => ["walk.mcap", "glasses.toml", "truth_walk.tum"],
        };
        [
            layout.file(recording),
            layout.file(rig),
            layout.truth().join(truth),
        ]
    }

    /// Simulates and records unless the recording stands; `begins` is called before. How many messages were lost. `last` is the simulation
    /// that was recorded before, if any, whose world may serve once more, and then this one.
    pub fn record(
        &self,
        layout: &Layout,
        context: &Context,
        last: &mut Option<Arc<Simulation>>,
        begins: impl FnOnce(),
    ) -> anyhow::Result<u64> {
        let made_from = self.made_from();
        let files = self.files(layout);
        let outputs = files.each_ref().map(PathBuf::as_path);
        if let Some(lost) = context.standing(&outputs, &made_from) {
            return Ok(lost);
        }
        begins();
        standing::forget(&outputs)?;
        let lost = self.make(layout, context, last)?;
        standing::finish(&outputs, &[], &made_from, &lost)?;
        Ok(lost)
    }

    /// All that decides what is recorded.
    pub fn made_from(&self) -> Provenance {
        let mut made_from = Provenance::new(self.config);
        if let Some(rig) = self.rig {
            made_from.add_rig(rig);
        }
        made_from
    }

    fn make(
        &self,
        layout: &Layout,
        context: &Context,
        last: &mut Option<Arc<Simulation>>,
    ) -> anyhow::Result<u64> {
        let rig = self.rig.cloned();
        let rigs = match self.walker {
            Walker::Backpack => [rig, None],
            Walker::Glasses => [None, rig],
        };
        let earlier = last.take();
        let simulation =
            simulated::prepare(layout, self.config, rigs, earlier.as_deref(), context)?;
        drop(earlier);
        let report = match (self.walker, self.told) {
            (Walker::Backpack, _) => simulated::record_backpack(layout, &simulation, context)?,
            (Walker::Glasses, Some(told)) => {
                simulated::record_walk(layout, &simulation, told, context)?
            }
            (Walker::Glasses, None) => simulated::record_glasses(layout, &simulation, context)?,
        };
        *last = Some(simulation);
        Ok(report.lost)
    }
}
