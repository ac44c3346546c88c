//! The inertial unit of a Mynt D on USB: the driver, `rusb` and libusb as they are, above an emulated kernel.
#![cfg(feature = "hardware")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests, and the one line a skipped test owes its reader"
)]

mod fake_kernel;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use lsfb_drivers::Error;
use lsfb_drivers::mynt_d::model::{USB_PRODUCT, USB_VENDOR};
use lsfb_drivers::mynt_d::wire::{Item, RawReading, Report};
use lsfb_drivers::mynt_d::{Decoder, MyntDConfig, MyntDImu, MyntDReading};
use lsfb_drivers::transport::PacketSource;

const DEVICE: &str = "LSFB_FAKE_USB";
const REPORTS: u16 = 200;
const PERIOD_US: u32 = 1_000;

/// Device, configuration, HID interface, HID, interrupt endpoint 0x81 (USB 2.0, chapter 9).
fn descriptors(product: u16) -> Vec<u8> {
    let [v0, v1] = USB_VENDOR.to_le_bytes();
    let [p0, p1] = product.to_le_bytes();
    let device = [18, 1, 0, 2, 0, 0, 0, 64, v0, v1, p0, p1, 0, 1, 0, 0, 0, 1];
    let configuration = [9, 2, 34, 0, 1, 1, 0, 0x80, 50];
    let interface = [9, 4, 0, 0, 1, 3, 0, 0, 0];
    let hid = [9, 0x21, 0x11, 1, 0, 1, 0x22, 32, 0];
    let endpoint = [7, 5, 0x81, 3, 64, 0, 1];
    [&device[..], &configuration, &interface, &hid, &endpoint].concat()
}

/// The layout is that of `tests/fakekernel/src/usb.rs`.
fn script(product: u16) -> Vec<u8> {
    let descriptors = descriptors(product);
    let mut script = (descriptors.len() as u32).to_le_bytes().to_vec();
    script.extend(descriptors);
    for serial in 0..REPORTS {
        let ticks = 100 * u32::from(serial);
        let reading = |ticks, z| RawReading {
            ticks,
            xyz: [0, 0, z],
            temperature: 0x40,
        };
        let items = [
            Item::Accelerometer(reading(ticks, 0x1555)),
            Item::Gyroscope(reading(ticks + 50, serial as i16)),
        ];
        let report = Report::emit(serial, &items).unwrap();
        script.extend((PERIOD_US * u32::from(serial)).to_le_bytes());
        script.extend((report.len() as u32).to_le_bytes());
        script.extend(report);
    }
    script.extend([0; 4]);
    script.extend(u32::MAX.to_le_bytes());
    script
}

/// Below the emulated kernel: the path of the device. Above it: `None`, after the test has been run below.
fn below_fake_kernel(name: &str, product: u16) -> Option<MyntDConfig> {
    if let Some(device) = std::env::var_os(DEVICE) {
        let device = device.into_string().unwrap();
        let path = PathBuf::from(device.split('\t').next().unwrap());
        return Some(MyntDConfig { path });
    }
    if fake_kernel::is_possible(name) {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("script");
        std::fs::write(&file, script(product)).unwrap();
        let device = dir.path().join("imu_mynt_d");
        let both = format!("{}\t{}", device.display(), file.display());
        fake_kernel::run_below(name, &[(DEVICE, both)]);
    }
    None
}

#[test]
fn every_report_of_a_unit_arrives_until_it_is_unplugged() {
    let name = "every_report_of_a_unit_arrives_until_it_is_unplugged";
    let Some(config) = below_fake_kernel(name, USB_PRODUCT) else {
        return;
    };
    let mut imu = MyntDImu::open(&config).unwrap();
    let mut decoder = Decoder::new();
    let mut samples = 0u32;
    let begin = Instant::now();
    let lost = loop {
        match imu.recv(Duration::from_secs(5)) {
            Ok(packet) => decoder
                .push(&packet.expect("the unit went silent"))
                .unwrap(),
            Err(error) => break error,
        }
        while let Some(reading) = decoder.next_reading() {
            assert_eq!(reading.device_ticks, u64::from(100 * samples + 50));
            let MyntDReading::Imu(sample) = reading.sample else {
                panic!("{reading:?}")
            };
            let expected = (f64::from(samples) * 2000.0 / 65_536.0).to_radians();
            assert!((sample.angular_velocity_rad_s[2] - expected).abs() < 1e-12);
            samples += 1;
        }
    };
    assert!(matches!(lost, Error::Lost { .. }), "{lost}");
    // The last gyroscope reading has no accelerometer reading behind it.
    assert_eq!(samples, u32::from(REPORTS) - 1);
    let counters = decoder.counters();
    assert_eq!((counters.reports, counters.missing), (REPORTS.into(), 0));
    let sent_over = Duration::from_micros(u64::from(PERIOD_US) * u64::from(REPORTS - 1));
    assert!(begin.elapsed() >= sent_over);
    assert!(matches!(imu.recv(Duration::ZERO), Err(Error::Lost { .. })));
}

#[test]
fn another_device_at_the_path_is_an_error_that_names_it() {
    let name = "another_device_at_the_path_is_an_error_that_names_it";
    let Some(config) = below_fake_kernel(name, 0x1234) else {
        return;
    };
    let error = MyntDImu::open(&config).unwrap_err().to_string();
    assert!(
        error.contains("found 0483:1234, expected 0483:5720"),
        "{error}"
    );
}
