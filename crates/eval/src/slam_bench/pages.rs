//! A page for each sequence: trajectories in one plane, their errors over time and by size, with what the table leaves out.

use std::path::Path;

use super::plan::{Plan, Sequence, System};
use super::results::{RunResult, judge, median, read_estimate};
use crate::alignment::AlignmentMode;
use crate::report::{Report, Track, View};
use crate::slam_bench::Scale;
use crate::{Contender, Error, Evaluation, ReadOptions, compare, read_trajectory};

/// As many trajectories as have colours of their own.
const MOST_TRACKS: usize = 4;

/// A page with the median run of each system on a sequence, the best ones drawn; `None` where no run gave a result. `out` holds the runs.
pub fn page_of(
    plan: &Plan,
    out: &Path,
    sequence: &Sequence,
    results: &[RunResult],
) -> Result<Option<Report>, Error> {
    let truth = read_trajectory(&sequence.truth, &ReadOptions::default())?;
    let mut judged: Vec<(&System, Evaluation)> = Vec::new();
    for system in &plan.systems {
        let Some(run) = median(sequence, system, results) else {
            continue;
        };
        let estimate = read_estimate(&run.folder(out), run)?;
        // As the table judges it.
        let alignment = match system.scale {
            Scale::Metric => AlignmentMode::Se3,
            Scale::Free => AlignmentMode::Sim3,
        };
        judged.push((system, judge(plan, &truth, &estimate, alignment)?));
    }
    judged.sort_by(|a, b| {
        let rmse = |e: &Evaluation| e.ate_translation_m.rmse;
        rmse(&a.1).total_cmp(&rmse(&b.1))
    });
    if judged.is_empty() {
        return Ok(None);
    }
    let contenders: Vec<Contender<'_>> = judged
        .iter()
        .map(|(system, evaluation)| Contender {
            name: &system.name,
            evaluation,
        })
        .collect();
    let truth = lsfb_geometry::Trajectory::new(truth.poses);
    // The best lies over the others.
    let drawn = judged.iter().take(MOST_TRACKS).rev();
    let tracks = drawn.enumerate().map(|(i, (system, evaluation))| Track {
        // All have the same.
        truth: (i == 0).then(|| truth.clone()),
        ..Track::of(&system.name, evaluation, &truth)
    });
    let title = match judged.len() > MOST_TRACKS {
        true => format!(
            "{}: {}, the best {MOST_TRACKS} drawn",
            plan.title, sequence.name
        ),
        false => format!("{}: {}", plan.title, sequence.name),
    };
    Ok(Some(Report {
        title,
        tracks: tracks.collect(),
        view: View::Widest,
        comparison: compare(&contenders),
        ..Report::default()
    }))
}

#[cfg(test)]
mod tests {
    use lsfb_types::no_progress;

    use super::super::results::run_plan;
    use super::super::results::tests::{CONFIG, setup, system};
    use super::*;

    #[test]
    fn a_page_shows_who_had_a_result() {
        let noisy =
            "awk -v e=$2 '{{ $2 += 0.1 * e * sin(7 * $1); print }}' ../../../../truth.tum > $1";
        let systems = [system("noisy", noisy), system("crash", "exit 7")];
        let (folder, plan) = setup(&systems.concat());
        let out = folder.path().join("out");
        let results = run_plan(&plan, &out, CONFIG, &no_progress).expect("run");
        let page = page_of(&plan, &out, &plan.sequences[0], &results).expect("readable");
        let page = page.expect("one system with a result").to_html();
        for shown in [
            "M0",
            "noisy",
            "Translation error over time",
            "Share of poses by translation error",
        ] {
            assert!(page.contains(shown), "{shown}");
        }
        assert!(!page.contains("crash"));
    }

    /// Where nobody has a result, no page pretends to one.
    #[test]
    fn a_sequence_that_all_failed_has_no_page() {
        let (folder, plan) = setup(&system("crash", "exit 7"));
        let out = folder.path().join("out");
        let results = run_plan(&plan, &out, CONFIG, &no_progress).expect("run");
        let page = page_of(&plan, &out, &plan.sequences[0], &results).expect("readable");
        assert!(page.is_none());
    }
}
