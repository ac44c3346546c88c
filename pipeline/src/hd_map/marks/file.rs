//! Clicks as a text file: somebody writes them down, or a program that shows images does.

use std::path::Path;

use lsfb_geometry::Vector2;
use lsfb_types::Timestamp;

use super::Click;
use crate::Error;

/// Clicks are made by hand.
const MAX_BYTES: u64 = 16 << 20;
/// The line of names, which may be left out.
const NAMES: &str = "mark,camera,time_ns,u_px,v_px";

/// Reads clicks, one a line: `mark,camera,time_ns,u_px,v_px`, the stamp of the image in nanoseconds and the pixel, whose middle is a whole number. Lines that
/// are empty, begin with `#` or are the line of names are skipped.
pub fn read_clicks(path: &Path) -> Result<Vec<Click>, Error> {
    let size = std::fs::metadata(path).map_err(Error::io(path))?.len();
    let bad = |line: usize, reason: String| Error::ClickLine {
        path: path.to_owned(),
        line,
        reason,
    };
    if size > MAX_BYTES {
        return Err(bad(1, format!("{size} bytes are no list of clicks")));
    }
    let text = std::fs::read_to_string(path).map_err(Error::io(path))?;
    let mut clicks: Vec<Click> = Vec::new();
    for (index, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') || line.replace(' ', "") == NAMES {
            continue;
        }
        clicks.push(parse(line).map_err(|reason| bad(index + 1, reason))?);
    }
    match clicks.is_empty() {
        true => Err(bad(1, format!("no click in it: expected lines of {NAMES}"))),
        false => Ok(clicks),
    }
}

fn parse(line: &str) -> Result<Click, String> {
    let columns: Vec<&str> = line.split(',').map(str::trim).collect();
    let [mark, camera, time_ns, u_px, v_px] = columns[..] else {
        return Err(format!("{} columns, expected {NAMES}", columns.len()));
    };
    // Names stand in surveys too, whose words are divided by blanks.
    if mark.is_empty() || mark.contains(char::is_whitespace) {
        return Err(format!("{mark:?} is no name of a mark: one word is needed"));
    }
    let nanos: i64 = time_ns
        .parse()
        .map_err(|_| format!("{time_ns:?} is no stamp in whole nanoseconds"))?;
    let pixel = |text: &str| match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(format!("{text:?} is no pixel")),
    };
    Ok(Click {
        mark: mark.to_owned(),
        camera: camera.to_owned(),
        time: Timestamp::from_nanos(nanos),
        pixel: Vector2::new(pixel(u_px)?, pixel(v_px)?),
    })
}
