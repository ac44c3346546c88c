use super::access::{CAN_NETWORK, RULES};
use super::network::{TimeServices, clock};
use super::*;

fn write(root: &Path, path: &str, text: &str) {
    let path = root.join(path);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

fn verdict(root: &Path, name: &str) -> Finding {
    let checks = kernel_checks(root);
    checks
        .into_iter()
        .find(|check| check.subject == name)
        .unwrap()
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
    write(root, "proc/sys/vm/dirty_background_bytes", "0\n");
    write(root, "proc/sys/vm/dirty_background_ratio", "10\n");
    let option = |name: &str, value: &str| {
        let path = format!("sys/module/uvcvideo/parameters/{name}");
        write(root, &path, value);
    };
    option("clock", "CLOCK_MONOTONIC\n");
    option("hwtimestamps", "1\n");
    option("nodrop", "0\n");
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
        "video:x:44:\ndialout:x:20:\nplugdev:x:46:\nlsfb:x:990:\n",
    );
    write(
        root,
        "proc/self/limits",
        "Max open files            1024                 1048576              files\n\
         Max locked memory         8388608              8388608              bytes\n\
         Max nice priority         0                    0\n\
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
        ("early writing", Verdict::Warn, "vm.dirty_background_bytes"),
        ("USB buffers", Verdict::Warn, "usbfs_memory_mb"),
        ("video options", Verdict::Warn, "plug the cameras in again"),
        ("CAN interface", Verdict::Warn, "install.sh"),
        ("groups", Verdict::Fail, "usermod -aG dialout,plugdev,lsfb"),
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
        // Programs read numbers, no sentences.
        let has_no_number = ["video options", "groups"].contains(&name);
        let is_judged = found.value.zip(found.limit);
        assert_eq!(is_judged.is_none(), has_no_number, "{found:?}");
        assert!(is_judged.is_none_or(|(value, limit)| !limit.holds(value)));
        let remedy = found.remedy.as_deref().unwrap_or_default();
        assert!(remedy.contains(words), "{found:?}");
    }

    write(root, "proc/sys/net/core/rmem_max", "33554432\n");
    write(root, "proc/sys/net/core/netdev_max_backlog", "5000\n");
    write(root, "proc/sys/vm/dirty_bytes", "536870912\n");
    write(root, "proc/sys/vm/dirty_background_bytes", "67108864\n");
    option("hwtimestamps", "0\n");
    option("nodrop", "1\n");
    let (file, text) = CAN_NETWORK;
    write(root, &format!("etc/systemd/network/{file}"), text);
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
        "Uid:\t1000\t1000\nGid:\t1000\nGroups:\t20 44 46 990\n",
    );
    write(
        root,
        "proc/self/limits",
        "Max open files            65536                1048576              files\n\
         Max locked memory         unlimited            unlimited            bytes\n\
         Max nice priority         35                   35\n\
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
    let judgement = Judgement::new(kernel_checks(root));
    assert_eq!(judgement.verdict(), Verdict::Pass, "{judgement:?}");
    assert!(judgement.findings().iter().all(|f| f.remedy.is_none()));
    write(root, "etc/udev/rules.d/70-lsfb-imu.rules", "# older\n");
    let rules = verdict(root, "device rules");
    assert!(rules.what.contains("70-lsfb-imu.rules"), "{rules:?}");
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
    assert!(found.what.contains("0.000012 seconds"), "{found:?}");
    let unsynchronized = TimeServices {
        chrony: Some("Leap status     : Not synchronised\n".to_owned()),
        systemd: Some("NTPSynchronized=yes\n".to_owned()),
    };
    assert_eq!(clock(folder.path(), &unsynchronized).verdict, Verdict::Pass);
}

#[test]
fn the_disk_is_measured_and_nothing_is_left_behind() {
    let folder = tempfile::tempdir().unwrap();
    let checks = disk::checks(folder.path());
    assert_eq!(checks.len(), 2);
    assert!(checks[1].what.contains("MB/s"), "{checks:?}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    let missing = disk::checks(&folder.path().join("missing"));
    assert!(missing.iter().all(|check| check.verdict == Verdict::Fail));
}

/// What `udev/` sets is looked at: nobody adds a line there without a check here.
#[test]
fn every_setting_of_the_installer_is_checked() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../udev");
    let lines = |file: &str| -> Vec<String> {
        let text = fs::read_to_string(folder.join(file)).unwrap();
        let lines = text.lines().map(str::trim);
        lines
            .filter(|line| !line.is_empty() && !line.starts_with('#'))
            .map(str::to_owned)
            .collect()
    };
    let keys = |lines: &[String], from: usize, at: &str| -> Vec<String> {
        let words = lines.iter().map(|l| l.split(at).nth(from).unwrap_or(""));
        words.map(|word| word.trim().to_owned()).collect()
    };
    assert_eq!(
        keys(&lines("60-lsfb.conf"), 0, "="),
        [
            "net.core.rmem_max",
            "net.core.netdev_max_backlog",
            "vm.dirty_background_bytes",
            "vm.dirty_bytes"
        ]
    );
    assert_eq!(
        keys(&lines("lsfb-limits.conf"), 2, " "),
        ["rtprio", "memlock", "nice", "nofile"]
    );
    let options = lines("lsfb-modprobe.conf");
    let [uvc] = options.as_slice() else {
        panic!("{options:?}");
    };
    let names: Vec<&str> = uvc
        .split_whitespace()
        .filter_map(|word| Some(word.split_once('=')?.0))
        .collect();
    // How long a control may take changes no frame.
    assert_eq!(names, ["clock", "hwtimestamps", "nodrop", "timeout"]);
    assert_eq!(lines("lsfb-tmpfiles.conf").len(), 1);
    let rules = fs::read_dir(&folder).unwrap().flatten();
    let rules = rules.filter(|e| e.path().extension().is_some_and(|e| e == "rules"));
    assert_eq!(rules.count(), RULES.len());
}
