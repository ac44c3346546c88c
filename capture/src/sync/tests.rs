use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::clock::OneWayClock;

fn image(frame_id: u32, millis: i64) -> Stamped<Image> {
    let time = Timestamp::from_nanos(millis * 1_000_000);
    Stamped {
        time,
        arrival: time,
        device_ticks: (millis * 1_000).cast_unsigned(),
        sample: Image {
            frame_id,
            ..Image::default()
        },
    }
}

fn two_units() -> Groups {
    Groups::new(&[
        vec!["cam0".to_owned(), "cam1".to_owned()],
        vec!["cam2".to_owned(), "cam3".to_owned()],
    ])
}

#[test]
fn a_late_unit_completes_its_groups_and_a_missed_trigger_is_named_at_once() {
    let mut groups = two_units();
    let mut decided = Vec::new();
    for trigger in 0..30_i64 {
        // The first unit's counter wraps; the second one's is 100 behind, three triggers late, one millisecond off.
        let id = (65_530 + trigger) as u32 % 65_536;
        for camera in ["cam0", "cam1"] {
            decided.extend(groups.note(camera, &image(id, trigger * 50)));
        }
        let other = trigger - 3;
        if other >= 0 && other != 16 {
            for camera in ["cam2", "cam3"] {
                decided.extend(groups.note(camera, &image((100 + other) as u32, other * 50 + 1)));
            }
        }
        if other == 17 {
            let last = decided.last().unwrap();
            assert_eq!((last.trigger, last.present), (65_530 + 17, 4));
            let missed = &decided[decided.len() - 2];
            assert_eq!(missed.missing, ["cam2", "cam3"]);
            assert_eq!((missed.trigger, missed.expected), (65_546, 4));
        }
    }
    let rest = groups.finish();
    assert_eq!((rest.report.complete, rest.report.incomplete), (26, 4));
    assert_eq!(
        rest.report.missing_by_camera,
        BTreeMap::from([("cam2".to_owned(), 4), ("cam3".to_owned(), 4)])
    );
    assert_eq!(rest.groups.len(), 3);
}

#[test]
fn counters_decide_where_times_do_not_agree() {
    let mut groups = two_units();
    for trigger in 0..50_i64 {
        for camera in ["cam0", "cam1"] {
            groups.note(camera, &image(trigger as u32, trigger * 50));
        }
        // Once fitted in, a single frame may be stamped anyhow.
        let late = if trigger % 10 == 9 { 20 } else { 0 };
        for camera in ["cam2", "cam3"] {
            groups.note(camera, &image(7_000 + trigger as u32, trigger * 50 + late));
        }
    }
    let report = groups.finish().report;
    assert_eq!(
        (report.complete, report.incomplete, report.refitted),
        (50, 0, 0)
    );
}

#[test]
fn a_unit_that_begins_anew_is_fitted_in_again() {
    let mut groups = two_units();
    for trigger in 0..60_i64 {
        for camera in ["cam0", "cam1"] {
            groups.note(camera, &image(500 + trigger as u32, trigger * 50));
        }
        // It is away for ten triggers and counts from zero afterwards.
        if !(30..40).contains(&trigger) {
            let id = if trigger < 30 {
                900 + trigger
            } else {
                trigger - 40
            };
            for camera in ["cam2", "cam3"] {
                groups.note(camera, &image(id as u32, trigger * 50));
            }
        }
    }
    let report = groups.finish().report;
    assert_eq!(
        (report.complete, report.incomplete, report.refitted),
        (50, 10, 1)
    );
}

#[test]
fn units_whose_links_run_far_apart_still_meet() {
    let mut groups = Groups::new(&[vec!["cam0".to_owned()], vec!["cam2".to_owned()]]);
    for camera in ["cam0", "cam2"] {
        for trigger in 0..3_000 {
            groups.note(camera, &image(trigger, i64::from(trigger) * 100));
        }
    }
    let report = groups.finish().report;
    assert_eq!((report.complete, report.incomplete), (3_000, 0));
}

#[test]
fn four_units_with_one_camera_each_and_one_that_is_silent() {
    let names: Vec<_> = (0..4).map(|n| vec![format!("cam{n}")]).collect();
    let mut groups = Groups::new(&names);
    for trigger in 0..10_u32 {
        for n in [2, 0, 1] {
            let id = trigger + 1_000 * n;
            groups.note(&format!("cam{n}"), &image(id, i64::from(trigger) * 50));
        }
    }
    let report = groups.finish().report;
    assert_eq!((report.complete, report.incomplete), (0, 10));
    assert_eq!(report.missing_by_camera["cam3"], 10);
}

/// How the frames of a rig come.
#[derive(Clone, Copy, Debug)]
struct Links {
    rate_hz: i64,
    /// Delays lie evenly between nothing and twice this.
    jitter_ms: f64,
    /// Frames of a unit that come together.
    batch: i64,
    /// Once in a while a link is silent for this long.
    stall_ms: i64,
    /// Share of the frames that never come.
    lost: f64,
}

/// Frames of units with clocks of their own, in the order of their arrival, through the clock that stamps them.
fn over(links: Links, seed: u64) -> Decided {
    const SECS: i64 = 8;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut events = Vec::new();
    let mut lost = BTreeMap::new();
    for unit in 0..3_usize {
        let skew = 100e-6 * (rng.random::<f64>() - 0.5);
        let power_up_ns = (rng.random::<f64>() * 100e9) as i64;
        let first_id = rng.random::<u16>();
        // The host opens one unit after the other.
        let first_trigger = (rng.random::<f64>() * links.rate_hz as f64) as i64;
        // Batches begin anywhere.
        let phase = (rng.random::<f64>() * links.batch as f64) as i64;
        let mut earliest_ns = 0;
        let mut waiting = Vec::new();
        for trigger in first_trigger..SECS * links.rate_hz {
            let true_ns = trigger * 1_000_000_000 / links.rate_hz;
            if trigger > first_trigger && rng.random::<f64>() < links.lost {
                *lost.entry(trigger).or_insert(0) += 1;
            } else {
                waiting.push((trigger, true_ns));
            }
            if (trigger + phase) % links.batch != 0 && trigger + 1 < SECS * links.rate_hz {
                continue;
            }
            let mut delay_ns = (2e6 * links.jitter_ms * rng.random::<f64>()) as i64;
            if rng.random::<f64>() < 0.05 {
                delay_ns += links.stall_ms * 1_000_000;
            }
            earliest_ns = earliest_ns.max(true_ns + 2_000_000 + delay_ns);
            for (trigger, true_ns) in waiting.drain(..) {
                let device_ns = power_up_ns + true_ns + (true_ns as f64 * skew) as i64;
                let id = (i64::from(first_id) + trigger) as u16;
                events.push((earliest_ns, events.len(), unit, id, device_ns));
            }
        }
        for trigger in 0..first_trigger {
            *lost.entry(trigger).or_insert(0) += 1;
        }
    }
    events.sort_unstable();
    let names: Vec<_> = (0..3).map(|n| vec![format!("cam{n}")]).collect();
    let mut groups = Groups::new(&names);
    let mut clocks = [(); 3].map(|()| OneWayClock::default());
    let mut decided = Vec::new();
    for (arrival_ns, _, unit, id, device_ns) in events {
        let arrival = Timestamp::from_nanos(1_772_359_200_000_000_000 + arrival_ns);
        let device_ns = device_ns / 1_000 * 1_000;
        clocks[unit].push(device_ns, arrival);
        let image = Stamped {
            time: clocks[unit].time(device_ns),
            arrival,
            device_ticks: (device_ns / 1_000).cast_unsigned(),
            sample: Image {
                frame_id: id.into(),
                ..Image::default()
            },
        };
        decided.extend(groups.note(&names[unit][0], &image));
    }
    let mut rest = groups.finish();
    decided.append(&mut rest.groups);
    let expected = lost.values().filter(|units| **units < 3).count() as u64;
    let none = lost.values().filter(|units| **units == 3).count() as u64;
    let case = format!("{links:?}, seed {seed}: {:?}", rest.report);
    assert_eq!(rest.report.incomplete, expected, "{case}");
    assert_eq!(
        rest.report.complete,
        (SECS * links.rate_hz).cast_unsigned() - expected - none,
        "{case}"
    );
    assert_eq!(rest.report.refitted, 0, "{case}");
    Decided {
        groups: decided,
        report: rest.report,
    }
}

#[test]
fn every_group_is_whole_whatever_the_links_are_like() {
    let smooth = Links {
        rate_hz: 20,
        jitter_ms: 5.0,
        batch: 1,
        stall_ms: 0,
        lost: 0.0,
    };
    for links in [
        smooth,
        Links {
            stall_ms: 45,
            ..smooth
        },
        Links {
            batch: 4,
            stall_ms: 45,
            ..smooth
        },
        Links {
            rate_hz: 10,
            batch: 3,
            ..smooth
        },
        Links {
            rate_hz: 30,
            jitter_ms: 3.0,
            batch: 5,
            ..smooth
        },
        Links {
            lost: 0.05,
            stall_ms: 45,
            ..smooth
        },
    ] {
        for seed in 0..40 {
            // Nothing that was sent is missing from its group; what was lost is named.
            over(links, seed);
        }
    }
}
