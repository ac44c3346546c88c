//! The inner loop: the returns of one block, or of a pair of blocks, as points. Thirty-two lasers at a time, without a
//! branch per point, so that the compiler can use vector instructions.

use std::f32::consts::PI;
use std::sync::LazyLock;

use lsfb_types::{Echo, LidarPoint};

use super::model::{Model, ModelTable};
use super::wire::{CHANNELS, DataPacket, TURN_CENTIDEG};

const DEGREES: usize = TURN_CENTIDEG as usize / 100;

type Lanes = [f32; CHANNELS];

/// What is constant about the 32 lasers of a model, laser by laser.
pub(super) struct Beams {
    sin_offset: Lanes,
    cos_offset: Lanes,
    /// Metres along the vertical, and in the plane, of one unit of distance.
    rise_m: Lanes,
    flat_m: Lanes,
    optical_offset_m: Lanes,
    firing_ns: [u32; CHANNELS],
    firing_ns_f32: Lanes,
    ring: [u16; CHANNELS],
}

impl Beams {
    pub(super) fn of(model: Model) -> &'static Self {
        static ALL: LazyLock<[Beams; 3]> =
            LazyLock::new(|| Model::ALL.map(|model| Beams::new(model.table())));
        &ALL[match model {
            Model::Vlp32c => 0,
            Model::Vlp16 => 1,
            Model::Hdl32e => 2,
        }]
    }

    fn new(table: &ModelTable) -> Self {
        let lanes = |of: &dyn Fn(f64, f64) -> f64| {
            table.channels.map(|channel| {
                let elevation = channel.elevation_deg.to_radians();
                of(elevation, channel.azimuth_offset_deg.to_radians()) as f32
            })
        };
        let unit_m = f64::from(table.distance_unit_mm) / 1000.0;
        let optical_offset_m = table.optical_offset_mm / 1000.0;
        Self {
            sin_offset: lanes(&|_, offset| offset.sin()),
            cos_offset: lanes(&|_, offset| offset.cos()),
            rise_m: lanes(&|elevation, _| elevation.sin() * unit_m),
            flat_m: lanes(&|elevation, _| elevation.cos() * unit_m),
            optical_offset_m: lanes(&|elevation, _| optical_offset_m * (-elevation).tan()),
            firing_ns: table.channels.map(|channel| channel.firing_ns),
            firing_ns_f32: table.channels.map(|channel| channel.firing_ns as f32),
            ring: table.channels.map(|channel| channel.ring),
        }
    }
}

/// An angle by its sine and cosine.
#[derive(Clone, Copy)]
struct Direction {
    sin: f32,
    cos: f32,
}

/// Whole degrees and hundredths: the sum of one of each is any encoder angle.
struct Turns {
    degrees: [Direction; DEGREES],
    hundredths: [Direction; 100],
}

static TURNS: LazyLock<Turns> = LazyLock::new(|| {
    let of = |centideg: usize| {
        let (sin, cos) = (centideg as f64 * (std::f64::consts::PI / 18_000.0)).sin_cos();
        Direction {
            sin: sin as f32,
            cos: cos as f32,
        }
    };
    Turns {
        degrees: std::array::from_fn(|degree| of(degree * 100)),
        hundredths: std::array::from_fn(of),
    }
});

fn encoder(azimuth_centideg: u16) -> Direction {
    let turns = &*TURNS;
    let degree = turns.degrees[usize::from(azimuth_centideg / 100) % DEGREES];
    let hundredth = turns.hundredths[usize::from(azimuth_centideg % 100)];
    Direction {
        sin: degree.sin * hundredth.cos + degree.cos * hundredth.sin,
        cos: degree.cos * hundredth.cos - degree.sin * hundredth.sin,
    }
}

/// When and where a block, or the two of a pair, fired.
pub(super) struct Firing {
    /// Encoder angle at the first laser, 0.01°.
    pub azimuth_centideg: u16,
    /// Motion of the rotor, centidegrees per nanosecond.
    pub pace_centideg_ns: f32,
    /// Time of the first laser after the scan's first, nanoseconds.
    pub offset_ns: u32,
    /// Which echo a block holds where it is the only one of its shot.
    pub echo: Echo,
}

/// The echoes of a block, laser by laser.
struct Echoes {
    range_raw: [u16; CHANNELS],
    reflectivity: [u8; CHANNELS],
}

impl Echoes {
    #[inline]
    fn read<T: AsRef<[u8]>>(packet: &DataPacket<T>, block: usize) -> Self {
        let channels = packet.channel_bytes(block);
        let mut echoes = Self {
            range_raw: [0; CHANNELS],
            reflectivity: [0; CHANNELS],
        };
        for (k, &[low, high, reflectivity]) in channels.iter().enumerate() {
            echoes.range_raw[k] = u16::from_le_bytes([low, high]);
            echoes.reflectivity[k] = reflectivity;
        }
        echoes
    }
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

/// Makes the points of one model's blocks.
pub(super) struct PointMaker {
    beams: &'static Beams,
    /// Lift of the beams' origin, metres.
    lift_m: Lanes,
    /// A block's points before they are appended. Indices are taken modulo its length, which they never reach, so that
    /// no check is left in the loop.
    made: [LidarPoint; 2 * CHANNELS],
}

impl PointMaker {
    pub(super) fn new(model: Model, optical_offset: OpticalOffset) -> Self {
        let beams = Beams::of(model);
        Self {
            beams,
            lift_m: match optical_offset {
                OpticalOffset::Ignored => [0.0; CHANNELS],
                OpticalOffset::Applied => beams.optical_offset_m,
            },
            made: [LidarPoint::default(); 2 * CHANNELS],
        }
    }

    /// Appends the returns of a block in firing order.
    pub(super) fn single<T: AsRef<[u8]>>(
        &mut self,
        packet: &DataPacket<T>,
        block: usize,
        firing: &Firing,
        out: &mut Vec<LidarPoint>,
    ) {
        let echoes = Echoes::read(packet, block);
        let placed = self.place(&self.aim(firing), &echoes.range_raw);
        let mut count = 0;
        for k in 0..CHANNELS {
            self.made[count % (2 * CHANNELS)] =
                self.point(k, &placed, &echoes, firing, firing.echo);
            count += usize::from(echoes.range_raw[k] != 0);
        }
        out.extend_from_slice(&self.made[..count]);
    }

    /// Appends the returns of a pair of blocks in firing order: last, then strongest where it is another one (the even
    /// block holds the last echo: VLP-32C 63-9325 p. 59).
    pub(super) fn dual<T: AsRef<[u8]>>(
        &mut self,
        packet: &DataPacket<T>,
        even_block: usize,
        firing: &Firing,
        out: &mut Vec<LidarPoint>,
    ) {
        let last = Echoes::read(packet, even_block);
        let strongest = Echoes::read(packet, even_block + 1);
        let aim = self.aim(firing);
        let last_placed = self.place(&aim, &last.range_raw);
        let strongest_placed = self.place(&aim, &strongest.range_raw);
        let mut count = 0;
        for k in 0..CHANNELS {
            let (last_raw, strongest_raw) = (last.range_raw[k], strongest.range_raw[k]);
            let first = if last_raw == strongest_raw {
                Echo::Both
            } else {
                Echo::Last
            };
            self.made[count % (2 * CHANNELS)] = self.point(k, &last_placed, &last, firing, first);
            count += usize::from(last_raw != 0);
            self.made[count % (2 * CHANNELS)] =
                self.point(k, &strongest_placed, &strongest, firing, Echo::Strongest);
            count += usize::from(strongest_raw != 0) & usize::from(strongest_raw != last_raw);
        }
        out.extend_from_slice(&self.made[..count]);
    }

    /// Where each laser pointed: encoder, the laser's own offset, and the motion until it fired.
    #[inline]
    fn aim(&self, firing: &Firing) -> Aim {
        let Beams {
            sin_offset,
            cos_offset,
            flat_m,
            firing_ns_f32,
            ..
        } = self.beams;
        let encoder = encoder(firing.azimuth_centideg);
        let pace_rad_ns = firing.pace_centideg_ns * (PI / 18_000.0);
        let mut aim = Aim {
            forward_m: [0.0; CHANNELS],
            right_m: [0.0; CHANNELS],
        };
        for k in 0..CHANNELS {
            let sin = encoder.sin * cos_offset[k] + encoder.cos * sin_offset[k];
            let cos = encoder.cos * cos_offset[k] - encoder.sin * sin_offset[k];
            // Below 0.02 rad the first terms of the series are exact in `f32`.
            let moved = pace_rad_ns * firing_ns_f32[k];
            let square = moved * moved;
            let (sin_moved, cos_moved) = (moved * (1.0 - square * (1.0 / 6.0)), 1.0 - square * 0.5);
            aim.forward_m[k] = (cos * cos_moved - sin * sin_moved) * flat_m[k];
            aim.right_m[k] = (sin * cos_moved + cos * sin_moved) * flat_m[k];
        }
        aim
    }

    #[inline]
    fn place(&self, aim: &Aim, range_raw: &[u16; CHANNELS]) -> Placed {
        let mut placed = Placed {
            x_m: [0.0; CHANNELS],
            y_m: [0.0; CHANNELS],
            z_m: [0.0; CHANNELS],
        };
        for (k, &range_raw) in range_raw.iter().enumerate() {
            let range = f32::from(range_raw);
            // The manual's frame has azimuth 0 along y and grows towards x.
            placed.x_m[k] = range * aim.forward_m[k];
            placed.y_m[k] = -(range * aim.right_m[k]);
            placed.z_m[k] = range * self.beams.rise_m[k] + self.lift_m[k];
        }
        placed
    }

    #[inline]
    fn point(
        &self,
        k: usize,
        placed: &Placed,
        echoes: &Echoes,
        firing: &Firing,
        echo: Echo,
    ) -> LidarPoint {
        LidarPoint {
            position_m: [placed.x_m[k], placed.y_m[k], placed.z_m[k]],
            intensity: echoes.reflectivity[k],
            ring: self.beams.ring[k],
            echo,
            time_offset_ns: firing.offset_ns + self.beams.firing_ns[k],
        }
    }
}

/// The points of a block, laser by laser, also of those without an echo.
struct Placed {
    x_m: Lanes,
    y_m: Lanes,
    z_m: Lanes,
}

/// Metres forward and to the right of one unit of distance.
struct Aim {
    forward_m: Lanes,
    right_m: Lanes,
}
