//! When a device rested, by its inertial samples: poses alone stand still as well where tracking was lost, and creep where it drifts.

use std::ops::Range;

use lsfb_geometry::{StampedPose, Vector3};
use lsfb_types::{Finding, ImuSample, STANDARD_GRAVITY_M_S2, Stamped, Timestamp, Verdict};

use super::rests::{Rest, RestConfig, runs_of, spread, still_poses};
use crate::Error;

/// Samples are judged over this long, seconds.
const WINDOW_SECS: f64 = 0.5;
/// A longer step between samples ends a window, seconds.
const LONGEST_STEP_SECS: f64 = 0.1;
/// Standard deviation of a resting gyroscope about its mean, rad/s: phones have 0.005, a hand that holds still 0.05.
const GYRO_SCATTER_RAD_S: f64 = 0.02;
/// A bias is smaller, an even turn larger, rad/s.
const GYRO_MEAN_RAD_S: f64 = 0.1;
/// Standard deviation of a resting accelerometer about its mean, m/s².
const ACCEL_SCATTER_M_S2: f64 = 0.1;
/// By how much the mean specific force may miss gravity, m/s²: more is an even acceleration.
const OFF_GRAVITY_M_S2: f64 = 0.5;
/// Poses that a rest must have.
const LEAST_POSES: usize = 5;

/// Rests of a device, and where its trajectory disagrees with them.
#[derive(Clone, Debug, PartialEq)]
pub struct InertialRests {
    /// In order of time, each with the mean of the trajectory's positions.
    pub rests: Vec<Rest>,
    /// Rests at which the trajectory moves or has no poses, and stops at which the device moves.
    pub findings: Vec<Finding>,
}

/// Rests of at least `config.least_secs`; both in order of time, on one clock.
pub fn inertial_rests(
    poses: &[StampedPose],
    samples: &[Stamped<ImuSample>],
    config: &RestConfig,
) -> Result<InertialRests, Error> {
    let ends = |first: Option<Timestamp>, last: Option<Timestamp>| match (first, last) {
        (Some(first), Some(last)) => format!("{first} to {last} s"),
        _ => "nothing".to_owned(),
    };
    let (first, last) = (poses.first().map(|p| p.time), poses.last().map(|p| p.time));
    let inside = |s: &&Stamped<ImuSample>| Some(s.time) >= first && Some(s.time) <= last;
    if samples.iter().filter(inside).count() < 2 {
        return Err(Error::NoInertialSamples {
            poses_span: ends(first, last),
            samples_span: ends(
                samples.first().map(|s| s.time),
                samples.last().map(|s| s.time),
            ),
        });
    }
    let is_still = still_samples(samples);
    let mut findings = Vec::new();
    let mut rests = Vec::new();
    let lasting = runs_of(&is_still)
        .into_iter()
        .map(|run| ends_of(run, samples));
    for [start, end] in lasting.filter(|[a, b]| b.secs_since(*a) >= config.least_secs) {
        let from = poses.partition_point(|p| p.time < start);
        let to = poses.partition_point(|p| p.time <= end);
        // Before and after the trajectory nothing is asked of it.
        let is_asked = Some(end) > first && Some(start) < last;
        match spread(&poses[from..to]).filter(|s| s.rest.poses >= LEAST_POSES) {
            Some(found) => {
                if found.largest_m > config.spread_m {
                    findings.push(creeps(&found.rest, found.largest_m, poses));
                }
                rests.push(found.rest);
            }
            None if is_asked => findings.push(silent(start, end, poses)),
            None => {}
        }
    }
    findings.extend(stops(poses, samples, &is_still, config));
    Ok(InertialRests { rests, findings })
}

fn ends_of(run: Range<usize>, samples: &[Stamped<ImuSample>]) -> [Timestamp; 2] {
    let last = run.end.saturating_sub(1).max(run.start);
    [samples[run.start].time, samples[last].time]
}

/// Which samples lie in a window in which the IMU rests.
fn still_samples(samples: &[Stamped<ImuSample>]) -> Vec<bool> {
    let mut is_still = vec![false; samples.len()];
    let step = |i: usize| samples[i].time.secs_since(samples[i - 1].time);
    let mut end = 0;
    let mut whole_from = 0;
    for start in 0..samples.len() {
        end = end.max(start);
        while end + 1 < samples.len()
            && samples[end].time.secs_since(samples[start].time) < WINDOW_SECS
        {
            end += 1;
            if step(end) > LONGEST_STEP_SECS {
                whole_from = end;
            }
        }
        let lasts = samples[end].time.secs_since(samples[start].time) >= WINDOW_SECS;
        if lasts && whole_from <= start && rests(&samples[start..=end]) {
            is_still[start..=end].fill(true);
        }
    }
    is_still
}

fn rests(window: &[Stamped<ImuSample>]) -> bool {
    let of = |value: fn(&ImuSample) -> [f64; 3]| {
        let values = || window.iter().map(|s| Vector3::from(value(&s.sample)));
        let count = window.len() as f64;
        let mean = values().sum::<Vector3<f64>>() / count;
        let squares: f64 = values().map(|v| (v - mean).norm_squared()).sum();
        (mean.norm(), (squares / count).sqrt())
    };
    let (turn, turn_scatter) = of(|s| s.angular_velocity_rad_s);
    let (force, force_scatter) = of(|s| s.specific_force_m_s2);
    turn <= GYRO_MEAN_RAD_S
        && turn_scatter <= GYRO_SCATTER_RAD_S
        && force_scatter <= ACCEL_SCATTER_M_S2
        && (force - STANDARD_GRAVITY_M_S2).abs() <= OFF_GRAVITY_M_S2
}

fn since_first(time: Timestamp, poses: &[StampedPose]) -> f64 {
    poses.first().map_or(0.0, |p| time.secs_since(p.time))
}

fn creeps(rest: &Rest, largest_m: f64, poses: &[StampedPose]) -> Finding {
    let what = format!(
        "the trajectory moves by up to {:.1} cm about its mean in the {:.1} s from {:.1} s on during which the device rests",
        100.0 * largest_m,
        rest.end.secs_since(rest.start),
        since_first(rest.start, poses)
    );
    Finding::new("moves-at-rest", Verdict::Warn, "trajectory", what).value(largest_m, "m")
}

fn silent(start: Timestamp, end: Timestamp, poses: &[StampedPose]) -> Finding {
    let what = format!(
        "no poses for the rest of {:.1} s that begins at {:.1} s",
        end.secs_since(start),
        since_first(start, poses)
    );
    Finding::new("no-poses-at-rest", Verdict::Warn, "trajectory", what)
}

/// Stops of the trajectory in which the device moves for as long as a rest lasts.
fn stops(
    poses: &[StampedPose],
    samples: &[Stamped<ImuSample>],
    is_still: &[bool],
    config: &RestConfig,
) -> Option<Finding> {
    let moves = |run: &Range<usize>| {
        let (start, end) = (poses[run.start].time, poses[run.end - 1].time);
        let from = samples.partition_point(|s| s.time < start);
        let to = samples.partition_point(|s| s.time <= end);
        let is_moving: Vec<bool> = is_still[from..to].iter().map(|still| !still).collect();
        let stretches = runs_of(&is_moving).into_iter();
        let mut stretches = stretches.map(|run| ends_of(run, &samples[from..to]));
        stretches.any(|[a, b]| b.secs_since(a) >= config.least_secs)
    };
    let runs = runs_of(&still_poses(poses, config));
    let moving: Vec<Range<usize>> = runs.into_iter().filter(moves).collect();
    let first = moving.first()?;
    let what = format!(
        "the trajectory stands still {} while the device moves, first at {:.1} s: these are not counted as rests; was tracking lost?",
        crate::count(moving.len(), "time", "times"),
        since_first(poses[first.start].time, poses)
    );
    Some(
        Finding::new("stops-in-motion", Verdict::Warn, "trajectory", what)
            .value(moving.len() as f64, ""),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::Se3;

    /// 100 Hz: rests until 3 s, from 6 to 9 s and from 12 s on, is carried in between.
    fn rests_at(t: f64) -> bool {
        !((3.0..6.0).contains(&t) || (9.0..12.0).contains(&t))
    }

    fn samples() -> Vec<Stamped<ImuSample>> {
        let sample = |i: i64| {
            let t = i as f64 / 100.0;
            let shake = if rests_at(t) { 0.004 } else { 1.0 };
            let wave = |k: f64| shake * (k * t).sin();
            let time = Timestamp::from_nanos(i * 10_000_000);
            Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: ImuSample {
                    angular_velocity_rad_s: [0.02 + 0.6 * wave(13.0), 0.5 * wave(9.0), 0.0],
                    specific_force_m_s2: [wave(11.0), 0.3, 9.8 + 2.0 * wave(17.0)],
                },
            }
        };
        (0..1500).map(sample).collect()
    }

    fn poses(place: impl Fn(f64) -> f64) -> Vec<StampedPose> {
        let pose = |i: i64| StampedPose {
            time: Timestamp::from_nanos(i * 50_000_000),
            world_from_rig: Se3::new(
                Default::default(),
                Vector3::new(place(i as f64 / 20.0), 0.0, 1.0),
            ),
        };
        (0..300).map(pose).collect()
    }

    /// Walks from 3 to 6 and from 9 to 12 s.
    fn walk(t: f64) -> f64 {
        t.clamp(3.0, 6.0) + t.clamp(9.0, 12.0)
    }

    fn codes(found: &InertialRests) -> Vec<&str> {
        found.findings.iter().map(|f| f.code.as_ref()).collect()
    }

    #[test]
    fn rests_are_those_of_the_device() {
        let config = RestConfig::default();
        let found = inertial_rests(&poses(walk), &samples(), &config).expect("overlap");
        assert_eq!(found.rests.len(), 3, "{found:?}");
        assert!((found.rests[1].place.x - 15.0).abs() < 1e-6);
        assert!(found.findings.is_empty(), "{:?}", found.findings);
    }

    /// By its poses alone the first trajectory rests a third time, and the second only twice.
    #[test]
    fn a_trajectory_that_freezes_or_creeps_is_found_out() {
        let config = RestConfig::default();
        let frozen = poses(|t| if t < 9.0 { walk(t) } else { walk(9.0) });
        let found = inertial_rests(&frozen, &samples(), &config).expect("overlap");
        assert_eq!(
            (found.rests.len(), codes(&found)),
            (3, vec!["stops-in-motion"])
        );
        let lost = poses(|t| {
            if (4.0..5.9).contains(&t) {
                4.0
            } else {
                walk(t)
            }
        });
        let found = inertial_rests(&lost, &samples(), &config).expect("overlap");
        assert_eq!(
            (found.rests.len(), codes(&found)),
            (3, vec!["stops-in-motion"])
        );
        let creeping = poses(|t| walk(t) + 0.05 * (t - 6.0).clamp(0.0, 3.0));
        let found = inertial_rests(&creeping, &samples(), &config).expect("overlap");
        assert_eq!(
            (found.rests.len(), codes(&found)),
            (3, vec!["moves-at-rest"])
        );
        let mut gap = poses(walk);
        gap.retain(|p| !(6.2..8.8).contains(&(p.time.nanos() as f64 * 1e-9)));
        let found = inertial_rests(&gap, &samples(), &config).expect("overlap");
        assert_eq!(
            found.rests.len(),
            3,
            "poses at both ends of the rest remain"
        );
    }

    #[test]
    fn another_clock_is_an_error() {
        let late: Vec<StampedPose> = poses(walk)
            .into_iter()
            .map(|p| StampedPose {
                time: p.time.plus_secs(1e6),
                ..p
            })
            .collect();
        let error = inertial_rests(&late, &samples(), &RestConfig::default()).expect_err("apart");
        assert!(error.to_string().contains("one clock"), "{error}");
        assert!(inertial_rests(&[], &samples(), &RestConfig::default()).is_err());
        // An even turn has no scatter, and is no rest; neither is a sensor that says nothing.
        let mut turning = samples();
        for s in &mut turning {
            s.sample.angular_velocity_rad_s[2] = 0.5;
        }
        let found = inertial_rests(&poses(walk), &turning, &RestConfig::default());
        assert!(found.expect("overlap").rests.is_empty());
        let mut silent = samples();
        for s in &mut silent {
            s.sample = ImuSample::default();
        }
        let found = inertial_rests(&poses(walk), &silent, &RestConfig::default());
        assert!(found.expect("overlap").rests.is_empty());
    }
}
