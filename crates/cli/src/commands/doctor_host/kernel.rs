//! What the kernel is set to: `udev/60-lsfb.conf`, `lsfb-tmpfiles.conf`, `lsfb-modprobe.conf`.

use std::path::Path;

use lsfb_types::{Finding, Limit, Verdict};

use super::{INSTALL, at_least, check, number, read};
use crate::memory::meminfo_bytes;

/// A VLP-32C with dual returns fills this in four seconds, receive buffers' overhead included.
const GOOD_RMEM_BYTES: u64 = 33_554_432;
/// Below one second of it, a busy moment loses packets.
const POOR_RMEM_BYTES: u64 = 8_388_608;
const GOOD_BACKLOG: u64 = 5_000;
const GOOD_USBFS_MB: u64 = 256;
/// Dirty pages beyond this stall the writer when they are flushed at once.
const GOOD_DIRTY_BYTES: u64 = 1 << 30;
/// Writing that begins later than this comes in bursts.
const GOOD_BACKGROUND_BYTES: u64 = 256 << 20;
/// Options of the driver of UVC cameras, as `lsfb-modprobe.conf` sets them.
const VIDEO_OPTIONS: [(&str, &str, &[&str]); 3] = [
    ("clock", "CLOCK_MONOTONIC", &["CLOCK_MONOTONIC"]),
    ("hwtimestamps", "0", &["0", "N"]),
    ("nodrop", "1", &["1", "Y"]),
];

pub(super) fn receive_buffer(root: &Path) -> Finding {
    let name = "receive buffer";
    match number(root, "proc/sys/net/core/rmem_max") {
        Some(bytes) => check(
            name,
            at_least(bytes as f64, GOOD_RMEM_BYTES as f64, POOR_RMEM_BYTES as f64),
            format!("net.core.rmem_max = {bytes}"),
            format!("sudo sysctl -w net.core.rmem_max={GOOD_RMEM_BYTES}; to make it permanent: {INSTALL}"),
        )
        .value(bytes as f64, "bytes")
        .limit(Limit::AtLeast(GOOD_RMEM_BYTES as f64)),
        None => check(
            name,
            Verdict::Unknown,
            "net.core.rmem_max cannot be read",
            "check it by hand",
        ),
    }
}

pub(super) fn backlog(root: &Path) -> Finding {
    let name = "network backlog";
    let Some(packets) = number(root, "proc/sys/net/core/netdev_max_backlog") else {
        let what = "not visible in this network namespace";
        return check(name, Verdict::Unknown, what, "check it on the host");
    };
    let what = format!("net.core.netdev_max_backlog = {packets}");
    check(name, Verdict::Warn, what, "")
        .judged(packets as f64, "packets", Limit::AtLeast(GOOD_BACKLOG as f64))
        .remedy(format!(
            "sudo sysctl -w net.core.netdev_max_backlog={GOOD_BACKLOG}; to make it permanent: {INSTALL}"
        ))
}

pub(super) fn dirty_pages(root: &Path) -> Finding {
    let bytes = number(root, "proc/sys/vm/dirty_bytes").unwrap_or_default();
    let ratio = number(root, "proc/sys/vm/dirty_ratio").unwrap_or_default();
    let memory = meminfo_bytes(root, "MemTotal:").unwrap_or_default();
    let limit = match bytes {
        0 => memory / 100 * ratio,
        bytes => bytes,
    };
    check(
        "write-back",
        Verdict::Warn.unless(limit <= GOOD_DIRTY_BYTES),
        format!(
            "up to {} MB are buffered in memory before writing to disk",
            limit / 1_000_000
        ),
        format!("sudo sysctl -w vm.dirty_bytes=536870912; to make it permanent: {INSTALL}"),
    )
    .value((limit / 1_000_000) as f64, "MB")
    .limit(Limit::AtMost((GOOD_DIRTY_BYTES / 1_000_000) as f64))
}

pub(super) fn usbfs(root: &Path) -> Finding {
    let name = "USB buffers";
    match number(root, "sys/module/usbcore/parameters/usbfs_memory_mb") {
        Some(0) => check(name, Verdict::Pass, "usbfs_memory_mb = 0: no limit", ""),
        Some(megabytes) => {
            let good = megabytes >= GOOD_USBFS_MB;
            let why = if good {
                ""
            } else {
                ": too little for cameras read through libusb"
            };
            let what = format!("usbfs_memory_mb = {megabytes}{why}");
            let remedy = format!(
                "echo {GOOD_USBFS_MB} | sudo tee /sys/module/usbcore/parameters/usbfs_memory_mb; to make it permanent: {INSTALL}"
            );
            check(name, Verdict::Warn.unless(good), what, remedy)
                .value(megabytes as f64, "MB")
                .limit(Limit::AtLeast(GOOD_USBFS_MB as f64))
        }
        None => check(
            name,
            Verdict::Warn,
            "this kernel has no USB",
            "record on a machine with USB, or from mock devices only",
        ),
    }
}

/// From how many bytes on the kernel begins to write by itself.
pub(super) fn early_writing(root: &Path) -> Finding {
    let bytes = number(root, "proc/sys/vm/dirty_background_bytes").unwrap_or_default();
    let ratio = number(root, "proc/sys/vm/dirty_background_ratio").unwrap_or_default();
    let memory = meminfo_bytes(root, "MemTotal:").unwrap_or_default();
    let start = match bytes {
        0 => memory / 100 * ratio,
        bytes => bytes,
    };
    check(
        "early writing",
        Verdict::Warn.unless(start <= GOOD_BACKGROUND_BYTES),
        format!("starts at {} MB", start / 1_000_000),
        format!(
            "sudo sysctl -w vm.dirty_background_bytes=67108864; to make it permanent: {INSTALL}"
        ),
    )
    .value((start / 1_000_000) as f64, "MB")
    .limit(Limit::AtMost((GOOD_BACKGROUND_BYTES / 1_000_000) as f64))
}

/// How frames of cameras are stamped, and whether damaged ones are handed over.
pub(super) fn video_options(root: &Path) -> Finding {
    let name = "video options";
    let parameters = "sys/module/uvcvideo/parameters";
    if !root.join(parameters).exists() {
        return check(
            name,
            Verdict::Unknown,
            "no UVC camera has been plugged in yet",
            "",
        );
    }
    let wrong: Vec<String> = VIDEO_OPTIONS
        .iter()
        .filter_map(|(option, wanted, good)| {
            let found = read(root, &format!("{parameters}/{option}")).unwrap_or_default();
            let is_good = good.contains(&found.as_str());
            (!is_good).then(|| format!("{option} = {found} instead of {wanted}"))
        })
        .collect();
    if wrong.is_empty() {
        return check(
            name,
            Verdict::Pass,
            "monotonic stamps, no dropped frames",
            "",
        );
    }
    check(
        name,
        Verdict::Warn,
        wrong.join(", "),
        format!("{INSTALL}, then plug the cameras in again"),
    )
}
