//! What the pages of several steps show alike.

use lsfb_geometry::{Matrix6, Se3};
use lsfb_report::{Normal, arrows, coverage, histogram, scatter};
use maud::{Markup, html};

use crate::angles::PoseNumbers;
use crate::coverage::COVERAGE_CELLS;

/// Errors beyond this leave the plots, pixels.
const LARGEST_SHOWN_PX: f64 = 1.0;
const ERROR_BINS: usize = 40;
/// Where corners were seen in a camera's image, and how they were met.
pub(crate) fn of_corners(
    cells: &[u32],
    cell_errors_px: &[[f64; 2]],
    errors_px: &[[f64; 2]],
    size_px: [u32; 2],
) -> Markup {
    html! {
        div.plots {
            figure {
                (coverage("corners per part of the image", cells, COVERAGE_CELLS, size_px).draw())
                figcaption { "Corners by part of the image: dark where there are many; red parts have none" }
            }
            (mean_errors(cell_errors_px, size_px))
            figure {
                (scatter("reprojection errors", "px", LARGEST_SHOWN_PX, errors_px).draw())
                figcaption { "Reprojection errors within ±" (LARGEST_SHOWN_PX) " px" }
            }
            figure {
                (lengths(errors_px))
                figcaption { "Length of the errors" }
            }
        }
    }
}

/// Mean errors per cell of an image as arrows from the cells' middles, the longest as long as a cell is wide.
pub(crate) fn mean_errors(cell_errors_px: &[[f64; 2]], size_px: [u32; 2]) -> Markup {
    let [columns, rows] = COVERAGE_CELLS;
    let cell = [
        f64::from(size_px[0]) / columns as f64,
        f64::from(size_px[1]) / rows as f64,
    ];
    let lengths = cell_errors_px.iter().map(|e| e[0].hypot(e[1]));
    let longest_px = lengths.fold(0.0, f64::max);
    let middle = |k: usize| {
        [
            ((k % columns) as f64 + 0.5) * cell[0],
            ((k / columns) as f64 + 0.5) * cell[1],
        ]
    };
    let seen = cell_errors_px.iter().enumerate();
    let seen: Vec<_> = seen
        .filter(|(_, e)| **e != [0.0; 2])
        .map(|(k, e)| (middle(k), *e))
        .collect();
    let enlarged = cell[0] / longest_px.max(1e-9);
    html! {
        figure {
            (arrows("mean error per part of the image", &seen, enlarged, size_px).draw())
            figcaption { "Mean error by part of the image, magnified: the longest is " (format!("{longest_px:.2}")) " px" }
        }
    }
}

fn lengths(errors_px: &[[f64; 2]]) -> Markup {
    let mut bins = vec![0.0; ERROR_BINS];
    for [x, y] in errors_px {
        let bin = (x.hypot(*y) / LARGEST_SHOWN_PX * ERROR_BINS as f64) as usize;
        if let Some(count) = bins.get_mut(bin) {
            *count += 1.0;
        }
    }
    let labels = ("error (px)", "corners");
    let span = [0.0, LARGEST_SHOWN_PX];
    histogram(
        "length of the errors",
        labels,
        span,
        &[bins],
        Normal::Unknown,
    )
    .draw()
}

/// Counts in evenly wide bins over `span`, beside what is expected.
pub(crate) fn counts(
    name: &str,
    x_label: &str,
    span: [f64; 2],
    bins: &[u32],
    expected: Normal,
) -> Markup {
    let heights = bins.iter().copied().map(f64::from).collect();
    histogram(name, (x_label, "count"), span, &[heights], expected).draw()
}

/// Rows of a pose: angles in degrees and millimetres with their standard deviations, by the covariance of a right perturbation;
/// `digits` behind the point of angles and of lengths.
pub(crate) fn pose_rows(pose: &Se3, covariance: &Matrix6<f64>, digits: [usize; 2]) -> Markup {
    let numbers = PoseNumbers::of(pose, covariance);
    let angles = numbers.angles;
    let [of_angles, of_lengths] = digits;
    html! {
        @for (k, (name, value)) in angles.names.iter().zip(angles.degrees).enumerate() {
            tr {
                td { (name) ", °" }
                td { (format!("{value:.of_angles$}")) }
                td { (format!("{:.of_angles$}", numbers.angle_sigma_deg[k])) }
            }
        }
        @for (k, name) in ["x", "y", "z"].iter().enumerate() {
            tr {
                td { (name) ", mm" }
                td { (format!("{:.of_lengths$}", pose.translation[k] * 1e3)) }
                td { (format!("{:.*}", of_lengths + 1, numbers.translation_sigma_m[k] * 1e3)) }
            }
        }
        @if let Some(remark) = angles.remark { tr { td.words colspan="3" { (remark) } } }
    }
}
