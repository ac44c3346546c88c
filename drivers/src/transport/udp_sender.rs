//! The device's side of a UDP stream, for mocks.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};

use crate::Error;

/// Sends datagrams from one port to one address, as a sensor does.
#[derive(Debug)]
pub struct UdpSender {
    socket: UdpSocket,
    target: SocketAddr,
}

impl UdpSender {
    /// Takes a free port and aims it at `target`.
    pub fn aim(target: SocketAddr) -> Result<Self, Error> {
        let any: SocketAddr = match target {
            SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
            SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
        };
        let socket = UdpSocket::bind(any).map_err(|cause| Error::Open {
            device: target.to_string(),
            action: "bind a port to send from",
            cause,
        })?;
        Ok(Self { socket, target })
    }

    /// Sends one datagram. Whether anybody receives it cannot be known here.
    pub fn send(&self, datagram: &[u8]) -> Result<(), Error> {
        self.socket
            .send_to(datagram, self.target)
            .map_err(|cause| Error::Send {
                device: self.target.to_string(),
                cause,
            })?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::transport::PacketSource;
    use crate::transport::udp::{UdpConfig, UdpSource};

    #[test]
    fn datagrams_arrive_whole_and_in_order() {
        let mut source = UdpSource::bind(&UdpConfig {
            binds: vec![(Ipv4Addr::LOCALHOST, 0).into()],
            sender: None,
            receive_buffer_bytes: 1 << 16,
        })
        .unwrap();
        let sender = UdpSender::aim(source.local_addresses()[0]).unwrap();
        sender.send(&[7; 1206]).unwrap();
        sender.send(&[]).unwrap();
        sender.send(&[8, 9]).unwrap();
        let mut next = || source.recv(Duration::from_secs(5)).unwrap().unwrap().bytes;
        assert_eq!(next(), [7; 1206]);
        assert!(next().is_empty());
        assert_eq!(next(), [8, 9]);
    }
}
