//! Two hundred connections of everything that a network may send: the rig records on, and the phone that is paired too.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;

use lsfb_drivers::sidecar::credentials::{DeviceKey, PairingToken};
use lsfb_drivers::sidecar::{ClientConfig, SidecarClient};

use super::live::wait_until;
use super::*;

const STRANGERS: usize = 200;
const NOTES: u32 = 60;

/// What the n-th stranger does; what is returned stays open.
fn molest(n: usize, rig: &ClientConfig) -> Option<TcpStream> {
    let mut tcp = TcpStream::connect(rig.address).unwrap();
    match n % 4 {
        // Says nothing at all.
        0 => Some(tcp),
        // No TLS.
        1 => {
            let _ = tcp.write_all(&[0xA5; 700]);
            let _ = tcp.read(&mut [0; 16]);
            None
        }
        // The beginning of TLS, and no more.
        2 => {
            let _ = tcp.write_all(&[0x16, 3, 1, 2, 0, 1, 0, 1, 0xFC, 3, 3]);
            Some(tcp)
        }
        // The whole way, with an invitation that does not exist.
        _ => {
            let stranger = ClientConfig {
                device: format!("stranger{n}"),
                device_key: DeviceKey([n as u8; 32]),
                pairing_token: Some(PairingToken([n as u8; 16])),
                ..rig.clone()
            };
            assert!(SidecarClient::connect(stranger).is_err());
            None
        }
    }
}

#[test]
fn two_hundred_strangers_cost_nobody_anything() {
    let folder = tempfile::tempdir().unwrap();
    let imu = mock::imu(None, &[]);
    let session = imu_and_phones(&imu.path, folder.path());
    let invited = mock::invited(&session, folder.path());
    let rig = ClientConfig {
        session: "walk".to_owned(),
        pairing_token: None,
        // Only what was acknowledged is followed by more.
        window_messages: 1,
        ..invited.clone()
    };
    let counts = session.counts();
    let out = folder.path().join("scan.mcap");
    let stop = AtomicBool::new(false);
    let report = std::thread::scope(|scope| {
        let spawn = |name: &str| std::thread::Builder::new().name(name.to_owned());
        let running = spawn("session")
            .spawn_scoped(scope, || session.run(&out, &until(&stop)).unwrap())
            .unwrap();
        // It was paired before: an address with many strangers is not listened to about invitations.
        mock::visor(invited).bye().unwrap();
        let rig = &rig;
        let crowds: Vec<_> = (0..4)
            .map(|crowd| {
                let strangers = (crowd..STRANGERS).step_by(4);
                // Of every kind in each crowd.
                spawn("crowd")
                    .spawn_scoped(scope, move || {
                        let stay: Vec<_> = strangers.map(|n| molest(n / 4 + crowd, rig)).collect();
                        stay
                    })
                    .unwrap()
            })
            .collect();
        // It comes while they are at it.
        let mut visor = mock::visor(rig.clone());
        (0..NOTES).for_each(|n| mock::send_note(&mut visor, n));
        let stay: Vec<_> = crowds
            .into_iter()
            .map(|crowd| crowd.join().unwrap())
            .collect();
        visor.bye().unwrap();
        let before = counts.imu_samples.load(Ordering::Relaxed);
        wait_until("the IMU goes on", || {
            counts.imu_samples.load(Ordering::Relaxed) > before + 50
        });
        drop(stay);
        stop.store(true, Ordering::Relaxed);
        running.join().unwrap()
    });
    assert_eq!(report.failure, None, "{report:?}");
    assert_eq!(report.lost, 0, "{report:?}");
    let phones = stream(&report, "sidecar");
    assert_eq!(phones.decoded, u64::from(NOTES), "{phones:?}");
    let said = phones.notes.join("\n");
    for reason in ["no TLS", "disconnected to make room for others"] {
        assert!(said.contains(reason), "{reason}: {said}");
    }
    assert!(said.contains("too many attempts"), "{said}");
    let recording = Recording::open(&out).unwrap();
    assert_eq!(
        recording.imu().unwrap().count() as u64,
        stream(&report, "imu0").decoded
    );
}
