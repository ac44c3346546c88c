//! Whether all lasers of a LiDAR see something, all around.

use lsfb_drivers::any_lidar::{Decoder, Model, Settings};
use lsfb_drivers::lidar::Azimuths;
use lsfb_recording::{Recording, message};
use lsfb_types::{Finding, LidarScan, Verdict};

use super::{Depth, DoctorConfig, Findings};
use crate::Error;
use crate::device_note::DeviceNote;
use crate::lidar::Sight;
use crate::order::Order;

/// Scans that are looked at where not everything is read: about ten seconds of them.
const SCANS: usize = 120;

/// What one LiDAR saw.
#[derive(Default)]
struct LidarCounts {
    sight: Sight,
    scans: usize,
    returns: usize,
    arrivals: Order,
}

impl LidarCounts {
    fn note(&mut self, scan: &LidarScan, lasers: Option<usize>, azimuths: &Azimuths) {
        self.sight.note(scan, lasers, azimuths);
        self.scans += 1;
        self.returns += scan.points.len();
    }

    fn finish(mut self) -> Self {
        self.sight.finish();
        self
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

    fn seen(&mut self, name: &str, seen: &LidarCounts) {
        let LidarCounts { sight, scans, .. } = seen;
        let subject = format!("device {name}");
        let of = format!("in {scans} scans checked");
        if let Some(back) = seen.arrivals.back() {
            let found = format!(
                "arrivals of its packets {back}: the host's clock was set, or captures from different times were joined"
            );
            let finding = Finding::new("arrivals", Verdict::Warn, &*subject, found);
            self.add(finding.remedy("record again, or cut the capture where it goes back"));
        }
        if *scans > 0 && seen.returns == 0 {
            let found = format!("no returns {of}");
            let finding = Finding::new("lasers", Verdict::Fail, &*subject, found);
            return self
                .add(finding.remedy(
                    "remove the cap from its window; if that does not help, it is broken",
                ));
        }
        self.add(match (sight.worst(), sight.seeing()) {
            (Some(silent), _) => {
                let verdict = match silent.are_many() {
                    true => Verdict::Fail,
                    false => Verdict::Warn,
                };
                let found = format!("{}, {of}", silent.words());
                Finding::new("lasers", verdict, &*subject, found)
                    .value(silent.rings.len() as f64, "lasers")
                    .remedy("clean the window; otherwise the sensor is broken")
            }
            (None, Some((seeing, all))) => {
                let found = format!(
                    "{seeing} of {all} lasers have returns, and none is dead between working ones, {of}"
                );
                Finding::new("lasers", Verdict::Pass, &*subject, found)
            }
            (None, None) => {
                let found = format!(
                    "cannot check all lasers: too few returns {of}, or the data does not identify the lasers"
                );
                Finding::new("lasers", Verdict::Unknown, &*subject, found)
                    .remedy("record a few seconds with objects nearby all around")
            }
        });
        if let Some(blocked) = sight.ever_blocked() {
            let finding = Finding::new("sector", Verdict::Warn, &*subject, blocked.words());
            self.add(finding.remedy("clear its view, or restrict its field of view"));
        } else if !sight.is_turn_judged() {
            let found = format!(
                "cannot check whether part of its turn is covered: too few shots {of}, or its packets were not recorded"
            );
            let finding = Finding::new("sector", Verdict::Unknown, &*subject, found);
            self.add(finding.remedy("record a few seconds, including its packets"));
        }
    }
}

fn by_packets(recording: &Recording, name: &str, most: usize) -> Result<LidarCounts, Error> {
    let mut seen = LidarCounts::default();
    let Ok(packets) = recording.packets(&format!("{name}/packets")) else {
        return Ok(seen);
    };
    let mut decoder = Decoder::new(Settings::default());
    for recorded in packets {
        // What is damaged is said elsewhere.
        let Ok(recorded) = recorded else {
            continue;
        };
        seen.arrivals.note(recorded.packet.arrival);
        if let Ok(Some(scan)) = decoder.push(&recorded.packet) {
            let lasers = decoder.found().map(|found| found.model.lasers());
            seen.note(&scan.sample, lasers, &decoder.counters().azimuths);
        }
        if seen.scans >= most {
            return Ok(seen.finish());
        }
    }
    while let Some(scan) = decoder.finish() {
        let lasers = decoder.found().map(|found| found.model.lasers());
        seen.note(&scan.sample, lasers, &decoder.counters().azimuths);
    }
    Ok(seen.finish())
}

fn by_clouds(recording: &Recording, name: &str, most: usize) -> Result<LidarCounts, Error> {
    let mut seen = LidarCounts::default();
    let model = DeviceNote::read(recording, name).and_then(|note| note.model());
    let lasers = model
        .and_then(|model| Model::from_key(&model))
        .map(Model::lasers);
    for scan in recording.scans_of(name)?.take(most).flatten() {
        seen.note(&scan.sample, lasers, &Azimuths::default());
    }
    Ok(seen.finish())
}

#[cfg(test)]
mod tests {
    use lsfb_recording::{Writer, WriterConfig};
    use lsfb_types::{LidarPoint, Stamped, Timestamp, no_progress};

    use super::*;
    use crate::doctor::examine;

    /// What is said of the lasers of a VLP-32C in a recording of so few scans, of which these lasers see something over this share of
    /// the turn.
    fn verdict(scans: i64, turn: f32, sees: impl Fn(u16) -> bool) -> (Verdict, String) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.mcap");
        let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
        let note = DeviceNote::new("lidar").with("model", "VLP-32C");
        writer
            .write_metadata(&note.record(), note.entries().clone())
            .unwrap();
        for n in 0..scans {
            let time = Timestamp::from_nanos(1_772_359_200_000_000_000 + n * 100_000_000);
            let shots = (0..360).flat_map(|k| (0..32).map(move |ring| (k, ring)));
            let points = shots.filter(|(_, ring)| sees(*ring)).map(|(k, ring)| {
                let azimuth = k as f32 / 360.0 * turn * std::f32::consts::TAU;
                LidarPoint {
                    position_m: [azimuth.cos(), azimuth.sin(), 0.0],
                    ring,
                    ..LidarPoint::default()
                }
            });
            let scan = Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: LidarScan {
                    points: points.collect(),
                },
            };
            writer.write_scan("lidar", &scan).unwrap();
        }
        writer.finish().unwrap();
        let recording = Recording::open(&path).unwrap();
        let diagnosis = examine(&recording, &DoctorConfig::default(), &no_progress).unwrap();
        let mut findings = diagnosis.judgement.findings().iter();
        let lasers = findings.find(|f| f.code == "lasers").expect("lasers");
        (lasers.verdict, lasers.what.clone())
    }

    /// Of fewer than twenty scans nothing was said.
    #[test]
    fn few_scans_are_judged_or_it_is_said_that_they_are_not() {
        let (one_left, said) = verdict(2, 1.0, |ring| ring == 7);
        assert_eq!(one_left, Verdict::Fail, "{said}");
        assert!(said.starts_with("31 of its 32 lasers"), "{said}");
        assert_eq!(verdict(2, 1.0, |ring| ring != 7).0, Verdict::Warn);
        let (none, said) = verdict(2, 1.0, |_| false);
        assert!(none == Verdict::Fail && said.contains("no returns"));
        assert_eq!(verdict(2, 1.0, |_| true).0, Verdict::Pass);
        let (part, said) = verdict(2, 0.3, |ring| ring == 7);
        assert!(part == Verdict::Unknown && said.contains("in 2 scans"));
    }
}
