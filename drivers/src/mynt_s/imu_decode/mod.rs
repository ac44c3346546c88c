//! Answers of the unit's own IMU to samples. No I/O.

use lsfb_types::{ImuSample, Packet, Timestamp};

use super::model::{ACCELEROMETER_SPAN_G, GYROSCOPE_SPAN_DEG_S, STANDARD_GRAVITY_M_S2};
use super::wire::{ImuProtocol, ImuResponse, ImuSegment, ImuValues};
use crate::pairing::{Pairing, Reading};
use crate::{Decoded, WireError};

/// Steps that a span option covers in protocol 1.
const STEPS_PER_SPAN: f64 = 65_536.0;
/// Stamps of one sensor further apart than this are a gap: the slowest setting, 100 Hz, has half of it.
const LONGEST_STEP_US: u64 = 20_000;

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
    /// Times that the stamps of the samples jumped by more than 20 ms: owners report 45 ms.
    pub gaps: u64,
    /// Longest of them, microseconds.
    pub longest_gap_us: u64,
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
    last_sample_us: Option<u64>,
    pairing: Pairing,
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
            last_sample_us: None,
            pairing: Pairing::default(),
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
        for sample in &samples {
            self.note_gap(sample.device_ticks);
        }
        Ok(samples)
    }

    /// What was met so far.
    pub fn counters(&self) -> ImuCounters {
        ImuCounters {
            unpaired: self.pairing.unpaired(),
            ..self.counters
        }
    }

    /// The last segment that arrived safely, 0 before the first: what protocol 1 asks the unit to continue from.
    pub fn last_serial(&self) -> u32 {
        self.last_serial.unwrap_or(0)
    }

    fn note_gap(&mut self, now_us: u64) {
        let last_us = self.last_sample_us.replace(now_us).unwrap_or(now_us);
        let step_us = now_us.saturating_sub(last_us);
        if step_us > LONGEST_STEP_US {
            self.counters.gaps += 1;
            self.counters.longest_gap_us = self.counters.longest_gap_us.max(step_us);
        }
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
            ticks: segment.timestamp_us,
            xyz,
        };
        let g = STANDARD_GRAVITY_M_S2;
        let radians = std::f64::consts::PI / 180.0;
        match segment.values {
            ImuValues::RawAccelerometer(xyz) => {
                let scale = self.accelerometer_span_g / STEPS_PER_SPAN * g;
                let force = reading(xyz.map(|v| f64::from(v) * scale));
                self.pairing.push_specific_force(force, samples);
            }
            ImuValues::AccelerometerG(xyz) => {
                let force = reading(xyz.map(|v| f64::from(v) * g));
                self.pairing.push_specific_force(force, samples);
            }
            ImuValues::RawGyroscope(xyz) => {
                let scale = self.gyroscope_span_deg_s / STEPS_PER_SPAN * radians;
                self.pairing
                    .push_angular_velocity(reading(xyz.map(|v| f64::from(v) * scale)));
            }
            ImuValues::GyroscopeDegS(xyz) => {
                self.pairing
                    .push_angular_velocity(reading(xyz.map(|v| f64::from(v) * radians)));
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
}

#[cfg(test)]
mod tests;
