//! Grey images from JPEG and PNG files.

use std::path::{Path, PathBuf};

use lsfb_types::Image;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::Error;

/// Largest image accepted, pixels.
const MAX_PIXELS: usize = 1 << 28;

/// The JPEG and PNG files of a folder in the order of their names; numbers in names count as numbers, so that `pose10`
/// follows `pose9`.
pub fn list(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let io = |source| Error::Io {
        path: folder.display().to_string(),
        source,
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let extension = path.extension().map(|e| e.to_ascii_lowercase());
        if extension.is_some_and(|e| e == "jpg" || e == "jpeg" || e == "png") {
            files.push(path);
        }
    }
    files.sort_by_cached_key(|p| natural_key(&p.to_string_lossy()));
    Ok(files)
}

/// Text cut into words and numbers: numbers compare by value, then all by text.
fn natural_key(name: &str) -> (Vec<(String, u128)>, String) {
    let mut parts: Vec<(String, u128)> = Vec::new();
    let mut word = String::new();
    let mut digits = String::new();
    for c in name.chars().chain(['\0']) {
        if c.is_ascii_digit() {
            digits.push(c);
            continue;
        }
        if !digits.is_empty() {
            let number = digits.parse().unwrap_or(u128::MAX);
            parts.push((std::mem::take(&mut word), number));
            digits.clear();
        }
        word.push(c);
    }
    parts.push((word, 0));
    (parts, name.to_owned())
}

/// Reads one image as grey.
pub fn read(path: &Path) -> Result<Image, Error> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io {
        path: path.display().to_string(),
        source,
    })?;
    let decoded = if bytes.starts_with(&[0x89, b'P', b'N', b'G']) {
        decode_png(&bytes)
    } else {
        decode_jpeg(bytes)
    };
    decoded.map_err(|problem| Error::Parse {
        path: path.display().to_string(),
        problem,
    })
}

fn decode_jpeg(bytes: Vec<u8>) -> Result<Image, String> {
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::Luma);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let pixels = decoder
        .decode()
        .map_err(|e| format!("not a readable JPEG: {e}"))?;
    let (width, height) = decoder.dimensions().ok_or("a JPEG without a size")?;
    gray(width, height, pixels)
}

fn decode_png(bytes: &[u8]) -> Result<Image, String> {
    let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder
        .read_info()
        .map_err(|e| format!("not a readable PNG: {e}"))?;
    let size = reader
        .output_buffer_size()
        .filter(|size| *size <= 4 * MAX_PIXELS)
        .ok_or("a PNG of impossible size")?;
    let mut buffer = vec![0; size];
    let info = reader
        .next_frame(&mut buffer)
        .map_err(|e| format!("not a readable PNG: {e}"))?;
    let samples = info.color_type.samples();
    let pixels = match samples {
        1 => buffer,
        2 => buffer.chunks_exact(2).map(|c| c[0]).collect(),
        // Rec. 601, as JPEG has it.
        _ => buffer
            .chunks_exact(samples)
            .map(|c| {
                let [r, g, b] = [c[0], c[1], c[2]].map(u32::from);
                ((299 * r + 587 * g + 114 * b + 500) / 1000) as u8
            })
            .collect(),
    };
    gray(info.width as usize, info.height as usize, pixels)
}

fn gray(width: usize, height: usize, mut pixels: Vec<u8>) -> Result<Image, String> {
    let count = width
        .checked_mul(height)
        .filter(|n| (1..=MAX_PIXELS).contains(n))
        .ok_or_else(|| format!("{width} × {height} pixels"))?;
    if pixels.len() < count {
        return Err(format!("{} pixels, expected {count}", pixels.len()));
    }
    pixels.truncate(count);
    Ok(Image {
        width: width as u32,
        height: height as u32,
        pixels,
        exposure_ns: 0,
        frame_id: 0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_ordered_by_their_numbers() {
        let mut names = ["img10.png", "img9.png", "a2", "img2b", "img2"];
        names.sort_by_cached_key(|n| natural_key(n));
        assert_eq!(names, ["a2", "img2", "img2b", "img9.png", "img10.png"]);
    }
}
