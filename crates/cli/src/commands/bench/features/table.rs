//! The table: a feature a row.

use std::fmt::Write as _;

use lsfb_report::{Page, scroll};
use maud::{Markup, html};
use serde::Serialize;

use super::scores::PlanarScore;

/// A feature in figures.
#[derive(Serialize)]
pub struct Row {
    pub feature: String,
    /// Features of an image, mean.
    pub features_per_image: f64,
    /// Over all pairs with a homography; `None` where there are none.
    pub homographies: Option<Planar>,
    /// The same for what sets the second image apart.
    pub by_kind: Vec<(&'static str, Planar)>,
    /// Over all pairs with a motion, places together; `None` where there are none.
    pub poses: Option<Posed>,
    /// The same for each place.
    pub by_place: Vec<(String, Posed)>,
    /// CPU time of an image on one thread, median.
    pub cpu_ms_per_image: Option<f64>,
    /// Numbers of a descriptor as published, and bytes in our maps.
    pub values_per_descriptor: usize,
    pub bytes_per_descriptor: usize,
}

/// Pairs with a homography.
#[derive(Clone, Copy, Serialize)]
pub struct Planar {
    pub pairs: usize,
    /// Share of the keypoints, where the images overlap, with one of the other image within 1 and 3 px; `None` where there are none.
    pub repeatability: Option<[f64; 2]>,
    /// Share of mutual nearest neighbours within 1 and 3 px, mean over the pairs.
    pub matching_accuracy: [f64; 2],
    /// Matches within 3 px, mean over the pairs.
    pub right_matches: f64,
}

/// Pairs with a motion.
#[derive(Clone, Copy, Serialize)]
pub struct Posed {
    pub pairs: usize,
    /// Area below the curve of recall up to 5°, 10° and 20°, of matches as the toolkit makes them.
    pub auc: [f64; 3],
    /// Of mutual nearest neighbours alone.
    pub auc_mutual: [f64; 3],
    /// Matches of a pair, as the toolkit makes them, mean.
    pub matches: f64,
}

impl Planar {
    /// Means over pairs; `None` of none.
    pub fn mean(scores: &[PlanarScore]) -> Option<Self> {
        let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let of_all = |value: &dyn Fn(&PlanarScore) -> f64| mean(scores.iter().map(value).collect());
        let repeated: Vec<[f64; 2]> = scores.iter().filter_map(|s| s.repeatability).collect();
        let repeatability = [0, 1].map(|k| mean(repeated.iter().map(|r| r[k]).collect()));
        (!scores.is_empty()).then(|| Self {
            pairs: scores.len(),
            repeatability: (!repeated.is_empty()).then_some(repeatability),
            matching_accuracy: [0, 1].map(|k| of_all(&|s| s.accuracy[k])),
            right_matches: of_all(&|s| s.right as f64),
        })
    }
}

const HEADS: [&str; 13] = [
    "feature",
    "found",
    "rep. 1 px",
    "rep. 3 px",
    "MMA 1 px",
    "MMA 3 px",
    "right",
    "AUC 5°",
    "AUC 10°",
    "AUC 20°",
    "matches",
    "CPU ms",
    "bytes",
];

impl Row {
    /// As in the table; percentages but for counts, milliseconds and bytes.
    fn cells(&self) -> Vec<String> {
        let mut cells = vec![
            self.feature.clone(),
            format!("{:.0}", self.features_per_image),
        ];
        cells.extend(planar_cells(self.homographies.as_ref()));
        cells.extend(posed_cells(self.poses.as_ref()));
        cells.push(
            self.cpu_ms_per_image
                .map_or("–".to_owned(), |ms| format!("{ms:.0}")),
        );
        cells.push(self.bytes_per_descriptor.to_string());
        cells
    }
}

fn percent(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

fn planar_cells(planar: Option<&Planar>) -> Vec<String> {
    let Some(p) = planar else {
        return vec!["–".to_owned(); 5];
    };
    let none = ["–", "–"].map(str::to_owned);
    let mut cells = p.repeatability.map_or(none, |r| r.map(percent)).to_vec();
    cells.extend(p.matching_accuracy.map(percent));
    cells.push(format!("{:.0}", p.right_matches));
    cells
}

fn posed_cells(posed: Option<&Posed>) -> Vec<String> {
    let Some(p) = posed else {
        return vec!["–".to_owned(); 4];
    };
    let mut cells: Vec<String> = p.auc.into_iter().map(percent).collect();
    cells.push(format!("{:.0}", p.matches));
    cells
}

/// For the terminal.
pub fn text(rows: &[Row], about: &str) -> String {
    let mut text = format!("{about}\n");
    let mut line = |cells: &[String]| {
        let _ = write!(text, "{:<18}", cells[0]);
        for cell in &cells[1..] {
            let _ = write!(text, "{cell:>10}");
        }
        text.push('\n');
    };
    line(&HEADS.map(str::to_owned));
    for row in rows {
        line(&row.cells());
    }
    text.trim_end().to_owned()
}

/// The page.
pub fn page(rows: &[Row], about: &str) -> Page {
    Page::new("Comparison of features").body(html! {
        p { (about) }
        p.note {
            "Repeatability: share of keypoints with a keypoint of the other image within the \
             limit. MMA: share of mutual nearest neighbours within the limit. AUC: area under \
             the recall curve over the larger of rotation and direction error, for matches as \
             used for maps; behind the slash, for mutual nearest neighbours only. In per cent, \
             except counts, milliseconds and bytes."
        }
        section { h2 { "All pairs" } (scroll(&table(&HEADS, rows.iter().map(Row::cells)))) }
        section { h2 { "By image change" } (scroll(&by_kind(rows))) }
        section { h2 { "By place" } (scroll(&by_place(rows))) }
    })
}

fn table(heads: &[&str], rows: impl Iterator<Item = Vec<String>>) -> Markup {
    html! {
        table.numbers {
            thead { tr { @for head in heads { th { (head) } } } }
            tbody { @for row in rows { tr { @for cell in row { td { (cell) } } } } }
        }
    }
}

fn by_kind(rows: &[Row]) -> Markup {
    let heads = [
        "feature",
        "pairs",
        "rep. 1 px",
        "rep. 3 px",
        "MMA 1 px",
        "MMA 3 px",
        "right",
    ];
    let lines = rows.iter().flat_map(|row| {
        row.by_kind.iter().map(|(kind, planar)| {
            [
                vec![row.feature.clone(), (*kind).to_owned()],
                planar_cells(Some(planar)),
            ]
            .concat()
        })
    });
    table(&heads, lines)
}

fn by_place(rows: &[Row]) -> Markup {
    let heads = ["feature", "place", "pairs", "AUC 5°", "AUC 10°", "AUC 20°"];
    let lines = rows.iter().flat_map(|row| {
        row.by_place.iter().map(|(place, posed)| {
            let mut cells = vec![row.feature.clone(), place.clone(), posed.pairs.to_string()];
            let both = posed.auc.iter().zip(posed.auc_mutual);
            cells.extend(both.map(|(a, b)| format!("{} / {}", percent(*a), percent(b))));
            cells
        })
    });
    table(&heads, lines)
}
