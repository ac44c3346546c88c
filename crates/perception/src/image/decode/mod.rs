//! Grey images from JPEG, PNG and BMP files.

mod bmp;

use std::io::Cursor;
use std::path::{Path, PathBuf};

use lsfb_types::Image;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

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
        Some(Format::Jpeg) => decode_jpeg(bytes),
        Some(Format::Png) => decode_png(bytes),
        Some(Format::Bmp) => bmp::decode(bytes),
        None => Err("neither JPEG, PNG nor BMP".to_owned()),
    }
}

fn decode_jpeg(bytes: &[u8]) -> Result<Image, String> {
    // The decoder fills what is missing with grey.
    if !jpeg_is_whole(bytes) {
        return Err("a JPEG that is cut short".to_owned());
    }
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::Luma);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let pixels = decoder.decode().map_err(|e| e.to_string())?;
    let info = decoder.info().ok_or("no size")?;
    grey(u32::from(info.width), u32::from(info.height), pixels, 1)
}

/// Whether the end of the image comes behind the start of its last scan. Within a scan a marker's first byte is followed by a zero
/// or a restart, so that no data passes for the end.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    const SCAN: u8 = 0xda;
    const END: u8 = 0xd9;
    let mut at = 2;
    // Segments up to the first scan have lengths: a thumbnail in one of them has an end of its own.
    while let Some([0xff, marker, high, low]) = bytes.get(at..at + 4) {
        if *marker == 0xff {
            at += 1;
            continue;
        }
        at += 2 + usize::from(u16::from_be_bytes([*high, *low]));
        if *marker == SCAN {
            let rest = bytes.get(at..).unwrap_or_default();
            return rest.windows(2).any(|w| w == [0xff, END]);
        }
    }
    false
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

    /// A grey JPEG of 8 × 8 pixels (libjpeg).
    const JPEG: &str = "ffd8ffe000104a46494600010100000100010000ffdb004300080606070605080707070909080a0c140d0c0b0b0c1912130f141d1a1f1e1d1a1c1c20242e2720222c231c1c2837292c30313434341f27393d38323c2e333432ffc0000b080008000801011100ffc4001f0000010501010101010100000000000000000102030405060708090a0bffc400b5100002010303020403050504040000017d01020300041105122131410613516107227114328191a1082342b1c11552d1f02433627282090a161718191a25262728292a3435363738393a434445464748494a535455565758595a636465666768696a737475767778797a838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9faffda0008010100003f00f7faffd9";

    #[test]
    fn a_jpeg_cut_short_is_not_read_as_whole() {
        let digits = JPEG.as_bytes().chunks(2);
        let bytes: Vec<u8> = digits
            .map(|d| u8::from_str_radix(std::str::from_utf8(d).expect("ASCII"), 16).expect("hex"))
            .collect();
        let image = decode(&bytes).expect("an image");
        assert_eq!((image.width, image.height, image.pixels.len()), (8, 8, 64));
        for length in 2..bytes.len() {
            let error = decode(&bytes[..length]).expect_err("it is cut");
            assert!(error.contains("cut short"), "{length}: {error}");
        }
    }
}
