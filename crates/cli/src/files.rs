//! Files that commands read and write: errors name them and say what to do.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_recording::sha256_of;

/// Writes a file; an error names it.
pub fn write(path: &Path, contents: impl AsRef<[u8]>) -> anyhow::Result<()> {
    std::fs::write(path, contents).with_context(|| path.display().to_string())
}

/// Fails early, and with what to do, where nothing is at `path`.
pub fn expect_file(path: &Path, remedy: &str) -> anyhow::Result<()> {
    anyhow::ensure!(
        path.exists(),
        "{}: no such file or folder: check the path, or {remedy}",
        path.display()
    );
    Ok(())
}

/// The image files of a folder, by name; folders below it are none, whatever they are called.
pub fn image_files(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        let is_named_image = ["png", "jpg", "jpeg"].iter().any(|k| extension == *k);
        if is_named_image && !path.is_dir() {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// `NAME=PATH`.
pub fn named_path(text: &str) -> Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((name, path)) if !name.is_empty() && !path.is_empty() => {
            Ok((name.to_owned(), PathBuf::from(path)))
        }
        _ => Err("expected a name and a path: PEER=result".to_owned()),
    }
}

/// Fails before the work is done where its result could not be written: makes the folder around it and a trial file in it.
pub fn expect_writable(result: &Path) -> anyhow::Result<()> {
    let folder = match result.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let trial = folder.join(format!(".lsfb-{}", std::process::id()));
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&trial, b""))
        .and_then(|()| std::fs::remove_file(&trial))
        .with_context(|| {
            let result = result.display();
            format!("{result}: this folder is not writable: choose another one, or change its permissions")
        })
}

/// Whether both names lead to one file.
pub fn is_same(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

/// Whether two files have the same bytes.
pub fn is_copy(a: &Path, b: &Path) -> bool {
    let length = |path: &Path| std::fs::metadata(path).map(|known| known.len());
    let is_as_long = matches!((length(a), length(b)), (Ok(a), Ok(b)) if a == b);
    is_as_long && matches!((sha256_of(a), sha256_of(b)), (Ok(a), Ok(b)) if a == b)
}

/// A text file that stands beside a trajectory: `walk.tum` and `covariance` → `walk_covariance.txt`.
pub fn beside(trajectory: &Path, what: &str) -> PathBuf {
    let stem = trajectory.file_stem().unwrap_or_default().to_string_lossy();
    trajectory.with_file_name(format!("{stem}_{what}.txt"))
}

/// The name of a file without its folder, for pages beside it.
pub fn name_of(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// Names the file in an error that does not.
pub fn about<T, E: Into<anyhow::Error>>(path: &Path, result: Result<T, E>) -> anyhow::Result<T> {
    result.map_err(|error| {
        let error: anyhow::Error = error.into();
        let name = path.display().to_string();
        if error.to_string().contains(&name) {
            error
        } else {
            error.context(name)
        }
    })
}
