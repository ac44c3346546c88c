//! Distances in a map between marks that somebody clicked, against a tape: whether it is a map of centimetres.

use lsfb_types::{Finding, Limit, Verdict};
use serde::{Deserialize, Serialize};

use super::distances::LARGEST_M;
use super::file::Tape;

/// What is asked of a map of centimetres beside [`LARGEST_M`], metres: mean difference from what was measured. The paper's has 6.61 and
/// 19.89 cm.
const MEAN_M: f64 = 0.03;
/// A difference of more standard deviations is not by chance.
const CHANCE_SIGMAS: f64 = 4.0;
/// A distance that clicks and tape do not tell better than this judges no map, metres, 1 σ.
const JUDGING_SIGMA_M: f64 = 0.5 * LARGEST_M;

/// A distance in the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MarkDistance {
    /// The marks at its ends.
    pub ends: [String; 2],
    /// What the map says, metres.
    pub map_m: f64,
    /// Standard deviation of that.
    pub sigma_m: f64,
    /// What a tape says; absent where nothing was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured: Option<MeasuredDistance>,
}

/// What a tape says of a distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredDistance {
    /// What was measured, metres.
    pub measured_m: f64,
    /// Map less measured.
    pub error_m: f64,
    /// The same in standard deviations of both.
    pub sigmas: f64,
    /// Whether it is told well enough to judge the map, and not between two marks that hold the map.
    pub judges: bool,
}

/// Whether what was measured may judge a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Judging {
    /// It may.
    May,
    /// The map was bent to the marks at both ends.
    HeldAtBothEnds,
}

impl MarkDistance {
    /// A distance in the map, with its standard deviation.
    pub fn new(ends: [String; 2], [map_m, sigma_m]: [f64; 2]) -> Self {
        Self {
            ends,
            map_m,
            sigma_m,
            measured: None,
        }
    }

    /// With what a tape says of it.
    pub fn measured(self, tape: &Tape, judging: Judging) -> Self {
        let error_m = self.map_m - tape.distance_m;
        let both_m = self.sigma_m.hypot(tape.sigma_m);
        let measured = MeasuredDistance {
            measured_m: tape.distance_m,
            error_m,
            sigmas: error_m / both_m,
            judges: judging == Judging::May && both_m <= JUDGING_SIGMA_M,
        };
        Self {
            measured: Some(measured),
            ..self
        }
    }
}

/// Whether the place of a mark is known too badly to judge a map by its distances.
pub fn judge_mark(name: &str, sigma_m: f64) -> Option<Finding> {
    let what = format!("standard deviation is {:.1} cm, too large", 100.0 * sigma_m);
    let finding = Finding::new("mark-weak", Verdict::Warn, name, what)
        .value(sigma_m, "m")
        .limit(Limit::AtMost(JUDGING_SIGMA_M))
        .remedy("click it in images taken farther apart");
    (sigma_m > JUDGING_SIGMA_M).then_some(finding)
}

/// Whether distances that were measured are those in the map.
pub fn judge_mark_distances(distances: &[MarkDistance]) -> Finding {
    let measured = || distances.iter().filter_map(|d| d.measured);
    let beyond = measured()
        .filter(|m| m.sigmas.abs() > CHANCE_SIGMAS)
        .count();
    let judging: Vec<f64> = measured()
        .filter(|m| m.judges)
        .map(|m| m.error_m.abs())
        .collect();
    let (all, count) = (distances.len(), judging.len());
    let mean_m = judging.iter().sum::<f64>() / count.max(1) as f64;
    let largest_m = judging.iter().copied().fold(0.0, f64::max);
    let verdict = match mean_m <= MEAN_M && largest_m <= LARGEST_M {
        false => Verdict::Fail,
        true if beyond > 0 => Verdict::Warn,
        true if count == 0 => Verdict::Unknown,
        true => Verdict::Pass,
    };
    let what = format!(
        "{count} of {all} distances, those accurate to {:.1} cm or better and not between two control points, off by {:.1} mm on average (limit {:.0}), at most {:.1} mm; {beyond} of all by more than {CHANCE_SIGMAS} σ",
        100.0 * JUDGING_SIGMA_M,
        1e3 * mean_m,
        1e3 * MEAN_M,
        1e3 * largest_m
    );
    // The criterion that is crossed, or would be next.
    let (value_m, limit_m) = match mean_m / MEAN_M > largest_m / LARGEST_M {
        true => (mean_m, MEAN_M),
        false => (largest_m, LARGEST_M),
    };
    Finding::new("distances", verdict, "marks", what)
        .value(value_m, "m")
        .limit(Limit::AtMost(limit_m))
        .remedy("measure the worst distance again; if it is right, the map is bent there")
}

#[cfg(test)]
mod tests {
    use super::super::file::TapeKind;
    use super::*;

    /// A map whose distance is off by so much, by a tape of 1 mm; the map's own standard deviation.
    fn distance(error_m: f64, sigma_m: f64, judging: Judging) -> MarkDistance {
        let ends = ["a", "b"].map(str::to_owned);
        let tape = Tape {
            kind: TapeKind::Free,
            ends: ends.clone(),
            distance_m: 10.0,
            sigma_m: 0.001,
        };
        MarkDistance::new(ends, [10.0 + error_m, sigma_m]).measured(&tape, judging)
    }

    /// Naively a distance told to 30 cm, or one that the map was bent to, passes a map.
    #[test]
    fn only_what_is_known_well_and_not_held_judges_a_map() {
        let verdict = |distances: &[MarkDistance]| judge_mark_distances(distances).verdict;
        assert_eq!(
            verdict(&[distance(0.01, 0.005, Judging::May)]),
            Verdict::Pass
        );
        assert_eq!(
            verdict(&[distance(0.06, 0.02, Judging::May)]),
            Verdict::Fail
        );
        assert_eq!(
            verdict(&[distance(0.04, 0.02, Judging::May)]),
            Verdict::Fail,
            "mean"
        );
        assert_eq!(
            verdict(&[distance(0.02, 0.002, Judging::May)]),
            Verdict::Warn,
            "by no chance"
        );
        assert_eq!(
            verdict(&[distance(0.0, 0.3, Judging::May)]),
            Verdict::Unknown
        );
        let held = distance(0.001, 0.005, Judging::HeldAtBothEnds);
        assert_eq!(verdict(&[held]), Verdict::Unknown);
        assert_eq!(judge_mark("a", 0.01), None);
        let weak = judge_mark("a", 0.03).expect("weak");
        assert_eq!(weak.what, "standard deviation is 3.0 cm, too large");
    }
}
