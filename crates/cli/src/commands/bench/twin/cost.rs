//! How long stages took and how much memory: kept beside their results, since a trial that is continued does not run them again.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::memory;

/// Of one stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    pub wall_s: f64,
    /// The most that the program held meanwhile.
    pub peak_rss_mb: f64,
    /// Whether stages of other places ran beside it, whose memory is in that.
    #[serde(default)]
    pub beside_others: bool,
}

/// Of the stages whose results lie in one folder.
pub struct Costs {
    path: PathBuf,
    known: BTreeMap<String, Cost>,
}

impl Costs {
    /// Those of before, if any; what cannot be read is not known.
    pub fn open(path: PathBuf) -> Self {
        let known = std::fs::read(&path)
            .ok()
            .and_then(|text| serde_json::from_slice(&text).ok())
            .unwrap_or_default();
        Self { path, known }
    }

    /// Runs a stage. It says by its argument that it made its result; one that stands costs what it cost when it was made.
    pub fn of<T>(
        &mut self,
        stage: &str,
        run: impl FnOnce(&Cell<bool>) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        let (began, made) = (Instant::now(), Cell::new(false));
        let (result, peak) = memory::peak_of(|| run(&made));
        let result = result?;
        if made.get() {
            let cost = Cost {
                wall_s: began.elapsed().as_secs_f64(),
                peak_rss_mb: peak.mb,
                beside_others: peak.is_shared,
            };
            self.known.insert(stage.to_owned(), cost);
            crate::files::write(&self.path, serde_json::to_vec_pretty(&self.known)?)?;
        }
        Ok(result)
    }

    /// What a stage cost; nothing where it never came to its end.
    pub fn get(&self, stage: &str) -> Option<Cost> {
        self.known.get(stage).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_that_stands_costs_what_it_cost_before() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("costs.json");
        let mut costs = Costs::open(path.clone());
        let result = costs.of("map", |made| {
            made.set(true);
            Ok(7)
        });
        assert_eq!(result.expect("made"), 7);
        let before = costs.get("map").expect("known");
        let mut again = Costs::open(path);
        again.of("map", |_| Ok(())).expect("stands");
        assert_eq!(again.get("map"), Some(before));
        assert!(again.of::<()>("scan", |_| anyhow::bail!("no")).is_err());
        assert_eq!(again.get("scan"), None);
    }
}
