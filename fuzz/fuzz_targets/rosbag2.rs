//! rosbag2 databases: a small one of ours with edits, or whatever the fuzzer makes up.
#![no_main]

use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::Error;
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::rosbag2::Rosbag2Source;

const WHOLE: &[u8] = include_bytes!("../seeds/rosbag2/small.db3");

fuzz_target!(|data: &[u8]| {
    let path = std::env::temp_dir().join(format!("lsfb-fuzz-{}.db3", std::process::id()));
    let mut bytes = data.to_vec();
    if !data.starts_with(b"SQLite") {
        bytes = WHOLE.to_vec();
        for edit in data.chunks_exact(3) {
            let at = usize::from(u16::from_le_bytes([edit[0], edit[1]])) % bytes.len();
            bytes[at] ^= edit[2];
        }
    }
    std::fs::write(&path, bytes).expect("a scratch file");
    let Ok(mut source) = Rosbag2Source::open(&path) else {
        return;
    };
    // A database with a loop in it may have no end.
    for _ in 0..100 {
        match source.recv(Duration::ZERO) {
            Ok(packet) => assert!(packet.is_some(), "a file never waits"),
            Err(Error::EndOfStream { .. }) => break,
            Err(Error::File { .. }) => {}
            Err(error) => panic!("{error}"),
        }
    }
});
