//! Grey images from JPEG files.
//!
//! Decoders show what they can of a damaged file: what is missing becomes grey, and zeros in the middle of the data a smear that no
//! later stage tells from a picture. So the file is looked at before it is decoded: its end must come, and the data of each scan must
//! be as long as the picture takes (`scan`). Damage to pixels that leaves the length of the data alone is not seen: the
//! format has no checksum.

mod huffman;
mod scan;

use lsfb_types::Image;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

pub(super) fn decode(bytes: &[u8]) -> Result<Image, String> {
    if !is_whole(bytes) {
        return Err("a truncated JPEG".to_owned());
    }
    scan::check(bytes).map_err(|damage| format!("a damaged JPEG: {damage}"))?;
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::Luma);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let pixels = decoder.decode().map_err(|e| e.to_string())?;
    let info = decoder.info().ok_or("no size")?;
    super::grey(u32::from(info.width), u32::from(info.height), pixels, 1)
}

/// Whether the end of the image comes behind the start of its last scan. Within a scan a marker's first byte is followed by a zero
/// or a restart, so that no data passes for the end.
fn is_whole(bytes: &[u8]) -> bool {
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

#[cfg(test)]
mod tests;
