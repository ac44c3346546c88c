//! Codebooks of VLAD vectors.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_pipeline::vlad::Codebook;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(codebook) = Codebook::from_bytes(bytes) {
        assert_eq!(codebook.to_bytes(), bytes);
    }
});
