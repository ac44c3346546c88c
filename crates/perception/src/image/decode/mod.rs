//! Grey images from JPEG, PNG and BMP files.

mod bmp;
mod jpeg;

use std::io::Cursor;
use std::path::{Path, PathBuf};

use lsfb_types::Image;

/// Largest image accepted, pixels.
pub const MAX_PIXELS: u64 = 1 << 28;

/// Why an image could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The file or folder could not be read.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is another kind of file.
    #[error("{path}: neither JPEG, PNG nor BMP", path = path.display())]
    OtherFormat {
        /// The file.
        path: PathBuf,
    },
    /// The file is damaged.
    #[error("{path}: not a readable image ({reason}); copy it again from its source", path = path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What the decoder says.
        reason: String,
    },
}

/// Reads one image as grey.
pub fn read(path: &Path) -> Result<Image, ImageError> {
    let bytes = std::fs::read(path).map_err(|source| ImageError::Io {
        path: path.to_owned(),
        source,
    })?;
    match Format::of(&bytes) {
        Some(_) => decode(&bytes).map_err(|reason| ImageError::Damaged {
            path: path.to_owned(),
            reason,
        }),
        None => Err(ImageError::OtherFormat {
            path: path.to_owned(),
        }),
    }
}

/// What a file is by its first bytes.
enum Format {
    Jpeg,
    Png,
    Bmp,
}

impl Format {
    fn of(bytes: &[u8]) -> Option<Self> {
        let signatures = [
            (&b"\x89PNG"[..], Self::Png),
            (&b"\xff\xd8"[..], Self::Jpeg),
            (&b"BM"[..], Self::Bmp),
        ];
        let mut known = signatures.into_iter();
        Some(known.find(|(s, _)| bytes.starts_with(s))?.1)
    }
}

/// Decodes the bytes of one image as grey; what is wrong with them else, in words.
pub fn decode(bytes: &[u8]) -> Result<Image, String> {
    match Format::of(bytes) {
        Some(Format::Jpeg) => jpeg::decode(bytes),
        Some(Format::Png) => decode_png(bytes),
        Some(Format::Bmp) => bmp::decode(bytes),
        None => Err("neither JPEG, PNG nor BMP".to_owned()),
    }
}

fn decode_png(bytes: &[u8]) -> Result<Image, String> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    // Not to eight bits: of twelve in sixteen that would leave four.
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(|e| e.to_string())?;
    let size = reader
        .output_buffer_size()
        .filter(|size| *size as u64 <= 8 * MAX_PIXELS)
        .ok_or("too large")?;
    let mut samples = vec![0; size];
    let info = reader.next_frame(&mut samples).map_err(|e| e.to_string())?;
    samples.truncate(info.buffer_size());
    if info.bit_depth == png::BitDepth::Sixteen {
        let values = samples.chunks_exact(2);
        let values: Vec<u16> = values.map(|v| u16::from_be_bytes([v[0], v[1]])).collect();
        samples = grey_from_16_bits(&values);
    }
    grey(info.width, info.height, samples, info.color_type.samples())
}

/// Brightness of red, green and blue by ITU-R BT.601, as JPEG has it.
pub fn luma(color: [u8; 3]) -> u8 {
    let [r, g, b] = color.map(u32::from);
    ((299 * r + 587 * g + 114 * b + 500) / 1000) as u8
}

/// Eight bits of sixteen: the highest that are used, since cameras of ten, twelve and fourteen bits leave the others zero.
pub fn grey_from_16_bits(values: &[u16]) -> Vec<u8> {
    let largest = values.iter().copied().max().unwrap_or(0);
    let used = (u16::BITS - largest.leading_zeros())
        .next_multiple_of(2)
        .max(8);
    values.iter().map(|v| (v >> (used - 8)) as u8).collect()
}

/// Keeps the first of grey and alpha, weighs colors by their brightness.
fn grey(width: u32, height: u32, samples: Vec<u8>, channels: usize) -> Result<Image, String> {
    let pixels: Vec<u8> = match channels {
        1 => samples,
        2 => samples.chunks_exact(2).map(|p| p[0]).collect(),
        _ => samples
            .chunks_exact(channels)
            .map(|p| luma([p[0], p[1], p[2]]))
            .collect(),
    };
    let expected = u64::from(width) * u64::from(height);
    if pixels.len() as u64 != expected || !(1..=MAX_PIXELS).contains(&expected) {
        return Err(format!("{} pixels for {width} × {height}", pixels.len()));
    }
    Ok(Image {
        width,
        height,
        pixels,
        exposure_ns: 0,
        frame_id: 0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_and_damage_in_images() {
        let folder = tempfile::tempdir().expect("scratch folder");
        let path = folder.path().join("rgb.png");
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 2, 1);
        encoder.set_color(png::ColorType::Rgb);
        let mut writer = encoder.write_header().expect("header");
        writer
            .write_image_data(&[255, 0, 0, 255, 255, 255])
            .expect("pixels");
        writer.finish().expect("end");
        std::fs::write(&path, &bytes).expect("write");
        let image = read(&path).expect("valid");
        assert_eq!(
            (image.width, image.height, image.pixels),
            (2, 1, vec![76, 255])
        );
        for damaged in [&bytes[..bytes.len() / 2], b"\xff\xd8\xff", b"text", b""] {
            std::fs::write(&path, damaged).expect("write");
            let message = read(&path).expect_err("damaged").to_string();
            assert!(message.contains("rgb.png"), "{message}");
        }
    }

    #[test]
    fn twelve_bits_in_sixteen_keep_their_contrast() {
        assert_eq!(grey_from_16_bits(&[0, 2048, 4095]), [0, 128, 255]);
        assert_eq!(grey_from_16_bits(&[0, 0x8000, 0xffff]), [0, 128, 255]);
        assert_eq!(grey_from_16_bits(&[0, 7]), [0, 7]);
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, 2, 1);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        let mut writer = encoder.write_header().expect("PNG");
        writer
            .write_image_data(&[0x0f, 0xff, 0x04, 0x00])
            .expect("PNG");
        drop(writer);
        assert_eq!(decode(&file).expect("an image").pixels, [255, 64]);
    }
}
