//! Four phones beside the rig at their full rate, and a phone that was out of reach catches up. Seconds as a test; with `LSFB_FIGURES=1` at
//! the length that `docs/figures.md` states.

use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;

use lsfb_drivers::sidecar::wire::Advertise;
use lsfb_drivers::sidecar::{ClientClock, ClientConfig, SidecarClient};

use super::*;

const PHONES: usize = 4;
const CLOCK: &str = "android.elapsedRealtime";
/// A JPEG of 640 × 480 at quality 90 has about as many.
const JPEG_BYTES: usize = 60_000;
const IMU_HZ: u64 = 400;
/// One image for so many inertial samples: 30 Hz.
const SAMPLES_TO_IMAGE: f64 = 400.0 / 30.0;

fn is_long() -> bool {
    std::env::var_os("LSFB_FIGURES").is_some()
}

/// What a phone did.
#[derive(Debug, Default)]
struct Walked {
    messages: u64,
    /// Of the walk that lay behind when it was in reach again, and what it took to have none behind, seconds.
    behind_secs: f64,
    caught_up_secs: f64,
}

/// Measures for so long, and sends at once what it may; what it could not send yet it sends in order later.
fn walk(config: ClientConfig, secs: f64, out_until_secs: f64) -> Walked {
    let mut client = SidecarClient::connect(config.clone()).unwrap();
    for (channel, name, schema) in [
        (1, "imu", "sensor_msgs/msg/Imu"),
        (2, "image", "sensor_msgs/msg/CompressedImage"),
    ] {
        let described = Advertise {
            channel,
            topic: format!("/sidecar/{}/{name}", config.device),
            encoding: "cdr".to_owned(),
            schema_name: schema.to_owned(),
            schema: b"uint8[] data".to_vec(),
            clock_id: CLOCK.to_owned(),
            metadata_json: String::new(),
        };
        client.advertise(&described).unwrap();
    }
    let clock = config.clock.unwrap();
    // No compression makes it smaller.
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let jpeg: Vec<u8> = std::iter::repeat_with(|| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state as u8
    })
    .take(2 * JPEG_BYTES)
    .collect();
    let began = Instant::now();
    let mut walked = Walked::default();
    let mut images = 0.0;
    for n in 0..(secs * IMU_HZ as f64) as u64 {
        let due = Duration::from_micros(n * 1_000_000 / IMU_HZ);
        std::thread::sleep(due.saturating_sub(began.elapsed()));
        let behind = began.elapsed().saturating_sub(due).as_secs_f64();
        let now_secs = began.elapsed().as_secs_f64();
        if now_secs >= out_until_secs && walked.caught_up_secs == 0.0 {
            walked.behind_secs = walked.behind_secs.max(behind);
            if behind < 0.1 {
                walked.caught_up_secs = now_secs - out_until_secs;
            }
        }
        let time_ns = clock.now_ns() - (behind * 1e9) as i64;
        client.send(1, time_ns, &[0; 320]).unwrap();
        walked.messages += 1;
        if n as f64 >= images * SAMPLES_TO_IMAGE {
            images += 1.0;
            // Another part each time, as no two images are alike.
            let from = images as usize * 997 % JPEG_BYTES;
            client
                .send(2, time_ns, &jpeg[from..from + JPEG_BYTES])
                .unwrap();
            walked.messages += 1;
        }
    }
    assert_eq!(client.bye().unwrap().messages, walked.messages);
    walked
}

fn phone(name: &str, config: ClientConfig) -> ClientConfig {
    ClientConfig {
        device: name.to_owned(),
        reconnect_secs: 180,
        clock: Some(ClientClock {
            id: CLOCK.to_owned(),
            offset_ns: -1_700_000_000_000_000_000,
            skew_ppm: 20.0,
        }),
        ..config
    }
}

#[test]
fn four_phones_beside_the_rig_lose_nothing() {
    let secs = if is_long() { 60.0 } else { 3.0 };
    let folder = tempfile::tempdir().unwrap();
    let sockets = [0, 1].map(|n| folder.path().join(format!("unit{n}")));
    let units = sockets.each_ref().map(|s| mock::unit_without_imu(s));
    let imu = mock::imu(None, &[]);
    let config = DevicesConfig {
        lidars: vec![lidar()],
        cameras: vec![
            unit(&sockets[0], ["cam0", "cam1"]),
            unit(&sockets[1], ["cam2", "cam3"]),
        ],
        imus: vec![line(&imu.path)],
        sidecar: Some(mock::sidecar(folder.path())),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let phones: Vec<ClientConfig> = (0..PHONES)
        .map(|n| phone(&format!("phone{n}"), mock::invited(&session, folder.path())))
        .collect();
    // A VLP-16's rate.
    let packets = (secs * 754.0) as u64;
    let pause = Duration::from_micros(1_326);
    let sent = mock::send_lidar(
        &session.lidar_addresses()[0..2],
        &session.counts(),
        packets,
        pause,
    );
    let out = folder.path().join("scan.mcap");
    let stop = AtomicBool::new(false);
    let (walked, report) = std::thread::scope(|scope| {
        let running = scope.spawn(|| session.run(&out, &until(&stop)).unwrap());
        let walks: Vec<_> = phones
            .into_iter()
            .map(|phone| mock::spawn("phone", move || walk(phone, secs, f64::MAX)))
            .collect();
        let walked: Vec<Walked> = walks.into_iter().map(|walk| walk.join().unwrap()).collect();
        sent.join().unwrap();
        stop.store(true, Ordering::Relaxed);
        (walked, running.join().unwrap())
    });
    drop(units);
    let lost: u64 = report
        .streams
        .iter()
        .map(|s| s.dropped + s.missing + s.bad)
        .sum();
    assert_eq!((lost, report.failure.as_ref()), (0, None), "{report:?}");
    let messages: u64 = walked.iter().map(|w| w.messages).sum();
    assert_eq!(stream(&report, "sidecar").decoded, messages);
    let megabytes = std::fs::metadata(&out).unwrap().len() as f64 / 1e6;
    println!(
        "{PHONES} phones, {secs} s: {messages} messages and {megabytes:.0} MB with the rig's, {lost} lost; enqueue to write p99 {:.1} ms",
        report.write_p99_ms
    );
}

/// Carries bytes between a phone and the rig while it may.
fn carry(from: TcpListener, to: SocketAddr, is_out: Arc<AtomicBool>) {
    let mut open: Vec<TcpStream> = Vec::new();
    from.set_nonblocking(true).unwrap();
    loop {
        std::thread::sleep(Duration::from_millis(20));
        if is_out.load(Ordering::Relaxed) {
            for socket in open.drain(..) {
                let _ = socket.shutdown(Shutdown::Both);
            }
        }
        let Ok((phone, _)) = from.accept() else {
            continue;
        };
        if is_out.load(Ordering::Relaxed) {
            continue;
        }
        phone.set_nonblocking(false).unwrap();
        let Ok(rig) = TcpStream::connect(to) else {
            return;
        };
        for (mut a, mut b) in [
            (phone.try_clone().unwrap(), rig.try_clone().unwrap()),
            (rig.try_clone().unwrap(), phone.try_clone().unwrap()),
        ] {
            mock::spawn("carry", move || {
                let mut bytes = vec![0; 64 << 10];
                while let Ok(n @ 1..) = a.read(&mut bytes) {
                    if b.write_all(&bytes[..n]).is_err() {
                        break;
                    }
                }
                let _ = b.shutdown(Shutdown::Both);
            });
        }
        open.extend([phone, rig]);
    }
}

#[test]
fn a_phone_that_was_out_of_reach_catches_up_three_times_as_fast_as_it_walks() {
    let away = Duration::from_secs(if is_long() { 60 } else { 3 });
    let out_secs = away.as_secs_f64();
    let folder = tempfile::tempdir().unwrap();
    let config = DevicesConfig {
        sidecar: Some(lsfb_capture::SidecarConfig {
            come_back_secs: 180,
            ..mock::sidecar(folder.path())
        }),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let rig = session.sidecar_address().unwrap();
    let listener = TcpListener::bind(LOOPBACK).unwrap();
    let way = listener.local_addr().unwrap();
    let is_out = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&is_out);
    mock::spawn("way", move || carry(listener, rig, told));
    let phone = ClientConfig {
        address: way,
        ..phone("phone", mock::invited(&session, folder.path()))
    };
    let out = folder.path().join("walk.mcap");
    let running = {
        let out = out.clone();
        mock::spawn("session", move || run(session, &out))
    };
    let back_secs = 1.0 + out_secs;
    let walking = mock::spawn("phone", move || {
        walk(phone, back_secs + out_secs / 2.0 + 2.0, back_secs)
    });
    std::thread::sleep(Duration::from_secs(1));
    is_out.store(true, Ordering::Relaxed);
    std::thread::sleep(away);
    is_out.store(false, Ordering::Relaxed);
    let walked = walking.join().unwrap();
    let report = running.join().unwrap();
    assert_eq!(
        (report.lost, report.failure.as_ref()),
        (0, None),
        "{report:?}"
    );
    assert_eq!(stream(&report, "sidecar").decoded, walked.messages);
    // What lay behind, and what was measured while it was sent.
    let speed = (walked.behind_secs + walked.caught_up_secs) / walked.caught_up_secs;
    println!(
        "{:.1} s behind, caught up in {:.1} s: {speed:.1} times as fast as it was measured",
        walked.behind_secs, walked.caught_up_secs
    );
    assert!(walked.behind_secs > 0.8 * out_secs, "{walked:?}");
    assert!(speed >= 3.0, "{walked:?}");
}
