//! Windows bitmaps without compression, of 8, 24 and 32 bits.

use lsfb_types::Image;

use super::{grey, luma};

/// Header of the file, then that of the bitmap.
const FILE_HEADER: usize = 14;

/// Decodes a bitmap as grey.
pub(super) fn decode(bytes: &[u8]) -> Result<Image, String> {
    let short = || "a truncated BMP".to_owned();
    let u32_at = |at: usize| -> Result<u32, String> {
        let four = bytes.get(at..at + 4).and_then(|b| b.try_into().ok());
        four.map(u32::from_le_bytes).ok_or_else(short)
    };
    let start = u32_at(10)? as usize;
    let header = u32_at(FILE_HEADER)? as usize;
    let (width, rows) = (u32_at(18)? as i32, u32_at(22)? as i32);
    // Behind the number of planes, which is one.
    let bits = u32_at(26)? >> 16;
    let compression = u32_at(30)?;
    if header < 40 || width <= 0 || rows == 0 || rows == i32::MIN {
        return Err(format!("a BMP of {width} × {rows} pixels"));
    }
    // 3: masks say where the colors are; where they usually are is all that is read.
    if !(compression == 0 || compression == 3 && bits == 32) {
        return Err("a compressed BMP".to_owned());
    }
    let pixel_bytes = match bits {
        8 => 1,
        24 => 3,
        32 => 4,
        other => {
            return Err(format!(
                "a BMP of {other} bits per pixel: 8, 24 and 32 are supported"
            ));
        }
    };
    let (width, height) = (width as usize, rows.unsigned_abs() as usize);
    let row_bytes = width
        .checked_mul(pixel_bytes)
        .map(|row| row.next_multiple_of(4))
        .ok_or_else(short)?;
    let length = row_bytes.checked_mul(height).ok_or_else(short)?;
    let end = start.checked_add(length).ok_or_else(short)?;
    let data = bytes.get(start..end).ok_or_else(short)?;
    let palette = |index: u8| -> u8 {
        let at = FILE_HEADER + header + 4 * usize::from(index);
        let color = bytes.get(at..at + 3).filter(|_| at + 3 <= start);
        color.map_or(index, |c| luma([c[2], c[1], c[0]]))
    };
    let palette: Vec<u8> = (0..=u8::MAX).map(palette).collect();
    let mut lines: Vec<&[u8]> = data.chunks_exact(row_bytes).collect();
    // Usually from the lowest row up.
    if rows > 0 {
        lines.reverse();
    }
    let pixels = lines
        .into_iter()
        .flat_map(|line| line[..width * pixel_bytes].chunks_exact(pixel_bytes))
        .map(|p| match p {
            [index] => palette[usize::from(*index)],
            [blue, green, red, ..] => luma([*red, *green, *blue]),
            _ => 0,
        });
    grey(width as u32, height as u32, pixels.collect(), 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(bits: u16, rows: i32, palette: &[u8], data: &[u8]) -> Vec<u8> {
        let start = 54 + palette.len() as u32;
        let mut bytes = b"BM".to_vec();
        bytes.extend((start + data.len() as u32).to_le_bytes());
        bytes.extend([0; 4]);
        bytes.extend(start.to_le_bytes());
        bytes.extend(40u32.to_le_bytes());
        bytes.extend(3i32.to_le_bytes());
        bytes.extend(rows.to_le_bytes());
        bytes.extend(1u16.to_le_bytes());
        bytes.extend(bits.to_le_bytes());
        bytes.extend([0; 24]);
        bytes.extend(palette);
        bytes.extend(data);
        bytes
    }

    #[test]
    fn bitmaps_are_read_from_either_end() {
        let palette: Vec<u8> = (0..=255u8).flat_map(|k| [255 - k; 4]).collect();
        let data = [1, 2, 3, 0, 4, 5, 6, 0];
        let image = decode(&file(8, 2, &palette, &data)).expect("an image");
        assert_eq!((image.width, image.height), (3, 2));
        assert_eq!(image.pixels, [251, 250, 249, 254, 253, 252]);
        let image = decode(&file(8, -2, &palette, &data)).expect("an image");
        assert_eq!(image.pixels, [254, 253, 252, 251, 250, 249]);
        // Blue, green, red.
        let colors = [255, 0, 0, 0, 255, 0, 0, 0, 255, 0, 0, 0];
        let image = decode(&file(24, 1, &[], &colors)).expect("an image");
        assert_eq!(image.pixels, [29, 150, 76]);
    }

    #[test]
    fn what_is_no_whole_bitmap_is_refused() {
        let whole = file(24, 1, &[], &[0; 12]);
        for length in 2..whole.len() {
            assert!(decode(&whole[..length]).is_err(), "{length}");
        }
        let error = decode(&file(4, 1, &[], &[0; 12])).expect_err("four bits");
        assert!(error.contains("4 bits"), "{error}");
        assert!(decode(&file(24, i32::MIN, &[], &[0; 12])).is_err());
    }
}
