//! The machine that records: disk and battery.

use std::path::{Path, PathBuf};

use lsfb_capture::health::{self, StorageHealth};
use lsfb_operator::{BatteryState, Level, StorageState};
use nix::sys::statvfs::statvfs;

/// The recorder's word for how bad something is as the page's colour.
pub fn shown(level: health::Level) -> Level {
    match level {
        health::Level::Ok => Level::Good,
        health::Level::Warn => Level::Warning,
        health::Level::Error => Level::Bad,
    }
}

/// The disk while a recording is written.
pub fn recording_storage(health: &StorageHealth) -> StorageState {
    StorageState {
        level: shown(health.level),
        free_bytes: health.free_bytes,
        rate_bytes_s: health.rate_bytes_per_sec,
        full_in_s: health.secs_to_full,
        problem: health.problem.clone(),
    }
}

/// The disk of a folder while nothing is written; `None` where it cannot be asked.
pub fn idle_storage(folder: &Path) -> Option<StorageState> {
    let disk = statvfs(folder).ok()?;
    let free_bytes = disk.blocks_available() * disk.fragment_size();
    Some(StorageState::idle(free_bytes))
}

/// Where the kernel tells of batteries.
pub const POWER_SUPPLIES: &str = "/sys/class/power_supply";

/// The host's battery, of those below a folder; `None` without one.
pub fn battery(supplies: &Path) -> Option<BatteryState> {
    let mut folders: Vec<PathBuf> = std::fs::read_dir(supplies)
        .ok()?
        .flatten()
        .map(|entry| entry.path())
        .collect();
    folders.sort();
    folders.iter().find_map(|folder| {
        let read = |name: &str| {
            let text = std::fs::read_to_string(folder.join(name)).ok()?;
            Some(text.trim().to_owned())
        };
        // Mice and pens have batteries, too.
        let of_device = read("scope").is_some_and(|scope| scope == "Device");
        if read("type")? != "Battery" || of_device {
            return None;
        }
        let percent: f64 = read("capacity")?.parse().ok()?;
        let charging = read("status").is_some_and(|s| s == "Charging" || s == "Full");
        Some(BatteryState::new(percent, charging))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hosts_battery_is_found_among_others() {
        let folder = tempfile::tempdir().unwrap();
        let supply = |name: &str, files: &[(&str, &str)]| {
            let path = folder.path().join(name);
            std::fs::create_dir(&path).unwrap();
            for (file, text) in files {
                std::fs::write(path.join(file), format!("{text}\n")).unwrap();
            }
        };
        assert_eq!(battery(folder.path()), None);
        supply("AC", &[("type", "Mains")]);
        supply(
            "hidpp_0",
            &[("type", "Battery"), ("scope", "Device"), ("capacity", "5")],
        );
        assert_eq!(battery(folder.path()), None);
        supply(
            "BAT0",
            &[
                ("type", "Battery"),
                ("capacity", "17"),
                ("status", "Discharging"),
            ],
        );
        let found = battery(folder.path()).unwrap();
        assert_eq!(
            (found.level, found.percent, found.charging),
            (Level::Warning, 17.0, false)
        );
    }
}
