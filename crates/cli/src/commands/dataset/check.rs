//! `lsfb dataset check`: whether a dataset is as it was packed.

use std::path::PathBuf;

use lsfb_eval::dataset::{DatasetFolder, Description, Difference, SUMS, TRUTH, check_sums};
use lsfb_recording::sha256_of;
use lsfb_types::{Finding, Judgement, Verdict};
use serde::Serialize;

use crate::context::Context;
use crate::judged::{Judged, lines, printable};
use crate::outcome::Outcome;

/// Check a dataset against its hashes: files missing, changed or added since it was packed.
///
/// Truth that is held back is reported; truth that is present must be the one that dataset.toml names.
/// Compare the printed hash of SHA256SUMS with the published one: anyone who changes files can change
/// the list as well. Exit code 4: something differs.
///
/// Examples:
///   lsfb dataset check dataset
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The dataset.
    #[arg(value_name = "FOLDER")]
    dataset: PathBuf,
}

#[derive(Serialize)]
struct Checked {
    sums_sha256: String,
    differences: Vec<Difference>,
}

/// Hashes, compares, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let (folder, description) = super::open(&arguments.dataset)?;
    let show = |p| context.show(p);
    let mut differences = check_sums(folder.path(), Some(TRUTH), &show)?;
    let mut findings: Vec<Finding> = differences.iter().map(|d| different(d, "")).collect();
    findings.extend(absent(&folder, &description));
    if folder.truth().exists() {
        let in_truth = check_sums(&folder.truth(), None, &show)?;
        findings.extend(in_truth.iter().map(|d| different(d, "truth/")));
        differences.extend(in_truth);
        findings.push(of_the_truth(&folder, &description)?);
    } else {
        let what = "held back: not checked";
        findings.push(Finding::new("truth", Verdict::Unknown, TRUTH, what));
    }
    if findings.iter().all(|f| f.verdict != Verdict::Fail) {
        let what = "every file is unchanged";
        findings.push(Finding::new("files", Verdict::Pass, "files", what));
    }
    let checked = Checked {
        sums_sha256: sha256_of(&folder.path().join(SUMS))?,
        differences,
    };
    let judgement = Judgement::new(findings);
    let what = format!("{}, {} walks", description.title, description.queries.len());
    let judged = Judged::new(&judgement, &printable(&what), &checked);
    context.print(&judged, || {
        printable(&format!(
            "{}\n{}SHA256SUMS has the hash {}",
            judged.summary,
            lines(&judgement),
            checked.sums_sha256
        ))
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

fn different(difference: &Difference, folder: &str) -> Finding {
    let (name, what) = match difference {
        Difference::Missing(name) => (name, "is missing"),
        Difference::Changed(name) => (name, "was changed"),
        Difference::Added(name) => (name, "was added: no hash is known"),
    };
    Finding::new("file", Verdict::Fail, format!("{folder}{name}"), what)
}

/// What `dataset.toml` names and was never there: no list of hashes misses it.
fn absent(folder: &DatasetFolder, description: &Description) -> Vec<Finding> {
    let scans = description.maps.iter().map(|m| folder.scan(&m.environment));
    let walks = description.queries.iter().map(|q| folder.walk(&q.name));
    let rigs = description
        .queries
        .iter()
        .map(|q| folder.calibration_of(q.device));
    let mut wanted: Vec<PathBuf> = scans.chain(walks).chain(rigs).collect();
    if folder.truth().exists() {
        wanted.extend(
            description
                .queries
                .iter()
                .map(|q| folder.walk_truth(&q.name)),
        );
    }
    wanted.dedup();
    let missing = wanted.into_iter().filter(|path| !path.is_file());
    missing
        .map(|path| {
            let what = "is named in dataset.toml, but is missing";
            Finding::new("absent", Verdict::Fail, path.display().to_string(), what)
        })
        .collect()
}

fn of_the_truth(folder: &DatasetFolder, description: &Description) -> anyhow::Result<Finding> {
    let own = sha256_of(&folder.truth().join(SUMS))?;
    let is_same = own == description.truth_sums_sha256;
    let what = match is_same {
        true => "is the one named in dataset.toml",
        false => "differs from the one named in dataset.toml",
    };
    Ok(Finding::new(
        "truth",
        Verdict::Fail.unless(is_same),
        TRUTH,
        what,
    ))
}
