//! Messages as ROS 1 and ROS 2 lay them out: the same fields, packed in the one, aligned (CDR) in the other.

use lsfb_perception::image::{self, MAX_PIXELS};
use lsfb_types::{Image, ImuSample};

/// How fields lie in a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Layout {
    /// Without gaps; headers begin with a counter.
    Ros1,
    /// Each number at a multiple of its size behind an encapsulation of four bytes.
    Cdr,
}

/// Takes fields off a message; every length is checked against what is there.
struct Fields<'a> {
    layout: Layout,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Fields<'a> {
    fn new(layout: Layout, bytes: &'a [u8]) -> Result<Self, String> {
        let bytes = match layout {
            Layout::Ros1 => bytes,
            Layout::Cdr => match bytes {
                [0, 1, _, _, body @ ..] => body,
                _ => return Err("no CDR with little-endian numbers".to_owned()),
            },
        };
        Ok(Self {
            layout,
            bytes,
            at: 0,
        })
    }

    fn raw(&mut self, length: usize) -> Result<&'a [u8], String> {
        let end = self.at.checked_add(length);
        let bytes = end.and_then(|end| self.bytes.get(self.at..end));
        let bytes = bytes.ok_or_else(|| {
            format!(
                "{length} bytes at {} of {}: the message is cut short",
                self.at,
                self.bytes.len()
            )
        })?;
        self.at += length;
        Ok(bytes)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N], String> {
        if self.layout == Layout::Cdr {
            self.at = self.at.next_multiple_of(N);
        }
        let mut value = [0; N];
        value.copy_from_slice(self.raw(N)?);
        Ok(value)
    }

    fn u8(&mut self) -> Result<u8, String> {
        Ok(self.number::<1>()?[0])
    }

    fn u32(&mut self) -> Result<u32, String> {
        Ok(u32::from_le_bytes(self.number()?))
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.number()?);
        }
        Ok(values)
    }

    fn sequence(&mut self) -> Result<&'a [u8], String> {
        let length = self.u32()? as usize;
        self.raw(length)
    }

    fn text(&mut self) -> Result<&'a str, String> {
        let bytes = self.sequence()?;
        // CDR counts the zero at the end.
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        std::str::from_utf8(bytes).map_err(|_| "text that is no UTF-8".to_owned())
    }

    /// The stamp of a `std_msgs/Header`, nanoseconds.
    fn header(&mut self) -> Result<i64, String> {
        if self.layout == Layout::Ros1 {
            self.u32()?;
        }
        let (seconds, nanoseconds) = (self.u32()?, self.u32()?);
        self.text()?;
        if nanoseconds >= 1_000_000_000 {
            return Err(format!("a stamp with {nanoseconds} ns"));
        }
        Ok(i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds))
    }
}

/// Stamp and samples of a `sensor_msgs/Imu`.
pub(super) fn imu(layout: Layout, bytes: &[u8]) -> Result<(i64, ImuSample), String> {
    let mut fields = Fields::new(layout, bytes)?;
    let stamp = fields.header()?;
    // Orientation and its covariance.
    fields.f64s::<13>()?;
    let angular_velocity_rad_s = fields.f64s()?;
    fields.f64s::<9>()?;
    let specific_force_m_s2 = fields.f64s()?;
    fields.f64s::<9>()?;
    let finite = |v: &[f64; 3]| v.iter().all(|x| x.is_finite());
    if !(finite(&angular_velocity_rad_s) && finite(&specific_force_m_s2)) {
        return Err("a sample that is no number".to_owned());
    }
    let sample = ImuSample {
        angular_velocity_rad_s,
        specific_force_m_s2,
    };
    Ok((stamp, sample))
}

/// Stamp and grey image of a `sensor_msgs/CompressedImage`.
pub(super) fn compressed_image(layout: Layout, bytes: &[u8]) -> Result<(i64, Image), String> {
    let mut fields = Fields::new(layout, bytes)?;
    let stamp = fields.header()?;
    fields.text()?;
    Ok((stamp, image::decode(fields.sequence()?)?))
}

/// Stamp and grey image of a `sensor_msgs/Image`.
pub(super) fn image(layout: Layout, bytes: &[u8]) -> Result<(i64, Image), String> {
    let mut fields = Fields::new(layout, bytes)?;
    let stamp = fields.header()?;
    let (height, width) = (fields.u32()?, fields.u32()?);
    let encoding = fields.text()?;
    let is_bigendian = fields.u8()? != 0;
    let step = fields.u32()? as usize;
    let data = fields.sequence()?;
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
                    "images {other} are not read: mono8, mono16, rgb8, bgr8, their kinds with alpha, yuv422 and bayer_*8 are"
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
