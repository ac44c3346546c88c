//! Grey images from JPEG and PNG files.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use lsfb_types::Image;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Largest image accepted, pixels.
const MAX_PIXELS: u64 = 1 << 28;

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
    #[error("{path}: neither PNG nor JPEG", path = path.display())]
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
    let decoded = if bytes.starts_with(b"\x89PNG") {
        decode_png(&bytes)
    } else if bytes.starts_with(b"\xff\xd8") {
        decode_jpeg(&bytes)
    } else {
        return Err(ImageError::OtherFormat {
            path: path.to_owned(),
        });
    };
    decoded.map_err(|reason| ImageError::Damaged {
        path: path.to_owned(),
        reason,
    })
}

fn decode_jpeg(bytes: &[u8]) -> Result<Image, String> {
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::Luma);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let pixels = decoder.decode().map_err(|e| e.to_string())?;
    let info = decoder.info().ok_or("no size")?;
    grey(u32::from(info.width), u32::from(info.height), pixels, 1)
}

fn decode_png(bytes: &[u8]) -> Result<Image, String> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(|e| e.to_string())?;
    let size = reader
        .output_buffer_size()
        .filter(|size| *size as u64 <= 4 * MAX_PIXELS)
        .ok_or("too large")?;
    let mut samples = vec![0; size];
    let info = reader.next_frame(&mut samples).map_err(|e| e.to_string())?;
    samples.truncate(info.buffer_size());
    grey(info.width, info.height, samples, info.color_type.samples())
}

/// Keeps the first of grey and alpha, weighs red, green and blue as ITU-R BT.601 does.
fn grey(width: u32, height: u32, samples: Vec<u8>, channels: usize) -> Result<Image, String> {
    let pixels: Vec<u8> = match channels {
        1 => samples,
        2 => samples.chunks_exact(2).map(|p| p[0]).collect(),
        _ => samples
            .chunks_exact(channels)
            .map(|p| {
                let [r, g, b] = [p[0], p[1], p[2]].map(u32::from);
                ((299 * r + 587 * g + 114 * b + 500) / 1000) as u8
            })
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
}
