//! Which disk is full: "no space left" says neither.

use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use nix::sys::statvfs::statvfs;

/// Free bytes below which a file system counts as full: a block or two.
const FULL_BYTES: u64 = 64 * 1024;

/// The sentence to add to an error: the first of the places that lies on a full disk, where the error is about one.
pub fn named(error: &anyhow::Error, places: &[PathBuf]) -> Option<String> {
    let of_space = |kind| matches!(kind, ErrorKind::StorageFull | ErrorKind::QuotaExceeded);
    let about_space = error.chain().any(|cause| {
        let kind = cause
            .downcast_ref::<std::io::Error>()
            .map(std::io::Error::kind);
        // Errors of other programs' libraries keep the words alone.
        kind.is_some_and(of_space) || cause.to_string().contains("No space left on device")
    });
    if !about_space {
        return None;
    }
    // Stdout may be a file.
    let stdout = std::fs::read_link("/proc/self/fd/1").ok();
    let full = places
        .iter()
        .chain(&stdout)
        .find_map(|place| full_disk_of(place));
    Some(match full {
        Some(mount) => format!(
            "the disk mounted at {} is full: free disk space, or write elsewhere",
            mount.display()
        ),
        None => "the disk is full: free disk space, or write elsewhere".to_owned(),
    })
}

/// Where the file system of a path is mounted, if it is full.
fn full_disk_of(path: &Path) -> Option<PathBuf> {
    let there = existing(path)?;
    let stat = statvfs(&there).ok()?;
    let free_bytes = stat.blocks_available().saturating_mul(stat.fragment_size());
    (free_bytes < FULL_BYTES).then(|| mount_of(&there))
}

/// The path itself, or the nearest folder above it that exists.
fn existing(path: &Path) -> Option<PathBuf> {
    let absolute = std::path::absolute(path).ok()?;
    let found = absolute.ancestors().find(|p| p.exists())?;
    found.canonicalize().ok()
}

/// The topmost folder on the same file system.
fn mount_of(path: &Path) -> PathBuf {
    let device = |p: &Path| p.metadata().map(|m| m.dev()).ok();
    let here = device(path);
    let same = path.ancestors().take_while(|p| device(p) == here);
    same.last().unwrap_or(path).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_about_space_and_no_others_are_explained() {
        let full = std::io::Error::from(ErrorKind::StorageFull);
        let full = anyhow::Error::from(full).context("scan.tum");
        let sentence = named(&full, &[]).expect("a sentence");
        assert!(sentence.contains("disk is full"), "{sentence}");
        assert!(named(&anyhow::anyhow!("something else"), &[]).is_none());
    }

    #[test]
    fn a_path_that_is_not_there_yet_lies_where_its_folder_does() {
        let root = Path::new("/proc/self");
        assert_eq!(
            mount_of(&existing(&root.join("no/such")).expect("proc")),
            Path::new("/proc")
        );
    }
}
