//! `lsfb doctor --host`: whether this machine can record, and what to do where it cannot.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use serde::Serialize;

macro_rules! rules {
    ($name:literal) => {
        ($name, include_str!(concat!("../../../../udev/", $name)))
    };
}

/// Rules, as they belong in the system; `udev/install.sh` puts them there.
const RULES: [(&str, &str); 7] = [
    rules!("70-lsfb-camera.rules"),
    rules!("70-lsfb-can.rules"),
    rules!("70-lsfb-gnss.rules"),
    rules!("70-lsfb-imu.rules"),
    rules!("70-lsfb-microstrain.rules"),
    rules!("70-lsfb-mynt-d.rules"),
    rules!("70-lsfb-sync.rules"),
];
const INSTALL: &str = "sudo udev/install.sh --apply";
/// Groups whose members may open cameras, serial lines and USB devices.
const GROUPS: [&str; 3] = ["video", "dialout", "plugdev"];
/// A VLP-32C with dual returns fills this in four seconds, receive buffers' overhead included.
const GOOD_RMEM_BYTES: u64 = 33_554_432;
/// Below one second of it, a busy moment loses packets.
const POOR_RMEM_BYTES: u64 = 8_388_608;
const GOOD_BACKLOG: u64 = 5_000;
const GOOD_USBFS_MB: u64 = 256;
/// Dirty pages beyond this stall the writer when they are flushed at once.
const GOOD_DIRTY_BYTES: u64 = 1 << 30;
const GOOD_RT_PRIORITY: u64 = 60;
const GOOD_OPEN_FILES: u64 = 4_096;
const GOOD_MEMORY_BYTES: u64 = 2 << 30;
/// Four cameras of 1280×800 at 20 Hz, YUYV, with a fifth to spare.
const GOOD_DISK_BYTES_S: f64 = 200e6;
/// The same, grey.
const POOR_DISK_BYTES_S: f64 = 95e6;
const DISK_TEST_BYTES: usize = 256 << 20;
/// Ten minutes of YUYV.
const GOOD_FREE_BYTES: u64 = 100_000_000_000;
const POOR_FREE_BYTES: u64 = 10_000_000_000;
/// SuperSpeed, Mbit/s.
const USB3_MBIT_S: f64 = 5_000.0;

/// How a check went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum Verdict {
    /// As it should be.
    Pass,
    /// It will do, and could be better.
    Warn,
    /// Data will be lost.
    Fail,
}

/// One thing looked at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// What.
    pub name: &'static str,
    /// How it went.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// What to do; empty where nothing is to be done.
    pub remedy: String,
}

/// Everything that was looked at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HostReport {
    /// The worst verdict.
    pub verdict: Verdict,
    /// One entry per check.
    pub checks: Vec<Check>,
}

impl HostReport {
    /// Looks at this machine. `folder`: where recordings are to be written.
    pub fn of_this_machine(folder: &Path) -> Self {
        let root = Path::new("/");
        let mut checks = kernel_checks(root);
        checks.push(clock(root, &time_services()));
        checks.push(lidar_network());
        checks.extend(disk_checks(folder));
        Self::new(checks)
    }

    fn new(checks: Vec<Check>) -> Self {
        let worst = checks.iter().map(|check| check.verdict).max();
        Self {
            verdict: worst.unwrap_or(Verdict::Pass),
            checks,
        }
    }

    /// The report for people.
    pub fn text(&self) -> String {
        let mut lines = Vec::new();
        for check in &self.checks {
            let word = match check.verdict {
                Verdict::Pass => "PASS",
                Verdict::Warn => "WARN",
                Verdict::Fail => "FAIL",
            };
            lines.push(format!("{word}  {:<22} {}", check.name, check.found));
            if !check.remedy.is_empty() {
                lines.push(format!("      {:<22} → {}", "", check.remedy));
            }
        }
        lines.join("\n")
    }
}

fn check(
    name: &'static str,
    verdict: Verdict,
    found: impl Into<String>,
    remedy: impl Into<String>,
) -> Check {
    let remedy = match verdict {
        Verdict::Pass => String::new(),
        Verdict::Warn | Verdict::Fail => remedy.into(),
    };
    Check {
        name,
        verdict,
        found: found.into(),
        remedy,
    }
}

/// Good from `good` on, poor below `poor`.
fn at_least(value: f64, good: f64, poor: f64) -> Verdict {
    match value {
        v if v >= good => Verdict::Pass,
        v if v >= poor => Verdict::Warn,
        _ => Verdict::Fail,
    }
}

fn read(root: &Path, path: &str) -> Option<String> {
    let text = fs::read_to_string(root.join(path)).ok()?;
    Some(text.trim().to_owned())
}

fn number(root: &Path, path: &str) -> Option<u64> {
    read(root, path)?.split_whitespace().next()?.parse().ok()
}

/// Folders below one, in order of name.
fn folders(root: &Path, path: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(root.join(path))
        .into_iter()
        .flatten()
        .flatten();
    let mut found: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    found.sort();
    found
}

/// What can be read from files.
fn kernel_checks(root: &Path) -> Vec<Check> {
    vec![
        receive_buffer(root),
        backlog(root),
        dirty_pages(root),
        usbfs(root),
        groups(root),
        udev_rules(root),
        real_time(root),
        open_files(root),
        governor(root),
        memory(root),
        cameras(root),
        serial_latency(root),
    ]
}

fn receive_buffer(root: &Path) -> Check {
    let name = "receive buffer";
    match number(root, "proc/sys/net/core/rmem_max") {
        Some(bytes) => check(
            name,
            at_least(bytes as f64, GOOD_RMEM_BYTES as f64, POOR_RMEM_BYTES as f64),
            format!("net.core.rmem_max = {bytes}"),
            format!("sudo sysctl -w net.core.rmem_max={GOOD_RMEM_BYTES}, for good: {INSTALL}"),
        ),
        None => check(
            name,
            Verdict::Warn,
            "net.core.rmem_max cannot be read",
            "check it by hand",
        ),
    }
}

fn backlog(root: &Path) -> Check {
    let found = number(root, "proc/sys/net/core/netdev_max_backlog");
    let good = found.is_none_or(|packets| packets >= GOOD_BACKLOG);
    check(
        "network backlog",
        if good { Verdict::Pass } else { Verdict::Warn },
        match found {
            Some(packets) => format!("net.core.netdev_max_backlog = {packets}"),
            None => "not of this network namespace".to_owned(),
        },
        format!("sudo sysctl -w net.core.netdev_max_backlog={GOOD_BACKLOG}, for good: {INSTALL}"),
    )
}

fn dirty_pages(root: &Path) -> Check {
    let bytes = number(root, "proc/sys/vm/dirty_bytes").unwrap_or_default();
    let ratio = number(root, "proc/sys/vm/dirty_ratio").unwrap_or_default();
    let memory = meminfo_bytes(root, "MemTotal:").unwrap_or_default();
    let limit = match bytes {
        0 => memory / 100 * ratio,
        bytes => bytes,
    };
    check(
        "write-back",
        if limit <= GOOD_DIRTY_BYTES {
            Verdict::Pass
        } else {
            Verdict::Warn
        },
        format!("up to {} MB wait in memory for the disk", limit / 1_000_000),
        format!("sudo sysctl -w vm.dirty_bytes=536870912, for good: {INSTALL}"),
    )
}

fn usbfs(root: &Path) -> Check {
    let name = "USB buffers";
    match number(root, "sys/module/usbcore/parameters/usbfs_memory_mb") {
        // Zero is no limit.
        Some(megabytes) if megabytes == 0 || megabytes >= GOOD_USBFS_MB => check(
            name,
            Verdict::Pass,
            format!("usbfs_memory_mb = {megabytes}"),
            "",
        ),
        Some(megabytes) => check(
            name,
            Verdict::Warn,
            format!("usbfs_memory_mb = {megabytes}: too little for cameras read through libusb"),
            format!(
                "echo {GOOD_USBFS_MB} | sudo tee /sys/module/usbcore/parameters/usbfs_memory_mb, for good: {INSTALL}"
            ),
        ),
        None => check(
            name,
            Verdict::Warn,
            "this kernel has no USB",
            "record on a machine with USB, or from mock devices only",
        ),
    }
}

/// Members of groups may open devices; root may anyway.
fn groups(root: &Path) -> Check {
    let name = "groups";
    let status = read(root, "proc/self/status").unwrap_or_default();
    let ids = |field: &str| -> Vec<u32> {
        let line = status.lines().find_map(|line| line.strip_prefix(field));
        let words = line.unwrap_or_default().split_whitespace();
        words.filter_map(|word| word.parse().ok()).collect()
    };
    if ids("Uid:").get(1) == Some(&0) {
        return check(name, Verdict::Pass, "root, who may open every device", "");
    }
    let mine = [ids("Groups:"), ids("Gid:")].concat();
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

fn udev_rules(root: &Path) -> Check {
    let name = "device rules";
    let installed = |file: &str| {
        let places = [
            "etc/udev/rules.d",
            "usr/lib/udev/rules.d",
            "lib/udev/rules.d",
        ];
        places
            .iter()
            .find_map(|place| fs::read_to_string(root.join(place).join(file)).ok())
    };
    let (mut missing, mut other) = (Vec::new(), Vec::new());
    for (file, text) in RULES {
        match installed(file) {
            None => missing.push(file),
            Some(found) if found != text => other.push(file),
            Some(_) => {}
        }
    }
    if missing.is_empty() && other.is_empty() {
        return check(name, Verdict::Pass, format!("{} files", RULES.len()), "");
    }
    let mut found = Vec::new();
    if !missing.is_empty() {
        found.push(format!("missing: {}", missing.join(", ")));
    }
    if !other.is_empty() {
        found.push(format!("not those of this version: {}", other.join(", ")));
    }
    check(name, Verdict::Warn, found.join("; "), INSTALL)
}

/// The soft limit of a resource; `u64::MAX` where there is none.
fn limit(root: &Path, name: &str) -> Option<u64> {
    let limits = read(root, "proc/self/limits")?;
    let line = limits.lines().find_map(|line| line.strip_prefix(name))?;
    match line.split_whitespace().next()? {
        "unlimited" => Some(u64::MAX),
        number => number.parse().ok(),
    }
}

fn real_time(root: &Path) -> Check {
    let priority = limit(root, "Max realtime priority").unwrap_or_default();
    let locked = limit(root, "Max locked memory").unwrap_or_default();
    let effective_root = groups(root).found.starts_with("root");
    let good = (priority >= GOOD_RT_PRIORITY || effective_root) && locked >= 64 << 20;
    let locked_text = match locked {
        u64::MAX => "any amount of".to_owned(),
        bytes => format!("{} kB of", bytes / 1024),
    };
    check(
        "real-time limits",
        if good { Verdict::Pass } else { Verdict::Warn },
        format!("priority up to {priority}, {locked_text} locked memory"),
        format!("{INSTALL} --user $USER, then log in again"),
    )
}

fn open_files(root: &Path) -> Check {
    let files = limit(root, "Max open files").unwrap_or_default();
    let good = files >= GOOD_OPEN_FILES;
    check(
        "open files",
        if good { Verdict::Pass } else { Verdict::Warn },
        match files {
            u64::MAX => "unlimited".to_owned(),
            files => format!("up to {files}"),
        },
        format!("ulimit -n {GOOD_OPEN_FILES}, for good: {INSTALL}"),
    )
}

fn governor(root: &Path) -> Check {
    let name = "processor speed";
    let cores = folders(root, "sys/devices/system/cpu");
    let governors: Vec<String> = cores
        .iter()
        .filter_map(|core| read(core, "cpufreq/scaling_governor"))
        .collect();
    if governors.is_empty() {
        return check(name, Verdict::Pass, "does not change", "");
    }
    let slow: Vec<_> = governors.iter().filter(|g| *g != "performance").collect();
    match slow.first() {
        None => check(name, Verdict::Pass, "governor performance", ""),
        Some(governor) => check(
            name,
            Verdict::Warn,
            format!(
                "governor {governor} on {} of {} cores",
                slow.len(),
                governors.len()
            ),
            "sudo cpupower frequency-set -g performance",
        ),
    }
}

fn meminfo_bytes(root: &Path, field: &str) -> Option<u64> {
    let table = read(root, "proc/meminfo")?;
    let line = table.lines().find_map(|line| line.strip_prefix(field))?;
    let kilobytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes * 1024)
}

fn memory(root: &Path) -> Check {
    let free = meminfo_bytes(root, "MemAvailable:").unwrap_or_default();
    check(
        "memory",
        at_least(
            free as f64,
            GOOD_MEMORY_BYTES as f64,
            0.5 * GOOD_MEMORY_BYTES as f64,
        ),
        format!("{:.1} GB free", free as f64 / 1e9),
        "close other programs",
    )
}

/// Cameras must have a port that is fast enough.
fn cameras(root: &Path) -> Check {
    let name = "cameras";
    let hex = |id: u16| format!("{id:04x}");
    let vendor = hex(lsfb_drivers::camera::model::USB_VENDOR);
    let product = hex(lsfb_drivers::camera::model::USB_PRODUCT);
    let mut speeds = Vec::new();
    for device in folders(root, "sys/bus/usb/devices") {
        let is = |file: &str, id: &String| read(&device, file).as_ref() == Some(id);
        if is("idVendor", &vendor) && is("idProduct", &product) {
            let speed = read(&device, "speed").and_then(|s| s.parse::<f64>().ok());
            speeds.push(speed.unwrap_or_default());
        }
    }
    let slow = speeds.iter().filter(|speed| **speed < USB3_MBIT_S).count();
    match (speeds.len(), slow) {
        (0, _) => check(name, Verdict::Pass, "none is plugged in", ""),
        (units, 0) => check(name, Verdict::Pass, format!("{units} on USB 3"), ""),
        (units, slow) => check(
            name,
            Verdict::Fail,
            format!("{slow} of {units} on a slow port or cable"),
            "plug each into a USB 3 port of its own, without a hub",
        ),
    }
}

fn serial_latency(root: &Path) -> Check {
    let name = "serial converters";
    let lines = folders(root, "sys/bus/usb-serial/devices");
    let late: Vec<String> = lines
        .iter()
        .filter(|line| number(line, "latency_timer").is_some_and(|ms| ms > 1))
        .filter_map(|line| Some(line.file_name()?.to_string_lossy().into_owned()))
        .collect();
    match (lines.len(), late.len()) {
        (0, _) => check(name, Verdict::Pass, "none is plugged in", ""),
        (all, 0) => check(name, Verdict::Pass, format!("{all}, without delay"), ""),
        (_, _) => check(
            name,
            Verdict::Warn,
            format!("{} bundle bytes for several milliseconds", late.join(", ")),
            INSTALL,
        ),
    }
}

/// What the services that keep the time say.
#[derive(Clone, Debug, Default)]
struct TimeServices {
    /// `chronyc -n tracking`.
    chrony: Option<String>,
    /// `timedatectl show -p NTPSynchronized`.
    systemd: Option<String>,
}

fn time_services() -> TimeServices {
    let ask = |program: &str, arguments: &[&str]| {
        let output = Command::new(program).args(arguments).output().ok()?;
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        output.status.success().then_some(said)
    };
    TimeServices {
        chrony: ask("chronyc", &["-n", "tracking"]),
        systemd: ask("timedatectl", &["show", "-p", "NTPSynchronized"]),
    }
}

fn clock(root: &Path, services: &TimeServices) -> Check {
    let name = "clock";
    let pulse = if root.join("dev/pps0").exists() {
        ", with a pulse per second"
    } else {
        ""
    };
    if let Some(tracking) = &services.chrony {
        let field = |name: &str| {
            let line = tracking.lines().find(|line| line.starts_with(name))?;
            Some(line.split_once(':')?.1.trim().to_owned())
        };
        if field("Leap status").as_deref() == Some("Normal") {
            let offset = field("System time").unwrap_or_default();
            return check(name, Verdict::Pass, format!("chrony: {offset}{pulse}"), "");
        }
    }
    let synchronized = services
        .systemd
        .as_ref()
        .is_some_and(|said| said.trim() == "NTPSynchronized=yes");
    if synchronized || root.join("run/systemd/timesync/synchronized").exists() {
        return check(
            name,
            Verdict::Pass,
            format!("follows a time server{pulse}"),
            "",
        );
    }
    check(
        name,
        Verdict::Warn,
        format!("follows nothing{pulse}: recordings of two machines will not agree"),
        "sudo apt-get install chrony; with a GNSS receiver sudo udev/install.sh --apply --gnss",
    )
}

/// Velodyne sensors send to 192.168.1.0/24 unless told otherwise.
fn lidar_network() -> Check {
    let name = "LiDAR network";
    let addresses = nix::ifaddrs::getifaddrs().into_iter().flatten();
    let ready = addresses
        .filter_map(|interface| {
            let address = interface.address?;
            let ip = address.as_sockaddr_in()?.ip();
            (ip.octets().starts_with(&[192, 168, 1]))
                .then(|| format!("{} {ip}", interface.interface_name))
        })
        .next();
    match ready {
        Some(interface) => check(name, Verdict::Pass, interface, ""),
        None => check(
            name,
            Verdict::Warn,
            "no address in 192.168.1.0/24, where a Velodyne sends to",
            "sudo ip address add 192.168.1.100/24 dev <interface of the LiDAR>",
        ),
    }
}

/// Space and speed of the disk where recordings go.
fn disk_checks(folder: &Path) -> Vec<Check> {
    let place = folder.display();
    let mut checks = Vec::new();
    match nix::sys::statvfs::statvfs(folder) {
        Ok(disk) => {
            let free = disk.blocks_available() * disk.fragment_size();
            checks.push(check(
                "disk space",
                at_least(free as f64, GOOD_FREE_BYTES as f64, POOR_FREE_BYTES as f64),
                format!(
                    "{:.0} GB free in {place}: {:.0} min of four cameras",
                    free as f64 / 1e9,
                    free as f64 / 164e6 / 60.0
                ),
                "make room, or record to another disk",
            ));
        }
        Err(error) => checks.push(check(
            "disk space",
            Verdict::Fail,
            format!("{place}: {error}"),
            "name an existing folder",
        )),
    }
    checks.push(match write_speed(folder) {
        Ok(bytes_s) => check(
            "disk speed",
            at_least(bytes_s, GOOD_DISK_BYTES_S, POOR_DISK_BYTES_S),
            format!("{:.0} MB/s written and synced in {place}", bytes_s / 1e6),
            "four cameras of 1280×800 at 20 Hz need 82 MB/s grey, 164 MB/s in YUYV: use a faster disk or fewer frames",
        ),
        Err(error) => check(
            "disk speed",
            Verdict::Fail,
            format!("cannot write to {place}: {error}"),
            "name a folder that can be written to",
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

#[cfg(test)]
mod tests {
    use super::*;

    fn write(root: &Path, path: &str, text: &str) {
        let path = root.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    fn verdict(root: &Path, name: &str) -> Check {
        let checks = kernel_checks(root);
        checks.into_iter().find(|check| check.name == name).unwrap()
    }

    /// A machine on which nothing has been set up, and the same after `udev/install.sh`.
    #[test]
    fn what_is_missing_is_named_with_its_remedy_and_what_is_there_passes() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        write(root, "proc/sys/net/core/rmem_max", "212992\n");
        write(root, "proc/sys/net/core/netdev_max_backlog", "1000\n");
        write(root, "proc/sys/vm/dirty_bytes", "0\n");
        write(root, "proc/sys/vm/dirty_ratio", "20\n");
        write(
            root,
            "proc/meminfo",
            "MemTotal: 16000000 kB\nMemAvailable: 500000 kB\n",
        );
        write(
            root,
            "sys/module/usbcore/parameters/usbfs_memory_mb",
            "16\n",
        );
        write(
            root,
            "proc/self/status",
            "Uid:\t1000\t1000\nGid:\t1000\nGroups:\t44 1000\n",
        );
        write(
            root,
            "etc/group",
            "video:x:44:\ndialout:x:20:\nplugdev:x:46:\n",
        );
        write(
            root,
            "proc/self/limits",
            "Max open files            1024                 1048576              files\n\
             Max locked memory         8388608              8388608              bytes\n\
             Max realtime priority     0                    0\n",
        );
        write(
            root,
            "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
            "powersave\n",
        );
        write(root, "sys/bus/usb/devices/1-1/idVendor", "04b4\n");
        write(root, "sys/bus/usb/devices/1-1/idProduct", "00f9\n");
        write(root, "sys/bus/usb/devices/1-1/speed", "480\n");
        write(
            root,
            "sys/bus/usb-serial/devices/ttyUSB0/latency_timer",
            "16\n",
        );
        for (name, expected, words) in [
            (
                "receive buffer",
                Verdict::Fail,
                "net.core.rmem_max=33554432",
            ),
            ("network backlog", Verdict::Warn, "netdev_max_backlog=5000"),
            ("write-back", Verdict::Warn, "vm.dirty_bytes"),
            ("USB buffers", Verdict::Warn, "usbfs_memory_mb"),
            ("groups", Verdict::Fail, "usermod -aG dialout,plugdev"),
            ("device rules", Verdict::Warn, "install.sh"),
            ("real-time limits", Verdict::Warn, "log in again"),
            ("open files", Verdict::Warn, "ulimit -n 4096"),
            ("processor speed", Verdict::Warn, "performance"),
            ("memory", Verdict::Fail, "close other programs"),
            ("cameras", Verdict::Fail, "USB 3"),
            ("serial converters", Verdict::Warn, "install.sh"),
        ] {
            let found = verdict(root, name);
            assert_eq!(found.verdict, expected, "{found:?}");
            assert!(found.remedy.contains(words), "{found:?}");
        }

        write(root, "proc/sys/net/core/rmem_max", "33554432\n");
        write(root, "proc/sys/net/core/netdev_max_backlog", "5000\n");
        write(root, "proc/sys/vm/dirty_bytes", "536870912\n");
        write(
            root,
            "proc/meminfo",
            "MemTotal: 16000000 kB\nMemAvailable: 9000000 kB\n",
        );
        write(
            root,
            "sys/module/usbcore/parameters/usbfs_memory_mb",
            "256\n",
        );
        write(
            root,
            "proc/self/status",
            "Uid:\t1000\t1000\nGid:\t1000\nGroups:\t20 44 46\n",
        );
        write(
            root,
            "proc/self/limits",
            "Max open files            65536                1048576              files\n\
             Max locked memory         unlimited            unlimited            bytes\n\
             Max realtime priority     80                   80\n",
        );
        write(
            root,
            "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
            "performance\n",
        );
        write(root, "sys/bus/usb/devices/1-1/speed", "5000\n");
        write(
            root,
            "sys/bus/usb-serial/devices/ttyUSB0/latency_timer",
            "1\n",
        );
        for (file, text) in RULES {
            write(root, &format!("etc/udev/rules.d/{file}"), text);
        }
        let report = HostReport::new(kernel_checks(root));
        assert_eq!(report.verdict, Verdict::Pass, "{}", report.text());
        assert!(report.checks.iter().all(|check| check.remedy.is_empty()));
        write(root, "etc/udev/rules.d/70-lsfb-imu.rules", "# older\n");
        let rules = verdict(root, "device rules");
        assert!(rules.found.contains("70-lsfb-imu.rules"), "{rules:?}");
    }

    #[test]
    fn a_clock_that_follows_nothing_is_a_warning() {
        let folder = tempfile::tempdir().unwrap();
        let nothing = clock(folder.path(), &TimeServices::default());
        assert_eq!(nothing.verdict, Verdict::Warn);
        let chrony = TimeServices {
            chrony: Some(
                "System time     : 0.000012 seconds fast of NTP time\nLeap status     : Normal\n"
                    .to_owned(),
            ),
            systemd: None,
        };
        let found = clock(folder.path(), &chrony);
        assert_eq!(found.verdict, Verdict::Pass);
        assert!(found.found.contains("0.000012 seconds"), "{found:?}");
        let unsynchronized = TimeServices {
            chrony: Some("Leap status     : Not synchronised\n".to_owned()),
            systemd: Some("NTPSynchronized=yes\n".to_owned()),
        };
        assert_eq!(clock(folder.path(), &unsynchronized).verdict, Verdict::Pass);
    }

    #[test]
    fn the_disk_is_measured_and_nothing_is_left_behind() {
        let folder = tempfile::tempdir().unwrap();
        let checks = disk_checks(folder.path());
        assert_eq!(checks.len(), 2);
        assert!(checks[1].found.contains("MB/s"), "{checks:?}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        let missing = disk_checks(&folder.path().join("missing"));
        assert!(missing.iter().all(|check| check.verdict == Verdict::Fail));
    }
}
