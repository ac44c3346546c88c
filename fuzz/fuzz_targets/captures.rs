//! pcap and pcapng files.
#![no_main]

use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::Error;
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::pcap::PcapSource;

fuzz_target!(|data: &[u8]| {
    let path = std::env::temp_dir().join(format!("lsfb-fuzz-{}.pcap", std::process::id()));
    std::fs::write(&path, data).expect("a scratch file");
    for ports in [&[][..], &[2368]] {
        let Ok(mut source) = PcapSource::open(&path, ports) else {
            return;
        };
        loop {
            match source.recv(Duration::ZERO) {
                Ok(packet) => assert!(packet.is_some(), "a file never waits"),
                Err(Error::EndOfStream { .. }) => break,
                Err(Error::File { .. }) => {
                    let after = source.recv(Duration::ZERO);
                    assert!(matches!(after, Err(Error::EndOfStream { .. })));
                    break;
                }
                Err(error) => panic!("{error}"),
            }
        }
    }
});
