//! Refinement of the LiDAR's pose to cameras on simulated walks against exact truth.

#[path = "../tests/simulated_walk/mod.rs"]
mod simulated_walk;

use lsfb_geometry::{Se3, Vector3, Vector6};
use lsfb_recording::Recording;
use lsfb_sim::SimConfig;
use lsfb_types::no_progress;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use simulated_walk::Walk;

type Failure = Box<dyn std::error::Error>;
const CAMERAS: [&str; 2] = ["cam0", "cam1"];

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let word = |k: usize, default: &str| arguments.get(k).map_or(default.into(), String::clone);
    let (from, to, seconds): (u64, u64, f64) = (
        word(0, "1").parse()?,
        word(1, "2").parse()?,
        word(2, "36").parse()?,
    );
    let size: f64 = word(3, "1").parse()?;
    let folder = std::path::PathBuf::from("/tmp/refine-walks");
    std::fs::create_dir_all(&folder)?;
    let (mut total, mut n) = (0.0, 0.0);
    let mut comp = [0.0; 6];
    let mut mean = [0.0; 6];
    for seed in from..=to {
        let path = folder.join(format!("{seed}-{seconds}.mcap"));
        if !path.exists() {
            let config = SimConfig {
                seed,
                ..SimConfig::default()
            };
            let t = std::time::Instant::now();
            let walk = Walk::simulate(&config, &CAMERAS, seconds);
            let part = folder.join(format!("{seed}-{seconds}.part"));
            walk.write(&part, 0.0);
            std::fs::rename(&part, &path)?;
            eprintln!("simulated {:?}", t.elapsed());
        }
        if size < 0.0 {
            continue;
        }
        let recording = Recording::open(&path)?;
        let mut rig = recording.rig()?;
        let lidar = rig.lidar.as_mut().ok_or("lidar")?;
        let truth = lidar.rig_from_lidar;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut direction = || {
            let any = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            any.try_normalize(1e-3).unwrap_or_else(Vector3::x)
        };
        let (turn, shift) = (
            direction() * 2.5f64.to_radians() * size,
            direction() * 0.05 * size,
        );
        lidar.rig_from_lidar = lidar.rig_from_lidar
            * Se3::exp(&Vector6::new(
                turn.x, turn.y, turn.z, shift.x, shift.y, shift.z,
            ));
        let t = std::time::Instant::now();
        let found =
            lsfb_calib::verify::refine(&recording, &rig, &Default::default(), &no_progress)?;
        eprintln!("{:?}", t.elapsed());
        for c in &found.cameras {
            let Some(edge) = &c.edge else {
                println!("seed {seed} {}: {}", c.camera, c.sentence);
                continue;
            };
            let want = rig.cameras[&c.camera].rig_from_camera.inverse() * truth;
            let off = (edge.target_from_source * want.inverse()).log();
            let ad = edge.target_from_source.adjoint();
            let cov = ad * edge.covariance.unwrap() * ad.transpose();
            let nees = off.dot(&(cov.try_inverse().unwrap() * off)) / 6.0;
            let z: Vec<String> = (0..6)
                .map(|k| format!("{:+.2}", off[k] / cov[(k, k)].sqrt()))
                .collect();
            println!(
                "seed {seed} {}: left {:.3}° {:.1} mm, NEES/6 {nees:.2}, off mdeg/mm {:?}, z {z:?} {} {:?}",
                c.camera,
                off.fixed_rows::<3>(0).norm().to_degrees(),
                off.fixed_rows::<3>(3).norm() * 1e3,
                (0..6)
                    .map(|k| format!("{:+.1}", off[k] * if k < 3 { 57295.8 } else { 1e3 }))
                    .collect::<Vec<_>>(),
                c.sentence,
                c.evidence.as_ref().map(|e| e.transfer)
            );
            for k in 0..6 {
                let z = off[k] / cov[(k, k)].sqrt();
                comp[k] += z * z;
                mean[k] += z;
            }
            total += nees;
            n += 1.0;
        }
    }
    println!(
        "mean NEES/6 {:.2}; z² {:?}; mean z {:?}",
        total / n,
        comp.map(|c| (c / n * 100.0f64).round() / 100.0),
        mean.map(|c| (c / n * 100.0f64).round() / 100.0)
    );
    Ok(())
}
