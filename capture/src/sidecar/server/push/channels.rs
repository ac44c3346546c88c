//! What was pushed becomes messages as an app of our own would send them.
//!
//! Each sensor has a topic of its own; at each sample of the gyroscope `imu` has the specific force as well, taken linearly between its
//! neighbours. What the phone's system made of its sensors (acceleration without gravity, gravity) stays apart.

use std::collections::{BTreeMap, VecDeque};

use lsfb_drivers::sidecar::sensor_logger::{PushedBody, PushedKind, PushedReading, PushedValue};
use lsfb_drivers::sidecar::wire::Advertise;
use lsfb_recording::message::{
    self, BleAdvert, GnssFix, GnssReading, ImuVariance, MagneticSample, PressureSample, Schema,
    WifiReading,
};
use lsfb_types::{ImuSample, Timestamp};

/// The phone's clock, as the app tells it: of its system, set or not.
const CLOCK_ID: &str = "sensorlogger.unix";
/// Number of the channel of [`PushedKind`]s put together.
const IMU: u32 = 100;
/// Between two forces that lie further apart than this nothing is known, nanoseconds.
const WIDEST_GAP_NS: i64 = 200_000_000;
/// Samples that wait for their neighbours at most.
const MAX_WAITING: usize = 8_192;
/// Networks of one scan are told together.
const SCAN_NS: i64 = 1_000_000_000;

/// One message.
#[derive(Debug)]
pub(super) struct Outgoing {
    pub(super) channel: u32,
    pub(super) time_ns: i64,
    pub(super) payload: Vec<u8>,
}

/// The channels of one session.
#[derive(Debug, Default)]
pub(super) struct Channels {
    last_ns: BTreeMap<PushedKind, i64>,
    force: Option<PushedKind>,
    rate: Option<PushedKind>,
    forces: VecDeque<(i64, [f64; 3])>,
    rates: VecDeque<(i64, [f64; 3])>,
    scan: u32,
    scan_ns: Option<i64>,
    /// Readings that were there already.
    pub(super) repeated: u64,
}

impl Channels {
    /// The messages of a batch, each topic in the order of time.
    pub(super) fn messages(&mut self, device: &str, body: PushedBody) -> Vec<Outgoing> {
        let mut readings = body.readings;
        readings.sort_by_key(|reading| reading.time_ns);
        let has = |kind| readings.iter().any(|reading| reading.kind == kind);
        let first_of = |kinds: [PushedKind; 2]| kinds.into_iter().find(|kind| has(*kind));
        // Raw ones before those that the system corrects while it learns; what a session began with it goes on with.
        let force = first_of([PushedKind::ForceUncalibrated, PushedKind::Force]);
        let rate = first_of([PushedKind::RateUncalibrated, PushedKind::Rate]);
        (self.force, self.rate) = (self.force.or(force), self.rate.or(rate));
        let mut out = Vec::with_capacity(2 * readings.len());
        for reading in readings {
            if self.is_repeated(&reading) {
                self.repeated += 1;
                continue;
            }
            if let PushedValue::Vector(axes) = reading.value {
                if Some(reading.kind) == self.force {
                    self.forces.push_back((reading.time_ns, axes));
                } else if Some(reading.kind) == self.rate {
                    self.rates.push_back((reading.time_ns, axes));
                }
            }
            let payload = self.encode(device, &reading);
            out.push(Outgoing {
                channel: channel_of(reading.kind),
                time_ns: reading.time_ns,
                payload,
            });
        }
        self.put_together(device, &mut out);
        out
    }

    /// The app repeats samples of its own (its README: "Removing Duplicated Entries"). Of networks and beacons several are heard at once.
    fn is_repeated(&mut self, reading: &PushedReading) -> bool {
        if matches!(reading.kind, PushedKind::Wifi | PushedKind::Bluetooth) {
            return false;
        }
        let last = self.last_ns.entry(reading.kind).or_insert(i64::MIN);
        let is_repeated = reading.time_ns <= *last;
        *last = reading.time_ns.max(*last);
        is_repeated
    }

    fn put_together(&mut self, device: &str, out: &mut Vec<Outgoing>) {
        while let Some((time_ns, rate)) = self.rates.front().copied() {
            while self
                .forces
                .get(1)
                .is_some_and(|(after, _)| *after <= time_ns)
            {
                self.forces.pop_front();
            }
            let force = match (self.forces.front(), self.forces.get(1)) {
                (None, _) => break,
                (Some((at, force)), _) if *at == time_ns => Some(*force),
                (Some((before, _)), _) if *before > time_ns => None,
                // What follows has not come yet.
                (Some(_), None) => break,
                (Some((before, a)), Some((after, b))) if after - before <= WIDEST_GAP_NS => {
                    let share = (time_ns - before) as f64 / (after - before) as f64;
                    Some(std::array::from_fn(|axis| {
                        a[axis] + share * (b[axis] - a[axis])
                    }))
                }
                _ => None,
            };
            self.rates.pop_front();
            if let Some(specific_force_m_s2) = force {
                let sample = ImuSample {
                    angular_velocity_rad_s: rate,
                    specific_force_m_s2,
                };
                let time = Timestamp::from_nanos(time_ns);
                let payload = message::encode_imu(time, device, &sample, ImuVariance::UNKNOWN);
                out.push(Outgoing {
                    channel: IMU,
                    time_ns,
                    payload,
                });
            }
        }
        // One sensor without the other.
        for waiting in [&mut self.rates, &mut self.forces] {
            let excess = waiting.len().saturating_sub(MAX_WAITING);
            waiting.drain(..excess);
        }
    }

    fn encode(&mut self, device: &str, reading: &PushedReading) -> Vec<u8> {
        let time = Timestamp::from_nanos(reading.time_ns);
        match &reading.value {
            PushedValue::Vector(axes) if schema_of(reading.kind) == message::MAGNETIC_FIELD => {
                let sample = MagneticSample {
                    field_t: *axes,
                    variance_t2: [0.0; 3],
                };
                message::encode_magnetic(time, device, &sample)
            }
            PushedValue::Vector(axes) => message::encode_vector(time, device, axes),
            PushedValue::PressurePa(pressure_pa) => {
                let sample = PressureSample {
                    pressure_pa: *pressure_pa,
                    variance_pa2: 0.0,
                };
                message::encode_pressure(time, device, &sample)
            }
            PushedValue::Position {
                latitude_deg,
                longitude_deg,
                altitude_m,
                sigma_m,
            } => {
                let mut covariance_enu_m2 = [0.0; 9];
                if let Some([across_m, up_m]) = sigma_m {
                    covariance_enu_m2[0] = across_m * across_m;
                    covariance_enu_m2[4] = across_m * across_m;
                    covariance_enu_m2[8] = up_m * up_m;
                }
                let fix = GnssFix {
                    latitude_deg: *latitude_deg,
                    longitude_deg: *longitude_deg,
                    altitude_m: *altitude_m,
                    covariance_enu_m2,
                };
                message::encode_gnss(time, device, &GnssReading { fix: Some(fix) })
            }
            PushedValue::Network {
                bssid,
                ssid,
                frequency_mhz,
                rssi_dbm,
            } => {
                let is_same = self
                    .scan_ns
                    .is_some_and(|began| reading.time_ns - began < SCAN_NS);
                if !is_same {
                    self.scan_ns = Some(reading.time_ns);
                    self.scan = self.scan.wrapping_add(1);
                }
                let reading = WifiReading {
                    scan: self.scan,
                    bssid: bssid.clone(),
                    ssid: ssid.clone(),
                    frequency_mhz: *frequency_mhz,
                    rssi_dbm: *rssi_dbm,
                };
                message::encode_wifi(time, device, &reading)
            }
            PushedValue::Advert {
                address,
                rssi_dbm,
                data,
            } => {
                let advert = BleAdvert::heard(address.clone(), *rssi_dbm, data.clone());
                message::encode_ble(time, device, &advert)
            }
        }
    }
}

/// A channel, as an app would describe it.
pub(super) fn describe(device: &str, channel: u32) -> Option<Advertise> {
    let (name, schema) = match channel {
        IMU => ("imu", message::IMU),
        _ => {
            let kind = KINDS
                .into_iter()
                .find(|kind| channel_of(*kind) == channel)?;
            (name_of(kind), schema_of(kind))
        }
    };
    Some(Advertise {
        channel,
        topic: format!("/sidecar/{device}/{name}"),
        encoding: "cdr".to_owned(),
        schema_name: schema.name.to_owned(),
        schema: schema.text.as_bytes().to_vec(),
        clock_id: CLOCK_ID.to_owned(),
        metadata_json: String::new(),
    })
}

const KINDS: [PushedKind; 12] = [
    PushedKind::ForceUncalibrated,
    PushedKind::Force,
    PushedKind::LinearAcceleration,
    PushedKind::Gravity,
    PushedKind::RateUncalibrated,
    PushedKind::Rate,
    PushedKind::MagneticUncalibrated,
    PushedKind::Magnetic,
    PushedKind::Pressure,
    PushedKind::Location,
    PushedKind::Wifi,
    PushedKind::Bluetooth,
];

fn channel_of(kind: PushedKind) -> u32 {
    kind as u32 + 1
}

fn name_of(kind: PushedKind) -> &'static str {
    match kind {
        PushedKind::ForceUncalibrated => "accel",
        PushedKind::Force => "accel_calibrated",
        PushedKind::LinearAcceleration => "linear_acceleration",
        PushedKind::Gravity => "gravity",
        PushedKind::RateUncalibrated => "gyro",
        PushedKind::Rate => "gyro_calibrated",
        PushedKind::MagneticUncalibrated => "mag",
        PushedKind::Magnetic => "mag_calibrated",
        PushedKind::Pressure => "pressure",
        PushedKind::Location => "gnss",
        PushedKind::Wifi => "wifi",
        PushedKind::Bluetooth => "ble",
    }
}

fn schema_of(kind: PushedKind) -> Schema {
    match kind {
        PushedKind::MagneticUncalibrated | PushedKind::Magnetic => message::MAGNETIC_FIELD,
        PushedKind::Pressure => message::FLUID_PRESSURE,
        PushedKind::Location => message::NAV_SAT_FIX,
        PushedKind::Wifi => message::WIFI_READING,
        PushedKind::Bluetooth => message::BLE_ADVERT,
        PushedKind::ForceUncalibrated
        | PushedKind::Force
        | PushedKind::LinearAcceleration
        | PushedKind::Gravity
        | PushedKind::RateUncalibrated
        | PushedKind::Rate => message::VECTOR,
    }
}
