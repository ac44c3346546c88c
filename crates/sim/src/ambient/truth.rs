//! The truth about the surroundings, for `eval` alone.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::Surroundings;
use crate::datum::DatumConfig;

/// What `truth_surroundings.json` holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurroundingsTruth {
    /// Where the world's origin is on Earth; x points east, y north.
    pub datum: DatumConfig,
    /// Radios of access points, one for each address.
    pub networks: Vec<TrueTransmitter>,
    /// Beacons.
    pub beacons: Vec<TrueTransmitter>,
    /// What the device of the second walk reads too much, decibel.
    pub receiver_offset_db: f64,
    /// Earth's magnetic field in the world, tesla.
    pub earth_field_t: [f64; 3],
    /// Magnetised pieces of steel.
    pub dipoles: Vec<TrueDipole>,
    /// Field of the device's own magnets, in its axes, tesla.
    pub hard_iron_t: [f64; 3],
    /// What its soft iron makes of the field outside, row by row.
    pub soft_iron: [[f64; 3]; 3],
}

/// Something that sends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrueTransmitter {
    /// Its address.
    pub address: String,
    /// Where it is in the world, metres.
    pub position_m: [f64; 3],
    /// Radiated power, dBm.
    pub power_dbm: f64,
    /// Middle of its channel, MHz.
    pub frequency_mhz: f64,
}

/// A magnetised piece of steel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrueDipole {
    /// Where it is in the world, metres.
    pub position_m: [f64; 3],
    /// Its moment, A m².
    pub moment_a_m2: [f64; 3],
}

impl Surroundings {
    /// The truth about them.
    pub fn truth(&self) -> SurroundingsTruth {
        let sensor = self.magnetic_sensor();
        let transmitter = |address: &str, source: &super::RadioSource| TrueTransmitter {
            address: address.to_owned(),
            position_m: source.position_m.into(),
            power_dbm: source.power_dbm,
            frequency_mhz: source.frequency_mhz,
        };
        let array = |v: Vector3<f64>| -> [f64; 3] { v.into() };
        SurroundingsTruth {
            datum: self.config.datum,
            networks: self
                .transmitters
                .networks()
                .map(|n| transmitter(&n.bssid, &n.source))
                .collect(),
            beacons: self
                .transmitters
                .beacons
                .iter()
                .map(|b| transmitter(&b.address, &b.source))
                .collect(),
            receiver_offset_db: self.receiver().offset_db,
            earth_field_t: array(self.magnetic.earth_t),
            dipoles: self
                .magnetic
                .dipoles
                .iter()
                .map(|d| TrueDipole {
                    position_m: array(d.position_m),
                    moment_a_m2: array(d.moment_a_m2),
                })
                .collect(),
            hard_iron_t: array(sensor.hard_iron_t),
            soft_iron: std::array::from_fn(|row| {
                std::array::from_fn(|column| sensor.soft_iron[(row, column)])
            }),
        }
    }
}
