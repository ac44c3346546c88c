//! How the devices are doing, from what passes the tap.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use lsfb_capture::{DevicesConfig, Ending, StreamReport, Tapped};
use lsfb_operator::{Level, StreamState, SyncState};
use lsfb_types::Timestamp;

/// Time over which rates are taken.
const RATE_WINDOW: Duration = Duration::from_secs(2);
/// A device silent for this long has a problem.
const SILENT: Duration = Duration::from_millis(1_000);
/// Time that devices have to send something at first.
const PATIENCE: Duration = Duration::from_secs(5);
/// Time over which a clock's smallest delay is looked for.
const CLOCK_WINDOW: Duration = Duration::from_secs(4);
/// Transport delays differ by less.
const SYNC_GOOD_MS: f64 = 150.0;
/// More than any transport: a clock is wrong.
const SYNC_BAD_MS: f64 = 500.0;

/// All devices of a recording.
#[derive(Debug)]
pub struct Streams {
    began: Instant,
    streams: BTreeMap<String, Stream>,
    /// Unit of each camera.
    units: BTreeMap<String, String>,
}

#[derive(Debug)]
struct Stream {
    expected: Expected,
    /// Samples that make one on the screen: a frame of a stereo unit is two images.
    per_sample: u64,
    report: StreamReport,
    counts: VecDeque<(Instant, u64)>,
    heard: Option<Instant>,
    delays_ns: VecDeque<(Instant, i64)>,
}

/// Whether a device must send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Expected {
    Always,
    /// A phone comes when it comes.
    Perhaps,
}

impl Streams {
    /// The devices that a recording is to have.
    pub fn new(devices: &DevicesConfig) -> Self {
        let mut streams = BTreeMap::new();
        let mut units = BTreeMap::new();
        let mut add = |name: &str, expected, per_sample| {
            let stream = Stream {
                expected,
                per_sample,
                report: StreamReport::default(),
                counts: VecDeque::new(),
                heard: None,
                delays_ns: VecDeque::new(),
            };
            streams.insert(name.to_owned(), stream);
        };
        if devices.lidar.is_some() {
            add("lidar", Expected::Always, 1);
        }
        if devices.imu.is_some() {
            add("imu0", Expected::Always, 1);
        }
        if devices.sidecar.is_some() {
            add("sidecar", Expected::Perhaps, 1);
        }
        for unit in &devices.cameras {
            let name = unit.names.join("+");
            add(&name, Expected::Always, 2);
            for camera in &unit.names {
                units.insert(camera.clone(), name.clone());
            }
        }
        Self {
            began: Instant::now(),
            streams,
            units,
        }
    }

    /// Takes what passes.
    pub fn note(&mut self, entry: &Tapped, now: Instant) {
        match entry {
            Tapped::Counts(report) => {
                if let Some(stream) = self.streams.get_mut(&report.name) {
                    stream.count(report, now);
                }
            }
            Tapped::Image { camera, image } => {
                if let Some(unit) = self.units.get(camera)
                    && let Some(stream) = self.streams.get_mut(unit)
                {
                    stream.delay(image.time, image.arrival, now);
                }
            }
            Tapped::Imu { imu, sample } => {
                if let Some(stream) = self.streams.get_mut(*imu) {
                    stream.delay(sample.time, sample.arrival, now);
                }
            }
            Tapped::Scan(scan) => {
                let last = scan.sample.points.iter().map(|p| p.time_offset_ns).max();
                let end = scan.time.plus_nanos(last.map_or(0, i64::from));
                if let Some(stream) = self.streams.get_mut("lidar") {
                    stream.delay(end, scan.arrival, now);
                }
            }
            Tapped::Message { .. } => {}
        }
    }

    /// What became of them.
    pub fn end(&mut self, reports: &[StreamReport]) {
        let now = Instant::now();
        for report in reports {
            if let Some(stream) = self.streams.get_mut(&report.name) {
                stream.count(report, now);
            }
        }
    }

    /// Everything that should have been recorded and was not.
    pub fn lost(&self) -> u64 {
        self.streams.values().map(|s| s.report.lost()).sum()
    }

    /// One line per device.
    pub fn states(&self, now: Instant) -> Vec<StreamState> {
        let streams = self.streams.iter();
        streams
            .map(|(name, stream)| stream.state(name, self.began, now))
            .collect()
    }

    /// How the clocks agree: a sample's delay is its transport's, which is short, and its clock's error.
    pub fn sync(&mut self, now: Instant) -> SyncState {
        let mut delays_ms: Vec<(f64, &str)> = Vec::new();
        for (name, stream) in &mut self.streams {
            stream.forget(now);
            let smallest = stream.delays_ns.iter().map(|(_, delay)| *delay).min();
            delays_ms.extend(smallest.map(|ns| (ns as f64 * 1e-6, name.as_str())));
        }
        delays_ms.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (Some(first), Some(last)) = (delays_ms.first(), delays_ms.last()) else {
            return SyncState::default();
        };
        if delays_ms.len() < 2 {
            return SyncState::default();
        }
        let spread_ms = last.0 - first.0;
        let level = match spread_ms {
            s if s < SYNC_GOOD_MS => Level::Good,
            s if s < SYNC_BAD_MS => Level::Warning,
            _ => Level::Bad,
        };
        let problem = if level == Level::Good {
            String::new()
        } else {
            format!(
                "clocks of {} and {} lie {spread_ms:.0} ms apart",
                first.1, last.1
            )
        };
        SyncState {
            level,
            spread_ms: Some(spread_ms),
            problem,
        }
    }
}

impl Stream {
    fn count(&mut self, report: &StreamReport, now: Instant) {
        if report.received > self.report.received || self.heard.is_none() {
            self.heard = Some(now);
        }
        self.report = report.clone();
        self.counts.push_back((now, report.decoded));
        while self.counts.len() > 2
            && self
                .counts
                .front()
                .is_some_and(|(at, _)| now.duration_since(*at) > RATE_WINDOW)
        {
            self.counts.pop_front();
        }
    }

    fn delay(&mut self, time: Timestamp, arrival: Timestamp, now: Instant) {
        self.heard = Some(now);
        // The smallest of each tenth of a second is enough.
        let delay_ns = arrival - time;
        match self.delays_ns.back_mut() {
            Some((at, smallest)) if now.duration_since(*at) < Duration::from_millis(100) => {
                *smallest = delay_ns.min(*smallest);
            }
            _ => self.delays_ns.push_back((now, delay_ns)),
        }
    }

    fn forget(&mut self, now: Instant) {
        while self
            .delays_ns
            .front()
            .is_some_and(|(at, _)| now.duration_since(*at) > CLOCK_WINDOW)
        {
            self.delays_ns.pop_front();
        }
    }

    fn rate_hz(&self, silent: Duration) -> f64 {
        let (Some((first_at, first)), Some((last_at, last))) =
            (self.counts.front(), self.counts.back())
        else {
            return 0.0;
        };
        let span_s = last_at.duration_since(*first_at).as_secs_f64();
        if span_s <= 0.0 || silent > RATE_WINDOW {
            return 0.0;
        }
        last.saturating_sub(*first) as f64 / span_s / self.per_sample as f64
    }

    fn state(&self, name: &str, began: Instant, now: Instant) -> StreamState {
        let silent = now.duration_since(self.heard.unwrap_or(began));
        let lost = self.report.lost();
        let (level, problem) = if let Ending::Lost(why) = &self.report.ending {
            (Level::Bad, why.clone())
        } else if self.report.ending == Ending::EndOfStream {
            (Level::Good, String::new())
        } else if self.heard.is_none() && self.expected == Expected::Perhaps {
            (Level::Unknown, String::new())
        } else if self.heard.is_none() && silent < PATIENCE {
            (Level::Unknown, String::new())
        } else if self.heard.is_none() {
            (
                Level::Bad,
                "sends nothing: check power, cable and address".to_owned(),
            )
        } else if silent > SILENT {
            (
                Level::Bad,
                format!("silent for {:.0} s", silent.as_secs_f64()),
            )
        } else if lost > 0 {
            (Level::Warning, String::new())
        } else {
            (Level::Good, String::new())
        };
        StreamState {
            name: name.to_owned(),
            level,
            rate_hz: self.rate_hz(silent),
            samples: self.report.decoded / self.per_sample,
            lost,
            silent_s: self.heard.map(|_| silent.as_secs_f64()),
            problem,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use lsfb_capture::{ImuLineConfig, LidarNetConfig, SidecarConfig};
    use lsfb_types::{ImuSample, LidarScan, Stamped};

    use super::*;

    fn devices() -> DevicesConfig {
        DevicesConfig {
            lidar: Some(LidarNetConfig::default()),
            imu: Some(ImuLineConfig {
                path: "imu".into(),
                baud: 921_600,
                rate_hz: 200,
            }),
            sidecar: Some(SidecarConfig {
                listen: SocketAddr::from(([127, 0, 0, 1], 0)),
            }),
            ..DevicesConfig::default()
        }
    }

    fn counts(name: &str, decoded: u64, missing: u64) -> Tapped {
        Tapped::Counts(StreamReport {
            name: name.to_owned(),
            received: decoded,
            decoded,
            missing,
            ..StreamReport::default()
        })
    }

    fn stamped<T>(time_ns: i64, arrival_ns: i64, sample: T) -> Stamped<T> {
        Stamped {
            time: Timestamp::from_nanos(time_ns),
            arrival: Timestamp::from_nanos(arrival_ns),
            device_ticks: 0,
            sample,
        }
    }

    fn state(streams: &Streams, name: &str, now: Instant) -> StreamState {
        let mut states = streams.states(now).into_iter();
        states.find(|s| s.name == name).unwrap()
    }

    #[test]
    fn rates_losses_and_silence_are_seen_within_a_second() {
        let mut streams = Streams::new(&devices());
        let began = Instant::now();
        let at = |ms: u64| began + Duration::from_millis(ms);
        for step in 0..20 {
            streams.note(&counts("imu0", 50 * step, 0), at(250 * step));
            streams.note(
                &counts("lidar", step, u64::from(step == 19)),
                at(250 * step),
            );
        }
        let now = at(4_900);
        let imu = state(&streams, "imu0", now);
        assert_eq!((imu.level, imu.problem.as_str()), (Level::Good, ""));
        assert!((imu.rate_hz - 200.0).abs() < 1e-6, "{imu:?}");
        let lidar = state(&streams, "lidar", now);
        assert_eq!((lidar.level, lidar.lost), (Level::Warning, 1));
        assert_eq!(streams.lost(), 1);
        assert_eq!(state(&streams, "sidecar", now).level, Level::Unknown);
        // The cable is out: known a second after the last sample.
        let imu = state(&streams, "imu0", at(4_750 + 1_001));
        assert_eq!(imu.level, Level::Bad);
        assert!(imu.problem.contains("silent"), "{imu:?}");
    }

    #[test]
    fn a_clock_a_second_off_is_named() {
        let mut streams = Streams::new(&devices());
        let now = Instant::now();
        let ms = 1_000_000;
        let imu = |delay_ms: i64| Tapped::Imu {
            imu: "imu0",
            sample: stamped(0, delay_ms * ms, ImuSample::default()),
        };
        streams.note(&imu(2), now);
        assert_eq!(streams.sync(now), SyncState::default());
        streams.note(
            &Tapped::Scan(stamped(0, 12 * ms, LidarScan::default())),
            now,
        );
        let sync = streams.sync(now);
        assert_eq!(sync.level, Level::Good);
        assert!((sync.spread_ms.unwrap() - 10.0).abs() < 1e-9);
        let later = now + Duration::from_secs(5);
        streams.note(&imu(1_003), later);
        streams.note(
            &Tapped::Scan(stamped(0, 12 * ms, LidarScan::default())),
            later,
        );
        let sync = streams.sync(later);
        assert_eq!(sync.level, Level::Bad);
        assert!(
            sync.problem.contains("imu0") && sync.problem.contains("991 ms"),
            "{sync:?}"
        );
    }
}
