//! COLMAP's `images.bin`, written as its `images.txt` would be: one reader knows what the columns mean.
//!
//! Layout, little-endian (COLMAP's documentation, "Output format"): the number of images (u64), then for each its number (u32), the
//! rotation w x y z and translation of the world in the camera (f64 each), the camera's number (u32), the name to a zero byte, the number
//! of image points (u64) and 24 bytes for each of these.

use std::fmt::Write as _;
use std::path::Path;

/// How the comments of `images.txt` begin.
pub(super) const HEAD: &str = "Image list with two lines of data per image";
/// Bytes of one image point: two coordinates and the number of its 3D point.
const POINT_BYTES: u64 = 24;
/// Longest name of an image that is believed.
const MAX_NAME_BYTES: usize = 4_096;

/// Whether a file is called as a binary model's images are.
pub(super) fn is_binary(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "bin")
}

/// The images as text, without their points.
pub(super) fn as_text(bytes: &[u8]) -> Result<String, String> {
    let mut rest = Rest { bytes, at: 0 };
    let count = rest.u64()?;
    let mut text = format!("# {HEAD}\n");
    for _ in 0..count {
        let number = rest.u32()?;
        write!(text, "{number}").map_err(|e| e.to_string())?;
        for _ in 0..7 {
            // Debug prints as many digits as give the same number again.
            write!(text, " {:?}", f64::from_bits(rest.u64()?)).map_err(|e| e.to_string())?;
        }
        let camera = rest.u32()?;
        let name = rest.name()?;
        writeln!(text, " {camera} {name}").map_err(|e| e.to_string())?;
        let points = rest.u64()?;
        let length = points.checked_mul(POINT_BYTES);
        let length = length.and_then(|l| usize::try_from(l).ok());
        rest.take(length.ok_or_else(|| rest.cut("points"))?)?;
    }
    match rest.bytes.len() - rest.at {
        0 => Ok(text),
        more => Err(format!(
            "{more} bytes after the {count} images of COLMAP's images.bin"
        )),
    }
}

/// What is not read yet.
struct Rest<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Rest<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], String> {
        let end = self.at.checked_add(length);
        let found = end.and_then(|end| self.bytes.get(self.at..end));
        let found = found.ok_or_else(|| self.cut("bytes"))?;
        self.at += length;
        Ok(found)
    }

    fn u32(&mut self) -> Result<u32, String> {
        let bytes = self.take(4)?.try_into();
        bytes.map(u32::from_le_bytes).map_err(|_| self.cut("bytes"))
    }

    fn u64(&mut self) -> Result<u64, String> {
        let bytes = self.take(8)?.try_into();
        bytes.map(u64::from_le_bytes).map_err(|_| self.cut("bytes"))
    }

    /// To its zero byte.
    fn name(&mut self) -> Result<&'a str, String> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let end = rest.iter().take(MAX_NAME_BYTES).position(|b| *b == 0);
        let length = end.ok_or_else(|| self.cut("name"))?;
        let name = self.take(length)?;
        self.take(1)?;
        std::str::from_utf8(name).map_err(|_| self.cut("name"))
    }

    fn cut(&self, what: &str) -> String {
        format!(
            "byte {}: invalid {what}; the file is truncated, or not COLMAP's images.bin",
            self.at
        )
    }
}
