//! What a phone measures besides images and motion: radio, the magnetic field, the pressure of the air, satellites.
//!
//! Everything follows from the world that the cameras see (walls in the way of a wave, steel near the compass, sky above the
//! antenna), from the walk and from the seed.

mod crossing;
mod gnss;
mod magnetic;
mod message;
mod pressure;
mod radio;
mod smooth;
mod transmitters;
mod truth;

pub use crossing::wall_loss_db;
pub(crate) use gnss::course_deg;
pub use gnss::{GnssEpoch, PositionError};
pub use magnetic::{Dipole, MagneticSensor, MagneticWorld};
pub use message::{AmbientChannel, AmbientMessage, AmbientSample};
pub use radio::Receiver;
pub use transmitters::{AccessPoint, Beacon, Network, RadioSource, Transmitters};
pub use truth::{SurroundingsTruth, TrueDipole, TrueTransmitter};

use lsfb_types::Timestamp;

use crate::calendar::{EPOCH, GLASSES_EPOCH};
use crate::config::{Device, NmeaSentence, PulseSource, SimConfig};
use crate::datum::Geodetic;
use crate::noise::hash;
use crate::walk::Walk;
use crate::world::World;

/// The receiver behind a LiDAR's pulse and sentences.
#[derive(Clone, Debug, Default)]
pub(crate) struct TimeFeed {
    pub pulse: PulseSource,
    pub sentence: NmeaSentence,
    /// Where the site is.
    pub home: Geodetic,
    /// What the receiver says, second by second.
    pub epochs: Vec<GnssEpoch>,
}

/// Everything around the walks that is neither seen nor felt.
#[derive(Clone, Debug)]
pub struct Surroundings {
    config: SimConfig,
    transmitters: Transmitters,
    /// With those of the scanner's floor, where the second walk is on another.
    heard: Transmitters,
    magnetic: MagneticWorld,
}

impl Surroundings {
    pub(crate) fn new(config: &SimConfig, world: &World, scan: &Walk) -> Self {
        let scanned = hash(config.seed ^ 0x5a11);
        let floor = |seed| Transmitters::place(world, scan, seed);
        let (seed, transmitters, heard) = match config.floors_up {
            0 => (scanned, floor(scanned), floor(scanned)),
            floors => {
                let seed = hash(scanned ^ u64::from(floors));
                let below = floor(scanned).through_slabs(floors);
                (seed, floor(seed), floor(seed).and(below))
            }
        };
        Self {
            transmitters,
            heard,
            magnetic: MagneticWorld::new(config, world, seed),
            config: config.clone(),
        }
    }

    /// Access points and beacons.
    pub fn transmitters(&self) -> &Transmitters {
        &self.transmitters
    }

    /// The magnetic field.
    pub fn magnetic(&self) -> &MagneticWorld {
        &self.magnetic
    }

    /// The iron of the second walk's device.
    pub fn magnetic_sensor(&self) -> MagneticSensor {
        MagneticSensor::new(&self.config.magnetic, self.seed(1))
    }

    /// What the second walk's device hears with.
    pub fn receiver(&self) -> Receiver {
        Receiver::new(self.seed(2))
    }

    fn seed(&self, number: u64) -> u64 {
        hash(self.config.seed ^ hash(0x0a3b ^ number))
    }

    /// Everything that the device of the second walk measures, in the order in which its app gets it.
    pub fn messages(&self, world: &World, walk: &Walk) -> Vec<AmbientMessage> {
        let config = &self.config;
        let mut all = Vec::new();
        all.extend(magnetic::samples(
            &config.magnetic,
            &self.magnetic,
            &self.magnetic_sensor(),
            walk,
            self.seed(3),
        ));
        all.extend(pressure::samples(
            &config.barometer,
            &config.datum,
            walk,
            config.floors_up,
            self.seed(4),
        ));
        all.extend(self.gnss(world, walk).iter().map(GnssEpoch::message));
        let receiver = self.receiver();
        if config.device != Device::Iphone {
            // iOS gives no list of networks to apps.
            all.extend(radio::wifi(
                &config.wifi,
                &self.heard,
                &receiver,
                world,
                walk,
                self.seed(5),
            ));
        }
        all.extend(radio::ble(
            &config.ble,
            config.device,
            &self.heard,
            &receiver,
            world,
            walk,
            self.seed(6),
        ));
        all.sort_by_key(|m| (m.ready_ns, m.channel(), m.measured_ns));
        all
    }

    /// What the receiver of the second walk's device says, second by second.
    pub fn gnss(&self, world: &World, walk: &Walk) -> Vec<GnssEpoch> {
        let begin = GLASSES_EPOCH;
        self.gnss_on(world, walk, begin, self.seed(7))
    }

    /// What gives the LiDAR on the backpack its time.
    pub(crate) fn time_feed(&self, world: &World, walk: &Walk) -> TimeFeed {
        let datum = &self.config.datum;
        TimeFeed {
            pulse: self.config.gnss.pulse,
            sentence: self.config.gnss.sentence,
            home: datum.geodetic(Default::default()),
            epochs: self.gnss_on(world, walk, EPOCH, self.seed(8)),
        }
    }

    fn gnss_on(&self, world: &World, walk: &Walk, begin: Timestamp, seed: u64) -> Vec<GnssEpoch> {
        gnss::epochs(
            &self.config.gnss,
            &self.config.datum,
            world,
            walk,
            begin,
            seed,
        )
    }
}

#[cfg(test)]
mod tests;
