//! Records of one kind from one place, put in order: whatever does not fit is counted.

use lsfb_recording::LAST_STAMP;
use lsfb_types::{ImuSample, Timestamp, median};

use super::payload::{Kind, Payload};

/// Fewer records than this have no rhythm.
const ENOUGH: usize = 10;
/// A record further than this from the middle of its stream was stamped by another clock, or wrongly: a day.
const FARTHEST_NS: i64 = 86_400_000_000_000;

/// Gravity is most of what an accelerometer feels.
const POSSIBLE_FORCE_M_S2: std::ops::Range<f64> = 6.0..15.0;
/// Nobody turns a device faster for half of the time, rad/s.
const FASTEST_RAD_S: f64 = 10.0;

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
                format!("{what}: a stamp lies {days:.0} days from the others")
            });
        }
        let steps = near.iter().zip(near.iter().skip(1));
        self.counts.reordered += steps.filter(|(a, b)| b.time < a.time).count() as u64;
        self.records = near;
        self.records.sort_by_key(|r| r.time);
        if self.kind.periods_s().is_none() {
            return;
        }
        let mut kept: Vec<Record> = Vec::with_capacity(self.records.len());
        for record in std::mem::take(&mut self.records) {
            match kept.last() {
                Some(last) if last.time == record.time && last.payload == record.payload => {
                    self.counts.repeated += 1;
                }
                Some(last) if last.time == record.time => {
                    let at_ns = record.time.nanos();
                    self.lose(1, || format!("{what}: two different records at {at_ns} ns"));
                }
                _ => kept.push(record),
            }
        }
        self.records = kept;
    }

    /// Median length of specific force, m/s², where it is none of a device that is carried about: in another unit, or without gravity.
    pub(super) fn impossible_force_m_s2(&self) -> Option<f64> {
        let median = self.median_length(|sample| sample.specific_force_m_s2)?;
        (!POSSIBLE_FORCE_M_S2.contains(&median)).then_some(median)
    }

    /// Median rate of turn, rad/s, where nobody turns so fast: in degrees.
    pub(super) fn impossible_rate_rad_s(&self) -> Option<f64> {
        let median = self.median_length(|sample| sample.angular_velocity_rad_s)?;
        (median > FASTEST_RAD_S).then_some(median)
    }

    /// Median length of a vector of inertial samples; `None` of few.
    fn median_length(&self, vector: impl Fn(&ImuSample) -> [f64; 3]) -> Option<f64> {
        let lengths = self.records.iter().filter_map(|r| match &r.payload {
            Payload::Imu(sample) => {
                let [x, y, z] = vector(sample);
                Some((x * x + y * y + z * z).sqrt())
            }
            _ => None,
        });
        let lengths: Vec<f64> = lengths.collect();
        let is_enough = lengths.len() >= ENOUGH;
        median(lengths).filter(|_| is_enough)
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
