//! Imports that are told to stop: an error, and nothing half-written.

use std::path::Path;
use std::time::Duration;

use lsfb_capture::{
    DevicesConfig, Error, Incoming, LidarNetConfig, RecorderConfig, ReplayConfig, record_incoming,
    replay,
};
use lsfb_drivers::transport::PacketSource;
use lsfb_types::{Packet, Progress, Stopped, Timestamp};

const PACKETS: i64 = 20_000;

/// Bytes that are no packet of a LiDAR: recorded and counted all the same.
fn packet(n: i64) -> Packet {
    Packet {
        arrival: Timestamp::from_nanos(1_772_359_200_000_000_000 + n * 1_000_000),
        bytes: vec![0; 1206],
    }
}

struct Packets(i64);

impl PacketSource for Packets {
    fn recv(&mut self, _: Duration) -> Result<Option<Packet>, lsfb_drivers::Error> {
        self.0 += 1;
        match self.0 {
            1..=PACKETS => Ok(Some(packet(self.0))),
            _ => Err(lsfb_drivers::Error::EndOfStream {
                device: "packets".to_owned(),
            }),
        }
    }
}

fn anywhere() -> RecorderConfig {
    RecorderConfig {
        least_space_secs: 0.0,
        ..RecorderConfig::default()
    }
}

/// Stops when something has been done.
fn soon(progress: Progress) -> Result<(), Stopped> {
    match progress.done {
        0 => Ok(()),
        _ => Err(Stopped),
    }
}

fn assert_nothing_left<T>(outcome: Result<T, Error>, folder: &Path) {
    assert!(matches!(outcome, Err(Error::Stopped(_))));
    let left = std::fs::read_dir(folder).expect("folder").count();
    assert_eq!(left, 0);
}

#[test]
fn packets_of_a_file() {
    let folder = tempfile::tempdir().expect("folder");
    let config = ReplayConfig {
        recorder: anywhere(),
        ..ReplayConfig::default()
    };
    let out = folder.path().join("scan.mcap");
    let stopped = replay(Packets(0), &config, &out, &soon);
    assert_nothing_left(stopped, folder.path());
}

#[test]
fn packets_of_a_rig() {
    let folder = tempfile::tempdir().expect("folder");
    let config = DevicesConfig {
        lidars: vec![LidarNetConfig::default()],
        recorder: anywhere(),
        ..DevicesConfig::default()
    };
    let incoming = (1..=PACKETS).map(|n| Incoming::Lidar {
        lidar: 0,
        packet: packet(n),
    });
    let out = folder.path().join("scan.mcap");
    let stopped = record_incoming(incoming, &config, &out, &soon);
    assert_nothing_left(stopped, folder.path());
}
