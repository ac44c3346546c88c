//! A line of text for every packet on its way.

use std::fmt::Write as _;
use std::io::Write;
use std::net::IpAddr;
use std::time::Duration;

use lsfb_types::{Packet, Timestamp};

use super::PacketSource;
use crate::Error;

/// Bytes of each packet that a line shows.
const SHOWN_BYTES: usize = 16;

/// Writes a line about every packet of a source, and about its end:
/// arrival in seconds, microseconds since the packet before, length, first bytes.
#[derive(Debug)]
pub struct Tracing<S, W> {
    source: S,
    out: W,
    last: Option<Timestamp>,
    unwritten: u64,
}

impl<S: PacketSource, W: Write> Tracing<S, W> {
    /// Traces `source` into `out`.
    pub fn new(source: S, out: W) -> Self {
        Self {
            source,
            out,
            last: None,
            unwritten: 0,
        }
    }

    /// The source inside.
    pub fn source(&self) -> &S {
        &self.source
    }

    /// What the lines went to.
    pub fn out(&self) -> &W {
        &self.out
    }

    /// Lines that could not be written. They do not stop the packets.
    pub fn unwritten(&self) -> u64 {
        self.unwritten
    }

    fn line(&mut self, packet: &Packet) -> String {
        let step_us = self
            .last
            .replace(packet.arrival)
            .map_or(0, |last| (packet.arrival - last) / 1000);
        let mut line = format!(
            "{} {step_us:+} us {} bytes",
            packet.arrival,
            packet.bytes.len()
        );
        for byte in packet.bytes.iter().take(SHOWN_BYTES) {
            // Writing to a `String` cannot fail.
            let _ = write!(line, " {byte:02x}");
        }
        line
    }
}

impl<S: PacketSource, W: Write> PacketSource for Tracing<S, W> {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        let received = self.source.recv(timeout);
        let line = match &received {
            Ok(Some(packet)) => self.line(packet),
            Ok(None) => return received,
            Err(error) => error.to_string(),
        };
        if writeln!(self.out, "{line}").is_err() {
            self.unwritten += 1;
        }
        received
    }

    fn sender(&self) -> Option<IpAddr> {
        self.source.sender()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Two(u8);

    impl PacketSource for Two {
        fn recv(&mut self, _timeout: Duration) -> Result<Option<Packet>, Error> {
            self.0 += 1;
            match self.0 {
                1 | 3 => Ok(Some(Packet {
                    arrival: Timestamp::from_nanos(5_000_000_000 + i64::from(self.0) * 250_000),
                    bytes: vec![0xAB; usize::from(self.0) * 10],
                })),
                2 => Ok(None),
                _ => Err(Error::EndOfStream {
                    device: "two".to_owned(),
                }),
            }
        }
    }

    #[test]
    fn each_packet_and_the_end_have_a_line() {
        let mut traced = Tracing::new(Two(0), Vec::new());
        while traced.recv(Duration::ZERO).is_ok() {}
        let text = String::from_utf8(traced.out().clone()).unwrap();
        let ab = |n| " ab".repeat(n);
        assert_eq!(
            text,
            format!(
                "5.000250000 +0 us 10 bytes{}\n5.000750000 +500 us 30 bytes{}\ntwo: end of stream\n",
                ab(10),
                ab(16)
            )
        );
    }

    #[test]
    fn a_full_log_does_not_stop_the_packets() {
        let mut nowhere = [0u8; 3];
        let mut traced = Tracing::new(Two(0), nowhere.as_mut_slice());
        assert!(traced.recv(Duration::ZERO).unwrap().is_some());
        assert_eq!(traced.unwritten(), 1);
    }
}
