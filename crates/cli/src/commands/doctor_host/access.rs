//! What the user may do: groups, rules, limits (`udev/*.rules`, `lsfb-limits.conf`).

use std::fs;
use std::path::Path;

use lsfb_types::{Finding, Limit, Verdict};

use super::{INSTALL, check, read};

macro_rules! rules {
    ($name:literal) => {
        ($name, include_str!(concat!("../../../../../udev/", $name)))
    };
}

/// Rules, as they belong in the system; `udev/install.sh` puts them there.
pub(super) const RULES: [(&str, &str); 7] = [
    rules!("70-lsfb-camera.rules"),
    rules!("70-lsfb-can.rules"),
    rules!("70-lsfb-gnss.rules"),
    rules!("70-lsfb-imu.rules"),
    rules!("70-lsfb-microstrain.rules"),
    rules!("70-lsfb-mynt-d.rules"),
    rules!("70-lsfb-sync.rules"),
];
/// The interface of a CAN unit, for systemd-networkd.
pub(super) const CAN_NETWORK: (&str, &str) = rules!("80-lsfb-can.network");
/// Groups whose members may open cameras, serial lines and USB devices, and have the limits of `lsfb-limits.conf`.
const GROUPS: [&str; 4] = ["video", "dialout", "plugdev", "lsfb"];
const GOOD_RT_PRIORITY: u64 = 60;
/// A nice value of -15, as the kernel counts it.
const GOOD_NICE: u64 = 35;
const GOOD_OPEN_FILES: u64 = 4_096;
const GOOD_LOCKED_BYTES: u64 = 64 << 20;

/// Numbers of a field of this process's status.
fn own_ids(root: &Path, field: &str) -> Vec<u32> {
    let status = read(root, "proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(field));
    let words = line.unwrap_or_default().split_whitespace();
    words.filter_map(|word| word.parse().ok()).collect()
}

fn is_root(root: &Path) -> bool {
    own_ids(root, "Uid:").get(1) == Some(&0)
}

/// Members of groups may open devices; root may anyway.
pub(super) fn groups(root: &Path) -> Finding {
    let name = "groups";
    if is_root(root) {
        return check(name, Verdict::Pass, "root, which may open every device", "");
    }
    let mine = [own_ids(root, "Groups:"), own_ids(root, "Gid:")].concat();
    let table = read(root, "etc/group").unwrap_or_default();
    let id_of = |group: &str| -> Option<u32> {
        let line = table
            .lines()
            .find(|line| line.split(':').next() == Some(group))?;
        line.split(':').nth(2)?.parse().ok()
    };
    let missing: Vec<&str> = GROUPS
        .into_iter()
        .filter(|group| id_of(group).is_some_and(|id| !mine.contains(&id)))
        .collect();
    if missing.is_empty() {
        return check(name, Verdict::Pass, GROUPS.join(", "), "");
    }
    check(
        name,
        Verdict::Fail,
        format!("not in {}", missing.join(", ")),
        format!(
            "sudo usermod -aG {} $USER, then log in again",
            missing.join(",")
        ),
    )
}

/// Names the devices and lets users open them.
pub(super) fn device_rules(root: &Path) -> Finding {
    let places = [
        "etc/udev/rules.d",
        "usr/lib/udev/rules.d",
        "lib/udev/rules.d",
    ];
    installed(root, "device rules", &places, &RULES)
}

/// Brings the interface of a CAN unit up.
pub(super) fn can_network(root: &Path) -> Finding {
    let places = ["etc/systemd/network", "usr/lib/systemd/network"];
    installed(root, "CAN interface", &places, &[CAN_NETWORK])
}

/// Whether files of `udev/` are where the system looks for them.
fn installed(
    root: &Path,
    name: &'static str,
    places: &[&str],
    files: &[(&'static str, &str)],
) -> Finding {
    let found_in = |file: &str| {
        places
            .iter()
            .find_map(|place| fs::read_to_string(root.join(place).join(file)).ok())
    };
    let (mut missing, mut other) = (Vec::new(), Vec::new());
    for (file, text) in files {
        match found_in(file) {
            None => missing.push(*file),
            Some(found) if found != *text => other.push(*file),
            Some(_) => {}
        }
    }
    let wrong = (missing.len() + other.len()) as f64;
    let judged = |finding: Finding| finding.value(wrong, "files").limit(Limit::AtMost(0.0));
    if missing.is_empty() && other.is_empty() {
        let count = files.len();
        let files = if count == 1 { "file" } else { "files" };
        return judged(check(name, Verdict::Pass, format!("{count} {files}"), ""));
    }
    let mut found = Vec::new();
    if !missing.is_empty() {
        found.push(format!("missing: {}", missing.join(", ")));
    }
    if !other.is_empty() {
        found.push(format!("not those of this version: {}", other.join(", ")));
    }
    judged(check(name, Verdict::Warn, found.join("; "), INSTALL))
}

/// The soft limit of a resource; `u64::MAX` where there is none.
pub(super) fn limit(root: &Path, name: &str) -> Option<u64> {
    let limits = read(root, "proc/self/limits")?;
    let line = limits.lines().find_map(|line| line.strip_prefix(name))?;
    match line.split_whitespace().next()? {
        "unlimited" => Some(u64::MAX),
        number => number.parse().ok(),
    }
}

pub(super) fn real_time(root: &Path) -> Finding {
    let priority = limit(root, "Max realtime priority").unwrap_or_default();
    let locked = limit(root, "Max locked memory").unwrap_or_default();
    // 20 less the lowest nice value that may be asked for.
    let nice = limit(root, "Max nice priority").unwrap_or_default();
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    // What the number says, the number, its unit, the least that is wanted of it.
    let priorities = [
        (
            format!("priority up to {priority}"),
            priority as f64,
            GOOD_RT_PRIORITY as f64,
        ),
        (format!("nice limit {nice}"), nice as f64, GOOD_NICE as f64),
    ];
    let memory = match locked {
        u64::MAX => "unlimited locked memory".to_owned(),
        bytes => format!("{:.1} MiB of locked memory", mib(bytes)),
    };
    let needs_priorities = !is_root(root);
    let priorities = priorities
        .into_iter()
        .map(|(said, value, least)| (said, value, "", least, needs_priorities));
    let mut all: Vec<_> = priorities.collect();
    all.push((memory, mib(locked), "MiB", mib(GOOD_LOCKED_BYTES), true));
    // The number of the finding is the first that is too low, said last: its limit follows.
    let low = all
        .iter()
        .position(|(_, value, _, least, counts)| *counts && value < least);
    if let Some(low) = low {
        let low = all.remove(low);
        all.push(low);
    }
    let said: Vec<&str> = all.iter().map(|(said, ..)| said.as_str()).collect();
    let finding = check(
        "real-time limits",
        Verdict::Warn.unless(low.is_none()),
        said.join(", "),
        format!("{INSTALL} --user $USER, then log in again"),
    );
    match all.last() {
        Some((_, value, unit, least, _)) if locked != u64::MAX || low.is_some() => {
            finding.value(*value, unit).limit(Limit::AtLeast(*least))
        }
        _ => finding,
    }
}

pub(super) fn open_files(root: &Path) -> Finding {
    let files = limit(root, "Max open files").unwrap_or_default();
    let good = files >= GOOD_OPEN_FILES;
    check(
        "open files",
        Verdict::Warn.unless(good),
        match files {
            u64::MAX => "unlimited".to_owned(),
            files => format!("up to {files}"),
        },
        format!("ulimit -n {GOOD_OPEN_FILES}; to make it permanent: {INSTALL}"),
    )
    .value(files as f64, "files")
    .limit(Limit::AtLeast(GOOD_OPEN_FILES as f64))
}
