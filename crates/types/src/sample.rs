use crate::Timestamp;

/// Standard gravity, m/s²: what an accelerometer at rest measures, nearly, and what devices that count in g mean by it.
pub const STANDARD_GRAVITY_M_S2: f64 = 9.806_65;

/// A sample with its three stamps. None is ever overwritten by another.
#[derive(Clone, Debug, PartialEq)]
pub struct Stamped<T> {
    /// Synchronized time of the measurement: mid-exposure, first firing, sample instant. MCAP `publish_time`.
    pub time: Timestamp,
    /// Host receive time. MCAP `log_time`.
    pub arrival: Timestamp,
    /// The device's own counter, in the device's own unit; 0 where it has none.
    pub device_ticks: u64,
    /// The measurement.
    pub sample: T,
}

/// One LiDAR return.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LidarPoint {
    /// Position in the LiDAR frame (x forward, y left, z up), metres.
    pub position_m: [f32; 3],
    /// Reflectivity as sent: 0–100 diffuse, 101–255 retro-reflective for Velodyne.
    pub intensity: u8,
    /// Rank of the laser by elevation, 0 lowest.
    pub ring: u16,
    /// Which echo of its shot it is.
    pub echo: Echo,
    /// Time after the scan's first firing, nanoseconds.
    pub time_offset_ns: u32,
}

/// Which echo of a shot a return is. The numbers of the first four are those of PyPI `velodyne-decoder`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Echo {
    /// Nobody said.
    #[default]
    Unknown = 0,
    /// The brightest.
    Strongest = 1,
    /// The farthest.
    Last = 2,
    /// The brightest and the farthest in one: sensors that report both found no other.
    Both = 3,
    /// The nearest.
    First = 4,
    /// The second nearest.
    Second = 5,
}

impl Echo {
    /// All, in the order of their numbers.
    pub const ALL: [Self; 6] = [
        Self::Unknown,
        Self::Strongest,
        Self::Last,
        Self::Both,
        Self::First,
        Self::Second,
    ];

    /// Its number in files.
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// [`Echo::Unknown`] for a number that names none.
    pub fn from_code(code: u8) -> Self {
        Self::ALL
            .get(usize::from(code))
            .copied()
            .unwrap_or_default()
    }
}

/// One revolution (or less, with a FOV window), in firing order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LidarScan {
    /// The returns.
    pub points: Vec<LidarPoint>,
}

/// One grey image.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Image {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// `width * height` grey values, row by row.
    pub pixels: Vec<u8>,
    /// Exposure time, nanoseconds; 0 where unknown.
    pub exposure_ns: u32,
    /// The device's frame counter: images of one trigger share it.
    pub frame_id: u32,
}

/// One inertial sample in the IMU frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImuSample {
    /// Angular velocity, rad/s.
    pub angular_velocity_rad_s: [f64; 3],
    /// Specific force, m/s² (+9.81 upward at rest).
    pub specific_force_m_s2: [f64; 3],
}
