//! UDP with kernel receive stamps, a counter of what the kernel dropped, and a receive buffer that was checked.

use std::collections::VecDeque;
use std::io::{self, IoSliceMut};
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::os::fd::{AsFd, AsRawFd};
use std::time::Duration;

use lsfb_types::{Packet, Timestamp};
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{
    ControlMessageOwned, MsgFlags, SockaddrStorage, recvmsg, setsockopt, sockopt,
};
use nix::sys::time::TimeSpec;

use super::{PacketSource, arrival_now};
use crate::Error;

/// Longest datagram taken whole; sensors send less than one Ethernet frame.
const LONGEST_DATAGRAM: usize = 2048;

/// What to listen on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UdpConfig {
    /// Addresses and ports of one device; port 0 takes a free one.
    pub binds: Vec<SocketAddr>,
    /// Pass over datagrams of any other sender.
    pub sender: Option<IpAddr>,
    /// Wanted kernel receive buffer per port, bytes.
    pub receive_buffer_bytes: usize,
}

/// Datagrams of one device, from one or more ports, in the order of arrival.
#[derive(Debug)]
pub struct UdpSource {
    ports: Vec<Port>,
    only_sender: Option<IpAddr>,
    waiting: VecDeque<Datagram>,
    last_sender: Option<IpAddr>,
    foreign: u64,
    wanted_buffer_bytes: usize,
    name: String,
}

#[derive(Debug)]
struct Port {
    socket: UdpSocket,
    address: SocketAddr,
    receive_buffer_bytes: usize,
    /// The kernel's own counter, which wraps.
    overflow: u32,
    dropped: u64,
}

impl UdpSource {
    /// Binds every port and asks for kernel stamps and drop counts.
    pub fn bind(config: &UdpConfig) -> Result<Self, Error> {
        let ports = config
            .binds
            .iter()
            .map(|bind| Port::open(*bind, config.receive_buffer_bytes))
            .collect::<Result<Vec<_>, _>>()?;
        let name = ports
            .iter()
            .map(|port| format!("udp {}", port.address))
            .collect::<Vec<_>>()
            .join(", ");
        Ok(Self {
            ports,
            only_sender: config.sender,
            waiting: VecDeque::new(),
            last_sender: None,
            foreign: 0,
            wanted_buffer_bytes: config.receive_buffer_bytes,
            name,
        })
    }

    /// The addresses that were bound, in the order of the configuration.
    pub fn local_addresses(&self) -> Vec<SocketAddr> {
        self.ports.iter().map(|port| port.address).collect()
    }

    /// The smallest receive buffer that the kernel granted, bytes. It doubles what is asked for and stops at
    /// `net.core.rmem_max`.
    pub fn receive_buffer_bytes(&self) -> usize {
        self.ports
            .iter()
            .map(|port| port.receive_buffer_bytes)
            .min()
            .unwrap_or(0)
    }

    /// Bytes of the wanted receive buffer that the kernel did not grant on its poorest port: 0 where there is enough. What
    /// is missing is to be set as `net.core.rmem_max`.
    pub fn receive_buffer_shortfall_bytes(&self) -> usize {
        self.wanted_buffer_bytes
            .saturating_sub(self.receive_buffer_bytes())
    }

    /// Datagrams that the kernel dropped because the buffer was full, known as of the last datagram received.
    pub fn kernel_drops(&self) -> u64 {
        self.ports.iter().map(|port| port.dropped).sum()
    }

    /// Datagrams of other senders that were passed over.
    pub fn foreign(&self) -> u64 {
        self.foreign
    }

    /// Takes at most one datagram from each port.
    fn collect(&mut self) -> Result<(), Error> {
        let mut batch = Vec::with_capacity(self.ports.len());
        for port in &mut self.ports {
            match port.receive() {
                Ok(Some(datagram))
                    if self
                        .only_sender
                        .is_some_and(|ip| datagram.sender != Some(ip)) =>
                {
                    self.foreign += 1
                }
                Ok(Some(datagram)) => batch.push(datagram),
                Ok(None) => {}
                Err(cause) => {
                    return Err(Error::Lost {
                        device: self.name.clone(),
                        cause,
                    });
                }
            }
        }
        batch.sort_by_key(|datagram| datagram.packet.arrival);
        self.waiting.extend(batch);
        Ok(())
    }
}

impl PacketSource for UdpSource {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        if self.waiting.is_empty() {
            self.collect()?;
        }
        if self.waiting.is_empty() {
            let millis = u16::try_from(timeout.as_millis()).unwrap_or(u16::MAX);
            let mut fds: Vec<PollFd<'_>> = self
                .ports
                .iter()
                .map(|port| PollFd::new(port.socket.as_fd(), PollFlags::POLLIN))
                .collect();
            match poll(&mut fds, PollTimeout::from(millis)) {
                Ok(0) | Err(Errno::EINTR) => return Ok(None),
                Ok(_) => self.collect()?,
                Err(errno) => {
                    return Err(Error::Lost {
                        device: self.name.clone(),
                        cause: errno.into(),
                    });
                }
            }
        }
        Ok(self.waiting.pop_front().map(|datagram| {
            self.last_sender = datagram.sender;
            datagram.packet
        }))
    }

    fn sender(&self) -> Option<IpAddr> {
        self.last_sender
    }
}

#[derive(Debug)]
struct Datagram {
    packet: Packet,
    sender: Option<IpAddr>,
}

impl Port {
    fn open(bind: SocketAddr, wanted_bytes: usize) -> Result<Self, Error> {
        let failed = |action| {
            move |cause: io::Error| Error::Open {
                device: format!("udp {bind}"),
                action,
                cause,
            }
        };
        let socket = UdpSocket::bind(bind).map_err(failed("bind"))?;
        let address = socket
            .local_addr()
            .map_err(failed("read the bound address"))?;
        setsockopt(&socket, sockopt::ReceiveTimestampns, &true)
            .map_err(|e| failed("request kernel receive stamps")(e.into()))?;
        setsockopt(&socket, sockopt::RxqOvfl, &1)
            .map_err(|e| failed("request the drop counter")(e.into()))?;
        // Only a privileged process may exceed net.core.rmem_max; everyone else gets what that allows.
        if setsockopt(&socket, sockopt::RcvBufForce, &wanted_bytes).is_err() {
            setsockopt(&socket, sockopt::RcvBuf, &wanted_bytes)
                .map_err(|e| failed("set the receive buffer")(e.into()))?;
        }
        let receive_buffer_bytes = nix::sys::socket::getsockopt(&socket, sockopt::RcvBuf)
            .map_err(|e| failed("read the receive buffer")(e.into()))?;
        Ok(Self {
            socket,
            address,
            receive_buffer_bytes,
            overflow: 0,
            dropped: 0,
        })
    }

    fn receive(&mut self) -> io::Result<Option<Datagram>> {
        let mut bytes = vec![0; LONGEST_DATAGRAM];
        let mut control = nix::cmsg_space!(TimeSpec, u32);
        let mut slices = [IoSliceMut::new(&mut bytes)];
        let received = recvmsg::<SockaddrStorage>(
            self.socket.as_raw_fd(),
            &mut slices,
            Some(&mut control),
            MsgFlags::MSG_DONTWAIT,
        );
        let message = match received {
            Ok(message) => message,
            // An ICMP answer to something sent from this port says nothing about what arrives.
            Err(Errno::EAGAIN | Errno::EINTR | Errno::ECONNREFUSED) => return Ok(None),
            Err(errno) => return Err(errno.into()),
        };
        let mut arrival = None;
        for control in message.cmsgs()? {
            match control {
                ControlMessageOwned::ScmTimestampns(stamp) => {
                    arrival = Some(Timestamp::from_nanos(
                        stamp.tv_sec() * 1_000_000_000 + stamp.tv_nsec(),
                    ));
                }
                ControlMessageOwned::RxqOvfl(count) => {
                    self.dropped += u64::from(count.wrapping_sub(self.overflow));
                    self.overflow = count;
                }
                _ => {}
            }
        }
        let sender = message.address.as_ref().and_then(|address| {
            let v4 = address.as_sockaddr_in().map(|a| IpAddr::V4(a.ip()));
            v4.or_else(|| address.as_sockaddr_in6().map(|a| IpAddr::V6(a.ip())))
        });
        let length = message.bytes;
        bytes.truncate(length);
        Ok(Some(Datagram {
            packet: Packet {
                arrival: arrival.unwrap_or_else(arrival_now),
                bytes,
            },
            sender,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(receive_buffer_bytes: usize, sender: Option<IpAddr>) -> UdpSource {
        let any = SocketAddr::from(([127, 0, 0, 1], 0));
        UdpSource::bind(&UdpConfig {
            binds: vec![any, any],
            sender,
            receive_buffer_bytes,
        })
        .unwrap()
    }

    #[test]
    fn datagrams_of_two_ports_come_in_order_with_kernel_stamps() {
        let mut udp = source(1 << 17, None);
        let [data, position] = udp.local_addresses()[..] else {
            panic!("two ports")
        };
        assert_ne!(data.port(), position.port());
        assert!(
            udp.receive_buffer_bytes() >= 200_000,
            "{}",
            udp.receive_buffer_bytes()
        );
        assert_eq!(udp.receive_buffer_shortfall_bytes(), 0);
        assert_eq!(udp.recv(Duration::ZERO).unwrap(), None);
        let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
        let before = arrival_now();
        for n in 0..50u8 {
            sender
                .send_to(&[n; 1206], if n % 5 == 4 { position } else { data })
                .unwrap();
        }
        let mut seen = Vec::new();
        let mut last = before;
        while let Some(packet) = udp.recv(Duration::from_millis(50)).unwrap() {
            assert!(packet.arrival >= last.min(before));
            assert_eq!(packet.bytes.len(), 1206);
            last = packet.arrival;
            seen.push(packet.bytes[0]);
        }
        seen.sort_unstable();
        assert_eq!(seen, (0..50).collect::<Vec<_>>());
        assert!(last.secs_since(before) < 5.0);
        assert_eq!(udp.kernel_drops(), 0);
    }

    #[test]
    fn the_kernel_tells_what_it_dropped() {
        let mut udp = source(1, None);
        let to = udp.local_addresses()[0];
        let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
        for _ in 0..200 {
            sender.send_to(&[0; 1206], to).unwrap();
        }
        let mut received = 0;
        while udp.recv(Duration::from_millis(20)).unwrap().is_some() {
            received += 1;
        }
        // The counter travels with the next datagram.
        sender.send_to(&[1], to).unwrap();
        assert!(udp.recv(Duration::from_millis(200)).unwrap().is_some());
        assert!(received < 200);
        assert_eq!(udp.kernel_drops(), 200 - received);
    }

    #[test]
    fn other_senders_are_passed_over_and_counted() {
        let mut udp = source(1 << 16, Some(IpAddr::from([10, 9, 8, 7])));
        let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
        sender.send_to(&[1], udp.local_addresses()[0]).unwrap();
        assert_eq!(udp.recv(Duration::from_millis(100)).unwrap(), None);
        assert_eq!(udp.foreign(), 1);
    }

    #[test]
    fn a_taken_port_is_an_error_that_names_it() {
        let udp = source(1 << 16, None);
        let config = UdpConfig {
            binds: udp.local_addresses(),
            sender: None,
            receive_buffer_bytes: 1 << 16,
        };
        let error = UdpSource::bind(&config).unwrap_err().to_string();
        assert!(
            error.contains(&udp.local_addresses()[0].to_string()) && error.contains("bind"),
            "{error}"
        );
    }
}
