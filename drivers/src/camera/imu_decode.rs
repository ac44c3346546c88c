//! Answers of the unit's own IMU to samples. No I/O.

use std::collections::VecDeque;

use lsfb_types::{ImuSample, Packet, Timestamp};

use super::model::{ACCELEROMETER_SPAN_G, GYROSCOPE_SPAN_DEG_S, STANDARD_GRAVITY_M_S2};
use super::wire::{ImuProtocol, ImuResponse, ImuSegment, ImuValues};
use crate::{Decoded, WireError};

/// Steps that a span option covers in protocol 1.
const STEPS_PER_SPAN: f64 = 65_536.0;
/// Gyroscope segments that may wait for the accelerometer's next one: a second's worth.
const MAX_WAITING: usize = 500;

/// What the decoder has met so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImuCounters {
    /// Segments decoded.
    pub segments: u64,
    /// Answers that could not be read.
    pub bad_answers: u64,
    /// Segments that the serial numbers say are missing.
    pub missing: u64,
    /// Segments dropped because they came before.
    pub duplicated: u64,
    /// Gyroscope segments given up because no accelerometer segment followed.
    pub unpaired: u64,
}

/// Answers in, samples out.
///
/// Accelerometer and gyroscope alternate with stamps of their own; the specific force is interpolated at the
/// gyroscope's stamps. `device_ticks` is microseconds of the unit's clock.
#[derive(Clone, Debug)]
pub struct ImuDecoder {
    protocol: ImuProtocol,
    accelerometer_span_g: f64,
    gyroscope_span_deg_s: f64,
    counters: ImuCounters,
    last_serial: Option<u32>,
    specific_force: Option<Reading>,
    waiting: VecDeque<Reading>,
}

#[derive(Clone, Copy, Debug)]
struct Reading {
    arrival: Timestamp,
    timestamp_us: u64,
    xyz: [f64; 3],
}

impl ImuDecoder {
    /// For a unit that speaks `protocol`, with the default spans of S2 units.
    pub fn new(protocol: ImuProtocol) -> Self {
        Self {
            protocol,
            accelerometer_span_g: ACCELEROMETER_SPAN_G.into(),
            gyroscope_span_deg_s: GYROSCOPE_SPAN_DEG_S.into(),
            counters: ImuCounters::default(),
            last_serial: None,
            specific_force: None,
            waiting: VecDeque::new(),
        }
    }

    /// Decodes one answer. An error is counted here; the next answer may be good again.
    pub fn push(&mut self, packet: &Packet) -> Result<Vec<Decoded<ImuSample>>, WireError> {
        let response = ImuResponse::parse(self.protocol, &packet.bytes)
            .inspect_err(|_| self.counters.bad_answers += 1)?;
        let mut samples = Vec::new();
        for segment in &response.segments {
            if self.is_new(segment.serial) {
                self.counters.segments += 1;
                self.push_segment(packet.arrival, segment, &mut samples);
            } else {
                self.counters.duplicated += 1;
            }
        }
        Ok(samples)
    }

    /// What was met so far.
    pub fn counters(&self) -> ImuCounters {
        self.counters
    }

    /// The last segment that arrived safely, 0 before the first: what protocol 1 asks the unit to continue from.
    pub fn last_serial(&self) -> u32 {
        self.last_serial.unwrap_or(0)
    }

    fn is_new(&mut self, serial: u32) -> bool {
        let step = self.last_serial.map_or(1, |last| serial.wrapping_sub(last));
        // Protocol 1 repeats segments until they are confirmed; going backwards by more is a restart.
        if step == 0 || step > u32::MAX - 1000 {
            return false;
        }
        if step < 1 << 31 {
            self.counters.missing += u64::from(step - 1);
        }
        self.last_serial = Some(serial);
        true
    }

    fn push_segment(
        &mut self,
        arrival: Timestamp,
        segment: &ImuSegment,
        samples: &mut Vec<Decoded<ImuSample>>,
    ) {
        let reading = |xyz| Reading {
            arrival,
            timestamp_us: segment.timestamp_us,
            xyz,
        };
        let g = STANDARD_GRAVITY_M_S2;
        let radians = std::f64::consts::PI / 180.0;
        match segment.values {
            ImuValues::RawAccelerometer(xyz) => {
                let scale = self.accelerometer_span_g / STEPS_PER_SPAN * g;
                let force = reading(xyz.map(|v| f64::from(v) * scale));
                self.push_specific_force(force, samples);
            }
            ImuValues::AccelerometerG(xyz) => {
                let force = reading(xyz.map(|v| f64::from(v) * g));
                self.push_specific_force(force, samples);
            }
            ImuValues::RawGyroscope(xyz) => {
                let scale = self.gyroscope_span_deg_s / STEPS_PER_SPAN * radians;
                self.push_angular_velocity(reading(xyz.map(|v| f64::from(v) * scale)));
            }
            ImuValues::GyroscopeDegS(xyz) => {
                self.push_angular_velocity(reading(xyz.map(|v| f64::from(v) * radians)));
            }
            ImuValues::Paired {
                gyroscope_deg_s,
                accelerometer_g,
            } => samples.push(Decoded {
                arrival,
                device_ticks: segment.timestamp_us,
                sample: ImuSample {
                    angular_velocity_rad_s: gyroscope_deg_s.map(|v| f64::from(v) * radians),
                    specific_force_m_s2: accelerometer_g.map(|v| f64::from(v) * g),
                },
            }),
        }
    }

    fn push_angular_velocity(&mut self, reading: Reading) {
        if self.waiting.len() == MAX_WAITING {
            self.waiting.pop_front();
            self.counters.unpaired += 1;
        }
        self.waiting.push_back(reading);
    }

    fn push_specific_force(&mut self, after: Reading, samples: &mut Vec<Decoded<ImuSample>>) {
        let before = self.specific_force.replace(after);
        while let Some(gyro) = self.waiting.front().copied() {
            if gyro.timestamp_us > after.timestamp_us {
                return;
            }
            self.waiting.pop_front();
            let Some(before) = before.filter(|before| before.timestamp_us <= gyro.timestamp_us)
            else {
                // Before the first accelerometer segment there is nothing to interpolate from.
                self.counters.unpaired += 1;
                continue;
            };
            samples.push(Decoded {
                arrival: gyro.arrival,
                device_ticks: gyro.timestamp_us,
                sample: ImuSample {
                    angular_velocity_rad_s: gyro.xyz,
                    specific_force_m_s2: interpolate(before, after, gyro.timestamp_us),
                },
            });
        }
    }
}

fn interpolate(before: Reading, after: Reading, at_us: u64) -> [f64; 3] {
    let span_us = after.timestamp_us.saturating_sub(before.timestamp_us);
    if span_us == 0 {
        return after.xyz;
    }
    let weight = at_us.saturating_sub(before.timestamp_us) as f64 / span_us as f64;
    std::array::from_fn(|i| before.xyz[i] + weight * (after.xyz[i] - before.xyz[i]))
}

#[cfg(test)]
mod tests;
