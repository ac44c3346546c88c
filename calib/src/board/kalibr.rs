//! Kalibr's target files: a flat list of `key: value`.

use std::collections::BTreeMap;
use std::path::Path;

use super::{MarkerDictionary, Target};
use crate::Error;

impl Target {
    /// Reads a Kalibr target file (`target_type: 'aprilgrid'` or `'checkerboard'`, square checkers only), or ours of a ChArUco
    /// board (`'charuco'` with `squareCols`, `squareRows`, `squareSize`, `markerSize`, `dictionary`), which Kalibr does not have.
    pub fn read_kalibr(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path).map_err(|source| Error::Io {
            path: path.display().to_string(),
            source,
        })?;
        Self::from_kalibr(&text).map_err(|problem| Error::Parse {
            path: path.display().to_string(),
            problem,
        })
    }

    fn from_kalibr(text: &str) -> Result<Self, String> {
        let mut entries = BTreeMap::new();
        for (number, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            // OpenCV's head is no YAML directive, but many files begin with it.
            if line.is_empty() || line == "---" || line.starts_with('%') {
                continue;
            }
            let (key, value) = line
                .split_once(':')
                .ok_or_else(|| format!("line {}: expected `key: value`", number + 1))?;
            let value = value.trim().trim_matches(['\'', '"']);
            entries.insert(key.trim(), (number + 1, value));
        }
        let get = |key: &str| {
            entries
                .get(key)
                .copied()
                .ok_or_else(|| format!("{key} is missing"))
        };
        let number = |key: &str| {
            let (line, value) = get(key)?;
            value
                .parse::<f64>()
                .map_err(|_| format!("line {line}: {key} is {value}, not a number"))
        };
        let count = |key: &str| {
            let (line, value) = get(key)?;
            value
                .parse::<u32>()
                .map_err(|_| format!("line {line}: {key} is {value}, not a count"))
        };
        let target = match get("target_type")? {
            (_, "aprilgrid") => Target::AprilGrid {
                columns: count("tagCols")?,
                rows: count("tagRows")?,
                tag_size_m: number("tagSize")?,
                spacing_ratio: number("tagSpacing")?,
            },
            (_, "checkerboard") => {
                let square_m = number("rowSpacingMeters")?;
                if number("colSpacingMeters")? != square_m {
                    return Err("rowSpacingMeters differs from colSpacingMeters: only square checkers are supported".into());
                }
                Target::Checkerboard {
                    columns: count("targetCols")?,
                    rows: count("targetRows")?,
                    square_m,
                }
            }
            (_, "charuco") => {
                let (line, name) = get("dictionary")?;
                Target::Charuco {
                    columns: count("squareCols")?,
                    rows: count("squareRows")?,
                    square_m: number("squareSize")?,
                    marker_m: number("markerSize")?,
                    dictionary: MarkerDictionary::named(name).ok_or_else(|| {
                        format!("line {line}: dictionary is {name}, expected 4x4, 5x5 or 6x6")
                    })?,
                }
            }
            (line, other) => {
                return Err(format!(
                    "line {line}: target_type is {other}, expected aprilgrid, checkerboard or charuco"
                ));
            }
        };
        // A key that is not understood may say that the board is another one.
        let known: &[&str] = match target {
            Target::AprilGrid { .. } => &["tagCols", "tagRows", "tagSize", "tagSpacing"],
            Target::Checkerboard { .. } => &[
                "targetCols",
                "targetRows",
                "rowSpacingMeters",
                "colSpacingMeters",
            ],
            Target::Charuco { .. } => &[
                "squareCols",
                "squareRows",
                "squareSize",
                "markerSize",
                "dictionary",
            ],
        };
        let unknown = entries
            .iter()
            .find(|(key, _)| **key != "target_type" && !known.contains(key));
        if let Some((key, (line, _))) = unknown {
            return Err(format!(
                "line {line}: {key} is unknown; expected target_type, {}",
                known.join(", ")
            ));
        }
        let problem = target.problem().map(|problem| problem.to_string());
        problem.map_or(Ok(target), Err)
    }

    /// The Kalibr target file.
    pub fn to_kalibr(&self) -> String {
        match *self {
            Target::AprilGrid {
                columns,
                rows,
                tag_size_m,
                spacing_ratio,
            } => format!(
                "target_type: 'aprilgrid'\ntagCols: {columns}\ntagRows: {rows}\ntagSize: {tag_size_m}\ntagSpacing: {spacing_ratio}\n"
            ),
            Target::Checkerboard {
                columns,
                rows,
                square_m,
            } => format!(
                "target_type: 'checkerboard'\ntargetCols: {columns}\ntargetRows: {rows}\nrowSpacingMeters: {square_m}\ncolSpacingMeters: {square_m}\n"
            ),
            Target::Charuco {
                columns,
                rows,
                square_m,
                marker_m,
                dictionary,
            } => format!(
                "target_type: 'charuco'\nsquareCols: {columns}\nsquareRows: {rows}\nsquareSize: {square_m}\nmarkerSize: {marker_m}\ndictionary: {}\n",
                dictionary.name()
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kalibr_files_round_trip_and_errors_name_the_line() {
        let grid = Target::AprilGrid {
            columns: 6,
            rows: 6,
            tag_size_m: 0.088,
            spacing_ratio: 0.3,
        };
        let board = Target::Checkerboard {
            columns: 9,
            rows: 6,
            square_m: 0.025,
        };
        let charuco = Target::Charuco {
            columns: 11,
            rows: 8,
            square_m: 0.03,
            marker_m: 0.022,
            dictionary: MarkerDictionary::Aruco5x5,
        };
        for target in [grid, board, charuco] {
            assert_eq!(Target::from_kalibr(&target.to_kalibr()), Ok(target));
            let opencv = format!("%YAML:1.0\n---\n{}", target.to_kalibr());
            assert_eq!(Target::from_kalibr(&opencv), Ok(target));
        }
        for (text, problem) in [
            (
                "target_type: 'circlegrid'",
                "line 1: target_type is circlegrid",
            ),
            (
                "target_type: 'aprilgrid'\ntagCols: six",
                "line 2: tagCols is six",
            ),
            ("target_type: 'aprilgrid'\ntagCols: 6", "tagRows is missing"),
            (
                "target_type: charuco\ndictionary: 7x7\nsquareCols: 5\nsquareRows: 5\nsquareSize: 1\nmarkerSize: 0.7",
                "line 2: dictionary is 7x7",
            ),
            ("nonsense", "line 1: expected"),
            (
                "target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\ntagFamily: tag25h9",
                "line 6: tagFamily is unknown",
            ),
            (
                "target_type: aprilgrid # mine\ntagCols: 60\ntagRows: 60\ntagSize: 1\ntagSpacing: 0.3",
                "60 × 60 tags",
            ),
        ] {
            let error = Target::from_kalibr(text).expect_err(text);
            assert!(error.starts_with(problem), "{error}");
        }
    }
}
