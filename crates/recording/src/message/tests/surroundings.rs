//! Against bytes serialised by rosbags 0.11 (ROS 2 Jazzy type store): build each message there with the values below and
//! stamp 1771234567.123456789, and print `store.serialize_cdr(message, type).hex()`.

use lsfb_types::Timestamp;

use super::{STAMP, hex};
use crate::cdr::CdrError;
use crate::message::*;

const MAGNETIC: &str = "0001000007e5926915cd5b07040000006d6167002d431cebe236fa3ef168e388b5f8b4bef168e388b5f804bf9b2ba1869b84063d\
    0000000000000000000000000000000000000000000000009b2ba1869b84163d000000000000000000000000000000000000000000000000b4e0f8a474e3203d";
const PRESSURE: &str =
    "0001000007e5926915cd5b07050000006261726f0000000000000000000000003439f7400000000000000240";
const GNSS: &str = "0001000007e5926915cd5b0705000000676e737300000100000000000000000000104840000000000000274000000000003c8040\
    0000000000001040000000000000e03f000000000000d03f000000000000e03f0000000000002240000000000000f0bf000000000000d03f\
    000000000000f0bf000000000000304003";
const WIFI: &str = "0001000007e5926915cd5b07050000007769666900000000070000001200000030323a30303a35653a31303a30303a303100\
    0000050000006c736662000000003c140000bdff";
const BLE: &str = "0001000007e5926915cd5b0704000000626c65001200000063303a30313a30323a30333a30343a303500000025000000\
    39313935623361642d613964302d343530302d383566662d396662306636356135323031000002010403c8ffacff00000300000002011a";
const SCAN: &str =
    "0001000007e5926915cd5b0704000000696d75000700000000e592690500000007e5926915cd5b071f000000";
const VECTOR_3: &str =
    "0001000007e5926915cd5b0704000000696d7500000000000000f83f00000000000002c0000000000000c03f";
const QUATERNION: &str = "0001000007e5926915cd5b0704000000696d75000000000000000000333333333333e33f00000000000000009a9999999999e93f";

pub(super) fn unhex(text: &str) -> Vec<u8> {
    (0..text.len() / 2)
        .map(|i| u8::from_str_radix(&text[2 * i..2 * i + 2], 16).unwrap())
        .collect()
}

#[test]
fn magnetic_field() {
    let sample = MagneticSample {
        field_t: [2.5e-5, -1.25e-6, -4.0e-5],
        variance_t2: [1e-14, 2e-14, 3e-14],
    };
    assert_eq!(hex(&encode_magnetic(STAMP, "mag", &sample)), MAGNETIC);
    assert_eq!(decode_magnetic(&unhex(MAGNETIC)), Ok(sample));
}

#[test]
fn pressure() {
    let sample = PressureSample {
        pressure_pa: 95_123.25,
        variance_pa2: 2.25,
    };
    assert_eq!(hex(&encode_pressure(STAMP, "baro", &sample)), PRESSURE);
    assert_eq!(decode_pressure(&unhex(PRESSURE)), Ok(sample));
}

#[test]
fn gnss() {
    let reading = GnssReading {
        fix: Some(GnssFix {
            latitude_deg: 48.125,
            longitude_deg: 11.5,
            altitude_m: 519.5,
            covariance_enu_m2: [4.0, 0.5, 0.25, 0.5, 9.0, -1.0, 0.25, -1.0, 16.0],
        }),
    };
    assert_eq!(hex(&encode_gnss(STAMP, "gnss", &reading)), GNSS);
    assert_eq!(decode_gnss(&unhex(GNSS)), Ok(reading));
    let none = GnssReading { fix: None };
    assert_eq!(decode_gnss(&encode_gnss(STAMP, "gnss", &none)), Ok(none));
}

#[test]
fn radio() {
    let wifi = WifiReading {
        scan: 7,
        bssid: "02:00:5e:10:00:01".into(),
        ssid: "lsfb".into(),
        frequency_mhz: 5180,
        rssi_dbm: -67,
    };
    assert_eq!(hex(&encode_wifi(STAMP, "wifi", &wifi)), WIFI);
    assert_eq!(decode_wifi(&unhex(WIFI)), Ok(wifi));
    let ble = BleAdvert {
        address: "c0:01:02:03:04:05".into(),
        uuid: "9195b3ad-a9d0-4500-85ff-9fb0f65a5201".into(),
        major: 258,
        minor: 772,
        measured_power_dbm: -56,
        rssi_dbm: -84,
        data: vec![2, 1, 0x1a],
    };
    assert_eq!(hex(&encode_ble(STAMP, "ble", &ble)), BLE);
    assert_eq!(decode_ble(&unhex(BLE)), Ok(ble));
}

#[test]
fn a_scan_says_when_it_began_and_ended() {
    let scan = WifiScan {
        scan: 7,
        started: Timestamp::from_nanos(1_771_234_560_000_000_005),
        ended: STAMP,
        readings: 31,
    };
    assert_eq!(hex(&encode_wifi_scan(STAMP, "imu", &scan)), SCAN);
    assert_eq!(decode_wifi_scan(&unhex(SCAN)), Ok(scan));
}

#[test]
fn axes_of_one_sensor() {
    let vector = [1.5, -2.25, 0.125];
    assert_eq!(hex(&encode_vector(STAMP, "imu", &vector)), VECTOR_3);
    assert_eq!(decode_vector(&unhex(VECTOR_3)), Ok(vector));
    let xyzw = [0.0, 0.6, 0.0, 0.8];
    assert_eq!(hex(&encode_orientation(STAMP, "imu", &xyzw)), QUATERNION);
    assert_eq!(decode_orientation(&unhex(QUATERNION)), Ok(xyzw));
}

#[test]
fn every_cut_message_of_the_surroundings_is_refused() {
    type Decode = fn(&[u8]) -> Option<CdrError>;
    let cases: [(&str, Decode); 8] = [
        (MAGNETIC, |b| decode_magnetic(b).err()),
        (PRESSURE, |b| decode_pressure(b).err()),
        (GNSS, |b| decode_gnss(b).err()),
        (WIFI, |b| decode_wifi(b).err()),
        (BLE, |b| decode_ble(b).err()),
        (SCAN, |b| decode_wifi_scan(b).err()),
        (VECTOR_3, |b| decode_vector(b).err()),
        (QUATERNION, |b| decode_orientation(b).err()),
    ];
    for (text, decode) in cases {
        let bytes = unhex(text);
        for cut in 0..bytes.len() {
            assert!(decode(&bytes[..cut]).is_some(), "{cut}");
        }
    }
}
