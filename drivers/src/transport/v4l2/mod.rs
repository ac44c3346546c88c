//! A camera behind a V4L2 capture node of the kernel's UVC driver.
//!
//! Frames come through mapped buffers, stamped by the kernel on `CLOCK_MONOTONIC` when their first bytes arrived; the
//! stamps are moved to host time by one offset, taken when the stream starts, so that a clock that is set later does
//! not tear the stream. The kernel numbers frames, also those that it could not hand over: [`LinkCounters::missing`].

mod ioctl;

use std::fmt;
use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

use lsfb_types::{Packet, Timestamp};
use nix::errno::Errno;
use nix::time::{ClockId, clock_gettime};
use v4l::buffer::{Flags, Metadata, Type};
use v4l::io::mmap;
use v4l::io::traits::{CaptureStream, Stream};
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Format, FourCC};

use super::uvc::LinkCounters;
use super::{PacketSource, arrival_now};
use crate::Error;
use crate::transport::uvc::{EXTENSION_UNIT, FrameFormat, ImageControl, XuQuery, XuSelector};

/// Buffers between the kernel and us: a second and more at 20 Hz, as many as the vendor's SDK asks for.
const BUFFERS: u32 = 24;
/// `poll` has said that a frame is there; taking it does not wait.
const DEQUEUE_TIMEOUT: Duration = Duration::from_secs(1);

/// An open capture node.
pub(super) struct NodeLink {
    device: String,
    node: Device,
    stream: Option<NodeStream>,
    counters: LinkCounters,
}

struct NodeStream {
    buffers: mmap::Stream<'static>,
    host_from_monotonic_ns: i64,
    last_sequence: Option<u32>,
}

impl NodeLink {
    pub(super) fn open(path: &Path) -> Result<Self, Error> {
        let device = path.display().to_string();
        let failed = |action, cause| Error::Open {
            device: device.clone(),
            action,
            cause,
        };
        let node =
            Device::with_path(path).map_err(|cause| failed("open the camera node", cause))?;
        // Whatever is no capture node, the metadata node of the same unit for one, has no format.
        node.format().map_err(|cause| {
            let problem = format!("not a V4L2 capture node: {cause}");
            failed(
                "open the camera node",
                io::Error::new(cause.kind(), problem),
            )
        })?;
        Ok(Self {
            device,
            node,
            stream: None,
            counters: LinkCounters::default(),
        })
    }

    pub(super) fn device(&self) -> &str {
        &self.device
    }

    pub(super) fn counters(&self) -> LinkCounters {
        self.counters
    }

    pub(super) fn start(&mut self, format: FrameFormat, rate_hz: u32) -> Result<(), Error> {
        // The buffers of an earlier stream go first: no format can be set while there are any.
        self.stream = None;
        self.set_format(format)?;
        self.set_rate(rate_hz)?;
        let stream = NodeStream::start(&self.node)
            .map_err(|cause| self.failed("start the stream", cause))?;
        self.stream = Some(stream);
        Ok(())
    }

    pub(super) fn xu_set(&mut self, selector: XuSelector, bytes: &[u8]) -> Result<(), Error> {
        self.transact(selector, XuQuery::SetCur, &mut bytes.to_vec())
    }

    pub(super) fn xu_get(
        &mut self,
        selector: XuSelector,
        query: XuQuery,
    ) -> Result<Vec<u8>, Error> {
        let mut bytes = vec![0; selector.len_bytes()];
        self.transact(selector, query, &mut bytes)?;
        Ok(bytes)
    }

    fn transact(
        &self,
        selector: XuSelector,
        query: XuQuery,
        bytes: &mut [u8],
    ) -> Result<(), Error> {
        let handle = self.node.handle();
        ioctl::query_extension_unit(&handle, EXTENSION_UNIT, selector.id(), query.code(), bytes)
            .map_err(|cause| {
                if is_unplugged(&cause) {
                    return self.lost(cause);
                }
                self.protocol(format!(
                    "the unit rejected query {:#04x} of selector {}: {cause}",
                    query.code(),
                    selector.id()
                ))
            })
    }

    pub(super) fn control_set(&mut self, control: ImageControl, value: i32) -> Result<(), Error> {
        ioctl::set_control(&self.node.handle(), control.v4l2_id(), value)
            .map_err(|cause| self.control_refused(control, cause))
    }

    pub(super) fn control_get(&mut self, control: ImageControl) -> Result<i32, Error> {
        ioctl::control(&self.node.handle(), control.v4l2_id())
            .map_err(|cause| self.control_refused(control, cause))
    }

    fn control_refused(&self, control: ImageControl, cause: io::Error) -> Error {
        if is_unplugged(&cause) {
            return self.lost(cause);
        }
        self.protocol(format!(
            "the unit rejected its control {control:?}: {cause}"
        ))
    }

    fn set_format(&self, format: FrameFormat) -> Result<(), Error> {
        let yuyv = FourCC::new(b"YUYV");
        let got = self
            .node
            .set_format(&Format::new(format.width, format.height, yuyv))
            .map_err(|cause| self.failed("set the frame format", cause))?;
        let same_size = (got.width, got.height) == (format.width, format.height);
        if !same_size || got.fourcc != yuyv || got.stride != 2 * format.width {
            return Err(self.protocol(format!(
                "asked for {}x{} YUYV, the unit gives {}x{} {} with rows of {} bytes; is it on a USB 3 port?",
                format.width, format.height, got.width, got.height, got.fourcc, got.stride
            )));
        }
        Ok(())
    }

    fn set_rate(&self, rate_hz: u32) -> Result<(), Error> {
        let got = self
            .node
            .set_params(&Parameters::with_fps(rate_hz))
            .map_err(|cause| self.failed("set the frame rate", cause))?
            .interval;
        if u64::from(got.numerator) * u64::from(rate_hz) != u64::from(got.denominator) {
            return Err(self.protocol(format!(
                "asked for {rate_hz} Hz, the unit gives {}/{} Hz; is it on a USB 3 port?",
                got.denominator, got.numerator
            )));
        }
        Ok(())
    }

    fn failed(&self, action: &'static str, cause: io::Error) -> Error {
        if is_unplugged(&cause) {
            return self.lost(cause);
        }
        Error::Open {
            device: self.device.clone(),
            action,
            cause,
        }
    }

    fn lost(&self, cause: io::Error) -> Error {
        Error::Lost {
            device: self.device.clone(),
            cause,
        }
    }

    fn protocol(&self, problem: String) -> Error {
        Error::Protocol {
            device: self.device.clone(),
            problem,
        }
    }
}

impl PacketSource for NodeLink {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        let Some(stream) = &mut self.stream else {
            return Err(
                self.protocol("waiting for a frame of a stream that was not started".into())
            );
        };
        match stream.next(timeout, &mut self.counters) {
            Ok(packet) => Ok(packet),
            Err(cause) => Err(self.lost(cause)),
        }
    }
}

impl fmt::Debug for NodeLink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("NodeLink")
            .field("device", &self.device)
            .field("counters", &self.counters)
            .finish_non_exhaustive()
    }
}

impl NodeStream {
    fn start(node: &Device) -> io::Result<Self> {
        let mut buffers = mmap::Stream::with_buffers(node, Type::VideoCapture, BUFFERS)?;
        buffers.set_timeout(DEQUEUE_TIMEOUT);
        // Buffer 0 is the one in hand, which `next` gives back first; it would queue all on its own, but then wait.
        for index in 1..BUFFERS {
            CaptureStream::queue(&mut buffers, index as usize)?;
        }
        let host_from_monotonic_ns = host_from_monotonic_ns()?;
        buffers.start()?;
        Ok(Self {
            buffers,
            host_from_monotonic_ns,
            last_sequence: None,
        })
    }

    fn next(
        &mut self,
        timeout: Duration,
        counters: &mut LinkCounters,
    ) -> io::Result<Option<Packet>> {
        // The crate gives its buffer in hand back before it waits, and again on the next call where the wait was in
        // vain. So the waiting is ours.
        if !self.wait(timeout)? {
            return Ok(None);
        }
        let (bytes, frame) = CaptureStream::next(&mut self.buffers)?;
        let used = bytes.get(..frame.bytesused as usize).unwrap_or(bytes);
        let packet = Packet {
            arrival: arrival(frame, self.host_from_monotonic_ns),
            bytes: used.to_vec(),
        };
        counters.frames += 1;
        counters.damaged += u64::from(frame.flags.contains(Flags::ERROR));
        if let Some(last) = self.last_sequence {
            let step = frame.sequence.wrapping_sub(last);
            counters.missing += u64::from(step.saturating_sub(1));
        }
        self.last_sequence = Some(frame.sequence);
        Ok(Some(packet))
    }

    /// Whether a frame, or a failure, is there.
    fn wait(&self, timeout: Duration) -> io::Result<bool> {
        const POLLIN: i16 = 1;
        let deadline = Instant::now() + timeout;
        loop {
            // Rounded up: a wait that ends early would come back for nothing.
            let left = deadline.saturating_duration_since(Instant::now());
            let left_ms = i32::try_from(left.as_micros().div_ceil(1000)).unwrap_or(i32::MAX);
            match self.buffers.handle().poll(POLLIN, left_ms) {
                Ok(ready) => return Ok(ready > 0),
                Err(cause) if cause.kind() == io::ErrorKind::Interrupted => {}
                Err(cause) => return Err(cause),
            }
        }
    }
}

/// When the frame's first bytes arrived, in host time; now, where the driver stamps by another clock.
fn arrival(frame: &Metadata, host_from_monotonic_ns: i64) -> Timestamp {
    if frame.flags & Flags::TIMESTAMP_MASK != Flags::TIMESTAMP_MONOTONIC {
        return arrival_now();
    }
    let seconds_ns = frame.timestamp.sec.saturating_mul(1_000_000_000);
    let monotonic_ns = seconds_ns.saturating_add(frame.timestamp.usec.saturating_mul(1_000));
    Timestamp::from_nanos(monotonic_ns.saturating_add(host_from_monotonic_ns))
}

/// Host time minus `CLOCK_MONOTONIC`.
fn host_from_monotonic_ns() -> io::Result<i64> {
    let monotonic_ns = || -> io::Result<i64> {
        let time = clock_gettime(ClockId::CLOCK_MONOTONIC)?;
        Ok(time.tv_sec() * 1_000_000_000 + time.tv_nsec())
    };
    let before_ns = monotonic_ns()?;
    let host_ns = arrival_now().nanos();
    let after_ns = monotonic_ns()?;
    Ok(host_ns - before_ns - (after_ns - before_ns) / 2)
}

/// The node has gone, together with its unit.
fn is_unplugged(cause: &io::Error) -> bool {
    cause.raw_os_error() == Some(Errno::ENODEV as i32)
}
