//! A corridor of equal doors: each place looks like the one a door on.

use super::*;

const DOOR_EVERY_M: f64 = 4.0;

/// Its ends are out of sight.
fn corridor() -> Room {
    let mut boxes = vec![[[-200.0, -1.5, 0.0], [200.0, 1.5, 2.6]]];
    for k in -20..20 {
        let at = f64::from(k) * DOOR_EVERY_M;
        boxes.push([[at, 1.3, 0.0], [at + 1.0, 1.5, 2.6]]);
        boxes.push([[at + 1.5, -1.5, 0.0], [at + 2.3, -1.3, 2.6]]);
    }
    Room::of(&boxes)
}

/// What odometry says where scans do not tell how far along the corridor one is.
fn blind_along(sigma_m: f64) -> Vector6<f64> {
    Vector6::new(1e-4, 1e-4, 1e-4, sigma_m, 0.002, 0.002)
}

#[test]
fn no_door_is_taken_for_another_on_the_way_out() {
    let stops = stops(&[[-20.0, 0.0], [25.0, 0.0]], 0.5, 0.0);
    let clouds = seen(&corridor(), &stops);
    for (slip_m, sigma_m) in [(0.0, 0.002), (-0.1, 0.1), (-0.3, 0.4)] {
        let drift = |_| Vector6::new(0.0, 0.0, 0.0, slip_m, 0.0, 0.0);
        let result = walk(&clouds, &stops, drift, &blind_along(sigma_m));
        let loops = found(&result);
        assert_eq!(
            loops.accepted().count(),
            0,
            "{slip_m} m: {}",
            decisions(&loops)
        );
    }
}

/// On the way back the odometry is a door off, and says that it may be. Naively every place on the way fits, and all agree with each other.
#[test]
fn no_door_is_taken_for_another_on_the_way_back() {
    let there_and_back = [[-15.0, 0.0], [15.0, 0.0], [-10.0, 0.0]];
    let stops = stops(&there_and_back, 0.5, 0.0);
    let clouds = seen(&corridor(), &stops);
    for (slips_m, sigma_m) in [(0.0, 0.003), (DOOR_EVERY_M, 0.15)] {
        // Slips where it turns back.
        let drift = |k: usize| {
            let slip_m = if (50..60).contains(&k) {
                0.1 * slips_m
            } else {
                0.0
            };
            Vector6::new(0.0, 0.0, 0.0, slip_m, 0.0, 0.0)
        };
        let result = walk(&clouds, &stops, drift, &blind_along(sigma_m));
        let loops = found(&result);
        let errors = errors_m(&loops, &result, &stops);
        assert!(errors.iter().all(|e| *e < 0.1), "{slips_m} m: {errors:?}");
    }
}
