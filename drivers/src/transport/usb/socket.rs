//! A mock device behind a Unix socket of datagrams that keep their order: what usbfs and libusb hand over, without them.
//!
//! The device sends its device descriptor (USB 2.0, table 9-8) to whoever connects, then packets of its interrupt endpoint as
//! they are. A single byte says that nothing follows. A socket that closes without it is a device that was unplugged.

use std::io;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::time::Duration;

use lsfb_types::Packet;
use nix::errno::Errno;
use nix::sys::socket::{
    AddressFamily, Backlog, MsgFlags, SockFlag, SockType, UnixAddr, bind, connect, listen, recv,
    send, socket,
};

use super::UsbConfig;
use crate::Error;
use crate::transport::poll::readable;
use crate::transport::{PacketSource, arrival_now};

/// How long a mock device may take to say what it is.
const INTRODUCTION: Duration = Duration::from_secs(5);
/// Bytes of a device descriptor, and where its ids are.
const DESCRIPTOR_LEN: usize = 18;
const VENDOR_AT: usize = 8;
/// Says that nothing follows; shorter than any report.
const END: [u8; 1] = [0];

fn datagrams() -> Result<OwnedFd, Errno> {
    let flags = SockFlag::SOCK_CLOEXEC;
    socket(AddressFamily::Unix, SockType::SeqPacket, flags, None)
}

/// The host's side.
#[derive(Debug)]
pub(super) struct SocketDevice {
    socket: OwnedFd,
    device: String,
    longest: usize,
    ended: bool,
}

impl SocketDevice {
    /// Connects, and checks what the device is.
    pub(super) fn connect(config: &UsbConfig) -> Result<Self, Error> {
        let device = config.path.display().to_string();
        let failed = |errno: Errno| Error::Open {
            device: device.clone(),
            action: "connect to the mock USB device",
            cause: errno.into(),
        };
        let socket = datagrams().map_err(failed)?;
        let address = UnixAddr::new(&config.path).map_err(failed)?;
        connect(socket.as_raw_fd(), &address).map_err(failed)?;
        let mut link = Self {
            socket,
            device: device.clone(),
            longest: config.longest,
            ended: false,
        };
        let introduced = readable(&link.socket.as_fd(), INTRODUCTION);
        let descriptor = match introduced.map_err(|cause| link.lost(cause))? {
            true => link.next()?,
            false => None,
        };
        match descriptor.as_deref() {
            Some([_, _, _, _, _, _, _, _, v0, v1, p0, p1, ..]) => {
                let [vendor, product] = [[*v0, *v1], [*p0, *p1]].map(u16::from_le_bytes);
                config.expect(&device, vendor, product)?;
                Ok(link)
            }
            _ => Err(Error::Protocol {
                device,
                problem: "expected a device descriptor first".to_owned(),
            }),
        }
    }

    /// The datagram that waits; `None`: the other side has gone.
    fn next(&mut self) -> Result<Option<Vec<u8>>, Error> {
        let mut bytes = vec![0; self.longest.max(DESCRIPTOR_LEN)];
        match recv(self.socket.as_raw_fd(), &mut bytes, MsgFlags::MSG_DONTWAIT) {
            Ok(0) => Ok(None),
            Ok(len) => {
                bytes.truncate(len);
                Ok(Some(bytes))
            }
            Err(errno) => Err(self.lost(errno.into())),
        }
    }

    fn lost(&self, cause: io::Error) -> Error {
        Error::Lost {
            device: self.device.clone(),
            cause,
        }
    }
}

impl PacketSource for SocketDevice {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        let end = || Error::EndOfStream {
            device: self.device.clone(),
        };
        if self.ended {
            return Err(end());
        }
        match readable(&self.socket.as_fd(), timeout) {
            Ok(true) => {}
            Ok(false) => return Ok(None),
            Err(cause) => return Err(self.lost(cause)),
        }
        match self.next()? {
            Some(bytes) if bytes == END => {
                self.ended = true;
                self.recv(timeout)
            }
            Some(bytes) => Ok(Some(Packet {
                arrival: arrival_now(),
                bytes,
            })),
            None => Err(self.lost(io::ErrorKind::UnexpectedEof.into())),
        }
    }
}

/// The device's side.
#[derive(Debug)]
pub struct MockUsb {
    path: PathBuf,
    listener: UnixListener,
    descriptor: [u8; DESCRIPTOR_LEN],
    host: Option<OwnedFd>,
}

impl MockUsb {
    /// Appears at `path` as a device with these ids.
    pub fn bind(path: &Path, vendor: u16, product: u16) -> Result<Self, Error> {
        let failed = |errno: Errno| Error::Open {
            device: path.display().to_string(),
            action: "create the mock USB device",
            cause: errno.into(),
        };
        let listener = datagrams().map_err(failed)?;
        let address = UnixAddr::new(path).map_err(failed)?;
        bind(listener.as_raw_fd(), &address).map_err(failed)?;
        listen(&listener, Backlog::new(1).map_err(failed)?).map_err(failed)?;
        // USB 2.0, 64 bytes to endpoint 0, one configuration.
        let mut descriptor = [18, 1, 0, 2, 0, 0, 0, 64, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1];
        let ids = [vendor.to_le_bytes(), product.to_le_bytes()].concat();
        descriptor[VENDOR_AT..VENDOR_AT + ids.len()].copy_from_slice(&ids);
        Ok(Self {
            path: path.to_owned(),
            listener: listener.into(),
            descriptor,
            host: None,
        })
    }

    /// Waits for a host. `false`: none came within `timeout`.
    pub fn accept(&mut self, timeout: Duration) -> Result<bool, Error> {
        if !readable(&self.listener.as_fd(), timeout).map_err(|cause| self.unsent(cause))? {
            return Ok(false);
        }
        let (host, _) = self.listener.accept().map_err(|cause| self.unsent(cause))?;
        self.host = Some(host.into());
        let descriptor = self.descriptor;
        self.send(&descriptor)?;
        Ok(true)
    }

    /// Sends a packet of the interrupt endpoint; waits while the host is busy.
    pub fn send(&mut self, packet: &[u8]) -> Result<(), Error> {
        let Some(host) = &self.host else {
            return Err(self.unsent(io::ErrorKind::NotConnected.into()));
        };
        match send(host.as_raw_fd(), packet, MsgFlags::MSG_NOSIGNAL) {
            Ok(_) => Ok(()),
            Err(errno) => Err(self.unsent(errno.into())),
        }
    }

    /// Says that nothing follows. What was sent stays there to be read.
    pub fn finish(mut self) -> Result<(), Error> {
        self.send(&END)
    }

    fn unsent(&self, cause: io::Error) -> Error {
        Error::Send {
            device: self.path.display().to_string(),
            cause,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::UsbSource;
    use super::*;

    fn config(path: &Path) -> UsbConfig {
        UsbConfig {
            path: path.to_owned(),
            vendor: 0x0483,
            product: 0x5720,
            interface: 0,
            endpoint_in: 0x81,
            longest: 64,
        }
    }

    #[test]
    fn packets_come_as_they_are_until_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("usb");
        let mut device = MockUsb::bind(&path, 0x0483, 0x5720).unwrap();
        assert!(!device.accept(Duration::ZERO).unwrap());
        std::thread::scope(|scope| {
            let host = std::thread::Builder::new()
                .name("host".to_owned())
                .spawn_scoped(scope, || UsbSource::open(&config(&path)).unwrap())
                .unwrap();
            assert!(device.accept(Duration::from_secs(5)).unwrap());
            let mut host = host.join().unwrap();
            assert_eq!(host.recv(Duration::ZERO).unwrap(), None);
            for n in 0..100 {
                device.send(&[n; 64]).unwrap();
            }
            device.finish().unwrap();
            for n in 0..100 {
                let packet = host.recv(Duration::from_secs(5)).unwrap().unwrap();
                assert_eq!(packet.bytes, [n; 64]);
            }
            for _ in 0..2 {
                let end = host.recv(Duration::from_secs(5)).unwrap_err();
                assert!(matches!(end, Error::EndOfStream { .. }), "{end}");
            }
        });
    }

    #[test]
    fn another_device_is_refused_and_an_unplugged_one_is_lost() {
        let folder = tempfile::tempdir().unwrap();
        for (product, expected) in [(0x5720, None), (0x1234, Some("found 0483:1234"))] {
            let path = folder.path().join(format!("usb{product}"));
            let mut device = MockUsb::bind(&path, 0x0483, product).unwrap();
            std::thread::scope(|scope| {
                let host = std::thread::Builder::new()
                    .name("host".to_owned())
                    .spawn_scoped(scope, || UsbSource::open(&config(&path)))
                    .unwrap();
                assert!(device.accept(Duration::from_secs(5)).unwrap());
                match (host.join().unwrap(), expected) {
                    (Ok(mut host), None) => {
                        drop(device);
                        let lost = host.recv(Duration::from_secs(5)).unwrap_err();
                        assert!(matches!(lost, Error::Lost { .. }), "{lost}");
                    }
                    (Err(error), Some(words)) => {
                        assert!(error.to_string().contains(words), "{error}");
                    }
                    (opened, _) => panic!("{opened:?}"),
                }
            });
        }
    }
}
