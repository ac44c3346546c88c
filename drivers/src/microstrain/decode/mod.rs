//! MIP bytes to inertial readings. No I/O.

use lsfb_types::{ImuSample, Packet, Timestamp};

use super::model::{STANDARD_GRAVITY_M_S2, set};
use super::wire::{Field, GpsTime, MipPacket};
use crate::byte_stream::ByteStream;
use crate::{Decoded, WireError};

/// What one packet of inertial data said.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MipReading {
    /// Angular velocity and specific force; `None` where one of them is missing.
    pub sample: Option<ImuSample>,
    /// Reference time since the packet before, nanoseconds.
    pub delta_ns: Option<u64>,
    /// GPS time; `None` where the unit does not send it.
    pub gps: Option<GpsTime>,
    /// Time fed in from outside, nanoseconds; `None` where there is none or it is not valid.
    pub external_time_ns: Option<u64>,
    /// Magnetic field, Gauss.
    pub magnetic_field_gauss: Option<[f32; 3]>,
    /// Air pressure, Pa.
    pub pressure_pa: Option<f64>,
}

/// What the decoder has met so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MipCounters {
    /// Packets with a right checksum, of any kind.
    pub packets: u64,
    /// Packets of inertial data among them.
    pub readings: u64,
    /// Bytes that belong to no packet.
    pub skipped_bytes: u64,
    /// Packets dropped for their checksum.
    pub bad_checksums: u64,
    /// Packets whose fields could not be read.
    pub bad_fields: u64,
    /// Packets of inertial data that the unit's own time differences say are missing.
    pub missing: u64,
    /// Packets of inertial data dropped because they repeat the one before.
    pub duplicated: u64,
}

/// Bytes in, readings out.
///
/// `device_ticks` is the unit's reference time: nanoseconds since power-up; 0 where the unit does not send it.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    stream: ByteStream,
    counters: MipCounters,
    last_ns: Option<u64>,
}

/// A packet taken out of the stream.
struct Framed {
    arrival: Timestamp,
    descriptor_set: u8,
    payload: Vec<u8>,
}

impl Decoder {
    /// A decoder at the beginning of a stream.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a piece of the stream; call [`Decoder::next_reading`] until it is empty.
    pub fn push(&mut self, packet: &Packet) {
        self.stream.push(packet.arrival, &packet.bytes);
    }

    /// The next reading, or `None` until more is pushed.
    pub fn next_reading(&mut self) -> Option<Decoded<MipReading>> {
        while let Some(framed) = self.next_packet() {
            self.counters.packets += 1;
            if framed.descriptor_set != set::SENSOR {
                continue;
            }
            match parse_reading(&framed) {
                Ok(reading) if self.is_new(&reading) => {
                    self.counters.readings += 1;
                    return Some(reading);
                }
                Ok(_) => self.counters.duplicated += 1,
                Err(_) => self.counters.bad_fields += 1,
            }
        }
        None
    }

    /// The stream has ended: what is left behind an unfinished packet.
    pub fn finish(&mut self) -> Vec<Decoded<MipReading>> {
        let mut readings = Vec::new();
        loop {
            while let Some(reading) = self.next_reading() {
                readings.push(reading);
            }
            if !self.stream.skip_unfinished() {
                return readings;
            }
        }
    }

    /// What was met so far.
    pub fn counters(&self) -> MipCounters {
        MipCounters {
            skipped_bytes: self.stream.skipped_bytes(),
            bad_checksums: self.stream.bad_checksums(),
            ..self.counters
        }
    }

    fn next_packet(&mut self) -> Option<Framed> {
        self.stream.next(
            |rest| {
                let parsed = MipPacket::parse(rest)?;
                Ok(parsed.map(|p| ((p.packet.descriptor_set, p.packet.payload.to_vec()), p.len)))
            },
            |arrival, (descriptor_set, payload)| Framed {
                arrival,
                descriptor_set,
                payload,
            },
        )
    }

    /// Compares with the packet before, by the unit's own time.
    fn is_new(&mut self, reading: &Decoded<MipReading>) -> bool {
        // A packet of slower fields carries no time, and no difference.
        let Some(delta_ns) = reading.sample.delta_ns else {
            return true;
        };
        let now_ns = reading.device_ticks;
        let Some(last_ns) = self.last_ns.replace(now_ns) else {
            return true;
        };
        let Some(step_ns) = now_ns.checked_sub(last_ns) else {
            // A unit that began anew.
            return true;
        };
        if step_ns == 0 {
            return false;
        }
        // The unit counts the difference from the packet before, whether that one arrived or not.
        let steps = step_ns.saturating_add(delta_ns / 2).checked_div(delta_ns);
        self.counters.missing += steps.unwrap_or(1).max(1) - 1;
        true
    }
}

fn parse_reading(framed: &Framed) -> Result<Decoded<MipReading>, WireError> {
    let packet = MipPacket {
        descriptor_set: framed.descriptor_set,
        payload: &framed.payload,
    };
    let mut reading = MipReading::default();
    let mut device_ticks = 0;
    let mut specific_force = None;
    let mut angular_velocity = None;
    for field in packet.fields() {
        match field? {
            Field::AccelerometerG(xyz) => {
                specific_force = Some(xyz.map(|g| f64::from(g) * STANDARD_GRAVITY_M_S2));
            }
            Field::GyroscopeRadS(xyz) => angular_velocity = Some(xyz.map(f64::from)),
            Field::MagnetometerGauss(xyz) => reading.magnetic_field_gauss = Some(xyz),
            Field::PressureMbar(pressure) => {
                reading.pressure_pa = Some(f64::from(pressure) * 100.0)
            }
            Field::GpsTimestamp(time) | Field::GpsTime(time) => reading.gps = Some(time),
            Field::ReferenceTimeNs(time_ns) => device_ticks = time_ns,
            Field::ReferenceDeltaNs(delta_ns) => reading.delta_ns = Some(delta_ns),
            Field::ExternalTime { time_ns, valid } if valid != 0 => {
                reading.external_time_ns = Some(time_ns);
            }
            _ => {}
        }
    }
    reading.sample = specific_force.zip(angular_velocity).map(
        |(specific_force_m_s2, angular_velocity_rad_s)| ImuSample {
            angular_velocity_rad_s,
            specific_force_m_s2,
        },
    );
    Ok(Decoded {
        arrival: framed.arrival,
        device_ticks,
        sample: reading,
    })
}

#[cfg(test)]
mod tests;
