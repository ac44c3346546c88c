use super::*;

const MS: Duration = Duration::from_millis(1);

/// Hears a part every `period_ms` from `from_ms` to `to_ms`, watching all the while.
fn hear(part: &mut Part, began: Instant, period_ms: u32, from_ms: u32, to_ms: u32) {
    for ms in from_ms..to_ms {
        let now = began + MS * ms;
        if (ms - from_ms).is_multiple_of(period_ms) {
            part.hear(1, now);
        }
        if ms.is_multiple_of(20) {
            part.look(now);
            part.watch(now);
        }
    }
}

#[test]
fn a_part_that_stops_is_a_problem_within_a_second_and_lost_after_it() {
    let began = Instant::now();
    for nominal_hz in [Some(1_500.0), None] {
        let mut part = Part::new(Expected::required("data", nominal_hz), began);
        hear(&mut part, began, 1, 0, 4_000);
        assert_eq!(part.problem(began + MS * 4_000), None);
        part.look(began + MS * 4_690);
        let alarm = part.problem(began + MS * 4_700).expect("an alarm");
        assert!(alarm.contains("no data for 0.7 s"), "{alarm}");
        part.look(began + MS * 5_500);
        part.finish(false);
        assert_eq!((part.silences(), part.slowdowns()), (1, 0));
    }
}

#[test]
fn a_rate_far_below_the_nominal_one_is_a_problem_within_a_second() {
    let began = Instant::now();
    for nominal_hz in [Some(100.0), None] {
        let mut part = Part::new(Expected::required("samples", nominal_hz), began);
        hear(&mut part, began, 10, 0, 4_000);
        assert_eq!(part.problem(began + MS * 4_000), None);
        hear(&mut part, began, 100, 4_000, 4_900);
        let alarm = part.problem(began + MS * 4_900).expect("an alarm");
        assert!(
            alarm.contains("samples at") && alarm.contains("100 Hz"),
            "{alarm}"
        );
        assert_eq!(part.slowdowns(), 0);
        hear(&mut part, began, 100, 4_900, 9_000);
        // One slow stretch, however long.
        assert_eq!((part.silences(), part.slowdowns()), (0, 1));
        // A third more or less is a matter of taste, half is not.
        hear(&mut part, began, 14, 9_000, 12_000);
        assert_eq!(part.problem(began + MS * 12_000), None);
        assert_eq!(part.slowdowns(), 1);
        hear(&mut part, began, 20, 12_000, 17_000);
        assert!(part.problem(began + MS * 17_000).is_some());
        assert_eq!(part.slowdowns(), 2);
    }
}

/// Naively what it sends in its first seconds is its rate, whatever the list of devices says: the doctor alone found this, afterwards.
#[test]
fn half_the_rate_from_the_very_start_is_a_problem_where_the_rate_was_told() {
    let began = Instant::now();
    let mut part = Part::new(Expected::required("images", Some(20.0)), began);
    hear(&mut part, began, 100, 0, 1_100);
    let alarm = part.problem(began + MS * 1_100).expect("an alarm");
    assert!(alarm.ends_with("Hz instead of 20 Hz"), "{alarm}");
    hear(&mut part, began, 100, 1_100, 6_000);
    assert_eq!(part.slowdowns(), 1);
}

/// Naively what came in a second is counted from the first of it until now: of five a second, one period is gone that is not over, and a
/// fifth of the rate.
#[test]
fn a_slow_part_has_its_rate_at_any_instant() {
    for hz in [5, 10] {
        let (began, period_ms) = (Instant::now(), 1_000 / hz);
        let mut part = Part::new(Expected::required("images", Some(f64::from(hz))), began);
        for ms in 0..6_000 {
            hear(
                &mut part,
                began,
                period_ms,
                ms,
                ms + u32::from(ms % period_ms == 0),
            );
            let now = began + MS * ms;
            if ms > 1_200 {
                let rate_hz = part.rate_hz(now);
                let off = (rate_hz / f64::from(hz) - 1.0).abs();
                assert!(off < 1e-9, "{rate_hz} Hz of {hz} at {ms} ms");
            }
        }
        // Two of three stay away.
        hear(&mut part, began, 3 * period_ms, 6_000, 9_000);
        let rate_hz = part.rate_hz(began + MS * 9_000);
        assert!(rate_hz < 0.5 * f64::from(hz), "{rate_hz} Hz of {hz}");
        assert_eq!(part.slowdowns(), 0);
    }
}

#[test]
fn what_never_comes_is_missed_where_it_is_needed() {
    let began = Instant::now();
    let mut data = Part::new(Expected::required("data", Some(100.0)), began);
    let mut position = Part::new(Expected::once_heard("position"), began);
    let later = began + MS * 900;
    assert!(data.problem(later).is_some());
    assert_eq!(position.problem(later), None);
    for part in [&mut data, &mut position] {
        part.look(later);
        part.finish(false);
    }
    assert_eq!((data.silences(), position.silences()), (1, 0));
    let mut position = Part::new(Expected::once_heard("position"), began);
    hear(&mut position, began, 10, 0, 3_500);
    position.look(began + MS * 4_190);
    assert!(position.problem(began + MS * 4_200).is_some());
}

#[test]
fn slow_parts_and_devices_that_come_back_are_no_silence() {
    let began = Instant::now();
    // One image every two seconds.
    let mut part = Part::new(Expected::required("images", Some(0.5)), began);
    hear(&mut part, began, 2_000, 0, 9_000);
    assert_eq!(part.problem(began + MS * 9_900), None);
    let mut part = Part::new(Expected::required("images", Some(20.0)), began);
    hear(&mut part, began, 50, 0, 2_000);
    part.restart(began + MS * 9_000);
    hear(&mut part, began, 50, 9_010, 12_000);
    part.look(began + MS * 12_100);
    part.finish(true);
    assert_eq!((part.silences(), part.slowdowns()), (0, 0));
}

/// The machine did not run the device's thread for three seconds, and what came meanwhile waited in the kernel: naively three
/// seconds of silence, and exit code 3 of a recording that lacks nothing.
#[test]
fn a_thread_that_was_not_run_has_missed_nothing() {
    let began = Instant::now();
    let mut part = Part::new(Expected::required("samples", Some(200.0)), began);
    hear(&mut part, began, 5, 0, 2_000);
    let later = began + MS * 5_000;
    let alarm = part.problem(later).expect("an alarm");
    assert!(alarm.contains("overloaded"), "{alarm}");
    part.hear(600, later);
    part.look(later);
    hear(&mut part, began, 5, 5_000, 8_000);
    assert_eq!(part.problem(began + MS * 8_000), None);
    part.finish(false);
    assert_eq!((part.silences(), part.slowdowns()), (0, 0));
    // It looked all the while, and there was nothing.
    let mut silent = Part::new(Expected::required("samples", Some(200.0)), began);
    hear(&mut silent, began, 5, 0, 2_000);
    (2_000..5_000).for_each(|ms| silent.look(began + MS * ms));
    silent.hear(1, later);
    assert_eq!(silent.silences(), 1);
}
