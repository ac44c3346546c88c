//! Forms as browsers send them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_web::fields;

fuzz_target!(|data: &[u8]| {
    let found = fields("multipart/form-data; boundary=b", data);
    for field in found.iter().flatten() {
        assert!(field.bytes.len() < data.len());
    }
});
