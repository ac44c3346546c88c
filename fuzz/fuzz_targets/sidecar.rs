//! Envelopes of phones and what is inside.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::sidecar::wire::{Advertise, Envelope, Hello};

fuzz_target!(|data: &[u8]| {
    if let Ok(envelope) = Envelope::parse(data) {
        let written = envelope.emit().expect("what was read fits");
        let again = Envelope::parse(&written).expect("it was written");
        assert_eq!(again, envelope);
    }
    if let Ok(hello) = Hello::parse(data) {
        assert_eq!(Hello::parse(&hello.emit()), Ok(hello));
    }
    if let Ok(advertise) = Advertise::parse(data) {
        assert_eq!(Advertise::parse(&advertise.emit()), Ok(advertise));
    }
});
