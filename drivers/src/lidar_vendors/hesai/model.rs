//! Constants of the supported models: user manuals of the PandarXT-32, the Pandar64 and the PandarQT, their appendices on
//! channels and on the absolute time of point cloud data.

/// UDP ports of data packets and of those about the GPS input, as the sensor leaves the factory.
pub const FACTORY_PORTS: [u16; 2] = [2368, 10110];

/// A sensor this driver decodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// PandarXT-32: 32 lasers, 31° upright, 120 m.
    Xt32,
    /// Pandar64: 64 lasers, 40° upright, 200 m.
    Pandar64,
    /// PandarQT: 64 lasers, 104° upright, 20 m.
    Qt64,
}

impl Model {
    /// All that are decoded.
    pub const ALL: [Self; 3] = [Self::Xt32, Self::Pandar64, Self::Qt64];

    /// Its layout and timing.
    pub const fn layout(self) -> &'static Layout {
        match self {
            Self::Xt32 => &XT32,
            Self::Pandar64 => &PANDAR64,
            Self::Qt64 => &QT64,
        }
    }

    /// How many lasers it has.
    pub fn lasers(self) -> usize {
        self.layout().channels
    }

    /// Elevation and azimuth of a channel by the manual, degrees; zero for a channel that it has not.
    pub fn angles_deg(self, channel: usize) -> [f64; 2] {
        let listed = |table: &[(i32, i32)]| {
            let (elevation, azimuth) = table.get(channel).copied().unwrap_or_default();
            [elevation, azimuth].map(|millideg| f64::from(millideg) / 1000.0)
        };
        match self {
            // One degree apart from 15° down.
            Self::Xt32 => [15.0 - channel as f64, 0.0],
            Self::Pandar64 => listed(&PANDAR64_ANGLES),
            Self::Qt64 => listed(&QT64_ANGLES),
        }
    }

    /// When a channel fires, after the timestamp of its packet, nanoseconds. `returns`: blocks of one shot.
    pub fn firing_ns(self, block: usize, channel: usize, returns: usize) -> i64 {
        self.block_ns(block, returns) + self.channel_ns(channel)
    }

    /// Beginning of a block's firings after the timestamp of its packet, nanoseconds.
    pub fn block_ns(self, block: usize, returns: usize) -> i64 {
        let returns = returns.max(1);
        let (shot, last) = (block / returns, (self.layout().blocks - 1) / returns);
        let before_last = last.saturating_sub(shot) as i64;
        match self {
            Self::Xt32 => 5_632 - 50_000 * before_last,
            Self::Pandar64 => -42_580 - 55_560 * before_last,
            Self::Qt64 => 25_710 + 500_000 * shot as i64 / 3,
        }
    }

    /// When a channel fires after the beginning of its block, nanoseconds.
    pub fn channel_ns(self, channel: usize) -> i64 {
        let listed = |table: &[i32]| table.get(channel).copied().unwrap_or_default().into();
        match self {
            Self::Xt32 => 368 + 1_512 * channel as i64,
            Self::Pandar64 => listed(&PANDAR64_FIRING_NS),
            Self::Qt64 => listed(&QT64_FIRING_NS),
        }
    }

    /// Time from one shot of all channels to the next, nanoseconds.
    pub const fn shot_ns(self) -> i64 {
        match self {
            Self::Xt32 => 50_000,
            Self::Pandar64 => 55_560,
            Self::Qt64 => 166_667,
        }
    }
}

impl std::fmt::Display for Model {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Xt32 => "XT32",
            Self::Pandar64 => "Pandar64",
            Self::Qt64 => "QT64",
        })
    }
}

/// Where the fields of a data packet lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Bytes 2 and 3: protocol version, or of the Pandar64 lasers and blocks.
    pub version: [u8; 2],
    /// Where the number of lasers stands; that of blocks is behind it.
    pub lasers_at: usize,
    /// Where the unit of distance stands, millimetres.
    pub unit_at: usize,
    /// First byte of block 0.
    pub body: usize,
    /// Blocks.
    pub blocks: usize,
    /// Channels of a block.
    pub channels: usize,
    /// Bytes of a channel: distance, reflectivity, and in some models one more.
    pub channel_bytes: usize,
    /// Where the return mode stands.
    pub return_mode: usize,
    /// Where the speed of the motor stands, revolutions per minute.
    pub motor_speed: usize,
    /// Where the date stands, six bytes.
    pub date: usize,
    /// Where the microseconds of the second stand.
    pub timestamp: usize,
    /// Bytes without the number of the packet; it may follow as four more.
    pub len: usize,
}

impl Layout {
    /// First byte of a block.
    pub const fn block(&self, block: usize) -> usize {
        self.body + block * (2 + self.channels * self.channel_bytes)
    }
}

static XT32: Layout = Layout {
    version: [6, 1],
    lasers_at: 6,
    unit_at: 9,
    body: 12,
    blocks: 8,
    channels: 32,
    channel_bytes: 4,
    return_mode: 1062,
    motor_speed: 1063,
    date: 1065,
    timestamp: 1071,
    len: 1076,
};

static PANDAR64: Layout = Layout {
    version: [64, 6],
    lasers_at: 2,
    unit_at: 5,
    body: 8,
    blocks: 6,
    channels: 64,
    channel_bytes: 3,
    return_mode: 1186,
    motor_speed: 1180,
    date: 1188,
    timestamp: 1182,
    len: 1194,
};

static QT64: Layout = Layout {
    version: [3, 1],
    lasers_at: 6,
    unit_at: 9,
    body: 12,
    blocks: 4,
    channels: 64,
    channel_bytes: 4,
    return_mode: 1060,
    motor_speed: 1054,
    date: 1062,
    timestamp: 1056,
    len: 1068,
};

/// Elevation and azimuth by channel, 0.001°: Pandar64 user manual, appendix on channels.
#[rustfmt::skip]
const PANDAR64_ANGLES: [(i32, i32); 64] = [
    (14900, -1042), (11050, -1042), (8077, -1042), (5075, -1042),
    (3058, -1042), (2046, -1042), (1878, 1042), (1706, 3125),
    (1540, 5208), (1369, -5208), (1202, -3125), (1031, -1042),
    (864, 1042), (693, 3125), (526, 5208), (355, -5208),
    (187, -3125), (18, -1042), (-151, 1042), (-319, 3125),
    (-490, 5208), (-657, -5208), (-827, -3125), (-995, -1042),
    (-1166, 1042), (-1333, 3125), (-1504, 5208), (-1670, -5208),
    (-1842, -3125), (-2010, -1042), (-2180, 1042), (-2347, 3125),
    (-2518, 5208), (-2682, -5208), (-2855, -3125), (-3022, -1042),
    (-3192, 1042), (-3357, 3125), (-3530, 5208), (-3694, -5208),
    (-3866, -3125), (-4032, -1042), (-4203, 1042), (-4367, 3125),
    (-4540, 5208), (-4702, -5208), (-4874, -3125), (-5039, -1042),
    (-5211, 1042), (-5373, 3125), (-5547, 5208), (-5708, -5208),
    (-5880, -3125), (-6043, -1042), (-7045, -1042), (-8041, -1042),
    (-9042, -1042), (-10027, -1042), (-11014, -1042), (-11988, -1042),
    (-12956, -1042), (-13912, -1042), (-18871, -1042), (-24879, -1042),
];

/// Firing times by channel, nanoseconds: Pandar64 user manual, appendix on absolute time.
#[rustfmt::skip]
const PANDAR64_FIRING_NS: [i32; 64] = [
    -23_180, -21_876, -20_572, -19_268, -17_964, -16_660, -11_444, -46_796,
    -7_532, -36_956, -50_732, -54_668, -40_892, -44_828, -31_052, -34_988,
    -48_764, -52_700, -38_924, -42_860, -29_084, -33_020, -46_796, -25_148,
    -36_956, -50_732, -27_116, -40_892, -44_828, -31_052, -34_988, -48_764,
    -25_148, -38_924, -42_860, -29_084, -33_020, -52_700, -6_228, -54_668,
    -15_356, -27_116, -10_140, -23_180, -4_924, -21_876, -14_052, -17_964,
    -8_836, -19_268, -3_620, -20_572, -12_748, -16_660, -7_532, -11_444,
    -6_228, -15_356, -10_140, -4_924, -3_620, -14_052, -8_836, -12_748,
];

/// Elevation and azimuth by channel, 0.001°: PandarQT user manual, appendix on channels.
#[rustfmt::skip]
const QT64_ANGLES: [(i32, i32); 64] = [
    (-52121, 8736), (-49785, 8314), (-47577, 7964), (-45477, 7669),
    (-43465, 7417), (-41528, 7198), (-39653, 7007), (-37831, 6838),
    (-36055, 6688), (-34320, 6554), (-32619, 6434), (-30950, 6326),
    (-29308, 6228), (-27690, 6140), (-26094, 6059), (-24517, 5987),
    (-22964, -5270), (-21420, -5216), (-19889, -5167), (-18372, -5123),
    (-16865, -5083), (-15368, -5047), (-13880, -5016), (-12399, -4988),
    (-10925, -4963), (-9457, -4942), (-7994, -4924), (-6535, -4910),
    (-5079, -4898), (-3626, -4889), (-2175, -4884), (-725, -4881),
    (725, 5493), (2175, 5496), (3626, 5502), (5079, 5512),
    (6534, 5525), (7993, 5541), (9456, 5561), (10923, 5584),
    (12397, 5611), (13877, 5642), (15365, 5676), (16861, 5716),
    (18368, 5759), (19885, 5808), (21415, 5862), (22959, 5921),
    (24524, -5330), (26101, -5396), (27697, -5469), (29315, -5550),
    (30957, -5640), (32627, -5740), (34328, -5850), (36064, -5974),
    (37840, -6113), (39662, -6269), (41537, -6447), (43475, -6651),
    (45487, -6887), (47587, -7163), (49795, -7493), (52133, -7892),
];

/// Firing times by channel, nanoseconds: PandarQT user manual, appendix on absolute time.
#[rustfmt::skip]
const QT64_FIRING_NS: [i32; 64] = [
    12_310, 14_370, 16_430, 18_490, 20_540, 22_600, 24_660, 26_710,
    29_160, 31_220, 33_280, 35_340, 37_390, 39_450, 41_500, 43_560,
    46_610, 48_670, 50_730, 52_780, 54_840, 56_900, 58_950, 61_010,
    63_450, 65_520, 67_580, 69_630, 71_690, 73_740, 75_800, 77_860,
    80_900, 82_970, 85_020, 87_080, 89_140, 91_190, 93_250, 95_300,
    97_750, 99_820, 101_870, 103_930, 105_980, 108_040, 110_100, 112_150,
    115_200, 117_260, 119_320, 121_380, 123_430, 125_490, 127_540, 129_600,
    132_050, 134_110, 136_170, 138_220, 140_280, 142_340, 144_390, 146_450,
];
