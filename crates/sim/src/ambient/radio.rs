//! Received power, and who is heard when.

use nalgebra::Vector3;

use lsfb_recording::message::{BleAdvert, WifiReading};

use super::crossing::wall_loss_db;
use super::message::{AmbientMessage, AmbientSample};
use super::smooth::SmoothField;
use super::transmitters::{RadioSource, Transmitters};
use crate::config::Device;
use crate::config::{BleConfig, WifiConfig};
use crate::noise::{Dice, gaussian, hash, next_gaussian, stream, unit};
use crate::walk::Walk;
use crate::world::World;

/// Speed of light, metres per microsecond.
const LIGHT_M_PER_US: f64 = 299.792_458;
/// Closer than this the law of the far field does not hold, metres.
const NEAREST_M: f64 = 0.3;
/// Channels that an Android phone listens on, MHz, and how long on each, nanoseconds.
const CHANNELS_2400: u32 = 13;
const CHANNELS_5000: u32 = 19;
const DWELL_NS: i64 = 110_000_000;
/// How far an advertisement strays from its rhythm (Bluetooth Core 5, Vol 6 Part B 4.4.2.2), and the rhythm, nanoseconds.
const ADVERT_NS: i64 = 100_000_000;
const ADVERT_DELAY_NS: f64 = 10e6;

/// The antenna of the device, and how the chip reads it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    /// What the device reads too much, decibel: antennas and chips differ.
    pub offset_db: f64,
}

/// What decides how a kind of radio is received.
#[derive(Clone, Copy, Debug)]
pub(super) struct Law {
    exponent: f64,
    shadowing_db: f64,
    shadowing_m: f64,
    rice_factor_db: f64,
    body_loss_db: f64,
    floor_dbm: f64,
}

impl From<&WifiConfig> for Law {
    fn from(config: &WifiConfig) -> Self {
        Self {
            exponent: config.path_loss_exponent,
            shadowing_db: config.shadowing_db,
            shadowing_m: config.shadowing_m,
            rice_factor_db: config.rice_factor_db,
            body_loss_db: config.body_loss_db,
            floor_dbm: config.floor_dbm,
        }
    }
}

impl From<&BleConfig> for Law {
    fn from(config: &BleConfig) -> Self {
        Self {
            exponent: config.path_loss_exponent,
            shadowing_db: config.shadowing_db,
            shadowing_m: config.shadowing_m,
            rice_factor_db: config.rice_factor_db,
            body_loss_db: config.body_loss_db,
            floor_dbm: config.floor_dbm,
        }
    }
}

impl Receiver {
    pub(super) fn new(seed: u64) -> Self {
        Self {
            offset_db: 2.0 * gaussian(hash(seed)),
        }
    }
}

/// A transmitter with its shadows.
pub(super) struct Shadowed<'a> {
    source: &'a RadioSource,
    shadow: SmoothField,
}

impl<'a> Shadowed<'a> {
    pub(super) fn new(source: &'a RadioSource, law: &Law, seed: u64) -> Self {
        Self {
            source,
            shadow: SmoothField::new(law.shadowing_m, hash(seed ^ hash(source.number))),
        }
    }
}

/// Power at a device at `place` that faces `ahead`, without the echoes of the moment, dBm.
pub(super) fn mean_dbm(
    law: &Law,
    receiver: &Receiver,
    world: &World,
    from: &Shadowed,
    place: Vector3<f64>,
    ahead: Vector3<f64>,
) -> f64 {
    let away = from.source.position_m - place;
    let distance_m = away.norm();
    let frequency_mhz = from.source.frequency_mhz;
    // Loss over the first metre of free space, then the power law; walls one by one (COST 231, multi-wall model).
    let first_db = 20.0 * (4.0 * std::f64::consts::PI * frequency_mhz / LIGHT_M_PER_US).log10();
    let path_db = first_db + 10.0 * law.exponent * distance_m.max(NEAREST_M).log10();
    let walls_db = wall_loss_db(world, place, from.source.position_m, frequency_mhz);
    // The body is behind the device: the more in the way, the more the transmitter is behind it.
    let behind = (0.5 - 0.5 * away.dot(&ahead) / distance_m.max(1e-6)).clamp(0.0, 1.0);
    let shadow_db = law.shadowing_db * from.shadow.at(place);
    let power_dbm = from.source.power_dbm - path_db - walls_db;
    power_dbm + shadow_db - law.body_loss_db * behind.powi(2) + receiver.offset_db
}

/// One reading: with the echoes of the moment, in whole decibels; `None` where it is missed.
pub(super) fn reading_dbm(law: &Law, mean_dbm: f64, dice: &Dice) -> Option<i16> {
    // The direct wave and echoes of all phases (Rice), together of power 1.
    let factor = 10_f64.powf(0.1 * law.rice_factor_db);
    let echo = (0.5 / (factor + 1.0)).sqrt();
    let direct = (factor / (factor + 1.0)).sqrt();
    let power =
        (direct + echo * next_gaussian(dice)).powi(2) + (echo * next_gaussian(dice)).powi(2);
    let rssi = mean_dbm + 10.0 * power.max(1e-6).log10();
    let heard = 1.0 / (1.0 + (-(rssi - law.floor_dbm) / 1.5).exp());
    (unit(dice.bits()) < heard).then(|| rssi.round().clamp(-127.0, 20.0) as i16)
}

fn direction_and_place(walk: &Walk, time_ns: i64) -> (Vector3<f64>, Vector3<f64>) {
    let pose = walk.at(time_ns as f64 * 1e-9).world_from_rig;
    (pose.rotation * Vector3::x(), pose.translation)
}

/// When scans begin that the system allows, nanoseconds after the beginning.
pub(super) fn scan_times(config: &WifiConfig, duration_s: f64, scan_ns: i64) -> Vec<i64> {
    let mut allowed: Vec<i64> = Vec::new();
    if config.request_every_s <= 0.0 {
        return allowed;
    }
    let every_ns = ((config.request_every_s * 1e9) as i64).max(scan_ns);
    let window_ns = (config.throttle_s * 1e9) as i64;
    let last_ns = (duration_s * 1e9) as i64 - scan_ns;
    for request in (0..).map(|k| k * every_ns).take_while(|t| *t <= last_ns) {
        let recent = allowed.iter().filter(|t| request - **t < window_ns).count();
        if recent < config.throttle_scans as usize {
            allowed.push(request);
        }
    }
    allowed
}

/// Wi-Fi as an Android app gets it: each network with the moment at which it was heard, all of a scan at its end.
pub(super) fn wifi(
    config: &WifiConfig,
    transmitters: &Transmitters,
    receiver: &Receiver,
    world: &World,
    walk: &Walk,
    seed: u64,
) -> Vec<AmbientMessage> {
    let law = Law::from(config);
    let networks: Vec<_> = transmitters
        .networks()
        .map(|n| (n, Shadowed::new(&n.source, &law, seed)))
        .collect();
    let dice = stream(seed, "wifi", 0);
    let scan_ns = i64::from(CHANNELS_2400 + CHANNELS_5000) * DWELL_NS;
    let mut messages = Vec::new();
    for (scan, begin_ns) in scan_times(config, walk.duration_s(), scan_ns)
        .into_iter()
        .enumerate()
    {
        for (network, shadowed) in &networks {
            let heard_ns = begin_ns + heard_after_ns(network.source.frequency_mhz, &dice);
            let (ahead, place) = direction_and_place(walk, heard_ns);
            let mean = mean_dbm(&law, receiver, world, shadowed, place, ahead);
            let Some(rssi_dbm) = reading_dbm(&law, mean, &dice) else {
                continue;
            };
            messages.push(AmbientMessage {
                measured_ns: heard_ns,
                ready_ns: begin_ns + scan_ns,
                sample: AmbientSample::Wifi(WifiReading {
                    scan: scan as u32,
                    bssid: network.bssid.clone(),
                    ssid: network.ssid.clone(),
                    frequency_mhz: network.source.frequency_mhz as u32,
                    rssi_dbm,
                }),
            });
        }
    }
    messages
}

/// When in a scan a channel's beacon is heard.
fn heard_after_ns(frequency_mhz: f64, dice: &Dice) -> i64 {
    let channel = if frequency_mhz < 3000.0 {
        ((frequency_mhz - 2412.0) / 5.0) as u32
    } else {
        // Channels 36 to 64, then 100 to 140.
        let number = (frequency_mhz as u32 - 5000) / 5;
        CHANNELS_2400
            + match number {
                0..=64 => number.saturating_sub(36) / 4,
                _ => 8 + (number - 100) / 4,
            }
    };
    i64::from(channel) * DWELL_NS + (unit(dice.bits()) * DWELL_NS as f64) as i64
}

/// Beacons: of each, once in a while, the latest advertisement.
pub(super) fn ble(
    config: &BleConfig,
    device: Device,
    transmitters: &Transmitters,
    receiver: &Receiver,
    world: &World,
    walk: &Walk,
    seed: u64,
) -> Vec<AmbientMessage> {
    if config.report_hz <= 0.0 {
        return Vec::new();
    }
    let law = Law::from(config);
    let period_ns = (1e9 / config.report_hz) as i64;
    let reports = (walk.duration_s() * config.report_hz) as i64;
    let mut messages = Vec::new();
    for (k, beacon) in transmitters.beacons.iter().enumerate() {
        let shadowed = Shadowed::new(&beacon.source, &law, seed);
        let dice = stream(seed, "ble", k as u64);
        let phase_ns = (unit(dice.bits()) * ADVERT_NS as f64) as i64;
        for report in 1..=reports {
            let ready_ns = report * period_ns;
            // Its last advertisement before the report.
            let stray_ns = (ADVERT_DELAY_NS * unit(dice.bits())) as i64;
            let back_ns = (ready_ns - phase_ns).rem_euclid(ADVERT_NS) + stray_ns;
            let measured_ns = (ready_ns - back_ns).max(0);
            let (ahead, place) = direction_and_place(walk, measured_ns);
            let mean = mean_dbm(&law, receiver, world, &shadowed, place, ahead);
            let Some(rssi_dbm) = reading_dbm(&law, mean, &dice) else {
                continue;
            };
            let hidden = device == Device::Iphone;
            messages.push(AmbientMessage {
                measured_ns,
                ready_ns,
                sample: AmbientSample::Ble(BleAdvert {
                    address: if hidden {
                        String::new()
                    } else {
                        beacon.address.clone()
                    },
                    uuid: uuid_text(&beacon.uuid),
                    major: beacon.major,
                    minor: beacon.minor,
                    measured_power_dbm: beacon.measured_power_dbm.into(),
                    rssi_dbm,
                    data: if hidden {
                        Vec::new()
                    } else {
                        beacon.advertisement()
                    },
                }),
            });
        }
    }
    messages
}

/// Eight, four, four, four and twelve digits.
fn uuid_text(uuid: &[u8; 16]) -> String {
    let hex: String = uuid.iter().map(|b| format!("{b:02x}")).collect();
    let parts = [0..8, 8..12, 12..16, 16..20, 20..32].map(|r| hex.get(r).unwrap_or_default());
    parts.join("-")
}

impl super::transmitters::Beacon {
    /// The advertisement as sent: flags, then Apple's manufacturer data of an iBeacon.
    pub fn advertisement(&self) -> Vec<u8> {
        let mut bytes = vec![0x02, 0x01, 0x06, 0x1a, 0xff, 0x4c, 0x00, 0x02, 0x15];
        bytes.extend(self.uuid);
        bytes.extend(self.major.to_be_bytes());
        bytes.extend(self.minor.to_be_bytes());
        bytes.push(self.measured_power_dbm.cast_unsigned());
        bytes
    }
}
