//! `lsfb dataset make`: the sequences of the plan, simulated and packed.

use std::path::{Path, PathBuf};

use lsfb_eval::dataset::{DatasetFolder, Description, Environment, MapEntry, TRUTH};
use serde::Serialize;

use super::contents::{Contents, Settings, Wish};
use super::readme::{LICENSE, README};
use super::seal::seal;
use crate::context::Context;
use crate::files::write;
use crate::outcome::Outcome;

/// Simulate the sequences of the plan, and pack them as a dataset.
///
/// The dataset has rigs, hashes, a licence, and the truth in a separate folder. Walks go beside the
/// scanner's path. Below 100 percent they take that share of their time and length, but at least
/// --min-secs; the scan takes as long as the longest walk of its environment, and at least four times
/// --min-secs. An interrupted run resumes; packed sequences are not made again. The folder
/// FOLDER.making holds what this needs: the seed, which reproduces the truth, and the key of the hashed
/// identifiers. Keep it private.
///
/// Examples:
///   lsfb dataset make --out dataset
///   lsfb dataset make --out small --scale-percent 10 --small-images --seed 417
///   lsfb dataset make --out corridor --sequence C3-android,C3-glasses --scale-percent 25
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder of the dataset.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Share of each sequence's time and length to simulate.
    #[arg(long, value_name = "PERCENT", default_value_t = 100.0, value_parser = percent)]
    scale_percent: f64,
    /// Shortest walk, unless the whole sequence is shorter.
    #[arg(long, value_name = "SECS", default_value_t = 10.0, value_parser = secs)]
    min_secs: f64,
    /// Images of three quarters of the size, scans with five images per second: a tenth of the work.
    #[arg(long)]
    small_images: bool,
    /// Sequences of `lsfb dataset plan`, separated by commas; by default all 75.
    #[arg(long = "sequence", value_name = "NAME", value_delimiter = ',')]
    sequences: Vec<String>,
    /// Seed of the buildings, the walks and the noise. Choose one that nobody can guess if the truth is
    /// held back.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = super::super::seed, allow_hyphen_values = true)]
    seed: u64,
    /// Licence of the dataset, a text file; by default a note on CC BY 4.0.
    #[arg(long, value_name = "FILE")]
    licence: Option<PathBuf>,
}

fn percent(text: &str) -> Result<f64, String> {
    let number: Option<f64> = text.parse().ok();
    let within = number.filter(|percent| (0.1..=500.0).contains(percent));
    within.ok_or_else(|| "expected a number from 0.1 to 500".to_owned())
}

fn secs(text: &str) -> Result<f64, String> {
    let number: Option<f64> = text.parse().ok();
    let within = number.filter(|secs| (5.0..=3600.0).contains(secs));
    within.ok_or_else(|| "expected a number from 5 to 3600".to_owned())
}

#[derive(Serialize)]
struct Made<'a> {
    dataset: &'a Path,
    walks: usize,
    sums_sha256: String,
}

/// Makes what does not stand, packs, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let plan = super::paper()?;
    let all = plan.sequences();
    let known = |name: &String| all.iter().any(|s| s.name == *name);
    if let Some(name) = arguments.sequences.iter().find(|name| !known(name)) {
        anyhow::bail!(
            "{name:?} is not a sequence: `lsfb dataset plan` lists motions; add the device, as in C3-android"
        );
    }
    let is_wanted =
        |name: &String| arguments.sequences.is_empty() || arguments.sequences.contains(name);
    let wanted: Vec<_> = all.iter().filter(|s| is_wanted(&s.name)).collect();
    let settings = Settings {
        seed: arguments.seed,
        scale_percent: arguments.scale_percent,
        min_secs: arguments.min_secs,
        small_images: arguments.small_images,
        sequences: wanted.iter().map(|s| s.name.clone()).collect(),
    };
    let making = take_folders(&arguments.out, &settings, context)?;
    let folder = DatasetFolder::new(&arguments.out);
    let contents = Contents {
        folder: &folder,
        making: &making,
        settings: &settings,
        plan: &plan,
        context,
    };
    let mut description = Description::new("LSFB, simulated", plan.rate_hz, settings.scale_percent);
    let is_used = |environment: &&Environment| {
        let mut used = wanted.iter();
        used.any(|s| s.motion.environment == environment.name)
    };
    description.environments = plan.environments.iter().filter(is_used).cloned().collect();
    let total = description.environments.len() + wanted.len();
    let mut done = 0;
    let mut note = |name: &str| {
        done += 1;
        context.note(&format!("{name}: {done} of {total}"));
    };
    let mut last = None;
    for environment in &description.environments {
        contents.pack(&Wish::scan(environment), &mut last)?;
        note(&environment.name);
        description.maps.push(MapEntry {
            environment: environment.name.clone(),
        });
    }
    for sequence in wanted {
        contents.pack(&Wish::walk(sequence), &mut last)?;
        note(&sequence.name);
        description.queries.push(contents.entry(sequence));
    }
    write(&folder.path().join("README.txt"), README)?;
    let licence = match &arguments.licence {
        Some(path) => crate::files::about(path, std::fs::read(path))?,
        None => LICENSE.as_bytes().to_vec(),
    };
    write(&folder.path().join("LICENSE.txt"), licence)?;
    let made = Made {
        dataset: &arguments.out,
        walks: description.queries.len(),
        sums_sha256: seal(&folder, description, context)?,
    };
    context.print(&made, || {
        format!(
            "{}: {} walks; SHA256SUMS has the hash {}",
            made.dataset.display(),
            made.walks,
            made.sums_sha256
        )
    })?;
    Ok(Outcome::Done)
}

/// Takes an empty folder, or one of the same dataset; gives the folder beside it, for what is being made.
fn take_folders(out: &Path, settings: &Settings, context: &Context) -> anyhow::Result<PathBuf> {
    context.will_write(out);
    let mut name = out.file_name().unwrap_or_default().to_os_string();
    name.push(".making");
    let making = out.with_file_name(name);
    let kept = making.join("settings.toml");
    let before: Option<Settings> = match std::fs::read_to_string(&kept) {
        Ok(text) => toml::from_str(&text).ok(),
        Err(_) => None,
    };
    let is_empty = std::fs::read_dir(out).map_or(true, |mut entries| entries.next().is_none());
    anyhow::ensure!(
        is_empty || before.as_ref() == Some(settings) || context.force(),
        "{}: has files that are not of this dataset, or were made with other settings: choose another --out, or use --force",
        out.display()
    );
    if !is_empty && before.as_ref() != Some(settings) {
        // What is left of another dataset would be hashed as a part of this one.
        for old in ["calibration", "map", "query", TRUTH].map(|name| out.join(name)) {
            if old.is_dir() {
                crate::files::about(&old, std::fs::remove_dir_all(&old))?;
            }
        }
    }
    for folder in [out, &making] {
        crate::files::about(folder, std::fs::create_dir_all(folder))?;
    }
    write(&kept, toml::to_string(settings)?)?;
    Ok(making)
}
