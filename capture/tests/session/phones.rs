//! Several phones at one port: what one of them does costs that one only, and whoever was cut off goes on where it was.

use std::sync::Arc;

use lsfb_capture::{PairingFolder, SidecarConfig};
use lsfb_drivers::Error;
use lsfb_drivers::sidecar::credentials::DeviceKey;
use lsfb_drivers::sidecar::model::CLOCK_UTC;
use lsfb_drivers::sidecar::wire::Advertise;
use lsfb_drivers::sidecar::{ClientClock, ClientConfig, SidecarClient};

use lsfb_recording::message::{WifiReading, decode_wifi, encode_wifi};
use rcgen::{CertificateParams, KeyPair};

use super::live::wait_until;
use super::*;

const TOPIC: &str = "/sidecar/visor/note";

fn advertise(topic: &str, schema_name: &str, schema: &str) -> Advertise {
    Advertise {
        channel: 3,
        topic: topic.to_owned(),
        encoding: "cdr".to_owned(),
        schema_name: schema_name.to_owned(),
        schema: schema.as_bytes().to_vec(),
        clock_id: CLOCK_UTC.to_owned(),
        metadata_json: String::new(),
    }
}

fn notes(out: &Path) -> Vec<u32> {
    let recording = Recording::open(out).unwrap();
    let notes = recording.messages(TOPIC).unwrap().map(Result::unwrap);
    notes
        .map(|note| u32::from_le_bytes(note.bytes[4..8].try_into().unwrap()))
        .collect()
}

/// An advertisement of a used topic with another schema ended the whole recording, the LiDAR's too.
#[test]
fn one_phones_bad_message_costs_that_phone_only() {
    let folder = tempfile::tempdir().unwrap();
    let imu = mock::imu(None, &[]);
    let session = imu_and_phones(&imu.path, folder.path());
    let invited = || mock::invited(&session, folder.path());
    let visors = invited();
    let rudes: Vec<ClientConfig> = (0..5)
        .map(|n| ClientConfig {
            device: format!("rude{n}"),
            ..invited()
        })
        .collect();
    let counts = session.counts();
    let out = folder.path().join("scan.mcap");
    let stop = AtomicBool::new(false);
    let report = std::thread::scope(|scope| {
        let running = std::thread::Builder::new()
            .name("session".to_owned())
            .spawn_scoped(scope, || session.run(&out, &until(&stop)).unwrap())
            .unwrap();
        let mut visor = mock::visor(visors.clone());
        mock::send_note(&mut visor, 0);
        // Somebody else's topic, with its schema and with another; topics of the recorder's own; no sidecar topic.
        for (rude, (topic, name, schema)) in rudes.into_iter().zip([
            (TOPIC, "std_msgs/msg/UInt32", "uint32 data"),
            (TOPIC, "std_msgs/msg/String", "string data"),
            (
                "/sidecar/rude2/x/device_time",
                "std_msgs/msg/UInt32",
                "uint32 data",
            ),
            (
                "/sidecar/rude3/session",
                "std_msgs/msg/UInt32",
                "uint32 data",
            ),
            ("/lidar/points", "std_msgs/msg/UInt32", "uint32 data"),
        ]) {
            let mut client = SidecarClient::connect(rude).unwrap();
            client.advertise(&advertise(topic, name, schema)).unwrap();
            let sent = client.send(3, 0, &[0, 1, 0, 0, 99, 0, 0, 0]);
            let ended = sent.and_then(|()| client.bye().map(|_| ()));
            assert!(ended.is_err(), "{topic}");
        }
        mock::send_note(&mut visor, 1);
        visor.bye().unwrap();
        // It comes again, with another session; its topic keeps its schema.
        let again = ClientConfig {
            session: "second".to_owned(),
            pairing_token: None,
            ..visors.clone()
        };
        let mut visor = mock::visor(again.clone());
        mock::send_note(&mut visor, 2);
        visor.bye().unwrap();
        let before = counts.imu_samples.load(Ordering::Relaxed);
        wait_until("the IMU goes on", || {
            counts.imu_samples.load(Ordering::Relaxed) > before + 100
        });
        stop.store(true, Ordering::Relaxed);
        running.join().unwrap()
    });
    assert_eq!(report.failure, None, "{report:?}");
    let phones = stream(&report, "sidecar");
    assert_eq!((phones.decoded, phones.bad), (3, 0), "{phones:?}");
    let said = phones.notes.join("\n");
    assert!(said.contains("5 × bad topic"), "{said}");
    assert_eq!(notes(&out), [0, 1, 2]);
    let recording = Recording::open(&out).unwrap();
    assert!(recording.imu().unwrap().count() > 100);
}

#[test]
fn strangers_are_refused_and_counted_and_a_token_is_used_once() {
    let folder = tempfile::tempdir().unwrap();
    let config = DevicesConfig {
        sidecar: Some(mock::sidecar(folder.path())),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let invited = mock::invited(&session, folder.path());
    let out = folder.path().join("walk.mcap");
    let running = {
        let out = out.clone();
        mock::spawn("session", move || run(session, &out))
    };
    let mut visor = mock::visor(invited.clone());
    mock::send_note(&mut visor, 0);
    let refused = |config: ClientConfig, why: &str| match SidecarClient::connect(config) {
        Err(Error::Refused {
            may_pass: false,
            reason,
            ..
        }) => assert!(reason.contains(why), "{reason}"),
        other => panic!("{other:?}"),
    };
    // The invitation again, for another device; another key for a name that is paired; nobody invited it.
    let other_name = ClientConfig {
        device: "other".to_owned(),
        ..invited.clone()
    };
    refused(other_name.clone(), "invitation");
    let other_key = ClientConfig {
        device_key: DeviceKey([7; 32]),
        pairing_token: None,
        device: "visor".to_owned(),
        ..invited.clone()
    };
    refused(other_key, "not paired");
    let uninvited = ClientConfig {
        pairing_token: None,
        ..other_name
    };
    refused(uninvited, "not paired");
    // A rig that has another key than the code says is not talked to at all.
    let mut elsewhere = invited;
    elsewhere.fingerprint.0[0] ^= 1;
    assert!(matches!(
        SidecarClient::connect(elsewhere),
        Err(Error::Open { .. })
    ));
    mock::send_note(&mut visor, 1);
    visor.bye().unwrap();
    let report = running.join().unwrap();
    let phones = stream(&report, "sidecar");
    assert_eq!((phones.decoded, report.lost), (2, 0), "{report:?}");
    let said = phones.notes.join("\n");
    for reason in ["2 × not paired", "1 × wrong, used or expired", "no TLS"] {
        assert!(said.contains(reason), "{reason}: {said}");
    }
    // No secret went into the recording.
    let bytes = std::fs::read(&out).unwrap();
    assert_eq!(notes(&out), [0, 1]);
    assert!(!bytes.windows(4).any(|w| w == b"tok="));
}

/// A rig's clock may be years off, and so may a phone's: the rig is known by its key, whatever the dates of its certificate.
#[test]
fn a_rig_whose_certificate_has_expired_is_known_by_its_key() {
    let folder = tempfile::tempdir().unwrap();
    let sidecar = mock::sidecar(folder.path());
    PairingFolder::open(&sidecar.folder).unwrap();
    let key = std::fs::read(sidecar.folder.join("key.der")).unwrap();
    let mut dated = CertificateParams::new(["lsfb-rig".to_owned()]).unwrap();
    dated.not_before = rcgen::date_time_ymd(2001, 1, 1);
    dated.not_after = rcgen::date_time_ymd(2002, 1, 1);
    let key = KeyPair::try_from(key.as_slice()).unwrap();
    let expired = dated.self_signed(&key).unwrap();
    std::fs::write(sidecar.folder.join("certificate.der"), expired.der()).unwrap();
    let config = DevicesConfig {
        sidecar: Some(sidecar),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let invited = mock::invited(&session, folder.path());
    let out = folder.path().join("walk.mcap");
    let running = {
        let out = out.clone();
        mock::spawn("session", move || run(session, &out))
    };
    let mut visor = mock::visor(invited);
    mock::send_note(&mut visor, 0);
    visor.bye().unwrap();
    assert_eq!(running.join().unwrap().lost, 0);
    assert_eq!(notes(&out), [0]);
}

/// What a phone hears of other people is not in the recording, in no form.
#[test]
fn hashed_identifiers_are_in_no_file() {
    const BSSID: &str = "ac:de:48:00:11:22";
    const SSID: &str = "Ada's flat";
    let folder = tempfile::tempdir().unwrap();
    let config = DevicesConfig {
        sidecar: Some(SidecarConfig {
            hash_identifiers: true,
            ..mock::sidecar(folder.path())
        }),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let [invited, second] = [(); 2].map(|()| mock::invited(&session, folder.path()));
    let out = folder.path().join("walk.mcap");
    let running = {
        let out = out.clone();
        mock::spawn("session", move || run(session, &out))
    };
    let mut phone = SidecarClient::connect(ClientConfig {
        device: "visor".to_owned(),
        ..invited
    })
    .unwrap();
    let topic = "/sidecar/visor/wifi";
    let schema = message::WIFI_READING;
    phone
        .advertise(&advertise(topic, schema.name, schema.text))
        .unwrap();
    for scan in 0..3 {
        let reading = WifiReading {
            scan,
            bssid: BSSID.to_owned(),
            ssid: SSID.to_owned(),
            ..WifiReading::default()
        };
        let bytes = encode_wifi(Timestamp::from_nanos(5), "phone", &reading);
        phone.send(3, i64::from(scan), &bytes).unwrap();
    }
    // Cut off, it cannot be read, and may hold anything.
    let cut = encode_wifi(Timestamp::from_nanos(5), BSSID, &WifiReading::default());
    phone.send(3, 3, &cut[..cut.len() - 12]).unwrap();
    // A text may hold anything.
    let mut other = SidecarClient::connect(ClientConfig {
        device: "other".to_owned(),
        ..second
    })
    .unwrap();
    let text = advertise("/sidecar/other/note", "std_msgs/msg/String", "string data");
    other.advertise(&text).unwrap();
    // Without a message nothing would be missed.
    let sent = other.send(3, 0, &[0, 1, 0, 0, 1, 0, 0, 0, 0]);
    let ended = sent.and_then(|()| other.bye().map(|_| ()));
    assert!(ended.is_err(), "{ended:?}");
    phone.bye().unwrap();
    let report = running.join().unwrap();
    let phones = stream(&report, "sidecar");
    assert_eq!((phones.decoded, phones.bad), (3, 1), "{phones:?}");
    let recording = Recording::open(&out).unwrap();
    let heard: Vec<WifiReading> = recording
        .messages(topic)
        .unwrap()
        .map(|m| decode_wifi(&m.unwrap().bytes).unwrap())
        .collect();
    assert_eq!(heard.len(), 3);
    assert!(heard.iter().all(|h| h.bssid == heard[0].bssid));
    // Chunks are compressed: each message is looked at.
    for topic in recording.topics() {
        for message in recording.messages(&topic.topic).unwrap() {
            let text = String::from_utf8_lossy(&message.unwrap().bytes).into_owned();
            assert!(!text.contains(BSSID) && !text.contains(SSID), "{topic:?}");
        }
    }
}

/// Only `lsfb doctor` said so, when the walk was over.
#[test]
fn wifi_scans_that_are_held_back_are_on_the_screen() {
    let folder = tempfile::tempdir().unwrap();
    let config = DevicesConfig {
        sidecar: Some(mock::sidecar(folder.path())),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let snapshots = session.health().subscribe();
    let invited = mock::invited(&session, folder.path());
    let out = folder.path().join("walk.mcap");
    let running = mock::spawn("session", move || run(session, &out));
    let mut phone = SidecarClient::connect(ClientConfig {
        device: "visor".to_owned(),
        ..invited
    })
    .unwrap();
    let schema = message::WIFI_READING;
    phone
        .advertise(&advertise("/sidecar/visor/wifi", schema.name, schema.text))
        .unwrap();
    let mut scan_of = |scan: u32, heard_ns: i64| {
        for n in 0..5 {
            let reading = WifiReading {
                scan,
                bssid: format!("ac:de:48:00:11:{n:02x}"),
                rssi_dbm: -50 - n,
                ..WifiReading::default()
            };
            let bytes = encode_wifi(Timestamp::from_nanos(heard_ns), "phone", &reading);
            phone.send(3, heard_ns + i64::from(n), &bytes).unwrap();
        }
    };
    scan_of(1, START_NS);
    // Its results, twice more.
    scan_of(2, START_NS);
    scan_of(3, START_NS);
    let mut problem = String::new();
    wait_until("the screen says it", || {
        let devices = snapshots.try_iter().flat_map(|snapshot| snapshot.devices);
        problem = devices.map(|d| d.problem).last().unwrap_or_default();
        problem.contains("throttles Wi-Fi scans")
    });
    assert!(problem.starts_with("visor: "), "{problem}");
    phone.bye().unwrap();
    let report = running.join().unwrap();
    let notes = stream(&report, "sidecar").notes.join("\n");
    assert!(notes.contains("visor: 3 Wi-Fi scans; 2 of them"), "{notes}");
}

/// A device that is cut off at any byte, repeats, damages and skips messages has each of them in the recording once, in order.
#[test]
fn faults_on_the_way_lose_nothing_and_repeat_nothing() {
    const MESSAGES: u32 = 400;
    let folder = tempfile::tempdir().unwrap();
    let config = DevicesConfig {
        sidecar: Some(mock::sidecar(folder.path())),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let phones: Vec<ClientConfig> = (0..8)
        .map(|n| ClientConfig {
            device: format!("phone{n}"),
            faults: Some(n),
            reconnect_secs: 30,
            clock: Some(ClientClock {
                id: CLOCK_UTC.to_owned(),
                offset_ns: 1_000_000,
                skew_ppm: 50.0,
            }),
            ..mock::invited(&session, folder.path())
        })
        .collect();
    let names: Vec<String> = phones.iter().map(|phone| phone.device.clone()).collect();
    let out = folder.path().join("walk.mcap");
    let running = {
        let out = out.clone();
        mock::spawn("session", move || run(session, &out))
    };
    let playing: Vec<_> = phones
        .into_iter()
        .map(|phone| {
            mock::spawn("phone", move || {
                let topic = format!("/sidecar/{}/note", phone.device);
                let mut client = SidecarClient::connect(phone).unwrap();
                client
                    .advertise(&advertise(&topic, "std_msgs/msg/UInt32", "uint32 data"))
                    .unwrap();
                (0..MESSAGES).for_each(|n| mock::send_note(&mut client, n));
                client.bye().unwrap()
            })
        })
        .collect();
    let connections: u64 = playing
        .into_iter()
        .map(|phone| phone.join().unwrap().connections)
        .sum();
    // The faults were there.
    assert!(connections > 16, "{connections}");
    let report = running.join().unwrap();
    assert_eq!(report.failure, None);
    assert_eq!(stream(&report, "sidecar").missing, 0, "{report:?}");
    let recording = Recording::open(&out).unwrap();
    for name in names {
        let topic = format!("/sidecar/{name}/note");
        let found = recording.messages(&topic).unwrap().map(Result::unwrap);
        let found: Vec<u32> = found
            .map(|note| u32::from_le_bytes(note.bytes[4..8].try_into().unwrap()))
            .collect();
        assert_eq!(found, Vec::from_iter(0..MESSAGES), "{name}");
        let exchanges = recording.messages(&format!("/sidecar/{name}/time_sync"));
        assert!(exchanges.unwrap().count() > 5, "{name}");
    }
}

/// A phone whose recording ends in the middle goes on in the next one where the first has got to, told so or not.
#[test]
fn the_next_recording_goes_on_where_the_last_one_has_got_to() {
    let folder = tempfile::tempdir().unwrap();
    let listener = std::net::TcpListener::bind(LOOPBACK).unwrap();
    let listen = listener.local_addr().unwrap();
    drop(listener);
    let config = DevicesConfig {
        sidecar: Some(SidecarConfig {
            listen,
            ..mock::sidecar(folder.path())
        }),
        ..anywhere()
    };
    let [first, second] = ["first", "second"].map(|name| folder.path().join(name));
    let session = Session::open(&config).unwrap();
    let invited = mock::invited(&session, folder.path());
    let stop = Arc::new(AtomicBool::new(false));
    let running = {
        let (out, stop) = (first.clone(), Arc::clone(&stop));
        mock::spawn("session", move || session.run(&out, &until(&stop)).unwrap())
    };
    let mut visor = mock::visor(ClientConfig {
        reconnect_secs: 30,
        ..invited
    });
    (0..200).for_each(|n| mock::send_note(&mut visor, n));
    stop.store(true, Ordering::Relaxed);
    running.join().unwrap();
    let session = Session::open(&config).unwrap();
    let running = {
        let out = second.clone();
        mock::spawn("session", move || run(session, &out))
    };
    (200..210).for_each(|n| mock::send_note(&mut visor, n));
    visor.bye().unwrap();
    let report = running.join().unwrap();
    assert_eq!(report.lost, 0, "{report:?}");
    let (mut found, rest) = (notes(&first), notes(&second));
    assert!(!found.is_empty() && !rest.is_empty());
    found.extend(rest);
    assert_eq!(found, Vec::from_iter(0..210));
}
