use lsfb_recording::message::{GnssReading, MagneticSample};
use lsfb_types::no_progress;
use nalgebra::{Matrix3, Vector3};

use super::*;
use crate::config::{GnssConfig, Place, WifiConfig};
use crate::datum::DatumConfig;
use crate::noise::stream;
use crate::walk::{PaperMotion, Walker};
use crate::world::builder::{Faces, Placement};
use crate::world::material::Material;
use crate::world::{Blueprint, FloorPlan};
use crate::{Simulation, WalkConfig};

/// Ground and sky, and what `build` adds.
fn world(build: impl Fn(&mut Blueprint)) -> World {
    let mut plan = Blueprint::default();
    let ground = Material::GRASS;
    let (corner, x, y) = ([-60.0, -60.0, 0.0], [120.0, 0.0, 0.0], [0.0, 120.0, 0.0]);
    plan.builder.quad(corner, x, y, ground);
    build(&mut plan);
    World::of(&plan, 1, 0.1, &no_progress).expect("built")
}

/// A wall along x = 0, thirty metres long.
fn wall(plan: &mut Blueprint, material: Material) {
    let place = Placement::new([0.0, 0.0, 0.0], 0.0);
    let (low, high) = ([0.0, -15.0, 0.0], [0.3, 15.0, 8.0]);
    plan.builder.cuboid(&place, low, high, Faces::All, material);
}

fn walk(duration_s: f64) -> Walk {
    let config = WalkConfig {
        duration_s,
        ..WalkConfig::default()
    };
    Walk::new(&FloorPlan::new(1), Walker::Glasses, &config, 1)
}

/// Slope of a line through points, and its standard deviation.
fn line(points: &[(f64, f64)]) -> [f64; 2] {
    let n = points.len() as f64;
    let mean = |f: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(f).sum::<f64>() / n;
    let (x, y) = (mean(&|p| p.0), mean(&|p| p.1));
    let sxx: f64 = points.iter().map(|p| (p.0 - x).powi(2)).sum();
    let sxy: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    let slope = sxy / sxx;
    let left: f64 = points
        .iter()
        .map(|p| (p.1 - y - slope * (p.0 - x)).powi(2))
        .sum();
    [slope, (left / (n - 2.0) / sxx).sqrt()]
}

#[test]
fn a_fit_finds_the_path_loss_within_its_deviation() {
    let open = world(|_| {});
    for (exponent, seed) in [(2.0, 1), (3.2, 2)] {
        let config = WifiConfig {
            path_loss_exponent: exponent,
            body_loss_db: 0.0,
            floor_dbm: -120.0,
            ..WifiConfig::default()
        };
        let law = radio::Law::from(&config);
        let receiver = Receiver { offset_db: 1.5 };
        let dice = stream(seed, "test", 0);
        let mut points = Vec::new();
        for number in 0..480_u64 {
            // Each of another transmitter, whose shadows are its own.
            let source = RadioSource {
                position_m: Vector3::new(0.0, 0.0, 2.0),
                power_dbm: 20.0,
                frequency_mhz: 2437.0,
                number,
            };
            let from = radio::Shadowed::new(&source, &law, seed);
            let distance = 1.5 * 1.37_f64.powi((number % 12) as i32);
            let place = Vector3::new(distance, 0.0, 2.0);
            let mean = radio::mean_dbm(&law, &receiver, &open, &from, place, Vector3::x());
            let rssi = radio::reading_dbm(&law, mean, &dice).expect("heard");
            points.push((distance.log10(), f64::from(rssi)));
        }
        let [slope, sigma] = line(&points);
        assert!(sigma < 0.6, "{sigma}");
        assert!(
            (slope + 10.0 * exponent).abs() < 2.5 * sigma,
            "{slope} ± {sigma}"
        );
    }
}

#[test]
fn walls_cost_what_they_are_made_of_once_and_from_both_sides() {
    let sides = [Vector3::new(-3.0, 0.0, 1.5), Vector3::new(4.0, 1.0, 1.5)];
    for (material, at_2400, at_5500) in [
        (Material::BRICK, 8.0, 13.0),
        (Material::CONCRETE, 13.0, 21.0),
        (Material::PLASTER, 3.0, 4.5),
        (Material::METAL, 18.0, 23.0),
    ] {
        let world = world(|plan| wall(plan, material));
        let [a, b] = sides;
        for (from, to) in [(a, b), (b, a)] {
            assert_eq!(wall_loss_db(&world, from, to, 2400.0), at_2400);
            assert_eq!(wall_loss_db(&world, from, to, 5500.0), at_5500);
        }
        let beside = Vector3::new(-3.0, 8.0, 1.5);
        assert_eq!(wall_loss_db(&world, a, beside, 2400.0), 0.0);
    }
}

#[test]
fn shadows_are_normal_and_fade_with_distance() {
    let (mut squares, mut near, mut far) = (0.0, 0.0, 0.0);
    let fields = 1500;
    for seed in 0..fields {
        let field = smooth::SmoothField::new(3.0, seed);
        let at = |x: f64| field.at(Vector3::new(x, 0.4, 1.0));
        squares += at(0.0).powi(2);
        near += at(0.0) * at(3.0);
        far += at(0.0) * at(12.0);
    }
    let n = fields as f64;
    assert!((squares / n - 1.0).abs() < 0.1, "{}", squares / n);
    assert!((near / n - (-1.0_f64).exp()).abs() < 0.09, "{}", near / n);
    assert!((far / n - (-4.0_f64).exp()).abs() < 0.09, "{}", far / n);
}

#[test]
fn scans_are_throttled_as_android_does() {
    let config = WifiConfig::default();
    let times = radio::scan_times(&config, 600.0, 3_500_000_000);
    assert_eq!(
        times
            .iter()
            .map(|t| t / 1_000_000_000)
            .take(6)
            .collect::<Vec<_>>(),
        [0, 10, 20, 30, 120, 130]
    );
    for (k, begin) in times.iter().enumerate() {
        let within = times[k..].iter().filter(|t| *t - begin < 120_000_000_000);
        assert!(within.count() <= 4);
    }
    let free = WifiConfig {
        throttle_scans: 1000,
        ..config
    };
    assert_eq!(radio::scan_times(&free, 600.0, 3_500_000_000).len(), 60);
}

fn simulation(place: Place, motion: Option<&str>, device: Device) -> Simulation {
    let mut config = match motion {
        Some(name) => SimConfig::for_motion(PaperMotion::named(name).expect("known"), device),
        None => SimConfig::for_place(place, device),
    };
    config.texel_m = 0.05;
    for cameras in [&mut config.scan_cameras, &mut config.glasses_cameras] {
        (cameras.width, cameras.height) = (64, 40);
    }
    Simulation::new(&config, &no_progress).expect("valid")
}

#[test]
fn what_a_phone_hears_in_a_corridor() {
    let android = simulation(Place::NarrowCorridor, None, Device::Android);
    let around = android.surroundings();
    let walk = android.glasses().walk();
    let messages = around.messages(android.world(), walk);
    assert!(messages.is_sorted_by_key(|m| m.ready_ns));
    assert!(messages.iter().all(|m| m.measured_ns <= m.ready_ns));
    let of = |kind| messages.iter().filter(move |m| m.channel() == kind);
    // Each scan arrives at once, its readings have times of their own.
    let mut scans = 0;
    for scan in 0..9 {
        let readings: Vec<_> = of(AmbientChannel::Wifi)
            .filter(|m| matches!(&m.sample, AmbientSample::Wifi(r) if r.scan == scan))
            .collect();
        if readings.len() > 2 {
            scans += 1;
            assert!(readings.windows(2).all(|w| w[0].ready_ns == w[1].ready_ns));
            let mut times: Vec<i64> = readings.iter().map(|m| m.measured_ns).collect();
            times.dedup();
            assert!(times.len() > 1);
        }
    }
    assert!(scans >= 4, "{scans}");
    // Every beacon of a corridor is heard about once a second.
    let beacons = around.transmitters().beacons.len() as f64;
    let heard = of(AmbientChannel::Ble).count() as f64;
    let share = heard / (beacons * walk.duration_s());
    assert!((0.8..=1.0).contains(&share), "{share}");
    let strongest = of(AmbientChannel::Ble).filter_map(|m| match &m.sample {
        AmbientSample::Ble(advert) => Some(advert.rssi_dbm),
        _ => None,
    });
    let strongest = strongest.max().expect("heard");
    assert!((-75..=-35).contains(&strongest), "{strongest}");
    // No sky above a corridor.
    let fixes = around.gnss(android.world(), walk);
    assert!(fixes.len() > 20 && fixes.iter().all(|e| e.reading == GnssReading::default()));

    let mut config = android.config().clone();
    config.device = Device::Iphone;
    let iphone = Surroundings::new(&config, android.world(), walk);
    let messages = iphone.messages(android.world(), walk);
    assert!(messages.iter().all(|m| match &m.sample {
        AmbientSample::Wifi(_) => false,
        AmbientSample::Ble(advert) => advert.address.is_empty() && advert.data.is_empty(),
        _ => true,
    }));
}

#[test]
fn an_advertisement_is_an_ibeacon() {
    let around = simulation(Place::NarrowCorridor, None, Device::Android);
    let beacon = &around.surroundings().transmitters().beacons[1];
    let hex: String = beacon
        .advertisement()
        .iter()
        .map(|b| format!("{b:02x}"))
        .collect();
    // Flags, Apple's prefix, UUID, the place's major, minor 2, −59 dBm; layout as in the vector of the specification.
    let major = beacon.major;
    assert_eq!(
        hex,
        format!("0201061aff4c0002159195b3ada9d0450085ff9fb0f65a5201{major:04x}0002c5")
    );
}

#[test]
fn the_field_is_earths_bent_by_steel_and_seen_through_the_phones_iron() {
    let simulation = simulation(Place::NarrowCorridor, None, Device::Android);
    let around = simulation.surroundings();
    let magnetic = around.magnetic();
    // Munich: 48.6 µT, of which 21.4 horizontal (IGRF); the dipole alone is right within 15 %.
    let earth = magnetic.earth_t;
    assert!((earth.norm() - 48.6e-6).abs() < 0.15 * 48.6e-6, "{earth}");
    assert!((earth.xy().norm() - 21.4e-6).abs() < 3.5e-6 && earth.z < -35e-6);
    assert!(!magnetic.dipoles.is_empty());

    let sensor = around.magnetic_sensor();
    let back = sensor.soft_iron.try_inverse().expect("nearly the identity");
    let walk = simulation.glasses().walk();
    let (mut noise, mut count) = (0.0, 0.0);
    let mut norms = Vec::new();
    for message in around.messages(simulation.world(), walk) {
        let AmbientSample::Magnetic(MagneticSample { field_t, .. }) = message.sample else {
            continue;
        };
        let pose = walk.at(message.measured_ns as f64 * 1e-9).world_from_rig;
        let field = back * (Vector3::from(field_t) - sensor.hard_iron_t);
        let truth = magnetic.at(pose.translation);
        noise += (pose.rotation * field - truth).norm_squared() / 3.0;
        norms.push(truth.norm());
        count += 1.0;
    }
    let noise = (noise / count).sqrt();
    assert!((noise - 0.3e-6).abs() < 0.03e-6, "{noise}");
    assert!((count / walk.duration_s() - 100.0).abs() < 1.0);
    // A corridor's doors are felt, and the field stays a field.
    let mean = norms.iter().sum::<f64>() / count;
    let spread = (norms.iter().map(|n| (n - mean).powi(2)).sum::<f64>() / count).sqrt();
    assert!((0.3e-6..20e-6).contains(&spread), "{spread}");
    assert!(norms.iter().all(|n| (5e-6..200e-6).contains(n)));
}

#[test]
fn a_storey_is_felt_by_the_barometer() {
    let simulation = simulation(Place::Stairs, Some("S0"), Device::Android);
    let walk = simulation.glasses().walk();
    let height = |m: &AmbientMessage| {
        walk.at(m.measured_ns as f64 * 1e-9)
            .world_from_rig
            .translation
            .z
    };
    let messages = simulation.surroundings().messages(simulation.world(), walk);
    let (mut above, mut below) = (Vec::new(), Vec::new());
    for message in &messages {
        if let AmbientSample::Pressure(sample) = message.sample {
            if height(message) > 5.0 {
                above.push(sample.pressure_pa);
            } else if height(message) < 2.0 {
                below.push(sample.pressure_pa);
            }
        }
    }
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    // Four metres at 565 m are 45 Pa; weather and noise change that by little.
    let step = mean(&below) - mean(&above);
    assert!((35.0..55.0).contains(&step), "{step}");
}

#[test]
fn positions_are_as_far_off_as_they_say() {
    let open = world(|_| {});
    // A façade to the south as well: its echoes are in the covariance.
    let street = world(|plan| {
        let place = Placement::new([0.0, 0.0, 0.0], 0.0);
        let (low, high) = ([-30.0, -8.0, 0.0], [30.0, -2.0, 12.0]);
        plan.builder
            .cuboid(&place, low, high, Faces::All, Material::BRICK);
    });
    let datum = DatumConfig::default();
    let config = GnssConfig::default();
    let walk = walk(0.5);
    let mut sigmas = Vec::new();
    for world in [&open, &street] {
        let (mut inside, mut count) = (0.0, 0.0);
        let mut sum = Matrix3::zeros();
        for seed in 0..1500 {
            // Another hour each time: other satellites.
            let begin = EPOCH.plus_nanos(seed as i64 * 3_600_000_000_000);
            let epochs = gnss::epochs(&config, &datum, world, &walk, begin, seed);
            let Some(error) = epochs[0].error else {
                continue;
            };
            let inverse = error.covariance_m2.try_inverse().expect("regular");
            let nees = error.enu_m.dot(&(inverse * error.enu_m));
            // 95 % of a chi-squared with three degrees of freedom.
            inside += f64::from(u8::from(nees < 7.815));
            sum += error.covariance_m2;
            count += 1.0;
        }
        let share = inside / count;
        assert!((0.93..=0.97).contains(&share), "{share}");
        sigmas.push((sum.trace() / count).sqrt());
        assert!(count > 300.0);
    }
    // A few metres in the open, worse in the street.
    assert!((1.0..6.0).contains(&sigmas[0]), "{sigmas:?}");
    assert!(sigmas[1] > 1.3 * sigmas[0], "{sigmas:?}");
}

#[test]
fn errors_of_positions_last_and_the_earth_is_round() {
    let open = world(|_| {});
    let datum = DatumConfig::default();
    let walk = walk(120.0);
    let epochs = gnss::epochs(&GnssConfig::default(), &datum, &open, &walk, EPOCH, 4);
    assert_eq!(epochs.len(), 121);
    let errors: Vec<Vector3<f64>> = epochs
        .iter()
        .filter_map(|e| e.error.map(|e| e.enu_m))
        .collect();
    assert!(errors.len() > 110);
    let step: f64 = errors.windows(2).map(|w| (w[1] - w[0]).norm()).sum::<f64>();
    let size: f64 = errors.iter().map(|e| e.norm()).sum::<f64>();
    assert!(step < 0.9 * size, "{step} {size}");
    // What it says is the truth plus the error: a degree of latitude is 111.2 km here.
    for epoch in &epochs {
        let (Some(fix), Some(error)) = (epoch.reading.fix, epoch.error) else {
            continue;
        };
        let place = walk
            .at(epoch.offset_ns as f64 * 1e-9)
            .world_from_rig
            .translation
            + error.enu_m;
        let north = (fix.latitude_deg - datum.latitude_deg) * 111_200.0;
        let east = (fix.longitude_deg - datum.longitude_deg) * 74_360.0;
        assert!((north - place.y).abs() < 0.01 + 1e-3 * place.y.abs());
        assert!((east - place.x).abs() < 0.01 + 2e-3 * place.x.abs());
        assert!((fix.altitude_m - datum.altitude_m - place.z).abs() < 1e-3);
    }
}

#[test]
fn what_cannot_be_is_refused() {
    let refused = |change: fn(&mut SimConfig)| {
        let mut config = SimConfig::tiny();
        change(&mut config);
        assert!(config.check().is_err(), "{config:?}");
    };
    assert!(SimConfig::tiny().check().is_ok());
    refused(|c| c.datum.latitude_deg = f64::NAN);
    refused(|c| c.datum.latitude_deg = 90.0);
    refused(|c| c.wifi.request_every_s = -1.0);
    refused(|c| c.wifi.path_loss_exponent = 0.0);
    refused(|c| c.ble.report_hz = f64::INFINITY);
    refused(|c| c.ble.rice_factor_db = f64::NAN);
    refused(|c| c.magnetic.rate_hz = 1_000_000);
    refused(|c| c.barometer.noise_pa = -1.0);
    refused(|c| c.gnss.multipath_s = 0.0);
    refused(|c| (c.gnss.noise_m, c.gnss.atmosphere_m) = (0.0, 0.0));
}

#[test]
fn any_number_of_threads_hears_the_same() {
    let once = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| {
            let simulation = simulation(Place::NarrowCorridor, None, Device::Glasses);
            let around = simulation.surroundings();
            let messages = around.messages(simulation.world(), simulation.glasses().walk());
            (around.truth(), messages)
        })
    };
    assert!(once(1) == once(3));
}
