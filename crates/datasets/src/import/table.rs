//! Tables of text, gzipped or not, line by line: a line that cannot be read is told by its number.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use flate2::read::MultiGzDecoder;
use lsfb_types::StampUnit;

use super::stamp;
use crate::Error;

/// Most bytes of text that one file may unpack to.
const MOST_BYTES: u64 = 4 << 30;
/// Ending of the name of a file that is packed.
const PACKED: &str = ".gz";

/// A file of text.
pub(super) struct Table {
    pub(super) path: PathBuf,
    text: String,
}

/// A line of it that is neither empty nor a comment.
pub(super) struct Row<'a> {
    /// Its number, from 1.
    pub(super) line: usize,
    pub(super) cells: Vec<&'a str>,
}

/// The file of that name in a folder, packed or not.
pub(super) fn find(folder: &Path, name: &str) -> Option<PathBuf> {
    let candidates = [folder.join(name), folder.join(format!("{name}{PACKED}"))];
    candidates.into_iter().find(|path| path.is_file())
}

impl Table {
    /// Reads a file. Bytes that are no UTF-8 are replaced: no number is made of them.
    pub(super) fn read(path: &Path) -> Result<Self, Error> {
        let fail = |source| Error::Io {
            path: path.to_owned(),
            source,
        };
        let file = std::fs::File::open(path).map_err(fail)?;
        let is_packed = path.to_string_lossy().ends_with(PACKED);
        let mut bytes = Vec::new();
        let read = match is_packed {
            true => MultiGzDecoder::new(file)
                .take(MOST_BYTES)
                .read_to_end(&mut bytes),
            false => file.take(MOST_BYTES).read_to_end(&mut bytes),
        };
        let read = read.map_err(fail)?;
        if read as u64 == MOST_BYTES {
            return Err(Error::Recorded {
                path: path.to_owned(),
                problem: format!("more than {} GiB of text", MOST_BYTES >> 30),
            });
        }
        let text = String::from_utf8(bytes)
            .unwrap_or_else(|e| String::from_utf8_lossy(e.as_bytes()).into_owned());
        Ok(Self {
            path: path.to_owned(),
            text,
        })
    }

    /// Name of the file.
    pub(super) fn name(&self) -> String {
        let name = self.path.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    /// All of it.
    pub(super) fn text(&self) -> &str {
        self.text.trim_start_matches('\u{feff}')
    }

    /// Lines that are neither empty nor comments, each split at a character. Blanks around the cells are left out, but between tabs,
    /// where they belong to names.
    pub(super) fn rows(&self, separator: char) -> impl Iterator<Item = Row<'_>> {
        let lines = self.text().lines().enumerate();
        let said = lines.filter(|(_, l)| !l.trim().is_empty() && !l.starts_with('#'));
        said.map(move |(index, line)| Row {
            line: index + 1,
            cells: match separator {
                '\t' => line.split(separator).collect(),
                _ => line.split(separator).map(str::trim).collect(),
            },
        })
    }

    /// Whether the last line has no end: the file may have been cut within it.
    pub(super) fn ends_within_a_line(&self) -> bool {
        !self.text.is_empty() && !self.text.ends_with('\n')
    }
}

/// What a receiver may receive, dBm: where a sign was lost it is another number.
pub(super) fn possible_dbm(value: f64) -> Result<i16, String> {
    match (-200.0..=20.0).contains(&value) {
        true => Ok(value.round() as i16),
        false => Err(format!("{value} dBm is not a plausible received power")),
    }
}

/// A carrier of Wi-Fi, MHz, of one in hertz, kilohertz or megahertz: they lie between 0.7 and 72 GHz.
pub(super) fn possible_mhz(value: f64) -> Result<u32, String> {
    let units = [1.0, 1e3, 1e6].map(|per_mhz| value / per_mhz);
    let found = units
        .into_iter()
        .find(|mhz| (700.0..72_000.0).contains(mhz));
    let found = found.map(|mhz| mhz.round() as u32);
    found.ok_or_else(|| format!("{value} is not a Wi-Fi frequency"))
}

impl Row<'_> {
    /// Fails where the line has not that many cells: what was cut, and two lines run together.
    pub(super) fn expect_cells(
        &self,
        counts: std::ops::RangeInclusive<usize>,
    ) -> Result<(), String> {
        match counts.contains(&self.cells.len()) {
            true => Ok(()),
            false => Err(format!(
                "{} columns instead of {}",
                self.cells.len(),
                counts.start()
            )),
        }
    }

    /// A cell; empty where there is none.
    pub(super) fn text(&self, cell: usize) -> &str {
        self.cells.get(cell).copied().unwrap_or_default()
    }

    /// A number, finite.
    pub(super) fn number(&self, cell: usize) -> Result<f64, String> {
        let text = self.text(cell);
        let value: Option<f64> = text.parse().ok();
        value
            .filter(|v| v.is_finite())
            .ok_or_else(|| format!("`{text}` in column {} is not a number", cell + 1))
    }

    /// Numbers in neighbouring cells.
    pub(super) fn numbers<const N: usize>(&self, from: usize) -> Result<[f64; N], String> {
        let mut numbers = [0.0; N];
        for (n, number) in numbers.iter_mut().enumerate() {
            *number = self.number(from + n)?;
        }
        Ok(numbers)
    }

    /// A whole number of a type.
    pub(super) fn whole<T: std::str::FromStr>(&self, cell: usize) -> Result<T, String> {
        let text = self.text(cell);
        text.parse().map_err(|_| {
            format!(
                "`{text}` in column {} is not a whole number in range",
                cell + 1
            )
        })
    }

    /// A received power, dBm; some apps write it with decimals.
    pub(super) fn dbm(&self, cell: usize) -> Result<i16, String> {
        possible_dbm(self.number(cell)?).map_err(|why| format!("column {}: {why}", cell + 1))
    }

    /// A carrier of Wi-Fi, MHz.
    pub(super) fn mhz(&self, cell: usize) -> Result<u32, String> {
        possible_mhz(self.number(cell)?).map_err(|why| format!("column {}: {why}", cell + 1))
    }

    /// A stamp, nanoseconds.
    pub(super) fn stamp(&self, cell: usize, unit: StampUnit) -> Result<i64, String> {
        stamp::parse(self.text(cell), unit)
    }
}
