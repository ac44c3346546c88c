//! How bytes travel: sockets, serial lines, capture files. What they mean is the drivers' business.

pub mod camera_link;
pub mod camera_socket;
pub mod can;
pub mod faults;
mod host_clock;
pub mod http;
pub mod pcap;
mod poll;
pub mod rosbag2;
pub mod save;
pub mod serial;
pub mod trace;
pub mod udp;
pub mod udp_sender;
pub mod usb;
#[cfg(feature = "hardware")]
mod v4l2;
pub mod websocket;

pub(crate) use host_clock::arrival_now;

use std::time::Duration;

use lsfb_types::Packet;

use crate::Error;

/// Where packets come from. Live, replay, simulation and tests differ only in this.
pub trait PacketSource {
    /// Waits up to `timeout`. `None` means nothing arrived yet, not that the stream ended; the end is
    /// [`Error::EndOfStream`], and so is every later call.
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error>;
}

impl<S: PacketSource + ?Sized> PacketSource for Box<S> {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        (**self).recv(timeout)
    }
}
