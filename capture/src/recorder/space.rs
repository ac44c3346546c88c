//! Room on the disks.

use std::collections::BTreeSet;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::Error;

/// Bytes that whoever runs this may still write into the file system of `folder`.
pub(crate) fn free_bytes(folder: &Path) -> Result<u64, Error> {
    let folder = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    let found = nix::sys::statvfs::statvfs(folder).map_err(|cause| Error::Io {
        path: folder.to_owned(),
        cause: cause.into(),
    })?;
    // Widths differ between platforms.
    #[allow(clippy::useless_conversion, reason = "u32 on some platforms")]
    let free = u64::from(found.blocks_available()) * u64::from(found.fragment_size());
    Ok(free)
}

/// Bytes that may still be written into all of `folders`, above `reserve_bytes` on each disk. Folders on one disk count once;
/// a disk that cannot be asked counts as full.
pub(crate) fn free_bytes_of(folders: &[PathBuf], reserve_bytes: u64) -> u64 {
    let mut disks = BTreeSet::new();
    folders
        .iter()
        .filter(|folder| {
            let folder = if folder.as_os_str().is_empty() {
                Path::new(".")
            } else {
                folder
            };
            std::fs::metadata(folder).is_ok_and(|found| disks.insert(found.dev()))
        })
        .filter_map(|folder| free_bytes(folder).ok())
        .map(|free| free.saturating_sub(reserve_bytes))
        .sum()
}

/// Refuses to begin what will not fit: `needed_secs` at `bytes_per_sec` on all of `folders` together.
pub(crate) fn check(
    folders: &[PathBuf],
    bytes_per_sec: f64,
    needed_secs: f64,
) -> Result<(), Error> {
    let free = free_bytes_of(folders, 0);
    let secs = free as f64 / bytes_per_sec.max(1.0);
    if secs >= needed_secs {
        return Ok(());
    }
    Err(Error::NoSpace {
        path: folders.first().cloned().unwrap_or_default(),
        free_bytes: free,
        secs,
        bytes_per_sec,
        needed_secs,
    })
}
