//! The board on paper: a PDF whose user units are true to scale.

use std::fmt::Write as _;

use super::{Target, charuco_square, tag_cells};
use crate::{Error, TargetProblem};

/// Points of a PDF per metre.
const POINTS_PER_M: f64 = 72.0 / 0.0254;
/// Largest page of a PDF, points.
const MAX_POINTS: f64 = 14_400.0;

/// How large the paper is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PageSize {
    /// Width, metres.
    pub width_m: f64,
    /// Height, metres.
    pub height_m: f64,
}

impl Target {
    /// Size of the printed pattern, metres: with the outer squares.
    pub fn printed_size(&self) -> PageSize {
        match *self {
            Target::AprilGrid {
                columns,
                rows,
                tag_size_m,
                spacing_ratio,
            } => {
                let gap = tag_size_m * spacing_ratio;
                let length = |n: u32| f64::from(n) * (tag_size_m + gap) + gap;
                PageSize {
                    width_m: length(columns),
                    height_m: length(rows),
                }
            }
            Target::Checkerboard {
                columns,
                rows,
                square_m,
            } => PageSize {
                width_m: f64::from(columns + 1) * square_m,
                height_m: f64::from(rows + 1) * square_m,
            },
            Target::Charuco {
                columns,
                rows,
                square_m,
                ..
            } => PageSize {
                width_m: f64::from(columns) * square_m,
                height_m: f64::from(rows) * square_m,
            },
        }
    }

    /// The board as a PDF of the size `page`, centred, with a ruler of 100 mm to check the printer by.
    pub fn to_pdf(&self, page: PageSize) -> Result<Vec<u8>, Error> {
        if let Some(problem) = self.problem() {
            return Err(problem.into());
        }
        let size = self.printed_size();
        let (width, height) = (page.width_m * POINTS_PER_M, page.height_m * POINTS_PER_M);
        if !(width > 0.0 && height > 0.0 && width.max(height) <= MAX_POINTS) {
            let problem = TargetProblem::Page {
                page_m: [page.width_m, page.height_m],
                most_m: MAX_POINTS / POINTS_PER_M,
            };
            return Err(problem.into());
        }
        if size.width_m > page.width_m || size.height_m > page.height_m {
            let problem = TargetProblem::LargePattern {
                pattern_m: [size.width_m, size.height_m],
                page_m: [page.width_m, page.height_m],
            };
            return Err(problem.into());
        }
        let mut drawing = String::from("0 g\n");
        let left = 0.5 * (page.width_m - size.width_m);
        let bottom = 0.5 * (page.height_m - size.height_m);
        for [x, y, w, h] in self.black_rectangles() {
            // Infallible on a String.
            let _ = writeln!(
                drawing,
                "{:.5} {:.5} {:.5} {:.5} re",
                (left + x) * POINTS_PER_M,
                (bottom + y) * POINTS_PER_M,
                w * POINTS_PER_M,
                h * POINTS_PER_M
            );
        }
        drawing.push_str("f\n");
        if bottom > 0.008 && page.width_m > 0.11 {
            let _ = writeln!(
                drawing,
                "0.5 w {x0:.5} 14 m {x1:.5} 14 l {x0:.5} 10 m {x0:.5} 18 l {x1:.5} 10 m {x1:.5} 18 l S",
                x0 = 0.005 * POINTS_PER_M,
                x1 = 0.105 * POINTS_PER_M
            );
            let _ = writeln!(
                drawing,
                "BT /F1 6 Tf {:.5} 6 Td (the line is 100 mm long: print without scaling) Tj ET",
                0.107 * POINTS_PER_M
            );
        }
        Ok(document(width, height, &drawing))
    }

    /// Left, bottom, width, height of what is black, metres from the pattern's lower left.
    fn black_rectangles(&self) -> Vec<[f64; 4]> {
        let mut out = Vec::new();
        match *self {
            Target::AprilGrid {
                columns,
                rows,
                tag_size_m,
                spacing_ratio,
            } => {
                let gap = tag_size_m * spacing_ratio;
                let pitch = tag_size_m + gap;
                for row in 0..=rows {
                    for column in 0..=columns {
                        out.push([f64::from(column) * pitch, f64::from(row) * pitch, gap, gap]);
                    }
                }
                for row in 0..rows {
                    for column in 0..columns {
                        let cells = tag_cells((row * columns + column) as usize);
                        let cell = tag_size_m / cells.len() as f64;
                        let (x, y) = (
                            gap + f64::from(column) * pitch,
                            gap + f64::from(row) * pitch,
                        );
                        for (j, line) in cells.iter().enumerate() {
                            let low = tag_size_m - (j + 1) as f64 * cell;
                            for (i, white) in line.iter().enumerate() {
                                if !white {
                                    out.push([x + i as f64 * cell, y + low, cell, cell]);
                                }
                            }
                        }
                    }
                }
            }
            Target::Checkerboard {
                columns,
                rows,
                square_m,
            } => {
                out = black_squares(columns + 1, rows + 1, square_m);
            }
            Target::Charuco {
                columns,
                rows,
                square_m,
                marker_m,
                dictionary,
            } => {
                out = black_squares(columns, rows, square_m);
                let margin = 0.5 * (square_m - marker_m);
                let bits = dictionary.edge_bits();
                let cell = marker_m / (bits + 2) as f64;
                for marker in 0..(columns * rows / 2) as usize {
                    let (column, row) = charuco_square(marker, columns as usize);
                    let left = f64::from(column) * square_m + margin;
                    let top = (f64::from(rows) - f64::from(row)) * square_m - margin;
                    for j in 0..bits + 2 {
                        for i in 0..bits + 2 {
                            let is_code = (1..=bits).contains(&i) && (1..=bits).contains(&j);
                            if !(is_code && dictionary.is_white(marker, i - 1, j - 1)) {
                                let low = top - (j + 1) as f64 * cell;
                                out.push([left + i as f64 * cell, low, cell, cell]);
                            }
                        }
                    }
                }
            }
        }
        out
    }
}

/// The black squares of a board, the upper left one among them.
fn black_squares(columns: u32, rows: u32, square_m: f64) -> Vec<[f64; 4]> {
    (0..rows)
        .flat_map(|row| (0..columns).map(move |column| (column, row)))
        .filter(|(column, row)| (row + column) % 2 == 0)
        .map(|(column, row)| {
            let y = f64::from(rows - 1 - row) * square_m;
            [f64::from(column) * square_m, y, square_m, square_m]
        })
        .collect()
}

fn document(width: f64, height: f64, drawing: &str) -> Vec<u8> {
    let objects = [
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>".to_owned(),
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>".to_owned(),
        format!(
            "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.5} {height:.5}] /Contents 4 0 R /Resources << /Font << /F1 5 0 R >> >> >>"
        ),
        format!(
            "<< /Length {} >>\nstream\n{drawing}endstream",
            drawing.len()
        ),
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>".to_owned(),
    ];
    let mut text = String::from("%PDF-1.6\n");
    let mut table = format!("xref\n0 {}\n0000000000 65535 f \n", objects.len() + 1);
    for (k, object) in objects.iter().enumerate() {
        // Infallible on a String.
        let _ = writeln!(table, "{:010} 00000 n ", text.len());
        let _ = write!(text, "{} 0 obj\n{object}\nendobj\n", k + 1);
    }
    let start = text.len();
    let _ = write!(
        text,
        "{table}trailer\n<< /Size {} /Root 1 0 R >>\nstartxref\n{start}\n%%EOF\n",
        objects.len() + 1
    );
    text.into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_areas_have_their_true_size() {
        let board = Target::Checkerboard {
            columns: 9,
            rows: 6,
            square_m: 0.025,
        };
        let pdf = board
            .to_pdf(PageSize {
                width_m: 0.297,
                height_m: 0.21,
            })
            .expect("A4");
        let text = String::from_utf8(pdf).expect("ASCII");
        let rectangles: Vec<Vec<f64>> = text
            .lines()
            .filter_map(|l| l.strip_suffix(" re"))
            .map(|l| l.split(' ').map(|n| n.parse().expect("a number")).collect())
            .collect();
        assert_eq!(rectangles.len(), 35);
        for r in &rectangles {
            assert!((r[2] / 72.0 * 25.4 - 25.0).abs() < 1e-5 && r[2] == r[3]);
        }
        assert!(text.contains("/MediaBox [0 0 841.88976 595.27559]"));
        let start: usize = text
            .rsplit("startxref\n")
            .next()
            .and_then(|t| t.lines().next())
            .and_then(|n| n.parse().ok())
            .expect("an offset");
        assert!(text[start..].starts_with("xref"));
        let small = PageSize {
            width_m: 0.1,
            height_m: 0.1,
        };
        let error = board.to_pdf(small).expect_err("too small").to_string();
        assert!(error.contains("250 × 175 mm"), "{error}");
    }
}
