//! Small pictures beside the images, for viewers: Rerun takes grey raw images for depth, and remote viewers want few bytes.

use lsfb_types::Image;

/// Wider images are halved.
const MAX_WIDTH: u32 = 320;

/// The image as PNG, halved where it is large; `None` for an image without pixels.
pub(crate) fn png(image: &Image) -> Option<Vec<u8>> {
    let halved;
    let shown = if image.width > MAX_WIDTH {
        halved = halve(image);
        &halved
    } else {
        image
    };
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, shown.width, shown.height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().ok()?;
    writer.write_image_data(&shown.pixels).ok()?;
    writer.finish().ok()?;
    Some(bytes)
}

/// Means of two by two pixels; an odd last row or column is left out.
fn halve(image: &Image) -> Image {
    let (width, height) = (image.width / 2, image.height / 2);
    let stride = image.width as usize;
    let mut pixels = Vec::with_capacity((width * height) as usize);
    for rows in image.pixels.chunks_exact(2 * stride) {
        let (upper, lower) = rows.split_at(stride);
        for (u, l) in upper.chunks_exact(2).zip(lower.chunks_exact(2)) {
            let sum = u16::from(u[0]) + u16::from(u[1]) + u16::from(l[0]) + u16::from(l[1]);
            pixels.push(((sum + 2) / 4) as u8);
        }
    }
    Image {
        width,
        height,
        pixels,
        ..Image::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: u32, height: u32) -> Image {
        let pixels = (0..width * height).map(|i| (i % 251) as u8).collect();
        Image {
            width,
            height,
            pixels,
            ..Image::default()
        }
    }

    fn decode(bytes: &[u8]) -> Image {
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
            .read_info()
            .unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        Image {
            width: info.width,
            height: info.height,
            pixels,
            ..Image::default()
        }
    }

    #[test]
    fn small_images_stay_and_large_ones_are_halved() {
        assert_eq!(decode(&png(&image(320, 3)).unwrap()), image(320, 3));
        let large = image(643, 7);
        let preview = decode(&png(&large).unwrap());
        assert_eq!((preview.width, preview.height), (321, 3));
        let mean = [0, 1, 643, 644]
            .map(|i| u32::from(large.pixels[i]))
            .iter()
            .sum::<u32>() as f64
            / 4.0;
        assert_eq!(f64::from(preview.pixels[0]), mean.round());
        assert_eq!(png(&Image::default()), None);
    }
}
