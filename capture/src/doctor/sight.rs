//! Whether all lasers of a LiDAR see something, all around.

use lsfb_drivers::any_lidar::{Decoder, Model, Settings};
use lsfb_drivers::lidar::Azimuths;
use lsfb_recording::{Recording, message};
use lsfb_types::{Finding, LidarScan, Verdict};

use super::{Depth, DoctorConfig, Findings};
use crate::Error;
use crate::device_note::DeviceNote;
use crate::lidar::Sight;

/// Scans that are looked at where not everything is read: about ten seconds of them.
const SCANS: usize = 120;

/// What one LiDAR saw.
#[derive(Default)]
struct Seen {
    sight: Sight,
    scans: usize,
}

impl Seen {
    fn note(&mut self, scan: &LidarScan, lasers: Option<usize>, azimuths: &Azimuths) {
        self.sight.note(scan, lasers, azimuths);
        self.scans += 1;
    }
}

impl Findings {
    /// Of each LiDAR, by its packets where they are there: these say where it fired and saw nothing.
    pub(super) fn sight(
        &mut self,
        recording: &Recording,
        config: &DoctorConfig,
    ) -> Result<(), Error> {
        let most = match config.read {
            Depth::Indexes => SCANS,
            Depth::Everything => usize::MAX,
        };
        let topics = recording.topics().iter();
        let mut lidars: Vec<&str> = topics
            .filter_map(|topic| {
                let end = match topic.schema == message::POINT_CLOUD.name {
                    true => "/points",
                    false if message::holds_lidar_packets(&topic.schema) => "/packets",
                    false => return None,
                };
                topic.topic.strip_prefix('/')?.strip_suffix(end)
            })
            .filter(|name| !name.contains('/'))
            .collect();
        lidars.sort_unstable();
        lidars.dedup();
        for name in lidars {
            let mut seen = by_packets(recording, name, most)?;
            if seen.scans == 0 {
                seen = by_clouds(recording, name, most)?;
            }
            self.seen(name, &seen);
        }
        Ok(())
    }

    fn seen(&mut self, name: &str, seen: &Seen) {
        let Seen { sight, scans } = seen;
        let subject = format!("device {name}");
        let of = format!("in {scans} scans that were looked at");
        let worst = sight.worst();
        if let Some(silent) = worst {
            let verdict = match silent.are_many() {
                true => Verdict::Fail,
                false => Verdict::Warn,
            };
            let found = format!("{}, {of}", silent.words());
            let finding = Finding::new("lasers", verdict, &*subject, found)
                .value(silent.rings.len() as f64, "lasers");
            self.add(finding.remedy("clean its window; if that does not help, it is broken"));
        }
        if let Some(blocked) = sight.blocked() {
            let finding = Finding::new("sector", Verdict::Warn, &*subject, blocked.words());
            self.add(
                finding.remedy(
                    "free its view, or set its field of view so that it does not fire there",
                ),
            );
        }
    }
}

fn by_packets(recording: &Recording, name: &str, most: usize) -> Result<Seen, Error> {
    let mut seen = Seen::default();
    let Ok(packets) = recording.packets(&format!("{name}/packets")) else {
        return Ok(seen);
    };
    let mut decoder = Decoder::new(Settings::default());
    for recorded in packets {
        // What is damaged is said elsewhere.
        let Ok(recorded) = recorded else {
            continue;
        };
        if let Ok(Some(scan)) = decoder.push(&recorded.packet) {
            let lasers = decoder.found().map(|found| found.model.lasers());
            seen.note(&scan.sample, lasers, &decoder.counters().azimuths);
        }
        if seen.scans >= most {
            break;
        }
    }
    Ok(seen)
}

fn by_clouds(recording: &Recording, name: &str, most: usize) -> Result<Seen, Error> {
    let mut seen = Seen::default();
    let model = DeviceNote::read(recording, name).and_then(|note| note.model());
    let lasers = model
        .and_then(|model| Model::from_key(&model))
        .map(Model::lasers);
    for scan in recording.scans_of(name)?.take(most).flatten() {
        seen.note(&scan.sample, lasers, &Azimuths::default());
    }
    Ok(seen)
}
