//! What a phone hears: access points and beacons. One message for each transmitter heard, so that each has its own time.

use lsfb_types::Timestamp;

use crate::cdr::{CdrError, CdrReader, CdrWriter};

/// `lsfb_msgs/msg/WifiReading`: one network in one scan. The header's stamp is when its beacon was heard.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WifiReading {
    /// Number of the scan it belongs to; its readings arrive together.
    pub scan: u32,
    /// Address of the access point's radio, `02:00:5e:00:00:01`.
    pub bssid: String,
    /// Name of the network; empty where it is hidden.
    pub ssid: String,
    /// Middle of its channel, MHz.
    pub frequency_mhz: u32,
    /// Received power, dBm.
    pub rssi_dbm: i16,
}

/// `lsfb_msgs/msg/WifiReading`.
pub fn encode_wifi(time: Timestamp, frame: &str, reading: &WifiReading) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(96 + frame.len() + reading.ssid.len());
    w.header(time, frame);
    w.u32(reading.scan);
    w.string(&reading.bssid);
    w.string(&reading.ssid);
    w.u32(reading.frequency_mhz);
    w.u16(reading.rssi_dbm.cast_unsigned());
    w.finish()
}

/// A `lsfb_msgs/msg/WifiReading`.
pub fn decode_wifi(bytes: &[u8]) -> Result<WifiReading, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    Ok(WifiReading {
        scan: r.u32("scan")?,
        bssid: r.string("bssid")?.to_owned(),
        ssid: r.string("ssid")?.to_owned(),
        frequency_mhz: r.u32("frequency_mhz")?,
        rssi_dbm: r.u16("rssi_dbm")?.cast_signed(),
    })
}

/// `lsfb_msgs/msg/WifiScan`: one scan, whose readings carry its number. The header's stamp is when its result was handed out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WifiScan {
    /// Its number.
    pub scan: u32,
    /// When it began; zero where nobody said.
    pub started: Timestamp,
    /// When it ended; zero where nobody said.
    pub ended: Timestamp,
    /// Networks that it found.
    pub readings: u32,
}

/// `lsfb_msgs/msg/WifiScan`.
pub fn encode_wifi_scan(time: Timestamp, frame: &str, scan: &WifiScan) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(64 + frame.len());
    w.header(time, frame);
    w.u32(scan.scan);
    w.time(scan.started);
    w.time(scan.ended);
    w.u32(scan.readings);
    w.finish()
}

/// A `lsfb_msgs/msg/WifiScan`.
pub fn decode_wifi_scan(bytes: &[u8]) -> Result<WifiScan, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    Ok(WifiScan {
        scan: r.u32("scan")?,
        started: r.time("started")?,
        ended: r.time("ended")?,
        readings: r.u32("readings")?,
    })
}

/// `lsfb_msgs/msg/BleAdvert`: one advertisement of a beacon.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BleAdvert {
    /// Address of the beacon; empty where the system hides it (iOS).
    pub address: String,
    /// Proximity UUID of an iBeacon, empty for other beacons.
    pub uuid: String,
    /// Major number of an iBeacon.
    pub major: u16,
    /// Minor number of an iBeacon.
    pub minor: u16,
    /// Power at one metre, as the beacon says, dBm.
    pub measured_power_dbm: i16,
    /// Received power, dBm.
    pub rssi_dbm: i16,
    /// The advertisement as sent; empty where the system hides it.
    pub data: Vec<u8>,
}

/// `lsfb_msgs/msg/BleAdvert`.
pub fn encode_ble(time: Timestamp, frame: &str, advert: &BleAdvert) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(128 + frame.len() + advert.data.len());
    w.header(time, frame);
    w.string(&advert.address);
    w.string(&advert.uuid);
    w.u16(advert.major);
    w.u16(advert.minor);
    w.u16(advert.measured_power_dbm.cast_unsigned());
    w.u16(advert.rssi_dbm.cast_unsigned());
    w.byte_sequence(&advert.data);
    w.finish()
}

/// A `lsfb_msgs/msg/BleAdvert`.
pub fn decode_ble(bytes: &[u8]) -> Result<BleAdvert, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    Ok(BleAdvert {
        address: r.string("address")?.to_owned(),
        uuid: r.string("uuid")?.to_owned(),
        major: r.u16("major")?,
        minor: r.u16("minor")?,
        measured_power_dbm: r.u16("measured_power_dbm")?.cast_signed(),
        rssi_dbm: r.u16("rssi_dbm")?.cast_signed(),
        data: r.byte_sequence("data")?.to_vec(),
    })
}
