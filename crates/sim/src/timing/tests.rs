use super::*;

const BEGIN: Timestamp = Timestamp::from_nanos(1_772_359_200_000_000_000);

fn free(drift_ppm: f64) -> ClockConfig {
    ClockConfig {
        discipline: Discipline::Free,
        start_s: 100.0,
        drift_ppm,
        ..ClockConfig::default()
    }
}

#[test]
fn a_quartz_gains_what_it_is_told_to_and_a_disciplined_clock_nothing() {
    let clock = DeviceClock::new(&free(50.0), BEGIN, 1);
    assert_eq!(clock.device_ns(0), 100_000_000_000);
    assert_eq!(clock.device_ns(10_000_000_000), 110_000_500_000);
    let utc = DeviceClock::new(&ClockConfig::default(), BEGIN, 1);
    assert_eq!(utc.device_ns(77), BEGIN.nanos() + 77);
}

#[test]
fn the_rate_is_the_slope_of_the_count_also_where_it_wanders() {
    let config = ClockConfig {
        wander_ppm: 2.0,
        wander_period_s: 60.0,
        ..free(-20.0)
    };
    let clock = DeviceClock::new(&config, BEGIN, 5);
    let mut rates = Vec::new();
    for k in 0..60 {
        let at = k * 1_000_000_000;
        let gained = clock.device_ns(at + 50_000_000) - clock.device_ns(at - 50_000_000);
        let slope_ppm = (gained - 100_000_000) as f64 / 100.0;
        assert!((slope_ppm - clock.rate_ppm(at)).abs() < 0.03);
        rates.push(clock.rate_ppm(at));
    }
    let most = rates.iter().copied().fold(f64::MIN, f64::max);
    assert!((most + 18.0).abs() < 0.02, "{most}");
}

#[test]
fn a_jump_is_where_the_truth_says() {
    let config = ClockConfig {
        jumps: vec![ClockJump {
            at_s: 1.25,
            by_s: 1.0,
        }],
        ..free(0.0)
    };
    let clock = DeviceClock::new(&config, BEGIN, 1);
    let step = clock.device_ns(1_250_000_000) - clock.device_ns(1_249_999_999);
    assert_eq!(step, 1_000_000_001);
    let rows = clock.truth_rows("imu0", 2.0);
    let before = format!(
        "imu0,{},101249999999,0.000000",
        BEGIN.nanos() + 1_249_999_999
    );
    let after = format!(
        "imu0,{},102250000000,0.000000",
        BEGIN.nanos() + 1_250_000_000
    );
    assert!(rows.contains(&format!("{before}\n{after}\n")), "{rows}");
}

#[test]
fn arrivals_are_spread_batched_and_held_up_but_never_out_of_order_or_early() {
    let config = LinkConfig {
        delay_s: 2e-3,
        jitter_s: 5e-3,
        batch: 2,
        stall_s: 45e-3,
        stall_every_s: 2.0,
    };
    let link = Link::new(&config, 3);
    let ready: Vec<i64> = (0..20_000).map(|k| k * 5_000_000).collect();
    let arrivals = link.arrivals(&ready);
    assert!(arrivals.is_sorted());
    assert!(arrivals.chunks(2).all(|pair| pair[0] == pair[1]));
    let delays: Vec<f64> = ready
        .iter()
        .zip(&arrivals)
        .skip(1)
        .step_by(2)
        .map(|(sent, got)| (got - sent) as f64 * 1e-6)
        .collect();
    let least = delays.iter().copied().fold(f64::MAX, f64::min);
    assert!((2.0..2.01).contains(&least), "{least}");
    // Fifty stalls of 45 ms, each of which holds up four or five of these batches.
    let held = delays.iter().filter(|d| **d > 12.5).count();
    assert!((120..240).contains(&held), "{held}");
    let free: Vec<f64> = delays.iter().copied().filter(|d| *d <= 12.0).collect();
    let mean = free.iter().sum::<f64>() / free.len() as f64;
    assert!((mean - 7.0).abs() < 0.3, "{mean}");
    assert!(delays.iter().all(|d| *d < 2.0 + 10.0 + 45.0));
}

#[test]
fn what_cannot_be_is_refused() {
    let mut clocks = ClocksConfig::quartz();
    assert!(clocks.check_bounds("clocks").is_ok());
    clocks.walker.link.stall_every_s = 0.1;
    assert!(clocks.check_bounds("clocks").is_err());
    clocks = ClocksConfig::default();
    clocks.lidar.drift_ppm = f64::NAN;
    assert!(clocks.check_bounds("clocks").is_err());
}
