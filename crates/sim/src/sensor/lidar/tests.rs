use super::*;
use crate::config::{LidarConfig, SimConfig};
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
    let first = simulation.scan().revolution(simulation.world(), 3);
    let second = simulation.scan().revolution(simulation.world(), 4);
    assert_eq!(
        first.last().map(|c| c.offset_ns + CYCLE_NS),
        second.first().map(|c| c.offset_ns)
    );
    assert!(
        first
            .windows(2)
            .all(|w| w[1].offset_ns - w[0].offset_ns == CYCLE_NS)
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
            .all(|p| i64::from(p.time_offset_ns) % CYCLE_NS <= 15 * 2304)
    );
    let mut rings: Vec<u16> = (0..LASERS).map(ring).collect();
    assert_eq!([rings[0], rings[1], rings[29], rings[5]], [0, 17, 31, 20]);
    rings.sort_unstable();
    assert_eq!(rings, (0..32).collect::<Vec<_>>());
}

#[test]
fn any_number_of_threads_gives_the_same_returns() {
    let simulation = simulation(0.03);
    let on = |threads| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("pool")
            .install(|| simulation.scan().revolution(simulation.world(), 7))
    };
    assert!(on(1) == on(3));
}

#[test]
fn shots_go_through_glass_and_come_back_from_it_head_on_only() {
    let mut builder = crate::world::builder::Builder::default();
    for (x, material) in [
        (2.0, crate::world::material::Material::GLASS),
        (5.0, crate::world::material::Material::PLASTER),
    ] {
        builder.quad([x, 4.0, -4.0], [0.0, -8.0, 0.0], [0.0, 0.0, 8.0], material);
    }
    let blueprint = crate::world::Blueprint {
        builder,
        ambient: 1.0,
        ..Default::default()
    };
    let world = World::of(&blueprint, 1, 0.1, &no_progress);
    let moment = world.moment(0.0, [0.0; 2]);
    let sim = LidarSim::new(Se3::identity(), &LidarConfig::default(), 4);
    let mut from_glass = 0;
    for k in 0..100 {
        let rays = RayPacket::splat([0.0; 3], [1.0, 0.0, 0.0]);
        let echo =
            sim.echoes(&world, &moment, rays, |lane| 8 * k + lane as u64)[0].expect("a wall");
        let pane = (echo.distance_m - 2.0).abs() < 1e-4;
        assert!(pane || (echo.distance_m - 5.0).abs() < 1e-4, "{echo:?}");
        from_glass += usize::from(pane);
        let ray = [0.8, 0.6, 0.0];
        let slanted = RayPacket::splat([0.0; 3], ray);
        let echo =
            sim.echoes(&world, &moment, slanted, |lane| 8 * k + lane as u64)[3].expect("a wall");
        assert!((echo.distance_m - 6.25).abs() < 1e-4, "{echo:?}");
    }
    assert!((40..80).contains(&from_glass), "{from_glass}");
}

#[test]
fn dark_and_distant_surfaces_are_lost_first() {
    let sim = LidarSim::new(Se3::identity(), &LidarConfig::default(), 4);
    let seen = |distance_m: f64, reflectance: f64| {
        let echo = Echo {
            distance_m,
            cosine: 1.0,
            reflectance,
        };
        (0..500)
            .filter(|&n| sim.measure(&echo, n).range_count > 0)
            .count()
    };
    assert!(seen(20.0, 0.05) > 490 && seen(90.0, 0.5) > 490);
    assert!(seen(140.0, 0.1) < 350 && seen(140.0, 0.1) > 150);
    assert!(seen(140.0, 0.1) < seen(140.0, 0.3));
}
