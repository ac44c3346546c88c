//! Problems of other programs, as the solver's examples read them: pose graphs in g2o format, bundle adjustment in the large,
//! stereo odometry.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_problems::{bal, g2o, stereo};
use lsfb_solver::Kernel;

fuzz_target!(|data: &[u8]| {
    let Some((&kind, data)) = data.split_first() else {
        return;
    };
    let text = String::from_utf8_lossy(data);
    match kind {
        b'b' => {
            if let Ok(found) = bal::parse(&text, Kernel::Squared) {
                let words = text.split_ascii_whitespace().count();
                assert!(9 * found.cameras.len() + 3 * found.points.len() <= words);
            }
        }
        b'g' => {
            if let Ok(found) = g2o::parse(&text) {
                assert!(found.poses.len() + found.edges <= text.lines().count());
                for pose in &found.poses {
                    let _ = found.problem.value(*pose);
                }
            }
        }
        _ => {
            let mut parts = text.split('\0').map(str::to_owned);
            let mut next = || parts.next().unwrap_or_default();
            let texts = stereo::Texts {
                calibration: next(),
                poses: next(),
                factors: next(),
            };
            let _ = stereo::parse(&texts);
        }
    }
});
