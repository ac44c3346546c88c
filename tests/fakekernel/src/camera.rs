//! The unit and the kernel's half of the conversation, as `linux/videodev2.h` lays it out on 64-bit machines.

use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io;
use std::os::fd::IntoRawFd;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::time::Duration;

use crate::camera_script::{End, Script};
use crate::{memory_file, monotonic};

pub type Errno = i32;

const G_FMT: u64 = 0xC0D0_5604;
const S_FMT: u64 = 0xC0D0_5605;
const REQBUFS: u64 = 0xC014_5608;
const QUERYBUF: u64 = 0xC058_5609;
const QBUF: u64 = 0xC058_560F;
const DQBUF: u64 = 0xC058_5611;
const STREAMON: u64 = 0x4004_5612;
const STREAMOFF: u64 = 0x4004_5613;
const G_PARM: u64 = 0xC0CC_5615;
const S_PARM: u64 = 0xC0CC_5616;
const G_CTRL: u64 = 0xC008_561B;
const S_CTRL: u64 = 0xC008_561C;

const YUYV: u32 = u32::from_le_bytes(*b"YUYV");
const FIELD_NONE: u32 = 1;
const TIMESTAMP_MONOTONIC: u32 = 0x2000;
const EXTENSION_UNIT: u8 = 3;
const SET_CUR: u8 = 0x01;
/// Sizes and rates that the unit has; it takes the first for any other.
const SIZES: [(u32, u32); 2] = [(1280, 400), (2560, 800)];
const RATES_HZ: [u32; 4] = [10, 20, 30, 60];
const MAX_BUFFERS: u32 = 32;
/// Brightness, contrast and gain, and the values they take.
const CONTROLS: [u32; 3] = [0x0098_0900, 0x0098_0901, 0x0098_0913];
const CONTROL_RANGE: std::ops::RangeInclusive<u32> = 0..=1000;

/// What `poll` shall say.
pub enum Ready {
    After(Duration),
    Never,
    Failed,
}

pub struct Unit {
    script: Script,
    memory: File,
    size: (u32, u32),
    rate_hz: u32,
    buffers: u32,
    queued: VecDeque<u32>,
    /// `CLOCK_MONOTONIC` at which the stream started.
    started: Option<Duration>,
    /// The last write to the extension unit, on whatever channel.
    written: Vec<u8>,
    /// Control → value.
    controls: BTreeMap<u32, u32>,
}

impl Unit {
    /// The unit that does what the script at `path` says, and the program's descriptor of its memory.
    pub fn plug_in(path: &Path) -> io::Result<(Self, i32)> {
        let script = Script::parse(&std::fs::read(path)?).ok_or(io::ErrorKind::InvalidData)?;
        let memory = memory_file()?;
        let fd = memory.try_clone()?.into_raw_fd();
        let unit = Self {
            script,
            memory,
            size: SIZES[1],
            rate_hz: RATES_HZ[0],
            buffers: 0,
            queued: VecDeque::new(),
            started: None,
            written: Vec::new(),
            controls: BTreeMap::new(),
        };
        Ok((unit, fd))
    }

    /// When the next frame can be taken.
    pub fn ready(&self) -> Ready {
        let Some(started) = self.started else {
            return Ready::Failed;
        };
        match self.script.frames.front() {
            Some(frame) if !self.queued.is_empty() => {
                let due = started + self.interval() * (frame.sequence + 1);
                Ready::After(due.saturating_sub(monotonic()))
            }
            None if self.script.end == End::Unplug => Ready::Failed,
            _ => Ready::Never,
        }
    }

    /// Carries out `request` on its argument.
    pub fn request(&mut self, request: u64, argument: &mut [u8]) -> Result<(), Errno> {
        self.check_plugged()?;
        match request {
            G_FMT | S_FMT => {
                if request == S_FMT {
                    if self.buffers > 0 {
                        return Err(libc::EBUSY);
                    }
                    let asked = (get(argument, 8)?, get(argument, 12)?);
                    let known = SIZES.into_iter().find(|&size| size == asked);
                    self.size = known.unwrap_or(SIZES[0]);
                }
                let (width, height) = self.size;
                let size_bytes = self.frame_bytes();
                for (offset, value) in [
                    (8, width),
                    (12, height),
                    (16, YUYV),
                    (20, FIELD_NONE),
                    (24, 2 * width),
                    (28, size_bytes),
                ] {
                    put(argument, offset, value)?;
                }
            }
            G_PARM | S_PARM => {
                if request == S_PARM {
                    let (numerator, denominator) = (get(argument, 12)?, get(argument, 16)?);
                    let known = RATES_HZ
                        .into_iter()
                        .find(|rate_hz| rate_hz * numerator == denominator);
                    self.rate_hz = known.unwrap_or(RATES_HZ[0]);
                }
                put(argument, 12, 1)?;
                put(argument, 16, self.rate_hz)?;
            }
            G_CTRL | S_CTRL => {
                let id = get(argument, 0)?;
                if !CONTROLS.contains(&id) {
                    return Err(libc::EINVAL);
                }
                if request == G_CTRL {
                    let value = self.controls.get(&id).copied().unwrap_or_default();
                    return put(argument, 4, value);
                }
                let value = get(argument, 4)?;
                if !CONTROL_RANGE.contains(&value) {
                    return Err(libc::ERANGE);
                }
                self.controls.insert(id, value);
            }
            REQBUFS => {
                self.buffers = get(argument, 0)?.min(MAX_BUFFERS);
                self.queued.clear();
                let len = u64::from(self.buffers) * u64::from(self.buffer_bytes());
                self.memory.set_len(len).map_err(|_| libc::ENOMEM)?;
                put(argument, 0, self.buffers)?;
            }
            QUERYBUF => {
                let index = self.buffer_index(argument)?;
                put(argument, 64, index * self.buffer_bytes())?;
                put(argument, 72, self.buffer_bytes())?;
            }
            QBUF => {
                let index = self.buffer_index(argument)?;
                if self.queued.contains(&index) {
                    return Err(libc::EINVAL);
                }
                self.queued.push_back(index);
            }
            DQBUF => self.dequeue(argument)?,
            STREAMON => self.started = Some(monotonic()),
            STREAMOFF => {
                self.started = None;
                self.queued.clear();
            }
            _ => return Err(libc::ENOTTY),
        }
        Ok(())
    }

    /// Carries out a transaction; an unknown one is stalled.
    pub fn query_extension_unit(
        &mut self,
        unit: u8,
        selector: u8,
        query: u8,
        data: &mut [u8],
    ) -> Result<(), Errno> {
        self.check_plugged()?;
        if unit != EXTENSION_UNIT {
            return Err(libc::ENOENT);
        }
        if query == SET_CUR {
            let known = self.script.writes.iter();
            let known = known.filter(|(s, _)| *s == selector);
            if !known.into_iter().any(|(_, bytes)| bytes == data) {
                return Err(libc::EPIPE);
            }
            self.written = data.to_vec();
            return Ok(());
        }
        let answer = self.script.answers.iter().find(|answer| {
            (answer.selector, answer.query, &answer.written) == (selector, query, &self.written)
        });
        let answer = answer.ok_or(libc::EPIPE)?;
        if answer.bytes.len() != data.len() {
            return Err(libc::ENOBUFS);
        }
        data.copy_from_slice(&answer.bytes);
        Ok(())
    }

    fn dequeue(&mut self, argument: &mut [u8]) -> Result<(), Errno> {
        let started = self.started.ok_or(libc::EINVAL)?;
        let Ready::After(Duration::ZERO) = self.ready() else {
            return Err(libc::EAGAIN);
        };
        let frame = self.script.frames.pop_front().ok_or(libc::EAGAIN)?;
        let index = self.queued.pop_front().ok_or(libc::EAGAIN)?;
        let offset = u64::from(index) * u64::from(self.buffer_bytes());
        self.memory
            .write_all_at(&frame.bytes, offset)
            .map_err(|_| libc::EIO)?;
        let stamp = started + self.interval() * (frame.sequence + 1);
        for (offset, value) in [
            (0, index),
            (8, frame.bytes.len() as u32),
            (12, frame.flags | TIMESTAMP_MONOTONIC),
            (16, FIELD_NONE),
            (24, stamp.as_secs() as u32),
            (28, (stamp.as_secs() >> 32) as u32),
            (32, stamp.subsec_micros()),
            (36, 0),
            (56, frame.sequence),
        ] {
            put(argument, offset, value)?;
        }
        Ok(())
    }

    /// An unplugged unit is noticed once the frames above are taken; a stream that has not begun has its unit.
    fn check_plugged(&self) -> Result<(), Errno> {
        let gone = self.script.end == End::Unplug && self.script.frames.is_empty();
        if gone { Err(libc::ENODEV) } else { Ok(()) }
    }

    fn buffer_index(&self, argument: &[u8]) -> Result<u32, Errno> {
        Some(get(argument, 0)?)
            .filter(|&index| index < self.buffers)
            .ok_or(libc::EINVAL)
    }

    fn interval(&self) -> Duration {
        Duration::from_secs(1) / self.rate_hz
    }

    fn frame_bytes(&self) -> u32 {
        self.size.0 * self.size.1 * 2
    }

    /// Whole pages, so that each buffer can be mapped.
    fn buffer_bytes(&self) -> u32 {
        self.frame_bytes().next_multiple_of(4096)
    }
}

fn get(bytes: &[u8], offset: usize) -> Result<u32, Errno> {
    let tail = bytes.get(offset..).ok_or(libc::EINVAL)?;
    tail.first_chunk()
        .map(|&word| u32::from_le_bytes(word))
        .ok_or(libc::EINVAL)
}

fn put(bytes: &mut [u8], offset: usize, value: u32) -> Result<(), Errno> {
    let tail = bytes.get_mut(offset..).ok_or(libc::EINVAL)?;
    *tail.first_chunk_mut().ok_or(libc::EINVAL)? = value.to_le_bytes();
    Ok(())
}
