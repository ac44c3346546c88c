//! Which board: the options that all steps with a board share.

use std::path::PathBuf;

use lsfb_calib::Target;
use lsfb_calib::board::MarkerDictionary;

/// Which board.
#[derive(clap::Args)]
#[group(required = true, multiple = false)]
pub struct BoardArguments {
    /// The board, as a Kalibr target file.
    #[arg(long, value_name = "YAML")]
    target: Option<PathBuf>,
    /// AprilGrid: tags across, tags up, size of a tag in metres, gap between tags as a fraction of the tag size.
    #[arg(long, value_name = "COLS,ROWS,SIZE,SPACING", value_parser = april_grid)]
    april_grid: Option<Target>,
    /// Checkerboard: inner corners across, inner corners down, size of a square in metres.
    #[arg(long, value_name = "COLS,ROWS,SIZE", value_parser = checkerboard)]
    checkerboard: Option<Target>,
    /// ChArUco board: squares across, squares down, sizes of a square and of a marker in metres, bits of a marker (4x4, 5x5,
    /// 6x6).
    #[arg(long, value_name = "COLS,ROWS,SQUARE,MARKER,BITS", value_parser = charuco)]
    charuco: Option<Target>,
}

impl BoardArguments {
    /// The board that was named.
    pub fn target(&self) -> anyhow::Result<Target> {
        if let Some(path) = &self.target {
            return Ok(Target::read_kalibr(path)?);
        }
        let named = self.april_grid.or(self.checkerboard).or(self.charuco);
        named.ok_or_else(|| {
            anyhow::anyhow!("no target: give --target, --april-grid, --checkerboard or --charuco")
        })
    }
}

fn april_grid(text: &str) -> Result<Target, String> {
    let [columns, rows, size, spacing] = words(text, "COLS,ROWS,SIZE,SPACING")?;
    checked(Target::AprilGrid {
        columns: count(columns)?,
        rows: count(rows)?,
        tag_size_m: number(size)?,
        spacing_ratio: number(spacing)?,
    })
}

fn checkerboard(text: &str) -> Result<Target, String> {
    let [columns, rows, size] = words(text, "COLS,ROWS,SIZE")?;
    checked(Target::Checkerboard {
        columns: count(columns)?,
        rows: count(rows)?,
        square_m: number(size)?,
    })
}

fn charuco(text: &str) -> Result<Target, String> {
    let [columns, rows, square, marker, bits] = words(text, "COLS,ROWS,SQUARE,MARKER,BITS")?;
    checked(Target::Charuco {
        columns: count(columns)?,
        rows: count(rows)?,
        square_m: number(square)?,
        marker_m: number(marker)?,
        dictionary: MarkerDictionary::named(bits)
            .ok_or_else(|| format!("{bits}: expected 4x4, 5x5 or 6x6"))?,
    })
}

/// Exactly `N` words between commas.
fn words<'a, const N: usize>(text: &'a str, expected: &str) -> Result<[&'a str; N], String> {
    let words: Vec<&str> = text.split(',').map(str::trim).collect();
    words.try_into().map_err(|_| format!("expected {expected}"))
}

fn count(word: &str) -> Result<u32, String> {
    word.parse().map_err(|_| format!("{word} is not a count"))
}

/// A number, or what is wrong with it.
fn number(word: &str) -> Result<f64, String> {
    word.parse().map_err(|_| format!("{word} is not a number"))
}

/// Nothing that is carried before a camera is longer, metres.
const LONGEST_M: f64 = 10.0;

/// Two lengths in metres, as all lengths on the command line are.
pub fn two_lengths(text: &str) -> Result<[f64; 2], String> {
    let [a, b] = words(text, "two lengths in metres")?;
    Ok([length(a)?, length(b)?])
}

fn length(word: &str) -> Result<f64, String> {
    let metres = number(word)?;
    if metres.abs() <= LONGEST_M {
        return Ok(metres);
    }
    Err(format!(
        "{word} m: lengths are in metres; for {word} mm write {}",
        metres / 1e3
    ))
}

fn checked(target: Target) -> Result<Target, String> {
    let problem = target.problem().map(|problem| problem.to_string());
    problem.map_or(Ok(target), Err)
}
