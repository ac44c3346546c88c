//! A satellite receiver: which satellites it sees, what is wrong with each range, and where that puts it.
//!
//! The receiver solves for position and clock by least squares, each range weighed by what it varies; the covariance that it
//! reports is that of this solution, so that it is honest as long as the ranges are.

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

use lsfb_recording::message::{GnssFix, GnssReading};
use lsfb_types::Timestamp;

use super::crossing;
use super::message::{AmbientMessage, AmbientSample};
use crate::config::GnssConfig;
use crate::datum::DatumConfig;
use crate::noise::{Dice, next_gaussian, stream};
use crate::walk::Walk;
use crate::world::{Substance, World};

/// Satellites in a constellation as GPS was planned: six planes of four.
const PLANES: usize = 6;
const SLOTS: usize = 4;
/// Radius of their orbits, metres, and the inclination, degrees.
const ORBIT_M: f64 = 26_559_700.0;
const INCLINATION_DEG: f64 = 55.0;
/// Two turns in a sidereal day; the Earth turns once, radians per second.
const EARTH_RAD_S: f64 = 7.292_115e-5;
const ORBIT_RAD_S: f64 = 2.0 * EARTH_RAD_S;
/// How far a way to the sky is looked along, metres.
const SKY_M: f64 = 600.0;
/// Façades further away than this send no echoes that matter; those nearer decay over this, metres.
const FACADE_M: f64 = 25.0;
const FACADE_DECAY_M: f64 = 8.0;
/// Directions in which façades are looked for.
const COMPASS: usize = 12;
/// A receiver's time to its first position, and after each loss, seconds.
const REACQUIRE_S: i64 = 3;

/// How far off a position is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionError {
    /// Error east, north, up, metres.
    pub enu_m: Vector3<f64>,
    /// What the receiver says about it, metres².
    pub covariance_m2: Matrix3<f64>,
}

/// One second of a receiver.
#[derive(Clone, Debug, PartialEq)]
pub struct GnssEpoch {
    /// Nanoseconds after the beginning.
    pub offset_ns: i64,
    /// Satellites used.
    pub satellites: usize,
    /// Satellites that are up, seen or not.
    pub above_mask: usize,
    /// What it says.
    pub reading: GnssReading,
    /// The truth about that; `None` without a position.
    pub error: Option<PositionError>,
}

impl GnssEpoch {
    pub(super) fn message(&self) -> AmbientMessage {
        AmbientMessage {
            measured_ns: self.offset_ns,
            // It takes a while to compute.
            ready_ns: self.offset_ns + 80_000_000,
            sample: AmbientSample::Gnss(self.reading),
        }
    }
}

/// Unit vectors from the place to all satellites at a time, in the world's axes.
fn satellites(datum: &DatumConfig, time_s: f64) -> Vec<Vector3<f64>> {
    let world_from_ecef = datum.ecef_from_world().transpose();
    let here = datum.origin_in_ecef();
    let (sin_tilt, cos_tilt) = INCLINATION_DEG.to_radians().sin_cos();
    (0..PLANES * SLOTS)
        .map(|k| {
            let (plane, slot) = ((k / SLOTS) as f64, (k % SLOTS) as f64);
            // Neighbouring planes are out of step by a sixth of a slot.
            let along = TAU * (slot / SLOTS as f64 + plane / (PLANES * SLOTS) as f64)
                + ORBIT_RAD_S * time_s;
            let node = TAU * plane / PLANES as f64 - EARTH_RAD_S * time_s;
            let (s, c) = along.sin_cos();
            let (sn, cn) = node.sin_cos();
            let in_ecef = ORBIT_M
                * Vector3::new(
                    c * cn - s * cos_tilt * sn,
                    c * sn + s * cos_tilt * cn,
                    s * sin_tilt,
                );
            (world_from_ecef * (in_ecef - here)).normalize()
        })
        .collect()
}

/// Whether nothing but leaves is between an antenna and the sky in a direction.
fn sees_sky(world: &World, antenna: Vector3<f64>, direction: Vector3<f64>) -> bool {
    let mut open = true;
    crossing::along(
        world,
        antenna,
        antenna + SKY_M * direction,
        |_, substance| {
            open = matches!(substance, Substance::Sky | Substance::Leaves);
            open && substance != Substance::Sky
        },
    );
    open
}

/// How much façades around send back, 0 in the open.
fn echoes(world: &World, antenna: Vector3<f64>) -> f64 {
    let strength = (0..COMPASS).map(|k| {
        let angle = TAU * k as f64 / COMPASS as f64;
        let mut nearest = FACADE_M;
        let end = antenna + FACADE_M * Vector3::new(angle.cos(), angle.sin(), 0.12);
        crossing::along(world, antenna, end, |facet, substance| {
            let Some(surface) = world.facets().get(facet) else {
                return false;
            };
            let from = surface.height_of(antenna.map(|v| v as f32).into());
            let large = crossing::area_m2(world, facet) > 1.0;
            if large && !matches!(substance, Substance::Leaves | Substance::Sky) {
                nearest = f64::from(from).min(FACADE_M);
            }
            !large
        });
        ((-nearest / FACADE_DECAY_M).exp() - (-FACADE_M / FACADE_DECAY_M).exp()).max(0.0)
    });
    strength.sum::<f64>() / COMPASS as f64
}

/// Something that lasts a while: a Gauss–Markov process of deviation 1.
struct Lasting {
    value: f64,
    keep: f64,
    fresh: f64,
}

impl Lasting {
    fn new(time_s: f64, dice: &Dice) -> Self {
        let keep = (-1.0 / time_s).exp();
        Self {
            value: next_gaussian(dice),
            keep,
            fresh: (1.0 - keep * keep).sqrt(),
        }
    }

    fn next(&mut self, dice: &Dice) {
        self.value = self.keep * self.value + self.fresh * next_gaussian(dice);
    }
}

/// What is wrong with the range to one satellite.
struct Range {
    dice: Dice,
    atmosphere: Lasting,
    multipath: Lasting,
}

/// Once a second on the second, from the beginning of a walk to its end.
pub(super) fn epochs(
    config: &GnssConfig,
    datum: &DatumConfig,
    world: &World,
    walk: &Walk,
    begin: Timestamp,
    seed: u64,
) -> Vec<GnssEpoch> {
    if config.rate_hz == 0 {
        return Vec::new();
    }
    let mut ranges: Vec<Range> = (0..(PLANES * SLOTS) as u64)
        .map(|k| {
            let dice = stream(seed, "gnss", k);
            Range {
                atmosphere: Lasting::new(config.atmosphere_s, &dice),
                multipath: Lasting::new(config.multipath_s, &dice),
                dice,
            }
        })
        .collect();
    let mask = config.mask_deg.to_radians().sin();
    // The receiver was on before the recording began.
    let mut seen_for_s = REACQUIRE_S;
    (0..=walk.duration_s() as i64)
        .map(|second| {
            let offset_ns = second * 1_000_000_000;
            let antenna = walk.at(second as f64).world_from_rig.translation;
            let time_s = begin.plus_nanos(offset_ns).nanos() as f64 * 1e-9;
            let echo = echoes(world, antenna);
            let mut used = Vec::new();
            let mut above_mask = 0;
            for (direction, range) in satellites(datum, time_s).into_iter().zip(&mut ranges) {
                range.atmosphere.next(&range.dice);
                range.multipath.next(&range.dice);
                let white = next_gaussian(&range.dice);
                if direction.z < mask {
                    continue;
                }
                above_mask += 1;
                if !sees_sky(world, antenna, direction) {
                    continue;
                }
                // Low satellites shine through more air, and their echoes are nearer to their signal.
                let slant = 1.0 / direction.z.max(0.1);
                let parts = [
                    (config.atmosphere_m * slant, range.atmosphere.value),
                    (
                        config.multipath_m * echo * slant.sqrt(),
                        range.multipath.value,
                    ),
                    (config.noise_m * slant.sqrt(), white),
                ];
                used.push(Measured {
                    direction,
                    error_m: parts.iter().map(|(sigma, value)| sigma * value).sum(),
                    variance_m2: parts.iter().map(|(sigma, _)| sigma * sigma).sum(),
                });
            }
            let solved = solve(&used);
            seen_for_s = if solved.is_some() { seen_for_s + 1 } else { 0 };
            let error = solved.filter(|_| seen_for_s > REACQUIRE_S);
            let reading = GnssReading {
                fix: error.map(|error| {
                    let place = datum.geodetic(antenna + error.enu_m);
                    GnssFix {
                        latitude_deg: place.latitude_deg,
                        longitude_deg: place.longitude_deg,
                        altitude_m: place.altitude_m,
                        covariance_enu_m2: std::array::from_fn(|i| {
                            error.covariance_m2[(i / 3, i % 3)]
                        }),
                    }
                }),
            };
            GnssEpoch {
                offset_ns,
                satellites: used.len(),
                above_mask,
                reading,
                error,
            }
        })
        .collect()
}

/// A range as measured.
struct Measured {
    direction: Vector3<f64>,
    error_m: f64,
    variance_m2: f64,
}

/// Where the errors of the ranges put the receiver; `None` where they leave that open.
fn solve(ranges: &[Measured]) -> Option<PositionError> {
    if ranges.len() < 4 {
        return None;
    }
    let mut normal = Matrix4::zeros();
    let mut right = Vector4::zeros();
    for range in ranges {
        let d = range.direction;
        let row = Vector4::new(-d.x, -d.y, -d.z, 1.0);
        normal += row * row.transpose() / range.variance_m2;
        right += row * (range.error_m / range.variance_m2);
    }
    let covariance = normal.try_inverse()?;
    let off = covariance * right;
    let covariance_m2 = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    // Satellites in one street of sky: a receiver gives no position then.
    (covariance_m2.trace() < 50.0_f64.powi(2)).then_some(PositionError {
        enu_m: off.fixed_rows::<3>(0).into_owned(),
        covariance_m2,
    })
}

/// Azimuth clockwise from north, for sentences, degrees.
pub(crate) fn course_deg(velocity: Vector3<f64>) -> f64 {
    (PI / 2.0 - velocity.y.atan2(velocity.x))
        .rem_euclid(TAU)
        .to_degrees()
}
