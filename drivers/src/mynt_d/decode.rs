//! Reports to samples. No I/O.

use std::collections::VecDeque;

use lsfb_types::{ImuSample, Packet};

use super::model::{
    ACCELEROMETER_SPAN_G, GYROSCOPE_SPAN_DEG_S, STANDARD_GRAVITY_M_S2, TEMPERATURE_STEP_CELSIUS,
    TEMPERATURE_ZERO_CELSIUS,
};
use super::wire::{Item, RawReading, Report};
use crate::pairing::{Pairing, Reading};
use crate::{Decoded, WireError};

/// Steps that a span covers.
const STEPS_PER_SPAN: f64 = 65_536.0;

/// What a unit said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MyntDReading {
    /// Angular velocity, with the specific force at the same instant.
    Imu(ImuSample),
    /// The camera took a frame.
    Frame {
        /// Counter of frames.
        frame_id: u16,
        /// Exposure, in steps of the unit.
        exposure: u16,
    },
}

/// What the decoder has met so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MyntDCounters {
    /// Reports decoded.
    pub reports: u64,
    /// Reports that could not be read, or of which a part could not.
    pub bad_reports: u64,
    /// Reports that the serial numbers say are missing.
    pub missing: u64,
    /// Reports dropped because they repeat the one before.
    pub duplicated: u64,
    /// Gyroscope readings given up because no accelerometer reading stands on both sides of them.
    pub unpaired: u64,
}

/// Reports in, readings out.
///
/// `device_ticks` is the unit's own stamp, continued beyond 32 bits.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    counters: MyntDCounters,
    last_serial: Option<u16>,
    last_ticks: Option<u64>,
    temperature_celsius: Option<f64>,
    pairing: Pairing,
    ready: VecDeque<Decoded<MyntDReading>>,
}

impl Decoder {
    /// A decoder at the beginning of a stream.
    pub fn new() -> Self {
        Self::default()
    }

    /// Decodes one report; call [`Decoder::next_reading`] until it is empty. An error is counted here.
    pub fn push(&mut self, packet: &Packet) -> Result<(), WireError> {
        let report =
            Report::parse(&packet.bytes).inspect_err(|_| self.counters.bad_reports += 1)?;
        let step = self
            .last_serial
            .replace(report.serial)
            .map_or(1, |last| report.serial.wrapping_sub(last));
        match step {
            0 => {
                self.counters.duplicated += 1;
                return Ok(());
            }
            1..0x8000 => self.counters.missing += u64::from(step - 1),
            // A unit that began anew.
            _ => self.last_ticks = None,
        }
        self.counters.reports += 1;
        let mut samples = Vec::new();
        for item in report.items() {
            let item = item.inspect_err(|_| self.counters.bad_reports += 1)?;
            match item {
                Item::Accelerometer(raw) => {
                    let scale = ACCELEROMETER_SPAN_G / STEPS_PER_SPAN * STANDARD_GRAVITY_M_S2;
                    let reading = self.reading(packet, &raw, scale);
                    self.pairing.push_specific_force(reading, &mut samples);
                }
                Item::Gyroscope(raw) => {
                    let scale = (GYROSCOPE_SPAN_DEG_S / STEPS_PER_SPAN).to_radians();
                    let reading = self.reading(packet, &raw, scale);
                    self.pairing.push_angular_velocity(reading);
                }
                Item::Frame {
                    ticks,
                    frame_id,
                    exposure,
                } => {
                    let frame = Decoded {
                        arrival: packet.arrival,
                        device_ticks: self.continue_ticks(ticks),
                        sample: MyntDReading::Frame { frame_id, exposure },
                    };
                    self.ready.push_back(frame);
                }
                Item::Other { .. } => {}
            }
        }
        self.ready.extend(samples.into_iter().map(|sample| Decoded {
            arrival: sample.arrival,
            device_ticks: sample.device_ticks,
            sample: MyntDReading::Imu(sample.sample),
        }));
        Ok(())
    }

    /// The next reading, or `None` until more is pushed.
    pub fn next_reading(&mut self) -> Option<Decoded<MyntDReading>> {
        self.ready.pop_front()
    }

    /// The unit's last temperature, °C.
    pub fn temperature_celsius(&self) -> Option<f64> {
        self.temperature_celsius
    }

    /// What was met so far.
    pub fn counters(&self) -> MyntDCounters {
        MyntDCounters {
            unpaired: self.pairing.unpaired(),
            ..self.counters
        }
    }

    fn reading(&mut self, packet: &Packet, raw: &RawReading, scale: f64) -> Reading {
        let temperature = f64::from(raw.temperature) * TEMPERATURE_STEP_CELSIUS;
        self.temperature_celsius = Some(temperature + TEMPERATURE_ZERO_CELSIUS);
        Reading {
            arrival: packet.arrival,
            ticks: self.continue_ticks(raw.ticks),
            xyz: raw.xyz.map(|value| f64::from(value) * scale),
        }
    }

    /// The stamp beyond 32 bits. Stamps of different items may lie a little before each other.
    fn continue_ticks(&mut self, ticks: u32) -> u64 {
        let continued = match self.last_ticks {
            None => ticks.into(),
            Some(last) => {
                let step = ticks.wrapping_sub(last as u32).cast_signed();
                last.saturating_add_signed(step.into())
            }
        };
        self.last_ticks = Some(continued);
        continued
    }
}

#[cfg(test)]
mod tests {
    use lsfb_types::Timestamp;

    use super::*;
    use crate::mynt_d::model::REPORT_LEN;
    use crate::test_random::Random;

    fn raw(ticks: u32, z: i16) -> RawReading {
        RawReading {
            ticks,
            xyz: [0, 0, z],
            temperature: 0x40,
        }
    }

    fn packet(serial: u16, items: &[Item<'_>]) -> Packet {
        Packet {
            arrival: Timestamp::from_nanos(serial.into()),
            bytes: Report::emit(serial, items).unwrap().to_vec(),
        }
    }

    fn report(serial: u16, ticks: u32) -> Packet {
        let frame = Item::Frame {
            ticks: ticks.wrapping_add(1),
            frame_id: serial,
            exposure: 240,
        };
        let accelerometer = Item::Accelerometer(raw(ticks, 0x1555));
        let gyroscope = Item::Gyroscope(raw(ticks.wrapping_add(2), 0x4000));
        packet(serial, &[accelerometer, frame, gyroscope])
    }

    #[test]
    fn readings_are_scaled_paired_and_continued_through_the_wrap() {
        let mut decoder = Decoder::new();
        let first = u32::MAX - 1;
        decoder.push(&report(65_535, first)).unwrap();
        decoder.push(&report(0, first.wrapping_add(4))).unwrap();
        let readings: Vec<_> = std::iter::from_fn(|| decoder.next_reading()).collect();
        let ticks: Vec<u64> = readings.iter().map(|r| r.device_ticks).collect();
        let first = u64::from(first);
        assert_eq!(ticks, [first + 1, first + 5, first + 2]);
        let MyntDReading::Imu(sample) = readings[2].sample else {
            panic!("{readings:?}")
        };
        let rate = 500f64.to_radians();
        assert!((sample.angular_velocity_rad_s[2] - rate).abs() < 1e-12);
        assert!((sample.specific_force_m_s2[2] - 0.999_94 * 9.806_65).abs() < 1e-4);
        let frame = MyntDReading::Frame {
            frame_id: 65_535,
            exposure: 240,
        };
        assert_eq!(readings[0].sample, frame);
        assert_eq!(decoder.temperature_celsius(), Some(31.0));
    }

    #[test]
    fn gaps_and_repetitions_are_counted() {
        let mut decoder = Decoder::new();
        for serial in [1, 2, 2, 5] {
            decoder
                .push(&report(serial, 10 * u32::from(serial)))
                .unwrap();
        }
        let mut bad = report(6, 60);
        bad.bytes[9] ^= 1;
        assert!(decoder.push(&bad).is_err());
        let expected = MyntDCounters {
            reports: 3,
            bad_reports: 1,
            missing: 2,
            duplicated: 1,
            unpaired: 0,
        };
        assert_eq!(decoder.counters(), expected);
    }

    #[test]
    fn random_reports_never_panic() {
        let mut random = Random::new(8);
        for _ in 0..2_000 {
            let mut decoder = Decoder::new();
            for _ in 0..5 {
                let mut bytes = random.bytes(REPORT_LEN);
                bytes.resize(REPORT_LEN, 0);
                bytes[63] = bytes[3..63].iter().fold(0, |sum, byte| sum ^ byte);
                let _ = decoder.push(&Packet {
                    arrival: Timestamp::default(),
                    bytes,
                });
            }
        }
    }
}
