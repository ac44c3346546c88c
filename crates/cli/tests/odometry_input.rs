//! `lsfb odometry` on what people have: their topics, their files, their packets.

use std::path::{Path, PathBuf};

use crate::answer::json;
use crate::capture_file::pcap;
use crate::process::lsfb;
use crate::refusal::refused;
use crate::ros_bags::Walk;
use lsfb_geometry::{Se3, StampedPose, UnitQuaternion, Vector3};
use lsfb_recording::message::StaticTransform;
use lsfb_recording::{Channel, Recording, Writer, WriterConfig, read_tum};
use lsfb_types::{ImuSample, LidarPoint, LidarScan, Stamped, Timestamp};
use serde_json::Value;

/// A room of 8 × 6 × 3 m with a pillar, seen from a sensor that moves 5 cm along x from scan to scan, also while it turns.
fn scan(number: usize) -> LidarScan {
    let mut points = Vec::new();
    for column in 0..900_u16 {
        let turns = number as f32 + f32::from(column) / 1000.0;
        let sensor = [0.05 * turns, 0.3, 1.2];
        for ring in 0..16_u16 {
            let azimuth = f32::from(column) * std::f32::consts::TAU / 900.0;
            let elevation = (f32::from(ring) * 4.0 - 30.0).to_radians();
            let ray = [
                elevation.cos() * azimuth.cos(),
                -elevation.cos() * azimuth.sin(),
                elevation.sin(),
            ];
            let walls = [(-4.0, 4.0), (-3.0, 3.0), (0.0, 3.0)];
            let mut range_m = f32::INFINITY;
            for ((along, from), (low, high)) in ray.iter().zip(sensor).zip(walls) {
                let wall = if *along > 0.0 { high } else { low };
                range_m = range_m.min((wall - from) / along);
            }
            // The pillar's face towards the sensor, at x = 2 m.
            let to_pillar = (2.0 - sensor[0]) / ray[0];
            let side = sensor[1] + to_pillar * ray[1];
            if to_pillar > 0.0 && (-1.0..-0.4).contains(&side) {
                range_m = range_m.min(to_pillar);
            }
            points.push(LidarPoint {
                position_m: ray.map(|c| c * range_m),
                ring,
                time_offset_ns: 100_000 * u32::from(column),
                ..LidarPoint::default()
            });
        }
    }
    LidarScan { points }
}

const SCANS: usize = 12;

/// From the first firing of a scan to its last.
const SCAN_NS: i64 = 89_900_000;

fn at(number: usize) -> Timestamp {
    Timestamp::from_nanos(1_700_000_000_000_000_000 + 100_000_000 * number as i64)
}

fn stamped<T>(time: Timestamp, sample: T) -> Stamped<T> {
    Stamped {
        time,
        arrival: time,
        device_ticks: 0,
        sample,
    }
}

/// What an IMU that stays level feels.
fn samples() -> impl Iterator<Item = Stamped<ImuSample>> {
    (0..10 * SCANS as i64).map(|tenth| {
        let level = ImuSample {
            angular_velocity_rad_s: [0.0; 3],
            // One that says the same again and again has paused.
            specific_force_m_s2: [0.0, 0.0, 9.81 + 1e-4 * (tenth % 10 % 3) as f64],
        };
        stamped(at(0).plus_nanos(10_000_000 * tenth), level)
    })
}

/// A recording without a rig: to this program that of a stranger.
fn foreign_mcap(path: &Path) {
    // Several chunks, so that a torn file still has some.
    let config = WriterConfig {
        chunk_bytes: 16 << 10,
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(path, &config).expect("a file");
    let mut samples = samples();
    for number in 0..SCANS {
        for sample in samples.by_ref().take(10) {
            writer.write_imu("imu0", &sample).expect("a sample");
        }
        writer
            .write_scan("lidar", &stamped(at(number), scan(number)))
            .expect("a scan");
    }
    writer.finish().expect("a file");
}

/// Where the trajectory ends, from the end of its first scan.
fn moved_m(path: &Path) -> [f64; 3] {
    let found = read_tum(path).expect("a trajectory");
    let [begin, .., last] = found.poses() else {
        panic!("poses")
    };
    // Without an IMU, but with times of points, the motion within that scan is there too.
    let end = begin.time.plus_nanos(SCAN_NS);
    let is_end = |p: &&StampedPose| (p.time - end).abs() < 10_000;
    let first = found.poses().iter().find(is_end).unwrap_or(begin);
    (first.world_from_rig.inverse() * last.world_from_rig)
        .translation
        .into()
}

fn expect_path(path: &Path) {
    let [x, y, z] = moved_m(path);
    // From the last firing of the first scan to that of the last.
    assert!(
        (x - 0.55).abs() < 0.06 && y.abs() < 0.03 && z.abs() < 0.03,
        "{x} {y} {z}"
    );
}

#[test]
fn an_mcap_of_a_stranger_is_run_on_without_an_imu_of_which_nothing_is_known() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    foreign_mcap(&path.join("walk.mcap"));
    let command = ["odometry", "walk.mcap", "--out", "walk.tum"];
    let report = json(path, &command, 0);
    assert_eq!(report["registered"], SCANS);
    assert_eq!(report["deskew"]["by_times"], SCANS);
    assert_eq!(report["input"]["lidar_topic"], "/lidar/points");
    assert_eq!(report["imu_samples"], 0);
    let said = report["input"]["warnings"].to_string();
    assert!(said.contains("neither --rig nor /tf_static"), "{said}");
    expect_path(&path.join("walk.tum"));
    judged_as_by_the_other_commands(path, &command, &report);

    // Asked for, it is an error and no silence.
    let asked = [&command[..], &["--imu-topic", "/imu0/data_raw"]].concat();
    refused(path, &asked, &["--rig", "/tf_static"]);
    let missing = [&command[..], &["--lidar-topic", "/os/points"]].concat();
    refused(path, &missing, &["/os/points", "these have: /lidar/points"]);

    let rig = "name = \"handheld\"\n[lidars.lidar]\nrange_noise_m = 0.02\n[lidars.lidar.rig_from_lidar]\n\
               rotation_xyzw = [0.0, 0.0, 0.0, 1.0]\ntranslation_m = [0.0, 0.0, 0.0]\n";
    std::fs::write(path.join("rig.toml"), rig).expect("a rig");
    let with_rig = [&command[..], &["--rig", "rig.toml", "--force"]].concat();
    let report = json(path, &with_rig, 0);
    assert_eq!(report["input"]["extrinsic"], "rig");
    assert_eq!(report["input"]["imu_topic"], "/imu0/data_raw");
    assert_eq!(report["imu_samples"], SCANS * 10);
    let found = read_tum(&path.join("walk.tum")).expect("a trajectory");
    let turned = found.poses().iter().map(|p| {
        p.world_from_rig
            .rotation
            .angle_to(&UnitQuaternion::identity())
    });
    assert!(turned.fold(0.0, f64::max) < 0.02);
}

/// A sensor whose place on the IMU two edges of `/tf_static` tell: together a quarter of a turn, so that it goes along the IMU's y.
#[test]
fn bags_of_both_ros_are_run_on_with_the_imu_that_tf_static_places() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    let edge = |child: &str, turn_deg: f64, up_m: f64| {
        let turn = Vector3::new(0.0, 0.0, turn_deg.to_radians());
        StaticTransform {
            parent: "base".to_owned(),
            child: child.to_owned(),
            parent_from_child: Se3::new(
                UnitQuaternion::from_scaled_axis(turn),
                Vector3::new(0.0, 0.0, up_m),
            ),
        }
    };
    let walk = Walk {
        scans: (0..SCANS).map(|n| stamped(at(n), scan(n))).collect(),
        samples: samples().collect(),
        edges: vec![edge("lidar", 30.0, 0.2), edge("imu", -60.0, 0.1)],
    };
    walk.ros1(&path.join("walk.bag"));
    walk.rosbag2(&path.join("walk"));
    for (input, out) in [("walk.bag", "1.tum"), ("walk", "2.tum")] {
        let report = json(path, &["odometry", input, "--out", out], 0);
        let (input, deskew) = (&report["input"], &report["deskew"]);
        assert_eq!(input["extrinsic"], "/tf_static", "{report}");
        let topics = (&input["lidar_topic"], &input["imu_topic"]);
        assert_eq!(topics, (&"/points".into(), &"/imu".into()));
        assert_eq!(
            (&report["registered"], &deskew["by_times"]),
            (&SCANS.into(), &SCANS.into())
        );
        assert_eq!(report["imu_samples"], 10 * SCANS);
        let [x, y, z] = moved_m(&path.join(out));
        assert!(
            x.abs() < 0.03 && (y - 0.55).abs() < 0.06 && z.abs() < 0.03,
            "{out}: {x} {y} {z}"
        );
    }
    // The same messages, the same walk.
    let poses = ["1.tum", "2.tum"].map(|out| std::fs::read(path.join(out)).expect("poses"));
    assert!(poses[0] == poses[1], "the bags differ");
}

/// Refused with the advice to import what cannot be imported.
#[test]
fn clouds_of_a_stranger_are_stored() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    foreign_mcap(&path.join("walk.mcap"));
    let command = [
        "odometry",
        "walk.mcap",
        "--out",
        "walk.tum",
        "--out-clouds",
        "clouds.mcap",
    ];
    let report = json(path, &command, 0);
    assert_eq!(report["clouds"]["scans"], SCANS);
    let clouds = Recording::open(&path.join("clouds.mcap")).expect("clouds");
    let poses = read_tum(&path.join("walk.tum")).expect("a trajectory");
    let (mut off, mut points) = (0, 0);
    for scan in clouds.scans().expect("scans") {
        let scan = scan.expect("a scan");
        let pose = poses
            .poses()
            .iter()
            .find(|p| p.time == scan.time)
            .expect("a pose");
        // The world's origin is where the first scan ended, 1.2 m above the floor and 2.7 m beside a wall.
        for point in &scan.sample.points {
            let in_world = pose.world_from_rig * Vector3::from(point.position_m.map(f64::from));
            let floor_m = (in_world.z + 1.2).abs().min((in_world.z - 1.8).abs());
            let walls_m = (in_world.y - 2.7).abs().min((in_world.y + 3.3).abs());
            off += u32::from(in_world.x.abs() < 1.0 && floor_m.min(walls_m) > 0.05);
            points += 1;
        }
    }
    assert!(points > 10_000 && 50 * off < points, "{off} of {points}");
}

/// It alone had neither verdict nor findings: a script that asks every command for them took its silence for a PASS.
fn judged_as_by_the_other_commands(path: &Path, command: &[&str], report: &Value) {
    assert_eq!(report["verdict"], "warn");
    let summary = report["summary"].as_str().expect("text");
    assert!(summary.starts_with("WARN: "), "{summary}");
    let findings = report["findings"].as_array().expect("findings");
    let found = |code: &str| {
        let found = findings.iter().find(|f| f["code"] == code);
        found.unwrap_or_else(|| panic!("no {code} in {findings:?}"))
    };
    let registered = found("registered");
    assert_eq!(
        (&registered["verdict"], &registered["value"]),
        (&"pass".into(), &(SCANS as f64).into())
    );
    let known = found("known");
    assert_eq!(
        (&known["unit"], &known["limit"]["at_most"]),
        (&"m".into(), &1.0.into())
    );
    assert_eq!(found("no-imu")["verdict"], "warn");
    assert_eq!(found("input")["what"], report["input"]["warnings"][0]);

    let text = lsfb(path, &[command, &["--force"]].concat());
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines[0].contains(" scans registered, "), "{text}");
    for problem in ["WARN     odometry ", "WARN     input "] {
        assert!(lines.iter().any(|line| line.starts_with(problem)), "{text}");
    }
}

#[test]
fn a_folder_of_kitti_is_read_and_nothing_is_left_beside_the_result() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    let scans = path.join("velodyne");
    std::fs::create_dir(&scans).expect("folder");
    for number in 0..SCANS {
        let points = scan(number).points;
        let numbers = points.iter().flat_map(|p| {
            let [x, y, z] = p.position_m;
            [x, y, z, 0.5].map(f32::to_le_bytes)
        });
        std::fs::write(
            scans.join(format!("{number}.bin")),
            numbers.flatten().collect::<Vec<u8>>(),
        )
        .expect("a scan");
    }
    let command = ["odometry", "velodyne", "--out", "k.tum", "--force"];
    let report = json(path, &command, 0);
    assert_eq!(
        (&report["registered"], &report["deskew"]["none"]),
        (&SCANS.into(), &SCANS.into())
    );
    let said = report.to_string();
    assert!(
        said.contains("10 scans per second") && said.contains("not_deskewed"),
        "{said}"
    );
    expect_path(&path.join("k.tum"));
    let mut there: Vec<PathBuf> = std::fs::read_dir(path)
        .expect("folder")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    there.sort();
    let names = [
        "k.tum",
        "k.tum.provenance.json",
        "k_covariance.txt",
        "velodyne",
    ];
    assert_eq!(there, names.map(|name| path.join(name)));
    // A pose and its covariance for each scan, as `lsfb eval` reads them.
    let text = std::fs::read_to_string(path.join("k_covariance.txt")).expect("covariances");
    let rows = text.lines().filter(|line| !line.starts_with('#'));
    let columns: Vec<usize> = rows.map(|row| row.split(' ').count()).collect();
    assert_eq!(columns, [44; SCANS]);

    // The order of its points shows the turn of the sensor.
    let by_azimuth = [&command[..], &["--lidar-model", "vlp-16"]].concat();
    let report = json(path, &by_azimuth, 0);
    assert_eq!(
        (&report["deskew"]["by_azimuth"], &report["deskew"]["none"]),
        (&SCANS.into(), &0.into())
    );

    // One scan was a trajectory of one pose, and a success.
    let report = json(path, &["odometry", "velodyne/0.bin", "--out", "one.tum"], 4);
    let findings = report["findings"].as_array().expect("findings");
    let codes: Vec<_> = findings.iter().filter(|f| f["verdict"] == "fail").collect();
    assert!(
        codes.len() == 1 && codes[0]["code"] == "one-pose",
        "{report}"
    );
}

#[test]
fn packets_in_a_bag_of_a_driver_are_run_on() {
    let test = "packets_in_a_bag_of_a_driver_are_run_on";
    let below = "lidar/nebula_velodyne/vlp32/1713492677464078412_0.db3";
    let Some(bag) = lsfb_tests::recordings(test, below) else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let arguments = [
        "odometry",
        bag.to_str().expect("UTF-8"),
        "--out",
        "v.tum",
        "--outdoor",
    ];
    let report = json(folder.path(), &arguments, 0);
    assert!(report["registered"].as_u64() >= Some(4), "{report}");
    assert_eq!(report["deskew"]["none"], 0, "{report}");
    assert_eq!(report["input"]["scan_times"], "packets");
    let left = std::fs::read_dir(folder.path()).expect("folder").count();
    assert_eq!(
        left, 3,
        "the trajectory, its covariances and its provenance"
    );
}

/// A message whose bytes end early costs itself, and the exit code says that something is missing.
#[test]
fn a_message_that_cannot_be_read_is_left_out_and_told_by_the_exit_code() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    let mut writer =
        Writer::create(&path.join("walk.mcap"), &WriterConfig::default()).expect("a file");
    let channel = Channel {
        topic: "/lidar/points",
        schema_name: "sensor_msgs/msg/PointCloud2",
        schema_text: "",
    };
    for number in 0..SCANS {
        if number == SCANS / 2 {
            let time = at(number);
            writer
                .write_cdr(&channel, time, time, &[0, 1, 0, 0, 7])
                .expect("half a message");
            continue;
        }
        writer
            .write_scan("lidar", &stamped(at(number), scan(number)))
            .expect("a scan");
    }
    writer.finish().expect("a file");
    let report = json(path, &["odometry", "walk.mcap", "--out", "walk.tum"], 3);
    assert_eq!(report["registered"], SCANS - 1);
    let said = report["input"]["warnings"].to_string();
    assert!(said.contains("1 messages could not be read"), "{said}");
}

/// A bag whose end is torn off was read as if it were whole: its missing end is said, and told by the exit code.
#[test]
fn a_bag_whose_end_is_torn_off_is_told_by_the_exit_code() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    let bag = path.join("walk.mcap");
    foreign_mcap(&bag);
    let whole = std::fs::read(&bag).expect("the bag");
    std::fs::write(&bag, &whole[..whole.len() * 3 / 4]).expect("a torn bag");
    let report = json(path, &["odometry", "walk.mcap", "--out", "walk.tum"], 3);
    let warnings = report["input"]["warnings"].as_array().expect("a list");
    let names_the_file = |w: &Value| w.to_string().contains("walk.mcap: ");
    assert!(warnings.iter().any(names_the_file), "{warnings:?}");
}

/// A list of loops that is given back as it is leads to the same trajectory, bit by bit; one of another walk is refused.
#[test]
fn loops_are_listed_and_a_list_is_taken_back() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    foreign_mcap(&path.join("walk.mcap"));
    let found = [
        "odometry",
        "walk.mcap",
        "--out-loops",
        "loops.txt",
        "--out",
        "a.tum",
    ];
    let report = json(path, &found, 0);
    // Half a metre of a way is no return.
    assert_eq!(report["loops"]["accepted"], 0);
    let list = std::fs::read_to_string(path.join("loops.txt")).expect("a list");
    assert!(list.starts_with("# Loops of a walk"), "{list}");
    let given = [
        "odometry",
        "walk.mcap",
        "--loops",
        "loops.txt",
        "--out",
        "b.tum",
    ];
    json(path, &given, 0);
    let trajectory = |name: &str| std::fs::read(path.join(name)).expect("a trajectory");
    assert_eq!(trajectory("a.tum"), trajectory("b.tum"));

    // A person's own loop: the last scan 20 cm farther than the odometry has it.
    let poses = read_tum(&path.join("a.tum")).expect("a trajectory");
    let (first, last) = (
        at(0).plus_nanos(SCAN_NS),
        poses.poses().last().expect("a pose").time,
    );
    let own = format!("accept {first} {last} - - - - - 0.75 0 0 0 0 0 1 0.001 0.001 -\n");
    std::fs::write(path.join("own.txt"), own).expect("a list");
    let given = [
        "odometry",
        "walk.mcap",
        "--loops",
        "own.txt",
        "--out",
        "c.tum",
    ];
    let report = json(path, &given, 0);
    assert_eq!(report["loops"]["accepted"], 1);
    let [x, ..] = moved_m(&path.join("c.tum"));
    assert!((x - 0.75).abs() < 0.03, "{x}");

    std::fs::write(
        path.join("other.txt"),
        "accept 1.000000000 2.000000000 - - - - - 0 0 0 0 0 0 1 1 1 -\n",
    )
    .expect("a list");
    let other = [
        "odometry",
        "walk.mcap",
        "--loops",
        "other.txt",
        "--out",
        "d.tum",
    ];
    refused(path, &other, &["other.txt:1", "no scan of this walk"]);
}

/// Six turns of a VLP-32C that stands, without some of its packets.
fn turns_without(absent: std::ops::Range<u64>) -> Vec<u8> {
    pcap((0..900).filter(|n| !absent.contains(n)))
}

/// They came as warnings of a run that was fine.
#[test]
fn packets_that_are_missing_from_a_capture_are_told_by_the_exit_code() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    let whole = turns_without(0..0);
    let captures = [
        ("whole.pcap", whole.clone(), 0),
        ("gap.pcap", turns_without(400..420), 3),
        ("cut.pcap", whole[..whole.len() * 6 / 10].to_vec(), 3),
    ];
    for (name, bytes, exit_code) in captures {
        std::fs::write(path.join(name), bytes).expect("file");
        let command = ["odometry", name, "--out", "walk.tum", "--force"];
        let report = json(path, &command, exit_code);
        assert_eq!(report["registered"], report["scans"], "{report}");
        let said = report["input"]["warnings"].to_string();
        assert_eq!(
            said.contains("packets are missing"),
            exit_code == 3,
            "{said}"
        );
    }
}
