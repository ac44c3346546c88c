//! Who sends LiDAR packets, and what is in a capture that has none.

use std::path::Path;

use crate::answer::json;
use crate::capture_file::{Frame, capture, pcap};
use crate::refusal::{found_unfit, refused};
use lsfb_drivers::velodyne::wire::DataPacket;
use lsfb_recording::Recording;
use lsfb_tests::recordings;
use lsfb_tests::velodyne::data_packet;
use lsfb_types::{Echo, LidarScan};
use serde_json::Value;

/// Protocol number of IP.
const TCP: u8 = 6;
/// Exit code of a recording from which something is missing.
const DATA_LOST: i32 = 3;

fn write(folder: &Path, name: &str, bytes: &[u8]) {
    std::fs::write(folder.join(name), bytes).expect("file");
}

fn scans(path: &Path) -> Vec<LidarScan> {
    let recording = Recording::open(path).expect("recording");
    let scans = recording.scans().expect("scans");
    scans.map(|scan| scan.expect("scan").sample).collect()
}

fn notes(report: &Value) -> String {
    report["streams"][0]["notes"].to_string()
}

/// Naively every packet of the port went into one cloud; then the second sensor was left out with exit code 0.
#[test]
fn two_lidars_on_one_port_are_two_and_never_make_one_cloud() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    write(path, "one.pcap", &pcap(0..600));
    let second = |n| Frame {
        sender: 202,
        // It looks a quarter of a turn elsewhere.
        ..Frame::udp(n, 2368, data_packet(n + 38))
    };
    let both = (0..600).flat_map(|n| [Frame::udp(n, 2368, data_packet(n)), second(n)]);
    write(path, "both.pcap", &capture(both));
    json(
        path,
        &["scan", "--pcap", "one.pcap", "--out", "one.mcap"],
        0,
    );
    let report = json(
        path,
        &["scan", "--pcap", "both.pcap", "--out", "both.mcap"],
        0,
    );
    assert_eq!(
        scans(&path.join("both.mcap")),
        scans(&path.join("one.mcap"))
    );
    for (index, name, address) in [(0, "lidar", 201), (1, "lidar2", 202)] {
        let stream = &report["streams"][index];
        assert_eq!(stream["name"], name);
        let said = stream["notes"].to_string();
        let what = format!("VLP-32C at 192.168.1.{address}, returns: strongest");
        assert!(said.contains(&what), "{said}");
    }
    let packets = |file: &str, lidar: &str| -> Vec<Vec<u8>> {
        let recording = Recording::open(&path.join(file)).expect("recording");
        let packets = recording.packets(&format!("{lidar}/packets"));
        let packets = packets.expect("packets");
        packets.map(|p| p.expect("packet").packet.bytes).collect()
    };
    let second: Vec<_> = (0..600).map(|n| data_packet(n + 38)).collect();
    assert_eq!(packets("both.mcap", "lidar2"), second);
    // Made again from the recording.
    json(
        path,
        &["scan", "--mcap", "both.mcap", "--out", "again.mcap"],
        0,
    );
    assert_eq!(packets("again.mcap", "lidar2"), second);
    assert_eq!(
        packets("again.mcap", "lidar"),
        packets("both.mcap", "lidar")
    );

    let chosen = ["scan", "--pcap", "both.pcap", "--lidar-sender"];
    let other = ["192.168.1.202", "--out", "other.mcap"];
    let report = json(path, &[&chosen[..], &other].concat(), 0);
    let said = notes(&report);
    assert!(
        said.contains("VLP-32C at 192.168.1.202")
            && said.contains("600 packets of 192.168.1.201 were rejected"),
        "{said}"
    );
    assert_eq!(packets("other.mcap", "lidar"), second);
    let named = [
        "front=192.168.1.201",
        "--lidar-sender",
        "rear=192.168.1.202",
        "--out",
        "named.mcap",
    ];
    json(path, &[&chosen[..], &named].concat(), 0);
    assert_eq!(packets("named.mcap", "rear"), second);
    write(path, "angles.csv", b"channel,elevation,azimuth\n1,0,0\n");
    let one_file = ["--lidar-angles", "angles.csv", "--out", "refused.mcap"];
    let one_file = [&chosen[..], &named[..3], &one_file].concat();
    refused(path, &one_file, &["front, rear", "belongs to one sensor"]);
    let unusable = ["a/b=192.168.1.201", "--out", "refused.mcap"];
    let why = "letters, digits and underscores";
    refused(path, &[&chosen[..], &unusable].concat(), &[why]);
}

/// Naively such a capture gave an empty recording and exit code 0.
#[test]
fn a_capture_without_the_lidar_says_what_is_in_it() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    let ouster = (0..20).map(|n| Frame::udp(n, 7502, vec![1; 24_896]));
    write(path, "ouster.pcap", &capture(ouster));
    let tcp = (0..7).map(|n| Frame {
        protocol: TCP,
        ..Frame::udp(n, 2368, vec![0x50; 40])
    });
    write(path, "tcp.pcap", &capture(tcp));
    let elsewhere = (0..600).map(|n| Frame::udp(n, 2370, data_packet(n)));
    write(path, "elsewhere.pcap", &capture(elsewhere));
    write(path, "nothing.pcap", &capture([]));
    for (name, words) in [
        (
            "ouster.pcap",
            &["20 datagrams of 24896 bytes to port 7502 from 192.168.1.201, looks like Ouster"][..],
        ),
        ("tcp.pcap", &["it has no LiDAR datagrams", "7 TCP segments"]),
        (
            "elsewhere.pcap",
            &[
                "600 datagrams of 1206 bytes to port 2370",
                "looks like Velodyne",
            ],
        ),
        ("nothing.pcap", &["it has no LiDAR datagrams"]),
    ] {
        found_unfit(path, &["scan", "--pcap", name, "--out", "out.mcap"], words);
        assert!(!path.join("out.mcap").exists(), "{name}");
    }
    // As it was called before too.
    for option in ["--lidar-ports", "--lidar-port"] {
        let ports = [option, "2370", "--out", "out.mcap", "--force"];
        let scan = ["scan", "--pcap", "elsewhere.pcap"];
        json(path, &[&scan[..], &ports].concat(), 0);
    }
    assert!(scans(&path.join("out.mcap")).len() > 3);
}

/// On a LiDAR's own port, of another maker: kept as it came, and named.
#[test]
fn another_sensor_on_the_lidars_port_is_named() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    let robosense = (0..20).map(|n| {
        let mut bytes = vec![0; 1248];
        bytes[..4].copy_from_slice(&[0x55, 0xAA, 0x05, 0x0A]);
        Frame::udp(n, 2368, bytes)
    });
    write(path, "robosense.pcap", &capture(robosense));
    let scan = [
        "scan",
        "--pcap",
        "robosense.pcap",
        "--out",
        "robosense.mcap",
    ];
    found_unfit(
        path,
        &scan,
        &[
            "from 20 datagrams",
            "looks like RoboSense",
            "robosense.mcap",
        ],
    );
    let recording = Recording::open(&path.join("robosense.mcap")).expect("recording");
    assert_eq!(recording.packets("lidar").expect("packets").count(), 20);
}

/// Naively each pair counted one packet missing and one unusable, and scans had holes.
#[test]
fn packets_that_overtook_each_other_are_put_back() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    write(path, "whole.pcap", &pcap(0..600));
    let order = (0..600).map(|n| match n % 10 {
        4 => n + 1,
        5 => n - 1,
        _ => n,
    });
    let frames = (0..)
        .zip(order)
        .map(|(at, n)| Frame::udp(at, 2368, data_packet(n)));
    write(path, "swapped.pcap", &capture(frames));
    // Past the window a packet is lost to its scan, and is not called missing.
    let late = (0..600).map(|n| match n {
        100..130 => n + 1,
        130 => 100,
        _ => n,
    });
    let frames = (0..)
        .zip(late)
        .map(|(at, n)| Frame::udp(at, 2368, data_packet(n)));
    write(path, "late.pcap", &capture(frames));
    json(
        path,
        &["scan", "--pcap", "whole.pcap", "--out", "whole.mcap"],
        0,
    );
    let report = json(
        path,
        &["scan", "--pcap", "swapped.pcap", "--out", "swapped.mcap"],
        0,
    );
    assert_eq!(report["lost"], 0, "{report}");
    assert!(
        notes(&report).contains("60 packets arrived out of order"),
        "{report}"
    );
    assert_eq!(
        scans(&path.join("swapped.mcap")),
        scans(&path.join("whole.mcap"))
    );
    let report = json(
        path,
        &["scan", "--pcap", "late.pcap", "--out", "late.mcap"],
        DATA_LOST,
    );
    let lidar = &report["streams"][0];
    assert_eq!(
        (&lidar["missing"], &lidar["reordered"], &report["lost"]),
        (&0.into(), &1.into(), &1.into()),
        "{report}"
    );
    assert!(
        notes(&report).contains("1 packets came too late to be reordered"),
        "{report}"
    );
}

#[test]
fn models_that_are_not_there_are_refused_by_name() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    write(path, "one.pcap", &pcap(0..60));
    for model in ["vlp-16", "xt32", "vlp-32c"] {
        let out = format!("{model}.mcap");
        let scan = [
            "scan",
            "--pcap",
            "one.pcap",
            "--out",
            &out,
            "--lidar-model",
            model,
        ];
        match model {
            "vlp-32c" => drop(json(path, &scan, 0)),
            "vlp-16" => drop(found_unfit(
                path,
                &scan,
                &["VLP-32C, but a VLP-16 is configured"],
            )),
            _ => drop(found_unfit(path, &scan, &["but a XT32 is configured"])),
        }
    }
}

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// The message of that fault advised to force the model, and there was no way to.
#[test]
fn a_sensor_whose_factory_bytes_lie_is_read_by_force() {
    let test = "a_sensor_whose_factory_bytes_lie_is_read_by_force";
    let Some(capture) = recordings(test, "lidar/rust_lidar_utils/velodyne/velodyne_vlp16.pcap")
    else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    let scan = ["scan", "--pcap", text(&capture), "--out"];
    found_unfit(
        path,
        &[&scan[..], &["lies.mcap"]].concat(),
        &["--lidar-model and --force-returns"],
    );
    let force = [
        "forced.mcap",
        "--lidar-model",
        "vlp-16",
        "--force-returns",
        "strongest",
    ];
    let report = json(path, &[&scan[..], &force].concat(), 0);
    assert!(notes(&report).contains("VLP-16"), "{report}");
    assert!(!scans(&path.join("forced.mcap")).is_empty());
}

/// A second vendor: packets from the ROS driver's bags become scans with times, rings and echoes.
#[test]
fn bags_of_hesai_sensors_become_recordings() {
    let test = "bags_of_hesai_sensors_become_recordings";
    let Some(folder) = recordings(test, "lidar/nebula_hesai") else {
        return;
    };
    for (bag, angles, model, packets) in [
        (
            "xt32/1673400677802009732/1673400677802009732_0.db3",
            "PandarXT32.csv",
            "XT32",
            2_000,
        ),
        (
            "64/1673403880599376836/1673403880599376836_0.db3",
            "Pandar64.csv",
            "Pandar64",
            2_400,
        ),
        (
            "qt64/1673401195788312575/1673401195788312575_0.db3",
            "PandarQT64.csv",
            "QT64",
            1_200,
        ),
    ] {
        let (out, bag) = (tempfile::tempdir().expect("folder"), folder.join(bag));
        let angles = folder.join("calibration").join(angles);
        let scan = ["scan", "--db3", text(&bag), "--out", "hesai.mcap"];
        let with_angles = ["--lidar-angles", text(&angles)];
        let report = json(out.path(), &[&scan[..], &with_angles].concat(), 0);
        assert_eq!(report["lost"], 0, "{report}");
        assert!(notes(&report).contains(model), "{report}");
        let path = out.path().join("hesai.mcap");
        let scans = scans(&path);
        assert!((4..=6).contains(&scans.len()), "{model}: {}", scans.len());
        let kinds = [Echo::Both, Echo::Last];
        for kind in kinds {
            assert!(
                scans
                    .iter()
                    .any(|s| s.points.iter().any(|p| p.echo == kind)),
                "{model}"
            );
        }
        let recording = Recording::open(&path).expect("recording");
        assert_eq!(
            recording.packets("lidar/packets").expect("packets").count(),
            packets
        );
        // Made again from the packets alone.
        json(
            out.path(),
            &[
                &["scan", "--mcap", "hesai.mcap", "--out", "again.mcap"][..],
                &with_angles,
            ]
            .concat(),
            0,
        );
        assert_eq!(
            self::scans(&out.path().join("again.mcap")),
            scans,
            "{model}"
        );
    }
}

/// Two sensors at their factory address: the file names one sender, and naively both made one cloud.
#[test]
fn two_lidars_with_one_address_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    let merged = |name: &str, second: &dyn Fn(u64) -> Vec<u8>| {
        let frames = (0..600).flat_map(|n| {
            let own = Frame::udp(n, 2368, data_packet(n));
            [own, Frame::udp(n, 2368, second(n))]
        });
        write(path, name, &capture(frames));
        let merged = ["scan", "--pcap", name, "--out", "merged.mcap"];
        let words = ["packets of two sensors at one address, 192.168.1.201"];
        refused(path, &merged, &words);
        assert!(!path.join("merged.mcap").exists(), "{name}");
    };
    // Switched on 25 ms, and 10 s, before the other.
    merged("before.pcap", &|n| data_packet(n + 38));
    merged("long_before.pcap", &|n| data_packet(n + 15_070));
    // Both on one pulse: as if one sensor sent twice as fast.
    merged("in_step.pcap", &|n| sent_later(data_packet(n), 300));
    // A sensor whose packets go a long way round comes out of turn now and then, and is one.
    let mut order: Vec<u64> = (0..600).collect();
    (0..600).step_by(10).for_each(|n| order.swap(n, n + 3));
    let frames = order.iter().zip(0..);
    let frames = frames.map(|(sent, n)| Frame::udp(n, 2368, data_packet(*sent)));
    write(path, "one.pcap", &capture(frames));
    json(
        path,
        &["scan", "--pcap", "one.pcap", "--out", "one.mcap"],
        0,
    );
}

/// A data packet of that much later, by the sensor's clock.
fn sent_later(packet: Vec<u8>, by_us: u32) -> Vec<u8> {
    let mut packet = DataPacket::new(packet).expect("a data packet");
    let time_us = packet.timestamp_us() + by_us;
    packet.set_timestamp_us(time_us);
    packet.into_inner()
}
