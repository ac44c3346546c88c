//! `lsfb bench twin`: the standard trial.

mod at_once;
mod cost;
mod in_view;
mod judging;
mod page;
mod result;
mod rigs;
mod scan;
mod session;
mod summary;
mod trial;

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use lsfb_recording::Provenance;
use lsfb_sim::{Device, Look, Place};
use serde::Serialize;

use crate::bad_argument::BadArgument;
use crate::commands::sim::device;
use crate::context::Context;
use crate::judged::{self, Judged};
use crate::outcome::Outcome;
use crate::pages;
use at_once::each_part;
use cost::{Cost, Costs};
use result::Run;
pub use result::WRONG_M;
use rigs::{Bearer, Calibrated, Rigs, calibrated, true_rig};
use scan::Scan;
use session::Refusable;
pub use session::refusal;
use summary::Group;
pub use trial::OTHER_FLOOR;
use trial::{Condition, Light, Scanned, Size, Walked, calibration};

/// Run the standard trial: scan, map, ground truth and evaluation in simulated places.
///
/// As in the paper's Tables IV and V. Walks go 0.5 to 6 m beside the scanner's path where there is
/// room, with the motions of Table VII, and every rig is calibrated with a simulated board. Exit code
/// 4: an exported pose is more than 10 cm off, or no place could be mapped. Finished parts are not run
/// again, and what is named twice is run once; recordings are removed once evaluated. Writes twin.json and
/// report.html.
///
/// Examples:
///   lsfb bench twin --out trial --quick
///   lsfb bench twin --out trial --place atrium,stairs --device glasses --seeds 3 --seed 11
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder for maps, trajectories and the report.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Environments of `lsfb sim --place`, separated by commas (--places is the same); by default all nine of
    /// the paper.
    #[arg(long = "place", visible_alias = "places", value_name = "NAME", value_parser = place, value_delimiter = ',')]
    places: Vec<Place>,
    /// Devices of the walks, separated by commas (--devices is the same; not a file of devices here); by
    /// default android, iphone and glasses.
    #[arg(long = "device", visible_alias = "devices", value_name = "NAME", value_parser = device, value_delimiter = ',')]
    devices: Vec<Device>,
    /// Changes between scan and walk, separated by commas: as-scanned; six-months, half of the movable
    /// objects moved; crowd, a dozen more people; other-floor, another floor that looks alike, where every
    /// pose is wrong; night, few lamps lit; fire-door, an open door closed (large-office, house-park, both
    /// corridors).
    #[arg(long = "condition", value_name = "NAME", value_parser = Condition::named, value_delimiter = ',', default_value = "as-scanned")]
    conditions: Vec<Condition>,
    /// Number of seeds.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// The first seed.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = super::super::seed, allow_hyphen_values = true)]
    seed: u64,
    /// Shorter walks and smaller images, for daily use; equally hard otherwise.
    #[arg(long)]
    quick: bool,
    /// Only check that everything runs, on seconds of scan and walk; the figures mean nothing.
    #[arg(long, conflicts_with = "quick")]
    try_out: bool,
    /// Use the exact rigs instead of calibrated ones: easier than any real trial.
    #[arg(long)]
    true_rigs: bool,
    /// Use simple light instead of path-traced lamps, sky and sun with shadows, gloss and overexposed
    /// windows (computed once per place and seed): easier than any real trial.
    #[arg(long)]
    simple_light: bool,
    /// Texture all surfaces with speckles, instead of individually painted surfaces, signs, books, screens
    /// and papers with text, and a view through the windows.
    #[arg(long)]
    plain_look: bool,
    /// Places to process at the same time; by default as many as cores and free memory allow. Results do
    /// not depend on it, but measured times do.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64))]
    at_once: Option<u16>,
    /// Keep all recordings: hundreds of megabytes per scan, tens of gigabytes without --quick.
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
    /// Walks through places as they were scanned, by the size of the place and the device.
    groups: &'a [Group],
    page: &'a Path,
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
            folder: (!arguments.simple_light).then(|| arguments.out.join("light")),
            look: match arguments.plain_look {
                true => Look::Plain,
                false => Look::Detailed,
            },
        },
        rigs: BTreeMap::new(),
    };
    let places = or_all(&arguments.places, &Place::ENVIRONMENTS);
    let devices = or_all(&arguments.devices, &Device::ALL);
    let all_conditions = each_once(&arguments.conditions);
    let conditions = |place: Place| {
        let all = all_conditions.iter();
        all.filter(move |condition| condition.is_possible_in(place))
    };
    let walks_of = |place: &Place| devices.len() * conditions(*place).count();
    for place in &places {
        for condition in &all_conditions {
            if !condition.is_possible_in(*place) {
                context.note(&format!(
                    "{}: it has no door that could be closed, and so no {} walks",
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
        BadArgument::new(format!(
            "no walk is left: none of the places has a door that could be closed; choose --place {}",
            doored.join(",")
        ))
    );
    let last = arguments.seed.saturating_add(arguments.seeds - 1);
    let seeds = arguments.seed..=last;
    let scans = seeds.clone().flat_map(|seed| {
        let size = trial.size;
        places
            .iter()
            .map(move |&place| Scanned { place, seed, size })
    });
    let scans: Vec<Scanned> = scans.collect();
    let asked = arguments.at_once.map(usize::from);
    let at_once = asked.unwrap_or_else(|| trial.size.at_once());
    trial.calibrate(seeds, &devices, at_once, context)?;
    let total = of_a_seed * arguments.seeds as usize;
    let (began, progress) = (Instant::now(), Mutex::new(Made::default()));
    let runs_of = |scanned: &Scanned, context: &Context| {
        let walked = |device: Device| {
            conditions(scanned.place).map(move |condition| Walked {
                scanned: *scanned,
                condition: *condition,
                device,
            })
        };
        let walks: Vec<Walked> = devices.iter().flat_map(|d| walked(*d)).collect();
        let mut scan = Scan::new(&trial, *scanned, context);
        scan.record(&walks)?;
        let mut runs = Vec::with_capacity(walks.len());
        for walked in &walks {
            let (run, is_new) = scan.run(walked, arguments.keep_recordings)?;
            runs.push(run);
            let said = progress.lock().map(|mut made| {
                made.count(is_new);
                made.left_of(total, began.elapsed())
            });
            if let (true, Ok(said)) = (is_new, said) {
                context.note(&said);
            }
        }
        if !arguments.keep_recordings {
            scan.forget_recording()?;
        }
        Ok(runs)
    };
    let name = |scanned: &Scanned| format!("{} {}", scanned.place.name(), scanned.seed);
    let runs = each_part(&scans, at_once, context, name, runs_of)?;
    let runs = runs.concat();
    finish(arguments, &runs, trial.size, context)
}

/// How far a trial is.
#[derive(Default)]
struct Made {
    /// Runs that were made now.
    new: usize,
    /// And those that stood.
    all: usize,
}

impl Made {
    fn count(&mut self, is_new: bool) {
        self.new += usize::from(is_new);
        self.all += 1;
    }

    fn left_of(&self, total: usize, elapsed: Duration) -> String {
        let each_min = elapsed.as_secs_f64() / 60.0 / self.new.max(1) as f64;
        let left_min = each_min * total.saturating_sub(self.all) as f64;
        format!("{} of {total} runs, about {left_min:.0} min left", self.all)
    }
}

/// Takes an empty folder, or one of a trial.
fn take_folder(out: &Path, context: &Context) -> anyhow::Result<()> {
    context.will_write(out);
    let mark = out.join(MARK);
    let is_empty = std::fs::read_dir(out).map_or(true, |mut entries| entries.next().is_none());
    anyhow::ensure!(
        is_empty || mark.exists() || context.force(),
        "{}: has files that do not belong to a trial: choose another --out, or use --force",
        out.display()
    );
    std::fs::create_dir_all(out)?;
    crate::files::write(&mark, "Made by `lsfb bench twin`, which resumes here.\n")
}

fn or_all<T: Copy + PartialEq>(chosen: &[T], all: &[T]) -> Vec<T> {
    match chosen {
        [] => all.to_vec(),
        chosen => each_once(chosen),
    }
}

/// In their order; what is named twice has one folder, in which no two threads may write.
fn each_once<T: Copy + PartialEq>(chosen: &[T]) -> Vec<T> {
    let mut once = Vec::with_capacity(chosen.len());
    for item in chosen {
        if !once.contains(item) {
            once.push(*item);
        }
    }
    once
}

/// The settings of a trial, as far as results depend on them: everything else it makes itself.
fn made_from(arguments: &Arguments) -> Provenance {
    let names = |all: &mut dyn Iterator<Item = &'static str>| all.collect::<Vec<_>>();
    let places = or_all(&arguments.places, &Place::ENVIRONMENTS);
    let devices = or_all(&arguments.devices, &Device::ALL);
    Provenance::new(&serde_json::json!({
        "places": names(&mut places.into_iter().map(Place::name)),
        "devices": names(&mut devices.into_iter().map(Device::name)),
        "conditions": names(&mut arguments.conditions.iter().map(|c| c.name())),
        "seed": arguments.seed,
        "seeds": arguments.seeds,
        "quick": arguments.quick,
        "try_out": arguments.try_out,
        "true_rigs": arguments.true_rigs,
        "simple_light": arguments.simple_light,
        "plain_look": arguments.plain_look,
    }))
}

/// Writes and prints the result.
fn finish(
    arguments: &Arguments,
    runs: &[Run],
    size: Size,
    context: &Context,
) -> anyhow::Result<Outcome> {
    let out = &arguments.out;
    let judgement = summary::judge(runs, size);
    let groups = &summary::groups(runs)[..];
    let page = out.join(PAGE);
    let title = "Standard trial in simulated places";
    let content = page::page(runs, groups, &judgement, title);
    pages::write(&page, content, &made_from(arguments))?;
    let printed = Printed {
        runs,
        groups,
        page: &page,
    };
    let judged = Judged::new(&judgement, &format!("{} runs", runs.len()), &printed);
    crate::files::write(&out.join(RESULT), serde_json::to_vec_pretty(&judged)?)?;
    context.print(&judged, || {
        let text = format!(
            "{}\n\n{}\n\n{}\n{}See {}",
            judged.summary,
            result::table(runs),
            summary::table(groups),
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
    /// Those of all seeds and bearers that walks need.
    rigs: BTreeMap<Borne, Rig>,
}

/// A seed, and who bears the rig: a device, or the backpack.
type Borne = (u64, Option<Device>);

/// A rig, or why there is none, and what it took to calibrate.
#[derive(Clone)]
struct Rig {
    found: Refusable<Calibrated>,
    cost: Option<Cost>,
}

impl Trial<'_> {
    /// Has the rigs of the backpack and of some devices with each seed, `at_once` of them calibrated at the same time.
    fn calibrate(
        &mut self,
        seeds: RangeInclusive<u64>,
        devices: &[Device],
        at_once: usize,
        context: &Context,
    ) -> anyhow::Result<()> {
        let bearers = |seed| {
            let devices = devices.iter().map(move |device| (seed, Some(*device)));
            std::iter::once((seed, None)).chain(devices)
        };
        let borne: Vec<Borne> = seeds.flat_map(bearers).collect();
        let name = |(seed, device): &Borne| format!("{} {seed}", bearer_name(*device));
        let rigs: Vec<Rig> = match self.given {
            Rigs::True => borne.iter().map(|borne| self.true_rig(*borne)).collect(),
            Rigs::Calibrated => each_part(&borne, at_once, context, name, |borne, context| {
                self.calibrated_rig(*borne, context)
            })?,
        };
        self.rigs = borne.into_iter().zip(rigs).collect();
        Ok(())
    }

    /// The rig of the backpack, or of a device, with a seed.
    fn rig(&self, seed: u64, device: Option<Device>) -> anyhow::Result<Rig> {
        let rig = self.rigs.get(&(seed, device)).cloned();
        rig.with_context(|| format!("{} was not calibrated", bearer_name(device)))
    }

    fn true_rig(&self, (seed, device): Borne) -> Rig {
        let config = calibration(device.unwrap_or_default(), seed, self.size);
        Rig {
            found: Ok(true_rig(&self.light.on(config), bearer(device))),
            cost: None,
        }
    }

    fn calibrated_rig(&self, (seed, device): Borne, context: &Context) -> anyhow::Result<Rig> {
        let name = bearer_name(device);
        let config = calibration(device.unwrap_or_default(), seed, self.size);
        let config = self.light.on(config);
        let mut attempts = SESSION_LENGTHS.iter().enumerate().peekable();
        loop {
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
                calibrated(&folder, &config, bearer(device), || made.set(true), context)
            });
            let found = refusal(found, "calibration")?;
            if let (Err(why), true) = (&found, attempts.peek().is_some()) {
                context.note(&format!("{name}: {why}; recorded again, for longer"));
                continue;
            }
            return Ok(Rig {
                found,
                cost: costs.get(name),
            });
        }
    }
}

const fn bearer(device: Option<Device>) -> Bearer {
    match device {
        None => Bearer::Backpack,
        Some(_) => Bearer::Walker,
    }
}

fn bearer_name(device: Option<Device>) -> &'static str {
    device.map_or("backpack", Device::name)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two of one name would write one folder at the same time.
    #[test]
    fn what_is_named_twice_is_run_once() {
        let (atrium, stairs) = (Place::Atrium, Place::Stairs);
        let all = [atrium];
        assert_eq!(
            or_all(&[stairs, atrium, stairs, stairs], &all),
            [stairs, atrium]
        );
        assert_eq!(or_all(&[], &all), [atrium]);
    }
}
