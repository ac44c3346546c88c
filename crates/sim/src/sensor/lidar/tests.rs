use super::echo::Echo;
use super::*;
use crate::config::SimConfig;
use crate::simulation::Simulation;
use lsfb_types::no_progress;

fn simulation(range_noise_m: f64) -> Simulation {
    let mut config = SimConfig::tiny();
    config.texel_m = 0.1;
    config.lidar.range_noise_m = range_noise_m;
    Simulation::new(&config, &no_progress).expect("valid")
}

/// Where each point of a scan lies along its own ray beyond the surface that the ray meets.
fn residuals(simulation: &Simulation, number: u32) -> Vec<f64> {
    let stamped = simulation
        .scan()
        .scan(simulation.world(), number)
        .expect("points");
    let start = stamped.time - simulation.scan().start();
    stamped
        .sample
        .points
        .iter()
        .filter_map(|point| {
            let at_ns = start + i64::from(point.time_offset_ns);
            let pose = simulation.scan().world_from_lidar(at_ns as f64 * 1e-9);
            let in_lidar = Vector3::from(point.position_m.map(f64::from));
            let ray = pose.rotation * in_lidar.normalize();
            let hit = simulation.world().cast(
                pose.translation.map(|v| v as f32).into(),
                ray.map(|v| v as f32).into(),
            )?;
            let off = in_lidar.norm() - f64::from(hit.distance);
            // Where the ray grazes an edge the rounded azimuth may choose the other surface.
            (off.abs() < 0.3).then_some(off)
        })
        .collect()
}

#[test]
fn points_lie_on_the_surfaces_with_the_stated_noise() {
    let noisy = residuals(&simulation(0.03), 15);
    let n = noisy.len() as f64;
    assert!(n > 40_000.0, "{n} points");
    let mean = noisy.iter().sum::<f64>() / n;
    let sigma = (noisy.iter().map(|r| r * r).sum::<f64>() / n - mean * mean).sqrt();
    let tail = noisy.iter().filter(|r| r.abs() > 1.96 * 0.03).count() as f64 / n;
    assert!(
        mean.abs() < 5e-4 && (sigma - 0.03).abs() < 1e-3,
        "{mean} ± {sigma}"
    );
    assert!((tail - 0.05).abs() < 0.006, "{tail}");
}

#[test]
fn without_noise_only_the_steps_of_range_and_azimuth_remain() {
    let exact = residuals(&simulation(0.0), 20);
    let outside = exact.iter().filter(|r| r.abs() > 0.004).count() as f64 / exact.len() as f64;
    assert!(outside < 0.005, "{outside} of the points are off");
}

#[test]
fn time_of_a_point_follows_the_firing_sequence() {
    let simulation = simulation(0.03);
    let lidar = simulation.scan().lidar().expect("a LiDAR");
    let cycle_ns = lidar.cycle_ns();
    let first = simulation.scan().revolution(simulation.world(), 3);
    let second = simulation.scan().revolution(simulation.world(), 4);
    assert_eq!(
        first.last().map(|c| c.offset_ns + cycle_ns),
        second.first().map(|c| c.offset_ns)
    );
    assert!(
        first
            .windows(2)
            .all(|w| w[1].offset_ns - w[0].offset_ns == cycle_ns)
    );
    assert!(
        first
            .windows(2)
            .all(|w| w[1].azimuth_centideg > w[0].azimuth_centideg)
    );
    assert!((1808..=1809).contains(&first.len()));
    let scan = simulation
        .scan()
        .scan(simulation.world(), 3)
        .expect("points")
        .sample;
    assert!(
        scan.points
            .windows(2)
            .all(|w| w[0].time_offset_ns <= w[1].time_offset_ns)
    );
    assert!(
        scan.points
            .iter()
            .all(|p| i64::from(p.time_offset_ns) % cycle_ns <= 15 * 2304)
    );
    let mut rings: Vec<u16> = (0..CHANNELS).map(|c| lidar.ring(c)).collect();
    assert_eq!([rings[0], rings[1], rings[29], rings[5]], [0, 17, 31, 20]);
    rings.sort_unstable();
    assert_eq!(rings, (0..32).collect::<Vec<_>>());
}

#[test]
fn any_number_of_threads_gives_the_same_returns() {
    let mut dual = SimConfig::tiny();
    (dual.texel_m, dual.lidar.returns) = (0.1, Returns::Dual);
    dual.lidar.divergence_rad = [3e-3, 1.5e-3];
    let dual = Simulation::new(&dual, &no_progress).expect("valid");
    for simulation in [simulation(0.03), dual] {
        let on = |threads| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("pool")
                .install(|| simulation.scan().revolution(simulation.world(), 7))
        };
        assert!(on(1) == on(3));
    }
}

/// Upright squares across the x axis.
fn world_of(walls: &[(f32, [f32; 2], crate::world::material::Material)]) -> World {
    let mut builder = crate::world::builder::Builder::default();
    for &(x, [left, right], material) in walls {
        let corner = [x, left, -4.0];
        builder.quad(corner, [0.0, right - left, 0.0], [0.0, 0.0, 8.0], material);
    }
    let blueprint = crate::world::Blueprint {
        builder,
        ambient: 1.0,
        ..Default::default()
    };
    World::of(&blueprint, 1, 0.1, &no_progress).expect("built")
}

#[test]
fn shots_go_through_glass_and_come_back_from_it_head_on_only() {
    use crate::world::material::Material;
    let across = [4.0, -4.0];
    let world = world_of(&[
        (2.0, across, Material::GLASS),
        (5.0, across, Material::PLASTER),
    ]);
    let moment = world.moment(0.0, [0.0; 2]);
    let sim = LidarSim::new(Se3::identity(), &LidarConfig::default(), 4);
    let mut from_glass = 0;
    for k in 0..100 {
        let number = |lane| 8 * k + lane as u64;
        let rays = RayPacket::splat([0.0; 3], [1.0, 0.0, 0.0]);
        let trail = sim.follow(&world, &moment, rays, number)[0];
        let echoes = trail.as_slice();
        let wall = echoes.last().expect("a wall");
        assert!((wall.distance_m - 5.0).abs() < 1e-4, "{echoes:?}");
        if let [pane, _] = echoes {
            assert!((pane.distance_m - 2.0).abs() < 1e-4, "{echoes:?}");
            from_glass += 1;
            // The pane glares: it is the strongest, the wall the last.
            let sent = |returns| {
                let config = LidarConfig {
                    returns,
                    range_noise_m: 0.0,
                    dropout: 0.0,
                    ..LidarConfig::default()
                };
                let sim = LidarSim::new(Se3::identity(), &config, 4);
                sim.answer(echoes, number(0)).map(|r| r.range_count)
            };
            assert_eq!(sent(Returns::Strongest), [500, 0]);
            assert_eq!(sent(Returns::Last), [1250, 0]);
            assert_eq!(sent(Returns::Dual), [1250, 500]);
        }
        let ray = [0.8, 0.6, 0.0];
        let slanted = RayPacket::splat([0.0; 3], ray);
        let trail = sim.follow(&world, &moment, slanted, number)[3];
        let [echo] = trail.as_slice() else {
            panic!("{trail:?}");
        };
        assert!((echo.distance_m - 6.25).abs() < 1e-4, "{echo:?}");
    }
    assert!((40..80).contains(&from_glass), "{from_glass}");
}

#[test]
fn a_beam_on_an_edge_is_answered_by_both_surfaces() {
    use crate::world::material::Material;
    // A near wall to the left of the x axis, a far one behind it: 3 mrad are 18 mm at 6 m.
    for (near_m, far_m, echoes) in [(6.0, 9.0, 2), (6.0, 6.5, 1)] {
        let world = world_of(&[
            (near_m, [4.0, 0.0], Material::PLASTER),
            (far_m, [4.0, -4.0], Material::PLASTER),
        ]);
        let moment = world.moment(0.0, [0.0; 2]);
        let config = LidarConfig {
            divergence_rad: [3e-3, 1.5e-3],
            ..LidarConfig::default()
        };
        let sim = LidarSim::new(Se3::identity(), &config, 4);
        let met = |y: f64| {
            let pose = Se3::new(
                nalgebra::UnitQuaternion::identity(),
                Vector3::new(0.0, y, 0.0),
            );
            // The laser that looks straight ahead.
            let volley = sim.aim(5, &[pose; LANES], |_| 1.4);
            let trail = sim.shoot(&world, &moment, &volley, |lane| lane as u64)[0];
            trail.as_slice().to_vec()
        };
        let (left, right) = (met(0.03), met(-0.03));
        assert!((left[0].distance_m - f64::from(near_m)).abs() < 1e-3 && left.len() == 1);
        assert!((right[0].distance_m - f64::from(far_m)).abs() < 1e-3 && right.len() == 1);
        // With most of the beam on the near wall, and with most of it beside.
        let (most, least) = (met(0.003), met(-0.003));
        assert_eq!([most.len(), least.len()], [echoes; 2]);
        if echoes == 2 {
            for [near, far] in [&most, &least].map(|e| [e[0], e[1]]) {
                assert!((near.distance_m - 6.0).abs() < 1e-3, "{near:?}");
                assert!((far.distance_m - 9.0).abs() < 1e-3, "{far:?}");
                let share = near.reflectance + far.reflectance;
                assert!((share - left[0].reflectance).abs() < 0.05, "{share}");
            }
            assert!(most[0].reflectance > most[1].reflectance);
            assert!(least[0].reflectance < least[1].reflectance);
        } else {
            // One echo between the two, nearer to the surface that covers more.
            assert!((6.1..6.3).contains(&most[0].distance_m), "{most:?}");
            assert!((6.2..6.4).contains(&least[0].distance_m), "{least:?}");
            assert!(most[0].distance_m < least[0].distance_m);
        }
    }
}

#[test]
fn of_many_echoes_the_second_strongest_is_sent_where_the_strongest_is_the_last() {
    let config = LidarConfig {
        returns: Returns::Dual,
        range_noise_m: 0.0,
        dropout: 0.0,
        ..LidarConfig::default()
    };
    let sim = LidarSim::new(Se3::identity(), &config, 4);
    let sent = |reflectances: &[f64]| {
        let echoes: Vec<Echo> = reflectances
            .iter()
            .enumerate()
            .map(|(k, &reflectance)| Echo {
                distance_m: 10.0 + 2.0 * k as f64,
                cosine: 1.0,
                reflectance,
                glare: 1.0,
                ..Echo::default()
            })
            .collect();
        let in_m = |r: Return| f64::from(r.range_count) * 0.004;
        sim.answer(&echoes, 7).map(in_m)
    };
    assert_eq!(sent(&[]), [0.0, 0.0]);
    assert_eq!(sent(&[0.4]), [10.0, 10.0]);
    assert_eq!(sent(&[0.4, 0.2]), [12.0, 10.0]);
    assert_eq!(sent(&[0.2, 0.2, 0.9]), [14.0, 10.0]);
    assert_eq!(sent(&[0.1, 0.3, 0.9]), [14.0, 12.0]);
    assert_eq!(sent(&[0.1, 0.5, 0.2]), [14.0, 12.0]);
}

#[test]
fn dark_and_distant_surfaces_are_lost_first() {
    let sim = LidarSim::new(Se3::identity(), &LidarConfig::default(), 4);
    let seen = |distance_m: f64, reflectance: f64| {
        let echo = Echo {
            distance_m,
            cosine: 1.0,
            reflectance,
            glare: 1.0,
            ..Echo::default()
        };
        (0..500)
            .filter(|&n| sim.measure(&echo, n).range_count > 0)
            .count()
    };
    assert!(seen(20.0, 0.05) > 490 && seen(90.0, 0.5) > 490);
    assert!(seen(140.0, 0.1) < 350 && seen(140.0, 0.1) > 150);
    assert!(seen(140.0, 0.1) < seen(140.0, 0.3));
}
