//! Measured distances against those between points of a map (Table II of the paper).

use lsfb_types::{Finding, Limit, Verdict};
use serde::Serialize;

use super::file::{Survey, Tape};
use crate::{Error, Statistics};

/// A map whose distances are further off is none of centimetres, metres.
pub(super) const LARGEST_M: f64 = 0.05;

/// One measured distance, and what the map says.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DistanceError {
    /// The points at its ends.
    pub ends: [String; 2],
    /// What was measured, metres.
    pub measured_m: f64,
    /// What the map says, metres.
    pub map_m: f64,
    /// Map less measured, metres.
    pub error_m: f64,
}

/// All measured distances between points of the map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DistanceReport {
    /// In the order of the file.
    pub distances: Vec<DistanceError>,
    /// Of their magnitudes, metres: the mean hides the largest.
    pub error_m: Statistics,
}

impl DistanceReport {
    /// Whether the map is one of centimetres.
    pub fn finding(&self) -> Finding {
        let verdict = Verdict::Warn.unless(self.error_m.max <= LARGEST_M);
        let what = format!(
            "{} distances off by {:.1} mm on average, at most {:.1} mm",
            self.distances.len(),
            1000.0 * self.error_m.mean,
            1000.0 * self.error_m.max
        );
        Finding::new("distances", verdict, "map", what)
            .value(self.error_m.max, "m")
            .limit(Limit::AtMost(LARGEST_M))
            .remedy("measure the worst distance again; if it is right, the map is bent there")
    }
}

/// Compares the distances whose both ends are points of the map.
pub fn compare_distances(survey: &Survey) -> Result<DistanceReport, Error> {
    let error = |tape: &Tape| {
        let [a, b] = [&tape.ends[0], &tape.ends[1]].map(|end| survey.points.get(end));
        let map_m = (a? - b?).norm();
        Some(DistanceError {
            ends: tape.ends.clone(),
            measured_m: tape.distance_m,
            map_m,
            error_m: map_m - tape.distance_m,
        })
    };
    let distances: Vec<DistanceError> = survey.tapes.iter().filter_map(error).collect();
    let sizes: Vec<f64> = distances.iter().map(|d| d.error_m.abs()).collect();
    let error_m = Statistics::of(&sizes).ok_or(Error::NoMapDistance)?;
    Ok(DistanceReport { distances, error_m })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use lsfb_geometry::Vector3;

    use super::super::file::TapeKind;
    use super::*;

    /// Table II of the paper after optimisation: 5.25, 1.04, 19.89 and 0.26 cm have the mean 6.61 cm, and one of 20.
    #[test]
    fn the_mean_hides_the_largest() {
        let errors_m = [0.0525, 0.0104, 0.1989, 0.0026];
        let mut points = BTreeMap::new();
        let mut tapes = Vec::new();
        for (i, (error_m, measured_m)) in
            errors_m.iter().zip([11.07, 15.72, 16.96, 7.62]).enumerate()
        {
            let ends = [format!("a{i}"), format!("b{i}")];
            points.insert(ends[0].clone(), Vector3::new(0.0, 0.0, i as f64));
            points.insert(
                ends[1].clone(),
                Vector3::new(measured_m - error_m, 0.0, i as f64),
            );
            tapes.push(Tape {
                kind: TapeKind::Free,
                ends,
                distance_m: measured_m,
                sigma_m: 0.001,
            });
        }
        let mut survey = Survey {
            tapes,
            line_sigma_m: 0.001,
            visits: Vec::new(),
            points,
        };
        let report = compare_distances(&survey).expect("four distances");
        assert_eq!(format!("{:.2}", 100.0 * report.error_m.mean), "6.61");
        assert_eq!(format!("{:.2}", 100.0 * report.error_m.max), "19.89");
        assert!(report.distances.iter().all(|d| d.error_m < 0.0));
        assert_eq!(report.finding().verdict, Verdict::Warn);
        survey.points.clear();
        assert!(matches!(
            compare_distances(&survey),
            Err(Error::NoMapDistance)
        ));
    }
}
