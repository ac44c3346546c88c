//! Pictures in scenes: PNG and JPEG.

use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::super::canvas::Canvas;

/// Pixels of one picture at most.
pub(super) const MOST_PIXELS: usize = 1 << 26;
/// Pixels along an edge of a JPEG picture at most.
const LONGEST: usize = 1 << 14;

/// What the values of a picture are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum Values {
    /// Brightness as shown on a screen.
    Shown,
    /// Share of the light, as sRGB codes it (IEC 61966-2-1).
    Light,
}

impl Values {
    fn of(self, byte: u8) -> f32 {
        let shown = f32::from(byte) / 255.0;
        match self {
            Self::Shown => shown,
            Self::Light if shown <= 0.040_45 => shown / 12.92,
            Self::Light => ((shown + 0.055) / 1.055).powf(2.4),
        }
    }

    /// Grey of a colour.
    pub(super) fn grey(self, [r, g, b]: [f32; 3]) -> f32 {
        match self {
            Self::Shown => 0.299 * r + 0.587 * g + 0.114 * b,
            // ITU-R BT.709.
            Self::Light => 0.2126 * r + 0.7152 * g + 0.0722 * b,
        }
    }
}

/// A PNG or JPEG picture in grey.
pub(super) fn decode(bytes: &[u8], values: Values) -> Result<Canvas, String> {
    let (width, height, channels, pixels) = if bytes.starts_with(b"\x89PNG") {
        let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        decoder.set_transformations(png::Transformations::normalize_to_color8());
        let mut reader = decoder
            .read_info()
            .map_err(|e| format!("a PNG picture: {e}"))?;
        let (w, h) = reader.info().size();
        let size = reader
            .output_buffer_size()
            .filter(|_| u64::from(w) * u64::from(h) <= MOST_PIXELS as u64)
            .ok_or("a PNG picture is too large")?;
        let mut pixels = vec![0; size];
        let info = reader
            .next_frame(&mut pixels)
            .map_err(|e| format!("a PNG picture: {e}"))?;
        (
            info.width as usize,
            info.height as usize,
            info.color_type.samples(),
            pixels,
        )
    } else {
        let options = DecoderOptions::default()
            .set_max_width(LONGEST)
            .set_max_height(LONGEST);
        let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options);
        decoder
            .decode_headers()
            .map_err(|e| format!("a JPEG picture: {e}"))?;
        if decoder
            .dimensions()
            .is_some_and(|(w, h)| w * h > MOST_PIXELS)
        {
            return Err("a JPEG picture is too large".to_owned());
        }
        let pixels = decoder
            .decode()
            .map_err(|e| format!("a JPEG picture: {e}"))?;
        let (width, height) = decoder
            .dimensions()
            .ok_or("a JPEG picture without a size")?;
        (
            width,
            height,
            pixels.len() / (width * height).max(1),
            pixels,
        )
    };
    if width < 2 || height < 2 || channels == 0 {
        return Err("a picture has less than two pixels along an edge".to_owned());
    }
    let of: Vec<f32> = (0..=u8::MAX).map(|byte| values.of(byte)).collect();
    let at = |byte: u8| of[usize::from(byte)];
    let values = pixels
        .chunks_exact(channels)
        .take(width * height)
        .map(|p| match *p {
            [r, g, b, ..] => values.grey([at(r), at(g), at(b)]),
            [grey, ..] => at(grey),
            [] => 0.0,
        });
    let values: Vec<f32> = values.collect();
    if values.len() < width * height {
        return Err("a picture ends too early".to_owned());
    }
    Ok(Canvas {
        width,
        height,
        texel_m: [1.0 / width as f32, 1.0 / height as f32],
        values,
        is_measured: false,
    })
}
