//! What Bluetooth beacons say of themselves: iBeacon and Eddystone, decoded from the advertisement as it was sent.

use super::radio::BleAdvert;

/// Elements of an advertisement: data of a service by its short number, and of a manufacturer.
const SERVICE_DATA: u8 = 0x16;
const MANUFACTURER: u8 = 0xFF;
/// How the data of an iBeacon begins: Apple, type, length.
const IBEACON: &[u8] = &[0x4C, 0x00, 0x02, 0x15];
/// How that of an Eddystone does: the service FEAA.
const EDDYSTONE: &[u8] = &[0xAA, 0xFE];
/// Beginnings and endings of addresses that an Eddystone shortens to one byte.
const SCHEMES: [&str; 4] = ["http://www.", "https://www.", "http://", "https://"];
const ENDINGS: [&str; 7] = [".com", ".org", ".edu", ".net", ".info", ".biz", ".gov"];

/// A beacon, by what it advertises.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Beacon {
    /// Apple's.
    IBeacon {
        /// Whose beacons, as text.
        uuid: String,
        /// Group of them.
        major: u16,
        /// Which of the group.
        minor: u16,
        /// Received at one metre, dBm.
        measured_power_dbm: i8,
    },
    /// Eddystone's number.
    EddystoneUid {
        /// Received at no distance, dBm.
        power_dbm: i8,
        /// Whose beacons.
        namespace: [u8; 10],
        /// Which of them.
        instance: [u8; 6],
    },
    /// Eddystone's address of a page.
    EddystoneUrl {
        /// Received at no distance, dBm.
        power_dbm: i8,
        /// The page.
        url: String,
    },
    /// How an Eddystone is.
    EddystoneTlm {
        /// Battery, millivolt; `None` where it is not told.
        battery_mv: Option<u16>,
        /// Degrees Celsius; `None` where it is not told.
        temperature_c: Option<f32>,
        /// Advertisements since it was switched on.
        adverts: u32,
        /// Since then, seconds.
        uptime_s: f64,
    },
}

impl Beacon {
    /// The beacon that an advertisement is of; `None` where it is of none that is known, or cut.
    pub fn decode(advert: &[u8]) -> Option<Self> {
        elements(advert).find_map(|(kind, data)| match kind {
            MANUFACTURER => ibeacon(data.strip_prefix(IBEACON)?),
            SERVICE_DATA => eddystone(data.strip_prefix(EDDYSTONE)?),
            _ => None,
        })
    }
}

impl BleAdvert {
    /// An advertisement as it was heard; what an iBeacon says stands beside it.
    pub fn heard(address: String, rssi_dbm: i16, data: Vec<u8>) -> Self {
        let heard = Self {
            address,
            rssi_dbm,
            data,
            ..Self::default()
        };
        match heard.beacon() {
            Some(Beacon::IBeacon {
                uuid,
                major,
                minor,
                measured_power_dbm,
            }) => Self {
                uuid,
                major,
                minor,
                measured_power_dbm: measured_power_dbm.into(),
                ..heard
            },
            _ => heard,
        }
    }

    /// The beacon that its bytes are of.
    pub fn beacon(&self) -> Option<Beacon> {
        Beacon::decode(&self.data)
    }

    /// By what its sender is known again: a beacon's number, an Eddystone's or an iBeacon's, as its address may change and iOS hides it; else
    /// the address.
    pub fn sender(&self) -> String {
        if let Some(Beacon::EddystoneUid {
            namespace,
            instance,
            ..
        }) = self.beacon()
        {
            return format!("{}:{}", hex(&namespace), hex(&instance));
        }
        match self.uuid.is_empty() {
            true => self.address.clone(),
            false => format!("{}:{}:{}", self.uuid, self.major, self.minor),
        }
    }
}

/// Elements: length of what follows, type, data.
fn elements(advert: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let mut rest = advert;
    std::iter::from_fn(move || {
        let (&length, behind) = rest.split_first()?;
        let (element, behind) = behind.split_at_checked(length.into())?;
        rest = behind;
        let (&kind, data) = element.split_first()?;
        Some((kind, data))
    })
}

fn ibeacon(data: &[u8]) -> Option<Beacon> {
    let (uuid, rest) = data.split_first_chunk::<16>()?;
    let &[a, b, c, d, power] = rest.first_chunk::<5>()?;
    let parts = [0..4, 4..6, 6..8, 8..10, 10..16].map(|part| hex(&uuid[part]));
    Some(Beacon::IBeacon {
        uuid: parts.join("-"),
        major: u16::from_be_bytes([a, b]),
        minor: u16::from_be_bytes([c, d]),
        measured_power_dbm: power as i8,
    })
}

fn eddystone(data: &[u8]) -> Option<Beacon> {
    let (&frame, data) = data.split_first()?;
    match frame {
        0x00 => {
            let (&power, data) = data.split_first()?;
            let (namespace, data) = data.split_first_chunk()?;
            Some(Beacon::EddystoneUid {
                power_dbm: power as i8,
                namespace: *namespace,
                instance: *data.first_chunk()?,
            })
        }
        0x10 => {
            let &[power, scheme] = data.first_chunk()?;
            let mut url = (*SCHEMES.get(usize::from(scheme))?).to_owned();
            for &byte in data.get(2..)? {
                match usize::from(byte) {
                    short @ 0..=6 => url = url + ENDINGS[short] + "/",
                    short @ 7..=13 => url += ENDINGS[short - 7],
                    0x21..=0x7E => url.push(char::from(byte)),
                    _ => return None,
                }
            }
            Some(Beacon::EddystoneUrl {
                power_dbm: power as i8,
                url,
            })
        }
        0x20 => tlm(data),
        _ => None,
    }
}

fn tlm(data: &[u8]) -> Option<Beacon> {
    // Of the version that is not encrypted.
    let data = data.strip_prefix(&[0])?;
    let (battery, data) = data.split_first_chunk()?;
    let (temperature, data) = data.split_first_chunk()?;
    let (adverts, data) = data.split_first_chunk()?;
    let battery = u16::from_be_bytes(*battery);
    let temperature = i16::from_be_bytes(*temperature);
    Some(Beacon::EddystoneTlm {
        battery_mv: (battery > 0).then_some(battery),
        temperature_c: (temperature != i16::MIN).then(|| f32::from(temperature) / 256.0),
        adverts: u32::from_be_bytes(*adverts),
        uptime_s: f64::from(u32::from_be_bytes(*data.first_chunk()?)) / 10.0,
    })
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(hex: &str) -> Vec<u8> {
        let parse = |h: &str| u8::from_str_radix(h, 16).expect("a byte");
        hex.split(' ').map(parse).collect()
    }

    const APPLE: &str =
        "02 01 06 1a ff 4c 00 02 15 91 95 b3 ad a9 d0 45 00 85 ff 9f b0 f6 5a 52 01 01 02 03 04 c8";
    const UID: &str = "02 01 06 03 03 aa fe 17 16 aa fe 00 e7 01 02 03 04 05 06 07 08 09 0a 11 12 13 14 15 16 00 00";
    const TLM: &str = "02 01 06 03 03 aa fe 11 16 aa fe 20 00 0b b8 19 80 00 00 04 d2 00 00 dd d5";
    const URL: &str = "03 03 aa fe 0d 16 aa fe 10 eb 03 69 73 6f 01 61 2f 62";

    #[test]
    fn beacons_are_what_they_say() {
        let advert = BleAdvert::heard("aa".to_owned(), -70, bytes(APPLE));
        let apple = (advert.major, advert.minor, advert.measured_power_dbm);
        assert_eq!(apple, (258, 772, -56));
        assert_eq!(advert.uuid, "9195b3ad-a9d0-4500-85ff-9fb0f65a5201");
        assert_eq!(
            advert.sender(),
            "9195b3ad-a9d0-4500-85ff-9fb0f65a5201:258:772"
        );
        let uid = BleAdvert::heard("aa".to_owned(), -70, bytes(UID));
        assert_eq!(uid.sender(), "0102030405060708090a:111213141516");
        assert!(uid.uuid.is_empty());
        let tlm = Beacon::EddystoneTlm {
            battery_mv: Some(3000),
            temperature_c: Some(25.5),
            adverts: 1234,
            uptime_s: 5678.9,
        };
        assert_eq!(Beacon::decode(&bytes(TLM)), Some(tlm));
        let url = Beacon::EddystoneUrl {
            power_dbm: -21,
            url: "https://iso.org/a/b".to_owned(),
        };
        assert_eq!(Beacon::decode(&bytes(URL)), Some(url));
    }

    #[test]
    fn what_is_cut_or_of_another_kind_is_no_beacon() {
        for whole in [APPLE, UID, TLM, URL] {
            let whole = bytes(whole);
            for end in 0..whole.len() {
                assert_eq!(Beacon::decode(&whole[..end]), None, "{end}");
            }
        }
        for other in [
            "02 01 06",
            "00",
            "03 ff 4c 00",
            "05 16 aa fe 30 00",
            "ff ff",
        ] {
            assert_eq!(Beacon::decode(&bytes(other)), None, "{other}");
        }
    }
}
