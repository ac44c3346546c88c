//! Records of one kind from one place, put in order: whatever does not fit is counted.

use std::collections::BTreeSet;

use lsfb_recording::LAST_STAMP;
use lsfb_types::{Timestamp, median, quantile};

use super::payload::{Kind, Payload};
use super::set_back;

/// Fewer records than this have no rhythm.
const ENOUGH: usize = 10;
/// A record further than this from the middle of its stream was stamped by another clock, or wrongly: a day.
const FARTHEST_NS: i64 = 86_400_000_000_000;

/// Gravity is most of what an accelerometer feels.
const POSSIBLE_FORCE_M_S2: std::ops::Range<f64> = 6.0..15.0;
/// A field of magnetism, tesla: that of the earth is 25 to 65 millionths, and a phone's own parts may be ten times as strong, or hide it.
const POSSIBLE_FIELD_T: std::ops::Range<f64> = 2e-6..1e-2;
/// How long images are exposed, nanoseconds.
const POSSIBLE_EXPOSURE_NS: std::ops::Range<f64> = 1e3..1e9;
/// Nobody turns a device faster for half of the time, nor for a twentieth of it, rad/s: a calm walk in degrees a second has a middle of 3 to 8.
const FASTEST_RAD_S: [(f64, f64, &str); 2] = [(0.5, 10.0, "half"), (0.95, 15.0, "a twentieth")];

/// One record with its stamps.
#[derive(Clone, Debug)]
pub(super) struct Record {
    pub(super) time: Timestamp,
    /// When the device had it: what was heard in a scan is handed out behind it.
    pub(super) arrival: Timestamp,
    pub(super) payload: Payload,
}

/// Records of one kind from one place.
#[derive(Debug)]
pub(super) struct Stream {
    /// What it is called where it comes from: a file, a type of line.
    pub(super) what: String,
    /// The topic it becomes, below its device.
    pub(super) topic: String,
    /// The device, where it is not that of the recording.
    pub(super) device: Option<String>,
    pub(super) kind: Kind,
    pub(super) records: Vec<Record>,
    /// Whether its records are made of those of others.
    pub(super) derived: bool,
    pub(super) counts: Counts,
}

/// What was met.
#[derive(Clone, Debug, Default)]
pub(super) struct Counts {
    pub(super) read: u64,
    pub(super) unreadable: u64,
    pub(super) first_problem: Option<String>,
    pub(super) repeated: u64,
    pub(super) reordered: u64,
}

impl Stream {
    /// Its topic in a recording of `device`. LiDARs have theirs at the root, where estimators look for them.
    pub(super) fn full_topic(&self, device: &str) -> String {
        match self.kind {
            Kind::Cloud => format!("/{}", self.topic),
            _ => format!(
                "/sidecar/{}/{}",
                self.device.as_deref().unwrap_or(device),
                self.topic
            ),
        }
    }

    /// Takes a record, or says where and why it is none.
    pub(super) fn take(&mut self, place: impl FnOnce() -> String, record: Result<Record, String>) {
        self.counts.read += 1;
        let checked = record.and_then(|record| {
            let stamps = [record.time, record.arrival];
            match stamps
                .iter()
                .all(|t| (0..=LAST_STAMP.nanos()).contains(&t.nanos()))
            {
                true => Ok(record),
                false => Err("its stamp is before 1970 or after 2038".to_owned()),
            }
        });
        match checked {
            Ok(record) => self.records.push(record),
            Err(why) => self.lose(1, || format!("{}: {why}", place())),
        }
    }

    /// Counts records that are lost.
    pub(super) fn lose(&mut self, records: u64, why: impl FnOnce() -> String) {
        self.counts.unreadable += records;
        self.counts.first_problem.get_or_insert_with(why);
    }

    /// The middle of its stamps; `None` where it is empty.
    pub(super) fn middle(&self) -> Option<Timestamp> {
        let mut times: Vec<Timestamp> = self.records.iter().map(|r| r.time).collect();
        let middle = times.len() / 2;
        (!times.is_empty()).then(|| *times.select_nth_unstable(middle).1)
    }

    /// Sorts by time; leaves out what lies elsewhere in time, what was written twice, and, of a sensor that measures once at a time,
    /// what contradicts the record before it.
    pub(super) fn put_in_order(&mut self) {
        let Some(middle) = self.middle() else {
            return;
        };
        let what = self.what.clone();
        let records = std::mem::take(&mut self.records);
        let (near, far): (Vec<_>, Vec<_>) = records
            .into_iter()
            .partition(|r| (r.time - middle).abs() <= FARTHEST_NS);
        if let Some(first) = far.first() {
            let days = (first.time - middle) as f64 / FARTHEST_NS as f64;
            self.lose(far.len() as u64, || {
                format!("{what}: a stamp is {days:.0} days from the others")
            });
        }
        let steps = near.iter().zip(near.iter().skip(1));
        self.counts.reordered += steps.filter(|(a, b)| b.time < a.time).count() as u64;
        if self.kind.periods_s().is_none() {
            self.records = near;
            self.records.sort_by_key(|r| r.time);
            return self.leave_out_heard_twice();
        }
        let runs = set_back::runs(near.iter().map(|r| r.time));
        let mut records: Vec<(usize, Record)> = runs.into_iter().zip(near).collect();
        records.sort_by_key(|(_, record)| record.time);
        let mut kept: Vec<(usize, Record)> = Vec::with_capacity(records.len());
        for (run, record) in records {
            match kept.last() {
                Some((_, last)) if last.time == record.time && last.payload == record.payload => {
                    self.counts.repeated += 1;
                }
                Some((_, last)) if last.time == record.time => {
                    let at_ns = record.time.nanos();
                    self.lose(1, || format!("{what}: two different records at {at_ns} ns"));
                }
                _ => kept.push((run, record)),
            }
        }
        self.leave_out_told_twice(&what, &mut kept);
        self.records = kept.into_iter().map(|(_, record)| record).collect();
    }

    /// Leaves out records of times that the device told twice, as nobody knows which of them came first.
    fn leave_out_told_twice(&mut self, what: &str, records: &mut Vec<(usize, Record)>) {
        let times: Vec<_> = records.iter().map(|(run, r)| (*run, r.time)).collect();
        let found = set_back::told_twice(&times);
        let Some(first) = found.first() else {
            return;
        };
        let before = records.len();
        let mut is_left_out = set_back::left_out(&times, &found).into_iter();
        records.retain(|_| !is_left_out.next().unwrap_or(false));
        let (start, end) = (first.times.start(), first.times.end());
        let secs = end.secs_since(*start);
        self.lose((before - records.len()) as u64, || match first.runs.len() {
            1 => format!("{what}: stamps that go back by {secs:.1} s, at {} ns", end.nanos()),
            _ => format!(
                "{what}: stamps go back by {secs:.1} s at {} ns, so that this time occurs twice: the clock was set, or two recordings were joined; import each part separately",
                end.nanos()
            ),
        });
    }

    /// Of what comes when there is something to hear, the same at the same time twice was written twice.
    fn leave_out_heard_twice(&mut self) {
        let mut heard: BTreeSet<String> = BTreeSet::new();
        let mut at = None;
        let mut repeated = 0;
        self.records.retain(|record| {
            if at.replace(record.time) != Some(record.time) {
                heard.clear();
            }
            let mut payload = record.payload.clone();
            // A list that stands in a file twice has its scans twice, with numbers of their own.
            match &mut payload {
                Payload::Wifi(reading) => reading.scan = 0,
                Payload::WifiScan(scan) => scan.scan = 0,
                _ => {}
            }
            let is_new = heard.insert(format!("{:?} {payload:?}", record.arrival));
            repeated += u64::from(!is_new);
            is_new
        });
        self.counts.repeated += repeated;
    }

    /// What no such sensor measures, in words: its numbers are in another unit.
    pub(super) fn impossible(&self) -> Option<String> {
        let is = |name: &str| {
            self.kind == Kind::Vector
                && self.topic.starts_with(name)
                && !self.topic.ends_with("_bias")
        };
        let force = self.median(|payload| match payload {
            Payload::Imu(sample) => Some(length(sample.specific_force_m_s2)),
            Payload::Vector(vector) if is("accel") => Some(length(*vector)),
            _ => None,
        });
        if let Some(force) = force.filter(|f| !POSSIBLE_FORCE_M_S2.contains(f)) {
            return Some(format!(
                "the median specific force is {force:.3} m/s² instead of gravity's 9.81: it is in another unit, or gravity was subtracted"
            ));
        }
        let rates = self.values(|payload| match payload {
            Payload::Imu(sample) => Some(length(sample.angular_velocity_rad_s)),
            Payload::Vector(vector) if is("gyro") => Some(length(*vector)),
            _ => None,
        });
        for (share, most, time) in FASTEST_RAD_S {
            if let Some(rate) = quantile(rates.clone(), share).filter(|rate| *rate > most) {
                return Some(format!(
                    "angular rates above {rate:.1} rad/s {time} of the time are implausible for a person: they are in degrees per second, or in another unit"
                ));
            }
        }
        let is_bias = self.topic.ends_with("_bias");
        let field = self.median(|payload| match payload {
            Payload::Magnetic(field) if !is_bias => Some(length(*field)),
            _ => None,
        });
        if let Some(field) = field.filter(|f| !POSSIBLE_FIELD_T.contains(f)) {
            return Some(format!(
                "the median magnetic field is {field:.2e} T instead of the earth's 5e-5: it is in another unit"
            ));
        }
        let exposure = self.median(|payload| match payload {
            Payload::Image(image) if image.exposure_ns > 0 => Some(f64::from(image.exposure_ns)),
            _ => None,
        });
        let exposure = exposure.filter(|e| !POSSIBLE_EXPOSURE_NS.contains(e));
        exposure.map(|exposure| {
            format!("an exposure time of {exposure} ns is implausible: it is in another unit")
        })
    }

    /// A number of the records that have it; none of few.
    fn values(&self, number: impl Fn(&Payload) -> Option<f64>) -> Vec<f64> {
        let numbers = self.records.iter().filter_map(|r| number(&r.payload));
        let numbers: Vec<f64> = numbers.collect();
        match numbers.len() >= ENOUGH {
            true => numbers,
            false => Vec::new(),
        }
    }

    /// Median of such a number.
    fn median(&self, number: impl Fn(&Payload) -> Option<f64>) -> Option<f64> {
        median(self.values(number))
    }

    /// Median of the times between its records, seconds, where no such sensor has it: its stamps are in another unit.
    pub(super) fn impossible_period_s(&self) -> Option<f64> {
        let [longest_s, shortest_s] = self.kind.periods_s()?;
        if self.records.len() < ENOUGH {
            return None;
        }
        let pairs = self.records.iter().zip(self.records.iter().skip(1));
        let mut periods: Vec<i64> = pairs.map(|(a, b)| b.time - a.time).collect();
        let middle = periods.len() / 2;
        let median_s = *periods.select_nth_unstable(middle).1 as f64 / 1e9;
        (!(shortest_s..=longest_s).contains(&median_s)).then_some(median_s)
    }
}

fn length([x, y, z]: [f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}
