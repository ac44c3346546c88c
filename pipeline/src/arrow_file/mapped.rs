//! The one place that maps files into memory.
#![allow(unsafe_code, reason = "a memory map is unsafe by nature: see below")]

use std::fs::File;
use std::path::Path;

use bytes::Bytes;
use memmap2::Mmap;

use crate::Error;

/// The bytes of a file without reading them. They stay mapped as long as any part of them is in use.
pub(crate) fn map_file(path: &Path) -> Result<Bytes, Error> {
    let file = File::open(path).map_err(Error::io(path))?;
    if file.metadata().map_err(Error::io(path))?.len() == 0 {
        return Ok(Bytes::new());
    }
    // SAFETY: the map is read-only, and the files of a map are replaced by renaming, never changed in place, so that
    // the mapped bytes stay what they are while this process lives.
    let map = unsafe { Mmap::map(&file) }.map_err(Error::io(path))?;
    Ok(Bytes::from_owner(map))
}
