//! Where on Earth a place is: x points east, y north, z up.

use lsfb_types::Bounds;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// WGS 84: equatorial radius, metres.
const EQUATOR_M: f64 = 6_378_137.0;
/// WGS 84: flattening.
const FLATTENING: f64 = 1.0 / 298.257_223_563;

/// Where the origin of the world is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DatumConfig {
    /// Latitude, degrees north.
    pub latitude_deg: f64,
    /// Longitude, degrees east.
    pub longitude_deg: f64,
    /// Height above the ellipsoid, metres.
    pub altitude_m: f64,
}

impl Default for DatumConfig {
    /// In Munich.
    fn default() -> Self {
        Self {
            latitude_deg: 48.0 + 8.8 / 60.0,
            longitude_deg: 11.0 + 34.5 / 60.0,
            altitude_m: 565.0,
        }
    }
}

/// A point on Earth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Geodetic {
    /// Latitude, degrees north.
    pub latitude_deg: f64,
    /// Longitude, degrees east.
    pub longitude_deg: f64,
    /// Height above the ellipsoid, metres.
    pub altitude_m: f64,
}

lsfb_types::bounds! {
    DatumConfig {
        latitude_deg: number(Bounds::Within(-89.0, 89.0)),
        longitude_deg: number(Bounds::Within(-180.0, 180.0)),
        altitude_m: number(Bounds::Within(-9000.0, 9000.0)),
    }
}

impl DatumConfig {
    fn origin(&self) -> Geodetic {
        Geodetic {
            latitude_deg: self.latitude_deg,
            longitude_deg: self.longitude_deg,
            altitude_m: self.altitude_m,
        }
    }

    /// Earth's frame from the world's: columns are east, north, up.
    pub(crate) fn ecef_from_world(&self) -> Matrix3<f64> {
        let (sin_lat, cos_lat) = self.latitude_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.longitude_deg.to_radians().sin_cos();
        Matrix3::new(
            -sin_lon,
            -sin_lat * cos_lon,
            cos_lat * cos_lon,
            cos_lon,
            -sin_lat * sin_lon,
            cos_lat * sin_lon,
            0.0,
            cos_lat,
            sin_lat,
        )
    }

    /// The world's origin in Earth's frame, metres.
    pub(crate) fn origin_in_ecef(&self) -> Vector3<f64> {
        let Geodetic {
            latitude_deg,
            longitude_deg,
            altitude_m,
        } = self.origin();
        let (sin_lat, cos_lat) = latitude_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = longitude_deg.to_radians().sin_cos();
        let squared = FLATTENING * (2.0 - FLATTENING);
        let normal_m = EQUATOR_M / (1.0 - squared * sin_lat * sin_lat).sqrt();
        let across = (normal_m + altitude_m) * cos_lat;
        Vector3::new(
            across * cos_lon,
            across * sin_lon,
            (normal_m * (1.0 - squared) + altitude_m) * sin_lat,
        )
    }

    /// Where on Earth a point of the world is.
    pub fn geodetic(&self, point_in_world: Vector3<f64>) -> Geodetic {
        let p = self.origin_in_ecef() + self.ecef_from_world() * point_in_world;
        let squared = FLATTENING * (2.0 - FLATTENING);
        let across = p.x.hypot(p.y);
        // Converges by three decimals a step near the ground.
        let mut latitude = (p.z / (across * (1.0 - squared))).atan();
        let mut altitude = 0.0;
        for _ in 0..8 {
            let sin = latitude.sin();
            let normal_m = EQUATOR_M / (1.0 - squared * sin * sin).sqrt();
            altitude = across / latitude.cos() - normal_m;
            let share = 1.0 - squared * normal_m / (normal_m + altitude);
            latitude = (p.z / (across * share)).atan();
        }
        Geodetic {
            latitude_deg: latitude.to_degrees(),
            longitude_deg: p.y.atan2(p.x).to_degrees(),
            altitude_m: altitude,
        }
    }
}
