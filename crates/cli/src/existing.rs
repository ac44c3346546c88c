//! The one rule for existing results: no command replaces one unless `--force` is given, and none replaces what it reads.
//!
//! A map is a result when it has its header: a folder without it is empty, or half a map. Lists of devices and sockets that
//! `lsfb sim` and `lsfb mock` make for a recorder are no results, and are made again.

use std::path::{Path, PathBuf};

use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::{Provenance, provenance_path};

use crate::files::{about, is_same};

/// Fails where a result is there and may not be replaced, and where it would take the place of what is `read`.
pub fn expect_free(result: &Path, read: &[&Path], force: bool) -> anyhow::Result<()> {
    anyhow::ensure!(
        !read.iter().any(|input| is_same(input, result)),
        "{}: would replace an input file: choose another name for the result",
        result.display()
    );
    anyhow::ensure!(
        force || !is_result(result),
        "{}: exists already: choose another name, or replace it with --force",
        result.display()
    );
    Ok(())
}

/// Fails where a folder that would be replaced as a whole has files that the command `made_by` is not known to have written: what is beside
/// its `result` says so.
pub fn expect_own_folder(folder: &Path, result: &Path, made_by: &str) -> anyhow::Result<()> {
    let beside = Provenance::beside(result);
    let is_own = beside.is_some_and(|made| made.config.get(made_by).is_some());
    anyhow::ensure!(
        is_own || expect_free_folder(folder, false).is_ok(),
        "{}: is not known to be written by `lsfb {made_by}`, so it is not replaced: remove it, or choose another name",
        folder.display()
    );
    Ok(())
}

/// Puts a folder that was written aside in its place. What is beside `result` is taken away first: it tells of what was there before.
pub fn replace_folder(aside: &Path, place: &Path, result: &Path) -> anyhow::Result<()> {
    let told = provenance_path(result);
    if told.exists() {
        about(&told, std::fs::remove_file(&told))?;
    }
    if place.is_dir() {
        about(place, std::fs::remove_dir_all(place))?;
    }
    about(place, std::fs::rename(aside, place))
}

/// Fails where one of the inputs lies in a folder that is replaced as a whole.
pub fn expect_outside(folder: &Path, read: &[&Path]) -> anyhow::Result<()> {
    let Ok(folder) = folder.canonicalize() else {
        return Ok(());
    };
    let inside = |path: &&&Path| {
        path.canonicalize()
            .is_ok_and(|path| path.starts_with(&folder))
    };
    match read.iter().find(inside) {
        Some(input) => anyhow::bail!(
            "{}: is in {}, which would be replaced: choose another folder",
            input.display(),
            folder.display()
        ),
        None => Ok(()),
    }
}

/// Fails where a folder that is a result as a whole has something in it and may not be replaced: what is left of another result would be
/// taken for a part of the new one.
pub fn expect_free_folder(folder: &Path, force: bool) -> anyhow::Result<()> {
    let is_empty = std::fs::read_dir(folder).map_or(true, |mut files| files.next().is_none());
    anyhow::ensure!(
        force || is_empty && !folder.is_file(),
        "{}: exists already: choose another name, or replace it with --force",
        folder.display()
    );
    Ok(())
}

/// Fails where a result has the name of another one of the same command, which it would take the place of. Devices and pipes may be named
/// twice.
pub fn expect_another(result: &Path, others: &[PathBuf]) -> anyhow::Result<()> {
    let place = |path: &Path| {
        let folder = path.parent().filter(|folder| *folder != Path::new(""));
        let folder = folder.unwrap_or(Path::new(".")).canonicalize();
        match (folder, path.file_name()) {
            (Ok(folder), Some(name)) => folder.join(name),
            _ => path.to_owned(),
        }
    };
    let is_kept = !result.exists() || result.is_file() || result.is_dir();
    let is_named = || {
        let here = place(result);
        others.iter().any(|other| place(other) == here)
    };
    anyhow::ensure!(
        !(is_kept && is_named()),
        "{}: two results would be written here: choose another name for one of them",
        result.display()
    );
    Ok(())
}

fn is_result(path: &Path) -> bool {
    match path.is_dir() {
        true => path.join(HdMap::HEADER).exists(),
        // Devices and pipes are written to, not replaced.
        false => path.is_file() || path.is_symlink() && !path.exists(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_results_have_one_name() {
        let folder = tempfile::tempdir().expect("folder");
        let [a, b] = ["a.csv", "b.csv"].map(|name| folder.path().join(name));
        let null = Path::new("/dev/null");
        let claimed = [a, null.to_owned()];
        for other in [&b, null] {
            expect_another(other, &claimed).expect("another");
        }
        let again = folder.path().join(".").join("a.csv");
        let refusal = expect_another(&again, &claimed).expect_err("one name");
        assert!(refusal.to_string().contains("two results"), "{refusal}");
    }

    /// A map's provenance made the folders beside it pass for images of `lsfb map depth`.
    #[test]
    fn what_another_command_made_is_not_replaced() {
        let folder = tempfile::tempdir().expect("folder");
        let result = folder.path().join("m");
        let depth = result.join("depth");
        std::fs::create_dir_all(&depth).expect("folder");
        expect_own_folder(&depth, &result, "map depth").expect("nothing in it");
        std::fs::write(depth.join("mine.png"), "mine").expect("file");
        for (config, is_own) in [("map", false), ("map depth", true)] {
            let made = Provenance::new(&serde_json::json!({ config: {} }));
            made.write(&result).expect("provenance");
            let found = expect_own_folder(&depth, &result, "map depth");
            assert_eq!(found.is_ok(), is_own, "{found:?}");
        }
        let aside = result.join("depth.part");
        std::fs::create_dir(&aside).expect("folder");
        replace_folder(&aside, &depth, &result).expect("replaced");
        assert!(!depth.join("mine.png").exists() && !provenance_path(&result).exists());
    }

    /// Images of other settings stood among new ones.
    #[test]
    fn folders_of_results_stay_unless_forced() {
        let folder = tempfile::tempdir().expect("folder");
        let depth = folder.path().join("depth");
        expect_free_folder(&depth, false).expect("nothing there");
        std::fs::create_dir(&depth).expect("folder");
        expect_free_folder(&depth, false).expect("nothing in it");
        std::fs::write(depth.join("1.png"), "yesterday").expect("file");
        let refusal = expect_free_folder(&depth, false).expect_err("taken");
        assert!(refusal.to_string().contains("--force"), "{refusal}");
        expect_free_folder(&depth, true).expect("forced");
    }

    #[test]
    fn files_and_whole_maps_stay_unless_forced() {
        let folder = tempfile::tempdir().expect("folder");
        let (file, map) = (folder.path().join("a.tum"), folder.path().join("map"));
        std::fs::create_dir(&map).expect("folder");
        for path in [&file, &map, Path::new("/dev/null")] {
            expect_free(path, &[], false).expect("free");
        }
        std::fs::write(&file, "yesterday").expect("file");
        std::fs::write(map.join(HdMap::HEADER), "yesterday").expect("file");
        for path in [&file, &map] {
            let refusal = expect_free(path, &[], false)
                .expect_err("taken")
                .to_string();
            assert!(refusal.contains("--force"), "{refusal}");
            expect_free(path, &[], true).expect("forced");
            let other_name = folder
                .path()
                .join(".")
                .join(path.file_name().expect("name"));
            let refusal = expect_free(path, &[&other_name], true).expect_err("read");
            assert!(refusal.to_string().contains("an input file"), "{refusal}");
        }
    }
}
