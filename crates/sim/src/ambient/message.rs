//! A measurement of the surroundings on its way to the app.

use lsfb_recording::message::{
    self, BleAdvert, GnssReading, MagneticSample, PressureSample, Schema, WifiReading,
};
use lsfb_types::Timestamp;

/// Kinds of measurement, each on a channel of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AmbientChannel {
    /// The magnetic field.
    Magnetic,
    /// The pressure of the air.
    Pressure,
    /// Positions by satellites.
    Gnss,
    /// Networks heard.
    Wifi,
    /// Beacons heard.
    Ble,
}

impl AmbientChannel {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Magnetic,
        Self::Pressure,
        Self::Gnss,
        Self::Wifi,
        Self::Ble,
    ];

    /// Last part of its topic.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Magnetic => "mag",
            Self::Pressure => "pressure",
            Self::Gnss => "gnss",
            Self::Wifi => "wifi",
            Self::Ble => "ble",
        }
    }

    /// Type of its messages.
    pub const fn schema(self) -> Schema {
        match self {
            Self::Magnetic => message::MAGNETIC_FIELD,
            Self::Pressure => message::FLUID_PRESSURE,
            Self::Gnss => message::NAV_SAT_FIX,
            Self::Wifi => message::WIFI_READING,
            Self::Ble => message::BLE_ADVERT,
        }
    }
}

/// What was measured.
#[derive(Clone, Debug, PartialEq)]
pub enum AmbientSample {
    /// The magnetic field.
    Magnetic(MagneticSample),
    /// The pressure of the air.
    Pressure(PressureSample),
    /// A position by satellites.
    Gnss(GnssReading),
    /// A network heard.
    Wifi(WifiReading),
    /// A beacon heard.
    Ble(BleAdvert),
}

/// A measurement with its times, nanoseconds after the beginning of the walk.
#[derive(Clone, Debug, PartialEq)]
pub struct AmbientMessage {
    /// When it was measured.
    pub measured_ns: i64,
    /// When the system gives it to the app.
    pub ready_ns: i64,
    /// What was measured.
    pub sample: AmbientSample,
}

impl AmbientMessage {
    /// Its channel.
    pub fn channel(&self) -> AmbientChannel {
        match self.sample {
            AmbientSample::Magnetic(_) => AmbientChannel::Magnetic,
            AmbientSample::Pressure(_) => AmbientChannel::Pressure,
            AmbientSample::Gnss(_) => AmbientChannel::Gnss,
            AmbientSample::Wifi(_) => AmbientChannel::Wifi,
            AmbientSample::Ble(_) => AmbientChannel::Ble,
        }
    }

    /// As CDR, with this stamp in its header.
    pub(crate) fn encode(&self, stamp: Timestamp) -> Vec<u8> {
        let frame = self.channel().name();
        match &self.sample {
            AmbientSample::Magnetic(sample) => message::encode_magnetic(stamp, "imu", sample),
            AmbientSample::Pressure(sample) => message::encode_pressure(stamp, frame, sample),
            AmbientSample::Gnss(reading) => message::encode_gnss(stamp, frame, reading),
            AmbientSample::Wifi(reading) => message::encode_wifi(stamp, frame, reading),
            AmbientSample::Ble(advert) => message::encode_ble(stamp, frame, advert),
        }
    }
}
