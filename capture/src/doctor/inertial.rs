//! Whether what an IMU measured can come from one that is carried.
//!
//! Whoever carries it holds it up: its specific force is that of gravity on average, however it is turned, and walking adds little.
//! A unit that sends zeros, forces in g, rates in degrees or the same samples several times sends as steadily as any other.

use lsfb_recording::Recording;
use lsfb_recording::message::{self, decode_imu};
use lsfb_types::{Finding, ImuSample, STANDARD_GRAVITY_M_S2, Timestamp, Verdict, median, quantile};

use super::{Depth, DoctorConfig, Findings};
use crate::health::Repeats;
use crate::order::Order;

/// Samples that are looked at where not everything is read: 20 s at 200 Hz.
const SAMPLES: usize = 4_000;
/// Fewer have no average.
const LEAST_SAMPLES: usize = 100;
/// Between these shares of gravity lies the middle of the forces on something that is carried: a runner's steps are in it.
const FORCES: [f64; 2] = [0.8, 1.6];
/// Nobody turns what he carries faster than this half of the time, nor for a twentieth of it, rad/s: a calm walk in degrees a second has a middle of 3 to 8.
const MOST_RAD_S: [(f64, f64, &str); 2] = [(0.5, 10.0, "half"), (0.95, 15.0, "a twentieth")];
/// An axis is dead where it never changes though the others of its sensor change by this: rad/s, m/s².
const TURNS_RAD_S: f64 = 0.3;
const FORCES_M_S2: f64 = 1.0;
/// Something that turns so fast measures something else each time, rad/s: there are no two samples without a difference …
const TURNING_RAD_S: f64 = 0.1;
/// … but for this share of them, which a driver may have sent twice; from the other on the IMU measures at less than half of the rate it claims.
const REPEATED: [f64; 2] = [0.05, 0.5];
/// What to do where arrivals go back.
pub(super) const SET_BEFORE: &str =
    "synchronise this machine's clock with chrony or NTP before recording";
const AXES: [&str; 3] = ["x", "y", "z"];

/// What an IMU measured.
#[derive(Default)]
struct Measured {
    samples: usize,
    unreadable: usize,
    not_finite: usize,
    forces_m_s2: Vec<f64>,
    rates_rad_s: Vec<f64>,
    /// Smallest and largest of each axis, of rates and of forces.
    ranges: [[[f64; 2]; 3]; 2],
    repeats: Repeats<ImuSample>,
    last: Option<ImuSample>,
    /// Samples that were taken in a turn, and in how many of them gyroscope and accelerometer say what they said before: either may be held alone.
    turning: usize,
    repeated: [usize; 2],
    stamps: Order,
    arrivals: Order,
}

impl Measured {
    fn note(&mut self, time: Timestamp, sample: ImuSample) {
        let values = [sample.angular_velocity_rad_s, sample.specific_force_m_s2];
        self.stamps.note(time);
        self.repeats.note(sample, time);
        if !values.iter().flatten().all(|value| value.is_finite()) {
            self.not_finite += 1;
            return;
        }
        for (ranges, values) in self.ranges.iter_mut().zip(&values) {
            for ([least, most], value) in ranges.iter_mut().zip(values) {
                let is_first = self.samples == 0;
                *least = if is_first { *value } else { least.min(*value) };
                *most = if is_first { *value } else { most.max(*value) };
            }
        }
        self.samples += 1;
        let [rate, force] = values.map(|v| v.iter().map(|value| value * value).sum::<f64>().sqrt());
        let last = self.last.replace(sample);
        if rate > TURNING_RAD_S {
            self.turning += 1;
            let last = last.map(|last| [last.angular_velocity_rad_s, last.specific_force_m_s2]);
            for (repeated, sensor) in self.repeated.iter_mut().zip(0..) {
                *repeated += usize::from(last.is_some_and(|last| last[sensor] == values[sensor]));
            }
        }
        self.rates_rad_s.push(rate);
        self.forces_m_s2.push(force);
    }

    /// What cannot be, and what to do about it.
    fn problems(&self) -> Vec<(Verdict, String, &'static str)> {
        let failures = self.failures().into_iter();
        let mut problems: Vec<_> = failures
            .map(|(found, remedy)| (Verdict::Fail, found, remedy))
            .collect();
        let [gyroscope, accelerometer] = self.repeated;
        let (repeated, sensor) = match gyroscope >= accelerometer {
            true => (gyroscope, "gyroscope"),
            false => (accelerometer, "accelerometer"),
        };
        let share = repeated as f64 / self.turning.max(1) as f64;
        let [some, most] = REPEATED;
        if self.turning >= LEAST_SAMPLES && share > some {
            let found = format!(
                "{:.0} % of the samples during rotation repeat the previous reading of the {sensor}, which measures more slowly than it sends",
                100.0 * share
            );
            let remedy = "write each reading once, with its own stamp";
            let verdict = match share > most {
                true => Verdict::Fail,
                false => Verdict::Warn,
            };
            problems.push((verdict, found, remedy));
        }
        problems
    }

    fn failures(&self) -> Vec<(String, &'static str)> {
        const FORMAT: &str = "check the program that wrote them";
        let mut problems = Vec::new();
        if self.unreadable > 0 {
            let found = format!("{} samples cannot be read", self.unreadable);
            problems.push((found, FORMAT));
        }
        if self.not_finite > 0 {
            let found = format!(
                "{} samples have values that are not numbers",
                self.not_finite
            );
            problems.push((found, FORMAT));
        }
        if let Some(found) = self.stamps.problem() {
            problems.push((format!("stamps {found}"), "run `lsfb clock` for details"));
        }
        if self.samples < LEAST_SAMPLES {
            return problems;
        }
        let stretches = self.repeats.stale().stretches();
        if stretches > 0 {
            let found = format!("{stretches} stretches of the same sample for more than a second");
            problems.push((found, "restart it"));
        }
        let force_m_s2 = median(self.forces_m_s2.clone()).unwrap_or_default();
        let [least, most] = FORCES.map(|share| share * STANDARD_GRAVITY_M_S2);
        if !(least..=most).contains(&force_m_s2) {
            let found = format!(
                "median specific force is {force_m_s2:.2} m/s², but a carried device measures gravity's {STANDARD_GRAVITY_M_S2:.2}"
            );
            let remedy = match FORCES {
                [least, most] if (least..=most).contains(&force_m_s2) => {
                    "it is in units of g: convert to m/s²"
                }
                _ => "check the accelerometer, its unit, and that gravity was not subtracted",
            };
            problems.push((found, remedy));
        }
        let too_fast = MOST_RAD_S.iter().find_map(|(share, most, time)| {
            let rate_rad_s = quantile(self.rates_rad_s.clone(), *share)?;
            (rate_rad_s > *most).then_some((rate_rad_s, time))
        });
        if let Some((rate_rad_s, time)) = too_fast {
            let found = format!(
                "angular rates above {rate_rad_s:.1} rad/s {time} of the time are implausible for a person"
            );
            problems.push((found, "are they in degrees per second? The unit is rad/s"));
        }
        let sensors = [("gyroscope", TURNS_RAD_S), ("accelerometer", FORCES_M_S2)];
        let widths = self
            .ranges
            .map(|axes| axes.map(|[least, most]| most - least));
        let moving = |sensor: usize| {
            let moving = widths[sensor].iter().filter(|w| **w > sensors[sensor].1);
            moving.count()
        };
        for (n, (sensor, _)) in sensors.into_iter().enumerate() {
            let ranges = &self.ranges[n];
            if widths[n] == [0.0; 3] && moving(1 - n) == 3 {
                let other = sensors[1 - n].0;
                let [x, y, z] = ranges.map(|[value, _]| value);
                let found = format!(
                    "the {sensor} reads ({x}, {y}, {z}) throughout while the {other} senses motion: it is dead"
                );
                problems.push((found, "repair or replace it, or enable that sensor"));
                continue;
            }
            let dead = widths[n].iter().position(|width| *width == 0.0);
            if let Some(axis) = dead.filter(|_| moving(n) == 2) {
                let (name, value) = (AXES[axis], ranges[axis][0]);
                let found = format!(
                    "{name} of the {sensor} is stuck at {value} while the other axes change: it is dead"
                );
                problems.push((found, "repair or replace it"));
            }
        }
        problems
    }
}

impl Findings {
    /// Each IMU's samples: the first, or all where everything is read.
    pub(super) fn inertial(
        &mut self,
        recording: &Recording,
        config: &DoctorConfig,
    ) -> Result<(), lsfb_recording::Error> {
        let topics = recording.topics().iter();
        for topic in topics.filter(|topic| topic.schema == message::IMU.name) {
            let mut measured = Measured::default();
            for (n, recorded) in recording.messages(&topic.topic)?.enumerate() {
                // What is damaged is said elsewhere.
                let is_enough =
                    config.read == Depth::Indexes && (n >= SAMPLES || recorded.is_err());
                if is_enough {
                    break;
                }
                let Ok(recorded) = recorded else {
                    continue;
                };
                measured.arrivals.note(recorded.arrival);
                match decode_imu(&recorded.bytes) {
                    Ok(sample) => measured.note(recorded.time, sample),
                    Err(_) => measured.unreadable += 1,
                }
            }
            self.measured(&topic.topic, &measured);
        }
        Ok(())
    }

    fn measured(&mut self, topic: &str, measured: &Measured) {
        let looked_at = measured.samples + measured.unreadable + measured.not_finite;
        let of = format!("in {looked_at} samples checked");
        if let Some(back) = measured.arrivals.back() {
            let found = format!("arrivals {back}: the host's clock was set, {of}");
            let finding = Finding::new("inertial", Verdict::Warn, topic, found);
            self.add(finding.remedy(SET_BEFORE));
        }
        let problems = measured.problems();
        let is_well = problems.is_empty();
        for (verdict, found, remedy) in problems {
            let found = format!("{found}, {of}");
            self.add(Finding::new("inertial", verdict, topic, found).remedy(remedy));
        }
        if measured.samples < LEAST_SAMPLES {
            let found = format!("too few samples to check their plausibility, {of}");
            self.add(Finding::new("inertial", Verdict::Unknown, topic, found));
        } else if is_well {
            let force_m_s2 = median(measured.forces_m_s2.clone()).unwrap_or_default();
            let found = format!(
                "median specific force {force_m_s2:.2} m/s², plausible for a carried device, {of}"
            );
            self.add(
                Finding::new("inertial", Verdict::Pass, topic, found).value(force_m_s2, "m/s²"),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use lsfb_recording::{Writer, WriterConfig};
    use lsfb_types::{Stamped, no_progress};

    use super::*;
    use crate::doctor::examine;

    /// The findings on ten seconds of an IMU at 200 Hz that measures this: rates, and forces.
    fn found(measured: impl Fn(i64) -> [[f64; 3]; 2]) -> Vec<Finding> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.mcap");
        let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
        for n in 0..2_000 {
            let time = Timestamp::from_nanos(1_772_359_200_000_000_000 + n * 5_000_000);
            let [angular_velocity_rad_s, specific_force_m_s2] = measured(n);
            let sample = Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: ImuSample {
                    angular_velocity_rad_s,
                    specific_force_m_s2,
                },
            };
            writer.write_imu("imu0", &sample).unwrap();
        }
        writer.finish().unwrap();
        let recording = Recording::open(&path).unwrap();
        let diagnosis = examine(&recording, &DoctorConfig::default(), &no_progress).unwrap();
        let findings = diagnosis.judgement.findings().iter();
        findings.filter(|f| f.code == "inertial").cloned().collect()
    }

    /// Someone who walks: steps at 2 Hz, turns by 30°/s.
    fn walk(n: i64) -> [[f64; 3]; 2] {
        let at = n as f64 * 0.005;
        let wave = |hz: f64| (std::f64::consts::TAU * hz * at).sin();
        let rates = [0.3 * wave(1.0), 0.2 * wave(1.3), 0.5 * wave(0.4)];
        [rates, [1.5 * wave(1.9), wave(1.1), 9.81 + 3.0 * wave(2.0)]]
    }

    #[track_caller]
    fn fails(measured: impl Fn(i64) -> [[f64; 3]; 2], words: &str) {
        let found = found(measured);
        let said = |f: &Finding| format!("{}; {}", f.what, f.remedy.clone().unwrap_or_default());
        let is_said = |f: &Finding| f.verdict == Verdict::Fail && said(f).contains(words);
        assert!(found.iter().any(is_said), "{words}: {found:?}");
    }

    /// At its rate and without a gap, each of them was a good recording.
    #[test]
    fn what_no_imu_that_is_carried_measures_is_no_pass() {
        let good = found(walk);
        assert!(
            matches!(&good[..], [one] if one.verdict == Verdict::Pass),
            "{good:?}"
        );
        fails(|_| [[0.0; 3]; 2], "the same sample");
        fails(|_| [[0.0; 3]; 2], "specific force is 0.00 m/s²");
        let scaled = |n, rate: f64, force: f64| {
            let [rates, forces] = walk(n);
            [rates.map(|v| v * rate), forces.map(|v| v * force)]
        };
        fails(
            |n| scaled(n, 1.0, 1.0 / STANDARD_GRAVITY_M_S2),
            "it is in units of g",
        );
        fails(|n| scaled(n, 57.3, 1.0), "in degrees");
        // Most of the time it stood on a table.
        fails(
            |n| scaled(n, if n < 1_600 { 1e-3 } else { 57.3 }, 1.0),
            "in degrees",
        );
        // Gravity was taken off.
        fails(
            |n| {
                let [rates, [x, y, z]] = walk(n);
                [rates, [x, y, z - 9.81]]
            },
            "gravity was not subtracted",
        );
        fails(
            |n| {
                let [[x, y, _], forces] = walk(n);
                [[x, y, 0.25], forces]
            },
            "z of the gyroscope is stuck at 0.25",
        );
        fails(
            |n| {
                let [rates, [x, _, z]] = walk(n);
                [rates, [x, f64::NAN, z]]
            },
            "not numbers",
        );
        fails(
            |n| [[0.0; 3], walk(n)[1]],
            "the gyroscope reads (0, 0, 0) throughout",
        );
        fails(
            |n| [walk(n)[0], [0.0, 0.0, 9.81]],
            "the accelerometer reads (0, 0, 9.81) throughout",
        );
        fails(|n| walk(n / 10 * 10), "90 % of the samples during rotation");
        fails(
            |n| [walk(n / 10 * 10)[0], walk(n)[1]],
            "repeat the previous reading of the gyroscope",
        );
        fails(
            |n| [walk(n)[0], walk(n / 10 * 10)[1]],
            "repeat the previous reading of the accelerometer",
        );
        // One of ten was written twice.
        let twice = found(|n| walk(n - i64::from(n % 10 == 0)));
        let is_warned = |f: &Finding| f.verdict == Verdict::Warn && f.what.contains("10 % of");
        assert!(twice.iter().any(is_warned), "{twice:?}");
        // At rest on a table, with noise: nothing moves, and nothing is dead.
        let rest = found(|n| {
            let noise = (n * 7919 % 101) as f64 * 1e-5;
            [[noise, -noise, 0.0], [0.0, noise, 9.81 + noise]]
        });
        assert!(rest.iter().all(|f| f.verdict == Verdict::Pass), "{rest:?}");
    }
}
