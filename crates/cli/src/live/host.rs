//! The machine that records: disk and battery.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use lsfb_operator::{BatteryState, Level, StorageState};
use nix::sys::statvfs::statvfs;

/// Time over which the rate of writing is taken.
const RATE_WINDOW: Duration = Duration::from_secs(10);
/// With less time than this the operator should know.
const SHORT_S: f64 = 600.0;
/// With less the recording ends soon.
const VERY_SHORT_S: f64 = 120.0;
/// Free space that is little even while nothing is written.
const LITTLE_BYTES: u64 = 10_000_000_000;
const LOW_PERCENT: f64 = 25.0;
const VERY_LOW_PERCENT: f64 = 10.0;

/// Watches the disk of one recording.
#[derive(Debug)]
pub struct Storage {
    folder: PathBuf,
    /// Every part of the recording begins with it.
    stem: String,
    sizes: VecDeque<(Instant, u64)>,
}

impl Storage {
    /// Watches where `out` is going to be.
    pub fn new(out: &Path) -> Self {
        let folder = match out.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
            _ => PathBuf::from("."),
        };
        Self {
            folder,
            stem: out
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            sizes: VecDeque::new(),
        }
    }

    /// The disk now; `None` where it cannot be asked.
    pub fn state(&mut self, now: Instant) -> Option<StorageState> {
        let disk = statvfs(&self.folder).ok()?;
        let free_bytes = disk.blocks_available() * disk.fragment_size();
        self.sizes.push_back((now, self.written_bytes()));
        while self
            .sizes
            .front()
            .is_some_and(|(at, _)| now.duration_since(*at) > RATE_WINDOW)
        {
            self.sizes.pop_front();
        }
        let rate_bytes_s = match (self.sizes.front(), self.sizes.back()) {
            (Some((first_at, first)), Some((last_at, last))) if last_at > first_at => {
                last.saturating_sub(*first) as f64 / last_at.duration_since(*first_at).as_secs_f64()
            }
            _ => 0.0,
        };
        let full_in_s = (rate_bytes_s > 1.0).then(|| free_bytes as f64 / rate_bytes_s);
        let level = match full_in_s {
            Some(secs) if secs < VERY_SHORT_S => Level::Bad,
            Some(secs) if secs < SHORT_S => Level::Warning,
            None if free_bytes < LITTLE_BYTES => Level::Warning,
            _ => Level::Good,
        };
        Some(StorageState {
            level,
            free_bytes,
            rate_bytes_s,
            full_in_s,
        })
    }

    fn written_bytes(&self) -> u64 {
        let Ok(entries) = std::fs::read_dir(&self.folder) else {
            return 0;
        };
        let mine = entries.flatten().filter(|entry| {
            let name = entry.file_name();
            name.to_string_lossy().starts_with(&self.stem)
        });
        mine.filter_map(|entry| entry.metadata().ok())
            .filter(std::fs::Metadata::is_file)
            .map(|metadata| metadata.len())
            .sum()
    }
}

/// The host's battery; `None` without one.
pub fn battery() -> Option<BatteryState> {
    battery_below(Path::new("/sys/class/power_supply"))
}

fn battery_below(supplies: &Path) -> Option<BatteryState> {
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
        let level = match percent {
            _ if charging => Level::Good,
            p if p < VERY_LOW_PERCENT => Level::Bad,
            p if p < LOW_PERCENT => Level::Warning,
            _ => Level::Good,
        };
        Some(BatteryState {
            level,
            percent,
            charging,
        })
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
        assert_eq!(battery_below(folder.path()), None);
        supply("AC", &[("type", "Mains")]);
        supply(
            "hidpp_0",
            &[("type", "Battery"), ("scope", "Device"), ("capacity", "5")],
        );
        assert_eq!(battery_below(folder.path()), None);
        supply(
            "BAT0",
            &[
                ("type", "Battery"),
                ("capacity", "17"),
                ("status", "Discharging"),
            ],
        );
        let found = battery_below(folder.path()).unwrap();
        assert_eq!(
            (found.level, found.percent, found.charging),
            (Level::Warning, 17.0, false)
        );
    }

    #[test]
    fn time_to_full_comes_from_what_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("scan.mcap");
        let mut storage = Storage::new(&out);
        let began = Instant::now();
        assert_eq!(storage.state(began).unwrap().full_in_s, None);
        std::fs::write(&out, vec![0; 1_000_000]).unwrap();
        let state = storage.state(began + Duration::from_secs(1)).unwrap();
        assert!((state.rate_bytes_s - 1e6).abs() < 1.0, "{state:?}");
        let expected = state.free_bytes as f64 / 1e6;
        assert!((state.full_in_s.unwrap() - expected).abs() < 1e-3 * expected);
    }
}
