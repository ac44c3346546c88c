//! Point clouds in PCD files.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_recording::read_pcd;

fuzz_target!(|data: &[u8]| {
    let path = std::env::temp_dir().join(format!("lsfb-fuzz-{}.pcd", std::process::id()));
    std::fs::write(&path, data).expect("a scratch file");
    if let Ok(cloud) = read_pcd(&path) {
        let scan = cloud.scan;
        // Every point takes a byte at least.
        assert!(scan.points.len() <= data.len());
        let finite = |p: &lsfb_types::LidarPoint| p.position_m.iter().all(|c| c.is_finite());
        assert!(scan.points.iter().all(finite));
    }
});
