//! What a solver needed for each keyframe.

use std::path::Path;

use anyhow::Context as _;
use serde::Serialize;

/// Keyframe from which on growth is looked at, in walks that are long enough.
const LEAST_GROWN: usize = 100;

/// One keyframe taken in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Update {
    /// Number of the keyframe, from 1.
    pub keyframe: usize,
    /// CPU time.
    pub cpu_ms: f64,
    /// `½ Σ ρ` after it, where the solver says so.
    pub cost: Option<f64>,
}

/// All updates of one solver, in order.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    pub name: String,
    pub updates: Vec<Update>,
}

/// A run in a few figures.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    solver: String,
    updates: usize,
    median_ms: f64,
    p95_ms: f64,
    max_ms: f64,
    /// Time of an update grows with keyframes to this power, by least squares between logarithms, the last tenth of the walk, where
    /// the loop closes, left out; absent where there are too few.
    growth_exponent: Option<f64>,
    /// Largest share by which the cost is above that of the batch solve, where both are known.
    cost_above_batch: Option<f64>,
}

impl Run {
    /// Nothing yet.
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            updates: Vec::new(),
        }
    }

    /// One line a keyframe.
    pub fn to_csv(&self) -> String {
        let mut text = String::from("keyframe,cpu_ms,cost\n");
        for update in &self.updates {
            let cost = update.cost.map_or(String::new(), |c| c.to_string());
            text += &format!("{},{:.4},{cost}\n", update.keyframe, update.cpu_ms);
        }
        text
    }

    /// In a few figures, beside the batch solve.
    pub fn summary(&self, batch: &Run) -> Summary {
        let mut times: Vec<f64> = self.updates.iter().map(|u| u.cpu_ms).collect();
        times.sort_by(f64::total_cmp);
        let share = |s: f64| {
            let last = times.len().saturating_sub(1);
            times
                .get((last as f64 * s).round() as usize)
                .copied()
                .unwrap_or(f64::NAN)
        };
        Summary {
            solver: self.name.clone(),
            updates: self.updates.len(),
            median_ms: share(0.5),
            p95_ms: share(0.95),
            max_ms: share(1.0),
            growth_exponent: self.growth_exponent(),
            cost_above_batch: self.cost_above(batch),
        }
    }

    fn growth_exponent(&self) -> Option<f64> {
        let last = self.updates.last()?.keyframe;
        let first = (3 * last / 10).min(LEAST_GROWN);
        let inner = self
            .updates
            .iter()
            .filter(|u| u.keyframe >= first && 10 * u.keyframe <= 9 * last && u.cpu_ms > 0.0);
        let points: Vec<[f64; 2]> = inner
            .map(|u| [(u.keyframe as f64).ln(), u.cpu_ms.ln()])
            .collect();
        if points.len() < 5 {
            return None;
        }
        let n = points.len() as f64;
        let mean = |k: usize| points.iter().map(|p| p[k]).sum::<f64>() / n;
        let (x, y) = (mean(0), mean(1));
        let product: f64 = points.iter().map(|p| (p[0] - x) * (p[1] - y)).sum();
        Some(product / points.iter().map(|p| (p[0] - x).powi(2)).sum::<f64>())
    }

    fn cost_above(&self, batch: &Run) -> Option<f64> {
        let pairs = self.updates.iter().filter_map(|update| {
            let at = batch
                .updates
                .binary_search_by_key(&update.keyframe, |b| b.keyframe)
                .ok()?;
            let (cost, least) = (update.cost?, batch.updates[at].cost?);
            (least > 0.0).then(|| cost / least - 1.0)
        });
        pairs.reduce(f64::max)
    }
}

impl Summary {
    /// For the terminal.
    pub fn line(&self) -> String {
        let growth = self
            .growth_exponent
            .map_or("–".to_owned(), |g| format!("{g:.2}"));
        let above = self
            .cost_above_batch
            .map_or("–".to_owned(), |c| format!("{c:.1e}"));
        format!(
            "{:<16} median {:>8.2} ms, p95 {:>8.2} ms, max {:>8.2} ms per keyframe; growth exponent {growth}; cost {above} above batch",
            self.solver, self.median_ms, self.p95_ms, self.max_ms
        )
    }
}

/// A peer's result: keyframe, CPU milliseconds and, if known, cost on each line; a first line of names is skipped.
pub fn read_run(name: &str, path: &Path, keyframes: u32) -> anyhow::Result<Run> {
    let place = || path.display().to_string();
    let text = std::fs::read_to_string(path).with_context(place)?;
    parse_run(name, &text, keyframes as usize).with_context(place)
}

fn parse_run(name: &str, text: &str, keyframes: usize) -> anyhow::Result<Run> {
    let mut run = Run::new(name);
    let lines = text.lines().enumerate();
    for (number, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        if number == 0 && line.starts_with("keyframe") {
            continue;
        }
        let update = parse_update(line)
            .filter(|u| (1..=keyframes).contains(&u.keyframe))
            .filter(|u| {
                run.updates
                    .last()
                    .is_none_or(|before| before.keyframe < u.keyframe)
            });
        run.updates.push(update.with_context(|| {
            format!("line {}: expected a keyframe from 1 to {keyframes} in ascending order, its CPU milliseconds, and its cost: {line}", number + 1)
        })?);
    }
    anyhow::ensure!(!run.updates.is_empty(), "it has no keyframe");
    Ok(run)
}

fn parse_update(line: &str) -> Option<Update> {
    let mut cells = line.split(',').map(str::trim);
    let keyframe = cells.next()?.parse().ok()?;
    let cpu_ms = number(cells.next()?)?;
    let cost = match cells.next() {
        None | Some("") => None,
        Some(cell) => Some(number(cell)?),
    };
    Some(Update {
        keyframe,
        cpu_ms,
        cost,
    })
}

/// Finite and not negative.
fn number(cell: &str) -> Option<f64> {
    let value: f64 = cell.parse().ok()?;
    (value.is_finite() && value >= 0.0).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let text = "keyframe,cpu_ms,cost\n1,0.5,12.25\n10,3.25,\n";
        let run = parse_run("peer", text, 10).expect("reads");
        assert_eq!(run.updates[1].cost, None);
        assert_eq!(
            run.to_csv(),
            "keyframe,cpu_ms,cost\n1,0.5000,12.25\n10,3.2500,\n"
        );
    }

    #[test]
    fn what_is_no_result_is_refused_with_its_line() {
        for (text, line) in [
            ("1,1\n1,1\n", "line 2"),
            ("0,1\n", "line 1"),
            ("11,1\n", "line 1"),
            ("1,nan\n", "line 1"),
            ("1,-1\n", "line 1"),
            ("1,1,x\n", "line 1"),
            ("<html>\n", "line 1"),
        ] {
            let error = parse_run("peer", text, 10).expect_err(text).to_string();
            assert!(error.starts_with(line), "{text}: {error}");
        }
        assert!(parse_run("peer", "", 10).is_err());
    }

    #[test]
    fn growth_is_the_slope_between_logarithms() {
        let mut run = Run::new("square");
        for keyframe in 1..=100 {
            run.updates.push(Update {
                keyframe,
                cpu_ms: 0.01 * (keyframe * keyframe) as f64,
                cost: Some(2.0),
            });
        }
        let mut batch = Run::new("batch");
        batch.updates.push(Update {
            cost: Some(1.0),
            ..run.updates[49]
        });
        let summary = run.summary(&batch);
        assert!(
            summary
                .growth_exponent
                .is_some_and(|g| (g - 2.0).abs() < 1e-9)
        );
        assert_eq!(summary.cost_above_batch, Some(1.0));
        assert!((summary.max_ms - 100.0).abs() < 1e-9);
    }
}
