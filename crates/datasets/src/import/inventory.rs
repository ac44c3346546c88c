//! Files of a source of which nothing was made: they are listed, so that nobody believes them to be in the recording.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::collected::Collected;
use super::payload::{Payload, Pixels};
use crate::Error;

/// Most files that are looked at: a folder with more holds something else than a walk.
const MOST_FILES: usize = 2_000_000;

/// Lists what was not used, by folder and ending.
pub(super) fn list_unused(source: &Path, collected: &mut Collected) -> Result<(), Error> {
    let mut used = collected.used.clone();
    used.extend(collected.videos.iter().cloned());
    for record in collected.streams.iter().flat_map(|s| &s.records) {
        match &record.payload {
            Payload::Image(image) => {
                if let Pixels::File(path) = &image.pixels {
                    used.insert(path.clone());
                }
            }
            Payload::Cloud(path) => {
                used.insert(path.clone());
            }
            _ => {}
        }
    }
    let mut files = Vec::new();
    files_below(source, &mut files)?;
    let mut unused: BTreeMap<String, u64> = BTreeMap::new();
    for file in files.iter().filter(|f| !used.contains(*f)) {
        *unused.entry(kind_of(source, file)).or_default() += 1;
    }
    for (what, count) in unused {
        collected.leave_out(what, count, "not used");
    }
    Ok(())
}

/// `folder/*.ending` of a file below `source`, or its name where it is the only one.
fn kind_of(source: &Path, file: &Path) -> String {
    let below = file.strip_prefix(source).unwrap_or(file);
    match (below.parent(), below.extension()) {
        (Some(folder), Some(ending)) if !folder.as_os_str().is_empty() => {
            format!("{}/*.{}", folder.display(), ending.to_string_lossy())
        }
        _ => below.display().to_string(),
    }
}

/// All files below a folder; links are not followed, as they may lead around in a circle.
fn files_below(folder: &Path, files: &mut Vec<PathBuf>) -> Result<(), Error> {
    if !folder.is_dir() {
        return Ok(());
    }
    let mut waiting = vec![folder.to_owned()];
    while let Some(folder) = waiting.pop() {
        let entries = std::fs::read_dir(&folder).map_err(|e| super::io(&folder, e))?;
        for entry in entries {
            let entry = entry.map_err(|e| super::io(&folder, e))?;
            let kind = entry.file_type().map_err(|e| super::io(&folder, e))?;
            match kind.is_dir() {
                true => waiting.push(entry.path()),
                false => files.push(entry.path()),
            }
        }
        if files.len() > MOST_FILES {
            return Err(Error::Recorded {
                path: folder,
                problem: format!("more than {MOST_FILES} files: give the folder of one recording"),
            });
        }
    }
    Ok(())
}
