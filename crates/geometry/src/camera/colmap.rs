//! Cameras in COLMAP's words (COLMAP's `sensor/models.h`), which kapture and nerfstudio use as well.
//!
//! COLMAP's pixel (0, 0) is the corner of the first pixel, ours its centre: half a pixel lies between them.

use super::{Camera, Lens};

/// From our pixels to COLMAP's.
const HALF_PIXEL: f64 = 0.5;

/// A camera model of COLMAP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColmapModel {
    /// `f, cx, cy`.
    SimplePinhole,
    /// `fx, fy, cx, cy`, as the models that follow where nothing else is said.
    Pinhole,
    /// `f, cx, cy, k`.
    SimpleRadial,
    /// `f, cx, cy, k1, k2`.
    Radial,
    /// `… k1, k2, p1, p2`.
    Opencv,
    /// `… k1, k2, k3, k4`.
    OpencvFisheye,
    /// `… k1, k2, p1, p2, k3, k4, k5, k6`.
    FullOpencv,
    /// `… omega`.
    Fov,
    /// `f, cx, cy, k`.
    SimpleRadialFisheye,
    /// `f, cx, cy, k1, k2`.
    RadialFisheye,
    /// `… k1, k2, p1, p2, k3, k4, sx1, sy1`: none of our lenses.
    ThinPrismFisheye,
}

/// Why a line of COLMAP's is no camera of ours.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ColmapError {
    /// A model of which no lens here is.
    #[error("model {model} is not supported")]
    Model {
        /// Its name.
        model: String,
    },
    /// Too few or too many parameters.
    #[error("{got} parameters for {model}, expected {expected}")]
    Parameters {
        /// The model's name.
        model: &'static str,
        /// How many there are.
        got: usize,
        /// How many the model has.
        expected: usize,
    },
    /// `FULL_OPENCV` with a denominator.
    #[error("rational distortion with k4 to k6 is not supported")]
    Rational,
    /// An image without pixels.
    #[error("an image of {0} × {1} pixels")]
    Size(u32, u32),
    /// Parameters that no lens has.
    #[error("{0}")]
    Lens(String),
}

impl ColmapModel {
    /// Every model, by its number in binary files.
    const BY_NUMBER: [Self; 11] = [
        Self::SimplePinhole,
        Self::Pinhole,
        Self::SimpleRadial,
        Self::Radial,
        Self::Opencv,
        Self::OpencvFisheye,
        Self::FullOpencv,
        Self::Fov,
        Self::SimpleRadialFisheye,
        Self::RadialFisheye,
        Self::ThinPrismFisheye,
    ];

    /// The name in text files.
    pub fn name(self) -> &'static str {
        match self {
            Self::SimplePinhole => "SIMPLE_PINHOLE",
            Self::Pinhole => "PINHOLE",
            Self::SimpleRadial => "SIMPLE_RADIAL",
            Self::Radial => "RADIAL",
            Self::Opencv => "OPENCV",
            Self::OpencvFisheye => "OPENCV_FISHEYE",
            Self::FullOpencv => "FULL_OPENCV",
            Self::Fov => "FOV",
            Self::SimpleRadialFisheye => "SIMPLE_RADIAL_FISHEYE",
            Self::RadialFisheye => "RADIAL_FISHEYE",
            Self::ThinPrismFisheye => "THIN_PRISM_FISHEYE",
        }
    }

    /// The model of a name in a text file.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::BY_NUMBER.into_iter().find(|m| m.name() == name)
    }

    /// The number in binary files.
    pub fn number(self) -> u32 {
        // In the order of the numbers.
        self as u32
    }

    /// The model of a number in a binary file.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::BY_NUMBER.get(usize::try_from(number).ok()?).copied()
    }

    /// Focal lengths and distortion parameters; beside them is the principal point.
    fn counts(self) -> (usize, usize) {
        match self {
            Self::SimplePinhole => (1, 0),
            Self::Pinhole => (2, 0),
            Self::SimpleRadial | Self::SimpleRadialFisheye => (1, 1),
            Self::Radial | Self::RadialFisheye => (1, 2),
            Self::Opencv | Self::OpencvFisheye => (2, 4),
            Self::FullOpencv | Self::ThinPrismFisheye => (2, 8),
            Self::Fov => (2, 1),
        }
    }

    /// Number of parameters.
    pub fn parameter_count(self) -> usize {
        let (focals, distortion) = self.counts();
        focals + 2 + distortion
    }

    fn lens(self, parameters: &[f64]) -> Result<Lens, ColmapError> {
        let expected = self.parameter_count();
        if parameters.len() != expected {
            return Err(ColmapError::Parameters {
                model: self.name(),
                got: parameters.len(),
                expected,
            });
        }
        let (focal, rest) = parameters.split_at(self.counts().0);
        let (principal, d) = rest.split_at(2);
        let focal_px = [focal[0], focal[focal.len() - 1]];
        let principal_px = [principal[0] - HALF_PIXEL, principal[1] - HALF_PIXEL];
        let at = |k: usize| d.get(k).copied().unwrap_or(0.0);
        Ok(match self {
            Self::ThinPrismFisheye => {
                return Err(ColmapError::Model {
                    model: self.name().to_owned(),
                });
            }
            Self::OpencvFisheye | Self::SimpleRadialFisheye | Self::RadialFisheye => {
                Lens::KannalaBrandt {
                    focal_px,
                    principal_px,
                    distortion: [at(0), at(1), at(2), at(3)],
                }
            }
            Self::Fov => Lens::FieldOfView {
                focal_px,
                principal_px,
                distortion: [at(0)],
            },
            // A denominator of one leaves the polynomial.
            Self::FullOpencv if d[5..].iter().any(|k| *k != 0.0) => {
                return Err(ColmapError::Rational);
            }
            // k1 k2 p1 p2 k3, the latter three only of OpenCV's models.
            Self::SimplePinhole
            | Self::Pinhole
            | Self::SimpleRadial
            | Self::Radial
            | Self::Opencv
            | Self::FullOpencv => Lens::PinholeRadtan {
                focal_px,
                principal_px,
                distortion: [at(0), at(1), at(2), at(3), at(4)],
            },
        })
    }
}

impl Camera {
    /// A camera by COLMAP's name of its model and its parameters.
    pub fn from_colmap(
        model: &str,
        [width, height]: [u32; 2],
        parameters: &[f64],
    ) -> Result<Self, ColmapError> {
        let known = ColmapModel::from_name(model).ok_or_else(|| ColmapError::Model {
            model: model.to_owned(),
        })?;
        let lens = known.lens(parameters)?;
        if width == 0 || height == 0 {
            return Err(ColmapError::Size(width, height));
        }
        match lens.problem() {
            Some(problem) => Err(ColmapError::Lens(problem)),
            None => Ok(Self {
                width,
                height,
                lens,
            }),
        }
    }

    /// COLMAP's model that says the same with the fewest parameters, and these; `None` for lenses that COLMAP does not know.
    pub fn to_colmap(&self) -> Option<(ColmapModel, Vec<f64>)> {
        let (model, distortion) = match self.lens {
            Lens::PinholeRadtan { distortion, .. } => match distortion {
                [0.0, 0.0, 0.0, 0.0, 0.0] => (ColmapModel::Pinhole, vec![]),
                [k1, k2, p1, p2, 0.0] => (ColmapModel::Opencv, vec![k1, k2, p1, p2]),
                [k1, k2, p1, p2, k3] => (
                    ColmapModel::FullOpencv,
                    vec![k1, k2, p1, p2, k3, 0.0, 0.0, 0.0],
                ),
            },
            Lens::KannalaBrandt { distortion, .. } => {
                (ColmapModel::OpencvFisheye, distortion.to_vec())
            }
            Lens::FieldOfView { distortion, .. } => (ColmapModel::Fov, distortion.to_vec()),
            Lens::DoubleSphere { .. } | Lens::ExtendedUnified { .. } => return None,
        };
        let ([fx, fy], [cx, cy]) = (self.focal_px(), self.principal_px());
        let pinhole = [fx, fy, cx + HALF_PIXEL, cy + HALF_PIXEL];
        Some((model, [&pinhole[..], &distortion].concat()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_places_and_names_are_found_again() {
        for (number, model) in (0..).zip(ColmapModel::BY_NUMBER) {
            assert_eq!(model.number(), number);
            assert_eq!(ColmapModel::from_number(number), Some(model));
            assert_eq!(ColmapModel::from_name(model.name()), Some(model));
        }
        assert_eq!(ColmapModel::from_number(11), None);
        // Of COLMAP's documentation.
        assert_eq!(ColmapModel::OpencvFisheye.number(), 5);
        assert_eq!(ColmapModel::FullOpencv.parameter_count(), 12);
    }

    #[test]
    fn cameras_are_found_again() {
        let (focal_px, principal_px) = ([310.0, 311.5], [321.25, 238.75]);
        let radtan = |distortion| Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion,
        };
        for (lens, name) in [
            (radtan([0.0; 5]), "PINHOLE"),
            (radtan([-0.2, 0.05, 1e-3, 2e-3, 0.0]), "OPENCV"),
            (radtan([-0.2, 0.05, 1e-3, 2e-3, 0.01]), "FULL_OPENCV"),
            (
                Lens::KannalaBrandt {
                    focal_px,
                    principal_px,
                    distortion: [0.01, -0.01, 0.004, -0.001],
                },
                "OPENCV_FISHEYE",
            ),
            (
                Lens::FieldOfView {
                    focal_px,
                    principal_px,
                    distortion: [0.9],
                },
                "FOV",
            ),
        ] {
            let camera = Camera {
                width: 640,
                height: 480,
                lens,
            };
            let (model, parameters) = camera.to_colmap().expect("of COLMAP's");
            assert_eq!(model.name(), name);
            assert_eq!(parameters[..4], [310.0, 311.5, 321.75, 239.25]);
            assert_eq!(
                Camera::from_colmap(name, [640, 480], &parameters),
                Ok(camera)
            );
        }
        // One focal length, and fewer terms.
        for (name, parameters, distortion) in [
            ("SIMPLE_PINHOLE", vec![], vec![0.0; 5]),
            ("SIMPLE_RADIAL", vec![0.1], vec![0.1, 0.0, 0.0, 0.0, 0.0]),
            ("RADIAL", vec![0.1, 0.2], vec![0.1, 0.2, 0.0, 0.0, 0.0]),
            ("SIMPLE_RADIAL_FISHEYE", vec![0.1], vec![0.1, 0.0, 0.0, 0.0]),
            ("RADIAL_FISHEYE", vec![0.1, 0.2], vec![0.1, 0.2, 0.0, 0.0]),
        ] {
            let all = [vec![500.0, 320.0, 240.0], parameters].concat();
            let camera = Camera::from_colmap(name, [640, 480], &all).expect("a camera");
            assert_eq!(camera.focal_px(), [500.0, 500.0]);
            assert_eq!(camera.principal_px(), [319.5, 239.5]);
            assert_eq!(camera.lens.distortion(), distortion);
        }
    }

    #[test]
    fn what_is_no_camera_is_said() {
        let problem = |model: &str, size, parameters: &[f64]| {
            let error = Camera::from_colmap(model, size, parameters);
            error.expect_err("no camera").to_string()
        };
        let prism = problem("THIN_PRISM_FISHEYE", [6, 4], &[1.0; 12]);
        assert_eq!(prism, "model THIN_PRISM_FISHEYE is not supported");
        let rational = [
            500.0, 500.0, 3.0, 2.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0,
        ];
        assert!(problem("FULL_OPENCV", [6, 4], &rational).contains("k4 to k6"));
        assert_eq!(
            problem("PINHOLE", [6, 4], &[1.0; 3]),
            "3 parameters for PINHOLE, expected 4"
        );
        assert!(problem("PINHOLE", [6, 4], &[f64::NAN, 1.0, 1.0, 1.0]).contains("fx is NaN"));
        assert!(problem("PINHOLE", [0, 4], &[1.0; 4]).contains("0 × 4"));
    }
}
