//! A Mynt camera's V4L2 node below an unmodified program, for kernels without V4L2.
//!
//! Loaded by `LD_PRELOAD`, it stands between the program and the C library: opening the path named by
//! `LSFB_FAKEV4L_NODE` gives a memory file, whose `ioctl`s and `poll`s are answered by `unit.rs` from the script
//! named by `LSFB_FAKEV4L_SCRIPT` (layout in `script.rs`); mapped buffers are mapped for real. Everything else passes through.
//! One node at a time.
#![allow(
    unsafe_code,
    reason = "it replaces functions of the C library, which are unsafe by nature"
)]

mod script;
mod unit;

use std::ffi::{CStr, OsStr};
use std::fs::File;
use std::io;
use std::os::fd::FromRawFd;
use std::os::unix::ffi::OsStrExt;
use std::sync::atomic::{AtomicI32, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use std::{mem, slice, thread};

use libc::{c_char, c_int, c_long, c_ulong, c_void, mode_t, nfds_t, pollfd};

use unit::{Errno, Ready, Unit};

/// The program's descriptor of the node. Read before the lock is taken: the lock itself may call `syscall`.
static NODE_FD: AtomicI32 = AtomicI32::new(-1);
static UNIT: Mutex<Option<Unit>> = Mutex::new(None);

const UVCIOC_CTRL_QUERY: u64 = 0xC010_7521;

fn lock() -> MutexGuard<'static, Option<Unit>> {
    UNIT.lock().unwrap_or_else(PoisonError::into_inner)
}

fn is_node(fd: c_int) -> bool {
    fd >= 0 && fd == NODE_FD.load(Ordering::Acquire)
}

fn fail(errno: Errno) -> c_int {
    // SAFETY: the C library's error variable of this thread.
    unsafe { *libc::__errno_location() = errno };
    -1
}

/// A new memory file.
fn memory_file() -> io::Result<File> {
    // SAFETY: the name is a C string.
    let fd = unsafe { libc::memfd_create(c"lsfb-fakev4l".as_ptr(), libc::MFD_CLOEXEC) };
    if fd < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the descriptor is new and nobody else's.
    Ok(unsafe { File::from_raw_fd(fd) })
}

/// `CLOCK_MONOTONIC`.
fn monotonic() -> Duration {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: the pointer is that of a local variable.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) };
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

/// The C library's own function of that name and type.
macro_rules! real {
    ($name:literal, $function:ty) => {{
        static ADDRESS: AtomicUsize = AtomicUsize::new(0);
        let mut address = ADDRESS.load(Ordering::Relaxed);
        if address == 0 {
            // SAFETY: the name is a C string.
            address = unsafe { libc::dlsym(libc::RTLD_NEXT, $name.as_ptr()) } as usize;
            ADDRESS.store(address, Ordering::Relaxed);
        }
        // SAFETY: the C library has the function, with this type; variadic integers are passed like others on x86_64.
        unsafe { mem::transmute::<usize, $function>(address) }
    }};
}

type Open = unsafe extern "C" fn(*const c_char, c_int, mode_t) -> c_int;
type Ioctl = unsafe extern "C" fn(c_int, c_ulong, *mut c_void) -> c_int;
type Syscall =
    unsafe extern "C" fn(c_long, c_long, c_long, c_long, c_long, c_long, c_long) -> c_long;
type Poll = unsafe extern "C" fn(*mut pollfd, nfds_t, c_int) -> c_int;
type Close = unsafe extern "C" fn(c_int) -> c_int;

/// The node's descriptor, if `path` is its path.
///
/// # Safety
/// `path` is a C string.
unsafe fn open_node(path: *const c_char) -> Option<c_int> {
    // SAFETY: the caller's promise.
    let path = OsStr::from_bytes(unsafe { CStr::from_ptr(path) }.to_bytes());
    if std::env::var_os("LSFB_FAKEV4L_NODE")? != path {
        return None;
    }
    Some(match Unit::plug_in() {
        Ok((unit, fd)) => {
            *lock() = Some(unit);
            NODE_FD.store(fd, Ordering::Release);
            fd
        }
        Err(cause) => fail(cause.raw_os_error().unwrap_or(libc::EINVAL)),
    })
}

/// # Safety
/// As the C library's `open`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn open(path: *const c_char, flags: c_int, mode: mode_t) -> c_int {
    let real = real!(c"open", Open);
    // SAFETY: the caller's arguments, passed on.
    unsafe { open_node(path).unwrap_or_else(|| real(path, flags, mode)) }
}

/// # Safety
/// As the C library's `open64`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn open64(path: *const c_char, flags: c_int, mode: mode_t) -> c_int {
    let real = real!(c"open64", Open);
    // SAFETY: the caller's arguments, passed on.
    unsafe { open_node(path).unwrap_or_else(|| real(path, flags, mode)) }
}

/// # Safety
/// As the C library's `close`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn close(fd: c_int) -> c_int {
    if is_node(fd) {
        NODE_FD.store(-1, Ordering::Release);
        *lock() = None;
    }
    let real = real!(c"close", Close);
    // SAFETY: the caller's argument, passed on.
    unsafe { real(fd) }
}

/// # Safety
/// As the C library's `poll`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poll(fds: *mut pollfd, count: nfds_t, timeout_ms: c_int) -> c_int {
    // SAFETY: the caller gives `count` entries, here one.
    match unsafe { fds.as_mut() } {
        Some(entry) if count == 1 && is_node(entry.fd) => {
            let (revents, wait) = match lock().as_ref().map(Unit::ready) {
                Some(Ready::After(wait)) => (libc::POLLIN, Some(wait)),
                Some(Ready::Never) => (0, None),
                Some(Ready::Failed) | None => (libc::POLLERR | libc::POLLHUP, Some(Duration::ZERO)),
            };
            let limit = u64::try_from(timeout_ms).ok().map(Duration::from_millis);
            let (wait, ready) = match (wait, limit) {
                (Some(wait), Some(limit)) => (wait.min(limit), wait <= limit),
                (Some(wait), None) => (wait, true),
                (None, Some(limit)) => (limit, false),
                // Nobody may wait for ever for a unit that has stalled.
                (None, None) => return fail(libc::EDEADLK),
            };
            thread::sleep(wait);
            entry.revents = if ready { revents } else { 0 };
            c_int::from(ready)
        }
        _ => {
            let real = real!(c"poll", Poll);
            // SAFETY: the caller's arguments, passed on.
            unsafe { real(fds, count, timeout_ms) }
        }
    }
}

/// # Safety
/// As the C library's `ioctl`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ioctl(fd: c_int, request: c_ulong, argument: *mut c_void) -> c_int {
    if is_node(fd) {
        // SAFETY: the caller's arguments.
        unsafe { ioctl_node(request, argument) }
    } else {
        let real = real!(c"ioctl", Ioctl);
        // SAFETY: the caller's arguments, passed on.
        unsafe { real(fd, request, argument) }
    }
}

/// The `v4l` crate makes its `ioctl`s this way.
///
/// # Safety
/// As the C library's `syscall`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn syscall(
    number: c_long,
    a: c_long,
    b: c_long,
    c: c_long,
    d: c_long,
    e: c_long,
    f: c_long,
) -> c_long {
    if number == libc::SYS_ioctl && is_node(a as c_int) {
        // SAFETY: the arguments of the `ioctl` that this is.
        return unsafe { ioctl_node(b as c_ulong, c as *mut c_void) }.into();
    }
    let real = real!(c"syscall", Syscall);
    // SAFETY: the caller's arguments, passed on.
    unsafe { real(number, a, b, c, d, e, f) }
}

/// # Safety
/// `argument` is what `request` asks for: the number of a request says how many bytes it points to.
unsafe fn ioctl_node(request: c_ulong, argument: *mut c_void) -> c_int {
    let mut guard = lock();
    let Some(unit) = guard.as_mut() else {
        return fail(libc::ENODEV);
    };
    let len = (request >> 16) as usize & 0x3FFF;
    // SAFETY: the caller's promise.
    let bytes = unsafe { slice::from_raw_parts_mut(argument.cast::<u8>(), len) };
    let outcome = if request == UVCIOC_CTRL_QUERY {
        let [
            id,
            selector,
            query,
            _,
            len_low,
            len_high,
            _,
            _,
            pointer @ ..,
        ] = &*bytes
        else {
            return fail(libc::EINVAL);
        };
        let Ok(pointer) = <[u8; 8]>::try_from(pointer) else {
            return fail(libc::EINVAL);
        };
        let len = u16::from_le_bytes([*len_low, *len_high]);
        // SAFETY: the request says so, see `linux/uvcvideo.h`.
        let data = unsafe {
            slice::from_raw_parts_mut(usize::from_le_bytes(pointer) as *mut u8, len.into())
        };
        unit.query_extension_unit(*id, *selector, *query, data)
    } else {
        unit.request(request, bytes)
    };
    match outcome {
        Ok(()) => 0,
        Err(errno) => fail(errno),
    }
}
