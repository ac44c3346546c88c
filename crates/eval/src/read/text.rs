//! The text of a file, gzipped or not, and its rows.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use flate2::read::MultiGzDecoder;

use super::colmap;
use crate::Error;

/// A day at 1 kHz is some 10 GB; a walk is below 1 GiB, and a gzipped bomb is not.
const MAX_TEXT_BYTES: u64 = 1 << 30;

/// Columns of a row that has a stamp and a position.
const LEAST_COLUMNS: usize = 4;

/// A line with something in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line<'a> {
    /// Counted from one.
    pub number: usize,
    /// Without blanks around it.
    pub text: &'a str,
}

/// Lines of data, and those that begin with `#` or `%`.
pub(super) fn lines(text: &str) -> (Vec<Line<'_>>, Vec<Line<'_>>) {
    let all = text.trim_start_matches('\u{feff}').lines().enumerate();
    let all = all.map(|(i, line)| Line {
        number: i + 1,
        text: line.trim(),
    });
    all.filter(|line| !line.text.is_empty())
        .partition(|line| !line.text.starts_with(['#', '%']))
}

/// Numbers with points where a program wrote them with commas, as in many languages: then there are blanks between the columns, or
/// semicolons.
pub(super) fn with_points(text: String) -> String {
    let (rows, _) = lines(&text);
    // The first row may be one of names.
    let Some(row) = rows.get(1).or(rows.first()) else {
        return text;
    };
    let is_column = |column: &str| column.replacen(',', ".", 1).parse::<f64>().is_ok();
    let mut columns: Vec<&str> = row.text.split([';', ' ', '\t']).collect();
    columns.retain(|column| !column.is_empty());
    let is_decimal = row.text.contains(',')
        && columns.len() >= LEAST_COLUMNS
        && columns.into_iter().all(is_column);
    match is_decimal {
        true => text.replace(',', "."),
        false => text,
    }
}

/// The last number of a file that breaks off within it: no line ends there, and it has fewer digits behind the point than that of any other row.
/// Whoever writes rows without an end behind the last one writes numbers alike.
pub(super) fn cut_number<'a>(text: &str, rows: &[Line<'a>]) -> Option<&'a str> {
    let digits = |row: &Line<'a>| -> (&'a str, usize) {
        let number = row.text.rsplit([',', ';', ' ', '\t']).next().unwrap_or("");
        let behind = number.split_once('.').map_or("", |(_, behind)| behind);
        let count = behind.bytes().take_while(u8::is_ascii_digit).count();
        (number, count)
    };
    if text.ends_with(['\n', '\r']) {
        return None;
    }
    let (last, others) = rows.split_last()?;
    let least = others.iter().map(|row| digits(row).1).min()?;
    let (number, count) = digits(last);
    (count < least).then_some(number)
}

/// Whether a file begins like an MCAP file.
pub(super) fn is_mcap(path: &Path) -> Result<bool, Error> {
    let io = |source| Error::Io {
        path: path.to_owned(),
        source,
    };
    let mut head = Vec::new();
    let file = File::open(path).map_err(io)?;
    file.take(5).read_to_end(&mut head).map_err(io)?;
    Ok(head == *b"\x89MCAP")
}

/// The whole text; that of COLMAP's `images.txt` for its `images.bin`.
pub(super) fn read(path: &Path) -> Result<String, Error> {
    let io = |source| Error::Io {
        path: path.to_owned(),
        source,
    };
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(io)?;
    file.take(MAX_TEXT_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(io)?;
    if bytes.starts_with(&[0x1f, 0x8b]) {
        let mut plain = Vec::new();
        MultiGzDecoder::new(bytes.as_slice())
            .take(MAX_TEXT_BYTES + 1)
            .read_to_end(&mut plain)
            .map_err(io)?;
        bytes = plain;
    }
    let refused = |what: String| Error::NotATrajectory {
        path: path.to_owned(),
        what,
    };
    if bytes.len() as u64 > MAX_TEXT_BYTES {
        return Err(refused(format!("more than {MAX_TEXT_BYTES} bytes of text")));
    }
    if colmap::is_binary(path) {
        return colmap::as_text(&bytes).map_err(refused);
    }
    String::from_utf8(bytes).map_err(|e| {
        refused(format!(
            "not text (byte {}); expected {}",
            e.utf8_error().valid_up_to(),
            super::UNDERSTOOD
        ))
    })
}

/// At most forty characters of what a file holds.
pub(super) fn shown(text: &str) -> String {
    text.chars().take(40).collect()
}
