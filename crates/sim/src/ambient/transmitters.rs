//! Where access points and beacons hang.

use nalgebra::Vector3;

use crate::noise::{Dice, below, hash, next_gaussian, stream, uniform};
use crate::walk::Walk;
use crate::world::World;

/// Ground that one access point serves, square metres.
const PER_ACCESS_POINT_M2: f64 = 250.0;
/// Ground that one beacon serves, square metres.
const PER_BEACON_M2: f64 = 60.0;
/// Height above the floor at which things are hung where no ceiling is near, metres.
const OPEN_M: f32 = 3.2;
/// Places tried for each; the one farthest from its neighbours is taken.
const TRIES: usize = 24;
/// How far from a walk anything is hung, metres.
const REACH_M: f64 = 12.0;
/// Loss through the first slab between floors and each further one, decibel (ITU-R P.1238, offices at 2.4 GHz).
const SLAB_DB: f64 = 15.0;
const NEXT_SLAB_DB: f64 = 4.0;
/// UUID of all beacons of a site.
const UUID: [u8; 16] = [
    0x91, 0x95, 0xb3, 0xad, 0xa9, 0xd0, 0x45, 0x00, 0x85, 0xff, 0x9f, 0xb0, 0xf6, 0x5a, 0x52, 0x01,
];

/// What sends, whatever it sends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RadioSource {
    /// Where it is in the world, metres.
    pub position_m: Vector3<f64>,
    /// Radiated power, dBm.
    pub power_dbm: f64,
    /// Middle of its channel, MHz.
    pub frequency_mhz: f64,
    /// Tells sources apart.
    pub number: u64,
}

/// One radio of an access point with the name it sends.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// Address, `02:00:5e:00:00:01`.
    pub bssid: String,
    /// Name.
    pub ssid: String,
    /// The radio.
    pub source: RadioSource,
}

/// A box on a ceiling with a radio in each band, each of which sends several names.
#[derive(Clone, Debug, PartialEq)]
pub struct AccessPoint {
    /// What it sends.
    pub networks: Vec<Network>,
}

/// An iBeacon.
#[derive(Clone, Debug, PartialEq)]
pub struct Beacon {
    /// Its address.
    pub address: String,
    /// Proximity UUID.
    pub uuid: [u8; 16],
    /// Major number.
    pub major: u16,
    /// Minor number.
    pub minor: u16,
    /// The power at one metre that it claims, dBm.
    pub measured_power_dbm: i8,
    /// Its radio.
    pub source: RadioSource,
}

/// Everything that sends in a place.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Transmitters {
    /// Access points.
    pub access_points: Vec<AccessPoint>,
    /// Beacons.
    pub beacons: Vec<Beacon>,
}

impl Transmitters {
    /// Hangs them along the scanner's way, as installers do: everywhere where people are, and above their heads. They are the same whoever
    /// walks there.
    pub(super) fn place(world: &World, scan: &Walk, seed: u64) -> Self {
        let spots = Spots::along(scan);
        // No two transmitters of this world have one address, wherever they are.
        let site = hash(seed ^ 0xadd7) as u16;
        let ground_m2 = spots.ground_m2();
        let count = |per_m2: f64, least: usize, most: usize| {
            ((ground_m2 / per_m2).ceil() as usize).clamp(least, most)
        };
        let dice = stream(seed, "access points", 0);
        let places = spots.spread(world, &dice, count(PER_ACCESS_POINT_M2, 2, 24));
        let access_points = places
            .into_iter()
            .enumerate()
            .map(|(k, position_m)| access_point(site, k, position_m, &dice))
            .collect();
        let dice = stream(seed, "beacons", 0);
        let places = spots.spread(world, &dice, count(PER_BEACON_M2, 4, 64));
        let beacons = places
            .into_iter()
            .enumerate()
            .map(|(k, position_m)| beacon(site, k, position_m, &dice))
            .collect();
        Self {
            access_points,
            beacons,
        }
    }

    /// As they are heard so many floors away from theirs.
    pub(super) fn through_slabs(mut self, floors: u32) -> Self {
        let loss_db = match floors {
            0 => 0.0,
            floors => SLAB_DB + NEXT_SLAB_DB * f64::from(floors - 1),
        };
        let networks = self.access_points.iter_mut().flat_map(|a| &mut a.networks);
        let networks = networks.map(|network| &mut network.source);
        let beacons = self.beacons.iter_mut().map(|beacon| &mut beacon.source);
        for source in networks.chain(beacons) {
            source.power_dbm -= loss_db;
        }
        self
    }

    /// These and others.
    pub(super) fn and(mut self, others: Self) -> Self {
        self.access_points.extend(others.access_points);
        self.beacons.extend(others.beacons);
        self
    }

    /// All networks of all access points.
    pub fn networks(&self) -> impl Iterator<Item = &Network> {
        self.access_points.iter().flat_map(|a| &a.networks)
    }
}

fn access_point(site: u16, number: usize, position_m: Vector3<f64>, dice: &Dice) -> AccessPoint {
    let [high_byte, low_byte] = site.to_be_bytes();
    // Channels that do not overlap, the next one at each neighbour.
    let low = [2412.0, 2437.0, 2462.0][number % 3];
    let high = [5180.0, 5220.0, 5260.0, 5500.0, 5540.0, 5660.0][number % 6];
    let odd_db = 1.5 * next_gaussian(dice);
    let mut networks = Vec::new();
    for (band, (frequency_mhz, power_dbm)) in [(low, 17.0), (high, 20.0)].into_iter().enumerate() {
        for (name, ssid) in ["lsfb-office", "lsfb-guest"].into_iter().enumerate() {
            let id = 4 * number + 2 * band + name;
            networks.push(Network {
                bssid: format!(
                    "02:{high_byte:02x}:{low_byte:02x}:10:{:02x}:{:02x}",
                    id >> 8 & 0xff,
                    id & 0xff
                ),
                ssid: ssid.to_owned(),
                source: RadioSource {
                    position_m,
                    power_dbm: power_dbm + odd_db,
                    frequency_mhz,
                    // Both names of a radio share its antenna, and so its shadows.
                    number: (2 * number + band) as u64,
                },
            });
        }
    }
    AccessPoint { networks }
}

fn beacon(site: u16, number: usize, position_m: Vector3<f64>, dice: &Dice) -> Beacon {
    let [high_byte, low_byte] = site.to_be_bytes();
    let odd_db = 1.0 * next_gaussian(dice);
    Beacon {
        address: format!(
            "c2:{high_byte:02x}:{low_byte:02x}:20:{:02x}:{:02x}",
            number >> 8 & 0xff,
            number & 0xff
        ),
        uuid: UUID,
        major: site,
        minor: number as u16 + 1,
        measured_power_dbm: -59,
        source: RadioSource {
            position_m,
            power_dbm: -12.0 + odd_db,
            frequency_mhz: 2440.0,
            number: 1_000_000 + number as u64,
        },
    }
}

/// Where people walk.
struct Spots {
    points: Vec<Vector3<f64>>,
}

impl Spots {
    fn along(walk: &Walk) -> Self {
        let mut points: Vec<Vector3<f64>> = Vec::new();
        for k in 0..=(2.0 * walk.duration_s()) as u32 {
            let point = walk.at(f64::from(k) * 0.5).world_from_rig.translation;
            let known = |p: &Vector3<f64>| (p - point).norm_squared() < 1.0;
            if !points.iter().rev().any(known) {
                points.push(point);
            }
        }
        Self { points }
    }

    /// Ground within a few metres of where people walk, square metres.
    fn ground_m2(&self) -> f64 {
        // Each spot stands for a piece of way about a metre long, four metres to either side.
        8.0 * self.points.len() as f64
    }

    /// Places away from each other, below a ceiling where there is one.
    fn spread(&self, world: &World, dice: &Dice, count: usize) -> Vec<Vector3<f64>> {
        let mut places: Vec<Vector3<f64>> = Vec::new();
        while places.len() < count && !self.points.is_empty() {
            let candidates = (0..TRIES).map(|_| self.candidate(world, dice));
            let loneliness = |place: &Vector3<f64>| {
                let nearest = places.iter().map(|p| (p - place).norm());
                nearest.fold(f64::INFINITY, f64::min)
            };
            let best = candidates.max_by(|a, b| loneliness(a).total_cmp(&loneliness(b)));
            places.extend(best);
        }
        places
    }

    /// A place to hang something: sideways from a spot as far as nothing is in the way, then up.
    fn candidate(&self, world: &World, dice: &Dice) -> Vector3<f64> {
        let spot = self.points[below(dice, self.points.len())];
        let angle = uniform(dice, 0.0, std::f32::consts::TAU);
        let reach = f64::from(uniform(dice, 0.0, REACH_M as f32));
        let along = Vector3::new(f64::from(angle.cos()), f64::from(angle.sin()), 0.0);
        let free = cast(world, spot, along).unwrap_or(REACH_M);
        let aside = spot + along * reach.min((free - 0.3).max(0.0));
        let up = cast(world, aside, Vector3::z()).unwrap_or(f64::INFINITY);
        aside + Vector3::z() * (up - 0.12).clamp(0.1, f64::from(OPEN_M) - 1.3)
    }
}

fn cast(world: &World, from: Vector3<f64>, direction: Vector3<f64>) -> Option<f64> {
    let hit = world.cast(
        from.map(|v| v as f32).into(),
        direction.map(|v| v as f32).into(),
    )?;
    Some(hit.distance.into())
}
