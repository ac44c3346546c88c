//! What a session says about itself while it runs, and devices that go and come back.

use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use lsfb_capture::health::{DeviceHealth, Level, Snapshot, SyncState};
use lsfb_drivers::sidecar::ClientConfig;
use lsfb_drivers::transport::http::{HttpListener, HttpRequest};
use lsfb_drivers::velodyne::settings::{SensorInfo, SensorStatus, Settings, Switch};
use lsfb_drivers::velodyne::wire::{PpsStatus, Returns};
use lsfb_drivers::velodyne::{SensorWeb, SettingsHandling};
use lsfb_recording::message::{decode_clock_model, decode_health_value};
use lsfb_recording::{CLOCK_MODELS, HEALTH};

use super::*;

/// However busy the machine is, what is waited for comes before this.
const PATIENCE: Duration = Duration::from_secs(60);

/// Waits until something has happened.
pub(super) fn wait_until(what: &str, mut happened: impl FnMut() -> bool) {
    let began = Instant::now();
    while !happened() {
        assert!(began.elapsed() < PATIENCE, "in vain: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Runs a session until `enough` has happened.
pub(super) fn run_until(
    session: Session,
    out: &Path,
    enough: impl FnMut() -> bool,
) -> CaptureReport {
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let running = std::thread::Builder::new()
            .name("session".to_owned())
            .spawn_scoped(scope, || session.run(out, &until(&stop)).unwrap())
            .unwrap();
        wait_until("enough of the session", enough);
        stop.store(true, Ordering::Release);
        running.join().unwrap()
    })
}

#[test]
fn health_is_told_and_recorded_and_the_units_own_imu_too() {
    let folder = tempfile::tempdir().unwrap();
    let front = folder.path().join("front");
    let camera = mock::stereo_unit(&front, 0, None, Farewell::Sudden);
    let imu = mock::imu(None, &[]);
    let with_imu = CameraUnitConfig {
        imu: Some("imu1".to_owned()),
        ..unit(&front, ["cam0", "cam1"])
    };
    let config = DevicesConfig {
        lidars: vec![lidar()],
        cameras: vec![with_imu],
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let feed = session.health();
    let snapshots = feed.subscribe();
    // Nobody reads this one: it misses some, and nobody waits for it.
    let _unread = feed.subscribe();
    let lidar = mock::send_lidar(
        &session.lidar_addresses(),
        &session.counts(),
        1_000_000,
        Duration::from_micros(663),
    );
    let out = folder.path().join("scan.mcap");
    let counts = session.counts();
    let mut told: Vec<Snapshot> = Vec::new();
    let report = run_until(session, &out, || {
        told.extend(snapshots.try_iter());
        let at_work = |device: &DeviceHealth| {
            device.received > 10 && device.sync == SyncState::Locked && device.rate_hz > 5.0
        };
        // 5 pairs of the unit's own IMU come with a frame of two images.
        counts.images.load(Ordering::Relaxed) > 2 * 12
            && told.len() >= 5
            && told.last().is_some_and(|s| s.devices.iter().all(at_work))
    });
    drop((camera, imu, lidar));

    let late = told.last().unwrap();
    let names: Vec<&str> = late.devices.iter().map(|d| d.name.as_str()).collect();
    assert_eq!(names, ["lidar", "cam0+cam1", "imu0"]);
    assert!(
        late.devices.iter().all(|device| device.connected),
        "{late:?}"
    );
    assert_eq!(late.devices[1].exposure_ms, Some(5.0));
    assert!(late.storage.free_bytes > 0 && late.storage.part_number == 1);
    assert!(late.storage.secs_to_full.is_some(), "{:?}", late.storage);

    let recording = Recording::open(&out).unwrap();
    for quantity in [
        "rate",
        "gap",
        "drops",
        "duplicates",
        "sync",
        "exposure",
        "saturation",
        "temperature",
        "space",
    ] {
        let topic = format!("{HEALTH}{quantity}");
        let values: Vec<_> = recording
            .messages(&topic)
            .unwrap()
            .map(|m| decode_health_value(&m.unwrap().bytes).unwrap())
            .collect();
        assert!(values.len() >= 4, "{topic}: {values:?}");
    }
    for device in ["lidar", "cam0", "cam1", "imu0", "imu1"] {
        let topic = format!("{CLOCK_MODELS}{device}");
        let last = recording.last_message(&topic).unwrap().unwrap();
        let model = decode_clock_model(&last.bytes).unwrap();
        assert_eq!(
            (model.device.as_str(), model.kind.as_str()),
            (device, "locked")
        );
    }
    // The unit's own IMU: 50 pairs a second, on the unit's clock, and the answers as they came.
    let topic = "/imu1/data_raw";
    let own: Vec<_> = recording
        .messages(topic)
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert!(own.len() > 40, "{}: {report:?}", own.len());
    assert!(own.windows(2).all(|w| w[1].time - w[0].time == 20_000_000));
    assert_eq!((own[0].time.nanos() - START_NS) % 10_000_000, 0);
    assert!(recording.packets("imu1").unwrap().count() > 8);
    // The rig's IMU is still the one that is meant.
    assert_eq!(
        recording.imu().unwrap().count() as u64,
        stream(&report, "imu0").decoded
    );
}

fn spawn_collector(snapshots: std::sync::mpsc::Receiver<Snapshot>) -> JoinHandle<Vec<Snapshot>> {
    mock::spawn("page", move || snapshots.iter().collect())
}

#[test]
fn a_unit_that_is_unplugged_and_comes_back_goes_on_and_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let front = folder.path().join("front");
    let first = mock::stereo_unit(&front, 0, Some(10), Farewell::Sudden);
    let again = mock::stereo_unit_after(Duration::from_millis(700), front.clone(), 40, 20);
    let imu = mock::imu(None, &[]);
    let config = DevicesConfig {
        cameras: vec![unit(&front, ["cam0", "cam1"])],
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let told = spawn_collector(session.health().subscribe());
    let out = folder.path().join("scan.mcap");
    let images = session.counts().images;
    let mut gone_by_itself = None;
    let report = run_until(session, &out, || {
        // The goodbye lies behind the last frame.
        let all = again.is_finished() && images.load(Ordering::Relaxed) == 60;
        let since = all.then(|| *gone_by_itself.get_or_insert_with(Instant::now));
        since.is_some_and(|since| since.elapsed() > Duration::from_secs(1))
    });
    first.join().unwrap();
    again.join().unwrap();
    let camera = stream(&report, "cam0+cam1");
    assert_eq!(camera.interruptions, 1, "{report:?}");
    assert_eq!((camera.decoded, camera.missing), (60, 30), "{camera:?}");
    assert_eq!(camera.ending, Ending::EndOfStream);
    assert!(
        camera.notes.iter().any(|n| n.contains("disconnected for")),
        "{camera:?}"
    );
    assert!(report.lost >= 31);
    let gone = told
        .join()
        .unwrap()
        .iter()
        .any(|s| s.level == Level::Error && s.devices[0].problem.contains("disconnected"));
    assert!(gone, "the operator is told");
    let recording = Recording::open(&out).unwrap();
    assert_eq!(recording.images("cam1").unwrap().count(), 30);
}

/// What is acknowledged is in the file: an app may forget it, and a kill at this moment costs nothing.
#[test]
fn a_sidecar_is_acknowledged_when_its_message_is_in_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("walk.mcap");
    let config = DevicesConfig {
        sidecar: Some(mock::sidecar(folder.path())),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let invited = mock::invited(&session, folder.path());
    let recording = {
        let out = out.clone();
        mock::spawn("session", move || run(session, &out))
    };
    let mut client = mock::visor(ClientConfig {
        // Each message waits until the one before it is acknowledged.
        window_messages: 1,
        ..invited
    });
    for n in 0..8_u32 {
        mock::send_note(&mut client, n);
        if n > 0 {
            let torn = folder.path().join("torn.mcap");
            std::fs::copy(&out, &torn).unwrap();
            let torn = Recording::open(&torn).unwrap();
            let stored = torn.messages("/sidecar/visor/note").unwrap().count();
            assert!(
                stored >= n as usize,
                "{stored} of {n} that are acknowledged"
            );
        }
    }
    client.bye().unwrap();
    let report = recording.join().unwrap();
    assert_eq!((stream(&report, "sidecar").decoded, report.lost), (8, 0));
}

/// A sensor's web page, until it is dropped.
struct Page {
    sensor: Arc<Mutex<SensorWeb>>,
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Page {
    fn serve() -> Self {
        let listener = HttpListener::bind(LOOPBACK).unwrap();
        let address = listener.address();
        let info = SensorInfo {
            model: "VLP-32C".to_owned(),
            serial: "11001170750012".to_owned(),
        };
        let status = SensorStatus {
            pps: PpsStatus::Locked,
            motor: Switch::On,
            motor_rpm: 600,
            laser: Switch::On,
        };
        let sensor = Arc::new(Mutex::new(SensorWeb::new(info, status)));
        let stop = Arc::new(AtomicBool::new(false));
        let (served, stopped) = (Arc::clone(&sensor), Arc::clone(&stop));
        let thread = mock::spawn("mock-velodyne-page", move || {
            while !stopped.load(Ordering::Relaxed) {
                let answer = |request: &HttpRequest| served.lock().unwrap().handle(request);
                listener.serve(Duration::from_millis(20), answer).unwrap();
            }
        });
        Self {
            sensor,
            address,
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[test]
fn the_lidar_is_set_as_asked_before_it_is_recorded_and_a_refusal_is_found_out() {
    let page = Page::serve();
    let folder = tempfile::tempdir().unwrap();
    let list = folder.path().join("devices.toml");
    let text = format!(
        "[lidar]\ndata = \"127.0.0.1:0\"\nposition = \"127.0.0.1:0\"\n[lidar.settings]\npage = \"{}\"\nrpm = 1200\n\
         returns = \"dual\"\nfield_of_view_deg = [270, 90]\nphase_lock_centideg = 18000\n",
        page.address
    );
    std::fs::write(&list, &text).unwrap();
    let config = DevicesConfig::read(&list).unwrap();
    Session::open(&config).unwrap();
    let set = *page.sensor.lock().unwrap().settings();
    assert_eq!((set.rpm, set.returns), (1200, Returns::Dual));
    let sector = set.field_of_view;
    assert_eq!((sector.start_deg, sector.end_deg), (270, 90));
    assert_eq!(set.phase_lock.lock, Switch::On);
    assert_eq!(set.phase_lock.offset_centideg, 18_000);
    // Where it sends was not asked for.
    assert_eq!(set.destination, Settings::default().destination);

    let refused = |config: &DevicesConfig| Session::open(config).err().unwrap().to_string();
    let mut other = config.clone();
    let settings = other.lidars.first_mut().and_then(|l| l.settings.as_mut());
    settings.unwrap().rpm = Some(900);
    page.sensor
        .lock()
        .unwrap()
        .set_handling(SettingsHandling::Ignores);
    let error = refused(&other);
    assert!(
        error.contains("was set to rpm=900 but reads rpm=1200"),
        "{error}"
    );
    let settings = other.lidars.first_mut().and_then(|l| l.settings.as_mut());
    settings.unwrap().rpm = Some(910);
    let error = refused(&other);
    assert!(
        error.contains("lidar.settings.rpm is 910: it must be a multiple of 60"),
        "{error}"
    );
}
