//! Interrupt transfers of a USB device: of a real one through libusb (feature `hardware`), of a mock one behind a socket.

mod socket;

use std::os::unix::fs::FileTypeExt;
use std::path::PathBuf;
use std::time::Duration;

use lsfb_types::Packet;

use self::socket::SocketDevice;
use super::PacketSource;
use crate::Error;

pub use self::socket::MockUsb;

#[cfg(feature = "hardware")]
mod device;
#[cfg(not(feature = "hardware"))]
mod device {
    //! In place of a device where this program was built without them.

    use std::io;
    use std::time::Duration;

    use lsfb_types::Packet;

    use super::UsbConfig;
    use crate::Error;
    use crate::transport::PacketSource;

    /// A real device; cannot be opened here.
    #[derive(Debug)]
    pub(super) struct RealDevice {
        absent: std::convert::Infallible,
    }

    impl RealDevice {
        /// Says that this program knows no USB devices.
        pub(super) fn open(config: &UsbConfig) -> Result<Self, Error> {
            Err(Error::Open {
                device: config.path.display().to_string(),
                action: "open the USB device",
                cause: io::Error::new(
                    io::ErrorKind::Unsupported,
                    "this build does not support USB devices; build it with `--features hardware`",
                ),
            })
        }
    }

    impl PacketSource for RealDevice {
        fn recv(&mut self, _timeout: Duration) -> Result<Option<Packet>, Error> {
            match self.absent {}
        }
    }
}

/// Which device, and what of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UsbConfig {
    /// Its usbfs node (`/dev/bus/usb/…`), a name that a udev rule gives it, or the socket of a [`MockUsb`].
    pub path: PathBuf,
    /// Vendor id that it must have.
    pub vendor: u16,
    /// Product id that it must have.
    pub product: u16,
    /// Interface with the endpoint.
    pub interface: u8,
    /// Interrupt endpoint, towards the host.
    pub endpoint_in: u8,
    /// Bytes of the longest packet.
    pub longest: usize,
}

impl UsbConfig {
    /// Refuses a device that is another one.
    fn expect(&self, device: &str, vendor: u16, product: u16) -> Result<(), Error> {
        if (vendor, product) == (self.vendor, self.product) {
            return Ok(());
        }
        Err(Error::Protocol {
            device: device.to_owned(),
            problem: format!(
                "found {vendor:04x}:{product:04x}, expected {:04x}:{:04x}",
                self.vendor, self.product
            ),
        })
    }
}

/// Packets of one endpoint.
#[derive(Debug)]
pub struct UsbSource(Link);

#[derive(Debug)]
enum Link {
    Device(device::RealDevice),
    Socket(SocketDevice),
}

impl UsbSource {
    /// Opens the device and checks what it is.
    pub fn open(config: &UsbConfig) -> Result<Self, Error> {
        let is_socket = std::fs::metadata(&config.path).is_ok_and(|m| m.file_type().is_socket());
        Ok(Self(if is_socket {
            Link::Socket(SocketDevice::connect(config)?)
        } else {
            Link::Device(device::RealDevice::open(config)?)
        }))
    }
}

impl PacketSource for UsbSource {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        match &mut self.0 {
            Link::Device(device) => device.recv(timeout),
            Link::Socket(device) => device.recv(timeout),
        }
    }
}
