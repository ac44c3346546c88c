//! Cameras on an IMU against exact truth: `simulated_rig SEEDS SECONDS [AXES]` prints the errors of each seed and, by kind of
//! parameter, how often they lie within 1.96 of their stated standard deviations, with IMUs whose scales and axes are off by AXES
//! (a share and rad; 0); `simulated_rig shuffle RUNS` gives the same input in other orders.

use std::collections::BTreeMap;
use std::time::Instant;

use lsfb_calib::camera::{CameraConfig, calibrate_cameras};
use lsfb_calib::camera_imu::{
    CameraImuCalibration, CameraImuConfig, KnownCamera, calibrate_camera_imu,
};
use lsfb_rigs::rig::{GRID, Setup, Simulated, noise, simulate};
use lsfb_types::no_progress;
use nalgebra::DVector;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

type Failure = Box<dyn std::error::Error>;

/// Largest errors allowed: degrees, metres, seconds, share of the focal length.
const BOUNDS: Worst = Worst {
    turn_deg: 0.02,
    place_m: 1e-3,
    clock_s: 50e-6,
    focal: 2e-4,
};

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let word = |k: usize, default: &str| arguments.get(k).map_or(default.into(), String::clone);
    match word(0, "20").as_str() {
        "shuffle" => shuffle(word(1, "100").parse()?),
        seeds => {
            let [duration_s, axes_sigma] = [word(1, "60"), word(2, "0")].map(|word| word.parse());
            seeds_against_truth(seeds.parse()?, duration_s?, axes_sigma?)
        }
    }
}

/// Lenses first, from the views alone, then all together.
fn calibrate(
    simulated: &Simulated,
    mut known: Vec<KnownCamera>,
) -> Result<CameraImuCalibration, lsfb_calib::Error> {
    let config = CameraConfig {
        holdout_every: 0,
        ..CameraConfig::default()
    };
    // Their clocks differ: each for itself.
    for camera in &mut known {
        let views = std::slice::from_ref(&camera.views);
        let lens = calibrate_cameras(&GRID, views, &config, &no_progress)?;
        camera.camera = lens.cameras[0].camera;
    }
    let config = CameraImuConfig::default();
    calibrate_camera_imu(
        &GRID,
        &known,
        &simulated.imu,
        &noise(),
        &config,
        &no_progress,
    )
}

/// Largest errors of the cameras of one seed.
#[derive(Clone, Copy, Default)]
struct Worst {
    turn_deg: f64,
    place_m: f64,
    clock_s: f64,
    focal: f64,
}

impl Worst {
    fn of(simulated: &Simulated, found: &CameraImuCalibration) -> Self {
        let mut worst = Self::default();
        for (c, truth) in found.cameras.iter().zip(&simulated.truth) {
            let off = truth.camera_from_rig.inverse() * c.camera_from_rig;
            let place = c.camera_from_rig.inverse().translation
                - truth.camera_from_rig.inverse().translation;
            let focal = c.camera.focal_px()[0] / truth.camera.focal_px()[0] - 1.0;
            worst = worst.max(&Self {
                turn_deg: off.rotation.angle().to_degrees(),
                place_m: place.norm(),
                clock_s: (c.rig_from_camera_s - truth.rig_from_camera_s).abs(),
                focal: focal.abs(),
            });
        }
        worst
    }

    fn max(&self, other: &Self) -> Self {
        Self {
            turn_deg: self.turn_deg.max(other.turn_deg),
            place_m: self.place_m.max(other.place_m),
            clock_s: self.clock_s.max(other.clock_s),
            focal: self.focal.max(other.focal),
        }
    }

    fn plus(&self, other: &Self, share: f64) -> Self {
        Self {
            turn_deg: self.turn_deg + share * other.turn_deg,
            place_m: self.place_m + share * other.place_m,
            clock_s: self.clock_s + share * other.clock_s,
            focal: self.focal + share * other.focal,
        }
    }

    fn words(&self) -> String {
        format!(
            "rotation {:.4}°, translation {:.3} mm, clock {:.1} µs, focal length {:.4} %",
            self.turn_deg,
            self.place_m * 1e3,
            self.clock_s * 1e6,
            self.focal * 100.0
        )
    }
}

/// Errors in the order of the joint covariance.
fn errors(simulated: &Simulated, found: &CameraImuCalibration) -> DVector<f64> {
    let mut by_name = BTreeMap::new();
    let mut put = |name: String, error: f64| {
        by_name.insert(name, error);
    };
    for (c, truth) in found.cameras.iter().zip(&simulated.truth) {
        let off = (truth.camera_from_rig.inverse() * c.camera_from_rig).log();
        for (k, axis) in ["x", "y", "z"].iter().enumerate() {
            put(format!("{} turn {axis}", c.name), off[k]);
            put(format!("{} shift {axis}", c.name), off[3 + k]);
        }
        put(
            format!("{} clock", c.name),
            c.rig_from_camera_s - truth.rig_from_camera_s,
        );
        put(format!("{} drift", c.name), c.clock_drift);
        for (p, truth) in c.lens.iter().zip(truth.camera.lens.parameters().values) {
            put(format!("{} {}", c.name, p.name), p.value - truth);
        }
    }
    for (what, found, truth) in [
        (
            "gyroscope bias",
            found.imu.gyro_bias_rad_s,
            &simulated.gyro_bias,
        ),
        (
            "accelerometer bias",
            found.imu.accel_bias_m_s2,
            &simulated.accel_bias,
        ),
        ("gravity", found.gravity_in_target_m_s2, &simulated.gravity),
    ] {
        for (k, axis) in ["x", "y", "z"].iter().enumerate() {
            put(format!("{what} {axis}"), found[k] - truth[k]);
        }
    }
    put("accelerometer delay".to_owned(), found.imu.accel_delay_s);
    let names = &found.covariance.names;
    DVector::from_iterator(names.len(), names.iter().map(|name| by_name[name]))
}

/// Kind of a parameter by its name.
fn kind(name: &str) -> &'static str {
    let word = name.split(' ').nth(1).unwrap_or_default();
    match (name.split(' ').next().unwrap_or_default(), word) {
        ("gyroscope", _) => "gyroscope bias",
        ("accelerometer", "delay") => "accelerometer's delay",
        ("accelerometer", _) => "accelerometer bias",
        ("gravity", _) => "gravity",
        (_, "turn") => "rotation",
        (_, "shift") => "translation",
        (_, "clock") => "clock",
        (_, "drift") => "drift",
        (_, "fx" | "fy") => "focal length",
        (_, "cx" | "cy") => "principal point",
        _ => "distortion",
    }
}

/// How often errors of one kind lie within their stated spread.
#[derive(Default)]
struct Coverage {
    inside: usize,
    all: usize,
    squares: f64,
}

impl Coverage {
    fn percent(&self) -> f64 {
        100.0 * self.inside as f64 / self.all.max(1) as f64
    }
}

#[derive(Default)]
struct Tally {
    by_kind: BTreeMap<&'static str, Coverage>,
    /// Squared error over its covariance, all parameters together, by seed.
    nees: Vec<f64>,
    dimension: usize,
    worst: Worst,
    mean: Worst,
}

impl Tally {
    fn add(
        &mut self,
        simulated: &Simulated,
        found: &CameraImuCalibration,
        seeds: u64,
    ) -> Result<String, Failure> {
        let (error, covariance) = (errors(simulated, found), &found.covariance);
        for (k, name) in covariance.names.iter().enumerate() {
            let ratio = error[k] / covariance.matrix[(k, k)].sqrt();
            let of_kind = self.by_kind.entry(kind(name)).or_default();
            of_kind.all += 1;
            of_kind.inside += usize::from(ratio.abs() <= 1.96);
            of_kind.squares += ratio * ratio;
        }
        let inverse = covariance.matrix.clone().cholesky();
        let inverse = inverse.ok_or("the joint covariance is not positive")?;
        let nees = error.dot(&inverse.solve(&error));
        self.nees.push(nees);
        self.dimension = error.len();
        let worst = Worst::of(simulated, found);
        self.worst = self.worst.max(&worst);
        self.mean = self.mean.plus(&worst, 1.0 / seeds as f64);
        Ok(format!(
            "{}, NEES {nees:.1} of {}",
            worst.words(),
            error.len()
        ))
    }

    #[allow(clippy::print_stdout, reason = "an example prints its result")]
    fn print(&self) {
        println!("allowed: {}", BOUNDS.words());
        println!("worst:   {}", self.worst.words());
        println!("mean:    {}", self.mean.words());
        let mut all = Coverage::default();
        for (kind, c) in &self.by_kind {
            println!(
                "{kind:18} {:4} of {:4} within 1.96 σ ({:5.1} %), mean square {:.2}",
                c.inside,
                c.all,
                c.percent(),
                c.squares / c.all.max(1) as f64
            );
            all.inside += c.inside;
            all.all += c.all;
        }
        println!(
            "together {} of {} ({:.1} %; 93 to 97 % wanted)",
            all.inside,
            all.all,
            all.percent()
        );
        let n = self.nees.len().max(1) as f64;
        let mean = self.nees.iter().sum::<f64>() / n;
        // Variance of χ² is twice its dimension.
        let spread = 1.96 * (2.0 * self.dimension as f64 / n).sqrt();
        println!(
            "NEES of all parameters together: mean {mean:.1} of {} (95 % of such means lie within ± {spread:.1})",
            self.dimension
        );
    }
}

#[allow(clippy::print_stdout, reason = "an example prints its result")]
fn seeds_against_truth(seeds: u64, duration_s: f64, axes_sigma: f64) -> Result<(), Failure> {
    let mut tally = Tally::default();
    for seed in 1..=seeds {
        let simulated = simulate(&Setup {
            seed,
            duration_s,
            axes_sigma,
            ..Setup::default()
        });
        let start = Instant::now();
        let found = calibrate(&simulated, simulated.known())?;
        let line = tally.add(&simulated, &found, seeds)?;
        println!(
            "seed {seed} ({:.1} s): {line}",
            start.elapsed().as_secs_f64()
        );
    }
    tally.print();
    Ok(())
}

#[allow(clippy::print_stdout, reason = "an example prints its result")]
fn shuffle(runs: u64) -> Result<(), Failure> {
    let simulated = simulate(&Setup {
        duration_s: 5.0,
        view_rate_hz: 10.0,
        ..Setup::default()
    });
    let run = |simulated: &Simulated, reversed: bool| {
        let mut known = simulated.known();
        if reversed {
            known.reverse();
        }
        let mut found = calibrate(simulated, known)?;
        if reversed {
            found.cameras.reverse();
        }
        Ok::<_, lsfb_calib::Error>(found)
    };
    let straight = run(&simulated, false)?;
    let mut largest = 0.0f64;
    for seed in 0..runs {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut other = simulated.clone();
        other.imu.shuffle(&mut rng);
        for corners in other.views.iter_mut().flat_map(|v| v.views.values_mut()) {
            corners.shuffle(&mut rng);
        }
        let found = run(&other, seed % 2 == 1)?;
        for (c, same) in found.cameras.iter().zip(&straight.cameras) {
            let off = (same.camera_from_rig.inverse() * c.camera_from_rig).log();
            let lens = c.lens.iter().zip(&same.lens);
            let lens = lens.map(|(a, b)| (a.value - b.value).abs());
            largest = lens
                .fold(largest, f64::max)
                .max(off.amax())
                .max((same.rig_from_camera_s - c.rig_from_camera_s).abs());
        }
        largest = largest.max((&found.covariance.matrix - &straight.covariance.matrix).amax());
    }
    println!(
        "{runs} runs with samples, corners and cameras in other orders: largest difference {largest:e} (rad, m, s, px)"
    );
    Ok(())
}
