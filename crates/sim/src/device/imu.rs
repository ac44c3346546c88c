//! An Xsens IMU behind a pseudo-terminal: answers its configuration, then sends MTData2 packets.

use std::path::{Path, PathBuf};
use std::time::Duration;

use lsfb_drivers::transport::serial::Pty;
use lsfb_drivers::xsens::Framer;
use lsfb_drivers::xsens::model::{SAMPLE_TIME_FINE_NS, WITH_EVERY_PACKET, data_id, message};
use lsfb_drivers::xsens::wire::{Item, Message, OutputSetting, UtcTime, Vector};
use lsfb_types::Timestamp;

use super::clock::{SimClock, Turn};
use crate::timing::{Clocked, Discipline};
use crate::{BiasedSample, Error, RigSim};

/// Serial number that the unit reports.
const DEVICE_ID: [u8; 4] = [0x03, 0x80, 0xA2, 0xC1];
/// Error code "parameter invalid".
const INVALID_PARAMETER: u8 = 0x04;
const LISTEN: Duration = Duration::from_millis(50);
/// How long the host may take to read the rest after the last packet.
const DRAIN: Duration = Duration::from_secs(30);
/// Status word: self-test passed, clock in step with UTC.
const STATUS_OK: u32 = 0x0000_0003;

/// The unit, and its end of the line.
pub(crate) struct ImuDevice {
    pty: Pty,
    framer: Framer,
    outputs: Vec<OutputSetting>,
}

impl ImuDevice {
    pub(crate) fn new() -> Result<Self, Error> {
        Ok(Self {
            pty: Pty::open()?,
            framer: Framer::new(512),
            outputs: Vec::new(),
        })
    }

    /// What the host opens as its serial line.
    pub(crate) fn path(&self) -> PathBuf {
        Path::to_owned(self.pty.path())
    }

    /// Waits for the host to configure the unit, then sends the whole walk. Returns the packets sent.
    pub(crate) fn run(
        mut self,
        rig: &RigSim,
        clock: &SimClock,
        device: usize,
    ) -> Result<u64, Error> {
        if !self.configure(rig.imu_rate_hz() as u16, clock)? {
            return Ok(0);
        }
        let mut sent = 0;
        let mut bytes = Vec::new();
        for sample in rig.imu() {
            if clock.reach(device, sample.offset_ns) == Turn::Stop {
                return Ok(sent);
            }
            bytes.clear();
            measurement(&self.outputs, rig, sample, sent, &mut bytes)?;
            self.pty.send(&bytes)?;
            sent += 1;
        }
        // The clock must not wait for this one while the line is read out.
        clock.finish(device);
        self.finish()?;
        Ok(sent)
    }

    /// Sends bytes of the data stream as they are.
    pub(super) fn send(&mut self, bytes: &[u8]) -> Result<(), Error> {
        Ok(self.pty.send(bytes)?)
    }

    /// Waits until the host has read everything, and hangs up.
    pub(super) fn finish(self) -> Result<(), Error> {
        Ok(self.pty.finish(DRAIN)?)
    }

    /// Answers requests until measuring begins. `false`: the session was stopped before.
    pub(super) fn configure(&mut self, rate_hz: u16, clock: &SimClock) -> Result<bool, Error> {
        loop {
            if clock.is_stopped() {
                return Ok(false);
            }
            if let Some(bytes) = self.pty.recv(LISTEN)? {
                self.framer.push(Timestamp::default(), &bytes);
            }
            while let Some(request) = self.framer.next_message() {
                match request.id {
                    message::REQ_DID => self.answer(request.id, &DEVICE_ID)?,
                    message::SET_OUTPUT_CONFIGURATION => {
                        self.set_outputs(rate_hz, &request.data)?
                    }
                    message::GO_TO_MEASUREMENT => {
                        self.answer(request.id, &[])?;
                        return Ok(true);
                    }
                    message::GO_TO_CONFIG => self.answer(request.id, &[])?,
                    _ => self.reply(message::ERROR, &[INVALID_PARAMETER])?,
                }
            }
        }
    }

    /// Accepts the list of outputs, at the rate that the unit runs at; an empty list asks for the current one.
    fn set_outputs(&mut self, rate_hz: u16, data: &[u8]) -> Result<(), Error> {
        if !data.is_empty() {
            let Ok(mut wanted) = OutputSetting::parse_all(data) else {
                return self.reply(message::ERROR, &[INVALID_PARAMETER]);
            };
            for setting in &mut wanted {
                if setting.rate_hz != WITH_EVERY_PACKET {
                    setting.rate_hz = rate_hz;
                }
            }
            self.outputs = wanted;
        }
        let accepted = OutputSetting::emit_all(&self.outputs);
        self.answer(message::SET_OUTPUT_CONFIGURATION, &accepted)
    }

    fn answer(&mut self, request: u8, data: &[u8]) -> Result<(), Error> {
        self.reply(request + 1, data)
    }

    fn reply(&mut self, id: u8, data: &[u8]) -> Result<(), Error> {
        let mut bytes = Vec::new();
        Message { id, data }.emit(&mut bytes)?;
        Ok(self.pty.send(&bytes)?)
    }
}

/// The message of one sample, with the items asked for in the order in which they were.
pub(super) fn measurement(
    outputs: &[OutputSetting],
    rig: &RigSim,
    sample: &BiasedSample,
    number: u64,
    bytes: &mut Vec<u8>,
) -> Result<(), Error> {
    let clock = rig.clocks().of(Clocked::Imu);
    let disciplined = clock.discipline() == Discipline::Utc;
    let device_ns = clock.device_ns(sample.offset_ns);
    // A unit that keeps UTC counts its fine time from the beginning.
    let counted_ns = if disciplined {
        sample.offset_ns
    } else {
        device_ns
    };
    let ticks = (counted_ns as u64 / SAMPLE_TIME_FINE_NS) as u32;
    let mut data = Vec::with_capacity(96);
    for output in outputs {
        let item = match output.id {
            data_id::PACKET_COUNTER => Item::PacketCounter(number as u16),
            data_id::SAMPLE_TIME_FINE => Item::SampleTimeFine(ticks),
            data_id::UTC_TIME => match UtcTime::from_unix_nanos(device_ns) {
                Some(utc) if disciplined => Item::Utc(utc),
                _ => continue,
            },
            data_id::TEMPERATURE => Item::Temperature {
                celsius: 31.5,
                coding: Default::default(),
            },
            data_id::ACCELERATION => {
                Item::Acceleration(Vector::single(sample.sample.specific_force_m_s2))
            }
            data_id::RATE_OF_TURN => {
                Item::RateOfTurn(Vector::single(sample.sample.angular_velocity_rad_s))
            }
            data_id::STATUS_WORD => Item::StatusWord(STATUS_OK),
            _ => continue,
        };
        item.emit(&mut data)?;
    }
    Ok(Message {
        id: message::MT_DATA2,
        data: &data,
    }
    .emit(bytes)?)
}
