//! Who receives the datagrams, where that is this machine: a sensor knows nothing of its host, but a mock that overruns a
//! busy one tests the machine's load and nothing else.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use super::clock::SimClock;

/// Datagrams between two looks.
const LOOK_EVERY: u32 = 16;
/// Bytes that may wait in a socket of the host, with the kernel's overhead: a quarter of the smallest usual buffer.
const ROOM_BYTES: u64 = 50_000;
/// A host that takes nothing for this long is overrun, as it would be by a sensor.
const PATIENCE: Duration = Duration::from_secs(2);
const NAP: Duration = Duration::from_micros(500);

/// Sockets of this machine at some addresses.
#[derive(Clone, Debug)]
pub(super) struct Host {
    targets: Vec<SocketAddr>,
    sent: u32,
}

impl Host {
    pub(super) fn new(targets: &[SocketAddr]) -> Self {
        Self {
            targets: targets.to_vec(),
            sent: 0,
        }
    }

    /// Whether somebody listens at every address. Of other machines nothing is known: a sensor sends all the same.
    pub(super) fn listens(&self) -> bool {
        let local = self.targets.iter().filter(|t| t.ip().is_loopback());
        local.into_iter().all(|t| queued_bytes(*t).is_some())
    }

    /// Call it before each datagram: waits while the host is busy.
    pub(super) fn wait_for_room(&mut self, clock: &SimClock) {
        self.sent = self.sent.wrapping_add(1);
        if !self.sent.is_multiple_of(LOOK_EVERY) {
            return;
        }
        let since = Instant::now();
        let full = || {
            let local = self.targets.iter().filter(|t| t.ip().is_loopback());
            local
                .filter_map(|t| queued_bytes(*t))
                .any(|bytes| bytes > ROOM_BYTES)
        };
        while full() && since.elapsed() < PATIENCE && !clock.is_stopped() {
            std::thread::sleep(NAP);
        }
    }
}

/// What waits in the socket of this machine that is bound to the port; `None` where there is none. A system that does not
/// tell counts as an empty socket.
fn queued_bytes(target: SocketAddr) -> Option<u64> {
    let wanted = format!(":{:04X}", target.port());
    let tables = ["/proc/net/udp", "/proc/net/udp6"].map(std::fs::read_to_string);
    if tables.iter().all(Result::is_err) {
        return Some(0);
    }
    tables.iter().flatten().find_map(|table| {
        table.lines().skip(1).find_map(|line| {
            let mut columns = line.split_whitespace();
            columns.nth(1).filter(|local| local.ends_with(&wanted))?;
            // Remote address, state, then both queues.
            let (_, received) = columns.nth(2)?.split_once(':')?;
            u64::from_str_radix(received, 16).ok()
        })
    })
}

/// Whether somebody on this machine takes frames of a CAN interface. A system that does not tell counts as one who does.
pub(super) fn listens_on_can(interface: &str) -> bool {
    let Ok(lists) = std::fs::read_dir("/proc/net/can") else {
        return true;
    };
    let mut lists = lists
        .flatten()
        .filter(|list| list.file_name().to_string_lossy().starts_with("rcvlist_"))
        .filter_map(|list| std::fs::read_to_string(list.path()).ok());
    lists.any(|list| {
        let mut devices = list
            .lines()
            .filter_map(|line| line.split_whitespace().next());
        devices.any(|device| device == interface)
    })
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;

    use super::*;
    use crate::device::clock::Pace;

    #[test]
    fn a_host_that_is_not_there_or_busy_is_seen() {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = socket.local_addr().unwrap();
        let mut host = Host::new(&[address]);
        assert!(host.listens());
        assert_eq!(queued_bytes(address), Some(0));
        let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
        for _ in 0..40 {
            sender.send_to(&[0; 1206], address).unwrap();
        }
        assert!(queued_bytes(address).unwrap() > ROOM_BYTES);
        let clock = SimClock::new(1, 1, Pace::Unlimited);
        clock.stop();
        // Stopped: nobody waits.
        (0..LOOK_EVERY).for_each(|_| host.wait_for_room(&clock));
        drop(socket);
        assert!(!host.listens());
    }
}
