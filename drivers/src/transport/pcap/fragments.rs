//! IPv4 fragments back into datagrams.

use std::collections::VecDeque;

use etherparse::{IpNumber, Ipv4HeaderSlice, LaxIpv4Slice, defrag::IpDefragBuf};

/// Datagrams that may be incomplete at once. A sensor sends them one after the other; the oldest gives way.
const OPEN_DATAGRAMS: usize = 16;
const UDP_HEADER_LEN: usize = 8;

/// Datagrams of which parts are still missing; each is bounded by IP itself to 64 KiB.
#[derive(Default)]
pub(super) struct Fragments {
    open: VecDeque<Open>,
}

struct Open {
    key: Key,
    datagram: IpDefragBuf,
}

#[derive(Clone, Copy, PartialEq, Eq)]
struct Key {
    source: [u8; 4],
    destination: [u8; 4],
    identification: u16,
    protocol: u8,
}

impl Key {
    fn of(header: &Ipv4HeaderSlice<'_>) -> Self {
        Self {
            source: header.source(),
            destination: header.destination(),
            identification: header.identification(),
            protocol: header.protocol().0,
        }
    }
}

/// What became of a fragment.
pub(super) enum Fragment {
    /// Parts of its datagram are missing still.
    Waiting,
    /// The UDP packet that it completes: header and payload.
    Complete(Vec<u8>),
    /// Not of UDP, or it contradicts the parts before it.
    Useless,
}

impl Fragments {
    /// Datagrams that are incomplete.
    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.open.len()
    }

    pub(super) fn push(&mut self, part: &LaxIpv4Slice<'_>) -> Fragment {
        let header = part.header();
        if header.protocol() != IpNumber::UDP {
            return Fragment::Useless;
        }
        let key = Key::of(&header);
        let at = self.open.iter().position(|open| open.key == key);
        let at = at.unwrap_or_else(|| {
            if self.open.len() == OPEN_DATAGRAMS {
                self.open.pop_front();
            }
            self.open.push_back(Open {
                key,
                datagram: IpDefragBuf::new(IpNumber::UDP, Vec::new(), Vec::new()),
            });
            self.open.len() - 1
        });
        let Some(open) = self.open.get_mut(at) else {
            return Fragment::Useless;
        };
        let added = open.datagram.add(
            header.fragments_offset(),
            header.more_fragments(),
            part.payload().payload,
        );
        if added.is_err() {
            self.open.remove(at);
            return Fragment::Useless;
        }
        if !open.datagram.is_complete() {
            return Fragment::Waiting;
        }
        match self.open.remove(at) {
            Some(whole) => Fragment::Complete(whole.datagram.take_bufs().0),
            None => Fragment::Useless,
        }
    }
}

/// The payload of a UDP packet to one of `ports`, or to any where there are none.
pub(super) fn payload<'a>(udp: &'a [u8], ports: &[u16]) -> Option<&'a [u8]> {
    let &[_, _, port_high, port_low, len_high, len_low, _, _] =
        udp.first_chunk::<UDP_HEADER_LEN>()?;
    let port = u16::from_be_bytes([port_high, port_low]);
    if !ports.is_empty() && !ports.contains(&port) {
        return None;
    }
    let len = usize::from(u16::from_be_bytes([len_high, len_low])).min(udp.len());
    udp.get(UDP_HEADER_LEN..len)
}
