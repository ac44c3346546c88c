//! Packets to scans: model and mode, loss, the cut into revolutions. Geometry of one packet is in [`super::layout`].

use std::collections::VecDeque;

use lsfb_types::{LidarPoint, LidarScan, Packet, Timestamp};

use super::layout::{PacketLayout, stride, turn};
use super::model::{Model, Product};
use super::points::{Firing, PointMaker};
use super::wire::{DataPacket, ReturnMode, TURN_CENTIDEG, identify};
use crate::{Decoded, WireError};

const HOUR_NS: i64 = 3_600_000_000_000;
/// UDP on one network reorders within milliseconds; a larger step back is a clock that was set.
const LATE_NS: i64 = 100_000_000;
/// Packets in a row that come late: from then on it was the one before them whose time is wrong.
const MOST_LATE: u32 = 8;
/// A device clock and a host clock that disagree by more between two packets: one of them was set.
const CLOCK_JUMP_NS: i64 = 500_000_000;
/// The slowest motor setting, 300 rpm, turns in 0.2 s: a longer scan means a stopped rotor.
const LONGEST_SCAN_NS: i64 = 1_000_000_000;
/// Encoder jitter around a stop may step back this far.
const JITTER_CENTIDEG: u16 = 30;
/// Timestamps are whole microseconds.
const PERIOD_TOLERANCE_NS: i64 = 3_000;
/// Packets at another model's rate that settle that the factory bytes are wrong: far less than one revolution.
const WRONG_RATE_PACKETS: u32 = 8;

/// Whose word counts for model and return mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ModelChoice {
    /// The factory bytes of the packets.
    #[default]
    FromPackets,
    /// The factory bytes, and packets of any other model are refused.
    Expect(Model),
    /// These, whatever the factory bytes say: old firmware leaves them meaningless.
    Force(Model, ReturnMode),
}

/// Whether the optical centre's vertical offset is modelled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OpticalOffset {
    /// Beams start at the origin, as in ros-drivers and nebula.
    #[default]
    Ignored,
    /// `z += f tan(-elevation)`, as in velodyne_decoder: up to 2 cm at the steepest beam.
    Applied,
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

/// Why a packet gave no points. Every such packet is counted in [`Counters`] too.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// Not a data packet of a supported layout.
    #[error(transparent)]
    Wire(#[from] WireError),
    /// A sensor that is recognised and not decoded.
    #[error("{product} packets are not supported; VLP-32C, VLP-16 and HDL-32E are")]
    Unsupported {
        /// What it is.
        product: Product,
    },
    /// Another sensor than the configured one.
    #[error("packets of a {got} where a {expected} is configured")]
    WrongModel {
        /// The configured model.
        expected: Model,
        /// What the packets say.
        got: Product,
    },
    /// The factory bytes contradict the packet rate.
    #[error(
        "packets claim to be of a {declared} but come at the rate of a {looks_like}: force the model"
    )]
    WrongBytes {
        /// What the packets say.
        declared: Model,
        /// Whose rate they have.
        looks_like: Model,
    },
    /// The return mode byte names no mode.
    #[error("return mode {code:#04x} is none of 0x37, 0x38, 0x39: force the mode")]
    ReturnMode {
        /// The byte.
        code: u8,
    },
}

/// What a [`Decoder`] has seen. All counts only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Data packets decoded.
    pub packets: u64,
    /// Returns decoded.
    pub points: u64,
    /// Scans finished.
    pub scans: u64,
    /// Packets of a wrong length, flag or azimuth.
    pub malformed: u64,
    /// Packets of another model or mode than can be decoded.
    pub refused: u64,
    /// Packets that are missing by the timestamps of their neighbours.
    pub lost: u64,
    /// Packets that came after a later one; left out of the scan.
    pub late: u64,
    /// Packets that came twice; the second is left out.
    pub duplicates: u64,
    /// Times the sensor's clock was set.
    pub clock_jumps: u64,
    /// Times model or return mode changed.
    pub mode_changes: u64,
    /// Packets decoded as [`ModelChoice::Force`] says whose factory bytes name another model or mode.
    pub contradicting: u64,
    /// Scans ended because the rotor did not come round.
    pub overlong: u64,
}

/// Turns data packets into scans. Times are the sensor's own.
///
/// Output lags by one packet: what comes after the gap of a field-of-view window is timed from the next packet.
/// `device_ticks` of a scan are nanoseconds since the top of the sensor's hour, below 3.6e12, at its first firing.
pub struct Decoder {
    config: DecoderConfig,
    held: Option<Held>,
    scan: Option<Building>,
    previous_azimuth: Option<u16>,
    dead_sector: Option<Sector>,
    wrong_rate: u32,
    late_in_a_row: u32,
    proven: bool,
    refusal: Option<DecodeError>,
    ready: VecDeque<Decoded<LidarScan>>,
    /// Points of the last scan: room for the next.
    usual_points: usize,
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

struct Building {
    first_ns: i64,
    arrival: Timestamp,
    points: Vec<LidarPoint>,
}

/// Where a field-of-view window keeps the sensor from firing: last block before, first block after.
#[derive(Clone, Copy)]
struct Sector {
    from: u16,
    to: u16,
}

/// What the time between two packets says.
enum Step {
    Next { elapsed_ns: i64 },
    Duplicate,
    Late,
    ClockJump,
}

impl Decoder {
    /// A decoder that has seen nothing.
    pub fn new(config: DecoderConfig) -> Self {
        Self {
            config,
            held: None,
            scan: None,
            previous_azimuth: None,
            dead_sector: None,
            wrong_rate: 0,
            late_in_a_row: 0,
            proven: false,
            refusal: None,
            ready: VecDeque::new(),
            usual_points: 0,
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
                self.flush();
            } else {
                match step(&held, &next) {
                    Step::Duplicate => {
                        self.counters.duplicates += 1;
                        return Ok(self.keep(held, next));
                    }
                    Step::Late if self.late_in_a_row < MOST_LATE => {
                        self.late_in_a_row += 1;
                        self.counters.late += 1;
                        return Ok(self.keep(held, next));
                    }
                    Step::Late | Step::ClockJump => {
                        self.counters.clock_jumps += 1;
                        self.assemble(held);
                        self.flush();
                    }
                    Step::Next { elapsed_ns } => self.advance(held, &next, elapsed_ns)?,
                }
            }
        }
        self.late_in_a_row = 0;
        self.held = Some(next);
        Ok(self.ready.pop_front())
    }

    /// Goes on waiting for the successor of `held`.
    fn keep(&mut self, held: Held, left_out: Held) -> Option<Decoded<LidarScan>> {
        self.spare = left_out.packet.into_inner();
        self.held = Some(held);
        self.ready.pop_front()
    }

    /// Ends the stream: what is left, one scan per call, until `None`.
    pub fn finish(&mut self) -> Option<Decoded<LidarScan>> {
        if let Some(held) = self.held.take() {
            self.assemble(held);
        }
        self.flush();
        self.ready.pop_front()
    }

    /// What was seen so far.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    fn accept<'a>(
        &self,
        bytes: &'a [u8],
    ) -> Result<(DataPacket<&'a [u8]>, Model, ReturnMode), DecodeError> {
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
        let mode = ReturnMode::from_code(code).ok_or(DecodeError::ReturnMode { code })?;
        Ok((data, model, mode))
    }

    /// Decodes `held`, now that its successor is known.
    fn advance(&mut self, mut held: Held, next: &Held, elapsed_ns: i64) -> Result<(), DecodeError> {
        let period = held.layout.packet_period_ns();
        let contiguous = held.layout.reaches(&next.layout);
        if contiguous {
            self.check_rate(&held, elapsed_ns)?;
        }
        let missing = (elapsed_ns - held.layout.span_ns() + period / 2).div_euclid(period);
        let between = Sector {
            from: held.layout.last_azimuth(),
            to: next.layout.first_azimuth(),
        };
        if missing > 0 && !contiguous && !self.is_dead(between) {
            self.counters.lost += missing as u64;
        }
        held.layout.time_gap_from_next(elapsed_ns);
        if let Some((from, to)) = held.layout.gap() {
            self.dead_sector = Some(Sector { from, to });
        }
        self.assemble(held);
        Ok(())
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
                self.scan = None;
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
            self.cut_before(azimuth_centideg, fired_ns);
            let scan = self.scan.get_or_insert_with(|| Building {
                first_ns: fired_ns.rem_euclid(HOUR_NS),
                arrival,
                points: Vec::with_capacity(self.usual_points),
            });
            let firing = Firing {
                azimuth_centideg,
                pace_centideg_ns: layout.pace_centideg_ns(group),
                offset_ns: (fired_ns - scan.first_ns).rem_euclid(HOUR_NS) as u32,
            };
            let before = scan.points.len();
            match layout.mode {
                ReturnMode::Dual => {
                    let even_block = group * stride(layout.mode);
                    maker.dual(&packet, even_block, &firing, &mut scan.points);
                }
                ReturnMode::Strongest | ReturnMode::Last => {
                    maker.single(&packet, group, &firing, &mut scan.points);
                }
            }
            self.counters.points += (scan.points.len() - before) as u64;
        }
        self.maker = Some((layout.model, maker));
        self.spare = packet.into_inner();
    }

    /// Ends the scan where the rotor passed the cut since the last block, or did not come round for too long.
    fn cut_before(&mut self, azimuth: u16, time_ns: i64) {
        if let Some(scan) = &self.scan
            && (time_ns - scan.first_ns).rem_euclid(HOUR_NS) > LONGEST_SCAN_NS
        {
            self.counters.overlong += 1;
            self.flush();
        }
        let Some(previous) = self.previous_azimuth else {
            self.previous_azimuth = Some(azimuth);
            return;
        };
        let moved = turn(previous, azimuth);
        if moved > TURN_CENTIDEG - JITTER_CENTIDEG {
            return;
        }
        let to_cut = turn(previous, self.config.cut_azimuth_centideg % TURN_CENTIDEG);
        if to_cut > 0 && to_cut <= moved {
            self.flush();
        }
        self.previous_azimuth = Some(azimuth);
    }

    fn flush(&mut self) {
        if let Some(scan) = self.scan.take() {
            self.counters.scans += 1;
            // Revolutions differ by a few blocks: with room for these the next one need not move.
            self.usual_points = scan.points.len() + scan.points.len() / 16;
            self.ready.push_back(Decoded {
                arrival: scan.arrival,
                device_ticks: scan.first_ns as u64,
                sample: LidarScan {
                    points: scan.points,
                },
            });
        }
    }
}

/// Whether the factory bytes name another model or mode than the packet is decoded as. Bytes that name nothing do not.
fn contradicts(packet: &DataPacket<&[u8]>, model: Model, mode: ReturnMode) -> bool {
    let product = Product::from_code(packet.product_code());
    let says_other_model = !matches!(product, Product::Unknown(_)) && product != model.product();
    let says_other_mode =
        ReturnMode::from_code(packet.return_mode_code()).is_some_and(|said| said != mode);
    says_other_model || says_other_mode
}

fn step(held: &Held, next: &Held) -> Step {
    let moved =
        (i64::from(next.packet.timestamp_us()) - i64::from(held.packet.timestamp_us())) * 1000;
    // Into half an hour around zero: the counter wraps at the hour.
    let elapsed_ns = (moved + HOUR_NS / 2).rem_euclid(HOUR_NS) - HOUR_NS / 2;
    let disagreement = (elapsed_ns - (next.arrival - held.arrival)).abs();
    if elapsed_ns == 0 {
        Step::Duplicate
    } else if (-LATE_NS..0).contains(&elapsed_ns) {
        Step::Late
    } else if elapsed_ns < 0 || (elapsed_ns > CLOCK_JUMP_NS && disagreement > CLOCK_JUMP_NS) {
        Step::ClockJump
    } else {
        Step::Next { elapsed_ns }
    }
}

#[cfg(test)]
mod tests;
