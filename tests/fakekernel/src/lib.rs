//! Devices below an unmodified program, for kernels that have none: cameras, a CAN bus, a USB device.
//!
//! Loaded by `LD_PRELOAD`, it stands between the program and the C library, and answers what the kernel would:
//!
//! | variable | what it makes |
//! | --- | --- |
//! | `LSFB_FAKE_CAMERAS` | V4L2 capture nodes: lines of a path, a tab, and the path of a script (`camera_script.rs`) |
//! | `LSFB_FAKE_USB` | a usbfs node: its path, a tab, and the path of a script (`usb.rs`) |
//! | `LSFB_FAKE_CAN` | CAN interfaces `vcan…`: the socket (SEQPACKET) of a bus that sends and takes frames; behind a frame it may send a u32, how many frames were dropped so far |
//!
//! Opening a camera's path gives a memory file, whose `ioctl`s and `poll`s are answered by `camera.rs`; mapped buffers are
//! mapped for real. A CAN socket is a connection to the bus, below which filters are applied as the kernel does. Everything else
//! passes through.
#![allow(
    unsafe_code,
    reason = "it replaces functions of the C library, which are unsafe by nature"
)]

mod camera;
mod camera_script;
mod can;
mod nodes;
mod usb;

use std::ffi::CStr;
use std::fs::File;
use std::io;
use std::os::fd::FromRawFd;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use std::{mem, slice, thread};

use libc::{
    c_char, c_int, c_long, c_uint, c_ulong, c_void, mode_t, msghdr, nfds_t, pollfd, sockaddr,
    socklen_t, ssize_t,
};

use camera::{Errno, Ready};

const UVCIOC_CTRL_QUERY: u64 = 0xC010_7521;

pub(crate) fn fail(errno: Errno) -> c_int {
    // SAFETY: the C library's error variable of this thread.
    unsafe { *libc::__errno_location() = errno };
    -1
}

/// A new memory file.
pub(crate) fn memory_file() -> io::Result<File> {
    // SAFETY: the name is a C string.
    let fd = unsafe { libc::memfd_create(c"lsfb-fakekernel".as_ptr(), libc::MFD_CLOEXEC) };
    if fd < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the descriptor is new and nobody else's.
    Ok(unsafe { File::from_raw_fd(fd) })
}

/// `CLOCK_MONOTONIC`.
pub(crate) fn monotonic() -> Duration {
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
type Socket = unsafe extern "C" fn(c_int, c_int, c_int) -> c_int;
type Bind = unsafe extern "C" fn(c_int, *const sockaddr, socklen_t) -> c_int;
type Setsockopt = unsafe extern "C" fn(c_int, c_int, c_int, *const c_void, socklen_t) -> c_int;
type Recvmsg = unsafe extern "C" fn(c_int, *mut msghdr, c_int) -> ssize_t;
type Opendir = unsafe extern "C" fn(*const c_char) -> *mut libc::DIR;
type IfNametoindex = unsafe extern "C" fn(*const c_char) -> c_uint;

/// The descriptor of the device at `path`, if there is one.
///
/// # Safety
/// `path` is a C string.
unsafe fn open_node(path: *const c_char) -> Option<c_int> {
    // SAFETY: the caller's promise.
    let path = unsafe { CStr::from_ptr(path) }.to_bytes();
    nodes::open(path).or_else(|| usb::open(path))
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
    nodes::close(fd);
    can::close(fd);
    usb::close(fd);
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
        Some(entry) if count == 1 && nodes::is_node(entry.fd) => {
            let ready = nodes::with(entry.fd, |unit| unit.ready());
            let (revents, wait) = match ready {
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
        Some(_) => {
            // SAFETY: the caller gives `count` entries.
            let entries = unsafe { slice::from_raw_parts_mut(fds, count as usize) };
            match entries.iter().position(|entry| usb::is_usb(entry.fd)) {
                Some(at) => poll_usb(entries, at, timeout_ms),
                None => real_poll(entries, timeout_ms),
            }
        }
        None => real_poll(&mut [], timeout_ms),
    }
}

fn real_poll(entries: &mut [pollfd], timeout_ms: c_int) -> c_int {
    let real = real!(c"poll", Poll);
    // SAFETY: pointer and length of a slice.
    unsafe { real(entries.as_mut_ptr(), entries.len() as nfds_t, timeout_ms) }
}

/// Waits for the USB device, the entry `at`, and for the others, which are real.
fn poll_usb(entries: &mut [pollfd], at: usize, timeout_ms: c_int) -> c_int {
    let begin = monotonic();
    let limit = u64::try_from(timeout_ms).ok().map(Duration::from_millis);
    let usb_fd = entries[at].fd;
    loop {
        let (revents, wait) = match usb::ready() {
            usb::Ready::Now => (libc::POLLOUT, Some(Duration::ZERO)),
            usb::Ready::Gone => (libc::POLLERR, Some(Duration::ZERO)),
            usb::Ready::After(wait) => (0, Some(wait)),
            usb::Ready::Never => (0, None),
        };
        let left = limit.map(|limit| limit.saturating_sub(monotonic() - begin));
        let wait = match (wait, left) {
            (Some(wait), Some(left)) => Some(wait.min(left)),
            (wait, left) => wait.or(left),
        };
        // Rounded up: a wait that ends early would come back for nothing.
        let wait_ms = wait.map_or(-1, |wait| wait.as_micros().div_ceil(1000) as c_int);
        // A negative descriptor is passed over.
        entries[at].fd = -1;
        let others = real_poll(entries, wait_ms);
        entries[at].fd = usb_fd;
        entries[at].revents = revents;
        if others < 0 {
            return others;
        }
        if others > 0 || revents != 0 || left == Some(Duration::ZERO) {
            return others + c_int::from(revents != 0);
        }
    }
}

/// # Safety
/// As the C library's `ioctl`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ioctl(fd: c_int, request: c_ulong, argument: *mut c_void) -> c_int {
    if nodes::is_node(fd) {
        // SAFETY: the caller's arguments.
        unsafe { ioctl_node(fd, request, argument) }
    } else if usb::is_usb(fd) {
        // SAFETY: the caller's arguments.
        unsafe { usb::ioctl(request, argument) }
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
    if number == libc::SYS_ioctl && nodes::is_node(a as c_int) {
        // SAFETY: the arguments of the `ioctl` that this is.
        return unsafe { ioctl_node(a as c_int, b as c_ulong, c as *mut c_void) }.into();
    }
    let real = real!(c"syscall", Syscall);
    // SAFETY: the caller's arguments, passed on.
    unsafe { real(number, a, b, c, d, e, f) }
}

/// # Safety
/// `argument` is what `request` asks for: the number of a request says how many bytes it points to.
unsafe fn ioctl_node(fd: c_int, request: c_ulong, argument: *mut c_void) -> c_int {
    let len = (request >> 16) as usize & 0x3FFF;
    // SAFETY: the caller's promise.
    let bytes = unsafe { slice::from_raw_parts_mut(argument.cast::<u8>(), len) };
    let outcome = nodes::with(fd, |unit| {
        if request != UVCIOC_CTRL_QUERY {
            return unit.request(request, bytes);
        }
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
            return Err(libc::EINVAL);
        };
        let pointer = <[u8; 8]>::try_from(pointer).map_err(|_| libc::EINVAL)?;
        let len = u16::from_le_bytes([*len_low, *len_high]);
        // SAFETY: the request says so, see `linux/uvcvideo.h`.
        let data = unsafe {
            slice::from_raw_parts_mut(usize::from_le_bytes(pointer) as *mut u8, len.into())
        };
        unit.query_extension_unit(*id, *selector, *query, data)
    });
    match outcome {
        Some(Ok(())) => 0,
        Some(Err(errno)) => fail(errno),
        None => fail(libc::ENODEV),
    }
}

/// # Safety
/// As the C library's `socket`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn socket(domain: c_int, kind: c_int, protocol: c_int) -> c_int {
    let real = real!(c"socket", Socket);
    if domain != libc::AF_CAN {
        // SAFETY: the caller's arguments, passed on.
        return unsafe { real(domain, kind, protocol) };
    }
    let flags = kind & (libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK);
    // SAFETY: only numbers are passed.
    let fd = unsafe { real(libc::AF_UNIX, libc::SOCK_SEQPACKET | flags, 0) };
    can::opened(fd)
}

/// # Safety
/// As the C library's `bind`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bind(fd: c_int, address: *const sockaddr, len: socklen_t) -> c_int {
    if can::is_can(fd) {
        return can::connect(fd);
    }
    let real = real!(c"bind", Bind);
    // SAFETY: the caller's arguments, passed on.
    unsafe { real(fd, address, len) }
}

/// # Safety
/// As the C library's `setsockopt`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn setsockopt(
    fd: c_int,
    level: c_int,
    name: c_int,
    value: *const c_void,
    len: socklen_t,
) -> c_int {
    if level == libc::SOL_CAN_RAW && can::is_can(fd) {
        // SAFETY: the caller gives `len` bytes.
        let bytes = unsafe { slice::from_raw_parts(value.cast::<u8>(), len as usize) };
        return can::set_option(fd, name, bytes);
    }
    let real = real!(c"setsockopt", Setsockopt);
    // SAFETY: the caller's arguments, passed on.
    unsafe { real(fd, level, name, value, len) }
}

/// # Safety
/// As the C library's `recvmsg`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn recvmsg(fd: c_int, message: *mut msghdr, flags: c_int) -> ssize_t {
    let real = real!(c"recvmsg", Recvmsg);
    if !can::is_can(fd) {
        // SAFETY: the caller's arguments, passed on.
        return unsafe { real(fd, message, flags) };
    }
    // SAFETY: the caller gives a message with at least one buffer, whose lengths are set anew before each try.
    unsafe {
        let (control_len, buffers, count) = (
            (*message).msg_controllen,
            (*message).msg_iov,
            (*message).msg_iovlen,
        );
        if count == 0 {
            return real(fd, message, flags);
        }
        // Behind a frame the bus may say how many were dropped so far.
        let mut drops = [0_u8; 4];
        let mut both = [
            *buffers,
            libc::iovec {
                iov_base: drops.as_mut_ptr().cast(),
                iov_len: drops.len(),
            },
        ];
        loop {
            (*message).msg_controllen = control_len;
            (*message).msg_iov = both.as_mut_ptr();
            (*message).msg_iovlen = both.len();
            let len = real(fd, message, flags);
            (*message).msg_iov = buffers;
            (*message).msg_iovlen = count;
            if len < 0 {
                return len;
            }
            let taken = (len as usize).min((*buffers).iov_len);
            let frame = slice::from_raw_parts((*buffers).iov_base.cast::<u8>(), taken);
            if len == 0 || can::passes(fd, frame) {
                if len as usize == taken + drops.len() {
                    tell_drops(message, control_len, u32::from_le_bytes(drops));
                }
                return taken as ssize_t;
            }
        }
    }
}

/// Adds the control message with which the kernel tells what it has dropped (`SO_RXQ_OVFL`).
///
/// # Safety
/// `message` has been received into, and had `room` bytes for control messages.
unsafe fn tell_drops(message: *mut msghdr, room: usize, drops: u32) {
    // SAFETY: only numbers are computed.
    let (space, len) = unsafe { (libc::CMSG_SPACE(4), libc::CMSG_LEN(4)) };
    // SAFETY: the caller's promise.
    unsafe {
        let used = (*message).msg_controllen;
        if used + space as usize > room {
            return;
        }
        let header = (*message)
            .msg_control
            .cast::<u8>()
            .add(used)
            .cast::<libc::cmsghdr>();
        header.write(libc::cmsghdr {
            cmsg_len: len as usize,
            cmsg_level: libc::SOL_SOCKET,
            cmsg_type: libc::SO_RXQ_OVFL,
        });
        libc::CMSG_DATA(header).cast::<u32>().write_unaligned(drops);
        (*message).msg_controllen = used + space as usize;
    }
}

/// # Safety
/// As the C library's `if_nametoindex`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn if_nametoindex(name: *const c_char) -> c_uint {
    // SAFETY: the caller gives a C string.
    if let Some(index) = can::interface_index(unsafe { CStr::from_ptr(name) }.to_bytes()) {
        return index;
    }
    let real = real!(c"if_nametoindex", IfNametoindex);
    // SAFETY: the caller's argument, passed on.
    unsafe { real(name) }
}

/// libusb looks whether there is anything on the bus, whatever it is, before it takes a descriptor.
///
/// # Safety
/// As the C library's `opendir`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn opendir(path: *const c_char) -> *mut libc::DIR {
    let real = real!(c"opendir", Opendir);
    // SAFETY: the caller gives a C string.
    let path = match unsafe { CStr::from_ptr(path) } {
        bus if bus == c"/dev/bus/usb" && usb::is_present() => c"/dev",
        other => other,
    };
    // SAFETY: a C string, the caller's or ours.
    unsafe { real(path.as_ptr()) }
}
