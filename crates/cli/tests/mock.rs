//! Devices in one process, their recorder in another.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use crate::process::lsfb;
use crate::running::{Running, wait_until};
use crate::simulated_session::{Ports, one_rig_at_a_time, recorded, scan, settings, text};
use lsfb_drivers::mynt_s::wire::{ImuProtocol, ImuResponse, ImuSegment};
use lsfb_recording::{LIDAR_POSITION, Recording, TF};
use nix::sys::signal::Signal;

/// Whether no datagram waits in the sockets at these ports of this machine.
fn nothing_waits(ports: &[u16]) -> bool {
    let table = std::fs::read_to_string("/proc/net/udp").expect("sockets");
    let columns = |line: &str| line.split_whitespace().map(str::to_owned).collect();
    let sockets: Vec<Vec<String>> = table.lines().map(columns).collect();
    ports.iter().all(|port| {
        let wanted = format!(":{port:04X}");
        let mut mine = sockets
            .iter()
            .filter(|c| c.get(1).is_some_and(|local| local.ends_with(&wanted)));
        mine.all(|c| c.get(4).is_some_and(|queues| queues.ends_with(":00000000")))
    })
}

/// The recordings made by others.
fn data(test: &str) -> Option<PathBuf> {
    let lidar = lsfb_tests::recordings(test, "lidar")?;
    Some(lidar.parent()?.to_owned())
}

/// What a raw topic holds, in order.
fn packets(path: &Path, source: &str) -> Vec<Vec<u8>> {
    let recording = Recording::open(path).expect("recording");
    let packets = recording.packets(source).expect("topic");
    packets.map(|p| p.expect("packet").packet.bytes).collect()
}

/// What a camera unit's own IMU measured, in order.
fn segments(path: &Path, imu: &str) -> Vec<ImuSegment> {
    let answers = packets(path, imu);
    let parsed = answers.iter().map(|bytes| {
        let answer = ImuResponse::parse(ImuProtocol::Float, bytes);
        answer.expect("an answer of protocol 2").segments
    });
    parsed.flatten().collect()
}

/// What must be the same in a recording of a mock: everything but when it arrived.
fn content(path: &Path) -> Vec<String> {
    let recording = Recording::open(path).expect("recording");
    let mut lines = Vec::new();
    for topic in recording.topics() {
        // The stream of a serial line is cut wherever it was read, and the frames of the rig are stamped like the message
        // that happened to come first. What the recorder says itself is about its own session.
        let own = ["/health/", "/sync/"]
            .iter()
            .any(|t| topic.topic.starts_with(t))
            || topic.topic.ends_with("/session");
        // Answers to polls are cut wherever their host asked.
        let cut = topic.topic.starts_with("/raw/imu");
        if own || cut || topic.topic.ends_with("tf_static") {
            continue;
        }
        let mut line = format!("{} {} {}", topic.topic, topic.schema, topic.messages);
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        for message in recording.messages(&topic.topic).expect("topic") {
            let message = message.expect("message");
            // Each packet of a revolution carries its arrival.
            let bytes = match topic.topic.as_str() {
                "/lidar/packets" => Vec::new(),
                _ => message.bytes,
            };
            for byte in message.time.nanos().to_le_bytes().iter().chain(&bytes) {
                hash = (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
            }
        }
        let _ = write!(line, " {hash:016x}");
        lines.push(line);
    }
    lines
}

#[test]
fn a_mock_of_a_recording_gives_the_same_recording() {
    let _alone = one_rig_at_a_time();
    let recorded = recorded(5);
    for (source, rate) in [("scan.mcap", "1"), ("walk.mcap", "2")] {
        let folder = tempfile::tempdir().expect("folder");
        let source = recorded.join(source);
        let ports = Ports::free().arguments();
        let arguments = ["mock", text(&source), "--out", "mock", "--speed", rate];
        let arguments = arguments.into_iter().map(str::to_owned).chain(ports);
        let mut mock = Running::lsfb(folder.path(), arguments);
        mock.wait_for("devices.toml");
        scan(folder.path(), "mock/devices.toml", "again.mcap");
        assert_eq!(mock.wait().code(), Some(0), "{}", mock.said());
        let again = folder.path().join("again.mcap");
        let (was, is) = (content(&source), content(&again));
        assert!(was.len() >= 3, "{was:?}");
        assert_eq!(was, is);
        if source.ends_with("scan.mcap") {
            for raw in ["lidar/packets", LIDAR_POSITION] {
                assert!(packets(&source, raw) == packets(&again, raw), "{raw}");
            }
            let stream = |path: &Path| packets(path, "imu0").concat();
            assert!(stream(&source) == stream(&again), "imu0");
            for imu in ["imu1", "imu2"] {
                let (was, is) = (segments(&source, imu), segments(&again, imu));
                assert!(was.len() > 1_000, "{imu}: {}", was.len());
                assert!(was == is, "{imu}");
            }
            let units = |path: &Path| {
                Recording::open(path)
                    .and_then(|recording| recording.camera_units())
                    .expect("units")
            };
            assert_eq!(units(&source), units(&again));
            assert_eq!(units(&source).len(), 2);
            for file in ["unit/cam0/1.bin", "unit/cam2/1.bin"] {
                let kept = |path: &Path| {
                    let recording = Recording::open(path).expect("recording");
                    recording.attachment(file).expect("device information")
                };
                assert_eq!(kept(&source), kept(&again), "{file}");
            }
            let rig = |path: &Path| {
                Recording::open(path)
                    .expect("recording")
                    .rig()
                    .expect("rig")
            };
            assert_eq!(rig(&source), rig(&again));
        }
    }
}

/// What another program's viewer needs: where the rig was, at the very stamps of the clouds, below the frames of the sensors.
#[test]
fn a_recording_with_odometry_shows_a_moving_rig() {
    let _alone = one_rig_at_a_time();
    let source = recorded(5).join("scan.mcap");
    let folder = tempfile::tempdir().expect("folder");
    let ports = Ports::free().arguments();
    let arguments = ["mock", text(&source), "--out", "mock"].map(str::to_owned);
    let mut mock = Running::lsfb(folder.path(), arguments.into_iter().chain(ports));
    mock.wait_for("devices.toml");
    let arguments = ["--devices", "mock/devices.toml", "--out", "again.mcap"];
    let scan = [&["scan", "--odometry", "--json"][..], &arguments].concat();
    let output = lsfb(folder.path(), &scan);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let live = &report["live_odometry"];
    let latency = |share: &str| live[share].as_f64().expect("a latency");
    let [p50_ms, p99_ms] = [latency("latency_p50_ms"), latency("latency_p99_ms")];
    assert!(0.0 < p50_ms && p50_ms <= p99_ms, "{live}");
    // Nobody looks, and so nothing looks for loops.
    assert!(live.get("loops").is_none(), "{live}");
    // What was skipped on a busy machine is counted.
    let counts = ["registered", "lost", "skipped_scans"].map(|of| live[of].as_u64());
    let [Some(registered), Some(lost), Some(skipped)] = counts else {
        panic!("counts: {live}")
    };
    assert_eq!(mock.wait().code(), Some(0), "{}", mock.said());
    let recording = Recording::open(&folder.path().join("again.mcap")).expect("recording");
    let clouds = recording.scans().expect("scans");
    let clouds: Vec<_> = clouds.map(|scan| scan.expect("scan").time).collect();
    let poses = recording.messages(TF).expect("poses");
    let poses: Vec<_> = poses.map(|pose| pose.expect("pose")).collect();
    let known = registered + lost + skipped;
    assert!(registered > 0 && known <= clouds.len() as u64, "{live}");
    // The odometry needs the first scan, and a busy machine leaves some out.
    assert!(
        poses.len() > clouds.len() / 4,
        "{} of {}",
        poses.len(),
        clouds.len()
    );
    for pair in poses.windows(2) {
        assert!(pair[0].time < pair[1].time && pair[0].bytes != pair[1].bytes);
    }
    assert!(poses.iter().all(|pose| clouds.contains(&pose.time)));
}

#[test]
fn a_mock_of_a_capture_file_gives_every_packet_at_its_rate() {
    let _alone = one_rig_at_a_time();
    let test = "a_mock_of_a_capture_file_gives_every_packet_at_its_rate";
    let Some(data) = data(test) else {
        return;
    };
    for (below, turns, positions) in [
        (
            "lidar/nebula_velodyne/vlp32/1713492677464078412_0.db3",
            1,
            0,
        ),
        ("lidar/mrpt/sample_velodyne_vlp16_gps.pcap", 2, 57),
        (
            "lidar/nebula_hesai/xt32/1673400677802009732/1673400677802009732_0.db3",
            1,
            0,
        ),
    ] {
        let source = data.join(below);
        let folder = tempfile::tempdir().expect("folder");
        let reference = folder.path().join("reference.mcap");
        let flag = match source.extension() {
            Some(ending) if ending == "db3" => "--db3",
            _ => "--pcap",
        };
        lsfb(
            folder.path(),
            &["scan", flag, text(&source), "--out", "reference.mcap"],
        );
        let ports = Ports::free();
        let turns_text = turns.to_string();
        let arguments = [
            "mock",
            text(&source),
            "--out",
            "mock",
            "--loop",
            &turns_text,
        ];
        let arguments = arguments.into_iter().map(str::to_owned);
        let mut mock = Running::lsfb(folder.path(), arguments.chain(ports.arguments()));
        mock.wait_for("devices.toml");
        let arguments = [
            "scan",
            "--devices",
            "mock/devices.toml",
            "--out",
            "again.mcap",
        ];
        let mut scan = Running::lsfb(folder.path(), arguments.map(str::to_owned));
        assert_eq!(mock.wait().code(), Some(0), "{}", mock.said());
        wait_until("the recorder has taken everything", || {
            nothing_waits(&ports.0)
        });
        scan.signal(Signal::SIGINT);
        // A clock that starts anew with each turn is reported; nothing is lost.
        assert!(scan.wait().code().is_some(), "{}", scan.said());
        let again = folder.path().join("again.mcap");
        let once = packets(&reference, "lidar/packets");
        assert!(once.len() > 200);
        let expected: Vec<_> = (0..turns).flat_map(|_| once.clone()).collect();
        assert!(packets(&again, "lidar/packets") == expected, "{below}");
        if positions > 0 {
            let found = packets(&again, LIDAR_POSITION);
            assert_eq!(found.len(), turns * positions, "{below}");
        }
    }
}

#[test]
fn a_puck_with_two_returns_and_a_microstrain_unit_are_recorded_too() {
    let _alone = one_rig_at_a_time();
    let folder = tempfile::tempdir().expect("folder");
    std::fs::write(folder.path().join("tiny.toml"), settings(3)).expect("settings");
    let arguments = [
        "sim",
        "--out",
        "sim",
        "--config",
        "tiny.toml",
        "--lidar-model",
        "vlp-16",
        "--returns",
        "dual",
        "--imu-family",
        "microstrain",
    ];
    let arguments = arguments.map(str::to_owned).into_iter();
    let ports = Ports::free().arguments();
    let mut sim = Running::lsfb(folder.path(), arguments.chain(ports));
    sim.wait_for("backpack-devices.toml");
    scan(folder.path(), "sim/backpack-devices.toml", "scan.mcap");
    sim.signal(Signal::SIGINT);
    sim.wait();
    let path = folder.path().join("scan.mcap");
    // Three seconds: a packet every 663.552 µs, return mode and product at their end; and a sample every 5 ms.
    let lidar = packets(&path, "lidar/packets");
    assert_eq!(lidar.len(), 4521);
    assert!(lidar.iter().all(|p| p.ends_with(&[0x39, 0x22])));
    assert!(
        packets(&path, "imu0")
            .concat()
            .starts_with(&[0x75, 0x65, 0x80])
    );
    let recording = Recording::open(&path).expect("recording");
    let samples = recording.imu().expect("samples").filter_map(Result::ok);
    assert_eq!(samples.count(), 601);
    assert!(
        recording
            .scans()
            .expect("scans")
            .filter_map(Result::ok)
            .count()
            >= 28
    );
}

#[test]
fn a_mock_of_a_microstrain_unit_sends_its_stream_again() {
    let _alone = one_rig_at_a_time();
    let folder = tempfile::tempdir().expect("folder");
    std::fs::write(folder.path().join("tiny.toml"), settings(2)).expect("settings");
    let arguments =
        "sim --out sim --config tiny.toml --imu-family microstrain --record --clocks ideal";
    let arguments: Vec<&str> = arguments.split(' ').collect();
    let output = lsfb(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let arguments = ["mock", "sim/scan.mcap", "--out", "mock"].map(str::to_owned);
    let ports = Ports::free().arguments();
    let mut mock = Running::lsfb(folder.path(), arguments.into_iter().chain(ports));
    mock.wait_for("devices.toml");
    scan(folder.path(), "mock/devices.toml", "again.mcap");
    assert_eq!(mock.wait().code(), Some(0), "{}", mock.said());
    let stream = |path: &str| packets(&folder.path().join(path), "imu0").concat();
    let again = stream("again.mcap");
    assert!(again.starts_with(&[0x75, 0x65, 0x80]) && again == stream("sim/scan.mcap"));
}

#[test]
fn sources_that_hold_nothing_to_play_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    std::fs::write(folder.path().join("empty.pcap"), b"").expect("file");
    for (arguments, reason) in [
        (&["mock", "missing.mcap", "--out", "m"][..], "missing.mcap"),
        (&["mock", "empty.pcap", "--out", "m"], "empty.pcap"),
        (
            &["mock", "a.mcap", "--out", "m", "--speed", "0"],
            "positive",
        ),
        (&["mock", "--out", "m"], "<SOURCE>"),
        (
            &[
                "mock",
                "a.mcap",
                "--out",
                "m",
                "--imu-family",
                "microstrain",
            ],
            "cannot be used with",
        ),
    ] {
        let output = lsfb(folder.path(), arguments);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success(), "{arguments:?}");
        assert!(errors.contains(reason), "{arguments:?}: {errors}");
    }
}
