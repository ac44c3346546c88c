//! Images written as PNG.

use std::io::{self, Write};

use png::{BitDepth, ColorType, Encoder};

pub use png::Compression;

/// Samples of a picture, row by row.
#[derive(Clone, Copy, Debug)]
pub enum Samples<'a> {
    /// One byte a pixel.
    Grey(&'a [u8]),
    /// One value of 16 bits a pixel.
    Grey16(&'a [u16]),
    /// Red, green and blue, three bytes a pixel.
    Rgb(&'a [u8]),
}

/// Writes a picture as PNG; an error also where there are more or fewer samples than its size in pixels has.
pub fn write_png(
    out: impl Write,
    (width, height): (u32, u32),
    samples: Samples<'_>,
    compression: Compression,
) -> io::Result<()> {
    let mut encoder = Encoder::new(out, width, height);
    let (color, depth) = match samples {
        Samples::Grey(_) => (ColorType::Grayscale, BitDepth::Eight),
        Samples::Grey16(_) => (ColorType::Grayscale, BitDepth::Sixteen),
        Samples::Rgb(_) => (ColorType::Rgb, BitDepth::Eight),
    };
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(compression);
    let mut writer = encoder.write_header()?;
    match samples {
        Samples::Grey(bytes) | Samples::Rgb(bytes) => writer.write_image_data(bytes)?,
        Samples::Grey16(values) => {
            let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
            writer.write_image_data(&bytes)?;
        }
    }
    Ok(writer.finish()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::decode;

    fn written(size: (u32, u32), samples: Samples<'_>) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        write_png(&mut bytes, size, samples, Compression::Fast)?;
        Ok(bytes)
    }

    #[test]
    fn what_is_written_is_read() {
        let grey = written((3, 1), Samples::Grey(&[1, 2, 250])).expect("written");
        assert_eq!(decode(&grey).expect("read").pixels, [1, 2, 250]);
        let deep = written((2, 1), Samples::Grey16(&[0x0a00, 0xff01])).expect("written");
        assert_eq!(decode(&deep).expect("read").pixels, [0x0a, 0xff]);
        let white = written((1, 1), Samples::Rgb(&[255; 3])).expect("written");
        assert_eq!(decode(&white).expect("read").pixels, [255]);
    }

    #[test]
    fn samples_that_do_not_fill_a_picture_are_refused() {
        assert!(written((2, 2), Samples::Grey(&[0; 3])).is_err());
        assert!(written((2, 2), Samples::Grey(&[0; 5])).is_err());
        assert!(written((0, 2), Samples::Grey(&[])).is_err());
    }
}
