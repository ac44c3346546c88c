//! Compressed tables of numbers.

use std::io::Read as _;
use std::path::Path;

/// Lines of a packed text file.
pub fn lines(path: &Path) -> Vec<String> {
    let packed = std::fs::File::open(path).expect("a file");
    let mut text = String::new();
    flate2::read::GzDecoder::new(packed)
        .read_to_string(&mut text)
        .expect("text");
    text.lines().map(str::to_owned).collect()
}

/// Rows of numbers; lines that begin with `#` are left out.
pub fn rows(path: &Path) -> Vec<Vec<f64>> {
    let all = lines(path);
    let rows = all.iter().filter(|line| !line.starts_with('#'));
    rows.map(|line| line.split(',').map(number).collect())
        .collect()
}

/// First column of a table as whole nanoseconds, which a double does not hold.
pub fn nanos(path: &Path, column: usize) -> Vec<i64> {
    let all = lines(path);
    let rows = all.iter().filter(|line| !line.starts_with('#'));
    let word = |line: &String| {
        line.split(',')
            .nth(column)
            .expect("a column")
            .trim()
            .to_owned()
    };
    rows.map(|line| word(line).parse().expect("nanoseconds"))
        .collect()
}

pub fn number(word: &str) -> f64 {
    word.trim().parse().expect("a number")
}
