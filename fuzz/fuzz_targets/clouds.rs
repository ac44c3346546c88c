//! Point clouds in files of every kind.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_datasets::read_cloud;

fuzz_target!(|data: &[u8]| {
    for ending in ["pcd", "ply", "bin"] {
        let name = format!("lsfb-fuzz-{}.{ending}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, data).expect("a scratch file");
        if let Ok(cloud) = read_cloud(&path) {
            let scan = cloud.scan;
            let finite = |p: &lsfb_types::LidarPoint| p.position_m.iter().all(|c| c.is_finite());
            assert!(scan.points.iter().all(finite));
        }
    }
});
