//! A LiDAR whose clock is set while it is recorded: by whole seconds above all, as a wrong sentence sets it.

use lsfb_capture::clock::{ClockConfig, estimate_clocks};
use lsfb_capture::doctor::{Depth, DoctorConfig, examine};
use lsfb_capture::{Incoming, record_incoming};
use lsfb_drivers::mynt_s::wire::{TimeSource, Trailer, emit_frame};
use lsfb_drivers::transport::uvc::FrameFormat;
use lsfb_drivers::velodyne::wire::{DataPacket, PositionPacket, PpsStatus};
use lsfb_recording::CLOCK_MODELS;
use lsfb_recording::message::decode_clock_model;
use lsfb_types::Verdict;

use super::*;

const PACKETS: u64 = 3_000;
const STEP_AT: u64 = 1_500;
/// A packet of a VLP-32C with one return, nanoseconds.
const PERIOD_NS: u64 = 663_552;
const STEPS_US: [i64; 7] = [
    -1_000_000, 1_000_000, -999_000, 999_000, -1_001_000, -2_000_000, 3_000_000,
];

/// Time past the hour of packet `n`, microseconds; ten seconds past it begins.
fn counted_us(n: u64, step_us: i64) -> u32 {
    let true_us = 10_000_000 + (n * PERIOD_NS / 1_000).cast_signed();
    let stepped_us = if n < STEP_AT { 0 } else { step_us };
    u32::try_from(true_us + stepped_us).unwrap()
}

fn arrival(n: u64) -> Timestamp {
    // Half a millisecond on the way, and a little disorder of the host's.
    let late_ns = 500_000 + (n * 7_919 % 101) * 1_000;
    Timestamp::from_nanos(START_NS + 10_000_000_000 + (n * PERIOD_NS + late_ns).cast_signed())
}

/// Records packets of a LiDAR whose clock steps, with or without a pulse.
fn recorded(out: &Path, step_us: i64, locked: bool) -> (CaptureReport, Recording) {
    record_counters(out, |n| {
        let pps = locked.then_some(PpsStatus::Locked);
        (counted_us(n, step_us), pps)
    })
}

/// Records packets of a LiDAR that has such a counter in packet `n`, microseconds, and says so of its pulse, if it says anything.
fn record_counters(
    out: &Path,
    counter: impl Fn(u64) -> (u32, Option<PpsStatus>),
) -> (CaptureReport, Recording) {
    let packets = (0..PACKETS).flat_map(|n| {
        let (counted, pps) = counter(n);
        let mut data = DataPacket::new(mock::lidar_packet(n)).unwrap();
        data.set_timestamp_us(counted);
        let position = pps.filter(|_| n % 14 == 0).map(|pps| {
            let mut position = PositionPacket::new(mock::position_packet(counted)).unwrap();
            position.set_pps_status(pps);
            position.into_inner()
        });
        let bytes = position.into_iter().chain([data.into_inner()]);
        bytes.map(move |bytes| Incoming::Lidar {
            lidar: 0,
            packet: Packet {
                arrival: arrival(n),
                bytes,
            },
        })
    });
    let config = DevicesConfig {
        lidars: vec![LidarNetConfig::default()],
        ..anywhere()
    };
    let report = record_incoming(packets, &config, out, &no_progress).unwrap();
    (report, Recording::open(out).unwrap())
}

fn assert_told(report: &CaptureReport, recording: &Recording, step_us: i64) {
    // Nothing is lost, and the step is told once, in the report, by the doctor and in the model of the clock.
    assert_eq!(report.lost, 0, "{step_us}: {report:?}");
    let lidar = stream(report, "lidar");
    let told = "1 jumps of the sensor's clock";
    assert!(
        lidar.notes.iter().any(|n| n == told),
        "{step_us}: {lidar:?}"
    );
    let packets = recording.packets("lidar/packets").unwrap();
    assert_eq!(packets.count() as u64, PACKETS);
    let model = recording.last_message(&format!("{CLOCK_MODELS}lidar"));
    let model = decode_clock_model(&model.unwrap().unwrap().bytes).unwrap();
    assert_eq!(model.epoch, 2, "{step_us}: {model:?}");
    let diagnosis = examine(recording, &DoctorConfig::default(), &no_progress).unwrap();
    let clock = diagnosis
        .judgement
        .findings()
        .iter()
        .find(|f| f.subject == "clock lidar");
    assert_eq!(
        clock.unwrap().verdict,
        Verdict::Warn,
        "{step_us}: {clock:?}"
    );

    // Afterwards it is found again: its size, and the very packet.
    let clocks = estimate_clocks(recording, &ClockConfig::default(), &no_progress).unwrap();
    let [first, second] = &clocks.devices[0].epochs[..] else {
        panic!("{step_us}: {:?}", clocks.devices[0].epochs);
    };
    assert_eq!(first.pairs, STEP_AT);
    assert_eq!(
        second.arrival_start_ns,
        arrival(STEP_AT).nanos(),
        "{step_us}"
    );
    let size_error_ns = second.step_ns + step_us * 1_000;
    assert!(size_error_ns.abs() < 200_000, "{step_us}: {size_error_ns}");
}

#[test]
fn a_lidar_without_pulse_keeps_the_hosts_time_over_every_step() {
    let folder = tempfile::tempdir().unwrap();
    for (k, step_us) in STEPS_US.into_iter().enumerate() {
        let out = folder.path().join(format!("{k}.mcap"));
        let (report, recording) = recorded(&out, step_us, false);
        assert_told(&report, &recording, step_us);
        for scan in recording.scans().unwrap() {
            let scan = scan.unwrap();
            let late_ns = scan.arrival - scan.time;
            assert!(late_ns.abs() < 2_000_000, "{step_us}: {late_ns}");
        }
    }
}

#[test]
fn a_locked_lidar_is_believed_and_its_steps_are_told() {
    let folder = tempfile::tempdir().unwrap();
    for (k, step_us) in STEPS_US.into_iter().enumerate() {
        let out = folder.path().join(format!("{k}.mcap"));
        let (report, recording) = recorded(&out, step_us, true);
        assert_told(&report, &recording, step_us);
        let mut scans = 0;
        for scan in recording.scans().unwrap() {
            let scan = scan.unwrap();
            // The sensor names the second: what it names stays.
            let named = Timestamp::from_nanos(START_NS + scan.device_ticks.cast_signed());
            assert_eq!(scan.time, named, "{step_us}");
            scans += 1;
        }
        assert!(scans >= 20, "{step_us}: {scans}");
    }
}

/// Its stamps were those of the second that its counter had been locked to: wrong by what the restart took, and "within a microsecond".
#[test]
fn a_lidar_that_is_restarted_is_locked_no_more() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scan.mcap");
    let (report, recording) = record_counters(&out, |n| {
        let restarted = n >= STEP_AT;
        let (since, begun_us, pps) = match restarted {
            true => (STEP_AT, 0, PpsStatus::Absent),
            false => (0, 10_000_000, PpsStatus::Locked),
        };
        let counted_us = begun_us + (n - since) * PERIOD_NS / 1_000;
        (u32::try_from(counted_us).unwrap(), Some(pps))
    });
    let lidar = stream(&report, "lidar");
    for told in ["1 losses of the PPS lock", "1 jumps of the sensor's clock"] {
        assert!(lidar.notes.iter().any(|n| n == told), "{lidar:?}");
    }
    for scan in recording.scans().unwrap() {
        let scan = scan.unwrap();
        let late_ns = scan.arrival - scan.time;
        assert!(late_ns.abs() < 2_000_000, "{late_ns}");
    }
    let model = recording.last_message(&format!("{CLOCK_MODELS}lidar"));
    let model = decode_clock_model(&model.unwrap().unwrap().bytes).unwrap();
    assert_eq!((&*model.kind, model.epoch), ("fitted", 2));
    let diagnosis = examine(&recording, &DoctorConfig::default(), &no_progress).unwrap();
    let finding = |code| {
        diagnosis
            .judgement
            .findings()
            .iter()
            .find(move |f| f.code == code)
    };
    assert_eq!(finding("clock-changes").unwrap().verdict, Verdict::Warn);
    let clocks = estimate_clocks(&recording, &ClockConfig::default(), &no_progress).unwrap();
    assert_eq!(clocks.devices[0].mode_changes, 1);
}

/// The recorder stamped by arrival until the pulse came, and this machine's clock was 0.4 s off: both the doctor and the clocks passed.
#[test]
fn a_lidar_that_locks_to_another_time_on_the_way_does_not_pass() {
    let folder = tempfile::tempdir().unwrap();
    for (name, off_us, verdict) in [("same", 0, Verdict::Warn), ("off", 400_000, Verdict::Fail)] {
        let out = folder.path().join(format!("{name}.mcap"));
        let (_, recording) = record_counters(&out, |n| {
            let (begun_us, pps) = match n >= STEP_AT {
                true => (10_000_000 + off_us, PpsStatus::Locked),
                false => (900_000_000, PpsStatus::Absent),
            };
            let counted_us = begun_us + n * PERIOD_NS / 1_000;
            (u32::try_from(counted_us).unwrap(), Some(pps))
        });
        for read in [Depth::Indexes, Depth::Everything] {
            let config = DoctorConfig {
                read,
                ..DoctorConfig::default()
            };
            let diagnosis = examine(&recording, &config, &no_progress).unwrap();
            let mut findings = diagnosis.judgement.findings().iter();
            let found = findings.find(|f| f.code == "clock-changes").unwrap();
            assert_eq!(found.verdict, verdict, "{name}: {found:?}");
        }
        let clocks = estimate_clocks(&recording, &ClockConfig::default(), &no_progress).unwrap();
        let judgement = clocks.judgement();
        let mut findings = judgement.findings().iter();
        let found = findings.find(|f| f.code == "recorded-stamps").unwrap();
        let expected = match verdict {
            Verdict::Warn => Verdict::Pass,
            other => other,
        };
        assert_eq!(found.verdict, expected, "{name}: {found:?}");
    }
}

#[test]
fn a_device_that_names_an_impossible_year_does_not_end_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scan.mcap");
    let frame = |n: u16, timestamp_us: u64| {
        let trailer = Trailer {
            time_source: TimeSource::External,
            frame_id: n,
            timestamp_us,
            exposure_steps: 10,
            checksum: 0,
        }
        .with_checksum();
        let format = FrameFormat {
            width: 64,
            height: 4,
        };
        let mut bytes = Vec::new();
        emit_frame(format, &[&[7; 128], &[9; 128]], &trailer, &mut bytes).unwrap();
        let arrival = Timestamp::from_nanos(START_NS + i64::from(n) * CAMERA_PERIOD_NS);
        let packet = Packet { arrival, bytes };
        Incoming::Frame { unit: 0, packet }
    };
    let time_us = |n: u16| ((START_NS + i64::from(n) * CAMERA_PERIOD_NS) / 1_000).cast_unsigned();
    // The year 2065, and nothing at all.
    let frames = (0..20).map(|n| match n {
        7 => frame(n, 3_000_000_000_000_000),
        12 => frame(n, u64::MAX),
        _ => frame(n, time_us(n)),
    });
    let config = DevicesConfig {
        cameras: vec![CameraUnitConfig {
            frame_px: [64, 4],
            ..unit(Path::new(""), ["cam0", "cam1"])
        }],
        ..anywhere()
    };
    let report = record_incoming(frames, &config, &out, &no_progress).unwrap();
    assert_eq!(report.failure, None);
    let camera = stream(&report, "cam0+cam1");
    assert!(camera.bad > 0 && report.lost > 0, "{camera:?}");
    let why = camera.first_bad.clone().unwrap_or_default();
    assert!(why.contains("which a recording cannot hold"), "{why}");
    let recording = Recording::open(&out).unwrap();
    let images: Vec<_> = recording
        .images("cam1")
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert_eq!(images.len(), 20);
    for (n, image) in (0..).zip(&images) {
        assert_eq!(image.arrival.nanos(), START_NS + n * CAMERA_PERIOD_NS);
        assert!((image.time - image.arrival).abs() < CAMERA_PERIOD_NS, "{n}");
    }
}
