//! How the devices are doing: the recorder's health, and how their clocks agree by what passes the tap.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use lsfb_capture::health::{self, DeviceHealth, Snapshot};
use lsfb_capture::{DevicesConfig, Ending, StreamReport, Tapped};
use lsfb_operator::{Level, StreamState, SyncState};
use lsfb_types::Timestamp;

use super::host;

/// Time over which rates are taken.
const RATE_WINDOW: Duration = Duration::from_secs(2);
/// Time over which a clock's smallest delay is looked for.
const CLOCK_WINDOW: Duration = Duration::from_secs(4);

/// All devices of a recording.
#[derive(Debug)]
pub struct Streams {
    /// In the order of the report.
    streams: Vec<Stream>,
    /// Images of a stereo unit make one frame.
    units: BTreeMap<String, usize>,
    clocks: BTreeMap<String, VecDeque<(Instant, i64)>>,
    lost: u64,
}

#[derive(Debug)]
struct Stream {
    state: StreamState,
    /// Samples that make one on the screen.
    per_sample: usize,
    counts: VecDeque<(Instant, u64)>,
}

impl Streams {
    /// For the devices that a recording is to have.
    pub fn new(devices: &DevicesConfig) -> Self {
        let units = devices.cameras.iter();
        Self {
            streams: Vec::new(),
            units: units
                .map(|unit| (unit.names.join("+"), unit.names.len()))
                .collect(),
            clocks: BTreeMap::new(),
            lost: 0,
        }
    }

    /// Takes what passes the tap.
    pub fn note(&mut self, entry: &Tapped, now: Instant) {
        match entry {
            Tapped::Image { camera, image } => self.delay(camera, image.time, image.arrival, now),
            Tapped::Imu { imu, sample } => self.delay(imu, sample.time, sample.arrival, now),
            Tapped::Scan { lidar, scan, .. } => {
                // A scan is stamped by its first packet.
                self.delay(lidar, scan.time, scan.arrival, now);
            }
            Tapped::Message { .. } => {}
        }
    }

    fn delay(&mut self, device: &str, time: Timestamp, arrival: Timestamp, now: Instant) {
        let delays = self.clocks.entry(device.to_owned()).or_default();
        // The smallest of each tenth of a second is enough.
        let delay_ns = arrival - time;
        match delays.back_mut() {
            Some((at, smallest)) if now.duration_since(*at) < Duration::from_millis(100) => {
                *smallest = delay_ns.min(*smallest);
            }
            _ => delays.push_back((now, delay_ns)),
        }
    }

    /// Takes what the recorder says of its devices.
    pub fn take(&mut self, snapshot: &Snapshot, now: Instant) {
        self.lost = snapshot.lost;
        for device in &snapshot.devices {
            let stream = self.stream(&device.name);
            stream.count(device.decoded, now);
            stream.state.level = level(device);
            stream.state.problem.clone_from(&device.problem);
            stream.state.lost = device.lost;
        }
    }

    /// What became of them in the end.
    pub fn end(&mut self, reports: &[StreamReport]) {
        let now = Instant::now();
        for report in reports {
            let stream = self.stream(&report.name);
            stream.count(report.decoded, now);
            stream.state.lost = report.lost();
            (stream.state.level, stream.state.problem) = match &report.ending {
                Ending::Lost(why) => (Level::Bad, why.clone()),
                _ if report.lost() > 0 => (Level::Warning, String::new()),
                _ => (Level::Good, String::new()),
            };
        }
    }

    fn stream(&mut self, name: &str) -> &mut Stream {
        let known = self.streams.iter().position(|s| s.state.name == name);
        let index = known.unwrap_or_else(|| {
            self.streams.push(Stream {
                state: StreamState {
                    name: name.to_owned(),
                    ..StreamState::default()
                },
                per_sample: self.units.get(name).copied().unwrap_or(1).max(1),
                counts: VecDeque::new(),
            });
            self.streams.len() - 1
        });
        &mut self.streams[index]
    }

    /// Everything that should have been recorded and was not.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// One line per device.
    pub fn states(&self) -> Vec<StreamState> {
        self.streams.iter().map(|s| s.state.clone()).collect()
    }

    /// How the clocks agree.
    pub fn sync(&mut self, now: Instant) -> SyncState {
        let mut delays_ms: Vec<(f64, &str)> = Vec::new();
        for (name, delays) in &mut self.clocks {
            while delays
                .front()
                .is_some_and(|(at, _)| now.duration_since(*at) > CLOCK_WINDOW)
            {
                delays.pop_front();
            }
            let smallest = delays.iter().map(|(_, delay)| *delay).min();
            delays_ms.extend(smallest.map(|ns| (ns as f64 * 1e-6, name.as_str())));
        }
        SyncState::of_delays(delays_ms)
    }
}

/// The recorder's words for the page's; of a device that has sent nothing yet, nothing is known.
fn level(device: &DeviceHealth) -> Level {
    match device.level {
        health::Level::Ok if device.received == 0 => Level::Unknown,
        level => host::shown(level),
    }
}

impl Stream {
    fn count(&mut self, decoded: u64, now: Instant) {
        self.counts.push_back((now, decoded));
        while self.counts.len() > 2
            && self
                .counts
                .front()
                .is_some_and(|(at, _)| now.duration_since(*at) > RATE_WINDOW)
        {
            self.counts.pop_front();
        }
        self.state.samples = decoded / self.per_sample as u64;
        self.state.rate_hz = match (self.counts.front(), self.counts.back()) {
            (Some((first_at, first)), Some((last_at, last))) if last_at > first_at => {
                let span_s = last_at.duration_since(*first_at).as_secs_f64();
                last.saturating_sub(*first) as f64 / span_s / self.per_sample as f64
            }
            _ => 0.0,
        };
    }
}

#[cfg(test)]
mod tests {
    use lsfb_types::{ImuSample, LidarScan, Stamped};

    use super::*;

    fn snapshot(decoded: u64, missing: u64, problem: &str) -> Snapshot {
        Snapshot {
            devices: vec![DeviceHealth {
                name: "cam0+cam1".to_owned(),
                received: decoded,
                decoded,
                missing,
                lost: missing,
                problem: problem.to_owned(),
                level: if problem.is_empty() {
                    health::Level::Ok
                } else {
                    health::Level::Error
                },
                ..DeviceHealth::default()
            }],
            lost: missing,
            ..Snapshot::default()
        }
    }

    fn stamped<T>(time_ns: i64, arrival_ns: i64, sample: T) -> Stamped<T> {
        Stamped {
            time: Timestamp::from_nanos(time_ns),
            arrival: Timestamp::from_nanos(arrival_ns),
            device_ticks: 0,
            sample,
        }
    }

    #[test]
    fn frames_are_counted_as_the_unit_sends_them_and_problems_are_passed_on() {
        let list = "[[camera]]\npath = \"front\"\nnames = [\"cam0\", \"cam1\"]\n";
        let devices: DevicesConfig = toml::from_str(list).unwrap();
        let mut streams = Streams::new(&devices);
        let began = Instant::now();
        streams.take(&snapshot(0, 0, ""), began);
        assert_eq!(streams.states()[0].level, Level::Unknown);
        for half in 1..=8 {
            let now = began + Duration::from_millis(500 * half);
            streams.take(&snapshot(20 * half, 0, ""), now);
        }
        let state = &streams.states()[0];
        assert_eq!((state.level, state.samples), (Level::Good, 80));
        assert!((state.rate_hz - 20.0).abs() < 1e-6, "{state:?}");
        let now = began + Duration::from_millis(4_500);
        streams.take(&snapshot(160, 3, "silent for 1.5 s"), now);
        let state = &streams.states()[0];
        assert_eq!((state.level, state.lost), (Level::Bad, 3));
        assert_eq!(
            (streams.lost(), state.problem.as_str()),
            (3, "silent for 1.5 s")
        );
    }

    #[test]
    fn a_clock_a_second_off_is_named() {
        let mut streams = Streams::new(&DevicesConfig::default());
        let now = Instant::now();
        let ms = 1_000_000;
        let imu = |delay_ms: i64| Tapped::Imu {
            imu: "imu0".to_owned(),
            sample: stamped(0, delay_ms * ms, ImuSample::default()),
        };
        let scan = || Tapped::Scan {
            lidar: "lidar".to_owned(),
            scan: stamped(0, 12 * ms, LidarScan::default()),
            offered: now,
        };
        streams.note(&imu(2), now);
        assert_eq!(streams.sync(now), SyncState::default());
        streams.note(&scan(), now);
        let sync = streams.sync(now);
        assert_eq!(sync.level, Level::Good);
        assert!((sync.spread_ms.unwrap() - 10.0).abs() < 1e-9);
        let later = now + Duration::from_secs(5);
        streams.note(&imu(1_003), later);
        streams.note(&scan(), later);
        let sync = streams.sync(later);
        assert_eq!(sync.level, Level::Bad);
        assert!(
            sync.problem.contains("imu0") && sync.problem.contains("991 ms"),
            "{sync:?}"
        );
    }
}
