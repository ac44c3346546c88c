//! Recordings made by others, where they are.

use std::io::Read;

use flate2::read::GzDecoder;

/// Text of a gzipped file; `None`, with a line, where it is absent.
pub fn text(test: &str, name: &str) -> Option<String> {
    let path = lsfb_tests::recordings(test, name)?;
    let mut text = String::new();
    GzDecoder::new(std::fs::File::open(path).expect("file opens"))
        .read_to_string(&mut text)
        .expect("file is text");
    Some(text)
}
