//! Devices that are plugged in.

use std::path::Path;

use lsfb_types::{Finding, Limit, Verdict};

use super::{INSTALL, check, folders, number, read};

/// SuperSpeed, Mbit/s.
const USB3_MBIT_S: f64 = 5_000.0;

/// Cameras must have a port that is fast enough.
pub(super) fn cameras(root: &Path) -> Finding {
    let name = "cameras";
    let hex = |id: u16| format!("{id:04x}");
    let vendor = hex(lsfb_drivers::mynt_s::model::USB_VENDOR);
    let product = hex(lsfb_drivers::mynt_s::model::USB_PRODUCT);
    let mut speeds = Vec::new();
    for device in folders(root, "sys/bus/usb/devices") {
        let is = |file: &str, id: &String| read(&device, file).as_ref() == Some(id);
        if is("idVendor", &vendor) && is("idProduct", &product) {
            let speed = read(&device, "speed").and_then(|s| s.parse::<f64>().ok());
            speeds.push(speed.unwrap_or_default());
        }
    }
    let slow = speeds.iter().filter(|speed| **speed < USB3_MBIT_S).count();
    let found = match (speeds.len(), slow) {
        (0, _) => return check(name, Verdict::Unknown, "none is plugged in", ""),
        (units, 0) => check(name, Verdict::Pass, format!("{units} on USB 3"), ""),
        (units, slow) => check(
            name,
            Verdict::Fail,
            format!("{slow} of {units} on a slow port or cable"),
            "plug each into a USB 3 port of its own, without a hub",
        ),
    };
    found
        .value(slow as f64, "cameras")
        .limit(Limit::AtMost(0.0))
}

pub(super) fn serial_latency(root: &Path) -> Finding {
    let name = "serial converters";
    let lines = folders(root, "sys/bus/usb-serial/devices");
    let late: Vec<String> = lines
        .iter()
        .filter(|line| number(line, "latency_timer").is_some_and(|ms| ms > 1))
        .filter_map(|line| Some(line.file_name()?.to_string_lossy().into_owned()))
        .collect();
    let found = match (lines.len(), late.len()) {
        (0, _) => return check(name, Verdict::Unknown, "none is plugged in", ""),
        (all, 0) => check(name, Verdict::Pass, format!("{all}, without delay"), ""),
        (_, _) => check(
            name,
            Verdict::Warn,
            format!("{} buffer bytes for several milliseconds", late.join(", ")),
            INSTALL,
        ),
    };
    found
        .value(late.len() as f64, "converters")
        .limit(Limit::AtMost(0.0))
}
