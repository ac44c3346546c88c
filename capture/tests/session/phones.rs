//! Several phones at one port: what one of them does costs that one only.

use lsfb_drivers::sidecar::model::CLOCK_UTC;
use lsfb_drivers::sidecar::wire::Advertise;
use lsfb_drivers::sidecar::{ClientConfig, SidecarClient};

use super::live::wait_until;
use super::*;

const TOPIC: &str = "/sidecar/visor/note";

fn client(address: SocketAddr, device: &str) -> SidecarClient {
    SidecarClient::connect(ClientConfig {
        address,
        device: device.to_owned(),
        ..ClientConfig::default()
    })
    .unwrap()
}

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

/// An advertisement of a used topic with another schema ended the whole recording, the LiDAR's too. Topics belong to who opened
/// them, and whoever comes later is heard as well.
#[test]
fn one_phones_bad_message_costs_that_phone_only() {
    let folder = tempfile::tempdir().unwrap();
    let imu = mock::imu(None, &[]);
    let config = DevicesConfig {
        imus: vec![line(&imu.path)],
        sidecar: Some(SidecarConfig { listen: LOOPBACK }),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let address = session.sidecar_address().unwrap();
    let counts = session.counts();
    let out = folder.path().join("scan.mcap");
    let stop = AtomicBool::new(false);
    let report = std::thread::scope(|scope| {
        let running = std::thread::Builder::new()
            .name("session".to_owned())
            .spawn_scoped(scope, || session.run(&out, &until(&stop)).unwrap())
            .unwrap();
        let mut visor = mock::visor(ClientConfig {
            address,
            ..ClientConfig::default()
        });
        mock::send_note(&mut visor, 0);

        // Somebody else's topic, with its schema and with another; a topic of the recorder's own; no sidecar topic.
        // A number of a channel means one thing per connection, so each comes with its own.
        for (topic, name, schema) in [
            (TOPIC, "std_msgs/msg/UInt32", "uint32 data"),
            (TOPIC, "std_msgs/msg/String", "string data"),
            (
                "/sidecar/rude/x/device_time",
                "std_msgs/msg/UInt32",
                "uint32 data",
            ),
            ("/lidar/points", "std_msgs/msg/UInt32", "uint32 data"),
        ] {
            let mut rude = client(address, "rude");
            rude.advertise(&advertise(topic, name, schema)).unwrap();
            mock::send_note(&mut rude, 99);
            rude.bye().unwrap();
        }
        mock::send_note(&mut visor, 1);
        visor.bye().unwrap();

        // Everybody has gone. The same topic is free again, but not for another schema.
        let mut stranger = client(address, "stranger");
        stranger
            .advertise(&advertise(TOPIC, "std_msgs/msg/String", "string data"))
            .unwrap();
        mock::send_note(&mut stranger, 98);
        stranger.bye().unwrap();
        let mut heir = client(address, "heir");
        heir.advertise(&advertise(TOPIC, "std_msgs/msg/UInt32", "uint32 data"))
            .unwrap();
        mock::send_note(&mut heir, 2);
        heir.bye().unwrap();
        let before = counts.imu_samples.load(Ordering::Relaxed);
        wait_until("the IMU goes on", || {
            counts.imu_samples.load(Ordering::Relaxed) > before + 100
        });
        stop.store(true, Ordering::Relaxed);
        running.join().unwrap()
    });
    assert_eq!(report.failure, None, "{report:?}");
    let phones = stream(&report, "sidecar");
    assert_eq!((phones.decoded, phones.bad), (3, 5), "{phones:?}");
    assert_eq!(phones.ending, Ending::Stopped);
    let why = phones.first_bad.as_deref().unwrap();
    assert!(why.contains("another app") && why.contains(TOPIC), "{why}");
    let recording = Recording::open(&out).unwrap();
    let notes = recording.messages(TOPIC).unwrap().map(Result::unwrap);
    let notes: Vec<u8> = notes.map(|note| note.bytes[4]).collect();
    assert_eq!(notes, [0, 1, 2]);
    assert!(recording.imu().unwrap().count() > 100);
}
