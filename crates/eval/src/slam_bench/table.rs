//! The rules of Tables VIII and IX: what is grey, what is bold, what is counted.

use serde::Serialize;

use super::cause::Cause;

/// An error above this share of the longer side of the place is grey, and so is a scale error above it.
const UNRELIABLE: f64 = 0.1;

/// Figures of one system on one sequence, metres and per cent; all absent where most runs failed.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Cell {
    /// Root mean square error after SE(3) alignment; absent for systems without scale.
    pub se3_m: Option<f64>,
    /// 100 · |1 − s| of the Sim(3) alignment; absent for systems without scale.
    pub scale_percent: Option<f64>,
    /// Root mean square error after Sim(3) alignment.
    pub sim3_m: Option<f64>,
    /// Why there are none.
    pub cause: Option<Cause>,
    /// What the figures do not say.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
}

/// One sequence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SlamRow {
    /// Its name.
    pub sequence: String,
    /// Longer side of the place, metres.
    pub longer_side_m: f64,
    /// In the order of the systems.
    pub cells: Vec<Cell>,
}

/// A system's name, and whether it knows the scale.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Column {
    /// As the table calls it.
    pub name: String,
    /// Whether the table has SE(3) and the scale error for it.
    pub has_scale: bool,
}

/// Systems on sequences.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SlamTable {
    /// What it is about.
    pub title: String,
    /// The systems.
    pub systems: Vec<Column>,
    /// The sequences.
    pub rows: Vec<SlamRow>,
}

/// What a figure measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Metric {
    /// Error after SE(3) alignment.
    Se3,
    /// Scale error.
    Scale,
    /// Error after Sim(3) alignment.
    Sim3,
}

/// A figure as it stands in the table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// Metres, per cent for [`Metric::Scale`]; absent where most runs failed: ×.
    pub value: Option<f64>,
    /// Not to be relied on.
    pub is_grey: bool,
    /// The best of its sequence.
    pub is_bold: bool,
}

/// Counts of one column of errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ColumnCount {
    /// Index of the system.
    pub system: usize,
    /// [`Metric::Se3`] or [`Metric::Sim3`].
    pub metric: Metric,
    /// Sequences on which it succeeded.
    pub succeeded: usize,
    /// Sequences on which it is the best.
    pub best: usize,
    /// No other column of this metric succeeded more often.
    pub is_most_robust: bool,
    /// No other column of this metric is the best more often.
    pub is_most_accurate: bool,
}

/// A table with its marks.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MarkedTable {
    /// What it is about.
    pub title: String,
    /// System and metric of each column.
    pub columns: Vec<(usize, Metric)>,
    /// The systems.
    pub systems: Vec<Column>,
    /// Name of the sequence and its figures, in the order of the columns.
    pub rows: Vec<(String, Vec<Figure>)>,
    /// Counts of the columns of errors.
    pub counts: Vec<ColumnCount>,
    /// Sequence, system and why most runs failed.
    pub failures: Vec<(String, String, Cause)>,
    /// Sequence, system and what their figures do not say.
    pub remarks: Vec<(String, String, String)>,
}

impl SlamTable {
    /// Applies the rules.
    pub fn marked(&self) -> MarkedTable {
        let columns: Vec<(usize, Metric)> = self
            .systems
            .iter()
            .enumerate()
            .flat_map(|(i, system)| {
                let metrics: &[Metric] = match system.has_scale {
                    true => &[Metric::Se3, Metric::Scale, Metric::Sim3],
                    false => &[Metric::Sim3],
                };
                metrics.iter().map(move |metric| (i, *metric))
            })
            .collect();
        let rows: Vec<(String, Vec<Figure>)> = self
            .rows
            .iter()
            .map(|row| (row.sequence.clone(), figures(row, &columns)))
            .collect();
        let failure = |row: &SlamRow| {
            let cells = row.cells.iter().zip(&self.systems);
            let causes = cells.filter_map(|(cell, system)| {
                Some((
                    row.sequence.clone(),
                    system.name.clone(),
                    cell.cause.clone()?,
                ))
            });
            causes.collect::<Vec<_>>()
        };
        let remark = |row: &SlamRow| {
            let cells = row.cells.iter().zip(&self.systems);
            let of_cell = |(cell, system): (&Cell, &Column)| {
                let place = (row.sequence.clone(), system.name.clone());
                let remarks = cell.remarks.iter().cloned();
                remarks
                    .map(|remark| (place.0.clone(), place.1.clone(), remark))
                    .collect::<Vec<_>>()
            };
            cells.flat_map(of_cell).collect::<Vec<_>>()
        };
        MarkedTable {
            remarks: self.rows.iter().flat_map(remark).collect(),
            title: self.title.clone(),
            systems: self.systems.clone(),
            counts: counts(&columns, &rows),
            failures: self.rows.iter().flat_map(failure).collect(),
            columns,
            rows,
        }
    }
}

fn figures(row: &SlamRow, columns: &[(usize, Metric)]) -> Vec<Figure> {
    let largest_m = UNRELIABLE * row.longer_side_m;
    let mut figures: Vec<Figure> = columns
        .iter()
        .map(|(system, metric)| {
            let cell = row.cells.get(*system).cloned().unwrap_or_default();
            // Without a scale error nothing says that metres are metres.
            let is_scaled = cell.scale_percent.is_some_and(|s| s <= 100.0 * UNRELIABLE);
            let (value, is_good) = match metric {
                Metric::Se3 => (
                    cell.se3_m,
                    is_scaled && cell.se3_m.is_some_and(|m| m <= largest_m),
                ),
                Metric::Scale => (cell.scale_percent, is_scaled),
                Metric::Sim3 => (cell.sim3_m, cell.sim3_m.is_some_and(|m| m <= largest_m)),
            };
            Figure {
                value: value.filter(|v| v.is_finite()),
                is_grey: !is_good,
                is_bold: false,
            }
        })
        .collect();
    for metric in [Metric::Se3, Metric::Sim3] {
        let of_metric = |i: &usize| columns[*i].1 == metric;
        let good = (0..figures.len())
            .filter(of_metric)
            .filter(|i| !figures[*i].is_grey);
        let best = good.filter_map(|i| figures[i].value).min_by(f64::total_cmp);
        for i in (0..figures.len()).filter(of_metric) {
            figures[i].is_bold = !figures[i].is_grey && best.is_some() && figures[i].value == best;
        }
    }
    figures
}

fn counts(columns: &[(usize, Metric)], rows: &[(String, Vec<Figure>)]) -> Vec<ColumnCount> {
    let count = |i: usize, wanted: fn(&Figure) -> bool| {
        rows.iter()
            .filter(|(_, figures)| wanted(&figures[i]))
            .count()
    };
    let mut counts: Vec<ColumnCount> = columns
        .iter()
        .enumerate()
        .filter(|(_, (_, metric))| *metric != Metric::Scale)
        .map(|(i, (system, metric))| ColumnCount {
            system: *system,
            metric: *metric,
            succeeded: count(i, |f| !f.is_grey),
            best: count(i, |f| f.is_bold),
            is_most_robust: false,
            is_most_accurate: false,
        })
        .collect();
    for metric in [Metric::Se3, Metric::Sim3] {
        let most = |of: fn(&ColumnCount) -> usize| {
            counts
                .iter()
                .filter(|c| c.metric == metric)
                .map(of)
                .max()
                .unwrap_or(0)
        };
        let (succeeded, best) = (most(|c| c.succeeded), most(|c| c.best));
        for count in counts.iter_mut().filter(|c| c.metric == metric) {
            count.is_most_robust = count.succeeded == succeeded && succeeded > 0;
            count.is_most_accurate = count.best == best && best > 0;
        }
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(cells: Vec<Cell>) -> MarkedTable {
        let systems = cells.iter().enumerate().map(|(i, _)| Column {
            name: format!("s{i}"),
            has_scale: true,
        });
        SlamTable {
            title: "t".to_owned(),
            systems: systems.collect(),
            rows: vec![SlamRow {
                sequence: "A".to_owned(),
                longer_side_m: 20.0,
                cells,
            }],
        }
        .marked()
    }

    fn cell(se3_m: f64, scale_percent: f64, sim3_m: f64) -> Cell {
        Cell {
            se3_m: Some(se3_m),
            scale_percent: Some(scale_percent),
            sim3_m: Some(sim3_m),
            ..Cell::default()
        }
    }

    /// The smallest SE(3) error with a wrong scale: the naive best is a system whose metres are none.
    #[test]
    fn a_wrong_scale_makes_se3_grey_and_not_sim3() {
        let marked = table(vec![cell(0.1, 12.0, 0.05), cell(0.3, 3.0, 0.2)]);
        let marks: Vec<(bool, bool)> = marked.rows[0]
            .1
            .iter()
            .map(|f| (f.is_grey, f.is_bold))
            .collect();
        assert_eq!(
            marks,
            [
                (true, false),
                (true, false),
                (false, true),
                (false, true),
                (false, false),
                (false, false)
            ]
        );
    }

    #[test]
    fn what_failed_is_never_best() {
        let failed = Cell {
            cause: Some(Cause::NeverInitialised),
            ..Cell::default()
        };
        let nan = cell(f64::NAN, f64::NAN, f64::NAN);
        let marked = table(vec![failed, nan, cell(2.1, 0.0, 2.0)]);
        let figures = &marked.rows[0].1;
        assert!(
            figures[..6]
                .iter()
                .all(|f| f.value.is_none() && f.is_grey && !f.is_bold)
        );
        assert!(figures[6].is_grey && !figures[8].is_grey && figures[8].is_bold);
        assert_eq!(marked.failures.len(), 1);
        assert!(
            table(vec![Cell::default()])
                .counts
                .iter()
                .all(|c| !c.is_most_robust)
        );
    }
}
