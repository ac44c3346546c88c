//! What a phone measured of its surroundings. Topics are found by their type; one of several is named in full.

use lsfb_types::Stamped;

use crate::cdr::CdrError;
use crate::error::Error;
use crate::message::{self, BleAdvert, GnssReading, MagneticSample, PressureSample, WifiReading};
use crate::message_iter::{Role, with_ticks};
use crate::reader::Recording;
use crate::topic::DEVICE_TIME;

impl Recording {
    /// Samples of a magnetometer, in the sensor's axes. `None`: the only one there is.
    pub fn magnetic(
        &self,
        topic: Option<&str>,
    ) -> Result<impl Iterator<Item = Result<Stamped<MagneticSample>, Error>> + use<'_>, Error> {
        self.surroundings(topic, message::MAGNETIC_FIELD, message::decode_magnetic)
    }

    /// Samples of a barometer. `None`: the only one there is.
    pub fn pressure(
        &self,
        topic: Option<&str>,
    ) -> Result<impl Iterator<Item = Result<Stamped<PressureSample>, Error>> + use<'_>, Error> {
        self.surroundings(topic, message::FLUID_PRESSURE, message::decode_pressure)
    }

    /// What a satellite receiver says. `None`: the only one there is.
    pub fn gnss(
        &self,
        topic: Option<&str>,
    ) -> Result<impl Iterator<Item = Result<Stamped<GnssReading>, Error>> + use<'_>, Error> {
        self.surroundings(topic, message::NAV_SAT_FIX, message::decode_gnss)
    }

    /// Wi-Fi networks heard, each with the time at which it was. `None`: by the only device that listened.
    pub fn wifi(
        &self,
        topic: Option<&str>,
    ) -> Result<impl Iterator<Item = Result<Stamped<WifiReading>, Error>> + use<'_>, Error> {
        self.surroundings(topic, message::WIFI_READING, message::decode_wifi)
    }

    /// Advertisements of Bluetooth beacons. `None`: by the only device that listened.
    pub fn ble(
        &self,
        topic: Option<&str>,
    ) -> Result<impl Iterator<Item = Result<Stamped<BleAdvert>, Error>> + use<'_>, Error> {
        self.surroundings(topic, message::BLE_ADVERT, message::decode_ble)
    }

    /// Samples of a type, with the device's own stamps where they were recorded.
    fn surroundings<'a, T: 'a>(
        &'a self,
        topic: Option<&str>,
        schema: message::Schema,
        decode: fn(&[u8]) -> Result<T, CdrError>,
    ) -> Result<impl Iterator<Item = Result<Stamped<T>, Error>> + use<'a, T>, Error> {
        let topic = match topic {
            Some(topic) => topic.to_owned(),
            None => self.only_topic(schema.name, |t| t.schema == schema.name)?,
        };
        let mut roles = self.sample_role(&topic, schema.name)?;
        let device_time = format!("{topic}{DEVICE_TIME}");
        let companions = self.channels_of(&device_time);
        roles.extend(companions.map(|id| (id, Role::Companion(0))));
        Ok(self.samples(roles, with_ticks(decode)))
    }
}
