//! Which measurement is a blunder: the largest residual in units of its own standard deviation (Baarda's data snooping).

use lsfb_geometry::Vector2;
use lsfb_types::{Finding, Limit, Verdict};

use super::adjustment::{Adjusted, adjust};
use super::observation::{Observation, Quantity};
use super::solution::{Mark, ObservationReport, SurveySolution, TermRms};
use crate::Error;

/// Of correct measurements one of a thousand is beyond this.
const CRITICAL_W: f64 = 3.29;
/// Blunders of this many standard deviations of their residual are found with a probability of 80 % (α = 0.1 %).
const FOUND_AT: f64 = 4.13;
/// Redundancy below which nothing checks a measurement.
const LEAST_REDUNDANCY: f64 = 0.01;
/// Redundancy below which a blunder hides well.
const WEAK_REDUNDANCY: f64 = 0.1;
/// Values of w this near to the largest cannot be told from it.
const SAME_W: f64 = 0.98;
/// Share of the measurements that may be blunders; with more the standard deviations are wrong, not the measurements.
const MOST_BLUNDERS: f64 = 0.2;
/// Factor by which standard deviations may be too small or too large.
const SIGMA0_RANGE: std::ops::RangeInclusive<f64> = 0.3..=2.0;

/// Adjusts, leaves out the worst blunder, and again.
pub(super) fn without_blunders(
    names: &[&str],
    observations: &[Observation],
    mut places: Vec<Vector2<f64>>,
) -> Result<SurveySolution, Error> {
    let mut used = vec![true; observations.len()];
    let mut findings = Vec::new();
    let most = (MOST_BLUNDERS * observations.len() as f64) as usize;
    loop {
        let chosen: Vec<usize> = (0..used.len()).filter(|i| used[*i]).collect();
        let some: Vec<Observation> = chosen.iter().map(|i| observations[*i]).collect();
        let adjusted = adjust(names, &some, &places)?;
        let suspects = suspects(&adjusted);
        let Some(&worst) = suspects.first() else {
            return Ok(solution(names, observations, &used, &adjusted, findings));
        };
        if used.iter().filter(|u| !**u).count() >= most.max(1) {
            // Nothing is left out where too much would be.
            let everything = adjust(names, observations, &places)?;
            let what =
                "more than a fifth of the measurements contradict each other: none was left out";
            let finding = Finding::new("blunders", Verdict::Fail, "survey", what)
                .remedy("give larger standard deviations, or measure again");
            let used = vec![true; observations.len()];
            return Ok(solution(
                names,
                observations,
                &used,
                &everything,
                vec![finding],
            ));
        }
        let named: Vec<String> = suspects
            .iter()
            .map(|i| describe(names, &observations[chosen[*i]]))
            .collect();
        if suspects.len() > 1 {
            let what = format!(
                "one of {} is wrong, but which one is unknown",
                named.join(", ")
            );
            let finding = Finding::new("blunder", Verdict::Fail, "survey", what)
                .remedy("measure these again, and one more distance across them");
            findings.push(finding);
            return Ok(solution(names, observations, &used, &adjusted, findings));
        }
        let observation = &some[worst];
        let error_m = -adjusted.weighted[worst] * observation.sigma_m / adjusted.redundancy[worst];
        let what = format!(
            "off by about {:+.1} mm relative to all others; left out",
            1000.0 * error_m
        );
        let w = w(&adjusted, worst).unwrap_or_default().abs();
        findings.push(
            Finding::new("blunder", Verdict::Warn, named.join(", "), what)
                .value(w, "σ")
                .limit(Limit::AtMost(CRITICAL_W))
                .remedy("measure it again"),
        );
        used[chosen[worst]] = false;
        places = adjusted.places;
    }
}

/// Observations whose residual is the largest beyond the critical value, and those that nothing tells from it.
fn suspects(adjusted: &Adjusted) -> Vec<usize> {
    let size = |i: usize| w(adjusted, i).unwrap_or_default().abs();
    let all = 0..adjusted.weighted.len();
    let largest = all.clone().map(size).fold(0.0, f64::max);
    if largest <= CRITICAL_W {
        return Vec::new();
    }
    let mut near: Vec<usize> = all.filter(|i| size(*i) >= SAME_W * largest).collect();
    near.sort_by(|a, b| size(*b).total_cmp(&size(*a)));
    near
}

fn w(adjusted: &Adjusted, i: usize) -> Option<f64> {
    let redundancy = adjusted.redundancy[i];
    (redundancy >= LEAST_REDUNDANCY).then(|| adjusted.weighted[i] / redundancy.sqrt())
}

fn describe(names: &[&str], observation: &Observation) -> String {
    let [a, b] = observation.ends.map(|end| names[end]);
    match observation.quantity {
        Quantity::Distance(_) => format!("{a}–{b}"),
        Quantity::SameY => format!("{a}–{b} same y"),
        Quantity::SameX => format!("{a}–{b} same x"),
    }
}

fn solution(
    names: &[&str],
    observations: &[Observation],
    used: &[bool],
    adjusted: &Adjusted,
    mut findings: Vec<Finding>,
) -> SurveySolution {
    let mut place_of_used = 0;
    let mut reports = Vec::with_capacity(observations.len());
    for (observation, is_used) in observations.iter().zip(used) {
        let [a, b] = observation.ends.map(|end| adjusted.places[end]);
        let residual_m = observation
            .linearize(&a, &b)
            .map_or(0.0, |(off_m, _)| off_m);
        let (redundancy, w) = match is_used {
            true => {
                place_of_used += 1;
                let i = place_of_used - 1;
                (adjusted.redundancy[i], w(adjusted, i))
            }
            false => (1.0, None),
        };
        let is_checked = redundancy >= LEAST_REDUNDANCY;
        reports.push(ObservationReport {
            what: describe(names, observation),
            measured_m: match observation.quantity {
                Quantity::Distance(measured_m) => Some(measured_m),
                Quantity::SameX | Quantity::SameY => None,
            },
            residual_m,
            sigma_m: observation.sigma_m,
            redundancy,
            w,
            smallest_blunder_m: is_checked
                .then(|| FOUND_AT * observation.sigma_m / redundancy.sqrt()),
            left_out: !is_used,
        });
    }
    let freedom: f64 = adjusted.redundancy.iter().sum();
    let degrees_of_freedom = freedom.round() as usize;
    let sigma0 = (degrees_of_freedom > 0).then(|| (adjusted.cost() / freedom).sqrt());
    findings.extend(unchecked(&reports));
    findings.push(fit(sigma0, degrees_of_freedom));
    // Where residuals are larger than stated, so are the errors of the marks.
    let factor = sigma0.map_or(1.0, |s| s.max(1.0));
    let sigma_m = |k: usize| factor * adjusted.covariance[(k, k)].max(0.0).sqrt();
    let marks = names.iter().zip(&adjusted.places).enumerate();
    let rms = |wanted: fn(&Quantity) -> bool| {
        let squares: Vec<f64> = observations
            .iter()
            .zip(&reports)
            .filter(|(o, r)| wanted(&o.quantity) && !r.left_out)
            .map(|(_, r)| r.residual_m * r.residual_m)
            .collect();
        let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
        (!squares.is_empty()).then(|| mean.sqrt())
    };
    SurveySolution {
        marks: marks
            .map(|(i, (name, place))| Mark {
                name: (*name).to_owned(),
                x_m: place.x,
                y_m: place.y,
                sigma_x_m: sigma_m(2 * i),
                sigma_y_m: sigma_m(2 * i + 1),
            })
            .collect(),
        rms: TermRms {
            distance_m: rms(|q| matches!(q, Quantity::Distance(_))),
            horizontal_m: rms(|q| *q == Quantity::SameY),
            vertical_m: rms(|q| *q == Quantity::SameX),
        },
        observations: reports,
        degrees_of_freedom,
        sigma0,
        findings,
    }
}

/// Measurements whose blunders nobody would see.
fn unchecked(reports: &[ObservationReport]) -> Option<Finding> {
    let weak = reports.iter().filter(|r| r.redundancy < WEAK_REDUNDANCY);
    let names: Vec<&str> = weak.map(|r| r.what.as_str()).collect();
    (!names.is_empty()).then(|| {
        let what = format!("a blunder would hardly be noticed in {}", names.join(", "));
        Finding::new("unchecked", Verdict::Warn, "survey", what)
            .value(names.len() as f64, "")
            .remedy("measure more distances to these marks")
    })
}

/// Whether residuals are as large as the standard deviations say.
fn fit(sigma0: Option<f64>, degrees_of_freedom: usize) -> Finding {
    let Some(sigma0) = sigma0 else {
        let what = "no redundant measurements: errors cannot be detected";
        return Finding::new("fit", Verdict::Warn, "survey", what).remedy("measure more distances");
    };
    let verdict = Verdict::Warn.unless(SIGMA0_RANGE.contains(&sigma0));
    let what = format!(
        "residuals are {sigma0:.2} times their standard deviations ({degrees_of_freedom} degrees of freedom)"
    );
    Finding::new("fit", verdict, "survey", what)
        .value(sigma0, "")
        .remedy("give standard deviations as large as the residuals")
}
