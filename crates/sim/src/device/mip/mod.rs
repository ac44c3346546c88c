//! A MicroStrain IMU behind a pseudo-terminal: answers its configuration, then sends MIP packets.

use std::path::{Path, PathBuf};
use std::time::Duration;

use lsfb_drivers::microstrain::MipUnit;
use lsfb_drivers::microstrain::model::{STANDARD_GRAVITY_M_S2, field, set};
use lsfb_drivers::microstrain::wire::{Field, FormatEntry, MipPacket};
use lsfb_drivers::transport::serial::Pty;

use super::clock::{SimClock, Turn};
use crate::timing::{Clocked, Discipline};
use crate::{BiasedSample, Error, RigSim};

const LISTEN: Duration = Duration::from_millis(50);
/// How long the host may take to read the rest after the last packet.
const DRAIN: Duration = Duration::from_secs(30);

/// The unit, and its end of the line.
pub(super) struct MipDevice {
    pty: Pty,
    unit: MipUnit,
}

impl MipDevice {
    /// A unit whose base rate is that of the samples: the host may ask for every one, or for every so many.
    pub(super) fn new(base_rate_hz: u16) -> Result<Self, Error> {
        Ok(Self {
            pty: Pty::open()?,
            unit: MipUnit::new(base_rate_hz),
        })
    }

    /// What the host opens as its serial line.
    pub(super) fn path(&self) -> PathBuf {
        Path::to_owned(self.pty.path())
    }

    /// Waits for the host to configure the unit, then sends the whole walk. Returns the packets sent.
    pub(super) fn run(
        mut self,
        rig: &RigSim,
        clock: &SimClock,
        device: usize,
    ) -> Result<u64, Error> {
        if !self.configure(clock)? {
            return Ok(0);
        }
        let mut stream = MipStream::new(self.unit.format().to_vec());
        let mut bytes = Vec::new();
        for sample in rig.imu() {
            if clock.reach(device, sample.offset_ns) == Turn::Stop {
                return Ok(stream.sent);
            }
            bytes.clear();
            stream.push(rig, sample, &mut bytes)?;
            if !bytes.is_empty() {
                self.send(&bytes)?;
            }
        }
        // The clock must not wait for this one while the line is read out.
        clock.finish(device);
        self.finish()?;
        Ok(stream.sent)
    }

    /// Answers requests until the unit streams. `false`: the session was stopped before.
    pub(super) fn configure(&mut self, clock: &SimClock) -> Result<bool, Error> {
        while !self.unit.is_streaming() {
            if clock.is_stopped() {
                return Ok(false);
            }
            if let Some(bytes) = self.pty.recv(LISTEN)? {
                let answers = self.unit.handle(&bytes)?;
                self.pty.send(&answers)?;
            }
        }
        Ok(true)
    }

    /// Sends bytes of the data stream as they are.
    pub(super) fn send(&mut self, bytes: &[u8]) -> Result<(), Error> {
        Ok(self.pty.send(bytes)?)
    }

    /// Waits until the host has read everything, and hangs up.
    pub(super) fn finish(self) -> Result<(), Error> {
        Ok(self.pty.finish(DRAIN)?)
    }
}

/// Packets of the fields asked for, sample by sample.
pub(super) struct MipStream {
    format: Vec<FormatEntry>,
    samples: u64,
    last_sent_ns: Option<i64>,
    /// Packets so far.
    pub sent: u64,
}

impl MipStream {
    pub(super) fn new(format: Vec<FormatEntry>) -> Self {
        Self {
            format,
            samples: 0,
            last_sent_ns: None,
            sent: 0,
        }
    }

    /// Appends the packet of a sample; nothing where no field is due.
    pub(super) fn push(
        &mut self,
        rig: &RigSim,
        sample: &BiasedSample,
        bytes: &mut Vec<u8>,
    ) -> Result<(), Error> {
        let number = self.samples;
        self.samples += 1;
        let clock = rig.clocks().of(Clocked::Imu);
        // Time since power-up, whatever else the unit knows.
        let now_ns = match clock.discipline() {
            Discipline::Utc => sample.offset_ns,
            Discipline::Free => clock.device_ns(sample.offset_ns),
        };
        let mut payload = Vec::with_capacity(64);
        let due = self
            .format
            .iter()
            .filter(|entry| number.is_multiple_of(entry.decimation.max(1).into()));
        for entry in due {
            let field = match entry.descriptor {
                field::REFERENCE_TIME => Field::ReferenceTimeNs(now_ns.max(0).cast_unsigned()),
                field::REFERENCE_DELTA => {
                    let past_ns = now_ns - self.last_sent_ns.unwrap_or(now_ns);
                    Field::ReferenceDeltaNs(past_ns.max(0).cast_unsigned())
                }
                field::ACCELEROMETER => {
                    let force = sample.sample.specific_force_m_s2;
                    Field::AccelerometerG(force.map(|f| (f / STANDARD_GRAVITY_M_S2) as f32))
                }
                field::GYROSCOPE => {
                    Field::GyroscopeRadS(sample.sample.angular_velocity_rad_s.map(|w| w as f32))
                }
                _ => continue,
            };
            field.emit(&mut payload)?;
        }
        if payload.is_empty() {
            return Ok(());
        }
        self.last_sent_ns = Some(now_ns);
        self.sent += 1;
        let packet = MipPacket {
            descriptor_set: set::SENSOR,
            payload: &payload,
        };
        Ok(packet.emit(bytes)?)
    }
}

#[cfg(test)]
mod tests;
