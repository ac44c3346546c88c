//! `lsfb bench twin`: the standard trial.

mod cost;
mod judging;
mod page;
mod result;
mod rigs;
mod session;
mod trial;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use lsfb_pipeline::ground_truth::GroundTruthConfig;
use lsfb_pipeline::mapping::MappingConfig;
use lsfb_recording::Provenance;
use lsfb_sim::{Device, Look, Place, SimConfig};
use serde::Serialize;

use crate::commands::sim::device;
use crate::context::Context;
use crate::judged::{self, Judged};
use crate::outcome::Outcome;
use crate::standing;
use cost::{Cost, Costs};
use result::Run;
pub use result::WRONG_M;
use rigs::{Bearer, Calibrated, Rigs, calibrated, true_rig};
pub use session::refusal;
use session::{Mapped, Refusable, STAGES, Session};
pub use trial::OTHER_FLOOR;
use trial::{Condition, Light, Scanned, Size, Walked, calibration};

/// Run the standard trial: scan, map, ground truth and evaluation in simulated places, as in the paper's Tables IV and V.
///
/// Walks go 0.5 to 6 m beside the scanner's path where the place has room, with the motions of Table VII, and every rig comes from a
/// calibration before a simulated board. The exit code is 4 if any exported pose is more than 10 cm off, or if no place could
/// be mapped. What is finished is not run again; recordings are removed once they are judged. Written are twin.json and report.html.
///
/// Examples:
///   lsfb bench twin --out trial --quick
///   lsfb bench twin --out trial --places atrium,stairs --devices glasses --seeds 3 --seed 11
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder for maps, trajectories and the report.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Environments of `lsfb sim --place`, separated by commas; without it all nine of the paper.
    #[arg(long = "place", visible_alias = "places", value_name = "NAME", value_parser = place, value_delimiter = ',')]
    places: Vec<Place>,
    /// Devices of the walks, separated by commas; without it android, iphone and glasses.
    #[arg(long = "device", visible_alias = "devices", value_name = "NAME", value_parser = device, value_delimiter = ',')]
    devices: Vec<Device>,
    /// How the place has changed between scan and walk, separated by commas: as-scanned; six-months, in which half of what
    /// people move has been moved; crowd, with a dozen people more; other-floor, on another floor that is built alike, where every
    /// pose is wrong; night, with few lamps lit; fire-door, with a door closed that stood open (large-office, house-park, both corridors).
    #[arg(long = "condition", visible_alias = "conditions", value_name = "NAME", value_parser = Condition::named, value_delimiter = ',', default_value = "as-scanned")]
    conditions: Vec<Condition>,
    /// Number of seeds.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// The first seed.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = super::super::seed, allow_hyphen_values = true)]
    seed: u64,
    /// Shorter walks and smaller images, for daily use; otherwise as hard.
    #[arg(long)]
    quick: bool,
    /// Only check that everything runs, on seconds of scan and walk; the figures mean nothing.
    #[arg(long, conflicts_with = "quick")]
    try_out: bool,
    /// Give the estimators the exact rigs instead of calibrated ones: easier than any real trial.
    #[arg(long)]
    true_rigs: bool,
    /// Light traced from true lamps, sky and sun, with shadows, gloss and windows too bright to see through; computed once for each place.
    #[arg(long)]
    baked_light: bool,
    /// Surfaces painted each in its own way, with signs, books, screens and papers that have words on them, and a view out of the windows.
    #[arg(long)]
    detailed_look: bool,
    /// Keep all recordings: hundreds of megabytes for each scan, tens of gigabytes without --quick.
    #[arg(long)]
    keep_recordings: bool,
}

fn place(name: &str) -> Result<Place, String> {
    let mut known = Place::ENVIRONMENTS.into_iter();
    known.find(|p| p.name() == name).ok_or_else(|| {
        let names: Vec<&str> = Place::ENVIRONMENTS.map(Place::name).to_vec();
        format!("expected one of {}", names.join(", "))
    })
}

/// Says that a folder is a trial's own.
const MARK: &str = "twin-trial.txt";
const RESULT: &str = "twin.json";
const PAGE: &str = "report.html";

#[derive(Serialize)]
struct Printed<'a> {
    runs: &'a [Run],
    page: &'a Path,
}

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

/// Runs what does not stand from a trial that was interrupted.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    take_folder(&arguments.out, context)?;
    let mut trial = Trial {
        out: &arguments.out,
        size: match (arguments.quick, arguments.try_out) {
            (true, _) => Size::Quick,
            (_, true) => Size::TryOut,
            (false, false) => Size::Full,
        },
        given: match arguments.true_rigs {
            true => Rigs::True,
            false => Rigs::Calibrated,
        },
        light: Light {
            folder: arguments.baked_light.then(|| arguments.out.join("light")),
            look: match arguments.detailed_look {
                true => Look::Detailed,
                false => Look::Plain,
            },
        },
        context,
        rigs: BTreeMap::new(),
    };
    let places = or_all(&arguments.places, &Place::ENVIRONMENTS);
    let devices = or_all(&arguments.devices, &Device::ALL);
    let conditions = |place: Place| {
        let all = arguments.conditions.iter();
        all.filter(move |condition| condition.is_possible_in(place))
    };
    let walks_of = |place: &Place| devices.len() * conditions(*place).count();
    for place in &places {
        for condition in &arguments.conditions {
            if !condition.is_possible_in(*place) {
                context.note(&format!(
                    "{}: has no door that could be closed, and so no {} walks",
                    place.name(),
                    condition.name()
                ));
            }
        }
    }
    let doored = Place::ENVIRONMENTS
        .into_iter()
        .filter(|p| p.has_fire_doors());
    let doored: Vec<&str> = doored.map(Place::name).collect();
    let of_a_seed: usize = places.iter().map(walks_of).sum();
    anyhow::ensure!(
        of_a_seed > 0,
        "no walk is left: none of the places has a door that could be closed; choose --place {}",
        doored.join(",")
    );
    let last = arguments.seed.saturating_add(arguments.seeds - 1);
    let total = of_a_seed * arguments.seeds as usize;
    let (began, mut made, mut runs) = (Instant::now(), 0, Vec::new());
    for seed in arguments.seed..=last {
        for place in &places {
            let scanned = Scanned {
                place: *place,
                seed,
                size: trial.size,
            };
            let mut scan = Scan::new(&trial, scanned);
            let of_device = |device: &Device| {
                let walked = |condition: &Condition| Walked {
                    scanned,
                    condition: *condition,
                    device: *device,
                };
                conditions(*place).map(walked).collect::<Vec<_>>()
            };
            let walks: Vec<Walked> = devices.iter().flat_map(of_device).collect();
            scan.record(&mut trial, &walks)?;
            for walked in &walks {
                let (run, is_new) = scan.run(&mut trial, walked, arguments.keep_recordings)?;
                made += usize::from(is_new);
                runs.push(run);
                if is_new {
                    let each_s = began.elapsed().as_secs_f64() / made as f64;
                    context.note(&format!(
                        "{} of {total} runs, about {:.0} min left",
                        runs.len(),
                        each_s * (total - runs.len()) as f64 / 60.0
                    ));
                }
            }
            if !arguments.keep_recordings {
                // Large, and its map is there.
                standing::remove(&scan.session.folder.join("scan.mcap"))?;
            }
        }
    }
    finish(&arguments.out, &runs, context)
}

/// Takes an empty folder, or one of a trial.
fn take_folder(out: &Path, context: &Context) -> anyhow::Result<()> {
    context.will_write(out);
    let mark = out.join(MARK);
    let is_empty = std::fs::read_dir(out).map_or(true, |mut entries| entries.next().is_none());
    anyhow::ensure!(
        is_empty || mark.exists() || context.force(),
        "{}: has files that are not of a trial: choose another --out, or use it with --force",
        out.display()
    );
    std::fs::create_dir_all(out)?;
    crate::files::write(&mark, "Made by `lsfb bench twin`, which continues here.\n")
}

fn or_all<T: Copy>(chosen: &[T], all: &[T]) -> Vec<T> {
    match chosen {
        [] => all.to_vec(),
        chosen => chosen.to_vec(),
    }
}

/// Writes and prints the result.
fn finish(out: &Path, runs: &[Run], context: &Context) -> anyhow::Result<Outcome> {
    let judgement = result::judge(runs);
    let page = out.join(PAGE);
    let title = "The standard trial in the twin";
    crate::files::write(&page, page::html(runs, &judgement, title))?;
    let printed = Printed { runs, page: &page };
    let judged = Judged::new(&judgement, &format!("{} runs", runs.len()), &printed);
    crate::files::write(&out.join(RESULT), serde_json::to_vec_pretty(&judged)?)?;
    context.print(&judged, || {
        let text = format!(
            "{}\n\n{}\n{}See {}",
            judged.summary,
            result::table(runs),
            judged::problem_lines(&judgement),
            page.display()
        );
        judged::printable(&text)
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

/// How long calibration sessions take compared to the first: whose is refused records another, as an operator would.
const SESSION_LENGTHS: [f64; 3] = [1.0, 1.5, 2.5];

/// What all places share.
struct Trial<'a> {
    out: &'a Path,
    size: Size,
    given: Rigs,
    light: Light,
    context: &'a Context,
    /// Rigs that were calibrated, by seed and name, with what that took.
    rigs: BTreeMap<(u64, &'static str), Rig>,
}

/// A rig, or why there is none, and what it took to calibrate.
#[derive(Clone)]
struct Rig {
    found: Refusable<Calibrated>,
    cost: Option<Cost>,
}

impl Trial<'_> {
    /// The rig of the backpack, or of a device, as calibrated with a seed.
    fn rig(&mut self, seed: u64, device: Option<Device>) -> anyhow::Result<Rig> {
        let (name, bearer) = match device {
            None => ("backpack", Bearer::Backpack),
            Some(device) => (device.name(), Bearer::Walker),
        };
        if let Some(rig) = self.rigs.get(&(seed, name)) {
            return Ok(rig.clone());
        }
        let config = calibration(device.unwrap_or_default(), seed, self.size);
        let config = self.light.on(config);
        if self.given == Rigs::True {
            return Ok(Rig {
                found: Ok(true_rig(&config, bearer)),
                cost: None,
            });
        }
        let mut attempts = SESSION_LENGTHS.iter().enumerate().peekable();
        let rig = loop {
            let Some((number, longer)) = attempts.next() else {
                anyhow::bail!("no calibration session is planned");
            };
            let folder = match number {
                0 => format!("calibration-{name}-{seed}"),
                again => format!("calibration-{name}-{seed}-again-{again}"),
            };
            let folder = self.out.join(folder);
            std::fs::create_dir_all(&folder)?;
            let mut config = config.clone();
            config.scan.duration_s *= longer;
            config.glasses.duration_s *= longer;
            let mut costs = Costs::open(folder.join("costs.json"));
            let found = costs.of(name, |made| {
                calibrated(&folder, &config, bearer, || made.set(true), self.context)
            });
            let found = refusal(found, "calibration")?;
            if let (Err(why), true) = (&found, attempts.peek().is_some()) {
                self.context
                    .note(&format!("{name}: {why}; recorded again, for longer"));
                continue;
            }
            break Rig {
                found,
                cost: costs.get(name),
            };
        };
        self.rigs.insert((seed, name), rig.clone());
        Ok(rig)
    }
}

/// A place with a seed: scanned and mapped once, when the first walk needs it.
struct Scan<'a> {
    session: Session<'a>,
    costs: Costs,
    mapped: Option<Refusable<Mapped>>,
}

impl<'a> Scan<'a> {
    fn new(trial: &Trial<'a>, scanned: Scanned) -> Self {
        let folder = trial
            .out
            .join(format!("{}-{}", scanned.place.name(), scanned.seed));
        Self {
            costs: Costs::open(folder.join("costs.json")),
            session: Session {
                folder,
                scanned,
                light: trial.light.clone(),
                context: trial.context,
            },
            mapped: None,
        }
    }

    /// Records the scan and the walks that do not stand: those of one world after another, so that it is built once.
    fn record(&mut self, trial: &mut Trial, walks: &[Walked]) -> anyhow::Result<()> {
        let pending = walks.iter().filter(|w| self.standing(trial, w).is_none());
        let mut pending: Vec<&Walked> = pending.collect();
        if pending.is_empty() {
            return Ok(());
        }
        let seed = self.session.scanned.seed;
        let Ok(backpack) = trial.rig(seed, None)?.found else {
            return Ok(());
        };
        let mut last = None;
        self.session
            .record_scan(&backpack, &mut self.costs, &mut last)?;
        // The scan's world is that of the walks as scanned.
        pending.sort_by_key(|walked| walked.condition);
        for walked in pending {
            let Ok(device) = trial.rig(seed, Some(walked.device))?.found else {
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
    fn result(&self, trial: &Trial, walked: &Walked) -> (PathBuf, Provenance) {
        let made_from = Provenance::new(&Settings {
            walked: *walked,
            rigs: trial.given,
            scan: trial.light.on(walked.scanned.config()),
            walk: trial.light.on(walked.config()),
            mapping: MappingConfig::default(),
            ground_truth: GroundTruthConfig::default(),
        });
        let folder = self.session.walk_folder(walked);
        (folder.join("run.json"), made_from)
    }

    fn standing(&self, trial: &Trial, walked: &Walked) -> Option<Run> {
        let (path, made_from) = self.result(trial, walked);
        trial.context.standing(&[&path], &made_from)
    }

    /// One walk that is recorded, and whether it was made now; what stands is read.
    fn run(
        &mut self,
        trial: &mut Trial,
        walked: &Walked,
        keep: bool,
    ) -> anyhow::Result<(Run, bool)> {
        if let Some(run) = self.standing(trial, walked) {
            return Ok((run, false));
        }
        let (path, made_from) = self.result(trial, walked);
        let folder = self.session.walk_folder(walked);
        std::fs::create_dir_all(&folder)?;
        standing::forget(&[&path])?;
        let run = self.make(trial, walked, &folder)?;
        crate::files::write(&path, serde_json::to_vec_pretty(&run)?)?;
        standing::finish(&[&path], &[], &made_from, &run)?;
        if !keep {
            standing::remove(&folder.join("walk.mcap"))?;
        }
        Ok((run, true))
    }

    fn make(&mut self, trial: &mut Trial, walked: &Walked, folder: &Path) -> anyhow::Result<Run> {
        let seed = walked.scanned.seed;
        let rigs = [
            trial.rig(seed, None)?,
            trial.rig(seed, Some(walked.device))?,
        ];
        let mut costs = Costs::open(folder.join("costs.json"));
        let mut run = Run::of(walked, trial.given);
        match (&rigs[0].found, &rigs[1].found) {
            (Err(why), _) | (_, Err(why)) => run.refused = Some(why.clone()),
            (Ok(backpack), Ok(device)) => {
                run.rigs_off = [backpack.off.clone(), device.off.clone()].concat();
                if self.mapped.is_none() {
                    self.mapped = Some(self.session.map(&mut self.costs)?);
                }
                match &self.mapped {
                    Some(Ok(mapped)) => {
                        self.session.walk(walked, mapped, &mut costs, &mut run)?;
                    }
                    Some(Err(why)) => run.refused = Some(why.clone()),
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
                run.peak_rss_mb = run.peak_rss_mb.max(cost.peak_rss_mb);
            }
        }
        Ok(run)
    }
}
