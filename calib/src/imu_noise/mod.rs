//! Noise of an IMU from a recording at rest: Allan variance, and the three noises that explain it.
//!
//! ```
//! use lsfb_calib::imu_noise::{ImuNoiseConfig, imu_noise};
//! use lsfb_types::{ImuSample, Timestamp, no_progress};
//! # use rand::{RngExt, SeedableRng};
//! # let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
//! # let mut noise = |sigma: f64| (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>() * sigma;
//! // Ten minutes at 100 Hz with 0.001 rad/s/√Hz and 0.01 m/s²/√Hz.
//! let samples: Vec<_> = (0..60_000)
//!     .map(|k| {
//!         let sample = ImuSample {
//!             angular_velocity_rad_s: [noise(0.01), noise(0.01), noise(0.01)],
//!             specific_force_m_s2: [noise(0.1), noise(0.1), 9.81 + noise(0.1)],
//!         };
//!         (Timestamp::from_nanos(k * 10_000_000), sample)
//!     })
//!     .collect();
//! let found = imu_noise(&samples, &ImuNoiseConfig::default(), &no_progress)?;
//! assert!((found.rig_imu().gyro_noise_density / 0.001 - 1.0).abs() < 0.02);
//! assert!((found.rig_imu().accel_noise_density / 0.01 - 1.0).abs() < 0.02);
//! # Ok::<(), lsfb_calib::Error>(())
//! ```

mod allan;
mod checks;
mod fit;
mod page;
mod rest;
mod uncertainty;

use lsfb_geometry::ImuNoiseModel;
use lsfb_types::{
    Bounds, Finding, ImuSample, ProgressFn, SharedProgress, Stopped, Timestamp, Verdict,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use allan::Cluster;
pub use fit::Noise;

use crate::Error;
use crate::stamps::{IMU_HZ, expect_nanoseconds};
use uncertainty::Recorded;

/// Settings of [`imu_noise`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImuNoiseConfig {
    /// Shortest recording accepted, seconds.
    pub min_duration_s: f64,
    /// A second whose spread is this many times the typical one is motion, not noise.
    pub motion_ratio: f64,
    /// Bias instability is not looked for below this cluster time, seconds: filters inside the IMU bend the curve there.
    pub min_cluster_s: f64,
}

impl Default for ImuNoiseConfig {
    fn default() -> Self {
        Self {
            min_duration_s: 60.0,
            motion_ratio: 4.0,
            min_cluster_s: 0.0,
        }
    }
}

lsfb_types::bounds! {
    ImuNoiseConfig {
        min_duration_s: number(Bounds::NOT_NEGATIVE),
        motion_ratio: number(Bounds::POSITIVE),
        min_cluster_s: number(Bounds::NOT_NEGATIVE),
    }
}

/// One axis of one triad.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AxisNoise {
    /// `gyro x`, `accel z`.
    pub name: String,
    /// The noises in rad/s or m/s².
    pub noise: Noise,
    /// Their standard deviations; of a noise that is not seen, how large it could be.
    pub sigma: Noise,
    /// The Allan variance by cluster time.
    pub clusters: Vec<Cluster>,
}

/// What [`imu_noise`] found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImuNoise {
    /// Samples used.
    pub samples: usize,
    /// Their length in time, seconds.
    pub duration_s: f64,
    /// Samples per second.
    pub rate_hz: f64,
    /// Gyroscope x y z, accelerometer x y z.
    pub axes: Vec<AxisNoise>,
    /// The noises of the gyroscope's axes together, rad/s.
    pub gyro: Noise,
    /// Their standard deviations.
    pub gyro_sigma: Noise,
    /// The noises of the accelerometer's axes together, m/s².
    pub accel: Noise,
    /// Their standard deviations.
    pub accel_sigma: Noise,
    /// What was looked at, and how it came out.
    #[serde(skip)]
    pub findings: Vec<Finding>,
}

impl ImuNoise {
    /// As the rig has it.
    pub fn rig_imu(&self) -> ImuNoiseModel {
        ImuNoiseModel {
            gyro_noise_density: self.gyro.density,
            accel_noise_density: self.accel.density,
            gyro_bias_walk: self.gyro.walk,
            accel_bias_walk: self.accel.walk,
        }
    }
}

/// Noise of an IMU that rests. The order of samples does not matter.
pub fn imu_noise(
    imu: &[(Timestamp, ImuSample)],
    config: &ImuNoiseConfig,
    progress: ProgressFn<'_>,
) -> Result<ImuNoise, Error> {
    config.check_bounds("imu_noise")?;
    expect_nanoseconds(
        "samples of the IMU",
        imu.iter().map(|s| s.0.nanos()),
        IMU_HZ,
    )?;
    let log = rest::Log::new(imu, config)?;
    let lengths: Vec<usize> = allan::lengths(log.axes[0].len())
        .into_iter()
        .filter(|m| *m as f64 * log.interval_s >= config.min_cluster_s)
        .collect();
    let recorded = |axes: usize| Recorded {
        samples: log.axes[0].len(),
        interval_s: log.interval_s,
        axes,
    };
    let names = [
        "gyro x", "gyro y", "gyro z", "accel x", "accel y", "accel z",
    ];
    let progress = SharedProgress::new("Allan variance", names.len() * lengths.len(), progress);
    let axes = names
        .par_iter()
        .zip(&log.axes)
        .map(|(name, samples)| {
            let clusters = allan::allan(samples, log.interval_s, &lengths, &progress)?;
            let noise = fit::fit(&clusters);
            Ok(AxisNoise {
                name: (*name).to_owned(),
                sigma: uncertainty::sigma(&noise, &clusters, &recorded(1)),
                noise,
                clusters,
            })
        })
        .collect::<Result<Vec<AxisNoise>, Stopped>>()?;
    let [(gyro, gyro_sigma), (accel, accel_sigma)] = [&axes[..3], &axes[3..]].map(|triad| {
        let clusters = together(triad);
        let noise = fit::fit(&clusters);
        (
            noise,
            uncertainty::sigma(&noise, &clusters, &recorded(triad.len())),
        )
    });
    let mut findings = checks::findings(&log, gyro.density);
    findings.splice(0..0, log.findings);
    for (name, noise) in [("gyroscope", &gyro), ("accelerometer", &accel)] {
        findings.push(random_walk(name, noise, log.duration_s));
    }
    Ok(ImuNoise {
        samples: log.axes[0].len(),
        duration_s: log.duration_s,
        rate_hz: 1.0 / log.interval_s,
        axes,
        gyro,
        gyro_sigma,
        accel,
        accel_sigma,
        findings,
    })
}

/// The Allan variance of three axes as one: their mean, with all their freedom.
fn together(axes: &[AxisNoise]) -> Vec<Cluster> {
    let count = axes.iter().map(|a| a.clusters.len()).min().unwrap_or(0);
    (0..count)
        .map(|k| {
            let of_axes = || axes.iter().map(move |a| &a.clusters[k]);
            Cluster {
                time_s: axes[0].clusters[k].time_s,
                variance: of_axes().map(|c| c.variance).sum::<f64>() / axes.len() as f64,
                freedom: of_axes().map(|c| c.freedom).sum(),
            }
        })
        .collect()
}

/// A random walk is seen where it outweighs the other noises: well within the recording.
fn random_walk(name: &str, noise: &Noise, duration_s: f64) -> Finding {
    let longest_s = duration_s / 9.0;
    let of_walk = noise.walk * (longest_s / 3.0).sqrt();
    let is_seen = of_walk >= 0.5 * noise.deviation(longest_s);
    let minutes = duration_s / 60.0;
    let what = if is_seen {
        format!("its random walk is visible within the {minutes:.0} min")
    } else {
        format!(
            "its random walk stays below its other noise for all of the {minutes:.0} min: the value is an upper bound"
        )
    };
    Finding::new("random-walk", Verdict::Warn.unless(is_seen), name, what)
        .value(minutes, "min")
        .remedy("record for several hours to measure it")
}

#[cfg(test)]
mod tests;
