//! Mynt cameras behind V4L2 nodes: the driver and the `v4l` crate as they are, above an emulated kernel.
//!
//! Each test writes what its unit shall do into a script, and runs itself again below `lsfb-fakev4l`, where the node of
//! that unit can be opened.
#![cfg(feature = "hardware")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests, and the one line a skipped test owes its reader"
)]

use std::os::unix::fs::symlink;
use std::path::PathBuf;
use std::process::Command;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use lsfb_drivers::Error;
use lsfb_drivers::camera::model::{FrameFormat, TRAILER_BYTES};
use lsfb_drivers::camera::wire::{
    CameraOption, DeviceInfo, ImuProtocol, OptionCommand, TimeSource, Trailer, Version, XuDevice,
    XuQuery, XuSelector, emit_frame,
};
use lsfb_drivers::camera::{CameraConfig, Decoder, DecoderConfig, MyntCamera};
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::camera_link::{CameraLink, LinkCounters};
use lsfb_tests::workspace_root;
use serde_json::Value;

const NODE: &str = "LSFB_FAKEV4L_NODE";
const SCRIPT: &str = "LSFB_FAKEV4L_SCRIPT";
const FORMAT: FrameFormat = FrameFormat::S2_1280X400;
const RATE_HZ: u32 = 60;
const TIMEOUT: Duration = Duration::from_secs(5);
/// Buffer flag of a damaged frame (`V4L2_BUF_FLAG_ERROR`).
const DAMAGED: u32 = 0x40;

/// What a unit shall do; the layout is that of `tests/fakev4l/src/script.rs`.
#[derive(Default)]
struct Script(Vec<u8>);

impl Script {
    fn record(&mut self, kind: u8, selector: u8, query: u8, body: &[u8]) {
        self.0.extend([kind, selector, query, 0]);
        self.0.extend((body.len() as u32).to_le_bytes());
        self.0.extend(body);
    }

    fn frame(&mut self, sequence: u32, flags: u32, bytes: &[u8]) {
        let mut body = [sequence, flags].map(u32::to_le_bytes).concat();
        body.extend(bytes);
        self.record(1, 0, 0, &body);
    }

    /// A write that `device` takes.
    fn write(&mut self, device: &mut XuDevice, selector: XuSelector, bytes: &[u8]) {
        device.set(selector, bytes).unwrap();
        self.record(2, selector.id(), 0, bytes);
    }

    /// A read after the write above, answered by `device`.
    fn read(&mut self, device: &mut XuDevice, selector: XuSelector, query: XuQuery) {
        let answer = device.get(selector, query).unwrap();
        self.record(3, selector.id(), query.code(), &answer);
    }

    fn unplug(&mut self) {
        self.record(4, 0, 0, &[]);
    }
}

fn info() -> DeviceInfo {
    DeviceInfo {
        name: "MYNT-EYE-S2100".to_owned(),
        serial: "07C41A19".to_owned(),
        spec: Version { major: 1, minor: 3 },
        baseline_mm: 80,
        ..Default::default()
    }
}

/// A unit that tells about itself and has its IMU set to 250 Hz.
fn unit() -> Script {
    let mut script = Script::default();
    let mut device = XuDevice::new(info(), ImuProtocol::Float);
    let mut request = vec![0; XuSelector::File.len_bytes()];
    request[0] = DeviceInfo::REQUEST;
    script.write(&mut device, XuSelector::File, &request);
    script.read(&mut device, XuSelector::File, XuQuery::GetCur);
    let option = CameraOption::ImuFrequency;
    let set = OptionCommand::Set { option, value: 250 };
    script.write(&mut device, XuSelector::CamCtrl, &set.emit());
    let select = OptionCommand::Select(option).emit();
    script.write(&mut device, XuSelector::CamCtrl, &select);
    for query in [
        XuQuery::GetCur,
        XuQuery::GetMin,
        XuQuery::GetMax,
        XuQuery::GetDef,
    ] {
        script.read(&mut device, XuSelector::CamCtrl, query);
    }
    script
}

fn trailer(frame_id: u16) -> Trailer {
    let trailer = Trailer {
        time_source: TimeSource::External,
        frame_id,
        timestamp_us: 1_772_359_200_000_000 + 16_667 * u64::from(frame_id),
        exposure_steps: 40,
        ..Default::default()
    };
    trailer.with_checksum()
}

/// Pixels of the left or right image: each frame, each side and each row has its own.
fn pixels(frame_id: u16, side: u8) -> Vec<u8> {
    (0..640 * 400u32)
        .map(|i| (i % 251) as u8 ^ (i / 640) as u8 ^ frame_id as u8 ^ side)
        .collect()
}

fn frame(frame_id: u16) -> Vec<u8> {
    let mut bytes = Vec::new();
    let (left, right) = (pixels(frame_id, 0), pixels(frame_id, 0x80));
    emit_frame(FORMAT, &left, &right, &trailer(frame_id), &mut bytes).unwrap();
    bytes
}

/// Builds the emulated kernel.
fn fake_kernel() -> PathBuf {
    let output = Command::new(env!("CARGO"))
        .args(["build", "--release", "--offline", "-p", "lsfb-fakev4l"])
        .arg("--message-format=json")
        .current_dir(workspace_root())
        .output()
        .expect("cargo runs");
    let messages = String::from_utf8_lossy(&output.stdout);
    let failed = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{failed}");
    let file = messages
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter(|message| message["target"]["name"] == "lsfb_fakev4l")
        .find_map(|message| message["filenames"][0].as_str().map(PathBuf::from));
    file.expect("a library")
}

/// Below the emulated kernel: the configuration of the node. Above it: `None`, after the test `name` has been run below
/// with a unit that does what `script` says.
fn below_fake_kernel(name: &str, script: impl FnOnce() -> Script) -> Option<CameraConfig> {
    if let Some(path) = std::env::var_os(NODE) {
        return Some(CameraConfig {
            path: path.into(),
            serial: "07C41A19".to_owned(),
            format: FORMAT,
            rate_hz: RATE_HZ,
            options: vec![(CameraOption::ImuFrequency, 250)],
        });
    }
    if !cfg!(target_arch = "x86_64") {
        println!("skipped: {name}: the emulated kernel is for x86_64");
        return None;
    }
    let dir = tempfile::tempdir().unwrap();
    // A name as udev gives it, for a character device.
    let node = dir.path().join("mynt_front");
    symlink("/dev/null", &node).unwrap();
    let file = dir.path().join("script");
    std::fs::write(&file, script().0).unwrap();
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", name, "--nocapture"])
        .env("LD_PRELOAD", fake_kernel())
        .env(NODE, node)
        .env(SCRIPT, file)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    let failed = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}{failed}");
    assert!(said.contains("1 passed"), "{said}");
    None
}

fn host_now_ns() -> i64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    now.as_nanos() as i64
}

#[test]
fn a_unit_is_configured_streams_and_stalls() {
    // Two frames are lost by the kernel, one comes in part.
    const SEQUENCES: [u32; 12] = [0, 1, 2, 3, 4, 7, 8, 9, 10, 11, 12, 13];
    const IN_PART: usize = 8;
    let script = || {
        let mut script = unit();
        for (i, sequence) in SEQUENCES.into_iter().enumerate() {
            let bytes = frame(sequence as u16);
            if i == IN_PART {
                script.frame(sequence, DAMAGED, &bytes[..bytes.len() / 2]);
            } else {
                script.frame(sequence, 0, &bytes);
            }
        }
        script
    };
    let name = "a_unit_is_configured_streams_and_stalls";
    let Some(config) = below_fake_kernel(name, script) else {
        return;
    };

    let before_ns = host_now_ns();
    let mut camera = MyntCamera::open(&config).unwrap();
    assert_eq!(*camera.info(), info());
    let mut decoder = Decoder::new(DecoderConfig::default());
    let mut arrivals_us = Vec::new();
    for (i, sequence) in SEQUENCES.into_iter().enumerate() {
        let packet = camera.recv(TIMEOUT).unwrap().unwrap();
        assert!((before_ns..=host_now_ns()).contains(&packet.arrival.nanos()));
        arrivals_us.push(packet.arrival.nanos() / 1000);
        if i == IN_PART {
            assert_eq!(packet.bytes.len(), FORMAT.frame_bytes() / 2);
            decoder.push(&packet).unwrap_err();
            continue;
        }
        let frame_id = sequence as u16;
        assert_eq!(packet.bytes, frame(frame_id));
        assert_eq!(Trailer::parse(&packet.bytes).unwrap(), trailer(frame_id));
        let pair = decoder.push(&packet).unwrap().unwrap();
        assert_eq!(pair.arrival, packet.arrival);
        assert_eq!(pair.device_ticks, trailer(frame_id).timestamp_us);
        assert_eq!(pair.sample.time_source, TimeSource::External);
        for (image, side) in [(&pair.sample.left, 0), (&pair.sample.right, 0x80)] {
            assert_eq!((image.width, image.height), (640, 400));
            assert_eq!(image.frame_id, sequence);
            assert_eq!(image.exposure_ns, 4_000_000);
            let expected = pixels(frame_id, side);
            let whole = expected.len() - TRAILER_BYTES / 2;
            assert_eq!(image.pixels[..whole], expected[..whole]);
        }
    }
    // The kernel's stamps, two intervals longer over the gap; each is cut to whole microseconds.
    for i in 1..SEQUENCES.len() {
        let expected_us = i64::from(SEQUENCES[i] - SEQUENCES[0]) * 1_000_000 / i64::from(RATE_HZ);
        let got_us = arrivals_us[i] - arrivals_us[0];
        assert!((got_us - expected_us).abs() <= 2, "{i}: {got_us}");
    }
    let expected = LinkCounters {
        frames: 12,
        missing: 2,
        damaged: 1,
    };
    assert_eq!(camera.link_counters(), expected);
    assert_eq!(
        (decoder.counters().frames, decoder.counters().missing),
        (11, 3)
    );

    // Transactions go on while the stream stalls, and so does waiting.
    for _ in 0..3 {
        let begin = Instant::now();
        assert_eq!(camera.recv(Duration::from_millis(30)).unwrap(), None);
        assert!(begin.elapsed() >= Duration::from_millis(30));
        assert_eq!(camera.option(CameraOption::ImuFrequency).unwrap(), 250);
    }
}

#[test]
fn an_unplugged_unit_is_lost_and_stays_lost() {
    let script = || {
        let mut script = unit();
        for sequence in 0..3 {
            script.frame(sequence, 0, &frame(sequence as u16));
        }
        script.unplug();
        script
    };
    let name = "an_unplugged_unit_is_lost_and_stays_lost";
    let Some(config) = below_fake_kernel(name, script) else {
        return;
    };
    let mut camera = MyntCamera::open(&config).unwrap();
    for _ in 0..3 {
        camera.recv(TIMEOUT).unwrap().unwrap();
    }
    for _ in 0..2 {
        let error = camera.recv(TIMEOUT).unwrap_err();
        assert!(matches!(error, Error::Lost { .. }), "{error}");
        let error = camera.option(CameraOption::ImuFrequency).unwrap_err();
        assert!(matches!(error, Error::Lost { .. }), "{error}");
    }
}

#[test]
fn what_the_unit_does_not_have_is_refused() {
    let name = "what_the_unit_does_not_have_is_refused";
    let Some(config) = below_fake_kernel(name, unit) else {
        return;
    };
    let open = |change: CameraConfig| MyntCamera::open(&change).unwrap_err().to_string();
    for (change, expected) in [
        (
            CameraConfig {
                format: FrameFormat {
                    width: 1504,
                    height: 480,
                },
                ..config.clone()
            },
            "asked for 1504x480 YUYV, the unit gives 1280x400 YUYV",
        ),
        (
            CameraConfig {
                rate_hz: 25,
                ..config.clone()
            },
            "asked for 25 Hz, the unit gives 10/1 Hz",
        ),
        (
            CameraConfig {
                serial: "OTHER".to_owned(),
                ..config.clone()
            },
            "unit 07C41A19 is here where OTHER is configured",
        ),
        (
            CameraConfig {
                options: vec![(CameraOption::ImuFrequency, 9000)],
                ..config.clone()
            },
            "refuses query 0x01 of selector 1",
        ),
    ] {
        let error = open(change);
        assert!(error.contains(expected), "{error}");
    }

    // What the configuration does not ask for: the range of an option.
    let mut link = CameraLink::open(&config.path).unwrap();
    let option = CameraOption::ImuFrequency;
    let select = OptionCommand::Select(option).emit();
    link.xu_set(XuSelector::CamCtrl, &select).unwrap();
    let mut device = XuDevice::new(info(), ImuProtocol::Float);
    device.set(XuSelector::CamCtrl, &select).unwrap();
    for query in [XuQuery::GetMin, XuQuery::GetMax, XuQuery::GetDef] {
        let expected = device.get(XuSelector::CamCtrl, query).unwrap();
        assert_eq!(link.xu_get(XuSelector::CamCtrl, query).unwrap(), expected);
    }
    let error = link.recv(TIMEOUT).unwrap_err().to_string();
    assert!(error.contains("was not started"), "{error}");
}
