//! Which descriptors are those of cameras.

use std::ffi::OsStr;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::Path;
use std::sync::atomic::{AtomicI32, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::camera::Unit;
use crate::fail;

const MAX_NODES: usize = 8;

/// The program's descriptors, -1 where there is none. Read before a lock is taken: the lock itself may call `syscall`.
static DESCRIPTORS: [AtomicI32; MAX_NODES] = [const { AtomicI32::new(-1) }; MAX_NODES];
static UNITS: [Mutex<Option<Unit>>; MAX_NODES] = [const { Mutex::new(None) }; MAX_NODES];

fn place_of(fd: i32) -> Option<usize> {
    let is_it = |known: &AtomicI32| known.load(Ordering::Acquire) == fd;
    (fd >= 0)
        .then(|| DESCRIPTORS.iter().position(is_it))
        .flatten()
}

/// Whether `fd` is that of a camera.
pub fn is_node(fd: i32) -> bool {
    place_of(fd).is_some()
}

/// Does something with the unit behind `fd`.
pub fn with<T>(fd: i32, work: impl FnOnce(&mut Unit) -> T) -> Option<T> {
    let unit = UNITS.get(place_of(fd)?)?;
    let mut unit = unit.lock().unwrap_or_else(PoisonError::into_inner);
    unit.as_mut().map(work)
}

/// Plugs the unit of `path` in; `None` where no camera is there.
pub fn open(path: &[u8]) -> Option<i32> {
    let cameras = std::env::var_os("LSFB_FAKE_CAMERAS")?.into_vec();
    let script = cameras
        .split(|&b| b == b'\n')
        .filter_map(|line| line.strip_prefix(path)?.strip_prefix(b"\t"))
        .next()?;
    let free = |known: &AtomicI32| known.load(Ordering::Acquire) < 0;
    let Some(place) = DESCRIPTORS.iter().position(free) else {
        return Some(fail(libc::EMFILE));
    };
    Some(match Unit::plug_in(Path::new(OsStr::from_bytes(script))) {
        Ok((unit, fd)) => {
            *UNITS[place].lock().unwrap_or_else(PoisonError::into_inner) = Some(unit);
            DESCRIPTORS[place].store(fd, Ordering::Release);
            fd
        }
        Err(cause) => fail(cause.raw_os_error().unwrap_or(libc::EINVAL)),
    })
}

/// Forgets the unit behind `fd`.
pub fn close(fd: i32) {
    if let Some(place) = place_of(fd) {
        DESCRIPTORS[place].store(-1, Ordering::Release);
        *UNITS[place].lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}
