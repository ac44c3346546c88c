//! How bytes travel: sockets, serial lines, capture files. What they mean is the drivers' business.

#[cfg(feature = "mynt-s")]
pub mod camera_link;
#[cfg(feature = "mynt-s")]
pub mod camera_socket;
#[cfg(feature = "can")]
pub mod can;
#[cfg(feature = "faults")]
pub mod faults;
mod host_clock;
#[cfg(feature = "lidar")]
pub mod http;
#[cfg(feature = "pcap")]
pub mod pcap;
#[cfg(feature = "sidecar")]
mod pinned_tls;
#[cfg(any(
    feature = "lidar",
    feature = "mynt-s",
    feature = "sidecar",
    feature = "can",
    feature = "mynt-d"
))]
mod poll;
#[cfg(feature = "rosbag2")]
pub mod rosbag2;
#[cfg(feature = "pcap")]
pub mod save;
#[cfg(feature = "serial")]
pub mod serial;
pub mod trace;
pub mod udp;
pub mod udp_sender;
#[cfg(feature = "mynt-d")]
pub mod usb;
#[cfg(feature = "mynt-s")]
pub mod uvc;
#[cfg(feature = "hardware")]
mod v4l2;
#[cfg(feature = "sidecar")]
pub mod websocket;

pub(crate) use host_clock::arrival_now;

use std::net::IpAddr;
use std::time::Duration;

use lsfb_types::Packet;

use crate::Error;

/// Where packets come from. Live, replay, simulation and tests differ only in this.
pub trait PacketSource {
    /// Waits up to `timeout`. `None` means nothing arrived yet, not that the stream ended; the end is
    /// [`Error::EndOfStream`], and so is every later call.
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error>;

    /// Who sent the packet that [`PacketSource::recv`] gave last; `None` where packets carry no sender.
    fn sender(&self) -> Option<IpAddr> {
        None
    }
}

impl<S: PacketSource + ?Sized> PacketSource for Box<S> {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        (**self).recv(timeout)
    }

    fn sender(&self) -> Option<IpAddr> {
        (**self).sender()
    }
}

impl<S: PacketSource + ?Sized> PacketSource for &mut S {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        (**self).recv(timeout)
    }

    fn sender(&self) -> Option<IpAddr> {
        (**self).sender()
    }
}
