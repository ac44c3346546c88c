//! Interrupt transfers of a USB device, through libusb (feature `hardware`).

use std::path::PathBuf;

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

    /// Packets of one endpoint; cannot be opened here.
    #[derive(Debug)]
    pub struct UsbSource {
        absent: std::convert::Infallible,
    }

    impl UsbSource {
        /// Says that this program knows no USB devices.
        pub fn open(config: &UsbConfig) -> Result<Self, Error> {
            Err(Error::Open {
                device: config.path.display().to_string(),
                action: "open the USB device",
                cause: io::Error::new(
                    io::ErrorKind::Unsupported,
                    "this program knows no USB devices; build it with `--features hardware`",
                ),
            })
        }
    }

    impl PacketSource for UsbSource {
        fn recv(&mut self, _timeout: Duration) -> Result<Option<Packet>, Error> {
            match self.absent {}
        }
    }
}

pub use device::UsbSource;

/// Which device, and what of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UsbConfig {
    /// Its usbfs node (`/dev/bus/usb/…`), or a name that a udev rule gives it.
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
