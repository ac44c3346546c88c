//! The disk where recordings go.

use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::time::Instant;

use lsfb_types::{Finding, Limit, Verdict};

use super::{at_least, check};

/// Four cameras of 1280×800 at 20 Hz, YUYV, with a fifth to spare.
const GOOD_DISK_BYTES_S: f64 = 200e6;
/// The same, grey.
const POOR_DISK_BYTES_S: f64 = 95e6;
const DISK_TEST_BYTES: usize = 256 << 20;
/// Ten minutes of YUYV.
const GOOD_FREE_BYTES: u64 = 100_000_000_000;
const POOR_FREE_BYTES: u64 = 10_000_000_000;

/// Space and speed of the disk where recordings go.
pub(super) fn checks(folder: &Path) -> Vec<Finding> {
    let place = folder.display();
    let mut checks = Vec::new();
    match nix::sys::statvfs::statvfs(folder) {
        Ok(disk) => {
            let free = disk.blocks_available() * disk.fragment_size();
            checks.push(
                check(
                    "disk space",
                    at_least(free as f64, GOOD_FREE_BYTES as f64, POOR_FREE_BYTES as f64),
                    format!(
                        "{:.0} GB free in {place}: {:.0} min of four cameras",
                        free as f64 / 1e9,
                        free as f64 / 164e6 / 60.0
                    ),
                    "free disk space, or record to another disk",
                )
                .value((free as f64 / 1e9).round(), "GB")
                .limit(Limit::AtLeast(GOOD_FREE_BYTES as f64 / 1e9)),
            );
        }
        Err(error) => checks.push(check(
            "disk space",
            Verdict::Fail,
            format!("{place}: {error}"),
            "give an existing folder",
        )),
    }
    checks.push(match write_speed(folder) {
        Ok(bytes_s) => check(
            "disk speed",
            at_least(bytes_s, GOOD_DISK_BYTES_S, POOR_DISK_BYTES_S),
            format!("{:.0} MB/s written and synced in {place}", bytes_s / 1e6),
            "four cameras of 1280×800 at 20 Hz need 82 MB/s grey, 164 MB/s in YUYV: use a faster disk or fewer frames",
        )
        .value((bytes_s / 1e6).round(), "MB/s")
        .limit(Limit::AtLeast(GOOD_DISK_BYTES_S / 1e6)),
        Err(error) => check(
            "disk speed",
            Verdict::Fail,
            format!("cannot write to {place}: {error}"),
            "give a writable folder",
        ),
    });
    checks
}

/// Bytes per second that reach the disk, by a file that is gone afterwards.
fn write_speed(folder: &Path) -> std::io::Result<f64> {
    let path = folder.join(format!(".lsfb-disk-test-{}", std::process::id()));
    let measured = (|| {
        let mut file = fs::File::create_new(&path)?;
        // Bytes that no disk can compress away.
        let mut state = 0x9e37_79b9_7f4a_7c15_u64;
        let block: Vec<u8> = std::iter::repeat_with(|| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state.to_le_bytes()
        })
        .take(4 << 17)
        .flatten()
        .collect();
        let began = Instant::now();
        let mut written = 0;
        while written < DISK_TEST_BYTES {
            file.write_all(&block)?;
            written += block.len();
        }
        file.sync_data()?;
        Ok(written as f64 / began.elapsed().as_secs_f64())
    })();
    // Whatever went wrong, the file goes.
    let _ = fs::remove_file(&path);
    measured
}
