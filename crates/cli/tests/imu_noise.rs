//! `lsfb calib imu-noise` on logs at rest whose noise is known.

use std::fmt::Write as _;
use std::path::Path;

use crate::pages;
use crate::process::lsfb;
use lsfb_geometry::{ImuNoiseModel, Rig};
use lsfb_recording::{Channel, Writer, WriterConfig};
use lsfb_types::{ImuSample, Stamped, Timestamp};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const RATE_HZ: i64 = 10;
const SECONDS: i64 = 5400;
const TRUTH: ImuNoiseModel = ImuNoiseModel {
    gyro_noise_density: 1.6e-4,
    accel_noise_density: 2.8e-3,
    gyro_bias_walk: 1.5e-5,
    accel_bias_walk: 2.0e-4,
};

/// A normal number (Box and Muller).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random_range(0.0..1.0f64)).ln()).sqrt();
    radius * rng.random_range(0.0..std::f64::consts::TAU).cos()
}

/// An hour and a half at rest, as EuRoC has it: white noise and a bias that walks.
fn write_log(path: &Path, seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let interval_s = 1.0 / RATE_HZ as f64;
    let (white, walk) = (interval_s.sqrt().recip(), interval_s.sqrt());
    let mut bias = [0.01, -0.02, 0.005, 0.1, -0.05, 9.81];
    let mut text = String::from("#timestamp [ns],w x,w y,w z,a x,a y,a z\n");
    for k in 0..SECONDS * RATE_HZ {
        let _ = write!(
            text,
            "{}",
            1_772_359_200_000_000_000 + k * 1_000_000_000 / RATE_HZ
        );
        for (axis, bias) in bias.iter_mut().enumerate() {
            let (density, random_walk) = match axis {
                0..3 => (TRUTH.gyro_noise_density, TRUTH.gyro_bias_walk),
                _ => (TRUTH.accel_noise_density, TRUTH.accel_bias_walk),
            };
            *bias += random_walk * walk * normal(&mut rng);
            let _ = write!(text, ",{:.9e}", *bias + density * white * normal(&mut rng));
        }
        text.push('\n');
    }
    std::fs::write(path, text).expect("log");
}

#[test]
fn known_noise_comes_back_within_its_sigma() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name);
    let mut worst = 0.0_f64;
    for seed in 1..=4 {
        write_log(&path("imu.csv"), seed);
        std::fs::write(path("rig.toml"), Rig::empty("backpack").to_toml()).expect("rig");
        let output = lsfb(
            folder.path(),
            &[
                "calib",
                "imu-noise",
                "--imu",
                "imu.csv",
                "--out",
                "noise.html",
                "--out-kalibr",
                "imu.yaml",
                "--rig",
                "rig.toml",
                "--out-rig",
                "rig.toml",
                "--force",
                "--json",
            ],
        );
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let found: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert_eq!(found["samples"], SECONDS * RATE_HZ);
        for (triad, density, walk) in [
            ("gyro", TRUTH.gyro_noise_density, TRUTH.gyro_bias_walk),
            ("accel", TRUTH.accel_noise_density, TRUTH.accel_bias_walk),
        ] {
            let number = |key: &str, name: &str| found[key][name].as_f64().expect("a number");
            let sigma = format!("{triad}_sigma");
            for (name, truth, narrow) in [("density", density, 0.01), ("walk", walk, 0.25)] {
                let sigma = number(&sigma, name);
                let off = (number(triad, name) - truth) / sigma;
                assert!(sigma < narrow * truth, "{triad} {name}: ± {sigma:e}");
                assert!(off.abs() < 3.5, "seed {seed}, {triad} {name}: {off:.1} σ");
                worst = worst.max(off.abs());
            }
        }

        // The same figures in the rig and in Kalibr's file.
        let rig = Rig::read(&path("rig.toml")).expect("rig");
        let imu = rig.imu_noise().expect("noise");
        assert_eq!(Some(imu.gyro_bias_walk), found["gyro"]["walk"].as_f64());
        let kalibr = std::fs::read_to_string(path("imu.yaml")).expect("file");
        let line = format!("gyroscope_noise_density: {:?}", imu.gyro_noise_density);
        assert!(
            kalibr.contains(&line) && kalibr.contains("update_rate: 10.0"),
            "{kalibr}"
        );
    }
    assert!(
        worst > 0.5,
        "standard deviations are far too large: {worst}"
    );
    let page = std::fs::read_to_string(path("noise.html")).expect("page");
    assert_eq!(page.matches("<svg").count(), 2);
    assert!(page.contains("Allan deviation"));
    pages::are_whole(folder.path());
    // Of a log without gaps; the sum of nothing is −0.
    assert!(page.contains("0 of ") && !page.contains("-0 of "), "{page}");
    assert!(path("noise.html.provenance.json").exists());
}

/// What a bag lacks is told by the exit code: a message that cannot be read, and all that came after a file was torn.
#[test]
fn a_bag_of_which_something_is_missing_is_no_whole_one() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name);
    let write = |name: &str, damaged: Option<i64>| {
        std::fs::create_dir(path(name)).expect("folder");
        let file = path(name).join("bag_0.mcap");
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut writer = Writer::create(&file, &WriterConfig::default()).expect("a file");
        for k in 0..100 * RATE_HZ {
            let time =
                Timestamp::from_nanos(1_772_359_200_000_000_000 + k * 1_000_000_000 / RATE_HZ);
            let mut noisy = |mean: [f64; 3]| mean.map(|value| value + 1e-3 * normal(&mut rng));
            let sample = Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: ImuSample {
                    angular_velocity_rad_s: noisy([0.0; 3]),
                    specific_force_m_s2: noisy([0.0, 0.0, 9.81]),
                },
            };
            if damaged == Some(k) {
                let channel = Channel {
                    topic: "/imu0/data_raw",
                    schema_name: "sensor_msgs/msg/Imu",
                    schema_text: "",
                };
                let half = [0, 1, 0, 0, 7];
                writer
                    .write_cdr(&channel, time, time, &half)
                    .expect("half a message");
            } else {
                writer.write_imu("imu0", &sample).expect("a sample");
            }
        }
        writer.finish().expect("a file");
        file
    };
    write("whole", None);
    write("half-a-message", Some(500));
    let torn = write("torn", None);
    let bytes = std::fs::read(&torn).expect("file");
    std::fs::write(&torn, &bytes[..bytes.len() * 9 / 10]).expect("file");
    for (name, code, words) in [
        ("whole", 0, ""),
        (
            "half-a-message",
            3,
            "1 messages of /imu0/data_raw could not be read",
        ),
        ("torn", 3, "bag_0.mcap"),
    ] {
        let page = format!("{name}.html");
        let arguments = ["calib", "imu-noise", "--recording", name, "--out", &page];
        let output = lsfb(folder.path(), &arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{name}: {said}");
        assert!(said.contains(words), "{name}: {said}");
    }
}
