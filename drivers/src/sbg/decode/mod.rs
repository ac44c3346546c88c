//! CAN frames to inertial readings. No I/O.

use std::collections::VecDeque;

use lsfb_types::{ImuSample, Packet, Timestamp};

use super::model::{ACCELEROMETER_STEPS, GYROSCOPE_STEPS, TEMPERATURE_STEPS};
use super::wire::{SbgMessage, UtcDate};
use crate::transport::can::CanFrame;
use crate::{Decoded, WireError};

/// Steps of the time that the period is taken from.
const STEPS_KEPT: usize = 9;

/// One sample of the unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SbgReading {
    /// Angular velocity and specific force.
    pub sample: ImuSample,
    /// Status bits of the inertial sensors.
    pub status: u16,
    /// Temperature, °C.
    pub temperature_celsius: f64,
    /// The UTC that arrived since the sample before.
    pub utc: Option<UtcFix>,
}

/// Which UTC a time of the unit is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UtcFix {
    /// Time of the unit, microseconds.
    pub time_us: u32,
    /// GPS time of week, milliseconds.
    pub time_of_week_ms: u32,
    /// Date and time of day.
    pub date: UtcDate,
}

/// What the decoder has met so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SbgCounters {
    /// Frames of the unit that were read.
    pub frames: u64,
    /// Samples made of them.
    pub samples: u64,
    /// Samples of which a frame is missing; left out.
    pub incomplete: u64,
    /// Frames of a sample that did not begin, or that came twice.
    pub stray: u64,
    /// Error frames of the bus.
    pub bus_errors: u64,
    /// Frames of others on the bus.
    pub foreign: u64,
    /// Frames that could not be read.
    pub malformed: u64,
    /// Samples that the spacing of the times says are missing, incomplete ones not among them.
    pub missing: u64,
}

/// A sample of which frames have arrived.
#[derive(Clone, Copy, Debug)]
struct Open {
    arrival: Timestamp,
    time_us: u32,
    status: u16,
    temperature: i16,
    accelerometer: Option<[i16; 3]>,
    gyroscope: Option<[i16; 3]>,
}

/// Frames in, readings out.
///
/// `device_ticks` is microseconds of the unit, continued beyond 32 bits. Only the first frame of a sample carries it;
/// the other two belong to it by order. The arrival is that of the first frame.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    counters: SbgCounters,
    open: Option<Open>,
    utc_time: Option<(u32, u32)>,
    utc: Option<UtcFix>,
    last_us: Option<u64>,
    /// The last steps of the time, the period being their median: neither a gap nor a glitch moves it.
    steps_us: VecDeque<u64>,
}

impl Decoder {
    /// A decoder at the beginning of a stream.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes one frame; a reading where it completes one. An error is counted here; the stream goes on.
    pub fn push(&mut self, packet: &Packet) -> Result<Option<Decoded<SbgReading>>, WireError> {
        let message = self
            .read(&packet.bytes)
            .inspect_err(|_| self.counters.malformed += 1)?;
        let Some(message) = message else {
            return Ok(None);
        };
        self.counters.frames += 1;
        match message {
            SbgMessage::UtcTime {
                time_us,
                time_of_week_ms,
            } => self.utc_time = Some((time_us, time_of_week_ms)),
            SbgMessage::UtcDate(date) => {
                let fix = |(time_us, time_of_week_ms)| UtcFix {
                    time_us,
                    time_of_week_ms,
                    date,
                };
                self.utc = self.utc_time.take().map(fix).or(self.utc);
            }
            SbgMessage::ImuInfo {
                time_us,
                status,
                temperature,
            } => {
                self.give_up();
                self.open = Some(Open {
                    arrival: packet.arrival,
                    time_us,
                    status,
                    temperature,
                    accelerometer: None,
                    gyroscope: None,
                });
            }
            SbgMessage::Accelerometer(xyz) => self.fill(|open| &mut open.accelerometer, xyz),
            SbgMessage::Gyroscope(xyz) => self.fill(|open| &mut open.gyroscope, xyz),
        }
        Ok(self.complete())
    }

    /// The stream has ended: a sample that lacks a frame is counted.
    pub fn finish(&mut self) {
        self.give_up();
    }

    /// What was met so far.
    pub fn counters(&self) -> SbgCounters {
        self.counters
    }

    fn read(&mut self, bytes: &[u8]) -> Result<Option<SbgMessage>, WireError> {
        let frame = CanFrame::parse(bytes)?;
        if frame.is_error() {
            self.counters.bus_errors += 1;
            return Ok(None);
        }
        let message = SbgMessage::parse(&frame)?;
        if message.is_none() {
            self.counters.foreign += 1;
        }
        Ok(message)
    }

    fn fill(&mut self, slot: impl FnOnce(&mut Open) -> &mut Option<[i16; 3]>, xyz: [i16; 3]) {
        match self.open.as_mut().map(slot) {
            Some(slot) if slot.is_none() => *slot = Some(xyz),
            _ => self.counters.stray += 1,
        }
    }

    fn give_up(&mut self) {
        if let Some(open) = self.open.take() {
            self.counters.incomplete += 1;
            self.continue_time(open.time_us);
        }
    }

    fn complete(&mut self) -> Option<Decoded<SbgReading>> {
        let open = self.open?;
        let (accelerometer, gyroscope) = open.accelerometer.zip(open.gyroscope)?;
        self.open = None;
        self.counters.samples += 1;
        let scaled = |xyz: [i16; 3], steps: f64| xyz.map(|value| f64::from(value) / steps);
        Some(Decoded {
            arrival: open.arrival,
            device_ticks: self.continue_time(open.time_us),
            sample: SbgReading {
                sample: ImuSample {
                    angular_velocity_rad_s: scaled(gyroscope, GYROSCOPE_STEPS),
                    specific_force_m_s2: scaled(accelerometer, ACCELEROMETER_STEPS),
                },
                status: open.status,
                temperature_celsius: f64::from(open.temperature) / TEMPERATURE_STEPS,
                utc: self.utc.take(),
            },
        })
    }

    /// The time beyond 32 bits. Counts samples that did not come.
    fn continue_time(&mut self, time_us: u32) -> u64 {
        let Some(last_us) = self.last_us else {
            self.last_us = Some(time_us.into());
            return time_us.into();
        };
        let step_us = u64::from(time_us.wrapping_sub(last_us as u32));
        let now_us = last_us + step_us;
        self.last_us = Some(now_us);
        // Half the range forward is a unit that began anew.
        if step_us == 0 || step_us >= 1 << 31 {
            self.steps_us.clear();
            return now_us;
        }
        if self.steps_us.len() == STEPS_KEPT {
            self.steps_us.pop_front();
        }
        self.steps_us.push_back(step_us);
        let mut sorted: Vec<u64> = self.steps_us.iter().copied().collect();
        sorted.sort_unstable();
        let period_us = sorted[(sorted.len() - 1) / 2];
        self.counters.missing += ((step_us + period_us / 2) / period_us).max(1) - 1;
        now_us
    }
}

#[cfg(test)]
mod tests;
