//! Recordings of the twin whose devices run on quartz clocks of their own: what `lsfb clock` makes of them against how the
//! clocks really ran, and what `lsfb doctor` says. The truth is opened here as `eval` opens it, by no estimator.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::{Path, PathBuf};

use lsfb_capture::clock::{ClockConfig, DeviceClock, Unwrap, estimate_clocks};
use lsfb_capture::doctor::{DoctorConfig, examine};
use lsfb_capture::{
    CameraUnitConfig, DevicesConfig, ImuFamily, ImuLineConfig, Incoming, LidarNetConfig,
    RecorderConfig, SidecarConfig, record_incoming,
};
use lsfb_recording::message::decode_time_reference;
use lsfb_recording::{Existing, Recording};
use lsfb_sim::{
    ClockConfig as DeviceClockConfig, ClockJump, Clocked, ClocksConfig, Discipline, Emitted,
    LinkConfig, SimConfig, Simulation,
};
use lsfb_types::{Verdict, no_progress};

/// 5 ms to either side, silences of 45 ms, as asked of the estimate.
fn rough(drift_ppm: f64, jumps: Vec<ClockJump>) -> DeviceClockConfig {
    DeviceClockConfig {
        discipline: Discipline::Free,
        start_s: 77.7,
        drift_ppm,
        jumps,
        link: LinkConfig {
            delay_s: 2e-3,
            jitter_s: 5e-3,
            batch: 1,
            stall_s: 45e-3,
            stall_every_s: 6.0,
        },
        ..DeviceClockConfig::default()
    }
}

/// The demo's rooms with images of a few pixels.
fn coarse() -> SimConfig {
    let mut config = SimConfig::tiny();
    config.texel_m = 0.05;
    for cameras in [&mut config.scan_cameras, &mut config.glasses_cameras] {
        (cameras.width, cameras.height) = (32, 16);
    }
    config
}

fn devices() -> DevicesConfig {
    DevicesConfig {
        recorder: RecorderConfig {
            existing: Existing::Replace,
            least_space_secs: 0.0,
            ..RecorderConfig::default()
        },
        ..DevicesConfig::default()
    }
}

/// All devices of a simulated backpack.
fn backpack(simulation: &Simulation, folder: &Path) -> DevicesConfig {
    let rig = folder.join("backpack.toml");
    std::fs::write(&rig, simulation.scan().rig().to_toml()).unwrap();
    let unit = |names: [&str; 2]| CameraUnitConfig {
        frame_px: [64, 16],
        ..CameraUnitConfig::stereo(PathBuf::new(), names.map(str::to_owned))
    };
    DevicesConfig {
        rig: Some(rig),
        lidars: vec![LidarNetConfig::default()],
        cameras: vec![unit(["cam0", "cam1"]), unit(["cam2", "cam3"])],
        imus: vec![imu_line()],
        ..devices()
    }
}

fn imu_line() -> ImuLineConfig {
    ImuLineConfig {
        name: "imu0".to_owned(),
        family: ImuFamily::Xsens,
        path: PathBuf::new(),
        baud: 921_600,
        rate_hz: 200,
    }
}

fn record(
    emitted: impl Iterator<Item = Result<Emitted, lsfb_sim::Error>>,
    devices: &DevicesConfig,
    out: &Path,
) -> Recording {
    let incoming = emitted.map(|item| match item.unwrap() {
        Emitted::Lidar(packet) => Incoming::Lidar { lidar: 0, packet },
        Emitted::Imu(packet) => Incoming::Imu { imu: 0, packet },
        Emitted::Frame { unit, packet } => Incoming::Frame { unit, packet },
        Emitted::Sidecar { arrival, message } => Incoming::Sidecar { arrival, message },
    });
    let report = record_incoming(incoming, devices, out, &no_progress).unwrap();
    assert_eq!(report.lost, 0, "{report:?}");
    Recording::open(out).unwrap()
}

/// How a clock really ran: true time and count.
struct Truth(Vec<(i64, i64)>);

impl Truth {
    fn read(path: &Path, device: &str) -> Self {
        let text = std::fs::read_to_string(path).unwrap();
        let rows = text.lines().filter_map(|line| {
            let mut columns = line.split(',');
            (columns.next() == Some(device)).then(|| {
                let mut next = || columns.next().unwrap().parse::<i64>().unwrap();
                (next(), next())
            })
        });
        Self(rows.collect())
    }

    /// True time at a count, nanoseconds.
    fn time_ns(&self, device_ns: i64) -> f64 {
        let after = self.0.partition_point(|(_, count)| *count <= device_ns);
        let after = after.clamp(1, self.0.len() - 1);
        let ((t0, c0), (t1, c1)) = (self.0[after - 1], self.0[after]);
        t0 as f64 + (device_ns - c0) as f64 * (t1 - t0) as f64 / (c1 - c0) as f64
    }

    /// Host seconds per device second less one between two true times, parts per million.
    fn skew_ppm(&self, from_ns: i64, to_ns: i64) -> f64 {
        let row = |time_ns: i64| self.0[self.0.partition_point(|(t, _)| *t < time_ns)];
        let (a, b) = (row(from_ns), row(to_ns));
        ((b.0 - a.0) as f64 / (b.1 - a.1) as f64 - 1.0) * 1e6
    }
}

/// The largest error of the offset between the estimate and the truth, after the constant delay, microseconds.
fn largest_error_us(
    recording: &Recording,
    clock: &DeviceClock,
    counts_ns: &[i64],
    truth: &Truth,
    delay_s: f64,
) -> f64 {
    let start = recording.arrival_range().unwrap().start;
    let stride = counts_ns.len().div_ceil(4_000);
    assert_eq!(clock.samples.len(), counts_ns.len().div_ceil(stride));
    let errors = clock.samples.iter().zip(counts_ns.iter().step_by(stride));
    errors
        .map(|(sample, count_ns)| {
            let estimated_s = sample.secs - sample.delay_ms * 1e-3;
            let true_s = (truth.time_ns(*count_ns) - start.nanos() as f64) * 1e-9;
            1e6 * (estimated_s - true_s - delay_s)
        })
        .fold(0.0, |most, error: f64| most.max(error.abs()))
}

fn counts(recording: &Recording, topic: &str, tick_ns: i64, period: i64) -> Vec<i64> {
    let mut unwrap = Unwrap::default();
    recording
        .messages(topic)
        .unwrap()
        .map(|message| {
            let reference = decode_time_reference(&message.unwrap().bytes).unwrap();
            let ticks = reference.device_ticks.cast_signed();
            match period {
                0 => ticks * tick_ns,
                period => unwrap.unwrap(ticks, period) * tick_ns,
            }
        })
        .collect()
}

#[test]
fn the_clock_of_an_imu_is_told_from_its_recording_step_included() {
    let mut config = coarse();
    config.scan.duration_s = 600.0;
    let step = ClockJump {
        at_s: 300.0,
        by_s: 1.0,
    };
    config.clocks.scan_imu = rough(50.0, vec![step]);
    let simulation = Simulation::new(&config, &no_progress).unwrap();
    let dir = tempfile::tempdir().unwrap();
    simulation.write_truth(dir.path()).unwrap();
    let devices = DevicesConfig {
        imus: vec![imu_line()],
        ..devices()
    };
    let emitted = simulation.emit_scan(&[Clocked::Imu]);
    let recording = record(emitted, &devices, &dir.path().join("scan.mcap"));
    let truth = Truth::read(&dir.path().join("truth_scan_clocks.csv"), "imu0");

    let report = estimate_clocks(&recording, &ClockConfig::default(), &no_progress).unwrap();
    let clock = report.devices.iter().find(|d| d.device == "imu0").unwrap();
    assert!(!clock.locked);
    let begin_ns = simulation.scan().start().nanos();
    let [first, second] = &clock.epochs[..] else {
        panic!("{:?}", clock.epochs);
    };
    let stepped_ns = begin_ns + 300_000_000_000;
    for (epoch, from_ns, to_ns) in [
        (first, begin_ns, stepped_ns - 1),
        (second, stepped_ns, begin_ns + 600_000_000_000),
    ] {
        let skew_ppm = truth.skew_ppm(from_ns, to_ns);
        assert!((skew_ppm + 50.0).abs() < 0.01);
        let error = epoch.skew_ppm - skew_ppm;
        assert!(error.abs() < 0.1, "{error} ppm, {epoch:?}");
        assert!(
            error.abs() < 4.0 * epoch.sigma_skew_ppm,
            "{error} {epoch:?}"
        );
    }
    // Found with the first sample after it; its size is known but for one delay.
    let late_ns = second.arrival_start_ns - stepped_ns;
    assert!((2_000_000..70_000_000).contains(&late_ns), "{late_ns}");
    let size_s = second.step_ns as f64 * 1e-9;
    assert!((-1.0..-0.93).contains(&size_s), "{size_s}");

    let counts_ns = counts(&recording, "/imu0/time_ref", 100_000, 1 << 32);
    let error = largest_error_us(&recording, clock, &counts_ns, &truth, 2e-3);
    assert!(error < 50.0, "{error}");
    tell("imu, +50 ppm, step of 1 s", clock, error);
}

#[test]
fn the_clock_of_a_phone_is_told_from_what_it_sends() {
    let mut config = coarse();
    config.glasses.duration_s = 240.0;
    config.glasses_cameras.rate_hz = 1;
    config.ble.report_hz = 0.0;
    config.clocks.walker = rough(-50.0, Vec::new());
    let simulation = Simulation::new(&config, &no_progress).unwrap();
    let dir = tempfile::tempdir().unwrap();
    simulation.write_truth(dir.path()).unwrap();
    let devices = DevicesConfig {
        sidecar: Some(SidecarConfig::new(
            ([127, 0, 0, 1], 0).into(),
            "sidecar".into(),
        )),
        ..devices()
    };
    let recording = record(
        simulation.emit_walk(),
        &devices,
        &dir.path().join("walk.mcap"),
    );
    let truth = Truth::read(&dir.path().join("truth_walk_clocks.csv"), "glasses");
    let report = estimate_clocks(&recording, &ClockConfig::default(), &no_progress).unwrap();
    let begin_ns = simulation.glasses().start().nanos();
    let skew_ppm = truth.skew_ppm(begin_ns, begin_ns + 240_000_000_000);
    for topic in ["imu", "mag"] {
        let name = format!("sidecar/glasses/{topic}");
        let clock = report.devices.iter().find(|d| d.device == name).unwrap();
        assert_eq!(clock.epochs.len(), 1, "{:?}", clock.epochs);
        let error_ppm = clock.epochs[0].skew_ppm - skew_ppm;
        assert!(error_ppm.abs() < 0.1, "{topic}: {error_ppm}");
        let counts_ns = counts(&recording, &format!("/{name}/device_time"), 1, 0);
        let error = largest_error_us(&recording, clock, &counts_ns, &truth, 2e-3);
        assert!(error < 50.0, "{topic}: {error}");
        tell(topic, clock, error);
    }
    let told = |name: &str| report.devices.iter().any(|d| d.device.ends_with(name));
    assert!(told("/image") && !told("/wifi") && !told("/gnss"));
    // Networks are heard seconds before they arrive; their stamps are those of when they were heard.
    let mut readings = 0;
    for (reading, count_ns) in recording.wifi(None).unwrap().zip(counts(
        &recording,
        "/sidecar/glasses/wifi/device_time",
        1,
        0,
    )) {
        let reading = reading.unwrap();
        let error_s = (reading.time.nanos() as f64 - truth.time_ns(count_ns)) * 1e-9 - 2e-3;
        assert!(error_s.abs() < 2e-3, "{error_s}");
        readings += 1;
    }
    assert!(readings > 10);
}

#[test]
fn lidar_and_cameras_are_told_within_their_deviations() {
    let mut config = coarse();
    config.scan.duration_s = 12.0;
    config.clocks = ClocksConfig::quartz();
    for unit in [
        &mut config.clocks.front_cameras,
        &mut config.clocks.rear_cameras,
    ] {
        // Late, in pairs, with silences: no image is missing from its group all the same.
        unit.link = LinkConfig {
            batch: 2,
            ..rough(0.0, Vec::new()).link
        };
    }
    let simulation = Simulation::new(&config, &no_progress).unwrap();
    let dir = tempfile::tempdir().unwrap();
    simulation.write_truth(dir.path()).unwrap();
    let devices = backpack(&simulation, dir.path());
    let emitted = simulation.emit_scan(&Clocked::SCAN);
    let recording = record(emitted, &devices, &dir.path().join("scan.mcap"));
    let report = estimate_clocks(&recording, &ClockConfig::default(), &no_progress).unwrap();
    let begin_ns = simulation.scan().start().nanos();
    // The IMU's ticks of 0.1 ms hide its 8 ppm for as long as this: it has ten minutes above.
    for (device, of) in [
        ("lidar", "lidar"),
        ("cam0", "cam0+cam1"),
        ("cam3", "cam2+cam3"),
    ] {
        let truth = Truth::read(&dir.path().join("truth_scan_clocks.csv"), of);
        let skew_ppm = truth.skew_ppm(begin_ns, begin_ns + 12_000_000_000);
        let clock = report.devices.iter().find(|d| d.device == device).unwrap();
        assert_eq!(clock.epochs.len(), 1);
        let (error, sigma) = (
            clock.epochs[0].skew_ppm - skew_ppm,
            clock.epochs[0].sigma_skew_ppm,
        );
        assert!(error.abs() < 4.0 * sigma, "{device}: {error} ± {sigma}");
        // The LiDAR's packets are many, and hardly late.
        assert!(device != "lidar" || sigma < 0.2, "{sigma}");
    }
}

/// For docs/figures.md; nothing unless asked.
fn tell(what: &str, clock: &DeviceClock, error_us: f64) {
    if std::env::var_os("LSFB_FIGURES").is_some() {
        let skews: Vec<f64> = clock.epochs.iter().map(|e| e.skew_ppm).collect();
        #[allow(clippy::print_stderr, reason = "figures are asked for")]
        {
            eprintln!("{what}: skew {skews:?} ppm, largest error of the offset {error_us:.1} µs");
        }
    }
}

#[test]
fn the_doctor_lists_what_is_around_and_finds_nothing_wrong() {
    let mut config = coarse();
    config.scan.duration_s = 3.0;
    config.glasses.duration_s = 15.0;
    let simulation = Simulation::new(&config, &no_progress).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let scan = backpack(&simulation, dir.path());
    let walk = DevicesConfig {
        sidecar: Some(SidecarConfig::new(
            ([127, 0, 0, 1], 0).into(),
            "sidecar".into(),
        )),
        ..devices()
    };
    let scan = record(
        simulation.emit_scan(&Clocked::SCAN),
        &scan,
        &dir.path().join("scan.mcap"),
    );
    let walk = record(simulation.emit_walk(), &walk, &dir.path().join("walk.mcap"));
    for recording in [&scan, &walk] {
        let diagnosis = examine(recording, &DoctorConfig::default(), &no_progress).unwrap();
        assert_eq!(
            diagnosis.judgement.verdict(),
            Verdict::Pass,
            "{:#?}",
            diagnosis.judgement.findings()
        );
    }
    let diagnosis = examine(&walk, &DoctorConfig::default(), &no_progress).unwrap();
    for name in ["mag", "pressure", "gnss", "wifi", "ble"] {
        let topic = format!("/sidecar/glasses/{name}");
        let listed = diagnosis
            .judgement
            .findings()
            .iter()
            .any(|f| f.subject == topic);
        assert!(listed, "{topic}: {:#?}", diagnosis.judgement.findings());
    }
    // Stamps that name the time themselves are those of the truth.
    for (sample, expected) in walk.magnetic(None).unwrap().zip(0_i64..) {
        let offset_ns = sample.unwrap().time - simulation.glasses().start();
        assert_eq!(offset_ns, (2 * expected + 1) * 5_000_000);
    }
    assert_eq!(walk.gnss(None).unwrap().count(), 16);
    assert!(walk.pressure(None).unwrap().count() > 290);
    assert!(walk.ble(None).unwrap().count() > 15);
}
