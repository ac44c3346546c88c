//! Packets to scans: models, loss, beam angles, and what each block of a dual mode holds.

use lsfb_types::{Echo, LidarPoint, LidarScan, Packet, Timestamp};

use super::model::Model;
use super::wire::{self, DataPacket, ReturnMode};
use crate::lidar::{
    BeamAngles, Counters, Found, Instants, MOST_LATE, Position, ScanBuilder, ScanSettings, Step,
    is_crowded, step,
};
use crate::{Decoded, WireError};

/// One unit of distance, metres.
const UNIT_M: f64 = 0.004;
/// Length of packets about the GPS input.
const GPS_PACKET_LEN: usize = 512;
/// Numbers of packets do not jump by more within half an hour.
const MOST_LOST: u32 = 20_000_000;

/// How packets become scans.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DecoderConfig {
    /// The sensor it must be; `None` takes whatever the packets say.
    pub model: Option<Model>,
    /// A scan ends where the rotor passes this angle, 0.01°.
    pub cut_azimuth_centideg: u16,
    /// Beam angles of this very unit; `None` takes those of the manual.
    pub angles: Option<BeamAngles>,
}

impl DecoderConfig {
    /// What the settings of any LiDAR mean for these.
    pub fn new(model: Option<Model>, settings: &ScanSettings) -> Self {
        Self {
            model,
            cut_azimuth_centideg: settings.cut_azimuth_centideg,
            angles: settings.angles.clone(),
        }
    }
}

/// Why a packet gave no points. Every such packet is counted in [`Counters`] too.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// Not a data packet of a supported layout.
    #[error(transparent)]
    Wire(#[from] WireError),
    /// A sensor of the family that is recognised and not decoded.
    #[error("looks like Hesai {name}, which is not supported; use XT32, Pandar64 or QT64")]
    Unsupported {
        /// What it is.
        name: &'static str,
    },
    /// Another sensor than the configured one.
    #[error("packets of a {got}, but a {expected} is configured")]
    WrongModel {
        /// The configured model.
        expected: Model,
        /// What the packets say.
        got: Model,
    },
    /// The return mode byte names no mode that is decoded.
    #[error("return mode {code:#04x} is not supported")]
    ReturnMode {
        /// The byte.
        code: u8,
    },
    /// The file of beam angles is of another model.
    #[error("the beam angle file has {got} channels, but a {model} has {expected}")]
    Angles {
        /// The sensor.
        model: Model,
        /// Its channels.
        expected: usize,
        /// Those of the file.
        got: usize,
    },
}

/// Whether a datagram is a data packet of this family, decoded or not, good or bad: by its length and its first bytes.
pub fn recognise(bytes: &[u8]) -> bool {
    wire::unsupported(bytes).is_some() || wire::has_length_of_a_model(bytes)
}

/// Time of a data packet past the sensor's hour, nanoseconds.
pub fn device_ns(bytes: &[u8]) -> Option<i64> {
    DataPacket::new(bytes).ok().map(|packet| packet.toh_ns())
}

/// Whether a datagram is one about the sensor's GPS input, which is recorded and not read: 512 bytes that begin with 0xFF 0xEE, where data
/// packets begin with these the other way round (User Manuals of XT32, Pandar64 and QT64, "GPS Data Packet").
pub fn is_beside(bytes: &[u8]) -> bool {
    bytes.len() == GPS_PACKET_LEN && bytes.starts_with(&[0xFF, 0xEE])
}

/// Packets about the GPS input are not read.
pub fn position(_: &[u8], _: Timestamp) -> Option<Result<Position, WireError>> {
    None
}

/// Where a channel looks.
#[derive(Clone, Copy)]
struct Beam {
    /// Metres upward, and in the plane, of one unit of distance.
    rise_m: f64,
    flat_m: f64,
    /// Sine and cosine of its azimuth.
    sin: f64,
    cos: f64,
    /// Rank by elevation, 0 lowest.
    ring: u16,
    /// Firing time after the earliest of its block, nanoseconds.
    firing_ns: u32,
}

/// What is constant about a sensor.
struct Beams {
    model: Model,
    beams: Vec<Beam>,
    /// Earliest firing of a block after its beginning, nanoseconds.
    first_ns: i64,
}

impl Beams {
    fn new(model: Model, angles: Option<&BeamAngles>) -> Self {
        let channels = model.layout().channels;
        let angles_deg = |channel: usize| {
            let unit = angles.and_then(|a| {
                let elevation = a.elevation_deg.get(channel)?;
                Some([*elevation, *a.azimuth_deg.get(channel)?])
            });
            unit.unwrap_or_else(|| model.angles_deg(channel))
        };
        let elevation_deg = |channel: usize| angles_deg(channel)[0];
        let first_ns = (0..channels).map(|channel| model.channel_ns(channel)).min();
        let first_ns = first_ns.unwrap_or_default();
        let beam = |channel: usize| {
            let [elevation, azimuth] = angles_deg(channel).map(f64::to_radians);
            let lower = |other: &usize| elevation_deg(*other) < elevation_deg(channel);
            Beam {
                rise_m: elevation.sin() * UNIT_M,
                flat_m: elevation.cos() * UNIT_M,
                sin: azimuth.sin(),
                cos: azimuth.cos(),
                ring: (0..channels).filter(lower).count() as u16,
                firing_ns: (model.channel_ns(channel) - first_ns) as u32,
            }
        };
        Self {
            model,
            beams: (0..channels).map(beam).collect(),
            first_ns,
        }
    }
}

/// The packet before.
#[derive(Clone, Copy)]
struct Previous {
    model: Model,
    mode: ReturnMode,
    instants: Instants,
    sequence: Option<u32>,
}

/// Turns data packets into scans. Times are the sensor's own.
///
/// `device_ticks` of a scan are nanoseconds since the top of the sensor's hour, below 3.6e12, at its first firing.
pub struct Decoder {
    config: DecoderConfig,
    beams: Option<Beams>,
    scans: ScanBuilder,
    previous: Option<Previous>,
    late_in_a_row: u32,
    found: Option<Found<Model>>,
    counters: Counters,
}

impl Decoder {
    /// A decoder that has seen nothing.
    pub fn new(config: DecoderConfig) -> Self {
        Self {
            scans: ScanBuilder::new(config.cut_azimuth_centideg),
            config,
            beams: None,
            previous: None,
            late_in_a_row: 0,
            found: None,
            counters: Counters::default(),
        }
    }

    /// Takes one packet and returns a scan where one is complete.
    pub fn push(&mut self, packet: &Packet) -> Result<Option<Decoded<LidarScan>>, DecodeError> {
        let (data, mode) = self
            .accept(&packet.bytes)
            .inspect_err(|error| match error {
                DecodeError::Wire(_) => self.counters.malformed += 1,
                _ => self.counters.refused += 1,
            })?;
        let next = Previous {
            model: data.model(),
            mode,
            instants: Instants {
                toh_ns: data.toh_ns(),
                arrival: packet.arrival,
            },
            sequence: data.sequence(),
        };
        if !self.follows(&next) {
            return Ok(self.scans.next_scan());
        }
        self.previous = Some(next);
        self.found = Some(Found {
            model: next.model,
            returns: mode.name(),
            rpm: Some(data.motor_rpm()).filter(|rpm| *rpm > 0),
        });
        self.assemble(&data, mode, packet.arrival);
        Ok(self.scans.next_scan())
    }

    /// Another scan that the last packet completed: one that ends two of them returns the first.
    pub fn ready(&mut self) -> Option<Decoded<LidarScan>> {
        self.scans.next_scan()
    }

    /// Ends the stream: what is left, one scan per call, until `None`.
    pub fn finish(&mut self) -> Option<Decoded<LidarScan>> {
        self.scans.flush(&mut self.counters);
        self.scans.next_scan()
    }

    /// What was seen so far.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// What the sensor is; `None` before its first packet.
    pub fn found(&self) -> Option<Found<Model>> {
        self.found.clone()
    }

    fn accept<'a>(
        &self,
        bytes: &'a [u8],
    ) -> Result<(DataPacket<&'a [u8]>, ReturnMode), DecodeError> {
        if let Some(name) = wire::unsupported(bytes) {
            return Err(DecodeError::Unsupported { name });
        }
        let data = DataPacket::new(bytes)?;
        let model = data.model();
        if let Some(expected) = self.config.model
            && model != expected
        {
            let got = model;
            return Err(DecodeError::WrongModel { expected, got });
        }
        let expected = data.layout().channels;
        if let Some(angles) = &self.config.angles
            && angles.channels() != expected
        {
            let got = angles.channels();
            return Err(DecodeError::Angles {
                model,
                expected,
                got,
            });
        }
        let code = data.return_mode_code();
        let mode = ReturnMode::from_code(code).ok_or(DecodeError::ReturnMode { code })?;
        Ok((data, mode))
    }

    /// Compares a packet with the one before. False: it is left out.
    fn follows(&mut self, next: &Previous) -> bool {
        let Some(previous) = self.previous else {
            return true;
        };
        if (previous.model, previous.mode) != (next.model, next.mode) {
            self.counters.mode_changes += 1;
            self.scans.flush(&mut self.counters);
            return true;
        }
        let elapsed_ns = match step(previous.instants, next.instants) {
            Step::Next { elapsed_ns } => elapsed_ns,
            Step::Duplicate if previous.sequence == next.sequence => {
                self.counters.duplicates += 1;
                return false;
            }
            Step::Duplicate => 0,
            Step::Late if self.late_in_a_row < MOST_LATE => {
                self.late_in_a_row += 1;
                self.counters.reordered += 1;
                // It was missed before.
                self.counters.lost = self.counters.lost.saturating_sub(1);
                return false;
            }
            Step::Late | Step::ClockJump => {
                self.late_in_a_row = 0;
                self.counters.clock_jumps += 1;
                self.scans.flush(&mut self.counters);
                return true;
            }
        };
        self.late_in_a_row = 0;
        let shots = next.model.layout().blocks / next.mode.echoes().len();
        let period_ns = next.model.shot_ns() * shots as i64;
        self.counters.crowded += u64::from(is_crowded(elapsed_ns, period_ns));
        self.counters.lost += match (previous.sequence, next.sequence) {
            // A larger step is a sensor that was restarted.
            (Some(before), Some(now)) if now.wrapping_sub(before) < MOST_LOST => {
                u64::from(now.wrapping_sub(before).saturating_sub(1))
            }
            (Some(_), Some(_)) => 0,
            _ => {
                let packets = (elapsed_ns + period_ns / 2) / period_ns;
                packets.saturating_sub(1).max(0).cast_unsigned()
            }
        };
        true
    }

    fn assemble(&mut self, data: &DataPacket<&[u8]>, mode: ReturnMode, arrival: Timestamp) {
        let model = data.model();
        let beams = match &mut self.beams {
            Some(beams) if beams.model == model => beams,
            place => place.insert(Beams::new(model, self.config.angles.as_ref())),
        };
        let echoes = mode.echoes();
        self.counters.packets += 1;
        for block in (0..data.layout().blocks).step_by(echoes.len()) {
            let azimuth_centideg = data.azimuth_centideg(block);
            let fired_ns = data.toh_ns() + model.block_ns(block, echoes.len()) + beams.first_ns;
            let place = self
                .scans
                .block(azimuth_centideg, fired_ns, arrival, &mut self.counters);
            let before = place.points.len();
            let (sin, cos) = (f64::from(azimuth_centideg) / 100.0).to_radians().sin_cos();
            for (channel, beam) in beams.beams.iter().enumerate() {
                let right_m = (sin * beam.cos + cos * beam.sin) * beam.flat_m;
                let forward_m = (cos * beam.cos - sin * beam.sin) * beam.flat_m;
                for index in 0..echoes.len() {
                    let raw = data.distance_raw(block + index, channel);
                    // The other echo of the shot; with one echo a shot, the same.
                    let other = data.distance_raw(block + echoes.len() - 1 - index, channel);
                    // Two equal echoes are one.
                    if raw == 0 || (index == 1 && raw == other) {
                        continue;
                    }
                    let range = f64::from(raw);
                    place.points.push(LidarPoint {
                        position_m: [
                            (range * forward_m) as f32,
                            (-range * right_m) as f32,
                            (range * beam.rise_m) as f32,
                        ],
                        intensity: data.reflectivity(block + index, channel),
                        ring: beam.ring,
                        echo: which(echoes, raw, other),
                        time_offset_ns: place.offset_ns + beam.firing_ns,
                    });
                }
            }
            let echoes = place.points.len() - before;
            self.counters.shot(azimuth_centideg, echoes);
        }
    }
}

/// Which echo of its shot a distance is.
fn which(echoes: &[Echo], raw: u16, other: u16) -> Echo {
    match echoes {
        [only] => *only,
        [nearer, _] if raw < other => *nearer,
        [_, farther] if raw > other && other > 0 => *farther,
        _ => Echo::Both,
    }
}

#[cfg(test)]
mod tests;
