//! Room on the disks.

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

/// Refuses to begin what will not fit: `needed_secs` at `bytes_per_sec` on all of `folders` together.
pub(crate) fn check(
    folders: &[PathBuf],
    bytes_per_sec: f64,
    needed_secs: f64,
) -> Result<(), Error> {
    let mut free = 0;
    for folder in folders {
        free += free_bytes(folder)?;
    }
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
