//! Whether the errors at the marks are those of the trajectory.

use lsfb_types::{Finding, Limit, Verdict};

use super::MarkReport;

/// Share of the visits that must be found: with fewer the errors are of a part of the walk that happens to fit.
const LEAST_FOUND: f64 = 0.5;
/// Marks that errors must be made of: the alignment chooses six of the three numbers of each.
const LEAST_MARKS: usize = 5;

impl MarkReport {
    /// What a reader should know of the errors.
    pub fn findings(&self) -> Vec<Finding> {
        let mut findings = vec![self.completeness()];
        findings.extend(self.few());
        findings.extend(self.off());
        findings
    }

    fn completeness(&self) -> Finding {
        let (found, missing) = (self.marks.len(), self.missing.len());
        let share = found as f64 / (found + missing).max(1) as f64;
        let verdict = match share {
            share if share < LEAST_FOUND => Verdict::Fail,
            _ => Verdict::Warn.unless(self.missing.is_empty()),
        };
        let what = match self.missing.is_empty() {
            true => format!("a rest at each of {found} marks"),
            false => format!(
                "no rest found at {missing} of {} marks: {}",
                found + missing,
                self.missing.join(", ")
            ),
        };
        let finding = Finding::new("marks", verdict, "trajectory", what)
            .value(100.0 * share, "%")
            .limit(Limit::AtLeast(100.0 * LEAST_FOUND));
        match self.missing.is_empty() {
            true => finding,
            false => finding.remedy("these marks are not in the errors: rest on each for two seconds, and list those that were visited (visit A B …)"),
        }
    }

    fn few(&self) -> Option<Finding> {
        let found = self.marks.len();
        (found < LEAST_MARKS).then(|| {
            let what = format!(
                "only {found} marks: six of their {} numbers went into the alignment, and the rest says little about the trajectory",
                3 * found
            );
            // Three have nothing left but chance, four hardly more.
            let verdict = match found < LEAST_MARKS - 1 {
                true => Verdict::Fail,
                false => Verdict::Warn,
            };
            Finding::new("few-marks", verdict, "trajectory", what)
                .value(found as f64, "")
                .limit(Limit::AtLeast(LEAST_MARKS as f64))
                .remedy("measure more marks, and rest on each")
        })
    }

    fn off(&self) -> Option<Finding> {
        let worst = self
            .far
            .iter()
            .max_by(|a, b| a.distance_m.total_cmp(&b.distance_m))?;
        let others = match self.far.len() {
            1 => String::new(),
            n => format!("; {n} marks are affected"),
        };
        let what = format!(
            "the trajectory rests {:.2} m from mark {} ({:.1} s), which is not in the errors{others}",
            worst.distance_m, worst.mark, worst.start_secs
        );
        Some(
            Finding::new("far-marks", Verdict::Fail, "trajectory", what)
                .value(worst.distance_m, "m")
                .remedy("the trajectory is bent there: include it (a larger --reach-m); if the device rested beside the mark, list the marks that were visited (visit A B …)"),
        )
    }
}
