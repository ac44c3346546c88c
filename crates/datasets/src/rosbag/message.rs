//! Messages as ROS 1 and ROS 2 lay them out.

use lsfb_geometry::{Quaternion, Se3, UnitQuaternion, Vector3};
use lsfb_perception::image::{self, MAX_PIXELS};
use lsfb_recording::message::{CdrError, CdrReader, Layout, StaticTransform};
use lsfb_types::{Image, ImuSample, Timestamp};

/// Stamp and samples of a `sensor_msgs/Imu`.
pub(super) fn imu(layout: Layout, bytes: &[u8]) -> Result<(Timestamp, String, ImuSample), String> {
    let sample = || -> Result<_, CdrError> {
        let mut r = CdrReader::with_layout(layout, bytes)?;
        let header = r.header()?;
        r.f64_array::<4>("orientation")?;
        r.f64_array::<9>("orientation_covariance")?;
        let angular_velocity_rad_s = r.f64_array("angular_velocity")?;
        r.f64_array::<9>("angular_velocity_covariance")?;
        let specific_force_m_s2 = r.f64_array("linear_acceleration")?;
        r.f64_array::<9>("linear_acceleration_covariance")?;
        Ok((header, angular_velocity_rad_s, specific_force_m_s2))
    };
    let (header, angular_velocity_rad_s, specific_force_m_s2) = sample().map_err(said)?;
    let finite = |v: &[f64; 3]| v.iter().all(|x| x.is_finite());
    if !(finite(&angular_velocity_rad_s) && finite(&specific_force_m_s2)) {
        return Err("a sample that is not a number".to_owned());
    }
    let sample = ImuSample {
        angular_velocity_rad_s,
        specific_force_m_s2,
    };
    Ok((header.stamp, header.frame_id.to_owned(), sample))
}

/// The edges of a `tf2_msgs/TFMessage`.
pub(super) fn transforms(layout: Layout, bytes: &[u8]) -> Result<Vec<StaticTransform>, String> {
    let read = || -> Result<Vec<StaticTransform>, CdrError> {
        let mut r = CdrReader::with_layout(layout, bytes)?;
        let mut transforms = Vec::new();
        for _ in 0..r.u32("transforms")? {
            let parent = r.header()?.frame_id.to_owned();
            let child = r.string("child_frame_id")?.to_owned();
            let [x, y, z] = r.f64_array("translation")?;
            let [qx, qy, qz, qw] = r.f64_array("rotation")?;
            let rotation = UnitQuaternion::try_new(Quaternion::new(qw, qx, qy, qz), 1e-6);
            let finite = [x, y, z, qx, qy, qz, qw].iter().all(|v| v.is_finite());
            let rotation = rotation
                .filter(|_| finite)
                .ok_or(CdrError::Value { field: "rotation" })?;
            transforms.push(StaticTransform {
                parent,
                child,
                parent_from_child: Se3::new(rotation, Vector3::new(x, y, z)),
            });
        }
        Ok(transforms)
    };
    read().map_err(said)
}

fn said(error: CdrError) -> String {
    error.to_string()
}

/// Stamp and grey image of a `sensor_msgs/CompressedImage`.
pub(super) fn compressed_image(layout: Layout, bytes: &[u8]) -> Result<(i64, Image), String> {
    let packed = || -> Result<_, CdrError> {
        let mut r = CdrReader::with_layout(layout, bytes)?;
        let stamp = r.header()?.stamp;
        r.string("format")?;
        Ok((stamp, r.byte_sequence("data")?))
    };
    let (stamp, data) = packed().map_err(said)?;
    Ok((stamp.nanos(), image::decode(data)?))
}

/// Stamp and grey image of a `sensor_msgs/Image`.
pub(super) fn image(layout: Layout, bytes: &[u8]) -> Result<(i64, Image), String> {
    let raw = || -> Result<_, CdrError> {
        let mut r = CdrReader::with_layout(layout, bytes)?;
        Ok((
            r.header()?.stamp.nanos(),
            r.u32("height")?,
            r.u32("width")?,
            r.string("encoding")?,
            r.u8("is_bigendian")? != 0,
            r.u32("step")? as usize,
            r.byte_sequence("data")?,
        ))
    };
    let (stamp, height, width, encoding, is_bigendian, step, data) = raw().map_err(said)?;
    let (columns, rows) = (width as usize, height as usize);
    let pixel = Pixel::of(encoding)?;
    let whole = columns
        .checked_mul(pixel.bytes())
        .is_some_and(|row| row <= step && row > 0)
        && step.checked_mul(rows) == Some(data.len())
        && rows > 0
        && u64::from(width) * u64::from(height) <= MAX_PIXELS;
    if !whole {
        return Err(format!(
            "an image of {width} × {height} pixels {encoding} in {} bytes, {step} a row",
            data.len()
        ));
    }
    let lines = data.chunks_exact(step);
    let pixels: Vec<u8> = match pixel {
        Pixel::Gray => lines.flat_map(|l| &l[..columns]).copied().collect(),
        Pixel::Gray16 => {
            let values = lines
                .flat_map(|l| l[..2 * columns].chunks_exact(2))
                .map(|v| {
                    if is_bigendian {
                        u16::from_be_bytes([v[0], v[1]])
                    } else {
                        u16::from_le_bytes([v[0], v[1]])
                    }
                });
            image::grey_from_16_bits(&values.collect::<Vec<_>>())
        }
        Pixel::Colors { bytes, red, blue } => lines
            .flat_map(|l| l[..bytes * columns].chunks_exact(bytes))
            .map(|p| image::luma([p[red], p[1], p[blue]]))
            .collect(),
        Pixel::Luma { first } => lines
            .flat_map(|l| l[first..].iter().step_by(2).take(columns))
            .copied()
            .collect(),
        Pixel::Bayer => {
            let raw: Vec<u8> = lines.flat_map(|l| &l[..columns]).copied().collect();
            gray_of_bayer(&raw, columns)
        }
    };
    let image = Image {
        width,
        height,
        pixels,
        exposure_ns: 0,
        frame_id: 0,
    };
    Ok((stamp, image))
}

/// How a pixel is written.
enum Pixel {
    Gray,
    Gray16,
    /// Bytes of a pixel, and which of them are red and blue; green is the second.
    Colors {
        bytes: usize,
        red: usize,
        blue: usize,
    },
    /// Two bytes, one of them brightness.
    Luma {
        first: usize,
    },
    /// A color each, in a pattern of 2 × 2.
    Bayer,
}

impl Pixel {
    /// By the names of `sensor_msgs/image_encodings.h`.
    fn of(encoding: &str) -> Result<Self, String> {
        let colors = |bytes, red, blue| Self::Colors { bytes, red, blue };
        Ok(match encoding {
            "mono8" | "8UC1" => Self::Gray,
            "mono16" | "16UC1" => Self::Gray16,
            "rgb8" => colors(3, 0, 2),
            "bgr8" | "8UC3" => colors(3, 2, 0),
            "rgba8" => colors(4, 0, 2),
            "bgra8" | "8UC4" => colors(4, 2, 0),
            "yuv422_yuy2" => Self::Luma { first: 0 },
            "yuv422" => Self::Luma { first: 1 },
            "bayer_rggb8" | "bayer_bggr8" | "bayer_gbrg8" | "bayer_grbg8" => Self::Bayer,
            other => {
                return Err(format!(
                    "image encoding {other} is not supported: use mono8, mono16, rgb8, bgr8, rgba8, bgra8, yuv422 or bayer_*8"
                ));
            }
        })
    }

    fn bytes(&self) -> usize {
        match self {
            Self::Gray | Self::Bayer => 1,
            Self::Gray16 | Self::Luma { .. } => 2,
            Self::Colors { bytes, .. } => *bytes,
        }
    }
}

/// Brightness of a mosaic of colors: around each pixel a quarter red, half green and a quarter blue, whichever color it has itself, so
/// that nothing moves.
fn gray_of_bayer(raw: &[u8], columns: usize) -> Vec<u8> {
    let rows = raw.len() / columns.max(1);
    // Beyond the border the pixel two further in has the color of the one that is missing.
    let inside = |k: isize, count: usize| -> usize {
        let last = count as isize - 1;
        let k = if k < 0 {
            -k
        } else if k > last {
            2 * last - k
        } else {
            k
        };
        k.clamp(0, last.max(0)) as usize
    };
    let mut gray = Vec::with_capacity(raw.len());
    for y in 0..rows as isize {
        for x in 0..columns as isize {
            let mut sum = 0;
            for (dy, wy) in [(-1, 1), (0, 2), (1, 1)] {
                for (dx, wx) in [(-1, 1), (0, 2), (1, 1)] {
                    let at = inside(y + dy, rows) * columns + inside(x + dx, columns);
                    sum += wx * wy * u32::from(raw[at]);
                }
            }
            gray.push(((sum + 8) / 16) as u8);
        }
    }
    gray
}
