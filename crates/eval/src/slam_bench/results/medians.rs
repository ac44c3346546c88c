//! Of several runs the one that counts.

use super::RunResult;
use crate::slam_bench::plan::{Plan, Scale, Sequence, System};
use crate::slam_bench::table::{Cell, Column, SlamRow, SlamTable};

/// Of several runs the one whose error is the median; `None` where all failed.
pub(in crate::slam_bench) fn median<'a>(
    sequence: &Sequence,
    system: &System,
    results: &'a [RunResult],
) -> Option<&'a RunResult> {
    let error = |r: &RunResult| r.se3_m.or(r.sim3_m).filter(|_| r.cause.is_none());
    let own = results
        .iter()
        .filter(|r| r.sequence == sequence.name && r.system == system.name);
    let mut good: Vec<(f64, &RunResult)> = own.filter_map(|r| Some((error(r)?, r))).collect();
    good.sort_by(|a, b| a.0.total_cmp(&b.0));
    let middle = good.len().checked_sub(1)? / 2;
    Some(good.get(middle)?.1)
}

/// The table of a plan: the median runs; × where all failed, with the cause of the first.
pub fn table_of(plan: &Plan, results: &[RunResult]) -> SlamTable {
    let cell = |sequence: &Sequence, system: &System| match median(sequence, system, results) {
        Some(median) => Cell {
            se3_m: median.se3_m,
            scale_percent: median.scale_percent,
            sim3_m: median.sim3_m,
            cause: None,
        },
        None => {
            let mut own = results
                .iter()
                .filter(|r| r.sequence == sequence.name && r.system == system.name);
            Cell {
                cause: own.find_map(|r| r.cause.clone()),
                ..Cell::default()
            }
        }
    };
    let row = |sequence: &Sequence| SlamRow {
        sequence: sequence.name.clone(),
        longer_side_m: sequence.longer_side_m,
        cells: plan
            .systems
            .iter()
            .map(|system| cell(sequence, system))
            .collect(),
    };
    SlamTable {
        title: plan.title.clone(),
        systems: plan
            .systems
            .iter()
            .map(|system| Column {
                name: system.name.clone(),
                has_scale: system.scale == Scale::Metric,
            })
            .collect(),
        rows: plan.sequences.iter().map(row).collect(),
    }
}
