//! The calibration that a unit carries: files 2 and 4. Integers are big-endian, doubles little-endian.
//!
//! Layout from the vendor's SDK (`device/types` and `data/`); its older fixed layouts (version below 1.2) are refused.

use super::Version;
use crate::WireError;

/// First version with a list of resolutions.
const FIRST_VERSION: Version = Version { major: 1, minor: 2 };
const PINHOLE: u8 = 0;
const KANNALA_BRANDT: u8 = 1;

/// How one camera maps rays to pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Intrinsics {
    /// Pinhole with Brown's distortion.
    Pinhole {
        /// fx, fy, cx, cy, pixels.
        projection_px: [f64; 4],
        /// k1, k2, p1, p2, k3.
        distortion: [f64; 5],
    },
    /// Kannala–Brandt's fisheye.
    KannalaBrandt {
        /// k2, k3, k4, k5.
        coefficients: [f64; 4],
        /// mu, mv, u0, v0, pixels.
        projection_px: [f64; 4],
    },
}

impl Intrinsics {
    fn model(&self) -> u8 {
        match self {
            Self::Pinhole { .. } => PINHOLE,
            Self::KannalaBrandt { .. } => KANNALA_BRANDT,
        }
    }

    fn parse(model: u8, rest: &mut Rest<'_>) -> Result<Self, WireError> {
        match model {
            PINHOLE => Ok(Self::Pinhole {
                projection_px: rest.doubles()?,
                distortion: rest.doubles()?,
            }),
            KANNALA_BRANDT => Ok(Self::KannalaBrandt {
                coefficients: rest.doubles()?,
                projection_px: rest.doubles()?,
            }),
            got => Err(WireError::Value {
                field: "camera model",
                offset: rest.at,
                got: got.into(),
            }),
        }
    }

    fn emit(&self, out: &mut Vec<u8>) {
        match self {
            Self::Pinhole {
                projection_px,
                distortion,
            } => {
                put(projection_px, out);
                put(distortion, out);
            }
            Self::KannalaBrandt {
                coefficients,
                projection_px,
            } => {
                put(coefficients, out);
                put(projection_px, out);
            }
        }
    }
}

/// A rotation, row by row, and a translation as the unit has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitTransform {
    /// Rotation, row by row.
    pub rotation: [f64; 9],
    /// Translation, millimetres.
    pub translation_mm: [f64; 3],
}

impl UnitTransform {
    fn parse(rest: &mut Rest<'_>) -> Result<Self, WireError> {
        Ok(Self {
            rotation: rest.doubles()?,
            translation_mm: rest.doubles()?,
        })
    }

    fn emit(&self, out: &mut Vec<u8>) {
        put(&self.rotation, out);
        put(&self.translation_mm, out);
    }
}

/// Both cameras at one resolution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoCalibration {
    /// Width of one image, pixels.
    pub width: u16,
    /// Height, pixels.
    pub height: u16,
    /// Left camera.
    pub left: Intrinsics,
    /// Right camera; of the same model as the left.
    pub right: Intrinsics,
    /// From the right camera's frame into the left's, as the vendor's SDK applies it.
    pub left_from_right: UnitTransform,
}

/// File 2.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageCalibration {
    /// Version of the layout.
    pub version: Version,
    /// One entry per resolution.
    pub resolutions: Vec<StereoCalibration>,
}

impl ImageCalibration {
    /// Reads the file's content.
    pub fn parse(file: &[u8]) -> Result<Self, WireError> {
        let mut rest = Rest { file, at: 0 };
        let version = rest.version()?;
        let mut resolutions = Vec::new();
        while rest.at < file.len() {
            let [model] = rest.bytes()?;
            let [width, height] = [rest.bytes()?, rest.bytes()?].map(u16::from_be_bytes);
            resolutions.push(StereoCalibration {
                width,
                height,
                left: Intrinsics::parse(model, &mut rest)?,
                right: Intrinsics::parse(model, &mut rest)?,
                left_from_right: UnitTransform::parse(&mut rest)?,
            });
        }
        Ok(Self {
            version,
            resolutions,
        })
    }

    /// The file's content. Two cameras of different models do not fit the layout.
    pub fn emit(&self) -> Result<Vec<u8>, WireError> {
        let mut out = vec![self.version.major, self.version.minor];
        for entry in &self.resolutions {
            if entry.left.model() != entry.right.model() {
                return Err(WireError::Value {
                    field: "camera model of the right camera",
                    offset: out.len(),
                    got: entry.right.model().into(),
                });
            }
            out.push(entry.left.model());
            out.extend(entry.width.to_be_bytes());
            out.extend(entry.height.to_be_bytes());
            entry.left.emit(&mut out);
            entry.right.emit(&mut out);
            entry.left_from_right.emit(&mut out);
        }
        Ok(out)
    }
}

/// Accelerometer or gyroscope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxesCalibration {
    /// Scale and misalignment, row by row.
    pub scale: [f64; 9],
    /// Assembly error, row by row.
    pub assembly: [f64; 9],
    /// Zero drift.
    pub drift: [f64; 3],
    /// Noise density.
    pub noise: [f64; 3],
    /// Random walk of the bias.
    pub bias: [f64; 3],
    /// Drift with temperature: two coefficients for each of x, y, z.
    pub temperature: [f64; 6],
}

impl AxesCalibration {
    fn parse(rest: &mut Rest<'_>) -> Result<Self, WireError> {
        Ok(Self {
            scale: rest.doubles()?,
            assembly: rest.doubles()?,
            drift: rest.doubles()?,
            noise: rest.doubles()?,
            bias: rest.doubles()?,
            temperature: rest.doubles()?,
        })
    }

    fn emit(&self, out: &mut Vec<u8>) {
        put(&self.scale, out);
        put(&self.assembly, out);
        put(&self.drift, out);
        put(&self.noise, out);
        put(&self.bias, out);
        put(&self.temperature, out);
    }
}

/// File 4.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuCalibration {
    /// Version of the layout.
    pub version: Version,
    /// Accelerometer.
    pub accelerometer: AxesCalibration,
    /// Gyroscope.
    pub gyroscope: AxesCalibration,
    /// From the left camera's frame into the IMU's, as the vendor's SDK applies it.
    pub imu_from_left: UnitTransform,
}

impl ImuCalibration {
    /// Reads the file's content.
    pub fn parse(file: &[u8]) -> Result<Self, WireError> {
        let mut rest = Rest { file, at: 0 };
        let calibration = Self {
            version: rest.version()?,
            accelerometer: AxesCalibration::parse(&mut rest)?,
            gyroscope: AxesCalibration::parse(&mut rest)?,
            imu_from_left: UnitTransform::parse(&mut rest)?,
        };
        if rest.at != file.len() {
            return Err(WireError::Length {
                expected: rest.at,
                got: file.len(),
            });
        }
        Ok(calibration)
    }

    /// The file's content.
    pub fn emit(&self) -> Vec<u8> {
        let mut out = vec![self.version.major, self.version.minor];
        self.accelerometer.emit(&mut out);
        self.gyroscope.emit(&mut out);
        self.imu_from_left.emit(&mut out);
        out
    }
}

fn put(values: &[f64], out: &mut Vec<u8>) {
    out.extend(values.iter().flat_map(|value| value.to_le_bytes()));
}

/// What is left of a file.
struct Rest<'a> {
    file: &'a [u8],
    at: usize,
}

impl Rest<'_> {
    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], WireError> {
        let bytes = self.file.get(self.at..).and_then(<[u8]>::first_chunk);
        let bytes = bytes.ok_or(WireError::Length {
            expected: self.at + N,
            got: self.file.len(),
        })?;
        self.at += N;
        Ok(*bytes)
    }

    fn doubles<const N: usize>(&mut self) -> Result<[f64; N], WireError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.bytes()?);
        }
        Ok(values)
    }

    fn version(&mut self) -> Result<Version, WireError> {
        let [major, minor] = self.bytes()?;
        let version = Version { major, minor };
        if version < FIRST_VERSION {
            return Err(WireError::Value {
                field: "layout version",
                offset: 0,
                got: u16::from_be_bytes([major, minor]).into(),
            });
        }
        Ok(version)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mynt_s::wire::UnitFile;
    use crate::test_random::Random;

    /// Doubles of a rotation and a translation.
    const TRANSFORM: usize = 12;

    fn numbers<const N: usize>(first: f64) -> [f64; N] {
        std::array::from_fn(|i| first + i as f64 / 8.0)
    }

    fn transform(first: f64) -> UnitTransform {
        UnitTransform {
            rotation: numbers(first),
            translation_mm: numbers(-first),
        }
    }

    fn images() -> ImageCalibration {
        let pinhole = |first| Intrinsics::Pinhole {
            projection_px: numbers(first),
            distortion: numbers(-first),
        };
        let fisheye = |first| Intrinsics::KannalaBrandt {
            coefficients: numbers(first),
            projection_px: numbers(700.0),
        };
        ImageCalibration {
            version: Version { major: 1, minor: 2 },
            resolutions: vec![
                StereoCalibration {
                    width: 640,
                    height: 400,
                    left: pinhole(350.0),
                    right: pinhole(351.0),
                    left_from_right: transform(1.0),
                },
                StereoCalibration {
                    width: 1280,
                    height: 800,
                    left: fisheye(0.25),
                    right: fisheye(0.5),
                    left_from_right: transform(2.0),
                },
            ],
        }
    }

    fn imu() -> ImuCalibration {
        let axes = |first| AxesCalibration {
            scale: numbers(first),
            assembly: numbers(first + 10.0),
            drift: numbers(first + 20.0),
            noise: numbers(first + 30.0),
            bias: numbers(first + 40.0),
            temperature: numbers(first + 50.0),
        };
        ImuCalibration {
            version: Version { major: 1, minor: 2 },
            accelerometer: axes(1.0),
            gyroscope: axes(2.0),
            imu_from_left: transform(3.0),
        }
    }

    #[test]
    fn calibrations_lie_where_the_layout_says() {
        let file = images().emit().unwrap();
        // Version, then model, width, height, two times nine doubles, and a transform, for each resolution.
        assert_eq!(file[..7], [1, 2, 0, 0x02, 0x80, 0x01, 0x90]);
        assert_eq!(file.len(), 2 + (5 + (18 + 12) * 8) + (5 + (16 + 12) * 8));
        assert_eq!(file[7..15], 350f64.to_le_bytes());
        assert_eq!(ImageCalibration::parse(&file), Ok(images()));
        let file = imu().emit();
        assert_eq!(
            file.len(),
            2 + (2 * (9 + 9 + 3 + 3 + 3 + 6) + TRANSFORM) * 8
        );
        assert_eq!(ImuCalibration::parse(&file), Ok(imu()));
        let answer = UnitFile::Imu.emit(&file).unwrap();
        assert_eq!(UnitFile::Imu.find(&answer), Ok(&file[..]));
        assert!(UnitFile::Images.find(&answer).is_err());
        assert!(UnitFile::Imu.emit(&[0; 1994]).is_err());
    }

    #[test]
    fn other_layouts_are_refused_and_nothing_panics() {
        let mut old = images().emit().unwrap();
        old[1] = 1;
        assert!(ImageCalibration::parse(&old).is_err());
        let mut mixed = images();
        mixed.resolutions[0].right = mixed.resolutions[1].right;
        assert!(mixed.emit().is_err());
        let mut random = Random::new(5);
        let files = [images().emit().unwrap(), imu().emit()];
        for _ in 0..5_000 {
            let mut file = files[random.below(2)].clone();
            random.mutate(&mut file);
            let _ = ImageCalibration::parse(&file);
            let _ = ImuCalibration::parse(&file);
        }
    }
}
