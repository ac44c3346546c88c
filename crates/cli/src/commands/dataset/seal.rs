//! `lsfb dataset seal`: a dataset's hashes.

use std::path::{Path, PathBuf};

use lsfb_eval::dataset::{DatasetFolder, Description, SUMS, TRUTH, check_sums, write_sums};
use lsfb_recording::sha256_of;
use serde::Serialize;

use crate::context::Context;
use crate::files::write;
use crate::outcome::Outcome;

/// Hash every file of a dataset that was assembled by hand, once its dataset.toml is written.
///
/// Writes truth/SHA256SUMS, its hash into dataset.toml, and SHA256SUMS of everything else; `sha256sum
/// --check` reads both. Publish the printed hash, so that anyone can verify that nothing was changed
/// since. A dataset that is sealed stays as it is; where files changed since, --force seals it anew.
///
/// Examples:
///   lsfb dataset seal dataset
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The dataset.
    #[arg(value_name = "FOLDER")]
    dataset: PathBuf,
}

#[derive(Serialize)]
struct Sealed<'a> {
    dataset: &'a Path,
    sums_sha256: String,
}

/// Hashes and prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let (folder, description) = super::open(&arguments.dataset)?;
    anyhow::ensure!(
        folder.truth().is_dir(),
        "{}: there is no truth, but dataset.toml needs its hash: put it there, and hold it back afterwards",
        folder.truth().display()
    );
    context.will_write(&arguments.dataset);
    let sums_sha256 = match standing(&folder, &description, context)? {
        Some(sums_sha256) => sums_sha256,
        None => seal(&folder, description, context)?,
    };
    let sealed = Sealed {
        dataset: &arguments.dataset,
        sums_sha256,
    };
    context.print(&sealed, || {
        format!(
            "{}: SHA256SUMS has the hash {}",
            sealed.dataset.display(),
            sealed.sums_sha256
        )
    })?;
    Ok(Outcome::Done)
}

/// The hash of a dataset that is sealed, as all its files are; `None` where it is to be sealed.
fn standing(
    folder: &DatasetFolder,
    description: &Description,
    context: &Context,
) -> anyhow::Result<Option<String>> {
    let [sums, truth_sums] = [folder.path(), &folder.truth()].map(|path| path.join(SUMS));
    // It is written last: without it a seal was begun at most.
    if context.force() || !sums.exists() {
        return Ok(None);
    }
    let show = |p| context.show(p);
    let is_own = truth_sums.exists()
        && description.truth_sums_sha256 == sha256_of(&truth_sums)?
        && check_sums(&folder.truth(), None, &show)?.is_empty()
        && check_sums(folder.path(), Some(TRUTH), &show)?.is_empty();
    anyhow::ensure!(
        is_own,
        "{}: is sealed, and files changed since (`lsfb dataset check` lists them): restore them, or seal it anew with --force",
        folder.path().display()
    );
    context.note(&format!("{}: sealed already", folder.path().display()));
    Ok(Some(sha256_of(&sums)?))
}

/// Writes `dataset.toml` with the hash of the truth, and all hashes; gives the hash of the list.
pub fn seal(
    folder: &DatasetFolder,
    description: Description,
    context: &Context,
) -> anyhow::Result<String> {
    let show = |p| context.show(p);
    let sealed = Description {
        truth_sums_sha256: write_sums(&folder.truth(), None, &show)?,
        ..description
    };
    let path = folder.description();
    write(&path, sealed.to_toml(&path)?)?;
    Ok(write_sums(folder.path(), Some(TRUTH), &show)?)
}
