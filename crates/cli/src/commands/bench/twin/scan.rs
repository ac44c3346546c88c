//! The runs of one place: its scan, the walks in it, and what is judged of each.

use std::path::{Path, PathBuf};

use lsfb_pipeline::ground_truth::GroundTruthConfig;
use lsfb_pipeline::mapping::MappingConfig;
use lsfb_recording::Provenance;
use lsfb_sim::{Device, SimConfig};
use serde::Serialize;

use super::cost::Costs;
use super::result::Run;
use super::rigs::Rigs;
use super::session::{Mapped, Refusable, STAGES, Session};
use super::trial::{Scanned, Walked};
use super::{Rig, Trial};
use crate::context::Context;
use crate::standing;

/// All that decides what a run gives.
#[derive(Serialize)]
struct Settings {
    walked: Walked,
    rigs: Rigs,
    scan: SimConfig,
    walk: SimConfig,
    mapping: MappingConfig,
    ground_truth: GroundTruthConfig,
}

/// A place with a seed: scanned and mapped once, when the first walk needs it.
pub struct Scan<'a> {
    trial: &'a Trial<'a>,
    session: Session<'a>,
    costs: Costs,
    mapped: Option<Refusable<Mapped>>,
}

impl<'a> Scan<'a> {
    pub fn new(trial: &'a Trial<'a>, scanned: Scanned, context: &'a Context) -> Self {
        let folder = trial
            .out
            .join(format!("{}-{}", scanned.place.name(), scanned.seed));
        Self {
            trial,
            costs: Costs::open(folder.join("costs.json")),
            session: Session {
                folder,
                scanned,
                light: trial.light.clone(),
                context,
            },
            mapped: None,
        }
    }

    /// The rig of the backpack, or of a device.
    fn rig(&self, device: Option<Device>) -> anyhow::Result<Rig> {
        let seed = self.session.scanned.seed;
        self.trial.rig(seed, device)
    }

    /// Records the scan and the walks that do not stand: those of one world after another, so that it is built once.
    pub fn record(&mut self, walks: &[Walked]) -> anyhow::Result<()> {
        let pending = walks.iter().filter(|w| self.standing(w).is_none());
        let mut pending: Vec<&Walked> = pending.collect();
        if pending.is_empty() {
            return Ok(());
        }
        let Ok(backpack) = self.rig(None)?.found else {
            return Ok(());
        };
        let mut last = None;
        self.session
            .record_scan(&backpack, &mut self.costs, &mut last)?;
        // The scan's world is that of the walks as scanned.
        pending.sort_by_key(|walked| walked.condition);
        for walked in pending {
            let Ok(device) = self.rig(Some(walked.device))?.found else {
                continue;
            };
            let folder = self.session.walk_folder(walked);
            let mut costs = Costs::open(folder.join("costs.json"));
            self.session
                .record_walk(walked, &device, &mut costs, &mut last)?;
        }
        Ok(())
    }

    /// Where the result of a walk lies, and what makes it.
    fn result(&self, walked: &Walked) -> (PathBuf, Provenance) {
        let made_from = Provenance::new(&Settings {
            walked: *walked,
            rigs: self.trial.given,
            scan: self.trial.light.on(walked.scanned.config()),
            walk: self.trial.light.on(walked.config()),
            mapping: MappingConfig::default(),
            ground_truth: GroundTruthConfig::default(),
        });
        let folder = self.session.walk_folder(walked);
        (folder.join("run.json"), made_from)
    }

    fn standing(&self, walked: &Walked) -> Option<Run> {
        let (path, made_from) = self.result(walked);
        self.session.context.standing(&[&path], &made_from)
    }

    /// One walk that is recorded, and whether it was made now; what stands is read.
    pub fn run(&mut self, walked: &Walked, keep: bool) -> anyhow::Result<(Run, bool)> {
        if let Some(run) = self.standing(walked) {
            return Ok((run, false));
        }
        let (path, made_from) = self.result(walked);
        let folder = self.session.walk_folder(walked);
        std::fs::create_dir_all(&folder)?;
        standing::forget(&[&path])?;
        let run = self.make(walked, &folder)?;
        crate::files::write(&path, serde_json::to_vec_pretty(&run)?)?;
        standing::finish(&[&path], &[], &made_from, &run)?;
        if !keep {
            standing::remove(&folder.join("walk.mcap"))?;
        }
        Ok((run, true))
    }

    fn make(&mut self, walked: &Walked, folder: &Path) -> anyhow::Result<Run> {
        let rigs = [self.rig(None)?, self.rig(Some(walked.device))?];
        let mut costs = Costs::open(folder.join("costs.json"));
        let mut run = Run::of(walked, self.trial.given);
        match (&rigs[0].found, &rigs[1].found) {
            (Err(why), _) | (_, Err(why)) => run.refuse(why, walked),
            (Ok(backpack), Ok(device)) => {
                run.rigs_off = [backpack.off.clone(), device.off.clone()].concat();
                if self.mapped.is_none() {
                    self.mapped = Some(self.session.map(&mut self.costs)?);
                }
                match &self.mapped {
                    Some(Ok(mapped)) => {
                        self.session.walk(walked, mapped, &mut costs, &mut run)?;
                    }
                    Some(Err(why)) => run.refuse(why, walked),
                    None => {}
                }
            }
        }
        let of_rigs = STAGES
            .iter()
            .zip(&rigs)
            .map(|(name, rig)| (*name, rig.cost));
        let others = STAGES.iter().skip(rigs.len());
        let others = others.map(|name| (*name, self.costs.get(name).or(costs.get(name))));
        for (name, cost) in of_rigs.chain(others) {
            if let Some(cost) = cost {
                run.stages_s.push((name.to_owned(), cost.wall_s));
                run.stages_peak_rss_mb
                    .push((name.to_owned(), cost.peak_rss_mb));
                run.peak_rss_mb = run.peak_rss_mb.max(cost.peak_rss_mb);
                run.beside_others |= cost.beside_others;
            }
        }
        Ok(run)
    }

    /// Removes the recording of the scan, which is large, and whose map is there.
    pub fn forget_recording(&self) -> anyhow::Result<()> {
        standing::remove(&self.session.folder.join("scan.mcap"))
    }
}
