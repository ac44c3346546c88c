//! CAN sockets: connections to the bus at `LSFB_FAKE_CAN`, with the kernel's filters (`linux/can/raw.h`).

use std::os::unix::ffi::OsStrExt;
use std::sync::atomic::{AtomicI32, Ordering};
use std::sync::{Mutex, PoisonError};

use libc::{c_int, c_uint};

use crate::fail;

const MAX_SOCKETS: usize = 8;
const ERROR_FLAG: u32 = 0x2000_0000;
/// What the kernel gives a real interface; nobody looks at it.
const INTERFACE_INDEX: c_uint = 7;

/// The program's CAN sockets, -1 where there is none.
static DESCRIPTORS: [AtomicI32; MAX_SOCKETS] = [const { AtomicI32::new(-1) }; MAX_SOCKETS];
static FILTERS: [Mutex<Filters>; MAX_SOCKETS] = [const { Mutex::new(Filters::NEW) }; MAX_SOCKETS];

struct Filters {
    /// Identifier and mask; a frame passes one of them. `None`: never set, everything passes.
    data: Option<Vec<(u32, u32)>>,
    errors: u32,
}

impl Filters {
    const NEW: Self = Self {
        data: None,
        errors: 0,
    };
}

fn place_of(fd: c_int) -> Option<usize> {
    let is_it = |known: &AtomicI32| known.load(Ordering::Acquire) == fd;
    (fd >= 0)
        .then(|| DESCRIPTORS.iter().position(is_it))
        .flatten()
}

/// Whether `fd` is a CAN socket.
pub fn is_can(fd: c_int) -> bool {
    place_of(fd).is_some()
}

/// Takes note of a new socket; its descriptor.
pub fn opened(fd: c_int) -> c_int {
    let free = |known: &AtomicI32| known.load(Ordering::Acquire) < 0;
    if fd < 0 {
        return fd;
    }
    let Some(place) = DESCRIPTORS.iter().position(free) else {
        return fail(libc::EMFILE);
    };
    *FILTERS[place]
        .lock()
        .unwrap_or_else(PoisonError::into_inner) = Filters::NEW;
    DESCRIPTORS[place].store(fd, Ordering::Release);
    fd
}

/// Forgets a socket.
pub fn close(fd: c_int) {
    if let Some(place) = place_of(fd) {
        DESCRIPTORS[place].store(-1, Ordering::Release);
    }
}

/// The index of an interface of the bus.
pub fn interface_index(name: &[u8]) -> Option<c_uint> {
    let is_here = name.starts_with(b"vcan") && std::env::var_os("LSFB_FAKE_CAN").is_some();
    is_here.then_some(INTERFACE_INDEX)
}

/// Connects a socket to the bus.
pub fn connect(fd: c_int) -> c_int {
    let Some(path) = std::env::var_os("LSFB_FAKE_CAN") else {
        return fail(libc::ENODEV);
    };
    let mut address = libc::sockaddr_un {
        sun_family: libc::AF_UNIX as libc::sa_family_t,
        sun_path: [0; 108],
    };
    let path = path.as_bytes();
    if path.len() >= address.sun_path.len() {
        return fail(libc::ENAMETOOLONG);
    }
    for (to, from) in address.sun_path.iter_mut().zip(path) {
        *to = from.cast_signed();
    }
    let len = size_of::<libc::sockaddr_un>() as libc::socklen_t;
    // SAFETY: the address is a local variable of that length.
    unsafe { libc::connect(fd, (&raw const address).cast(), len) }
}

/// Sets an option of the level `SOL_CAN_RAW`.
pub fn set_option(fd: c_int, name: c_int, value: &[u8]) -> c_int {
    let Some(place) = place_of(fd) else {
        return fail(libc::EBADF);
    };
    let mut filters = FILTERS[place]
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    let word = |bytes: &[u8]| bytes.first_chunk().map(|&word| u32::from_le_bytes(word));
    match name {
        libc::CAN_RAW_FILTER => {
            let pairs = value.chunks_exact(8).filter_map(|pair| {
                let (id, mask) = pair.split_at(4);
                word(id).zip(word(mask))
            });
            filters.data = Some(pairs.collect());
        }
        libc::CAN_RAW_ERR_FILTER => filters.errors = word(value).unwrap_or_default(),
        libc::CAN_RAW_LOOPBACK | libc::CAN_RAW_RECV_OWN_MSGS | libc::CAN_RAW_JOIN_FILTERS => {}
        _ => return fail(libc::ENOPROTOOPT),
    }
    0
}

/// Whether a frame passes the socket's filters.
pub fn passes(fd: c_int, frame: &[u8]) -> bool {
    let (Some(place), Some(&id)) = (place_of(fd), frame.first_chunk()) else {
        return true;
    };
    let id = u32::from_le_bytes(id);
    let filters = FILTERS[place]
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    if id & ERROR_FLAG != 0 {
        return id & filters.errors != 0;
    }
    let passes = |&(wanted, mask): &(u32, u32)| id & mask == wanted & mask;
    filters
        .data
        .as_ref()
        .is_none_or(|data| data.iter().any(passes))
}
