//! Readers written by others open our recordings and find the values we wrote.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::process::Command;

use lsfb_geometry::{
    Camera, ImuNoiseModel, Rig, RigCamera, RigImu, RigLidar, Se3, Vector3, Vector6,
};
use lsfb_recording::message::{
    self, BleAdvert, GnssFix, GnssReading, MagneticSample, PressureSample, WifiReading,
};
use lsfb_recording::{Channel, Compression, LIDAR_POSITION, TF, Writer, WriterConfig};
use lsfb_tests::foreign_python;
use lsfb_types::{Image, ImuSample, LidarPoint, LidarScan, Packet, Stamped, Timestamp};

const START: Timestamp = Timestamp::from_nanos(1_772_359_200_123_456_789);

fn stamped<T>(n: u32, sample: T) -> Stamped<T> {
    let time = START + i64::from(n) * 100_000_000;
    Stamped {
        time,
        arrival: time + 3_000_000,
        device_ticks: 5_000_000_000 + u64::from(n),
        sample,
    }
}

/// Values that `check.py` computes as well.
fn write(path: &std::path::Path, compression: Compression) {
    let config = WriterConfig {
        compression,
        chunk_secs: 0.5,
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(path, &config).unwrap();
    writer.expect_odometry();
    let pose = Se3::exp(&Vector6::new(0.0, 0.0, 0.5, 0.25, -0.5, 1.0));
    let camera = Camera::pinhole(6, 4, [5.0, 5.5], [2.5, 1.5]);
    writer
        .attach_rig(&Rig {
            calibrated_unix_s: Some(1_772_350_000),
            cameras: [(
                "cam0".to_owned(),
                RigCamera {
                    camera,
                    rig_from_camera: pose,
                    timing: Default::default(),
                    sigmas: Default::default(),
                },
            )]
            .into(),
            lidars: RigLidar {
                rig_from_lidar: pose,
                range_noise_m: 0.02,
            }
            .alone(),
            imus: RigImu::from(ImuNoiseModel {
                gyro_noise_density: 1e-3,
                accel_noise_density: 1e-2,
                gyro_bias_walk: 1e-5,
                accel_bias_walk: 1e-4,
            })
            .alone(),
            ..Rig::empty("backpack")
        })
        .unwrap();
    for n in 0..20u32 {
        let pixels = (0..24).map(|i| (i * 3 + n) as u8).collect();
        let image = Image {
            width: 6,
            height: 4,
            pixels,
            exposure_ns: 4_000_000 + n,
            frame_id: n,
        };
        writer
            .write_image_with_trailer("cam0", &stamped(n, image), &[0x3b, n as u8])
            .unwrap();
        let sample = ImuSample {
            angular_velocity_rad_s: [f64::from(n) * 0.25, -1.0, 0.5],
            specific_force_m_s2: [0.125, f64::from(n), 9.75],
        };
        writer.write_imu("imu0", &stamped(n, sample)).unwrap();
        let points = (0..3u16).map(|i| LidarPoint {
            position_m: [f32::from(i) + 0.5, n as f32, -0.25],
            intensity: 10 * i as u8,
            ring: i,
            time_offset_ns: 55_296 * u32::from(i),
            ..LidarPoint::default()
        });
        writer
            .write_scan(
                "lidar",
                &stamped(
                    n,
                    LidarScan {
                        points: points.collect(),
                    },
                ),
            )
            .unwrap();
        let time = stamped(n, ()).time;
        let packet = |i: u8, bytes: usize| Packet {
            arrival: time + i64::from(i),
            bytes: vec![i + n as u8; bytes],
        };
        writer
            .write_lidar_packets(
                "lidar",
                time,
                &[packet(0, 1206), packet(1, 1206), packet(2, 1206)],
            )
            .unwrap();
        writer
            .write_raw(LIDAR_POSITION, 0, u64::from(n), &packet(3, 512), time)
            .unwrap();
        let odom_from_rig = Se3::exp(&Vector6::new(0.0, 0.0, 0.5, 0.0, 0.0, 0.0));
        let odom_from_rig = Se3 {
            translation: Vector3::new(f64::from(n), 0.5, -0.25),
            ..odom_from_rig
        };
        let channel = Channel {
            topic: TF,
            schema_name: message::TF_MESSAGE.name,
            schema_text: message::TF_MESSAGE.text,
        };
        let bytes = message::encode_odometry(time, &odom_from_rig);
        let known = time + 3_000_000;
        writer.write_cdr(&channel, time, known, &bytes).unwrap();
        write_surroundings(&mut writer, n);
    }
    writer.finish().unwrap();
}

/// What a phone measures of its surroundings.
fn write_surroundings(writer: &mut Writer, n: u32) {
    let stamps = stamped(n, ());
    let x = f64::from(n);
    let magnetic = MagneticSample {
        field_t: [1e-6 * x, -2e-6, 4.5e-5],
        variance_t2: [1e-14, 2e-14, 3e-14],
    };
    let pressure = PressureSample {
        pressure_pa: 95_000.25 + x,
        variance_pa2: 2.25,
    };
    let fix = GnssFix {
        latitude_deg: 48.125,
        longitude_deg: 11.5 + x,
        altitude_m: 519.5,
        covariance_enu_m2: [4.0, 0.5, 0.25, 0.5, 9.0, -1.0, 0.25, -1.0, 16.0],
    };
    // Every second one is without a fix.
    let gnss = GnssReading {
        fix: n.is_multiple_of(2).then_some(fix),
    };
    let wifi = WifiReading {
        scan: n,
        bssid: "02:00:5e:10:00:01".into(),
        ssid: "lsfb".into(),
        frequency_mhz: 5180,
        rssi_dbm: -60 - n as i16,
    };
    let ble = BleAdvert {
        address: "c0:01:02:03:04:05".into(),
        uuid: "9195b3ad-a9d0-4500-85ff-9fb0f65a5201".into(),
        major: 258,
        minor: n as u16,
        measured_power_dbm: -56,
        rssi_dbm: -84,
        data: vec![2, 1, n as u8],
    };
    let time = stamps.time;
    for (name, schema, bytes) in [
        (
            "mag",
            message::MAGNETIC_FIELD,
            message::encode_magnetic(time, "mag", &magnetic),
        ),
        (
            "pressure",
            message::FLUID_PRESSURE,
            message::encode_pressure(time, "pressure", &pressure),
        ),
        (
            "gnss",
            message::NAV_SAT_FIX,
            message::encode_gnss(time, "gnss", &gnss),
        ),
        (
            "wifi",
            message::WIFI_READING,
            message::encode_wifi(time, "wifi", &wifi),
        ),
        (
            "ble",
            message::BLE_ADVERT,
            message::encode_ble(time, "ble", &ble),
        ),
    ] {
        let topic = format!("/sidecar/phone/{name}");
        let channel = Channel {
            topic: &topic,
            schema_name: schema.name,
            schema_text: schema.text,
        };
        writer
            .write_cdr(&channel, time, stamps.arrival, &bytes)
            .unwrap();
    }
}

#[test]
fn foreign_readers_read_every_value_and_pair_images_with_intrinsics() {
    let test = "foreign_readers_read_every_value_and_pair_images_with_intrinsics";
    let Some(python) = foreign_python(test) else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/foreign/check.py");
    for compression in [Compression::Lz4, Compression::Zstd, Compression::None] {
        let path = dir.path().join("walk.mcap");
        write(&path, compression);
        let output = Command::new(&python)
            .arg(script)
            .arg(&path)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(
            output.status.success(),
            "{said}{}",
            String::from_utf8_lossy(&output.stderr)
        );
        assert!(
            ["mcap", "rosbags", "mcap-ros2-support"]
                .iter()
                .all(|reader| said.contains(&format!("{reader}: 302 messages"))),
            "{said}"
        );
    }
}
