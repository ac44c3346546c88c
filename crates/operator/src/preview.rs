//! Small pictures of what the cameras see.

use lsfb_types::Image;

/// First byte of a preview among the binary messages; that of a piece of the map is 1.
const KIND: u8 = 2;
/// Longest side, pixels: enough to see a hand before the lens, 20 kB at most.
const LONGEST_SIDE_PX: u32 = 160;

/// A small grey picture.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Preview {
    width: u16,
    height: u16,
    pixels: Vec<u8>,
}

impl Preview {
    /// Makes an image small: each pixel is the mean of a square. `None` where the image has no pixels, or fewer than it says.
    pub fn of(image: &Image) -> Option<Self> {
        let step = image
            .width
            .max(image.height)
            .div_ceil(LONGEST_SIDE_PX)
            .max(1);
        let (width, height) = (image.width / step, image.height / step);
        let needed = u64::from(image.width) * u64::from(image.height);
        if width == 0 || height == 0 || (image.pixels.len() as u64) < needed {
            return None;
        }
        let (stride, step) = (image.width as usize, step as usize);
        let mean = |x: usize, y: usize| {
            let rows = (y * step..(y + 1) * step).filter_map(|row| {
                let start = row * stride + x * step;
                image.pixels.get(start..start + step)
            });
            let sum: u32 = rows.flatten().map(|grey| u32::from(*grey)).sum();
            (sum / (step * step) as u32) as u8
        };
        let rows = 0..height as usize;
        let pixels = rows.flat_map(|y| (0..width as usize).map(move |x| (x, y)));
        Some(Self {
            width: u16::try_from(width).ok()?,
            height: u16::try_from(height).ok()?,
            pixels: pixels.map(|(x, y)| mean(x, y)).collect(),
        })
    }

    /// For the page, little-endian: kind (`u8`), length of the camera's name (`u8`), width and height (`u16` each), the name,
    /// then the grey values row by row.
    pub(crate) fn message(&self, camera: &str) -> Vec<u8> {
        let name = camera.as_bytes();
        let name = name.get(..usize::from(u8::MAX)).unwrap_or(name);
        let mut bytes = vec![KIND, name.len() as u8];
        bytes.extend(self.width.to_le_bytes());
        bytes.extend(self.height.to_le_bytes());
        bytes.extend(name);
        bytes.extend(&self.pixels);
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_becomes_the_means_of_its_squares() {
        let (width, height) = (400_u32, 300_u32);
        let pixels = (0..width * height).map(|i| if i % width < 200 { 10 } else { 250 });
        let image = Image {
            width,
            height,
            pixels: pixels.collect(),
            ..Image::default()
        };
        let preview = Preview::of(&image).unwrap();
        assert_eq!((preview.width, preview.height), (133, 100));
        let row = &preview.pixels[50 * 133..51 * 133];
        assert_eq!((row[0], row[132]), (10, 250));
        // Of the three columns of this square two are dark.
        assert_eq!(u16::from(row[66]), (2 * 10 + 250) / 3);
        let message = preview.message("cam0");
        assert_eq!(message[..10], *b"\x02\x04\x85\x00\x64\x00cam0");
        assert_eq!(message.len(), 10 + 133 * 100);
    }

    #[test]
    fn images_without_their_pixels_give_none() {
        assert_eq!(Preview::of(&Image::default()), None);
        let short = Image {
            width: 640,
            height: 400,
            pixels: vec![0; 1_000],
            ..Image::default()
        };
        assert_eq!(Preview::of(&short), None);
        let thin = Image {
            width: 1_000,
            height: 1,
            pixels: vec![0; 1_000],
            ..Image::default()
        };
        assert_eq!(Preview::of(&thin), None);
    }
}
