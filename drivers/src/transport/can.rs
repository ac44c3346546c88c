//! CAN buses through SocketCAN: frames with kernel receive stamps and a counter of what the kernel dropped.

use std::io::{self, IoSliceMut};
use std::os::fd::{AsFd, AsRawFd};
use std::time::{Duration, Instant};

use lsfb_types::{Packet, Timestamp};
use nix::errno::Errno;
use nix::sys::socket::{ControlMessageOwned, MsgFlags, recvmsg, setsockopt, sockopt};
use nix::sys::time::TimeSpec;
use socketcan::{CanFilter, CanSocket, Socket, SocketOptions};

use super::poll::readable;
use super::{PacketSource, arrival_now};
use crate::{Error, WireError};

/// Bytes of a classic frame as the kernel hands it over.
pub const FRAME_LEN: usize = 16;
/// Most data bytes of a classic frame.
pub const MAX_DATA_LEN: usize = 8;

/// A frame takes a tenth of a millisecond on the bus: a queue that stays full belongs to a bus that is down.
const QUEUE_PATIENCE: Duration = Duration::from_secs(1);
const QUEUE_NAP: Duration = Duration::from_micros(500);

const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
const ERROR: u32 = 0x2000_0000;
const STANDARD_MASK: u32 = 0x7FF;

/// A classic frame (`struct can_frame` of `linux/can.h`, little-endian): what a [`CanSource`] yields as bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanFrame {
    /// Identifier with the kernel's flags in its upper three bits.
    id_word: u32,
    len: u8,
    data: [u8; MAX_DATA_LEN],
}

impl CanFrame {
    /// A data frame with an 11-bit identifier. More than eight bytes do not fit; the rest is cut off.
    pub fn standard(id: u16, data: &[u8]) -> Self {
        let mut frame = Self {
            id_word: u32::from(id) & STANDARD_MASK,
            len: data.len().min(MAX_DATA_LEN) as u8,
            data: [0; MAX_DATA_LEN],
        };
        for (to, from) in frame.data.iter_mut().zip(data) {
            *to = *from;
        }
        frame
    }

    /// Reads the 16 bytes.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let &[i0, i1, i2, i3, len, _, _, _, ref data @ ..] = bytes else {
            return Err(WireError::Length {
                expected: FRAME_LEN,
                got: bytes.len(),
            });
        };
        let data = data.try_into().map_err(|_| WireError::Length {
            expected: FRAME_LEN,
            got: bytes.len(),
        })?;
        if usize::from(len) > MAX_DATA_LEN {
            return Err(WireError::Value {
                field: "data length",
                offset: 4,
                got: len.into(),
            });
        }
        Ok(Self {
            id_word: u32::from_le_bytes([i0, i1, i2, i3]),
            len,
            data,
        })
    }

    /// The 16 bytes.
    pub fn emit(&self) -> [u8; FRAME_LEN] {
        let mut bytes = [0; FRAME_LEN];
        bytes[..4].copy_from_slice(&self.id_word.to_le_bytes());
        bytes[4] = self.len;
        bytes[8..].copy_from_slice(&self.data);
        bytes
    }

    /// The identifier of a data frame with an 11-bit one; `None` for every other frame.
    pub fn standard_id(&self) -> Option<u16> {
        let is_standard = self.id_word & (EXTENDED | REMOTE | ERROR) == 0;
        is_standard.then_some((self.id_word & STANDARD_MASK) as u16)
    }

    /// Whether the kernel made it, to tell of an error of the bus.
    pub fn is_error(&self) -> bool {
        self.id_word & ERROR != 0
    }

    /// Its data.
    pub fn data(&self) -> &[u8] {
        self.data.get(..self.len.into()).unwrap_or(&self.data)
    }
}

/// Which bus, and what of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CanConfig {
    /// Network interface, for instance `can0`.
    pub interface: String,
    /// Identifiers of the frames that are wanted, 11 bits each; all where the list is empty.
    pub ids: Vec<u16>,
}

/// Frames of a bus, and errors of the bus, 16 bytes each: see [`CanFrame::parse`].
#[derive(Debug)]
pub struct CanSource {
    socket: CanSocket,
    device: String,
    /// The kernel's own counter, which wraps.
    overflow: u32,
    dropped: u64,
}

impl CanSource {
    /// Opens the interface, sets filters, and asks for stamps and drop counts.
    pub fn open(config: &CanConfig) -> Result<Self, Error> {
        let device = format!("can {}", config.interface);
        let failed = |action| {
            let device = device.clone();
            move |cause: io::Error| Error::Open {
                device,
                action,
                cause,
            }
        };
        let socket = CanSocket::open(&config.interface).map_err(failed("open the interface"))?;
        if !config.ids.is_empty() {
            let exactly = |&id: &u16| CanFilter::new(id.into(), STANDARD_MASK | EXTENDED | REMOTE);
            let filters: Vec<CanFilter> = config.ids.iter().map(exactly).collect();
            socket
                .set_filters(&filters)
                .map_err(failed("set the filters"))?;
        }
        socket
            .set_error_filter_accept_all()
            .map_err(failed("request bus errors"))?;
        setsockopt(&socket, sockopt::ReceiveTimestampns, &true)
            .map_err(|e| failed("request kernel receive stamps")(e.into()))?;
        setsockopt(&socket, sockopt::RxqOvfl, &1)
            .map_err(|e| failed("request the drop counter")(e.into()))?;
        Ok(Self {
            socket,
            device,
            overflow: 0,
            dropped: 0,
        })
    }

    /// Frames that the kernel dropped because nobody took them, known as of the last frame received.
    pub fn kernel_drops(&self) -> u64 {
        self.dropped
    }

    /// Puts a frame on the bus.
    pub fn send(&mut self, frame: &CanFrame) -> Result<(), Error> {
        let sent = nix::unistd::write(&self.socket, &frame.emit());
        match sent {
            Ok(FRAME_LEN) => Ok(()),
            Ok(_) => Err(self.unsent(io::ErrorKind::WriteZero.into())),
            Err(errno) => Err(self.unsent(errno.into())),
        }
    }

    fn unsent(&self, cause: io::Error) -> Error {
        Error::Send {
            device: self.device.clone(),
            cause,
        }
    }

    fn lost(&self, cause: io::Error) -> Error {
        Error::Lost {
            device: self.device.clone(),
            cause,
        }
    }

    fn receive(&mut self) -> Result<Option<Packet>, Error> {
        let mut bytes = vec![0; FRAME_LEN];
        let mut control = nix::cmsg_space!(TimeSpec, u32);
        let mut slices = [IoSliceMut::new(&mut bytes)];
        let flags = MsgFlags::MSG_DONTWAIT;
        let received = recvmsg::<()>(
            self.socket.as_raw_fd(),
            &mut slices,
            Some(&mut control),
            flags,
        );
        let message = match received {
            Ok(message) => message,
            Err(Errno::EAGAIN | Errno::EINTR) => return Ok(None),
            Err(errno) => return Err(self.lost(errno.into())),
        };
        let mut arrival = None;
        let controls = message.cmsgs().map_err(|errno| self.lost(errno.into()))?;
        for control in controls {
            match control {
                ControlMessageOwned::ScmTimestampns(stamp) => {
                    let nanos = stamp.tv_sec() * 1_000_000_000 + stamp.tv_nsec();
                    arrival = Some(Timestamp::from_nanos(nanos));
                }
                ControlMessageOwned::RxqOvfl(count) => {
                    self.dropped += u64::from(count.wrapping_sub(self.overflow));
                    self.overflow = count;
                }
                _ => {}
            }
        }
        let len = message.bytes;
        if len == 0 {
            return Err(self.lost(io::ErrorKind::UnexpectedEof.into()));
        }
        bytes.truncate(len);
        Ok(Some(Packet {
            arrival: arrival.unwrap_or_else(arrival_now),
            bytes,
        }))
    }
}

/// Puts frames on a bus, as a device does; hears nothing.
#[derive(Debug)]
pub struct CanSender {
    socket: CanSocket,
    device: String,
}

impl CanSender {
    /// Opens the interface.
    pub fn open(interface: &str) -> Result<Self, Error> {
        let device = format!("can {interface}");
        let failed = |cause| Error::Open {
            device: device.clone(),
            action: "open the interface",
            cause,
        };
        let socket = CanSocket::open(interface).map_err(failed)?;
        socket.set_filter_drop_all().map_err(failed)?;
        Ok(Self { socket, device })
    }

    /// Puts a frame on the bus; waits a little while its queue is full.
    pub fn send(&mut self, frame: &CanFrame) -> Result<(), Error> {
        let began = Instant::now();
        loop {
            match nix::unistd::write(&self.socket, &frame.emit()) {
                Ok(_) => return Ok(()),
                Err(Errno::ENOBUFS | Errno::EAGAIN) if began.elapsed() < QUEUE_PATIENCE => {
                    std::thread::sleep(QUEUE_NAP);
                }
                Err(errno) => {
                    return Err(Error::Send {
                        device: self.device.clone(),
                        cause: errno.into(),
                    });
                }
            }
        }
    }
}

impl PacketSource for CanSource {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        match readable(&self.socket.as_fd(), timeout) {
            Ok(true) => self.receive(),
            Ok(false) => Ok(None),
            Err(cause) => Err(self.lost(cause)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_every_kind_are_read_and_written() {
        let frame = CanFrame::standard(0x123, &[1, 2, 3]);
        assert_eq!(CanFrame::parse(&frame.emit()), Ok(frame));
        assert_eq!(
            (frame.standard_id(), frame.data()),
            (Some(0x123), &[1, 2, 3][..])
        );
        assert_eq!(CanFrame::standard(1, &[9; 20]).data(), [9; 8]);
        for (flag, is_error) in [(0x80, false), (0x40, false), (0x20, true)] {
            let mut bytes = frame.emit();
            bytes[3] |= flag;
            let other = CanFrame::parse(&bytes).unwrap();
            assert_eq!((other.standard_id(), other.is_error()), (None, is_error));
        }
        let mut long = frame.emit();
        long[4] = 9;
        assert!(CanFrame::parse(&long).is_err());
        for len in [0, 4, 15] {
            assert!(CanFrame::parse(&frame.emit()[..len]).is_err());
        }
    }

    #[test]
    fn an_absent_interface_is_an_error_that_names_it() {
        let config = CanConfig {
            interface: "lsfb_no_can".to_owned(),
            ids: vec![1],
        };
        let error = CanSource::open(&config).unwrap_err().to_string();
        assert!(
            error.contains("can lsfb_no_can") && error.contains("open"),
            "{error}"
        );
    }
}
