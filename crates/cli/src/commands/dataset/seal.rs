//! `lsfb dataset seal`: a dataset's hashes.

use std::path::{Path, PathBuf};

use lsfb_eval::dataset::{DatasetFolder, Description, TRUTH, write_sums};
use serde::Serialize;

use crate::context::Context;
use crate::files::write;
use crate::outcome::Outcome;

/// Hash every file of a dataset that was assembled by hand, once its dataset.toml is written.
///
/// Writes truth/SHA256SUMS, its hash into dataset.toml, and SHA256SUMS of everything else; `sha256sum
/// --check` reads both. Publish the printed hash, so that anyone can verify that nothing was changed
/// since.
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
    let sealed = Sealed {
        dataset: &arguments.dataset,
        sums_sha256: seal(&folder, description, context)?,
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
