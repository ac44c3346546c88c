//! Constants of the supported models, each with its manual page.

use crate::lidar::Returns;

/// Blocks in a data packet.
pub const BLOCKS: usize = 12;
/// Distances in a block.
pub const CHANNELS: usize = 32;
/// UDP ports of data and of position packets, as the sensor leaves the factory.
pub const FACTORY_PORTS: [u16; 2] = [2368, 8308];

/// The byte on the wire for each return mode. In dual mode even blocks hold the last echo, odd blocks the strongest.
pub const fn code_of_returns(returns: Returns) -> u8 {
    match returns {
        Returns::Strongest => 0x37,
        Returns::Last => 0x38,
        Returns::Dual => 0x39,
    }
}

/// `None` for a byte that names no return mode.
pub const fn returns_of_code(code: u8) -> Option<Returns> {
    match code {
        0x37 => Some(Returns::Strongest),
        0x38 => Some(Returns::Last),
        0x39 => Some(Returns::Dual),
        _ => None,
    }
}

/// A sensor this driver decodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Model {
    /// Ultra Puck, 32 lasers, 4 mm.
    #[cfg_attr(feature = "serde", serde(rename = "vlp-32c"))]
    Vlp32c,
    /// Puck, 16 lasers, 2 mm.
    #[cfg_attr(feature = "serde", serde(rename = "vlp-16"))]
    Vlp16,
    /// 32 lasers, 2 mm.
    #[cfg_attr(feature = "serde", serde(rename = "hdl-32e"))]
    Hdl32e,
}

/// A sensor that can be told from its packets, decoded or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Product {
    /// Decoded.
    Vlp32c,
    /// Decoded.
    Vlp16,
    /// Decoded.
    Hdl32e,
    /// VLP-32A or VLP-32B: other beam angles.
    Vlp32ab,
    /// Puck Hi-Res: other beam angles.
    PuckHiRes,
    /// Velarray.
    Velarray,
    /// VLS-128 (Alpha Prime).
    Vls128,
    /// HDL-64E, told by its block flags: it sends no factory bytes.
    Hdl64e,
    /// A byte no manual lists.
    Unknown(u8),
}

impl Product {
    /// From the factory byte (VLP-32C 63-9325 p. 59; 0xA1 seen in VLS-128 packets, 0x63 in an old VLP-16 manual).
    pub const fn from_code(code: u8) -> Self {
        match code {
            0x21 => Self::Hdl32e,
            0x22 => Self::Vlp16,
            0x23 => Self::Vlp32ab,
            0x24 => Self::PuckHiRes,
            0x28 => Self::Vlp32c,
            0x31 => Self::Velarray,
            0x63 | 0xA1 => Self::Vls128,
            code => Self::Unknown(code),
        }
    }

    /// The factory byte; 0 for the HDL-64E, which has none.
    pub const fn code(self) -> u8 {
        match self {
            Self::Hdl32e => 0x21,
            Self::Vlp16 => 0x22,
            Self::Vlp32ab => 0x23,
            Self::PuckHiRes => 0x24,
            Self::Vlp32c => 0x28,
            Self::Velarray => 0x31,
            Self::Vls128 => 0xA1,
            Self::Hdl64e => 0,
            Self::Unknown(code) => code,
        }
    }

    /// `None` for a sensor this driver does not decode.
    pub const fn model(self) -> Option<Model> {
        match self {
            Self::Vlp32c => Some(Model::Vlp32c),
            Self::Vlp16 => Some(Model::Vlp16),
            Self::Hdl32e => Some(Model::Hdl32e),
            _ => None,
        }
    }
}

impl std::fmt::Display for Product {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Vlp32c => "VLP-32C",
            Self::Vlp16 => "VLP-16",
            Self::Hdl32e => "HDL-32E",
            Self::Vlp32ab => "VLP-32A/B",
            Self::PuckHiRes => "Puck Hi-Res",
            Self::Velarray => "Velarray",
            Self::Vls128 => "VLS-128",
            Self::Hdl64e => "HDL-64E",
            Self::Unknown(code) => return write!(f, "unknown product {code:#04x}"),
        })
    }
}

impl std::fmt::Display for Model {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.product().fmt(f)
    }
}

/// One of the 32 distances of a block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Channel {
    /// Angle above the horizontal, degrees.
    pub elevation_deg: f64,
    /// Added to the block's azimuth, degrees. Calibration files of ROS drivers carry the opposite sign.
    pub azimuth_offset_deg: f64,
    /// Rank of the laser by elevation, 0 lowest.
    pub ring: u16,
    /// Firing time after the first firing of the block, nanoseconds.
    pub firing_ns: u32,
}

/// Everything that differs between models.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelTable {
    /// One unit of distance, millimetres.
    pub distance_unit_mm: u16,
    /// Time from one block to the next (to the next pair in dual mode), nanoseconds.
    pub block_period_ns: u32,
    /// Height of the optical centre's offset along the beam, millimetres: `z += offset * tan(-elevation)`.
    pub optical_offset_mm: f64,
    /// The channels in the order of the packet, which is the order of firing.
    pub channels: [Channel; CHANNELS],
}

impl Model {
    /// All that are decoded.
    pub const ALL: [Self; 3] = [Self::Vlp32c, Self::Vlp16, Self::Hdl32e];

    /// Its name in settings.
    pub const fn key(self) -> &'static str {
        match self {
            Self::Vlp32c => "vlp-32c",
            Self::Vlp16 => "vlp-16",
            Self::Hdl32e => "hdl-32e",
        }
    }

    /// The model's constants.
    pub const fn table(self) -> &'static ModelTable {
        match self {
            Self::Vlp32c => &VLP_32C,
            Self::Vlp16 => &VLP_16,
            Self::Hdl32e => &HDL_32E,
        }
    }

    /// How many lasers it has.
    pub fn lasers(self) -> usize {
        let rings = self
            .table()
            .channels
            .iter()
            .map(|c| usize::from(c.ring) + 1);
        rings.max().unwrap_or_default()
    }

    /// The product that this model is.
    pub const fn product(self) -> Product {
        match self {
            Self::Vlp32c => Product::Vlp32c,
            Self::Vlp16 => Product::Vlp16,
            Self::Hdl32e => Product::Hdl32e,
        }
    }

    /// Time of a block's first firing after that of block 0, nanoseconds.
    pub const fn block_time_ns(self, mode: Returns, block: usize) -> u32 {
        let steps = match mode {
            Returns::Dual => block / 2,
            Returns::Strongest | Returns::Last => block,
        };
        steps as u32 * self.table().block_period_ns
    }

    /// Time from one packet to the next while the sensor fires, nanoseconds.
    pub const fn packet_period_ns(self, mode: Returns) -> u32 {
        self.block_time_ns(mode, BLOCKS)
    }
}

/// (elevation in 0.001°, azimuth offset in 0.1°, ring) by laser: VLP-32C 63-9325 p. 54 and 56.
#[rustfmt::skip]
const VLP_32C_LASERS: [(i32, i32, u16); 32] = [
    (-25_000, 14, 0), (-1_000, -42, 17), (-1_667, 14, 15), (-15_639, -14, 1),
    (-11_310, 14, 2), (0, -14, 20), (-667, 42, 18), (-8_843, -14, 3),
    (-7_254, 14, 4), (333, -42, 21), (-333, 14, 19), (-6_148, -14, 5),
    (-5_333, 42, 6), (1_333, -14, 24), (667, 42, 22), (-4_000, -14, 8),
    (-4_667, 14, 7), (1_667, -42, 25), (1_000, 14, 23), (-3_667, -42, 9),
    (-3_333, 42, 10), (3_333, -14, 27), (2_333, 14, 26), (-2_667, -14, 12),
    (-3_000, 14, 11), (7_000, -14, 29), (4_667, 14, 28), (-2_333, -42, 13),
    (-2_000, 42, 14), (15_000, -14, 31), (10_333, 14, 30), (-1_333, -14, 16),
];

/// VLP-16 63-9243 Rev. D p. 56 (elevations), p. 60 (timing). A block holds two firings of the 16 lasers.
#[rustfmt::skip]
const VLP_16_LASERS: [(i32, i32, u16); 16] = [
    (-15_000, 0, 0), (1_000, 0, 8), (-13_000, 0, 1), (3_000, 0, 9),
    (-11_000, 0, 2), (5_000, 0, 10), (-9_000, 0, 3), (7_000, 0, 11),
    (-7_000, 0, 4), (9_000, 0, 12), (-5_000, 0, 5), (11_000, 0, 13),
    (-3_000, 0, 6), (13_000, 0, 14), (-1_000, 0, 7), (15_000, 0, 15),
];

/// HDL-32E User Manual: the lower and the upper half of the lasers take turns.
#[rustfmt::skip]
const HDL_32E_LASERS: [(i32, i32, u16); 32] = [
    (-30_670, 0, 0), (-9_330, 0, 16), (-29_330, 0, 1), (-8_000, 0, 17),
    (-28_000, 0, 2), (-6_670, 0, 18), (-26_670, 0, 3), (-5_330, 0, 19),
    (-25_330, 0, 4), (-4_000, 0, 20), (-24_000, 0, 5), (-2_670, 0, 21),
    (-22_670, 0, 6), (-1_330, 0, 22), (-21_330, 0, 7), (0, 0, 23),
    (-20_000, 0, 8), (1_330, 0, 24), (-18_670, 0, 9), (2_670, 0, 25),
    (-17_330, 0, 10), (4_000, 0, 26), (-16_000, 0, 11), (5_330, 0, 27),
    (-14_670, 0, 12), (6_670, 0, 28), (-13_330, 0, 13), (8_000, 0, 29),
    (-12_000, 0, 14), (9_330, 0, 30), (-10_670, 0, 15), (10_670, 0, 31),
];

/// Pairs fire together every 2.304 µs, 16 pairs and a pause of 18.432 µs (VLP-32C 63-9325 p. 59).
static VLP_32C: ModelTable = ModelTable {
    distance_unit_mm: 4,
    block_period_ns: 55_296,
    optical_offset_mm: 42.4,
    channels: channels(
        &VLP_32C_LASERS,
        Firing {
            lasers_per_slot: 2,
            slot_ns: 2_304,
            sequence_ns: 55_296,
        },
    ),
};

/// A laser every 2.304 µs, the next firing after 55.296 µs (VLP-16 63-9243 Rev. D p. 60).
static VLP_16: ModelTable = ModelTable {
    distance_unit_mm: 2,
    block_period_ns: 2 * 55_296,
    optical_offset_mm: 41.91,
    channels: channels(
        &VLP_16_LASERS,
        Firing {
            lasers_per_slot: 1,
            slot_ns: 2_304,
            sequence_ns: 55_296,
        },
    ),
};

/// A laser every 1.152 µs, a block every 46.08 µs (HDL-32E User Manual; drivers disagree by up to 18 µs inside a block).
static HDL_32E: ModelTable = ModelTable {
    distance_unit_mm: 2,
    block_period_ns: 46_080,
    optical_offset_mm: 28.83,
    channels: channels(
        &HDL_32E_LASERS,
        Firing {
            lasers_per_slot: 1,
            slot_ns: 1_152,
            sequence_ns: 46_080,
        },
    ),
};

struct Firing {
    lasers_per_slot: usize,
    slot_ns: u32,
    sequence_ns: u32,
}

const fn channels(lasers: &[(i32, i32, u16)], firing: Firing) -> [Channel; CHANNELS] {
    let mut table = [Channel {
        elevation_deg: 0.0,
        azimuth_offset_deg: 0.0,
        ring: 0,
        firing_ns: 0,
    }; CHANNELS];
    let mut k = 0;
    while k < CHANNELS {
        let laser = k % lasers.len();
        let (elevation, offset, ring) = lasers[laser];
        table[k] = Channel {
            elevation_deg: elevation as f64 / 1_000.0,
            azimuth_offset_deg: offset as f64 / 10.0,
            ring,
            firing_ns: (k / lasers.len()) as u32 * firing.sequence_ns
                + (laser / firing.lasers_per_slot) as u32 * firing.slot_ns,
        };
        k += 1;
    }
    table
}
