//! Calls that the `v4l` crate does not have: transactions with a UVC extension unit (`linux/uvcvideo.h`), and single
//! controls (`linux/videodev2.h`).
#![allow(
    unsafe_code,
    reason = "a system call that takes a pointer; its wrapper is safe"
)]

use std::io;

use v4l::device::Handle;

/// `struct uvc_xu_control_query`.
#[repr(C)]
struct XuControlQuery {
    unit: u8,
    selector: u8,
    query: u8,
    size: u16,
    data: *mut u8,
}

nix::ioctl_readwrite!(uvcioc_ctrl_query, b'u', 0x21, XuControlQuery);

/// Carries out a transaction of `query`'s direction: `bytes`, as long as the channel, are written or filled.
pub(super) fn query_extension_unit(
    node: &Handle,
    unit: u8,
    selector: u8,
    query: u8,
    bytes: &mut [u8],
) -> io::Result<()> {
    let size = u16::try_from(bytes.len()).map_err(|_| io::ErrorKind::InvalidInput)?;
    let mut request = XuControlQuery {
        unit,
        selector,
        query,
        size,
        data: bytes.as_mut_ptr(),
    };
    // SAFETY: `node` is borrowed, so its descriptor is open; `request` has the layout of the kernel's struct and
    // outlives the call; `data` is valid for reads and writes of `size` bytes, beyond which the kernel does not go.
    unsafe { uvcioc_ctrl_query(node.fd(), &raw mut request) }?;
    Ok(())
}

/// `struct v4l2_control`.
#[repr(C)]
struct Control {
    id: u32,
    value: i32,
}

nix::ioctl_readwrite!(vidioc_g_ctrl, b'V', 27, Control);
nix::ioctl_readwrite!(vidioc_s_ctrl, b'V', 28, Control);

/// Current value of a control.
pub(super) fn control(node: &Handle, id: u32) -> io::Result<i32> {
    let mut request = Control { id, value: 0 };
    // SAFETY: the descriptor is open as above; `request` has the layout of the kernel's struct and outlives the call.
    unsafe { vidioc_g_ctrl(node.fd(), &raw mut request) }?;
    Ok(request.value)
}

/// Sets a control.
pub(super) fn set_control(node: &Handle, id: u32, value: i32) -> io::Result<()> {
    let mut request = Control { id, value };
    // SAFETY: as above.
    unsafe { vidioc_s_ctrl(node.fd(), &raw mut request) }?;
    Ok(())
}
