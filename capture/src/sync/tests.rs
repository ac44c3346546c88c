use super::*;

fn image(frame_id: u32, millis: i64) -> Stamped<Image> {
    let time = Timestamp::from_nanos(millis * 1_000_000);
    Stamped {
        time,
        arrival: time,
        device_ticks: 0,
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
    for trigger in 0..20_i64 {
        // The first unit's counter wraps; the second one's is 100 behind, three triggers late, one millisecond off.
        let id = (65_530 + trigger) as u32 % 65_536;
        for camera in ["cam0", "cam1"] {
            decided.extend(groups.note(camera, &image(id, trigger * 50)));
        }
        let other = trigger - 3;
        if other >= 0 && other != 8 {
            for camera in ["cam2", "cam3"] {
                decided.extend(groups.note(camera, &image((100 + other) as u32, other * 50 + 1)));
            }
        }
        if other == 9 {
            let last = decided.last().unwrap();
            assert_eq!((last.trigger, last.present), (65_530 + 9, 4));
            let missed = &decided[decided.len() - 2];
            assert_eq!(missed.missing, ["cam2", "cam3"]);
            assert_eq!((missed.trigger, missed.expected), (65_538, 4));
        }
    }
    let rest = groups.finish();
    assert_eq!((rest.report.complete, rest.report.incomplete), (16, 4));
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
