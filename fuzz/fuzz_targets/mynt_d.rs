//! Reports of the Mynt D's inertial unit.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::mynt_d::Decoder;
use lsfb_drivers::mynt_d::wire::Report;
use lsfb_types::{Packet, Timestamp};

fuzz_target!(|data: &[u8]| {
    let mut decoder = Decoder::new();
    for given in data.chunks(63) {
        // The checksum is ours, so that the fuzzer need not guess it.
        let mut bytes = given.to_vec();
        bytes.resize(63, 0);
        bytes.push(bytes[3..].iter().fold(0, |sum, byte| sum ^ byte));
        if let Ok(report) = Report::parse(&bytes)
            && let Ok(items) = report.items().collect::<Result<Vec<_>, _>>()
        {
            let written = Report::emit(report.serial, &items).expect("what was read fits");
            assert!(written.starts_with(&bytes[..3 + report.payload.len()]));
        }
        let _ = decoder.push(&Packet {
            arrival: Timestamp::default(),
            bytes,
        });
        while decoder.next_reading().is_some() {}
    }
    let _ = Report::parse(data);
});
