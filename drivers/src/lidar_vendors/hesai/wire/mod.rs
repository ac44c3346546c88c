//! Byte layout of Hesai data packets. Multi-byte fields are little-endian.

use lsfb_types::Echo;

use super::model::{Layout, Model};
use crate::WireError;
use crate::lidar::TURN_CENTIDEG;

/// Longest data packet of a supported model.
pub const MOST_BYTES: usize = 1198;
const START: [u8; 2] = [0xEE, 0xFF];
/// Number of the packet, where it is there: the last bytes.
const SEQUENCE_BYTES: usize = 4;
/// Distances are sent in units of so many millimetres.
const UNIT_MM: u8 = 4;
/// What the manuals say a unit sends in front of the date or behind the time.
const FACTORY_INFORMATION: u8 = 0x42;

/// Which echoes a sensor sends. Dual modes fill two blocks for each shot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReturnMode {
    /// The nearest echo.
    First,
    /// The second nearest.
    Second,
    /// The brightest.
    Strongest,
    /// The farthest.
    Last,
    /// The farthest and the brightest, or the second brightest where the farthest is the brightest.
    LastStrongest,
    /// The nearest two.
    FirstSecond,
    /// The nearest and the farthest.
    FirstLast,
    /// The nearest and the brightest, or the second brightest where the nearest is the brightest.
    FirstStrongest,
}

impl ReturnMode {
    /// All that are known.
    pub const ALL: [Self; 8] = [
        Self::First,
        Self::Second,
        Self::Strongest,
        Self::Last,
        Self::LastStrongest,
        Self::FirstSecond,
        Self::FirstLast,
        Self::FirstStrongest,
    ];

    /// The byte on the wire.
    pub const fn code(self) -> u8 {
        match self {
            Self::First => 0x33,
            Self::Second => 0x34,
            Self::Strongest => 0x37,
            Self::Last => 0x38,
            Self::LastStrongest => 0x39,
            Self::FirstSecond => 0x3A,
            Self::FirstLast => 0x3B,
            Self::FirstStrongest => 0x3C,
        }
    }

    /// `None` for a byte that names no mode, and for triple returns, which no supported model has.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| mode.code() == code)
    }

    /// What the echoes of a shot are, the nearer one first. The blocks of a shot stand in either order: an XT32 whose manual
    /// says the farthest comes first sends it last. Distances settle it.
    pub const fn echoes(self) -> &'static [Echo] {
        match self {
            Self::First => &[Echo::First],
            Self::Second => &[Echo::Second],
            Self::Strongest => &[Echo::Strongest],
            Self::Last => &[Echo::Last],
            Self::LastStrongest => &[Echo::Strongest, Echo::Last],
            Self::FirstSecond => &[Echo::First, Echo::Second],
            Self::FirstLast => &[Echo::First, Echo::Last],
            Self::FirstStrongest => &[Echo::First, Echo::Strongest],
        }
    }

    /// How people call it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::First => "first",
            Self::Second => "second",
            Self::Strongest => "strongest",
            Self::Last => "last",
            Self::LastStrongest => "last + strongest",
            Self::FirstSecond => "first + second",
            Self::FirstLast => "first + last",
            Self::FirstStrongest => "first + strongest",
        }
    }
}

/// The sensor's time of day in UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clock {
    /// Year after 1900, month from 1, day from 1.
    pub date: [u8; 3],
    /// Hour, minute, second.
    pub time: [u8; 3],
    /// Microseconds of the second.
    pub micros: u32,
}

/// A sensor that can be told from its packets and is not decoded.
pub fn unsupported(bytes: &[u8]) -> Option<&'static str> {
    match (bytes.len(), bytes) {
        // No header: blocks that begin with their own flag.
        (1_262 | 1_266, [0xFF, 0xEE, ..]) => Some("Pandar40P"),
        (_, [0xEE, 0xFF, 1, _, _, _, 128, ..]) => Some("Pandar128 or OT128"),
        (_, [0xEE, 0xFF, 3, 2, ..]) => Some("QT128"),
        (_, [0xEE, 0xFF, 4, ..]) => Some("AT128"),
        (_, [0xEE, 0xFF, 6, 1, _, _, 16, ..]) => Some("XT16"),
        (_, [0xEE, 0xFF, 6, 1, _, _, 32, 6, ..]) => Some("XT32M"),
        _ => None,
    }
}

/// Whether a datagram begins like a data packet of a supported model and is as long.
pub fn has_length_of_a_model(bytes: &[u8]) -> bool {
    let is_as_long = |model: Model| {
        let len = model.layout().len;
        bytes.len() == len || bytes.len() == len + SEQUENCE_BYTES
    };
    bytes.starts_with(&START) && Model::ALL.into_iter().any(is_as_long)
}

/// A view of one data packet.
#[derive(Clone, Debug)]
pub struct DataPacket<T> {
    bytes: T,
    model: Model,
    layout: &'static Layout,
}

impl<T: AsRef<[u8]>> DataPacket<T> {
    /// Finds the model and checks length, start, unit, every azimuth and the clock, so that no getter can panic.
    pub fn new(bytes: T) -> Result<Self, WireError> {
        let b = bytes.as_ref();
        let model = model_of(b)?;
        let layout = model.layout();
        if b.len() != layout.len && b.len() != layout.len + SEQUENCE_BYTES {
            return Err(WireError::Length {
                expected: layout.len,
                got: b.len(),
            });
        }
        let unit = b[layout.unit_at];
        if unit != UNIT_MM {
            return Err(WireError::Value {
                field: "distance unit",
                offset: layout.unit_at,
                got: unit.into(),
            });
        }
        let packet = Self {
            bytes,
            model,
            layout,
        };
        for block in 0..layout.blocks {
            let azimuth = packet.azimuth_centideg(block);
            if azimuth >= TURN_CENTIDEG {
                return Err(WireError::Value {
                    field: "azimuth",
                    offset: layout.block(block),
                    got: azimuth.into(),
                });
            }
        }
        let clock = packet.clock();
        let [_, minute, second] = clock.time;
        // A second lasts 1000001 µs at most: units count a little beyond it before they are set.
        if minute > 59 || second > 60 || clock.micros > 1_001_000 {
            return Err(WireError::Value {
                field: "time",
                offset: layout.date,
                got: clock.micros.into(),
            });
        }
        Ok(packet)
    }

    /// The sensor.
    pub fn model(&self) -> Model {
        self.model
    }

    /// Where its fields lie.
    pub fn layout(&self) -> &'static Layout {
        self.layout
    }

    /// Rotor angle of a block, clockwise seen from above, 0.01°, below 36000.
    pub fn azimuth_centideg(&self, block: usize) -> u16 {
        self.u16_at(self.layout.block(block))
    }

    /// Distance of a channel, 4 mm; 0 where nothing came back.
    pub fn distance_raw(&self, block: usize, channel: usize) -> u16 {
        self.u16_at(self.channel(block, channel))
    }

    /// Reflectivity of a channel, percent: above 100 for retro-reflectors.
    pub fn reflectivity(&self, block: usize, channel: usize) -> u8 {
        self.b()[self.channel(block, channel) + 2]
    }

    /// The return mode byte; see [`ReturnMode::from_code`].
    pub fn return_mode_code(&self) -> u8 {
        self.b()[self.layout.return_mode]
    }

    /// Speed of the motor, revolutions per minute.
    pub fn motor_rpm(&self) -> u16 {
        self.u16_at(self.layout.motor_speed)
    }

    /// The sensor's clock at the packet's reference instant; its manual says which firing that is.
    pub fn clock(&self) -> Clock {
        let b = self.b();
        let at = |k: usize| b[self.layout.date + k];
        let [t0, t1, t2, t3] = [0, 1, 2, 3].map(|k| b[self.layout.timestamp + k]);
        Clock {
            date: [at(0), at(1), at(2)],
            time: [at(3), at(4), at(5)],
            micros: u32::from_le_bytes([t0, t1, t2, t3]),
        }
    }

    /// Nanoseconds since the top of the sensor's hour.
    pub fn toh_ns(&self) -> i64 {
        let clock = self.clock();
        let [_, minute, second] = clock.time.map(i64::from);
        ((minute * 60 + second) * 1_000_000 + i64::from(clock.micros)) * 1_000
    }

    /// Number of the packet, where it carries one.
    pub fn sequence(&self) -> Option<u32> {
        let at = self.layout.len;
        let bytes = self.b().get(at..)?.first_chunk::<SEQUENCE_BYTES>()?;
        Some(u32::from_le_bytes(*bytes))
    }

    /// All bytes.
    pub fn bytes(&self) -> &[u8] {
        self.b()
    }

    fn b(&self) -> &[u8] {
        self.bytes.as_ref()
    }

    fn channel(&self, block: usize, channel: usize) -> usize {
        self.layout.block(block) + 2 + channel * self.layout.channel_bytes
    }

    fn u16_at(&self, at: usize) -> u16 {
        u16::from_le_bytes([self.b()[at], self.b()[at + 1]])
    }
}

/// A data packet without a return, of each model in each return mode.
pub fn blank_packets() -> Vec<(Model, Vec<u8>)> {
    let mut all = Vec::new();
    for model in Model::ALL {
        for mode in ReturnMode::ALL {
            let bytes = vec![0; model.layout().len + SEQUENCE_BYTES];
            if let Ok(packet) = DataPacket::init(bytes, model, mode) {
                all.push((model, packet.into_inner()));
            }
        }
    }
    all
}

impl<T: AsRef<[u8]> + AsMut<[u8]>> DataPacket<T> {
    /// Clears the bytes and writes what every packet has. Room for a number behind the packet is optional.
    pub fn init(mut bytes: T, model: Model, mode: ReturnMode) -> Result<Self, WireError> {
        let layout = model.layout();
        let b = bytes.as_mut();
        if b.len() != layout.len && b.len() != layout.len + SEQUENCE_BYTES {
            return Err(WireError::Length {
                expected: layout.len,
                got: b.len(),
            });
        }
        let has_sequence = b.len() > layout.len;
        b.fill(0);
        b[..2].copy_from_slice(&START);
        b[2..4].copy_from_slice(&layout.version);
        b[layout.lasers_at] = layout.channels as u8;
        b[layout.lasers_at + 1] = layout.blocks as u8;
        b[layout.unit_at] = UNIT_MM;
        if layout.lasers_at == 6 {
            // Blocks before the unit: which echo the first one holds. Behind it: echoes, and flags.
            let echoes = mode.echoes().len() as u8;
            b[8] = u8::from(echoes > 1);
            b[10] = 2;
            b[11] = u8::from(has_sequence);
        }
        b[layout.return_mode] = mode.code();
        b[factory_information_at(layout)] = FACTORY_INFORMATION;
        Ok(Self {
            bytes,
            model,
            layout,
        })
    }

    /// Sets the rotor angle of a block; whole turns are taken off.
    pub fn set_azimuth_centideg(&mut self, block: usize, value: u16) {
        let at = self.layout.block(block);
        self.put(at, &(value % TURN_CENTIDEG).to_le_bytes());
    }

    /// Sets distance (4 mm) and reflectivity of a channel.
    pub fn set_return(
        &mut self,
        block: usize,
        channel: usize,
        distance_raw: u16,
        reflectivity: u8,
    ) {
        let at = self.channel(block, channel);
        let [low, high] = distance_raw.to_le_bytes();
        self.put(at, &[low, high, reflectivity]);
    }

    /// Sets the speed of the motor, revolutions per minute.
    pub fn set_motor_rpm(&mut self, value: u16) {
        self.put(self.layout.motor_speed, &value.to_le_bytes());
    }

    /// Sets the sensor's clock.
    pub fn set_clock(&mut self, clock: &Clock) {
        self.put(self.layout.date, &clock.date);
        self.put(self.layout.date + 3, &clock.time);
        self.put(self.layout.timestamp, &clock.micros.to_le_bytes());
    }

    /// Sets the number of the packet, where there is room for it.
    pub fn set_sequence(&mut self, value: u32) {
        if self.bytes.as_ref().len() > self.layout.len {
            self.put(self.layout.len, &value.to_le_bytes());
        }
    }

    fn put(&mut self, at: usize, value: &[u8]) {
        self.bytes.as_mut()[at..at + value.len()].copy_from_slice(value);
    }
}

impl<T> DataPacket<T> {
    /// Gives the bytes back.
    pub fn into_inner(self) -> T {
        self.bytes
    }
}

/// The XT32 says it behind the time, the others in front of the date.
const fn factory_information_at(layout: &Layout) -> usize {
    if layout.timestamp > layout.date {
        layout.timestamp + 4
    } else {
        layout.date - 1
    }
}

fn model_of(bytes: &[u8]) -> Result<Model, WireError> {
    let Some(head) = bytes.first_chunk::<12>() else {
        return Err(WireError::Length {
            expected: Model::Xt32.layout().len,
            got: bytes.len(),
        });
    };
    if head[..2] != START {
        return Err(WireError::Constant {
            offset: 0,
            expected: u16::from_be_bytes(START).into(),
            got: u16::from_be_bytes([head[0], head[1]]).into(),
        });
    }
    let is_of = |model: &Model| {
        let layout = model.layout();
        let counts = [layout.channels as u8, layout.blocks as u8];
        head[2..4] == layout.version && head[layout.lasers_at..layout.lasers_at + 2] == counts
    };
    Model::ALL.into_iter().find(is_of).ok_or(WireError::Value {
        field: "protocol version",
        offset: 2,
        got: u16::from_be_bytes([head[2], head[3]]).into(),
    })
}

#[cfg(test)]
mod tests;
