//! The magnetic field: Earth's, bent by the steel of the place, seen through the iron of the device.

use nalgebra::{Matrix3, Vector3};

use lsfb_recording::message::MagneticSample;

use super::crossing::area_m2;
use super::message::{AmbientMessage, AmbientSample};
use crate::config::MagneticConfig;
use crate::config::SimConfig;
use crate::datum::DatumConfig;
use crate::noise::{next_gaussian, stream, uniform};
use crate::walk::Walk;
use crate::world::World;

/// Earth's dipole, nanotesla (IGRF-14, 2025.0: g₁⁰, g₁¹, h₁¹).
const DIPOLE_NT: [f64; 3] = [-29_350.0, -1_410.3, 4_545.5];
/// Radius at which that holds, and mean radius of the ground, metres.
const EARTH_M: f64 = 6_371_200.0;
/// μ₀ over 4π, T m/A.
const MU0_OVER_4PI: f64 = 1e-7;
/// A piece of steel is no point: closer than this its field grows no more, metres.
const PIECE_M: f64 = 0.3;
/// Pieces of steel at most, however large the place.
const MOST_PIECES: usize = 2_400;
/// Moments differ by this factor, one standard deviation.
const SPREAD: f64 = 2.0;

/// A magnetised piece of steel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dipole {
    /// Where it is in the world, metres.
    pub position_m: Vector3<f64>,
    /// Its moment, A m².
    pub moment_a_m2: Vector3<f64>,
}

/// The field of a place.
#[derive(Clone, Debug, PartialEq)]
pub struct MagneticWorld {
    /// Earth's field in the world's axes, tesla.
    pub earth_t: Vector3<f64>,
    /// What bends it.
    pub dipoles: Vec<Dipole>,
}

impl MagneticWorld {
    pub(super) fn new(config: &SimConfig, world: &World, seed: u64) -> Self {
        Self {
            earth_t: earth_field_t(&config.datum),
            dipoles: dipoles(&config.magnetic, world, seed),
        }
    }

    /// The field at a point of the world, tesla.
    pub fn at(&self, point_in_world: Vector3<f64>) -> Vector3<f64> {
        let bent: Vector3<f64> = self.dipoles.iter().map(|d| d.field_t(point_in_world)).sum();
        self.earth_t + bent
    }
}

impl Dipole {
    fn field_t(&self, point: Vector3<f64>) -> Vector3<f64> {
        let away = point - self.position_m;
        let squared = away.norm_squared() + PIECE_M * PIECE_M;
        let along = self.moment_a_m2.dot(&away) / squared;
        MU0_OVER_4PI * (3.0 * along * away - self.moment_a_m2) / (squared * squared.sqrt())
    }
}

/// The dipole part of Earth's field in the world's axes (east, north, up), tesla: right within some 15 % and 20°.
pub(super) fn earth_field_t(datum: &DatumConfig) -> Vector3<f64> {
    let [g10, g11, h11] = DIPOLE_NT;
    let (cos_theta, sin_theta) = datum.latitude_deg.to_radians().sin_cos();
    let (sin_phi, cos_phi) = datum.longitude_deg.to_radians().sin_cos();
    let tilted = g11 * cos_phi + h11 * sin_phi;
    let shrunk = (EARTH_M / (EARTH_M + datum.altitude_m)).powi(3);
    let up = 2.0 * (g10 * cos_theta + tilted * sin_theta);
    let north = -(g10 * sin_theta - tilted * cos_theta);
    let east = g11 * sin_phi - h11 * cos_phi;
    1e-9 * shrunk * Vector3::new(east, north, up)
}

/// Pieces of steel behind the surfaces that have some, larger surfaces more often.
fn dipoles(config: &MagneticConfig, world: &World, seed: u64) -> Vec<Dipole> {
    let weights: Vec<f32> = (0..world.facets().len())
        .map(|k| area_m2(world, k).sqrt() * world.substance(k).steel())
        .collect();
    let mut sums = Vec::with_capacity(weights.len());
    let mut total = 0.0_f64;
    for weight in &weights {
        total += f64::from(*weight);
        sums.push(total);
    }
    if total <= 0.0 {
        return Vec::new();
    }
    let [low, high] = world.extent_m();
    // A backdrop far away is no part of the place.
    let side = |axis: usize| f64::from(high[axis] - low[axis]).min(140.0);
    let wanted = config.pieces_per_m2 * side(0) * side(1);
    let count = (wanted as usize).min(MOST_PIECES);
    let dice = stream(seed, "steel", 0);
    let mut found = Vec::with_capacity(count);
    for _ in 0..count {
        let at = total * f64::from(uniform(&dice, 0.0, 1.0));
        let facet = sums.partition_point(|sum| *sum < at).min(sums.len() - 1);
        let Some(surface) = world.facets().get(facet) else {
            continue;
        };
        let (a, b) = (uniform(&dice, 0.0, 0.5), uniform(&dice, 0.0, 0.5));
        let depth = uniform(&dice, 0.02, 0.25);
        let point = surface.point(a, b);
        let position = std::array::from_fn(|i| f64::from(point[i] - depth * surface.normal[i]));
        let draw = || next_gaussian(&dice);
        // Steel that stands keeps the direction of the field it stands in: mostly downwards.
        let direction = Vector3::new(0.7 * draw(), 0.7 * draw(), -0.8 + 0.7 * draw());
        let strength = config.moment_a_m2 * (SPREAD.ln() * draw()).exp();
        found.push(Dipole {
            position_m: Vector3::from(position),
            moment_a_m2: strength * direction.try_normalize(1e-9).unwrap_or(-Vector3::z()),
        });
    }
    found
}

/// What the device's own iron makes of the field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MagneticSensor {
    /// Field of the device's own magnets, in its axes, tesla.
    pub hard_iron_t: Vector3<f64>,
    /// What its soft iron makes of the field outside.
    pub soft_iron: Matrix3<f64>,
}

impl MagneticSensor {
    pub(super) fn new(config: &MagneticConfig, seed: u64) -> Self {
        let dice = stream(seed, "iron", 0);
        let hard_iron_t = Vector3::from_fn(|_, _| config.hard_iron_t * next_gaussian(&dice));
        let soft = Matrix3::from_fn(|_, _| config.soft_iron * next_gaussian(&dice));
        // Induction has no direction of its own: the matrix is symmetric.
        let soft_iron = Matrix3::identity() + 0.5 * (soft + soft.transpose());
        Self {
            hard_iron_t,
            soft_iron,
        }
    }

    /// What the sensor sees of a field in its axes, tesla.
    pub fn seen(&self, field_t: Vector3<f64>) -> Vector3<f64> {
        self.soft_iron * field_t + self.hard_iron_t
    }
}

/// All samples of a walk; the sensor has the axes of the device's IMU.
pub(super) fn samples(
    config: &MagneticConfig,
    world: &MagneticWorld,
    sensor: &MagneticSensor,
    walk: &Walk,
    seed: u64,
) -> Vec<AmbientMessage> {
    let dice = stream(seed, "magnetometer", 0);
    let variance = config.noise_t.powi(2) + config.step_t.powi(2) / 12.0;
    let count = (walk.duration_s() * f64::from(config.rate_hz)) as i64;
    let sample = |k: i64| {
        // Between two samples of the IMU, as another chip measures when it likes.
        let measured_ns = (2 * k + 1) * 500_000_000 / i64::from(config.rate_hz.max(1));
        let pose = walk.at(measured_ns as f64 * 1e-9).world_from_rig;
        let field = sensor.seen(pose.rotation.inverse() * world.at(pose.translation));
        let digits = |field_t: f64| {
            let noisy = field_t + config.noise_t * next_gaussian(&dice);
            match config.step_t > 0.0 {
                true => (noisy / config.step_t).round() * config.step_t,
                false => noisy,
            }
        };
        AmbientMessage {
            measured_ns,
            ready_ns: measured_ns,
            sample: AmbientSample::Magnetic(MagneticSample {
                field_t: field.map(digits).into(),
                variance_t2: [variance; 3],
            }),
        }
    };
    (0..count).map(sample).collect()
}
