//! Answers of the unit's IMU, in its three layouts.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::mynt_s::ImuDecoder;
use lsfb_drivers::mynt_s::wire::{ImuProtocol, ImuRequest, ImuResponse};
use lsfb_types::{Packet, Timestamp};

fuzz_target!(|data: &[u8]| {
    for protocol in [
        ImuProtocol::Integer,
        ImuProtocol::Float,
        ImuProtocol::FloatPaired,
    ] {
        let _ = ImuRequest::parse(protocol, data);
        let mut decoder = ImuDecoder::new(protocol);
        let mut answer = vec![0x5B, 0];
        answer.extend((data.len() as u16).to_be_bytes());
        answer.extend(data);
        answer.push(data.iter().fold(0, |sum, byte| sum ^ byte));
        for bytes in [data, &answer[..]] {
            if let Ok(response) = ImuResponse::parse(protocol, bytes)
                && response.segments.len() <= ImuResponse::capacity(protocol)
            {
                let written = response.emit(protocol).expect("it fits");
                let again = ImuResponse::parse(protocol, &written).expect("it was written");
                assert_eq!(again.emit(protocol).expect("it fits"), written);
            }
            let _ = decoder.push(&Packet {
                arrival: Timestamp::default(),
                bytes: bytes.to_vec(),
            });
        }
    }
});
