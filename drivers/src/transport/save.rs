//! Packets into a capture file that Wireshark and [`super::pcap::PcapSource`] read, and a wrapper that does so on the way.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use etherparse::PacketBuilder;
use lsfb_types::Packet;

use super::PacketSource;
use crate::Error;

/// Nanosecond pcap, version 2.4, no time zone, no accuracy.
const MAGIC_NANOSECONDS: u32 = 0xA1B2_3C4D;
const SNAP_LEN: u32 = 0x0400_0000;
/// Addresses of a factory-fresh sensor that broadcasts.
const SENSOR: [u8; 4] = [192, 168, 1, 201];
const BROADCAST: [u8; 4] = [255; 4];
/// The vendor part is Velodyne's.
const SENSOR_MAC: [u8; 6] = [0x60, 0x76, 0x88, 0, 0, 1];
const BROADCAST_MAC: [u8; 6] = [0xFF; 6];
const TIME_TO_LIVE: u8 = 64;

/// What stands around a packet's bytes in the file.
#[derive(Clone, Copy, Debug)]
pub enum Encapsulation {
    /// Ethernet, IPv4 and UDP, from and to the port that `port_of` gives for a packet's bytes. At most 65 507 bytes each.
    Udp {
        /// The port of some bytes.
        port_of: fn(&[u8]) -> u16,
    },
    /// Nothing (link type 147): for packets that are no datagrams, such as frames and pieces of a serial stream.
    Bare,
}

/// Link type of [`Encapsulation::Bare`] (LINKTYPE_USER0).
pub(super) const BARE_LINK: u32 = 147;
const ETHERNET_LINK: u32 = 1;

/// Writes a capture file.
#[derive(Debug)]
pub struct PcapWriter {
    path: PathBuf,
    out: BufWriter<File>,
    encapsulation: Encapsulation,
    frame: Vec<u8>,
}

impl PcapWriter {
    /// Makes the file, or empties it.
    pub fn create(path: &Path, encapsulation: Encapsulation) -> Result<Self, Error> {
        let file = File::create(path).map_err(|cause| Error::Open {
            device: path.display().to_string(),
            action: "create the capture file",
            cause,
        })?;
        let mut writer = Self {
            path: path.to_owned(),
            out: BufWriter::new(file),
            encapsulation,
            frame: Vec::new(),
        };
        let link = match encapsulation {
            Encapsulation::Udp { .. } => ETHERNET_LINK,
            Encapsulation::Bare => BARE_LINK,
        };
        let mut header = Vec::new();
        header.extend(MAGIC_NANOSECONDS.to_le_bytes());
        header.extend([2u16, 4].map(u16::to_le_bytes).concat());
        header.extend([0, 0, SNAP_LEN, link].map(u32::to_le_bytes).concat());
        writer.put(&header)?;
        Ok(writer)
    }

    /// Appends one packet, stamped with its arrival.
    pub fn write(&mut self, packet: &Packet) -> Result<(), Error> {
        let mut frame = std::mem::take(&mut self.frame);
        frame.clear();
        let framed = match self.encapsulation {
            Encapsulation::Bare => Ok(packet.bytes.as_slice()),
            Encapsulation::Udp { port_of } => {
                let port = port_of(&packet.bytes);
                PacketBuilder::ethernet2(SENSOR_MAC, BROADCAST_MAC)
                    .ipv4(SENSOR, BROADCAST, TIME_TO_LIVE)
                    .udp(port, port)
                    .write(&mut frame, &packet.bytes)
                    .map(|()| frame.as_slice())
                    .map_err(|e| self.failed(io::Error::other(e.to_string())))
            }
        };
        let outcome = framed.and_then(|framed| {
            let nanos = packet.arrival.nanos();
            let secs = u32::try_from(nanos.div_euclid(1_000_000_000)).map_err(|_| {
                self.failed(io::Error::other(format!(
                    "the stamp {} is not one a pcap can hold: 1970 to 2106",
                    packet.arrival
                )))
            })?;
            let len = u32::try_from(framed.len()).map_err(|e| self.failed(io::Error::other(e)))?;
            let header = [secs, nanos.rem_euclid(1_000_000_000) as u32, len, len];
            let written = self
                .out
                .write_all(&header.map(u32::to_le_bytes).concat())
                .and_then(|()| self.out.write_all(framed));
            written.map_err(|cause| self.failed(cause))
        });
        self.frame = frame;
        outcome
    }

    /// Writes out what is still buffered. A writer that is dropped instead does so too, but cannot say that it failed.
    pub fn finish(mut self) -> Result<(), Error> {
        self.out.flush().map_err(|cause| self.failed(cause))
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), Error> {
        self.out
            .write_all(bytes)
            .map_err(|cause| self.failed(cause))
    }

    fn failed(&self, cause: io::Error) -> Error {
        Error::Send {
            device: self.path.display().to_string(),
            cause,
        }
    }
}

/// Saves every packet of a source as it passes.
#[derive(Debug)]
pub struct Saving<S> {
    source: S,
    writer: PcapWriter,
}

impl<S: PacketSource> Saving<S> {
    /// Saves what `source` yields with `writer`.
    pub fn new(source: S, writer: PcapWriter) -> Self {
        Self { source, writer }
    }

    /// Closes the file and gives the source back.
    pub fn finish(self) -> Result<S, Error> {
        self.writer.finish()?;
        Ok(self.source)
    }
}

impl<S: PacketSource> PacketSource for Saving<S> {
    /// A packet that cannot be saved is an error: a capture with a silent hole would be worse than none.
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        let packet = self.source.recv(timeout)?;
        if let Some(packet) = &packet {
            self.writer.write(packet)?;
        }
        Ok(packet)
    }

    fn sender(&self) -> Option<IpAddr> {
        self.source.sender()
    }
}

#[cfg(test)]
mod tests {
    use lsfb_types::Timestamp;

    use super::*;
    use crate::transport::pcap::PcapSource;

    fn all(source: &mut impl PacketSource) -> Vec<Packet> {
        std::iter::from_fn(|| source.recv(Duration::ZERO).ok().flatten()).collect()
    }

    fn packets(lengths: &[usize]) -> Vec<Packet> {
        let packet = |(i, &len): (usize, &usize)| Packet {
            arrival: Timestamp::from_nanos(1_771_234_567_123_456_789 + i as i64),
            bytes: vec![i as u8; len],
        };
        lengths.iter().enumerate().map(packet).collect()
    }

    #[test]
    fn what_is_saved_is_read_back_with_its_stamps_and_ports() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("saved.pcap");
        let port_of = |bytes: &[u8]| if bytes.len() == 512 { 8308 } else { 2368 };
        let mut writer = PcapWriter::create(&path, Encapsulation::Udp { port_of }).unwrap();
        let written = packets(&[1206, 512, 0, 1206]);
        for packet in &written {
            writer.write(packet).unwrap();
        }
        writer.finish().unwrap();
        assert_eq!(all(&mut PcapSource::open(&path, &[]).unwrap()), written);
        let positions = all(&mut PcapSource::open(&path, &[8308]).unwrap());
        assert_eq!(positions, written[1..2]);

        // A source that is saved on the way gives the same file once more.
        let again = dir.path().join("again.pcap");
        let writer = PcapWriter::create(&again, Encapsulation::Udp { port_of }).unwrap();
        let mut saving = Saving::new(PcapSource::open(&path, &[]).unwrap(), writer);
        assert_eq!(all(&mut saving), written);
        saving.finish().unwrap();
        assert_eq!(std::fs::read(path).unwrap(), std::fs::read(again).unwrap());
    }

    #[test]
    fn bare_packets_may_be_of_any_length() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("frames.pcap");
        let written = packets(&[3, 1_024_000, 70_000]);
        let mut writer = PcapWriter::create(&path, Encapsulation::Bare).unwrap();
        for packet in &written {
            writer.write(packet).unwrap();
        }
        writer.finish().unwrap();
        assert_eq!(all(&mut PcapSource::open(&path, &[]).unwrap()), written);
    }

    #[test]
    fn what_does_not_fit_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let udp = Encapsulation::Udp { port_of: |_| 1 };
        let mut writer = PcapWriter::create(&dir.path().join("a.pcap"), udp).unwrap();
        assert!(writer.write(&packets(&[70_000])[0]).is_err());
        let mut early = packets(&[4]).remove(0);
        early.arrival = Timestamp::from_nanos(-1);
        let error = writer.write(&early).unwrap_err().to_string();
        assert!(error.contains("1970"), "{error}");
        assert!(PcapWriter::create(dir.path(), udp).is_err());
    }
}
