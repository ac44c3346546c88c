//! UDP payloads out of pcap and pcapng captures: Ethernet with any VLAN tags, Linux cooked, raw IP, with IP options and in
//! fragments; and the bare packets that [`super::save`] writes.
//!
//! Old Velodyne firmware writes the IP length of a data packet into its position packets, so that a socket would drop
//! them. Here the UDP length counts, bounded by what was captured.

mod fragments;
mod survey;

use std::borrow::Cow;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use etherparse::{LaxNetSlice, LaxSlicedPacket, LinuxSllSlice, TransportSlice};
use lsfb_types::{Packet, Timestamp};
use pcap_file::pcap::PcapReader;
use pcap_file::pcapng::blocks::interface_description::InterfaceDescriptionOption;
use pcap_file::pcapng::{Block, PcapNgReader};
use pcap_file::{DataLink, Endianness, PcapError, TsResolution};

use self::fragments::{Fragment, Fragments, payload};
use self::survey::Passed;
pub use self::survey::Survey;
use super::PacketSource;
use super::save::BARE_LINK;
use crate::Error;

const PCAPNG_MAGIC: [u8; 4] = [0x0A, 0x0D, 0x0D, 0x0A];
const GZIP_MAGIC: [u8; 2] = [0x1F, 0x8B];
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xB5, 0x2F, 0xFD];
const LINUX_SLL_LEN: usize = 16;

/// UDP payloads of a capture, in its order, as fast as they are asked for.
pub struct PcapSource {
    path: PathBuf,
    reader: Reader,
    ports: Vec<u16>,
    frames: u64,
    skipped: u64,
    ended: bool,
    fragments: Fragments,
    survey: Survey,
    last_sender: Option<IpAddr>,
}

enum Reader {
    Pcap(PcapReader<BufReader<File>>),
    PcapNg(PcapNgReader<BufReader<File>>),
}

impl PcapSource {
    /// Opens a capture. Only datagrams to `ports` come out; to any port where the list is empty.
    pub fn open(path: &Path, ports: &[u16]) -> Result<Self, Error> {
        let opened = |cause| Error::Open {
            device: path.display().to_string(),
            action: "open",
            cause,
        };
        let mut file = File::open(path).map_err(opened)?;
        let mut magic = [0; 4];
        let problem = match file.read_exact(&mut magic) {
            Err(_) if path.is_dir() => Some("this is a folder: name the capture in it"),
            Err(_) => Some("too short for a capture"),
            Ok(()) if magic.starts_with(&GZIP_MAGIC) => Some("compressed: unpack it with gunzip"),
            Ok(()) if magic == ZSTD_MAGIC => Some("compressed: unpack it with unzstd"),
            Ok(()) => None,
        };
        if let Some(problem) = problem {
            return Err(damaged(path, "byte 0".into(), problem.into()));
        }
        let is_pcapng = magic == PCAPNG_MAGIC;
        file.seek(SeekFrom::Start(0)).map_err(opened)?;
        let no_capture = |error: PcapError| {
            damaged(
                path,
                "byte 0".into(),
                format!("neither pcap nor pcapng ({})", describe(&error)),
            )
        };
        let file = BufReader::new(file);
        let reader = if is_pcapng {
            Reader::PcapNg(PcapNgReader::new(file).map_err(no_capture)?)
        } else {
            Reader::Pcap(PcapReader::new(file).map_err(no_capture)?)
        };
        Ok(Self {
            path: path.to_owned(),
            reader,
            ports: ports.to_owned(),
            frames: 0,
            skipped: 0,
            ended: false,
            fragments: Fragments::default(),
            survey: Survey::default(),
            last_sender: None,
        })
    }

    /// Frames passed over: no UDP, another port, a fragment that fits no other.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// What the frames held that were passed over so far.
    pub fn survey(&self) -> &Survey {
        &self.survey
    }

    /// Reads one frame.
    fn read_frame(&mut self) -> Result<Frame, PcapError> {
        let ports = &self.ports;
        let (nanos, found) = match &mut self.reader {
            Reader::Pcap(reader) => {
                let header = reader.header();
                let Some(frame) = reader.next_raw_packet() else {
                    return Ok(Frame::End);
                };
                let frame = frame?;
                let unit_ns = match header.ts_resolution {
                    TsResolution::MicroSecond => 1_000,
                    TsResolution::NanoSecond => 1,
                };
                let nanos =
                    i64::from(frame.ts_sec) * 1_000_000_000 + i64::from(frame.ts_frac) * unit_ns;
                let found = datagram(header.datalink, &frame.data, ports, &mut self.fragments);
                (nanos, found.into_owned())
            }
            Reader::PcapNg(reader) => {
                let Some(block) = reader.next_block() else {
                    return Ok(Frame::End);
                };
                let (interface_id, ticks, data) = match block?.into_owned() {
                    // pcap-file hands the raw counter over as if it were nanoseconds.
                    Block::EnhancedPacket(frame) => {
                        (frame.interface_id, frame.timestamp.as_nanos(), frame.data)
                    }
                    // Its older form. The upper half comes first, in either order of bytes; pcap-file takes it for one number.
                    Block::Packet(frame) => {
                        let ticks = match reader.section().endianness {
                            Endianness::Big => frame.timestamp,
                            Endianness::Little => frame.timestamp.rotate_left(32),
                        };
                        let id = u32::from(frame.interface_id);
                        (id, u128::from(ticks), frame.data)
                    }
                    Block::SimplePacket(_) => {
                        return Err(PcapError::InvalidField(
                            "simple packet blocks have no time: capture again with enhanced packet blocks",
                        ));
                    }
                    _ => return Ok(Frame::None),
                };
                let interface = reader
                    .interfaces()
                    .get(interface_id as usize)
                    .ok_or(PcapError::InvalidInterfaceId(interface_id))?;
                let resolution = interface.options.iter().find_map(|option| match option {
                    InterfaceDescriptionOption::IfTsResol(code) => Some(*code),
                    _ => None,
                });
                let nanos = nanos_of(ticks, resolution.unwrap_or(6));
                let found = datagram(interface.linktype, &data, ports, &mut self.fragments);
                (nanos, found.into_owned())
            }
        };
        self.frames += 1;
        Ok(match found {
            Found::Payload { sender, bytes } => {
                self.last_sender = sender;
                Frame::Packet(Packet {
                    arrival: Timestamp::from_nanos(nanos),
                    bytes: bytes.into_owned(),
                })
            }
            Found::Part => Frame::None,
            Found::Other(passed) => {
                self.skipped += 1;
                self.survey.note(passed);
                Frame::None
            }
        })
    }
}

/// What the file holds next.
enum Frame {
    Packet(Packet),
    None,
    End,
}

/// What a frame holds.
enum Found<'a> {
    Payload {
        sender: Option<IpAddr>,
        bytes: Cow<'a, [u8]>,
    },
    /// A fragment of a datagram that is not complete yet.
    Part,
    Other(Passed),
}

impl Found<'_> {
    fn into_owned(self) -> Found<'static> {
        match self {
            Self::Payload { sender, bytes } => Found::Payload {
                sender,
                bytes: Cow::Owned(bytes.into_owned()),
            },
            Self::Part => Found::Part,
            Self::Other(passed) => Found::Other(passed),
        }
    }
}

impl PacketSource for PcapSource {
    fn recv(&mut self, _timeout: Duration) -> Result<Option<Packet>, Error> {
        loop {
            if self.ended {
                return Err(Error::EndOfStream {
                    device: self.path.display().to_string(),
                });
            }
            match self.read_frame() {
                Ok(Frame::Packet(packet)) => return Ok(Some(packet)),
                Ok(Frame::None) => {}
                Ok(Frame::End) => self.ended = true,
                Err(error) => {
                    self.ended = true;
                    let position = format!("frame {}", self.frames);
                    let problem =
                        format!("{}; the frames before it are complete", describe(&error));
                    return Err(damaged(&self.path, position, problem));
                }
            }
        }
    }

    fn sender(&self) -> Option<IpAddr> {
        self.last_sender
    }
}

/// The UDP payload of a frame, where there is one for a wanted port.
fn datagram<'a>(
    link: DataLink,
    frame: &'a [u8],
    ports: &[u16],
    fragments: &mut Fragments,
) -> Found<'a> {
    if u32::from(link) == BARE_LINK {
        return Found::Payload {
            sender: None,
            bytes: frame.into(),
        };
    }
    let Some(sliced) = slice(link, frame) else {
        return Found::Other(Passed::Unreadable);
    };
    let sender = match &sliced.net {
        Some(LaxNetSlice::Ipv4(ip)) => Some(IpAddr::V4(ip.header().source_addr())),
        Some(LaxNetSlice::Ipv6(ip)) => Some(IpAddr::V6(ip.header().source_addr())),
        _ => None,
    };
    match (sliced.transport, sliced.net) {
        (Some(TransportSlice::Udp(udp)), _) => {
            let port = udp.destination_port();
            if ports.is_empty() || ports.contains(&port) {
                return Found::Payload {
                    sender,
                    bytes: udp.payload().into(),
                };
            }
            Found::Other(Passed::Udp {
                sender,
                port,
                payload: udp.payload().to_vec(),
            })
        }
        (Some(TransportSlice::Tcp(_)), _) => Found::Other(Passed::Tcp),
        (None, Some(LaxNetSlice::Ipv4(part))) if part.is_payload_fragmented() => {
            match fragments.push(&part) {
                Fragment::Waiting => Found::Part,
                Fragment::Useless => Found::Other(Passed::Unreadable),
                Fragment::Complete(udp) => match payload(&udp, ports) {
                    Some(bytes) => Found::Payload {
                        sender,
                        bytes: bytes.to_vec().into(),
                    },
                    None => {
                        let bytes = payload(&udp, &[]).unwrap_or_default();
                        let port = udp.get(2..4).and_then(|p| p.try_into().ok());
                        let port = port.map_or(0, u16::from_be_bytes);
                        Found::Other(Passed::Udp {
                            sender,
                            port,
                            payload: bytes.to_vec(),
                        })
                    }
                },
            }
        }
        _ => Found::Other(Passed::NoUdp),
    }
}

fn slice(link: DataLink, frame: &[u8]) -> Option<LaxSlicedPacket<'_>> {
    match link {
        DataLink::ETHERNET => LaxSlicedPacket::from_ethernet(frame).ok(),
        DataLink::RAW | DataLink::IPV4 | DataLink::IPV6 => LaxSlicedPacket::from_ip(frame).ok(),
        DataLink::LINUX_SLL => {
            LinuxSllSlice::from_slice(frame).ok()?;
            LaxSlicedPacket::from_ip(frame.get(LINUX_SLL_LEN..)?).ok()
        }
        _ => None,
    }
}

/// A pcapng counter in nanoseconds; the resolution is a negative power of ten, or of two where the top bit is set.
fn nanos_of(ticks: u128, resolution: u8) -> i64 {
    let exponent = u32::from(resolution & 0x7F);
    let nanos = if resolution & 0x80 == 0 {
        match exponent {
            0..=9 => ticks.saturating_mul(10u128.pow(9 - exponent)),
            10..=38 => ticks / 10u128.pow(exponent - 9),
            _ => 0,
        }
    } else {
        ticks.saturating_mul(1_000_000_000) >> exponent.min(127)
    };
    i64::try_from(nanos).unwrap_or(i64::MAX)
}

fn describe(error: &PcapError) -> String {
    match error {
        PcapError::IoError(cause) if cause.kind() == std::io::ErrorKind::UnexpectedEof => {
            "the file is truncated or the frame's length is wrong".into()
        }
        PcapError::IoError(cause) => cause.to_string(),
        other => other.to_string(),
    }
}

fn damaged(path: &Path, position: String, problem: String) -> Error {
    Error::File {
        path: path.to_owned(),
        position,
        problem,
    }
}

#[cfg(test)]
mod tests;
