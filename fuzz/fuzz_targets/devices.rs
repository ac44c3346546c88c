//! Lists of devices, as people write them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_capture::{DevicesConfig, Session};

fuzz_target!(|data: &[u8]| {
    let folder = std::env::temp_dir().join(format!("lsfb-fuzz-{}-devices", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a scratch folder");
    let list = folder.join("devices.toml");
    std::fs::write(&list, data).expect("a scratch file");
    if let Ok(mut config) = DevicesConfig::read(&list) {
        let _ = config.expected_bytes_per_sec();
        let text = config.to_toml();
        std::fs::write(&list, &text).expect("a scratch file");
        assert_eq!(
            DevicesConfig::read(&list).map(|again| again.to_toml()).ok(),
            Some(text)
        );
        // Nothing listens on the network here.
        (config.sidecar, config.rig) = (None, None);
        config.lidars.clear();
        let _ = Session::open(&config);
    }
});
