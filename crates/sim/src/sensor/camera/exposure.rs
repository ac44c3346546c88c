//! From brightness to grey levels: exposure, vignetting, noise.

use super::{CameraSim, PoseAt};
use crate::noise::hash;
use crate::world::{LANES, NO_FACET, World};

/// Mean grey level that the automatic aims at.
const TARGET: f32 = 138.0;
/// The same in traced light: a grey card of 18 % at the root of its reflectance, which is what photographers meter for.
const GREY_CARD: f32 = 108.0;
/// Gain of light at least in traced light: a sensor's shortest exposures, for snow in the sun.
const LEAST_GAIN: f32 = 5e-4;
/// Grey level above which a place counts no more than this, when it is metered.
const BRIGHTEST: f32 = 300.0;
/// Amplification of a sensor's signal at most, where there is too little light: ISO 1600 to a nominal 100.
const NIGHT_AMPLIFICATION: f32 = 16.0;
/// Electrons of white at the nominal exposure and a dark pixel's noise: pixels of 3.75 µm with 60 % quantum efficiency behind f/2 have about 8 000 of a
/// white surface at 500 lx in 4 ms (10 000 photons per µm², lux and second), and read noise of five is usual.
const WHITE_E: f32 = 8000.0;
const READ_E: f32 = 5.0;
/// How long ago the light was measured that an exposure follows, seconds: cameras lag.
const LAGS_S: [f64; 3] = [0.08, 0.2, 0.4];
/// Gain of light at most, and at least.
const GAIN: [f32; 2] = [0.04, 24.0];
/// Places measured across and down.
const PROBES: [usize; 2] = [5, 7];

/// How one image is exposed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Exposure {
    pub time_ns: u32,
    /// Factor of the grey levels.
    pub brightness: f32,
    /// Amplification of the sensor's signal, 1 at the nominal exposure.
    pub amplification: f32,
    /// Whether noise is that of electrons in a dark place.
    pub in_the_dark: bool,
}

impl CameraSim {
    /// The exposure of the image at `time_s`.
    pub(super) fn meter(&self, world: &World, world_from_rig: PoseAt, time_s: f64) -> Exposure {
        let nominal = Exposure {
            time_ns: self.config.exposure_ns,
            brightness: 1.0,
            amplification: 1.0,
            in_the_dark: world.is_night(),
        };
        if !self.config.auto_exposure {
            return nominal;
        }
        let longest = self.config.longest_exposure_ns.max(self.config.exposure_ns);
        let most = match world.is_night() {
            true => NIGHT_AMPLIFICATION * longest as f32 / self.config.exposure_ns.max(1) as f32,
            false => GAIN[1],
        };
        let mut gain = 1.0_f32;
        for lag_s in LAGS_S {
            let levels = self.levels(world, world_from_rig, time_s - lag_s);
            let wanted = match world.is_lit() || world.is_night() {
                true => gain_over_the_range(&levels, most),
                false => (TARGET / mean_level(&levels).max(1.0))
                    .powi(2)
                    .clamp(GAIN[0], GAIN[1]),
            };
            gain *= wanted.powf(1.0 / LAGS_S.len() as f32);
        }
        let time_ns = (gain * self.config.exposure_ns as f32).min(longest as f32);
        Exposure {
            time_ns: time_ns as u32,
            brightness: gain.sqrt(),
            amplification: (gain * self.config.exposure_ns as f32 / time_ns).max(1.0),
            ..nominal
        }
    }

    /// Brightness of some places in the image.
    fn levels(&self, world: &World, world_from_rig: PoseAt, time_s: f64) -> Vec<f32> {
        let view = self.view(world, world_from_rig, time_s);
        let groups = self.width / LANES;
        let mut levels = Vec::new();
        for j in 0..PROBES[1] {
            let row = (2 * j + 1) * self.height / (2 * PROBES[1]);
            for i in 0..PROBES[0] {
                let group = (2 * i + 1) * groups / (2 * PROBES[0]);
                let seen = self.look(&view, row, &self.directions[row * groups + group]);
                let met = seen.iter().filter(|s| s.facet != NO_FACET);
                levels.extend(met.map(|s| s.value));
            }
        }
        levels
    }

    /// Vignetting, shot and read noise, quantisation of row `y`.
    pub(super) fn expose(
        &self,
        y: usize,
        values: &[f32],
        exposure: &Exposure,
        seed: u64,
        out: &mut [u8],
    ) {
        let first = y * self.width;
        let vignette = &self.vignette[first..first + self.width];
        let read = self.config.read_noise.powi(2) * exposure.amplification;
        let shot = self.config.shot_noise * exposure.amplification;
        for (pair, out) in out.chunks_exact_mut(2).enumerate() {
            let bits = hash(seed.wrapping_add((first / 2 + pair) as u64)).to_le_bytes();
            for (side, out) in out.iter_mut().enumerate() {
                let x = 2 * pair + side;
                let value = exposure.brightness * values[x] * vignette[x];
                let normal = |sum: u32| (sum as f32 - 510.0) / 147.8;
                // The sum of four bytes is close to normal: mean 510, standard deviation 147.8.
                let sum: u32 = bits[4 * side..4 * side + 4]
                    .iter()
                    .map(|b| u32::from(*b))
                    .sum();
                if exposure.in_the_dark {
                    *out = developed(value, exposure.amplification, normal(sum));
                    continue;
                }
                let level = (value as usize).min(255) as f32;
                let noise = normal(sum) * (read + shot * level).sqrt();
                *out = (value + noise + 0.5).clamp(0.0, 255.0) as u8;
            }
        }
    }
}

/// The grey level that a pixel of a dark place shows: electrons counted with the noise of their number and of reading them, amplified, then the
/// camera's gamma. Near black, noise is as large as what is seen.
fn developed(value: f32, amplification: f32, normal: f32) -> u8 {
    let white_e = WHITE_E / amplification;
    let electrons = (value / 255.0).powi(2) * white_e;
    let counted = electrons + normal * (electrons + READ_E * READ_E).sqrt();
    (255.0 * (counted.max(0.0) / white_e).sqrt() + 0.5).clamp(0.0, 255.0) as u8
}

/// Mean of levels; the aim where there is none.
fn mean_level(levels: &[f32]) -> f32 {
    let (mut sum, mut count) = (0.0, 0.0_f32);
    for level in levels {
        sum += level.min(BRIGHTEST);
        count += 1.0;
    }
    if count > 0.0 { sum / count } else { TARGET }
}

/// The gain under which the mean of levels becomes that of a grey card, what is too bright counting as just too bright: a window
/// does not drown the room.
fn gain_over_the_range(levels: &[f32], most: f32) -> f32 {
    if levels.is_empty() {
        return 1.0;
    }
    let mean = |gain: f32| {
        let shown = levels.iter().map(|l| (gain.sqrt() * l).min(BRIGHTEST));
        shown.sum::<f32>() / levels.len() as f32
    };
    // By halves of what is left, in octaves.
    let (mut low, mut high) = (LEAST_GAIN.log2(), most.log2());
    for _ in 0..24 {
        let middle = 0.5 * (low + high);
        match mean(middle.exp2()) < GREY_CARD {
            true => low = middle,
            false => high = middle,
        }
    }
    (0.5 * (low + high)).exp2()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shot noise of a bright pixel, read noise of a dark one, from the same electrons: 8 000 at white, 500 when they are amplified by 16.
    #[test]
    fn noise_in_the_dark_is_that_of_electrons() {
        // So many deviations up and down that grey levels are fine enough.
        for (value, amplification, many) in [
            (200.0_f32, 1.0_f32, 10.0),
            (200.0, 16.0, 8.0),
            (60.0, 16.0, 3.0),
        ] {
            let linear =
                |normal: f32| (f32::from(developed(value, amplification, normal)) / 255.0).powi(2);
            let apart = 0.5 * (linear(many) - linear(-many)) / many;
            let deviation = apart * 8000.0 / amplification;
            let electrons = (value / 255.0).powi(2) * 8000.0 / amplification;
            let expected = (electrons + 25.0).sqrt();
            assert!(
                (deviation / expected - 1.0).abs() < 0.06,
                "{deviation} {expected}"
            );
        }
        // Of black, half the pixels show the noise of reading it: 5 of 500 electrons are a tenth of white's level.
        assert!((25..=26).contains(&developed(0.0, 16.0, 1.0)));
        assert_eq!(developed(0.0, 16.0, -1.0), 0);
    }

    /// Levels of a room with a window, of a plaza in the sun, of a cellar.
    #[test]
    fn any_light_is_brought_to_a_grey_card() {
        let room = [[40.0; 9], [60.0; 9], [900.0; 9]].concat();
        for levels in [room, vec![2500.0; 30], vec![25.0; 30]] {
            let gain = gain_over_the_range(&levels, GAIN[1]);
            let shown = levels.iter().map(|l| (gain.sqrt() * l).min(BRIGHTEST));
            let mean = shown.sum::<f32>() / levels.len() as f32;
            assert!((mean - GREY_CARD).abs() < 0.5, "{mean} with {gain}");
        }
        assert_eq!(gain_over_the_range(&[], GAIN[1]), 1.0);
        assert!(gain_over_the_range(&[0.01; 4], GAIN[1]) > 0.99 * GAIN[1]);
    }
}
