//! Sensor Logger pushes to a rig: each reading once and in order, whatever the network does; nobody else is let in.

use std::fmt::Write as _;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;

use lsfb_capture::{PairingFolder, SidecarConfig};
use lsfb_drivers::sidecar::credentials::to_hex;
use lsfb_drivers::sidecar::sensor_logger::PushUnits;
use lsfb_recording::message::decode_vector;

use super::*;

/// Readings of each motion sensor in a batch: 200 ms.
const IN_BATCH: u64 = 20;

/// A batch as the app's PUSHING.md has it: 100 Hz, the phone at rest on its back.
fn batch(number: u64, z: &str) -> String {
    let mut readings = String::new();
    for n in 0..IN_BATCH {
        let time = 1_698_501_144_000_000_000 + (number * IN_BATCH + n) * 10_000_000;
        let _ = write!(
            readings,
            r#"{{"name":"accelerometeruncalibrated","time":{time},"values":{{"z":{z},"y":0.0,"x":0.0}}}},
               {{"name":"gyroscope","time":{},"values":{{"z":{n},"y":0.0,"x":{number}}}}},"#,
            time + 4_000_000
        );
    }
    let wifi = r#"{"name":"wifi","time":1698501144000000000,"values":{"ssid":"hall","bssid":"ac:de:48:00:11:22","frequency":5180,"level":-58}}"#;
    let battery = r#"{"name":"battery","time":1698501144000000000,"values":{"batteryLevel":0.5}}"#;
    format!(
        r#"{{"messageId":{number},"sessionId":"6d2f 1","deviceId":"b7","payload":[{readings}{wifi},{battery}]}}"#
    )
}

/// Status of a POST, and what is said.
fn post(rig: SocketAddr, path: &str, header: &str, body: &str) -> (u16, String) {
    let mut tcp = TcpStream::connect(rig).unwrap();
    let length = body.len();
    write!(
        tcp,
        "POST {path} HTTP/1.1\r\nHost: rig\r\nContent-Type: application/json\r\n{header}Connection: close\r\nContent-Length: {length}\r\n\r\n{body}"
    )
    .unwrap();
    let mut said = String::new();
    tcp.read_to_string(&mut said).unwrap();
    let status = said.split(' ').nth(1).and_then(|code| code.parse().ok());
    (status.unwrap_or(0), said)
}

/// A session that apps push to, paired in a folder.
fn pushed_to(folder: &Path) -> Session {
    let config = DevicesConfig {
        sidecar: Some(SidecarConfig {
            push_listen: Some(LOOPBACK),
            ..mock::sidecar(folder)
        }),
        ..anywhere()
    };
    Session::open(&config).unwrap()
}

/// After ten seconds out of reach a session began anew, and what its app had numbered meanwhile was not missed.
#[test]
fn batches_of_an_app_that_was_out_of_reach_are_missed() {
    let folder = tempfile::tempdir().unwrap();
    let session = pushed_to(folder.path());
    let rig = session.push_address().unwrap();
    let pairing = PairingFolder::open(&folder.path().join("sidecar")).unwrap();
    let key = to_hex(&pairing.invite_pusher("ada", PushUnits::Standard).unwrap().0);
    let path = format!("/v1/push/ada/{key}");
    let out = folder.path().join("walk.mcap");
    let stop = AtomicBool::new(false);
    let report = std::thread::scope(|scope| {
        let running = std::thread::Builder::new()
            .name("session".to_owned())
            .spawn_scoped(scope, || session.run(&out, &until(&stop)).unwrap())
            .unwrap();
        let push = |number| post(rig, &path, "", &batch(number, "9.81")).0;
        live::wait_until("it records", || push(0) == 200);
        for number in 1..10 {
            assert_eq!(push(number), 200);
        }
        std::thread::sleep(Duration::from_millis(10_800));
        assert_eq!(push(9), 200, "stored before");
        assert_eq!(push(60), 202, "waits for those before it");
        std::thread::sleep(Duration::from_millis(2_600));
        assert_eq!(push(61), 200);
        stop.store(true, Ordering::Relaxed);
        running.join().unwrap()
    });
    let phones = stream(&report, "sidecar");
    assert_eq!((phones.missing, phones.bad), (50, 0), "{phones:?}");
    assert!(report.lost >= 50, "{report:?}");
    let recording = Recording::open(&out).unwrap();
    let turns = recording.messages("/sidecar/ada/gyro_calibrated").unwrap();
    assert_eq!(turns.count() as u64, 12 * IN_BATCH);
}

#[test]
fn what_sensor_logger_pushes_is_recorded_once_in_order_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let session = pushed_to(folder.path());
    let rig = session.push_address().unwrap();
    let pairing = PairingFolder::open(&folder.path().join("sidecar")).unwrap();
    let key_of = |name: &str, units| to_hex(&pairing.invite_pusher(name, units).unwrap().0);
    let [ada, bob] = ["ada", "bob"].map(|name| key_of(name, PushUnits::Standard));
    let path = format!("/v1/push/ada/{ada}");
    let out = folder.path().join("walk.mcap");
    let stop = AtomicBool::new(false);
    let report = std::thread::scope(|scope| {
        let running = std::thread::Builder::new()
            .name("session".to_owned())
            .spawn_scoped(scope, || session.run(&out, &until(&stop)).unwrap())
            .unwrap();
        let push = |number| post(rig, &path, "", &batch(number, "9.81")).0;
        live::wait_until("it records", || push(0) == 200);
        // Overtaken on the way, and repeated.
        assert_eq!(push(2), 202);
        assert_eq!(push(1), 200);
        assert_eq!((push(1), push(2)), (200, 200));
        let header = format!("Authorization: Bearer {ada}\r\n");
        assert_eq!(post(rig, "/v1/push/ada", &header, &batch(3, "9.81")).0, 200);
        // Two that are lost on the way.
        assert_eq!(push(6), 202);
        // Others: a wrong key, another's key, no key, what a paired phone uses, no JSON, forces in g.
        for path in [
            format!("/v1/push/ada/{bob}"),
            "/v1/push/ada/00".to_owned(),
            "/v1/push/ada".to_owned(),
        ] {
            assert_eq!(post(rig, &path, "", &batch(9, "9.81")).0, 401, "{path}");
        }
        assert_eq!(post(rig, "/v1/sessions/x", "", "").0, 404);
        assert_eq!(post(rig, &path, "", "[1]").0, 400);
        let (status, said) = post(rig, &format!("/v1/push/bob/{bob}"), "", &batch(0, "-1.0"));
        assert!(status == 499 && said.contains("measures in g"), "{said}");
        std::thread::sleep(Duration::from_millis(2_600));
        assert_eq!(push(4), 410, "given up");
        stop.store(true, Ordering::Relaxed);
        running.join().unwrap()
    });
    let phones = stream(&report, "sidecar");
    assert_eq!((phones.missing, phones.bad), (2, 0), "{phones:?}");
    let said = phones.notes.join("\n");
    for words in [
        "5 × battery of ada",
        "1 × not paired",
        "2 × bad credentials",
        "1 × bad body",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let recording = Recording::open(&out).unwrap();
    let turns: Vec<(f64, f64)> = recording
        .messages("/sidecar/ada/gyro_calibrated")
        .unwrap()
        .map(|m| decode_vector(&m.unwrap().bytes).unwrap())
        .map(|v| (v[0], v[2]))
        .collect();
    let expected = [0_u32, 1, 2, 3, 6]
        .into_iter()
        .flat_map(|batch| (0..IN_BATCH as u32).map(move |n| (f64::from(batch), f64::from(n))));
    assert_eq!(turns, expected.collect::<Vec<_>>());
    // At each of them but the last before the gap and the last of all there are forces on both sides.
    let inertial = recording.messages("/sidecar/ada/imu").unwrap().count();
    assert_eq!(inertial, turns.len() - 2);
    let bytes = std::fs::read(&out).unwrap();
    assert!(!String::from_utf8_lossy(&bytes).contains(&ada));
}
