//! Packets to scans: model and mode, loss, the cut into revolutions. Geometry of one packet is in [`super::layout`].

use lsfb_types::{Echo, LidarScan, Packet, Timestamp};

use super::layout::{PacketLayout, stride};
use super::model::{Model, Product};
use super::nmea::Sentence;
use super::points::{Firing, OpticalOffset, PointMaker};
use super::wire::{
    DATA_PACKET_LEN, DataPacket, POSITION_PACKET_LEN, PositionPacket, PpsStatus, identify,
    returns_of_code,
};
use crate::lidar::{
    Counters, Found, Instants, MOST_LATE, Position, Returns, ScanBuilder, ScanSettings, Step,
    TURN_CENTIDEG, is_crowded, step, turn,
};
use crate::{Decoded, WireError};

/// Timestamps are whole microseconds.
const PERIOD_TOLERANCE_NS: i64 = 3_000;
/// Packets at another model's rate that settle that the factory bytes are wrong: far less than one revolution.
const WRONG_RATE_PACKETS: u32 = 8;
/// Half of the shortest turn (1200 rpm): where the rotor seems to go on as it did, and more time than this is left over, it went round
/// unseen.
const HALF_A_TURN_NS: i64 = 25_000_000;

/// Whose word counts for model and return mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ModelChoice {
    /// The factory bytes of the packets.
    #[default]
    FromPackets,
    /// The factory bytes, and packets of any other model are refused.
    Expect(Model),
    /// These, whatever the factory bytes say: old firmware leaves them meaningless.
    Force(Model, Returns),
}

/// How packets become scans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecoderConfig {
    /// Whose word counts for model and return mode.
    pub model: ModelChoice,
    /// A scan ends where the rotor passes this angle, 0.01°. With a field-of-view window, choose one outside it.
    pub cut_azimuth_centideg: u16,
    /// Whether the optical centre's vertical offset is modelled.
    pub optical_offset: OpticalOffset,
}

impl DecoderConfig {
    /// What the settings of any LiDAR mean for these.
    pub fn new(model: Option<Model>, settings: &ScanSettings) -> Self {
        Self {
            model: match (model, settings.force_returns) {
                (Some(model), Some(returns)) => ModelChoice::Force(model, returns),
                (Some(model), None) => ModelChoice::Expect(model),
                (None, _) => ModelChoice::FromPackets,
            },
            cut_azimuth_centideg: settings.cut_azimuth_centideg,
            optical_offset: OpticalOffset::default(),
        }
    }
}

/// Whether a datagram is as long as the data packets of this family, decoded or not.
pub fn recognise(bytes: &[u8]) -> bool {
    bytes.len() == DATA_PACKET_LEN
}

/// Time of a data packet past the sensor's hour, nanoseconds.
pub fn device_ns(bytes: &[u8]) -> Option<i64> {
    let packet = DataPacket::new(bytes).ok()?;
    Some(i64::from(packet.timestamp_us()) * 1_000)
}

/// Whether a datagram is one that is recorded and not read: there is none.
pub fn is_beside(_: &[u8]) -> bool {
    false
}

/// What a position packet says; `None` where it is none.
pub fn position(bytes: &[u8], arrival: Timestamp) -> Option<Result<Position, WireError>> {
    if bytes.len() != POSITION_PACKET_LEN {
        return None;
    }
    Some(PositionPacket::new(bytes).map(|packet| {
        let about_secs = arrival.nanos().div_euclid(1_000_000_000);
        let sentence = Sentence::parse(packet.nmea()).ok();
        let named_secs = sentence.and_then(|sentence| sentence.unix_secs(about_secs));
        Position {
            toh_ns: i64::from(packet.timestamp_us()) * 1_000,
            pps_locked: packet.pps_status() == PpsStatus::Locked,
            sentence: named_secs
                .map(|secs| Timestamp::from_nanos(secs.saturating_mul(1_000_000_000))),
            temperature_celsius: Some(f64::from(packet.top_temperature_celsius())),
        }
    }))
}

/// Why a packet gave no points. Every such packet is counted in [`Counters`] too.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// Not a data packet of a supported layout.
    #[error(transparent)]
    Wire(#[from] WireError),
    /// A sensor that is recognised and not decoded.
    #[error("{product} packets are not supported; use VLP-32C, VLP-16 or HDL-32E")]
    Unsupported {
        /// What it is.
        product: Product,
    },
    /// Another sensor than the configured one.
    #[error("packets of a {got}, but a {expected} is configured")]
    WrongModel {
        /// The configured model.
        expected: Model,
        /// What the packets say.
        got: Product,
    },
    /// The factory bytes contradict the packet rate.
    #[error(
        "packets claim to be from a {declared}, but arrive at the rate of a {looks_like}: force the model (in devices.toml `model` and `force_returns`, on the command line --lidar-model and --force-returns)"
    )]
    WrongBytes {
        /// What the packets say.
        declared: Model,
        /// Whose rate they have.
        looks_like: Model,
    },
    /// The return mode byte names no mode.
    #[error(
        "return mode {code:#04x} is none of 0x37, 0x38, 0x39: force the mode (in devices.toml `model` and `force_returns`, on the command line --lidar-model and --force-returns)"
    )]
    ReturnMode {
        /// The byte.
        code: u8,
    },
}

/// Turns data packets into scans. Times are the sensor's own.
///
/// Output lags by one packet: what comes after the gap of a field-of-view window is timed from the next packet.
/// `device_ticks` of a scan are nanoseconds since the top of the sensor's hour, below 3.6e12, at its first firing.
pub struct Decoder {
    config: DecoderConfig,
    held: Option<Held>,
    scans: ScanBuilder,
    dead_sector: Option<Sector>,
    wrong_rate: u32,
    late_in_a_row: u32,
    proven: bool,
    refusal: Option<DecodeError>,
    found: Option<(Model, Returns)>,
    maker: Option<(Model, Box<PointMaker>)>,
    /// Buffer of the last packet: room for the next.
    spare: Vec<u8>,
    counters: Counters,
}

struct Held {
    packet: DataPacket<Vec<u8>>,
    arrival: Timestamp,
    layout: PacketLayout,
}

impl Held {
    fn instants(&self) -> Instants {
        Instants {
            toh_ns: i64::from(self.packet.timestamp_us()) * 1_000,
            arrival: self.arrival,
        }
    }
}

/// Where a field-of-view window keeps the sensor from firing: last block before, first block after.
#[derive(Clone, Copy)]
struct Sector {
    from: u16,
    to: u16,
}

impl Decoder {
    /// A decoder that has seen nothing.
    pub fn new(config: DecoderConfig) -> Self {
        Self {
            config,
            held: None,
            scans: ScanBuilder::new(config.cut_azimuth_centideg),
            dead_sector: None,
            wrong_rate: 0,
            late_in_a_row: 0,
            proven: false,
            refusal: None,
            found: None,
            maker: None,
            spare: Vec::new(),
            counters: Counters::default(),
        }
    }

    /// Takes one packet and returns a scan where one is complete.
    pub fn push(&mut self, packet: &Packet) -> Result<Option<Decoded<LidarScan>>, DecodeError> {
        let (data, model, mode) = self
            .accept(&packet.bytes)
            .inspect_err(|error| match error {
                DecodeError::Wire(_) => self.counters.malformed += 1,
                _ => self.counters.refused += 1,
            })?;
        self.found = Some((model, mode));
        let layout = PacketLayout::new(&data, model, mode);
        self.counters.contradicting += u64::from(contradicts(&data, model, mode));
        let next = Held {
            packet: data.copied_into(std::mem::take(&mut self.spare)),
            arrival: packet.arrival,
            layout,
        };
        if let Some(held) = self.held.take() {
            if held.layout.model != model || held.layout.mode != mode {
                self.counters.mode_changes += 1;
                self.proven = false;
                self.assemble(held);
                self.scans.flush(&mut self.counters);
            } else {
                match step(held.instants(), next.instants()) {
                    Step::Duplicate => {
                        self.counters.duplicates += 1;
                        return Ok(self.keep(held, next));
                    }
                    Step::Late if self.late_in_a_row < MOST_LATE => {
                        self.late_in_a_row += 1;
                        self.counters.reordered += 1;
                        // It was missed before.
                        self.counters.lost = self.counters.lost.saturating_sub(1);
                        return Ok(self.keep(held, next));
                    }
                    Step::Late | Step::ClockJump => {
                        self.counters.clock_jumps += 1;
                        self.assemble(held);
                        self.scans.flush(&mut self.counters);
                    }
                    Step::Next { elapsed_ns } => self.advance(held, &next, elapsed_ns)?,
                }
            }
        }
        self.late_in_a_row = 0;
        self.held = Some(next);
        Ok(self.scans.next_scan())
    }

    /// Goes on waiting for the successor of `held`.
    fn keep(&mut self, held: Held, left_out: Held) -> Option<Decoded<LidarScan>> {
        self.spare = left_out.packet.into_inner();
        self.held = Some(held);
        self.scans.next_scan()
    }

    /// Another scan that the last packet completed: one that ends two of them returns the first.
    pub fn ready(&mut self) -> Option<Decoded<LidarScan>> {
        self.scans.next_scan()
    }

    /// Ends the stream: what is left, one scan per call, until `None`.
    pub fn finish(&mut self) -> Option<Decoded<LidarScan>> {
        if let Some(held) = self.held.take() {
            self.assemble(held);
        }
        self.scans.flush(&mut self.counters);
        self.scans.next_scan()
    }

    /// What was seen so far.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// What the sensor is; `None` before its first packet.
    pub fn found(&self) -> Option<Found<Model>> {
        let (model, mode) = self.found?;
        Some(Found {
            model,
            returns: match mode {
                Returns::Strongest => "strongest",
                Returns::Last => "last",
                Returns::Dual => "last + strongest",
            },
            rpm: None,
        })
    }

    fn accept<'a>(
        &self,
        bytes: &'a [u8],
    ) -> Result<(DataPacket<&'a [u8]>, Model, Returns), DecodeError> {
        if let Some(refusal) = self.refusal {
            return Err(refusal);
        }
        let product = identify(bytes)?;
        if let ModelChoice::Force(model, mode) = self.config.model {
            return Ok((DataPacket::new(bytes)?, model, mode));
        }
        if let ModelChoice::Expect(expected) = self.config.model
            && product.model() != Some(expected)
        {
            return Err(DecodeError::WrongModel {
                expected,
                got: product,
            });
        }
        let model = product
            .model()
            .ok_or(DecodeError::Unsupported { product })?;
        let data = DataPacket::new(bytes)?;
        let code = data.return_mode_code();
        let mode = returns_of_code(code).ok_or(DecodeError::ReturnMode { code })?;
        Ok((data, model, mode))
    }

    /// Decodes `held`, now that its successor is known.
    fn advance(&mut self, mut held: Held, next: &Held, elapsed_ns: i64) -> Result<(), DecodeError> {
        let period = held.layout.packet_period_ns();
        let beyond_ns = elapsed_ns - held.layout.span_ns();
        let reaches = held.layout.reaches(&next.layout);
        if reaches && beyond_ns < HALF_A_TURN_NS {
            self.check_rate(&held, elapsed_ns)?;
        }
        self.counters.crowded += u64::from(is_crowded(elapsed_ns, period));
        let between = Sector {
            from: held.layout.last_azimuth(),
            to: next.layout.first_azimuth(),
        };
        let missing = if reaches {
            self.lost_in_turns(beyond_ns, period)
        } else if self.is_dead(between) {
            let pause_ns = held.layout.time_to_turn_ns(turn(between.from, between.to));
            self.lost_in_turns(beyond_ns - pause_ns, period)
        } else {
            (beyond_ns + period / 2).div_euclid(period)
        };
        self.counters.lost += missing.max(0).cast_unsigned();
        held.layout.time_gap_from_next(elapsed_ns);
        if let Some((from, to)) = held.layout.gap() {
            self.dead_sector = Some(Sector { from, to });
        }
        self.assemble(held);
        Ok(())
    }

    /// Packets of the whole turns that fit into a time, where the rotor goes on as if there had been none.
    fn lost_in_turns(&self, unseen_ns: i64, period_ns: i64) -> i64 {
        if unseen_ns < HALF_A_TURN_NS {
            return 0;
        }
        let dead = self.dead_sector.map_or(0, |dead| turn(dead.from, dead.to));
        let firing = i64::from(TURN_CENTIDEG - dead);
        let fired_ns = unseen_ns / i64::from(TURN_CENTIDEG) * firing;
        (fired_ns + period_ns / 2) / period_ns
    }

    /// Tells a sensor whose factory bytes lie: no rotor gap between packets, and another model's packet rate.
    fn check_rate(&mut self, held: &Held, elapsed_ns: i64) -> Result<(), DecodeError> {
        if self.proven || matches!(self.config.model, ModelChoice::Force(..)) {
            return Ok(());
        }
        let (declared, mode) = (held.layout.model, held.layout.mode);
        let matches = |model: &Model| {
            (elapsed_ns - i64::from(model.packet_period_ns(mode))).abs() <= PERIOD_TOLERANCE_NS
        };
        if matches(&declared) {
            self.proven = true;
        } else if let Some(looks_like) = Model::ALL.into_iter().find(matches) {
            self.wrong_rate += 1;
            if self.wrong_rate >= WRONG_RATE_PACKETS {
                let refusal = DecodeError::WrongBytes {
                    declared,
                    looks_like,
                };
                self.refusal = Some(refusal);
                self.scans.discard();
                self.counters.refused += 1;
                return Err(refusal);
            }
        }
        Ok(())
    }

    fn is_dead(&self, between: Sector) -> bool {
        // The window's edges wander by one block.
        let near = |a: u16, b: u16| turn(a, b).min(turn(b, a)) <= 100;
        self.dead_sector
            .is_some_and(|dead| near(dead.from, between.from) && near(dead.to, between.to))
    }

    fn assemble(&mut self, held: Held) {
        let Held {
            packet,
            arrival,
            layout,
        } = held;
        let mut maker = match self.maker.take() {
            Some((model, maker)) if model == layout.model => maker,
            _ => Box::new(PointMaker::new(layout.model, self.config.optical_offset)),
        };
        let start_ns = i64::from(packet.timestamp_us()) * 1000;
        self.counters.packets += 1;
        for group in 0..layout.groups() {
            let fired_ns = start_ns + layout.group_time_ns(group);
            let azimuth_centideg = layout.group_azimuth(group);
            let block = self
                .scans
                .block(azimuth_centideg, fired_ns, arrival, &mut self.counters);
            let firing = Firing {
                azimuth_centideg,
                pace_centideg_ns: layout.pace_centideg_ns(group),
                offset_ns: block.offset_ns,
                echo: match layout.mode {
                    Returns::Strongest => Echo::Strongest,
                    Returns::Last => Echo::Last,
                    Returns::Dual => Echo::Both,
                },
            };
            let before = block.points.len();
            match layout.mode {
                Returns::Dual => {
                    let even_block = group * stride(layout.mode);
                    maker.dual(&packet, even_block, &firing, block.points);
                }
                Returns::Strongest | Returns::Last => {
                    maker.single(&packet, group, &firing, block.points);
                }
            }
            let echoes = block.points.len() - before;
            self.counters.shot(azimuth_centideg, echoes);
        }
        self.maker = Some((layout.model, maker));
        self.spare = packet.into_inner();
    }
}

/// Whether the factory bytes name another model or mode than the packet is decoded as. Bytes that name nothing do not.
fn contradicts(packet: &DataPacket<&[u8]>, model: Model, mode: Returns) -> bool {
    let product = Product::from_code(packet.product_code());
    let says_other_model = !matches!(product, Product::Unknown(_)) && product != model.product();
    let says_other_mode =
        returns_of_code(packet.return_mode_code()).is_some_and(|said| said != mode);
    says_other_model || says_other_mode
}

#[cfg(test)]
mod tests;
