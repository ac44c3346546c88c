//! Of several runs the one that counts.

use super::RunResult;
use crate::slam_bench::plan::{Plan, Scale, Sequence, System};
use crate::slam_bench::table::{Cell, Column, SlamRow, SlamTable};

/// Of several runs the one whose error is the median, of which one without a result has the largest; `None` where more than half of them
/// failed: of a system that crashes twice in three runs the third is no typical one.
pub(in crate::slam_bench) fn median<'a>(
    sequence: &Sequence,
    system: &System,
    results: &'a [RunResult],
) -> Option<&'a RunResult> {
    let error = |r: &RunResult| r.se3_m.or(r.sim3_m).filter(|_| r.cause.is_none());
    let runs = own(sequence, system, results);
    let mut good: Vec<(f64, &RunResult)> = runs.filter_map(|r| Some((error(r)?, r))).collect();
    good.sort_by(|a, b| a.0.total_cmp(&b.0));
    let middle = own(sequence, system, results).count().checked_sub(1)? / 2;
    Some(good.get(middle)?.1)
}

/// The runs of a system on a sequence.
fn own<'a>(
    sequence: &Sequence,
    system: &System,
    results: &'a [RunResult],
) -> impl Iterator<Item = &'a RunResult> {
    results
        .iter()
        .filter(move |r| r.sequence == sequence.name && r.system == system.name)
}

/// What the figures of a system do not say: that some runs failed, and what the judge found odd.
fn remarks(sequence: &Sequence, system: &System, results: &[RunResult]) -> Vec<String> {
    let Some(median) = median(sequence, system, results) else {
        return Vec::new();
    };
    let mut remarks = Vec::from_iter(median.remark.clone());
    let runs = own(sequence, system, results).count();
    let mut failed = own(sequence, system, results).filter_map(|r| r.cause.as_ref());
    if let Some(first) = failed.next() {
        remarks.push(format!(
            "{} of {runs} runs failed: {first}",
            1 + failed.count()
        ));
    }
    remarks
}

/// The table of a plan: the median runs; × where more than half of them failed, with the cause of the first.
pub fn table_of(plan: &Plan, results: &[RunResult]) -> SlamTable {
    let cell = |sequence: &Sequence, system: &System| match median(sequence, system, results) {
        Some(median) => Cell {
            se3_m: median.se3_m,
            scale_percent: median.scale_percent,
            sim3_m: median.sim3_m,
            cause: None,
            remarks: remarks(sequence, system, results),
        },
        None => Cell {
            cause: own(sequence, system, results).find_map(|r| r.cause.clone()),
            ..Cell::default()
        },
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
