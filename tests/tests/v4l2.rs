//! Mynt cameras behind V4L2 nodes: the driver and the `v4l` crate as they are, above an emulated kernel.
//!
//! Each test writes what its unit shall do into a script, and runs itself again below `lsfb-fakekernel`, where the nodes of
//! those units can be opened.
#![cfg(feature = "hardware")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests, and the one line a skipped test owes its reader"
)]

mod fake_kernel;

use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use lsfb_capture::{
    CameraUnitConfig, CaptureReport, DevicesConfig, Overflow, RecorderConfig, Session,
};
use lsfb_drivers::Error;
use lsfb_drivers::mynt_s::model::TRAILER_BYTES;
use lsfb_drivers::mynt_s::wire::{
    CameraOption, DeviceInfo, ImuProtocol, ImuRequest, ImuSegment, ImuValues, OptionCommand,
    TimeSource, Trailer, Version, XuDevice, emit_frame,
};
use lsfb_drivers::mynt_s::{CameraConfig, Decoder, DecoderConfig, Exposure, MyntCamera, Trigger};
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::camera_link::CameraLink;
use lsfb_drivers::transport::uvc::{FrameFormat, ImageControl, LinkCounters, XuQuery, XuSelector};
use lsfb_recording::Recording;
use lsfb_sim::{Pace, Playback, PlaybackEndpoints, Turns};
use lsfb_types::{no_progress, until};

const CAMERAS: &str = "LSFB_FAKE_CAMERAS";
const FORMAT: FrameFormat = FrameFormat::S2_1280X400;
const RATE_HZ: u32 = 60;
const TIMEOUT: Duration = Duration::from_secs(5);
/// Buffer flag of a damaged frame (`V4L2_BUF_FLAG_ERROR`).
const DAMAGED: u32 = 0x40;

/// What a unit shall do; the layout is that of `tests/fakekernel/src/camera_script.rs`.
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

fn info(serial: &str) -> DeviceInfo {
    DeviceInfo {
        name: "MYNT-EYE-S2100".to_owned(),
        serial: serial.to_owned(),
        spec: Version { major: 1, minor: 3 },
        baseline_mm: 80,
        ..Default::default()
    }
}

/// A unit that tells about itself and has its IMU set to 250 Hz.
fn unit() -> Script {
    unit_with_serial("07C41A19")
}

fn unit_with_serial(serial: &str) -> Script {
    let mut script = Script::default();
    let mut device = XuDevice::new(info(serial), ImuProtocol::Float);
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
    emit_frame(FORMAT, &[&left, &right], &trailer(frame_id), &mut bytes).unwrap();
    bytes
}

fn config(path: PathBuf, serial: &str) -> CameraConfig {
    CameraConfig {
        path,
        serial: serial.to_owned(),
        format: FORMAT,
        rate_hz: RATE_HZ,
        options: vec![(CameraOption::ImuFrequency, 250)],
        ..CameraConfig::default()
    }
}

/// Below the emulated kernel: the paths of the nodes. Above it: `None`, after the test `name` has been run below with
/// units that do what `scripts` say.
fn nodes_below_fake_kernel(
    name: &str,
    scripts: impl FnOnce() -> Vec<Script>,
) -> Option<Vec<PathBuf>> {
    if let Some(cameras) = std::env::var_os(CAMERAS) {
        let cameras = cameras.into_string().unwrap();
        let path = |line: &str| PathBuf::from(line.split('\t').next().unwrap());
        return Some(cameras.lines().map(path).collect());
    }
    if !fake_kernel::is_possible(name) {
        return None;
    }
    let dir = tempfile::tempdir().unwrap();
    let mut cameras = String::new();
    for (i, script) in scripts().into_iter().enumerate() {
        // A name as udev gives it, for a character device.
        let node = dir.path().join(format!("mynt_{i}"));
        symlink("/dev/null", &node).unwrap();
        let file = dir.path().join(format!("script_{i}"));
        std::fs::write(&file, script.0).unwrap();
        cameras += &format!("{}\t{}\n", node.display(), file.display());
    }
    fake_kernel::run_below(name, &[(CAMERAS, cameras)]);
    None
}

/// The same for one unit: its configuration.
fn below_fake_kernel(name: &str, script: impl FnOnce() -> Script) -> Option<CameraConfig> {
    let nodes = nodes_below_fake_kernel(name, || vec![script()])?;
    let node = nodes.into_iter().next()?;
    Some(config(node, "07C41A19"))
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
    assert_eq!(*camera.info(), info("07C41A19"));
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
        for (image, side) in pair.sample.images.iter().zip([0, 0x80]) {
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
            "found unit 07C41A19, but OTHER is configured",
        ),
        (
            CameraConfig {
                options: vec![(CameraOption::ImuFrequency, 9000)],
                ..config.clone()
            },
            "rejected query 0x01 of selector 1",
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
    let mut device = XuDevice::new(info("07C41A19"), ImuProtocol::Float);
    device.set(XuSelector::CamCtrl, &select).unwrap();
    for query in [XuQuery::GetMin, XuQuery::GetMax, XuQuery::GetDef] {
        let expected = device.get(XuSelector::CamCtrl, query).unwrap();
        assert_eq!(link.xu_get(XuSelector::CamCtrl, query).unwrap(), expected);
    }
    let error = link.recv(TIMEOUT).unwrap_err().to_string();
    assert!(error.contains("was not started"), "{error}");
}

#[test]
fn two_units_of_one_trigger_stream_side_by_side() {
    // The second unit powered up 40 triggers later, and its kernel lost one frame.
    const FIRST: [u32; 6] = [0, 1, 2, 3, 4, 5];
    const SECOND: [u32; 5] = [0, 1, 3, 4, 5];
    const AHEAD: u16 = 40;
    let scripts = || {
        let mut first = unit_with_serial("FRONT");
        for sequence in FIRST {
            first.frame(sequence, 0, &frame(AHEAD + sequence as u16));
        }
        let mut second = unit_with_serial("REAR");
        for sequence in SECOND {
            second.frame(sequence, 0, &frame(sequence as u16));
        }
        vec![first, second]
    };
    let name = "two_units_of_one_trigger_stream_side_by_side";
    let Some(nodes) = nodes_below_fake_kernel(name, scripts) else {
        return;
    };
    let mut units = nodes.into_iter().zip(["FRONT", "REAR"]);
    let mut read = |count: usize| {
        let (node, serial) = units.next().unwrap();
        let camera = MyntCamera::open(&config(node, serial)).unwrap();
        (camera, Decoder::new(DecoderConfig::default()), count)
    };
    // Both are open at once; frames are taken in turn.
    let mut open = [read(FIRST.len()), read(SECOND.len())];
    let mut triggers: [Vec<Trigger>; 2] = [Vec::new(), Vec::new()];
    for _ in 0..FIRST.len() {
        for ((camera, decoder, left), seen) in open.iter_mut().zip(&mut triggers) {
            if *left > 0 {
                *left -= 1;
                let packet = camera.recv(TIMEOUT).unwrap().unwrap();
                seen.push(decoder.push(&packet).unwrap().unwrap().sample.trigger);
            }
        }
    }
    let expected = |sequences: &[u32], ahead: u16| -> Vec<Trigger> {
        let index = |sequence: &u32| u64::from(*sequence) + u64::from(ahead);
        let trigger = |sequence| Trigger {
            epoch: 0,
            index: index(sequence),
        };
        sequences.iter().map(trigger).collect()
    };
    assert_eq!(triggers[0], expected(&FIRST, AHEAD));
    assert_eq!(triggers[1], expected(&SECOND, 0));
    assert_eq!(open[0].0.link_counters().missing, 0);
    assert_eq!(open[1].0.link_counters().missing, 1);
}

#[test]
fn manual_exposure_goes_through_the_controls_of_the_node() {
    let mut script = unit();
    let mut device = XuDevice::new(info("07C41A19"), ImuProtocol::Float);
    let option = CameraOption::ExposureMode;
    let set = OptionCommand::Set { option, value: 1 };
    script.write(&mut device, XuSelector::CamCtrl, &set.emit());
    let select = OptionCommand::Select(option).emit();
    script.write(&mut device, XuSelector::CamCtrl, &select);
    script.read(&mut device, XuSelector::CamCtrl, XuQuery::GetCur);
    let name = "manual_exposure_goes_through_the_controls_of_the_node";
    let Some(config) = below_fake_kernel(name, || script) else {
        return;
    };
    let with = |gain| CameraConfig {
        exposure: Exposure::Manual { gain, exposure: 90 },
        ..config.clone()
    };
    let mut camera = MyntCamera::open(&with(24)).unwrap();
    assert_eq!(camera.control(ImageControl::Gain).unwrap(), 24);
    assert_eq!(camera.control(ImageControl::Brightness).unwrap(), 90);
    assert_eq!(camera.option(CameraOption::ExposureMode).unwrap(), 1);
    drop(camera);
    let error = MyntCamera::open(&with(2_000)).unwrap_err().to_string();
    assert!(error.contains("rejected its control Gain"), "{error}");
}

/// A unit that also tells about 20 samples of its IMU, in the protocol of its spec.
fn unit_with_imu(serial: &str, spec: Version) -> Script {
    let protocol = ImuProtocol::of_spec(spec);
    let info = DeviceInfo {
        spec,
        ..info(serial)
    };
    let mut script = Script::default();
    let mut device = XuDevice::new(info, protocol);
    let mut request = vec![0; XuSelector::File.len_bytes()];
    request[0] = DeviceInfo::REQUEST;
    script.write(&mut device, XuSelector::File, &request);
    script.read(&mut device, XuSelector::File, XuQuery::GetCur);
    for serial in 1..=20_u32 {
        let z = serial as i16;
        let values = match (protocol, serial % 2) {
            (ImuProtocol::Integer, 0) => ImuValues::RawGyroscope([0, 0, z]),
            (ImuProtocol::Integer, _) => ImuValues::RawAccelerometer([0, 0, z]),
            (_, 0) => ImuValues::GyroscopeDegS([0.0, 0.0, z.into()]),
            (_, _) => ImuValues::AccelerometerG([0.0, 0.0, z.into()]),
        };
        device.push_imu(ImuSegment {
            serial,
            timestamp_us: trailer(0).timestamp_us + 2_500 * u64::from(serial),
            time_source: TimeSource::External,
            temperature: 30.0,
            values,
        });
    }
    // Protocol 1 is told how far its host has come, protocol 2 gives what is new.
    let requests: &[ImuRequest] = match protocol {
        ImuProtocol::Integer => &[ImuRequest::After(0), ImuRequest::After(20)],
        _ => &[ImuRequest::Single],
    };
    for request in requests {
        script.write(&mut device, XuSelector::ImuWrite, &request.emit());
        script.read(&mut device, XuSelector::ImuRead, XuQuery::GetCur);
    }
    for sequence in 0..FRAMES {
        script.frame(sequence, 0, &frame(sequence as u16));
    }
    script
}

const FRAMES: u32 = 12;
const UNITS: [([&str; 2], &str); 2] = [(["cam0", "cam1"], "imu1"), (["cam2", "cam3"], "imu2")];

/// Records units at `paths` until `images` of them are there, and their IMUs have been asked often.
fn record(paths: &[PathBuf], out: &Path) -> CaptureReport {
    let cameras = paths
        .iter()
        .zip(UNITS)
        .map(|(path, (names, imu))| CameraUnitConfig {
            rate_hz: RATE_HZ,
            imu: Some(imu.to_owned()),
            ..CameraUnitConfig::stereo(path.clone(), names.map(str::to_owned))
        });
    let config = DevicesConfig {
        cameras: cameras.collect(),
        overflow: Overflow::Wait,
        recorder: RecorderConfig {
            least_space_secs: 0.0,
            ..RecorderConfig::default()
        },
        ..DevicesConfig::default()
    };
    let session = Session::open(&config).unwrap();
    let images = session.counts().images;
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let running = std::thread::Builder::new()
            .name("session".to_owned())
            .spawn_scoped(scope, || session.run(out, &until(&stop)).unwrap())
            .unwrap();
        let wanted = u64::from(FRAMES) * 2 * UNITS.len() as u64;
        while images.load(Ordering::Relaxed) < wanted && !running.is_finished() {
            std::thread::sleep(Duration::from_millis(5));
        }
        // Units that stall never end; those that end do so within this.
        let since = Instant::now();
        while !running.is_finished() && since.elapsed() < Duration::from_secs(1) {
            std::thread::sleep(Duration::from_millis(5));
        }
        stop.store(true, Ordering::Relaxed);
        running.join().unwrap()
    })
}

/// Everything that the units said, decoded: images with their counters, and samples.
fn content(path: &Path) -> Vec<String> {
    let recording = Recording::open(path).unwrap();
    let mut lines = Vec::new();
    for (cameras, imu) in UNITS {
        for camera in cameras {
            for image in recording.images(camera).unwrap().map(Result::unwrap) {
                let sum: u64 = image.sample.pixels.iter().map(|p| u64::from(*p)).sum();
                lines.push(format!(
                    "{camera} {} {} {sum}",
                    image.time, image.device_ticks
                ));
            }
        }
        let topic = format!("/{imu}/data_raw");
        for sample in recording.messages(&topic).unwrap().map(Result::unwrap) {
            lines.push(format!("{imu} {} {:?}", sample.time, sample.bytes));
        }
    }
    lines
}

/// Units on V4L2 nodes are recorded, with what their extension units said; a mock plays that, and is recorded alike.
#[test]
fn units_behind_nodes_are_recorded_and_played() {
    let scripts = || {
        vec![
            unit_with_imu("FRONT", Version { major: 1, minor: 2 }),
            unit_with_imu("REAR", Version { major: 1, minor: 3 }),
        ]
    };
    let name = "units_behind_nodes_are_recorded_and_played";
    let Some(nodes) = nodes_below_fake_kernel(name, scripts) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let (first, again) = (
        folder.path().join("first.mcap"),
        folder.path().join("again.mcap"),
    );
    let report = record(&nodes, &first);
    assert_eq!(report.groups.complete, u64::from(FRAMES), "{report:?}");
    let was = content(&first);
    // 10 pairs, of which the last gyroscope segment of each unit has no partner.
    let images = 2 * UNITS.len() * FRAMES as usize;
    assert_eq!(was.len(), images + 2 * 9, "{was:#?}");

    let playback = Playback::open(&first).unwrap();
    assert!(playback.unplayed().is_empty());
    let sockets: Vec<PathBuf> = ["a", "b"].map(|name| folder.path().join(name)).to_vec();
    let endpoints = PlaybackEndpoints {
        camera_sockets: sockets.clone(),
        ..PlaybackEndpoints::nowhere()
    };
    let mock = playback
        .start(&endpoints, Pace::RealTimes(1.0), Turns::Times(1))
        .unwrap();
    let report = record(&sockets, &again);
    let sent = mock.join(&no_progress).unwrap();
    assert_eq!(
        (sent.stereo_frames, sent.unit_imu_segments),
        (2 * u64::from(FRAMES), 40)
    );
    assert_eq!(report.lost, 0, "{report:?}");
    assert_eq!(content(&again), was);
}
