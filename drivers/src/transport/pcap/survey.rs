//! What a capture holds beside the datagrams that were asked for.

use std::collections::BTreeMap;
use std::net::IpAddr;

/// Different streams that are told apart; what comes beyond is counted together.
const MOST_STREAMS: usize = 64;

/// A frame that was passed over.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Passed {
    /// A datagram to another port.
    Udp {
        /// Who sent it.
        sender: Option<IpAddr>,
        /// The port it was sent to.
        port: u16,
        /// What it says.
        payload: Vec<u8>,
    },
    /// A segment of a connection.
    Tcp,
    /// Another protocol.
    NoUdp,
    /// A frame or a fragment that makes no sense.
    Unreadable,
}

/// What was passed over, by kind, port and sender.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Survey {
    udp: BTreeMap<(u16, Option<IpAddr>), Datagrams>,
    more_udp: u64,
    tcp: u64,
    no_udp: u64,
    unreadable: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Datagrams {
    count: u64,
    shortest: usize,
    longest: usize,
    /// The first of them.
    first: Vec<u8>,
}

impl Survey {
    pub(super) fn note(&mut self, passed: Passed) {
        match passed {
            Passed::Tcp => self.tcp += 1,
            Passed::NoUdp => self.no_udp += 1,
            Passed::Unreadable => self.unreadable += 1,
            Passed::Udp {
                sender,
                port,
                payload,
            } => {
                let bytes = payload.len();
                let key = (port, sender);
                if self.udp.len() >= MOST_STREAMS && !self.udp.contains_key(&key) {
                    self.more_udp += 1;
                    return;
                }
                let stream = self.udp.entry(key).or_insert(Datagrams {
                    count: 0,
                    shortest: bytes,
                    longest: bytes,
                    first: payload,
                });
                stream.count += 1;
                stream.shortest = stream.shortest.min(bytes);
                stream.longest = stream.longest.max(bytes);
            }
        }
    }

    /// Whether nothing was passed over.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// For people. `whose` names the sensor that a datagram seems to be of.
    pub fn describe(&self, whose: impl Fn(&[u8]) -> Option<&'static str>) -> String {
        let mut parts = Vec::new();
        for ((port, sender), stream) in &self.udp {
            let Datagrams {
                count,
                shortest,
                longest,
                first,
            } = stream;
            let from = sender.map_or_else(String::new, |ip| format!(" from {ip}"));
            let sizes = match longest - shortest {
                0 => format!("{longest} bytes"),
                _ => format!("{shortest} to {longest} bytes"),
            };
            let like = whose(first).map_or_else(String::new, |name| format!(", looks like {name}"));
            parts.push(format!(
                "{count} datagrams of {sizes} to port {port}{from}{like}"
            ));
        }
        for (count, what) in [
            (self.more_udp, "datagrams to other ports"),
            (self.tcp, "TCP segments"),
            (self.no_udp, "frames of other protocols"),
            (self.unreadable, "malformed frames"),
        ] {
            if count > 0 {
                parts.push(format!("{count} {what}"));
            }
        }
        parts.join("; ")
    }
}
