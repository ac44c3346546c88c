//! Envelopes of phones and what is inside, and the receiving side of a connection.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::sidecar::credentials::PairingCode;
use lsfb_drivers::sidecar::sensor_logger::{PushUnits, PushedBody};
use lsfb_drivers::sidecar::wire::{
    Advertise, Envelope, Hello, State, TimeRequest, TimeResponse,
};
use lsfb_drivers::sidecar::{Decoder, SidecarMessage};

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
    if let Ok(request) = TimeRequest::parse(data) {
        assert_eq!(TimeRequest::parse(&request.emit()), Ok(request));
    }
    if let Ok(response) = TimeResponse::parse(data) {
        assert_eq!(TimeResponse::parse(&response.emit()), Ok(response));
    }
    for units in [PushUnits::Standard, PushUnits::Ios] {
        let _ = PushedBody::parse(data, units);
    }
    if let Ok(state) = State::parse(data) {
        assert_eq!(State::parse(&state.emit()), Ok(state));
    }
    if let Some(Ok(code)) = std::str::from_utf8(data).ok().map(str::parse::<PairingCode>) {
        assert_eq!(code.to_text().parse(), Ok(code));
    }
    // A whole connection: envelopes, each behind its length. DATA that passes is numbered without a gap.
    let mut decoder = Decoder::new();
    let mut rest = data;
    while let Some((length, after)) = rest.split_first() {
        let (envelope, next) = after.split_at(after.len().min(usize::from(*length)));
        let before = decoder.last_seq();
        match decoder.push(envelope) {
            Ok(Some(SidecarMessage::Data { seq, .. })) => assert_eq!(seq, before + 1),
            Ok(_) => {}
            Err(_) => break,
        }
        rest = next;
    }
});
