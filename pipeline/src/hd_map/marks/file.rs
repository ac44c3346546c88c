//! Clicks and control points as text files: somebody writes them down, or a program that shows images or surveys does.

use std::collections::BTreeSet;
use std::path::Path;

use lsfb_geometry::{Vector2, Vector3};
use lsfb_types::Timestamp;

use super::{Click, ControlPoint};
use crate::Error;

/// Such lists are made by hand.
const MAX_BYTES: u64 = 16 << 20;
/// The lines of names, which may be left out.
const CLICK_NAMES: &str = "mark,camera,time_ns,u_px,v_px";
const POINT_NAMES: [&str; 2] = [
    "mark,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m",
    "mark,x_m,y_m,z_m,sigma_m",
];
/// Larger coordinates are of no place on Earth, metres.
const FARTHEST_M: f64 = 1e8;

/// Why a line (from 1) is none.
type BadLine = (usize, String);

/// Reads clicks, one a line: `mark,camera,time_ns,u_px,v_px`, the stamp of the image in nanoseconds and the pixel, whose middle is a whole number. Lines that
/// are empty, begin with `#` or are the line of names are skipped.
pub fn read_clicks(path: &Path) -> Result<Vec<Click>, Error> {
    let clicks = lines(path, &[CLICK_NAMES], parse_click)?;
    clicks.map_err(|(line, reason)| Error::ClickLine {
        path: path.to_owned(),
        line,
        reason,
    })
}

/// Reads control points, one a line: `mark,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m`, or `mark,x_m,y_m,z_m,sigma_m` where the standard deviation is the same along
/// each axis. Lines that are empty, begin with `#` or are the line of names are skipped.
pub fn read_control_points(path: &Path) -> Result<Vec<ControlPoint>, Error> {
    let mut named = BTreeSet::new();
    let points = lines(path, &POINT_NAMES, |columns| {
        let point = parse_point(columns)?;
        match named.insert(point.mark.clone()) {
            true => Ok(point),
            false => Err(format!("{} occurs twice", point.mark)),
        }
    })?;
    points.map_err(|(line, reason)| Error::ControlPointLine {
        path: path.to_owned(),
        line,
        reason,
    })
}

/// Each line of a list, but for those without content and those of names; the outer error is that of the file.
fn lines<T>(
    path: &Path,
    names: &[&str],
    mut parse: impl FnMut(&[&str]) -> Result<T, String>,
) -> Result<Result<Vec<T>, BadLine>, Error> {
    let size = std::fs::metadata(path).map_err(Error::io(path))?.len();
    if size > MAX_BYTES {
        return Ok(Err((
            1,
            format!("{size} bytes are too many for a hand-made list"),
        )));
    }
    let text = std::fs::read_to_string(path).map_err(Error::io(path))?;
    let mut found = Vec::new();
    for (index, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = line.trim();
        let is_names = names.contains(&line.replace(' ', "").as_str());
        if line.is_empty() || line.starts_with('#') || is_names {
            continue;
        }
        let columns: Vec<&str> = line.split(',').map(str::trim).collect();
        match parse(&columns) {
            Ok(one) => found.push(one),
            Err(reason) => return Ok(Err((index + 1, reason))),
        }
    }
    Ok(match found.is_empty() {
        true => Err((
            1,
            format!("the file is empty: expected lines of {}", names[0]),
        )),
        false => Ok(found),
    })
}

/// Names stand in surveys too, whose words are divided by blanks.
fn name(text: &str) -> Result<String, String> {
    match text.is_empty() || text.contains(char::is_whitespace) {
        true => Err(format!(
            "{text:?} is not the name of a mark: it must be one word"
        )),
        false => Ok(text.to_owned()),
    }
}

fn number(text: &str, what: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(format!("{text:?} is not a {what}")),
    }
}

fn parse_click(columns: &[&str]) -> Result<Click, String> {
    let [mark, camera, time_ns, u_px, v_px] = columns else {
        return Err(format!("{} columns, expected {CLICK_NAMES}", columns.len()));
    };
    let mark = name(mark)?;
    let nanos: i64 = time_ns
        .parse()
        .map_err(|_| format!("{time_ns:?} is not a stamp in whole nanoseconds"))?;
    Ok(Click {
        mark,
        camera: (*camera).to_owned(),
        time: Timestamp::from_nanos(nanos),
        pixel: Vector2::new(
            number(u_px, "pixel coordinate")?,
            number(v_px, "pixel coordinate")?,
        ),
    })
}

fn parse_point(columns: &[&str]) -> Result<ControlPoint, String> {
    let (mark, place, sigmas) = match columns {
        [mark, x, y, z, sigma] => (mark, [x, y, z], [sigma; 3]),
        [mark, x, y, z, of_x, of_y, of_z] => (mark, [x, y, z], [of_x, of_y, of_z]),
        _ => {
            return Err(format!(
                "{} columns, expected {} or {}",
                columns.len(),
                POINT_NAMES[0],
                POINT_NAMES[1]
            ));
        }
    };
    let mut point = ControlPoint {
        mark: name(mark)?,
        place_m: Vector3::zeros(),
        sigmas_m: Vector3::zeros(),
    };
    for axis in 0..3 {
        point.place_m[axis] = number(place[axis], "coordinate in metres")?;
        if point.place_m[axis].abs() > FARTHEST_M {
            return Err(format!("{:?} is not a coordinate in metres", place[axis]));
        }
        let sigma_m = number(sigmas[axis], "standard deviation in metres")?;
        if sigma_m <= 0.0 {
            return Err(format!(
                "a standard deviation of {sigma_m} m: it must be above zero"
            ));
        }
        point.sigmas_m[axis] = sigma_m;
    }
    Ok(point)
}
