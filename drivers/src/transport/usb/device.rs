//! The device itself.
#![allow(
    unsafe_code,
    reason = "libusb takes a file descriptor that must outlive its handle; the source owns both"
)]

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::AsRawFd;
use std::time::Duration;

use lsfb_types::Packet;
use rusb::{Context, DeviceHandle, UsbContext};

use super::UsbConfig;
use crate::Error;
use crate::transport::{PacketSource, arrival_now};

/// libusb takes zero for eternity.
const SHORTEST_WAIT: Duration = Duration::from_millis(1);

/// A real device.
#[derive(Debug)]
pub(super) struct RealDevice {
    /// Dropped before the node that it works on.
    handle: DeviceHandle<Context>,
    _node: File,
    device: String,
    endpoint_in: u8,
    longest: usize,
}

impl RealDevice {
    /// Opens the node, checks what it is, and claims its interface.
    pub(super) fn open(config: &UsbConfig) -> Result<Self, Error> {
        let device = config.path.display().to_string();
        let failed = |action| {
            let device = device.clone();
            move |cause: io::Error| Error::Open {
                device,
                action,
                cause,
            }
        };
        let refused = |action| {
            let failed = failed(action);
            move |error: rusb::Error| failed(io::Error::other(error))
        };
        let node = OpenOptions::new()
            .read(true)
            .write(true)
            .open(&config.path)
            .map_err(failed("open the USB device"))?;
        // Found by its name, it need not be looked for on all buses.
        rusb::disable_device_discovery().map_err(refused("prepare libusb"))?;
        let context = Context::new().map_err(refused("prepare libusb"))?;
        // SAFETY: the descriptor is that of `node`, which is kept beside the handle and closed after it.
        let handle = unsafe { context.open_device_with_fd(node.as_raw_fd()) }
            .map_err(refused("hand the USB device to libusb"))?;
        let descriptor = handle
            .device()
            .device_descriptor()
            .map_err(refused("read the USB descriptor"))?;
        config.expect(&device, descriptor.vendor_id(), descriptor.product_id())?;
        match handle.set_auto_detach_kernel_driver(true) {
            Ok(()) | Err(rusb::Error::NotSupported) => {}
            Err(error) => return Err(refused("detach the USB device from its driver")(error)),
        }
        handle
            .claim_interface(config.interface)
            .map_err(refused("claim the USB interface"))?;
        Ok(Self {
            handle,
            _node: node,
            device,
            endpoint_in: config.endpoint_in,
            longest: config.longest,
        })
    }
}

impl PacketSource for RealDevice {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        let mut bytes = vec![0; self.longest];
        let timeout = timeout.max(SHORTEST_WAIT);
        let read = self
            .handle
            .read_interrupt(self.endpoint_in, &mut bytes, timeout);
        match read {
            Ok(len) => {
                bytes.truncate(len);
                Ok(Some(Packet {
                    arrival: arrival_now(),
                    bytes,
                }))
            }
            Err(rusb::Error::Timeout | rusb::Error::Interrupted) => Ok(None),
            Err(error) => Err(Error::Lost {
                device: self.device.clone(),
                cause: io::Error::other(error),
            }),
        }
    }
}
