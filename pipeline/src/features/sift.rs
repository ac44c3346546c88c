use lsfb_types::{Bounds, Image};
use serde::{Deserialize, Serialize};

use super::descriptor::Lattice;
use super::extrema::{Extremum, Limits, find_extrema};
use super::orientation::orientations;
use super::scale_space::Octave;
use super::selection::{Candidate, select};
use super::{Features, Keypoint};
use crate::Error;

/// Where the scale space begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FirstOctave {
    /// With the image enlarged twice: finds the finest features, at four times the work.
    Doubled,
    /// With the image as it is.
    Full,
}

/// Configuration of [`SiftDetector`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SiftConfig {
    /// Most features per image.
    pub max_features: usize,
    /// Where the scale space begins.
    pub first_octave: FirstOctave,
    /// Detection levels per octave.
    pub scales_per_octave: usize,
    /// Blur of the first level of each octave, pixels of the octave.
    pub base_blur_px: f32,
    /// Least contrast of an extremum, 0–1.
    pub min_contrast: f32,
    /// Largest ratio of principal curvatures; beyond it lies on an edge.
    pub max_edge_ratio: f32,
    /// Further directions of a keypoint reach this share of the strongest.
    pub orientation_peak_ratio: f32,
    /// Most directions per keypoint.
    pub max_orientations: usize,
}

impl Default for SiftConfig {
    fn default() -> Self {
        Self {
            max_features: 900,
            first_octave: FirstOctave::Doubled,
            scales_per_octave: 3,
            base_blur_px: 1.6,
            min_contrast: 0.007,
            max_edge_ratio: 10.0,
            orientation_peak_ratio: 0.8,
            max_orientations: 2,
        }
    }
}

lsfb_types::bounds! {
    SiftConfig {
        max_features: any,
        first_octave: any,
        scales_per_octave: number(Bounds::Within(1.0, 8.0)),
        base_blur_px: number(Bounds::Between(1.0, 10.0)),
        min_contrast: number(Bounds::POSITIVE),
        max_edge_ratio: number(Bounds::AT_LEAST_ONE),
        orientation_peak_ratio: number(Bounds::NOT_NEGATIVE),
        max_orientations: any,
    }
}

/// Finds and describes features. Keeps its scale space between images: use one per thread.
#[derive(Clone, Debug)]
pub struct SiftDetector {
    config: SiftConfig,
    lattice: Lattice,
    octaves: Vec<Octave>,
}

/// Smallest side of an octave that is still searched, pixels.
const MIN_SIDE_PX: usize = 24;
/// Rim of an octave that is not searched, pixels.
const BORDER_PX: usize = 5;

impl SiftDetector {
    /// A detector; refuses a configuration without meaning.
    pub fn new(config: &SiftConfig) -> Result<Self, Error> {
        config.check_bounds("sift")?;
        Ok(Self {
            config: config.clone(),
            lattice: Lattice::new(),
            octaves: Vec::new(),
        })
    }

    /// The features of `image`, by octave, level, row and column. An image whose pixels do not fill its size, or too
    /// small for one octave, has none.
    pub fn detect(&mut self, image: &Image) -> Features {
        let (width, height) = (image.width as usize, image.height as usize);
        if width.min(height) < MIN_SIDE_PX || image.pixels.len() != width * height {
            return Features::default();
        }
        let doubled = self.config.first_octave == FirstOctave::Doubled;
        self.build_octaves(image, doubled);
        let mut found: Vec<(usize, Extremum)> = Vec::new();
        let limits = Limits {
            contrast: self.config.min_contrast,
            edge_ratio: self.config.max_edge_ratio,
            border: BORDER_PX,
        };
        for (index, octave) in self.octaves.iter().enumerate() {
            found.extend(
                find_extrema(octave, &limits)
                    .into_iter()
                    .map(|e| (index, e)),
            );
        }
        let pixel_size = |octave: usize| {
            let exponent = octave as i32 - i32::from(doubled);
            2.0f32.powi(exponent)
        };
        let candidates: Vec<Candidate> = found
            .iter()
            .map(|(octave, e)| Candidate {
                x: e.x * pixel_size(*octave),
                y: e.y * pixel_size(*octave),
                response: e.response,
            })
            .collect();
        let mut chosen = Vec::new();
        for index in select(
            &candidates,
            image.width,
            image.height,
            self.config.max_features,
        ) {
            let (octave, extremum) = &found[index];
            let angles = self.directions(*octave, extremum);
            chosen.extend(angles.into_iter().map(|angle| (index, angle)));
        }
        chosen.truncate(self.config.max_features);
        chosen.sort_by_key(|(index, _)| *index);
        let mut features = Features::default();
        for (index, angle) in chosen {
            let (octave, extremum) = &found[index];
            let plane = &self.octaves[*octave].gaussians[self.level(extremum)];
            let (sigma, pixel_size) = (self.sigma(extremum), pixel_size(*octave));
            features.keypoints.push(Keypoint {
                pixel: [extremum.x * pixel_size, extremum.y * pixel_size],
                scale_px: sigma * pixel_size,
                angle_rad: angle,
                response: extremum.response,
            });
            let (x, y) = (extremum.x, extremum.y);
            features
                .descriptors
                .push(self.lattice.describe(plane, x, y, sigma, angle));
        }
        features
    }

    /// Memory of the scale space of an image, bytes.
    pub(super) fn scale_space_bytes(&self, image: &Image) -> usize {
        let doubled = self.config.first_octave == FirstOctave::Doubled;
        let pixels = image.pixels.len() * if doubled { 4 } else { 1 };
        // Octaves shrink to a quarter each: a third more than the first.
        pixels * (self.config.scales_per_octave + 3) * size_of::<f32>() * 4 / 3
    }

    /// The level of the octave nearest to an extremum.
    fn level(&self, extremum: &Extremum) -> usize {
        (extremum.level.round() as usize).clamp(1, self.config.scales_per_octave)
    }

    /// Blur of an extremum, pixels of its octave.
    fn sigma(&self, extremum: &Extremum) -> f32 {
        let octaves = extremum.level / self.config.scales_per_octave as f32;
        self.config.base_blur_px * 2.0f32.powf(octaves)
    }

    fn directions(&self, octave: usize, extremum: &Extremum) -> Vec<f32> {
        let plane = &self.octaves[octave].gaussians[self.level(extremum)];
        let (x, y, sigma) = (extremum.x, extremum.y, self.sigma(extremum));
        let config = &self.config;
        orientations(
            plane,
            x,
            y,
            sigma,
            config.orientation_peak_ratio,
            config.max_orientations,
        )
    }

    fn build_octaves(&mut self, image: &Image, doubled: bool) {
        let (scales, sigma) = (self.config.scales_per_octave, self.config.base_blur_px);
        let mut side = image.width.min(image.height) as usize * if doubled { 2 } else { 1 };
        let mut count = 0;
        while side >= MIN_SIDE_PX {
            count += 1;
            side /= 2;
        }
        self.octaves.resize_with(count, Octave::default);
        for index in 0..count {
            let (done, rest) = self.octaves.split_at_mut(index);
            match done.last() {
                None => rest[0].start(image, doubled, sigma),
                Some(previous) => rest[0].halve(previous, scales),
            }
            rest[0].fill(scales, sigma);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bright round blobs on grey.
    fn blobs(places: &[[f32; 3]], width: u32, height: u32) -> Image {
        let value = |x: u32, y: u32| {
            let sum: f32 = places
                .iter()
                .map(|[bx, by, sigma]| {
                    let squared = (x as f32 - bx).powi(2) + (y as f32 - by).powi(2);
                    (-squared / (2.0 * sigma * sigma)).exp()
                })
                .sum();
            (60.0 + 150.0 * sum).round() as u8
        };
        Image {
            width,
            height,
            pixels: (0..height)
                .flat_map(|y| (0..width).map(move |x| value(x, y)))
                .collect(),
            ..Image::default()
        }
    }

    #[test]
    fn blobs_are_found_where_and_as_large_as_they_are() {
        let places = [[40.3, 50.0, 2.5], [110.0, 61.7, 4.0], [200.6, 70.25, 8.0]];
        let image = blobs(&places, 260, 140);
        for first_octave in [FirstOctave::Doubled, FirstOctave::Full] {
            let config = SiftConfig {
                first_octave,
                ..SiftConfig::default()
            };
            let found = SiftDetector::new(&config).expect("valid").detect(&image);
            for [x, y, sigma] in places {
                // A blob of standard deviation s answers strongest at blur s / 2^(1/2k), k levels per octave.
                let expected = sigma / 2.0f32.powf(1.0 / 6.0);
                let hit = found.keypoints.iter().any(|k| {
                    (k.pixel[0] - x).hypot(k.pixel[1] - y) < 0.1
                        && (k.scale_px / expected - 1.0).abs() < 0.12
                });
                assert!(hit, "{first_octave:?} {x} {y}: {:?}", found.keypoints);
            }
        }
    }

    #[test]
    fn limits_are_kept_and_nonsense_gives_nothing() {
        let places: Vec<[f32; 3]> = (0..60)
            .map(|i| {
                [
                    15.0 + 25.0 * (i % 10) as f32,
                    15.0 + 25.0 * (i / 10) as f32,
                    3.0,
                ]
            })
            .collect();
        let image = blobs(&places, 270, 160);
        let mut config = SiftConfig {
            max_features: 37,
            ..SiftConfig::default()
        };
        let mut detector = SiftDetector::new(&config).expect("valid");
        let found = detector.detect(&image);
        assert_eq!((found.keypoints.len(), found.descriptors.len()), (37, 37));
        // Scale space kept from another image must not show.
        detector.detect(&blobs(&[], 100, 333));
        assert_eq!(detector.detect(&image), found);

        let torn = Image {
            pixels: vec![0; 10],
            ..image
        };
        assert!(detector.detect(&torn).is_empty());
        assert!(detector.detect(&Image::default()).is_empty());
        config.min_contrast = 0.0;
        let error = SiftDetector::new(&config)
            .expect_err("no contrast")
            .to_string();
        assert!(error.contains("sift.min_contrast"), "{error}");
    }
}
