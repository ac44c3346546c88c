//! Serial lines, and the pseudo-terminals that stand for them.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use lsfb_types::Packet;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::openpty;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use nix::unistd::ttyname;
use serialport::{SerialPort as _, TTYPort};

use super::{PacketSource, arrival_now};
use crate::Error;

/// Bytes read at once: what a tty buffers at most.
const CHUNK_BYTES: usize = 4096;
/// How long a write may wait for the line before the device counts as lost.
const WRITE_TIMEOUT: Duration = Duration::from_secs(2);
/// How often a waiting pseudo-terminal looks whether its reader is still there.
const PEER_CHECK: Duration = Duration::from_millis(5);
/// How long a line must look empty before it is: the kernel hands written bytes over to the reader's side later, and
/// meanwhile they can be seen on neither.
const SETTLE: Duration = Duration::from_millis(250);

/// An open serial line in raw mode, 8 data bits, no parity, no flow control.
#[derive(Debug)]
pub struct SerialLine {
    port: TTYPort,
    device: String,
    /// The other side of a pseudo-terminal closes to say that it is done; a real line hangs up when it is unplugged.
    hang_up_is_end: bool,
    ended: bool,
}

impl SerialLine {
    /// Opens `path` at `baud`. A real line is opened exclusively: a second reader would steal bytes.
    pub fn open(path: &Path, baud: u32) -> Result<Self, Error> {
        let device = path.display().to_string();
        let pseudo_terminal = path
            .canonicalize()
            .is_ok_and(|real| real.starts_with("/dev/pts"));
        let builder = serialport::new(device.as_str(), baud).timeout(WRITE_TIMEOUT);
        let opened = TTYPort::open(&builder.exclusive(!pseudo_terminal));
        let port = opened.map_err(|e| Error::Open {
            device: device.clone(),
            action: "open the serial line",
            cause: e.into(),
        })?;
        Ok(Self {
            port,
            device,
            hang_up_is_end: pseudo_terminal,
            ended: false,
        })
    }

    /// Sends all of `bytes`.
    pub fn send(&mut self, bytes: &[u8]) -> Result<(), Error> {
        let sent = self
            .port
            .set_timeout(WRITE_TIMEOUT)
            .map_err(io::Error::from)
            .and_then(|()| self.port.write_all(bytes));
        sent.map_err(|cause| Error::Send {
            device: self.device.clone(),
            cause,
        })
    }

    /// The path as the user named it.
    pub fn device(&self) -> &str {
        &self.device
    }

    fn hung_up(&mut self, cause: io::Error) -> Error {
        let device = self.device.clone();
        if self.hang_up_is_end {
            self.ended = true;
            Error::EndOfStream { device }
        } else {
            Error::Lost { device, cause }
        }
    }
}

impl PacketSource for SerialLine {
    /// Whatever arrived, up to 4 KiB: a packet here is a piece of the byte stream, not a message.
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        if self.ended {
            return Err(Error::EndOfStream {
                device: self.device.clone(),
            });
        }
        if let Err(e) = self.port.set_timeout(timeout) {
            return Err(self.hung_up(e.into()));
        }
        let mut bytes = vec![0; CHUNK_BYTES];
        match self.port.read(&mut bytes) {
            Ok(0) => Err(self.hung_up(io::ErrorKind::UnexpectedEof.into())),
            Ok(len) => {
                bytes.truncate(len);
                Ok(Some(Packet {
                    arrival: arrival_now(),
                    bytes,
                }))
            }
            Err(e)
                if matches!(
                    e.kind(),
                    io::ErrorKind::TimedOut
                        | io::ErrorKind::WouldBlock
                        | io::ErrorKind::Interrupted
                ) =>
            {
                Ok(None)
            }
            Err(e) => Err(self.hung_up(e)),
        }
    }
}

/// The device's side of a pseudo-terminal: what a mock IMU holds while the driver opens [`Pty::path`].
///
/// Nothing is ever lost: a write waits for its reader to open the line and to make room.
#[derive(Debug)]
pub struct Pty {
    master: File,
    path: PathBuf,
    reader_seen: bool,
}

impl Pty {
    /// Makes a new pair in raw mode.
    pub fn open() -> Result<Self, Error> {
        let (master, path) = raw_pair().map_err(|e| Error::Open {
            device: "pseudo-terminal".to_owned(),
            action: "create the pair",
            cause: e.into(),
        })?;
        Ok(Self {
            master: master.into(),
            path,
            reader_seen: false,
        })
    }

    /// What the driver opens as its serial line.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Sends all of `bytes`, waiting as long as the reader is there but slow, or not there yet.
    pub fn send(&mut self, mut bytes: &[u8]) -> Result<(), Error> {
        while !bytes.is_empty() {
            match self.wait(PollFlags::POLLOUT, PEER_CHECK)? {
                Peer::Ready => match self.master.write(bytes) {
                    Ok(len) => bytes = bytes.get(len..).unwrap_or_default(),
                    Err(e) if try_again(&e) => {}
                    Err(e) => return Err(self.lost(e)),
                },
                // Hang-up is a level: polling it again would spin.
                Peer::Absent => thread::sleep(PEER_CHECK),
                Peer::Busy => {}
            }
        }
        Ok(())
    }

    /// What the reader sent, waiting up to `timeout`.
    pub fn recv(&mut self, timeout: Duration) -> Result<Option<Vec<u8>>, Error> {
        let deadline = Instant::now() + timeout;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.wait(PollFlags::POLLIN, left)? {
                Peer::Ready => {
                    let mut bytes = vec![0; CHUNK_BYTES];
                    match self.master.read(&mut bytes) {
                        Ok(0) => return Err(self.lost(io::ErrorKind::UnexpectedEof.into())),
                        Ok(len) => {
                            bytes.truncate(len);
                            return Ok(Some(bytes));
                        }
                        Err(e) if try_again(&e) => {}
                        Err(e) => return Err(self.lost(e)),
                    }
                }
                Peer::Absent => thread::sleep(left.min(PEER_CHECK)),
                Peer::Busy => {}
            }
            if Instant::now() >= deadline {
                return Ok(None);
            }
        }
    }

    /// Waits until the reader has taken every byte, then closes: the reader sees the end of its stream. Closing earlier
    /// would discard what still lies in the line.
    pub fn finish(mut self, timeout: Duration) -> Result<(), Error> {
        let deadline = Instant::now() + timeout;
        let mut empty_since = None;
        loop {
            let now = Instant::now();
            if !self.drained()? {
                empty_since = None;
            } else if now - *empty_since.get_or_insert(now) >= SETTLE {
                return Ok(());
            }
            if now >= deadline {
                return Err(self.lost(io::ErrorKind::TimedOut.into()));
            }
            thread::sleep(Duration::from_millis(1));
        }
    }

    /// Whether nothing waits to be read on the other side, seen through a second handle to it.
    fn drained(&mut self) -> Result<bool, Error> {
        if let Peer::Absent = self.wait(PollFlags::POLLOUT, Duration::ZERO)? {
            return Ok(false);
        }
        let slave = OpenOptions::new()
            .read(true)
            .custom_flags((OFlag::O_NOCTTY | OFlag::O_NONBLOCK).bits())
            .open(&self.path)
            .map_err(|e| self.lost(e))?;
        let mut fds = [PollFd::new(slave.as_fd(), PollFlags::POLLIN)];
        let readable = poll(&mut fds, PollTimeout::ZERO).map_err(|e| self.lost(e.into()))?;
        Ok(readable == 0)
    }

    fn wait(&mut self, wanted: PollFlags, timeout: Duration) -> Result<Peer, Error> {
        let timeout = PollTimeout::try_from(timeout).unwrap_or(PollTimeout::MAX);
        let mut fds = [PollFd::new(self.master.as_fd(), wanted)];
        match poll(&mut fds, timeout) {
            Ok(_) | Err(nix::errno::Errno::EINTR) => {}
            Err(e) => return Err(self.lost(e.into())),
        }
        let got = fds[0].revents().unwrap_or(PollFlags::empty());
        if got.contains(PollFlags::POLLHUP) && !got.contains(PollFlags::POLLIN) {
            if self.reader_seen {
                return Err(self.lost(io::ErrorKind::BrokenPipe.into()));
            }
            return Ok(Peer::Absent);
        }
        self.reader_seen = true;
        Ok(if got.intersects(wanted) {
            Peer::Ready
        } else {
            Peer::Busy
        })
    }

    fn lost(&self, cause: io::Error) -> Error {
        Error::Lost {
            device: self.path.display().to_string(),
            cause,
        }
    }
}

/// What a look at the line found.
enum Peer {
    /// The wanted direction is open.
    Ready,
    /// A reader holds the line, but nothing can be moved now.
    Busy,
    /// No reader has opened the line yet.
    Absent,
}

fn try_again(e: &io::Error) -> bool {
    matches!(
        e.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
    )
}

/// A pair in raw mode whose second side is closed again, so that hang-up tells whether a reader is there.
fn raw_pair() -> nix::Result<(OwnedFd, PathBuf)> {
    let pair = openpty(None, None)?;
    let mut settings = tcgetattr(&pair.slave)?;
    cfmakeraw(&mut settings);
    tcsetattr(&pair.slave, SetArg::TCSANOW, &settings)?;
    let path = ttyname(&pair.slave)?;
    fcntl(&pair.master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK))?;
    Ok((pair.master, path))
}
