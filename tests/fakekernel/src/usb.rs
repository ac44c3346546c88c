//! A USB device as usbfs has it (`linux/usbdevice_fs.h`, 64-bit): descriptors to read, transfers to submit and reap.
//!
//! The script: u32 length and bytes of the descriptors; then for each packet of the device's interrupt endpoint u32
//! microseconds since the first transfer, u32 length, bytes. A length of 0xFFFF_FFFF at the end unplugs it; without it, it
//! falls silent. Numbers are little-endian.

use std::collections::VecDeque;
use std::fs::File;
use std::io::Write;
use std::os::fd::IntoRawFd;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::Path;
use std::sync::atomic::{AtomicI32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use libc::c_int;

use crate::camera::Errno;
use crate::{fail, memory_file, monotonic};

const CONTROL: u64 = 0xC018_5500;
const SUBMIT: u64 = 0x8038_550A;
const DISCARD: u64 = 0x550B;
const REAP: u64 = 0x4008_550D;
const CLAIM: u64 = 0x8004_550F;
const RELEASE: u64 = 0x8004_5510;
const CONNECT_INFO: u64 = 0x4008_5511;
const DRIVER_IOCTL: u64 = 0xC010_5512;
const GET_SPEED: u64 = 0x551F;

const FULL_SPEED: c_int = 2;
const UNPLUG: u32 = u32::MAX;

/// `struct usbdevfs_urb`.
#[repr(C)]
struct Urb {
    kind: u8,
    endpoint: u8,
    status: c_int,
    flags: u32,
    buffer: *mut u8,
    buffer_length: c_int,
    actual_length: c_int,
    start_frame: c_int,
    packets: c_int,
    error_count: c_int,
    signal: u32,
    context: *mut libc::c_void,
}

/// The program's descriptor, -1 where there is none. Read before the lock is taken: the lock itself may call `syscall`.
static DESCRIPTOR: AtomicI32 = AtomicI32::new(-1);
static DEVICE: Mutex<Option<Device>> = Mutex::new(None);

struct Device {
    packets: VecDeque<(Duration, Vec<u8>)>,
    unplugs: bool,
    /// `CLOCK_MONOTONIC` at the first transfer.
    started: Option<Duration>,
    /// Addresses of transfers in flight, and of those to be reaped.
    submitted: VecDeque<usize>,
    finished: VecDeque<usize>,
}

/// What `poll` shall say.
pub enum Ready {
    Now,
    After(Duration),
    Never,
    Gone,
}

/// Whether `fd` is that of the device.
pub fn is_usb(fd: c_int) -> bool {
    fd >= 0 && DESCRIPTOR.load(Ordering::Acquire) == fd
}

fn lock() -> MutexGuard<'static, Option<Device>> {
    DEVICE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Whether there is a device.
pub fn is_present() -> bool {
    std::env::var_os("LSFB_FAKE_USB").is_some()
}

/// Opens the device, if `path` is its path.
pub fn open(path: &[u8]) -> Option<c_int> {
    let line = std::env::var_os("LSFB_FAKE_USB")?.into_vec();
    let script = line.strip_prefix(path)?.strip_prefix(b"\t")?;
    let script = std::ffi::OsStr::from_bytes(script);
    Some(match Device::plug_in(Path::new(script)) {
        Some((device, descriptors)) => {
            let fd = descriptors.into_raw_fd();
            *lock() = Some(device);
            DESCRIPTOR.store(fd, Ordering::Release);
            fd
        }
        None => fail(libc::EINVAL),
    })
}

/// Forgets the device behind `fd`.
pub fn close(fd: c_int) {
    if is_usb(fd) {
        DESCRIPTOR.store(-1, Ordering::Release);
        *lock() = None;
    }
}

/// What `poll` shall say about the device now.
pub fn ready() -> Ready {
    lock().as_ref().map_or(Ready::Gone, Device::ready)
}

/// Carries out `request`.
///
/// # Safety
/// `argument` is what the request asks for.
pub unsafe fn ioctl(request: u64, argument: *mut libc::c_void) -> c_int {
    let mut guard = lock();
    let Some(device) = guard.as_mut() else {
        return fail(libc::ENODEV);
    };
    // SAFETY: the caller's promise.
    match unsafe { device.ioctl(request, argument) } {
        Ok(result) => result,
        Err(errno) => fail(errno),
    }
}

impl Device {
    /// The device of a script, and a file with its descriptors.
    fn plug_in(path: &Path) -> Option<(Self, File)> {
        let script = std::fs::read(path).ok()?;
        let (len, rest) = script.split_first_chunk()?;
        let (descriptors, mut rest) = rest.split_at_checked(u32::from_le_bytes(*len) as usize)?;
        let mut file = memory_file().ok()?;
        file.write_all(descriptors).ok()?;
        let mut device = Self {
            packets: VecDeque::new(),
            unplugs: false,
            started: None,
            submitted: VecDeque::new(),
            finished: VecDeque::new(),
        };
        while let Some((at_us, tail)) = rest.split_first_chunk() {
            let (len, tail) = tail.split_first_chunk()?;
            if u32::from_le_bytes(*len) == UNPLUG {
                device.unplugs = true;
                break;
            }
            let (bytes, tail) = tail.split_at_checked(u32::from_le_bytes(*len) as usize)?;
            let due = Duration::from_micros(u32::from_le_bytes(*at_us).into());
            device.packets.push_back((due, bytes.to_vec()));
            rest = tail;
        }
        Some((device, file))
    }

    fn is_gone(&self) -> bool {
        self.unplugs && self.packets.is_empty()
    }

    fn ready(&self) -> Ready {
        if !self.finished.is_empty() {
            return Ready::Now;
        }
        if self.is_gone() {
            return Ready::Gone;
        }
        match (self.started, self.packets.front()) {
            (Some(started), Some((due, _))) if !self.submitted.is_empty() => {
                match (started + *due).saturating_sub(monotonic()) {
                    Duration::ZERO => Ready::Now,
                    wait => Ready::After(wait),
                }
            }
            _ => Ready::Never,
        }
    }

    /// # Safety
    /// `argument` is what `request` asks for.
    unsafe fn ioctl(&mut self, request: u64, argument: *mut libc::c_void) -> Result<c_int, Errno> {
        if self.is_gone() && self.finished.is_empty() {
            return Err(libc::ENODEV);
        }
        match request {
            CLAIM | RELEASE => Ok(0),
            GET_SPEED => Ok(FULL_SPEED),
            CONNECT_INFO => {
                // SAFETY: the request has eight bytes, the first four of which are the device's number.
                unsafe { argument.cast::<u32>().write_unaligned(5) };
                Ok(0)
            }
            // No driver of the kernel holds it.
            DRIVER_IOCTL => Err(libc::ENODATA),
            // The device has one configuration, as its descriptors say.
            CONTROL => Err(libc::EPIPE),
            SUBMIT => {
                self.started.get_or_insert_with(monotonic);
                self.submitted.push_back(argument as usize);
                Ok(0)
            }
            DISCARD => {
                let known = self.submitted.iter().position(|&u| u == argument as usize);
                let urb = known.and_then(|at| self.submitted.remove(at));
                let urb = urb.ok_or(libc::EINVAL)?;
                // SAFETY: the program keeps a transfer until it is reaped.
                unsafe { (*(urb as *mut Urb)).status = -libc::ENOENT };
                self.finished.push_back(urb);
                Ok(0)
            }
            REAP => {
                self.finish_due();
                let urb = self.finished.pop_front().ok_or(libc::EAGAIN)?;
                // SAFETY: the request points to a pointer.
                unsafe { argument.cast::<usize>().write_unaligned(urb) };
                Ok(0)
            }
            _ => Err(libc::ENOTTY),
        }
    }

    /// Gives a packet that is due to the first transfer.
    fn finish_due(&mut self) {
        if !self.finished.is_empty() || !matches!(self.ready(), Ready::Now) {
            return;
        }
        let (Some((_, bytes)), Some(urb)) = (self.packets.pop_front(), self.submitted.pop_front())
        else {
            return;
        };
        // SAFETY: the program keeps a transfer and its buffer until it is reaped.
        unsafe {
            let transfer = urb as *mut Urb;
            let len = bytes.len().min((*transfer).buffer_length as usize);
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), (*transfer).buffer, len);
            (*transfer).actual_length = len as c_int;
            (*transfer).status = 0;
        }
        self.finished.push_back(urb);
    }
}
