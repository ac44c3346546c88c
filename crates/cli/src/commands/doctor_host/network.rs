//! Time and network.

use std::path::Path;
use std::process::Command;

use lsfb_types::{Finding, Verdict};

use super::check;

/// What the services that keep the time say.
#[derive(Clone, Debug, Default)]
pub(super) struct TimeServices {
    /// `chronyc -n tracking`.
    pub(super) chrony: Option<String>,
    /// `timedatectl show -p NTPSynchronized`.
    pub(super) systemd: Option<String>,
}

pub(super) fn time_services() -> TimeServices {
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

pub(super) fn clock(root: &Path, services: &TimeServices) -> Finding {
    let name = "clock";
    let pulse = if root.join("dev/pps0").exists() {
        ", with PPS"
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
            format!("synchronised to a time server{pulse}"),
            "",
        );
    }
    check(
        name,
        Verdict::Warn,
        format!("not synchronised{pulse}: recordings of two machines will not agree"),
        "sudo apt-get install chrony; with a GNSS receiver sudo udev/install.sh --apply --gnss",
    )
}

/// LiDARs are in 192.168.1.0/24 unless told otherwise: Velodyne's and Hesai's at 192.168.1.201.
pub(super) fn lidar() -> Finding {
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
            "no address in 192.168.1.0/24, to which a LiDAR sends",
            "sudo ip address add 192.168.1.100/24 dev <interface of the LiDAR>",
        ),
    }
}
