//! How one keeps one's balance: nobody stands like a tripod.

use std::f32::consts::TAU;

use super::{smooth_step, wave};
use crate::config::WalkConfig;
use crate::noise::{stream, uniform};

/// Who stands sways about the ankles like an inverted pendulum, forwards more than sideways and mostly below half a hertz: the centre of mass
/// moves by 3 to 5 mm rms (Winter, "Human balance and posture control during standing and walking", 1995), the trunk turns at 0.2 to 0.4 °/s.
#[derive(Clone, Debug)]
pub(super) struct Balance {
    /// Pitch, roll and yaw: two waves each.
    waves: [[Lean; 2]; 3],
}

/// One wave of it.
#[derive(Clone, Copy, Debug)]
struct Lean {
    amplitude_rad: f64,
    hz: f64,
    phase: f64,
}

/// Slow and quick part of each axis' sway, radians at the crest; how much it is differs by a third from one to another.
const SWAY_RAD: [[f64; 2]; 3] = [[5.0e-3, 1.7e-3], [3.3e-3, 1.2e-3], [2.0e-3, 0.8e-3]];
/// Frequencies of the two, hertz, from and to.
const SWAY_HZ: [[f32; 2]; 2] = [[0.15, 0.3], [0.4, 0.6]];
/// A walk is at rest before and after it: sway grows in and dies away within this time, seconds.
const SWAY_BEGINS_S: f64 = 1.0;

impl Balance {
    /// Of one walk: `walk` tells those of one seed apart that have another gait.
    pub fn of(seed: u64, walk: u64) -> Self {
        let rng = stream(seed, "balance", walk);
        let waves = SWAY_RAD.map(|axis| {
            std::array::from_fn(|k| Lean {
                amplitude_rad: axis[k] * f64::from(uniform(&rng, 0.67, 1.33)),
                hz: f64::from(uniform(&rng, SWAY_HZ[k][0], SWAY_HZ[k][1])),
                phase: f64::from(uniform(&rng, 0.0, TAU)),
            })
        });
        Self { waves }
    }

    /// What it adds to x, y, z, yaw, pitch and roll.
    pub fn at(&self, t: f64, heading: f64, config: &WalkConfig) -> [f64; 6] {
        let begun = smooth_step(t / SWAY_BEGINS_S);
        let begun = begun * smooth_step((config.duration_s - t) / SWAY_BEGINS_S);
        let [pitch, roll, yaw] = self.waves.map(|axis| {
            let waves = axis.map(|w| w.amplitude_rad * wave(t, w.hz, w.phase));
            begun * waves.iter().sum::<f64>()
        });
        // Pitch is forwards and down; what is higher above the ankles moves farther.
        let (forwards, left) = (config.height_m * pitch, -config.height_m * roll);
        let (sin, cos) = heading.sin_cos();
        [
            forwards * cos - left * sin,
            forwards * sin + left * cos,
            0.0,
            yaw,
            pitch,
            roll,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn people_sway_as_people_do() {
        let config = WalkConfig {
            duration_s: 120.0,
            height_m: 1.0,
            ..WalkConfig::default()
        };
        let rms = |values: &[f64]| {
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
            (squares / values.len() as f64).sqrt()
        };
        for seed in 1..=12 {
            let balance = Balance::of(seed, 0);
            let times: Vec<f64> = (100..11_900).map(|k| 0.01 * f64::from(k)).collect();
            let at = |k: usize| -> Vec<f64> {
                let all = times.iter().map(|t| balance.at(*t, 0.0, &config)[k]);
                all.collect()
            };
            let (forwards_m, sideways_m, pitch) = (rms(&at(0)), rms(&at(1)), at(4));
            let rates: Vec<f64> = pitch.windows(2).map(|p| (p[1] - p[0]) / 0.01).collect();
            let rate_deg_s = rms(&rates).to_degrees();
            assert!(
                (0.0025..0.005).contains(&forwards_m),
                "{seed}: {forwards_m} m"
            );
            assert!(
                (0.0015..0.0035).contains(&sideways_m),
                "{seed}: {sideways_m} m"
            );
            assert!((0.2..0.6).contains(&rate_deg_s), "{seed}: {rate_deg_s}°/s");
            assert_eq!(balance.at(0.0, 0.3, &config), [0.0; 6]);
        }
    }
}
