//! A rig that is killed again and again while phones send: every message is in one of its recordings, once, in order.
//!
//! `LSFB_SIDECAR_RUNS` phones, sixteen by default, each with faults of its own; the recorder is killed four times for each
//! sixteen of them.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use crate::sidecar_rig::SidecarRig;
use lsfb_drivers::sidecar::model::CLOCK_UTC;
use lsfb_drivers::sidecar::wire::Advertise;
use lsfb_drivers::sidecar::{ClientConfig, SidecarClient};
use lsfb_recording::{Recording, Writer, WriterConfig};
use nix::sys::signal::Signal;

/// Phones at once.
const AT_ONCE: usize = 16;
const MESSAGES: u32 = 300;
const CHANNELS: u32 = 2;
const KILLS: u32 = 4;

fn topic(device: &str, channel: u32) -> String {
    format!("/sidecar/{device}/note{channel}")
}

/// Sends everything, whatever happens.
fn walk(phone: ClientConfig) {
    let device = phone.device.clone();
    let mut client = SidecarClient::connect(phone).expect("a rig");
    for channel in 0..CHANNELS {
        let described = Advertise {
            channel,
            topic: topic(&device, channel),
            encoding: "cdr".to_owned(),
            schema_name: "std_msgs/msg/UInt32".to_owned(),
            schema: b"uint32 data".to_vec(),
            clock_id: CLOCK_UTC.to_owned(),
            metadata_json: String::new(),
        };
        client.advertise(&described).expect("a channel");
    }
    for n in 0..MESSAGES {
        let payload = [&[0, 1, 0, 0][..], &n.to_le_bytes()].concat();
        let time_ns = 1_772_359_200_000_000_000 + i64::from(n);
        client.send(n % CHANNELS, time_ns, &payload).expect("sent");
        std::thread::sleep(Duration::from_millis(8));
    }
    // All of it is acknowledged.
    client.bye().expect("stored");
}

/// What the recordings hold of each topic, in their order.
fn recorded(recordings: &[PathBuf]) -> BTreeMap<String, Vec<u32>> {
    let mut found: BTreeMap<String, Vec<u32>> = BTreeMap::new();
    for path in recordings {
        // One that was killed at once may hold nothing.
        let Ok(recording) = Recording::open(path) else {
            continue;
        };
        for topic in recording.topics() {
            if !topic.topic.contains("/note") {
                continue;
            }
            let messages = recording.messages(&topic.topic).expect("a topic");
            let numbers = messages.map(|message| {
                let bytes = message.expect("whole").bytes;
                u32::from_le_bytes(bytes[4..8].try_into().expect("four bytes"))
            });
            found
                .entry(topic.topic.clone())
                .or_default()
                .extend(numbers);
        }
    }
    found
}

fn round(first: usize) {
    let rig = SidecarRig::new();
    let address = rig.address;
    let phones: Vec<ClientConfig> = (first..first + AT_ONCE)
        .map(|number| {
            let code = rig.invite(address);
            ClientConfig {
                device: format!("phone{number}"),
                faults: Some(number as u64),
                reconnect_secs: 60,
                ..ClientConfig::invited(address, &code).expect("a key")
            }
        })
        .collect();
    let devices: Vec<String> = phones.iter().map(|phone| phone.device.clone()).collect();
    let (mut running, out) = rig.recorder(0);
    let mut recordings = vec![out];
    rig.wait_for(&mut running);
    std::thread::scope(|scope| {
        let walks: Vec<_> = phones
            .into_iter()
            .map(|phone| {
                std::thread::Builder::new()
                    .name(phone.device.clone())
                    .spawn_scoped(scope, move || walk(phone))
                    .expect("a thread")
            })
            .collect();
        for number in 1..=KILLS {
            std::thread::sleep(Duration::from_millis(350 + 37 * u64::from(number)));
            running.signal(Signal::SIGKILL);
            running.wait();
            let (next, out) = rig.recorder(number);
            running = next;
            recordings.push(out);
        }
        for walk in walks {
            walk.join().expect("everything was sent");
        }
    });
    running.signal(Signal::SIGINT);
    running.wait();
    let found = recorded(&recordings);
    for device in devices {
        for channel in 0..CHANNELS {
            let expected: Vec<u32> = (channel..MESSAGES).step_by(CHANNELS as usize).collect();
            let topic = topic(&device, channel);
            assert_eq!(found.get(&topic), Some(&expected), "{topic}");
        }
    }
}

#[test]
fn a_rig_that_is_killed_has_every_message_once() {
    let runs = std::env::var("LSFB_SIDECAR_RUNS")
        .ok()
        .and_then(|runs| runs.parse().ok());
    (0..runs.unwrap_or(AT_ONCE))
        .step_by(AT_ONCE)
        .for_each(round);
}

#[test]
fn a_recording_without_phones_makes_no_walks() {
    let folder = tempfile::tempdir().expect("folder");
    let scan = folder.path().join("scan.mcap");
    let writer = Writer::create(&scan, &WriterConfig::default()).expect("recording");
    writer.finish().expect("recording");
    let mut lsfb = Command::new(env!("CARGO_BIN_EXE_lsfb"));
    let lsfb = lsfb.args(["sidecar", "walks", "scan.mcap", "--out", "walks"]);
    let made = lsfb
        .current_dir(folder.path())
        .output()
        .expect("the built binary");
    let said = String::from_utf8_lossy(&made.stderr);
    assert_eq!(made.status.code(), Some(1), "{said}");
    assert!(said.contains("it contains no phone"), "{said}");
    assert!(!folder.path().join("walks").exists());
}
