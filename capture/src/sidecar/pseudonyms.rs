//! Identifiers of other people's access points and beacons, replaced before they are recorded.
//!
//! Each becomes a keyed hash of the same form: equal where the identifier is equal, so that maps of radio signals can be made, and not to be
//! turned back without the key. The key never is in a recording: it lies in the rig's folder, where all recordings of the rig share it. Who
//! removes it makes the identifiers of earlier recordings unrelated to those of later ones for good.

use lsfb_recording::message::{
    self, BleAdvert, CdrError, CdrReader, WifiReading, decode_ble, decode_wifi, encode_ble,
    encode_wifi,
};
use sha2::{Digest as _, Sha256};

/// Types without identifiers of others; what is neither of these nor known here could hold some.
const WITHOUT: [message::Schema; 12] = [
    message::IMU,
    message::IMAGE,
    message::CAMERA_INFO,
    message::MAGNETIC_FIELD,
    message::FLUID_PRESSURE,
    message::NAV_SAT_FIX,
    message::TIME_REFERENCE,
    message::FRAME_META,
    message::VECTOR,
    message::ORIENTATION,
    message::POSE,
    message::WIFI_SCAN,
];

/// What is replaced.
#[derive(Clone, Copy)]
enum Kind {
    Address = 1,
    Network = 2,
    Beacon = 3,
}

/// Replaces identifiers.
#[derive(Clone)]
pub(crate) struct Pseudonyms {
    key: [u8; 32],
}

impl std::fmt::Debug for Pseudonyms {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Pseudonyms(secret)")
    }
}

impl Pseudonyms {
    /// With the rig's key.
    pub(super) fn new(key: [u8; 32]) -> Self {
        Self { key }
    }

    /// Whether messages of a type may be recorded, replaced or as they are; otherwise why not.
    pub(super) fn admit(schema_name: &str) -> Result<(), String> {
        let known = WITHOUT.iter().map(|schema| schema.name);
        let replaced = [message::WIFI_READING.name, message::BLE_ADVERT.name];
        match known.chain(replaced).any(|name| name == schema_name) {
            true => Ok(()),
            false => Err(format!(
                "identifiers are hashed in this recording, and {schema_name} may contain some that \
                 the recorder does not know; set hash_identifiers = false to record it"
            )),
        }
    }

    /// The message without identifiers; `None` where it has none.
    pub(super) fn replace(
        &self,
        schema_name: &str,
        bytes: &[u8],
    ) -> Option<Result<Vec<u8>, CdrError>> {
        if schema_name == message::WIFI_READING.name {
            return Some(self.wifi(bytes));
        }
        (schema_name == message::BLE_ADVERT.name).then(|| self.ble(bytes))
    }

    fn wifi(&self, bytes: &[u8]) -> Result<Vec<u8>, CdrError> {
        let header = CdrReader::new(bytes)?.header()?;
        let reading = decode_wifi(bytes)?;
        let replaced = WifiReading {
            bssid: self.address(&reading.bssid),
            ssid: self.network(&reading.ssid),
            ..reading
        };
        Ok(encode_wifi(header.stamp, header.frame_id, &replaced))
    }

    fn ble(&self, bytes: &[u8]) -> Result<Vec<u8>, CdrError> {
        let header = CdrReader::new(bytes)?.header()?;
        let advert = decode_ble(bytes)?;
        let beacon = format!("{}/{}/{}", advert.uuid, advert.major, advert.minor);
        let hashed = self.hash(Kind::Beacon, &beacon);
        let is_beacon = !advert.uuid.is_empty();
        let number = |at: usize| match is_beacon {
            true => u16::from_be_bytes([hashed[at], hashed[at + 1]]),
            false => 0,
        };
        let replaced = BleAdvert {
            address: self.address(&advert.address),
            uuid: match is_beacon {
                true => uuid(&self.hash(Kind::Beacon, &advert.uuid)),
                false => String::new(),
            },
            major: number(0),
            minor: number(2),
            // It says the same once more.
            data: Vec::new(),
            ..advert
        };
        Ok(encode_ble(header.stamp, header.frame_id, &replaced))
    }

    /// An address that nobody was given: locally administered, of one station.
    fn address(&self, address: &str) -> String {
        if address.is_empty() {
            return String::new();
        }
        // Systems write the same address in either case.
        let hash = self.hash(Kind::Address, &address.to_ascii_lowercase());
        let first = hash[0] & !0x01 | 0x02;
        let rest = hash[1..6].iter().map(|byte| format!(":{byte:02x}"));
        rest.fold(format!("{first:02x}"), |text, byte| text + &byte)
    }

    fn network(&self, name: &str) -> String {
        match name {
            "" => String::new(),
            name => hex(&self.hash(Kind::Network, name)[..8]),
        }
    }

    fn hash(&self, kind: Kind, text: &str) -> [u8; 32] {
        let mut hash = Sha256::new();
        hash.update(self.key);
        hash.update([kind as u8]);
        hash.update(text.as_bytes());
        hash.finalize().into()
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn uuid(hash: &[u8; 32]) -> String {
    let [a, b, c, d, e] = [0..4, 4..6, 6..8, 8..10, 10..16].map(|range| hex(&hash[range]));
    format!("{a}-{b}-{c}-{d}-{e}")
}

#[cfg(test)]
mod tests {
    use lsfb_types::Timestamp;

    use super::*;

    fn wifi(bssid: &str, ssid: &str) -> Vec<u8> {
        let reading = WifiReading {
            scan: 7,
            bssid: bssid.to_owned(),
            ssid: ssid.to_owned(),
            frequency_mhz: 5180,
            rssi_dbm: -61,
        };
        encode_wifi(Timestamp::from_nanos(5), "phone", &reading)
    }

    fn replaced(pseudonyms: &Pseudonyms, schema: &message::Schema, bytes: &[u8]) -> Vec<u8> {
        let replaced = pseudonyms.replace(schema.name, bytes);
        replaced.expect("of this type").expect("readable")
    }

    /// Whether a text, or the bytes that it is the hexadecimal form of, stand in a message.
    fn holds(bytes: &[u8], text: &str) -> bool {
        let raw: Vec<u8> = text
            .split([':', '-'])
            .flat_map(|pair| {
                (0..pair.len() / 2)
                    .filter_map(|k| u8::from_str_radix(&pair[2 * k..2 * k + 2], 16).ok())
            })
            .collect();
        let lower = text.to_ascii_lowercase();
        let within = String::from_utf8_lossy(bytes).to_ascii_lowercase();
        within.contains(&lower) || raw.len() >= 4 && bytes.windows(raw.len()).any(|w| w == raw)
    }

    #[test]
    fn no_identifier_of_others_survives() {
        let pseudonyms = Pseudonyms::new([3; 32]);
        let (bssid, ssid) = ("AC:DE:48:00:11:22", "Ada's flat");
        let kept = replaced(&pseudonyms, &message::WIFI_READING, &wifi(bssid, ssid));
        assert!(!holds(&kept, bssid) && !holds(&kept, ssid));
        let reading = decode_wifi(&kept).unwrap();
        assert_eq!(
            (reading.scan, reading.frequency_mhz, reading.rssi_dbm),
            (7, 5180, -61)
        );
        let first = u8::from_str_radix(&reading.bssid[..2], 16).unwrap();
        assert_eq!((reading.bssid.len(), first & 0x03), (17, 0x02));
        let header = CdrReader::new(&kept).unwrap().header().unwrap();
        assert_eq!((header.stamp.nanos(), header.frame_id), (5, "phone"));

        let uuid = "9195b3ad-a9d0-4500-85ff-9fb0f65a5201";
        let sent = BleAdvert {
            address: bssid.to_owned(),
            uuid: uuid.to_owned(),
            major: 258,
            minor: 772,
            measured_power_dbm: -56,
            rssi_dbm: -70,
            data: b"\x02\x01\x06\xac\xde\x48\x00\x11\x22".to_vec(),
        };
        let bytes = encode_ble(Timestamp::from_nanos(9), "phone", &sent);
        let kept = replaced(&pseudonyms, &message::BLE_ADVERT, &bytes);
        assert!(!holds(&kept, bssid) && !holds(&kept, uuid));
        let advert = decode_ble(&kept).unwrap();
        assert_eq!((advert.measured_power_dbm, advert.rssi_dbm), (-56, -70));
        assert_eq!((advert.uuid.len(), advert.data.len()), (36, 0));
        assert_ne!((advert.major, advert.minor), (258, 772));
    }

    #[test]
    fn equal_identifiers_stay_equal_under_one_key_alone() {
        let [ours, theirs] = [3, 4].map(|key| Pseudonyms::new([key; 32]));
        let name = |pseudonyms: &Pseudonyms, bssid: &str| {
            let kept = replaced(pseudonyms, &message::WIFI_READING, &wifi(bssid, ""));
            let reading = decode_wifi(&kept).unwrap();
            assert_eq!(reading.ssid, "", "a hidden network stays hidden");
            reading.bssid
        };
        let first = name(&ours, "AC:DE:48:00:11:22");
        assert_eq!(first, name(&ours, "ac:de:48:00:11:22"));
        assert_ne!(first, name(&ours, "ac:de:48:00:11:23"));
        assert_ne!(first, name(&theirs, "ac:de:48:00:11:22"));
    }

    #[test]
    fn what_is_not_known_to_be_without_is_not_recorded() {
        assert!(Pseudonyms::admit(message::IMU.name).is_ok());
        assert!(Pseudonyms::admit(message::WIFI_READING.name).is_ok());
        // A phone that told its scans was refused.
        assert!(Pseudonyms::admit(message::WIFI_SCAN.name).is_ok());
        assert!(Pseudonyms::admit("std_msgs/msg/String").is_err());
        let pseudonyms = Pseudonyms::new([3; 32]);
        assert!(pseudonyms.replace(message::IMU.name, &[0; 40]).is_none());
        let cut = &wifi("ac:de:48:00:11:22", "x")[..30];
        let refused = pseudonyms.replace(message::WIFI_READING.name, cut);
        assert!(matches!(refused, Some(Err(_))), "{refused:?}");
    }
}
