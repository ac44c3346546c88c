//! Trajectories and rigs as text.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_geometry::Rig;
use lsfb_recording::{read_tum, write_tum};

fuzz_target!(|data: &[u8]| {
    let path = std::env::temp_dir().join(format!("lsfb-fuzz-{}.tum", std::process::id()));
    std::fs::write(&path, data).expect("a scratch file");
    if let Ok(trajectory) = read_tum(&path) {
        write_tum(&path, &trajectory).expect("a scratch file");
        read_tum(&path).expect("it was written");
    }
    if let Ok(text) = std::str::from_utf8(data) {
        let _ = Rig::from_toml(text, "fuzz");
    }
});
