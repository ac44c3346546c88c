//! What a trial shows as a whole, beside what is asked of it.

use std::fmt::Write as _;

use lsfb_sim::{Device, Place};
use lsfb_types::{Finding, Judgement, Limit, Verdict};
use serde::Serialize;

use super::result::Run;
use super::trial::Size;

/// Asked of every walk that is given: error after an alignment of its own, rms, metres.
const ASKED_OF_EACH_M: f64 = 0.02;
/// Share of the time in which the map is in view that is asked to be answered.
const ASKED_ANSWERED: f64 = 0.95;
/// The jitter of images localized one by one is asked to be so many times that of the trajectory.
const ASKED_JITTER_RATIO: f64 = 3.0;
/// Share of the poses that are asked to be within their region of 95 %, over so many walks at least.
const ASKED_WITHIN: [f64; 2] = [0.93, 0.97];
const ASKED_WALKS: usize = 20;

/// How large a place is, by its extent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PlaceSize {
    /// Up to 200 m².
    Small,
    /// Up to 1 000 m².
    Medium,
    Large,
}

impl PlaceSize {
    const ALL: [Self; 3] = [Self::Small, Self::Medium, Self::Large];

    fn of(place: &str) -> Self {
        let [x_m, y_m] = Place::named(place).map_or([0.0; 2], Place::size_m);
        match x_m * y_m {
            area_m2 if area_m2 <= 200.0 => Self::Small,
            area_m2 if area_m2 <= 1000.0 => Self::Medium,
            _ => Self::Large,
        }
    }

    /// As the table says it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Small => "small",
            Self::Medium => "medium",
            Self::Large => "large",
        }
    }

    /// What the mean error of walks with a device is asked to be, metres; nothing is asked of phones in larger places.
    fn asked_m(self, device: &str) -> Option<f64> {
        let is_glasses = device == Device::Glasses.name();
        match (self, is_glasses) {
            (Self::Small, true) => Some(0.004),
            (Self::Small, false) => Some(0.008),
            (Self::Medium, true) => Some(0.01),
            (Self::Large, true) => Some(0.03),
            (Self::Medium | Self::Large, false) => None,
        }
    }
}

/// Mean and largest over the walks of which it is known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeanAndWorst {
    pub mean: f64,
    pub worst: f64,
}

impl MeanAndWorst {
    fn of(values: impl Iterator<Item = Option<f64>>) -> Option<Self> {
        let known: Vec<f64> = values.flatten().collect();
        let worst = known.iter().copied().reduce(f64::max)?;
        let mean = known.iter().sum::<f64>() / known.len() as f64;
        Some(Self { mean, worst })
    }
}

/// Walks with one device through places of one size, as they were scanned.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Group {
    pub place_size: PlaceSize,
    pub device: String,
    pub walks: usize,
    /// Those without a trajectory.
    pub refused: usize,
    pub ate_rms_m: Option<MeanAndWorst>,
    /// Asked of the mean.
    pub ate_asked_m: Option<f64>,
    pub localized_ate_rms_m: Option<MeanAndWorst>,
    pub between_frames_m: Option<MeanAndWorst>,
    pub between_frames_deg: Option<MeanAndWorst>,
    pub jitter_solved_m: Option<MeanAndWorst>,
    pub jitter_localized_m: Option<MeanAndWorst>,
    /// Share of the poses within their region of 95 %; the worst is the largest.
    pub within_95: Option<f64>,
    /// Time in which the map was in view, and that part of it with a pose.
    pub map_in_view_s: f64,
    pub answered_in_view_s: f64,
}

impl Group {
    fn of(place_size: PlaceSize, device: &str, runs: &[&Run]) -> Self {
        let over = |value: fn(&Run) -> Option<f64>| MeanAndWorst::of(runs.iter().map(|r| value(r)));
        let total =
            |value: fn(&Run) -> Option<f64>| runs.iter().filter_map(|r| value(r)).sum::<f64>();
        Self {
            place_size,
            device: device.to_owned(),
            walks: runs.len(),
            refused: runs.iter().filter(|r| r.refused.is_some()).count(),
            ate_rms_m: over(|r| r.ate_rms_m),
            ate_asked_m: place_size.asked_m(device),
            localized_ate_rms_m: over(|r| r.localized_ate_rms_m),
            between_frames_m: over(|r| r.between_frames_m),
            between_frames_deg: over(|r| r.between_frames_deg),
            jitter_solved_m: over(|r| r.jitter_solved_m),
            jitter_localized_m: over(|r| r.jitter_localized_m),
            within_95: over_poses(runs),
            map_in_view_s: total(|r| r.map_in_view_s),
            answered_in_view_s: total(|r| r.answered_in_view_s),
        }
    }

    /// What the group is called.
    pub fn name(&self) -> String {
        format!("{} places, {}", self.place_size.name(), self.device)
    }

    /// Share of the time in which the map was in view that is answered.
    pub fn answered(&self) -> Option<f64> {
        (self.map_in_view_s > 0.0).then(|| self.answered_in_view_s / self.map_in_view_s)
    }

    fn findings(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        if let (Some(ate), Some(asked_m)) = (self.ate_rms_m, self.ate_asked_m) {
            let limit = Limit::AtMost(100.0 * asked_m);
            let value_cm = 100.0 * ate.mean;
            let what = format!(
                "the mean ATE of {} walks is {value_cm:.2} cm, the worst {:.2} cm",
                self.walks - self.refused,
                100.0 * ate.worst
            );
            findings.push(
                Finding::new(
                    "ate_mean",
                    Verdict::Warn.unless(limit.holds(value_cm)),
                    self.name(),
                    what,
                )
                .value(value_cm, "cm")
                .limit(limit),
            );
        }
        if let Some(answered) = self.answered() {
            let limit = Limit::AtLeast(100.0 * ASKED_ANSWERED);
            let value = 100.0 * answered;
            let what = format!(
                "{value:.0} % of the {:.0} s in which the map is in view have a pose; {} of {} walks are refused",
                self.map_in_view_s, self.refused, self.walks
            );
            findings.push(
                Finding::new(
                    "answered",
                    Verdict::Warn.unless(limit.holds(value)),
                    self.name(),
                    what,
                )
                .value(value, "%")
                .limit(limit),
            );
        }
        findings
    }
}

/// Share of all poses of some walks that are within their regions.
fn over_poses(runs: &[&Run]) -> Option<f64> {
    let known = runs.iter().filter_map(|r| Some((r.within_95?, r.exported)));
    let (within, all) = known.fold((0.0, 0), |(within, all), (share, poses)| {
        (within + share * poses as f64, all + poses)
    });
    (all > 0).then(|| within / all as f64)
}

/// Walks through places as they were scanned, by the size of the place and the device.
pub fn groups(runs: &[Run]) -> Vec<Group> {
    let mut groups = Vec::new();
    for size in PlaceSize::ALL {
        for device in Device::ALL.map(Device::name) {
            let own = runs.iter().filter(|run| {
                run.is_standard() && run.device == device && PlaceSize::of(&run.place) == size
            });
            let own: Vec<&Run> = own.collect();
            if !own.is_empty() {
                groups.push(Group::of(size, device, &own));
            }
        }
    }
    groups
}

/// A trial is good where nothing wrong was exported, something was placed, and the figures are those that are asked for. Of one that is only
/// tried out no figure is judged.
pub fn judge(runs: &[Run], size: Size) -> Judgement {
    let mut findings: Vec<Finding> = runs.iter().flat_map(Run::findings).collect();
    if runs.iter().all(|run| run.scanner_ate_rms_m.is_none()) {
        let what = "no place was mapped, so that no walk was tried";
        findings.push(Finding::new("nothing-tried", Verdict::Fail, "trial", what));
        return Judgement::new(findings);
    }
    if size == Size::TryOut {
        return Judgement::new(findings);
    }
    let mut in_map = runs.iter().filter(|run| run.is_in_map()).peekable();
    if in_map.peek().is_some() && in_map.all(|run| run.refused.is_some()) {
        let what = "all walks were refused: nothing to evaluate";
        findings.push(Finding::new("all-refused", Verdict::Fail, "trial", what));
    }
    findings.extend(runs.iter().filter(|r| r.is_standard()).flat_map(of_run));
    findings.extend(groups(runs).iter().flat_map(Group::findings));
    findings.extend(of_covariances(runs));
    Judgement::new(findings)
}

/// Figures that are asked of each walk.
fn of_run(run: &Run) -> Vec<Finding> {
    let mut findings = Vec::new();
    if let Some(ate_m) = run.ate_rms_m {
        let limit = Limit::AtMost(100.0 * ASKED_OF_EACH_M);
        let value_cm = 100.0 * ate_m;
        let verdict = Verdict::Warn.unless(limit.holds(value_cm));
        let what = format!("ATE {value_cm:.2} cm rms");
        findings.push(
            Finding::new("ate", verdict, run.name(), what)
                .value(value_cm, "cm")
                .limit(limit),
        );
    }
    if let Some(ratio) = run.jitter_ratio {
        let limit = Limit::AtLeast(ASKED_JITTER_RATIO);
        let verdict = Verdict::Warn.unless(limit.holds(ratio));
        let what = format!("images localized one by one jitter {ratio:.1} times as much");
        findings.push(
            Finding::new("jitter", verdict, run.name(), what)
                .value(ratio, "")
                .limit(limit),
        );
    }
    findings
}

/// Whether covariances are as large as errors: of few walks that is not told, since errors of one walk's poses are alike.
fn of_covariances(runs: &[Run]) -> Option<Finding> {
    let given = runs
        .iter()
        .filter(|r| r.is_in_map() && r.within_95.is_some());
    let given: Vec<&Run> = given.collect();
    let value = 100.0 * over_poses(&given)?;
    let what = format!(
        "{value:.1} % of the poses of {} walks are within the 95 % region of their covariance",
        given.len()
    );
    if given.len() < ASKED_WALKS {
        let what = format!("{what}; not judged with fewer than {ASKED_WALKS} walks");
        return Some(Finding::new("nees", Verdict::Unknown, "trial", what).value(value, "%"));
    }
    let [least, most] = ASKED_WITHIN.map(|share| 100.0 * share);
    let limit = match value < least {
        true => Limit::AtLeast(least),
        false => Limit::AtMost(most),
    };
    let verdict = Verdict::Warn.unless(limit.holds(value));
    let found = Finding::new("nees", verdict, "trial", what);
    Some(found.value(value, "%").limit(limit))
}

/// A line for each group.
pub fn table(groups: &[Group]) -> String {
    let mut text = format!(
        "{:<26} {:>9} {:>17} {:>6} {:>17} {:>13} {:>15} {:>7} {:>9}\n{:<26} {:>9} {:>17} {:>6} {:>17} {:>13} {:>15} {:>7} {:>9}",
        "",
        "walks",
        "ATE rms",
        "asked",
        "localized alone",
        "jitter",
        "between frames",
        "in 95 %",
        "answered",
        "",
        "(refused)",
        "mean (worst) cm",
        "cm",
        "mean (worst) cm",
        "mm (alone)",
        "mm, °",
        "%",
        "% in view"
    );
    let number = |value: Option<f64>, factor: f64, digits: usize| match value {
        Some(value) => format!("{:.digits$}", factor * value),
        None => "–".to_owned(),
    };
    let both = |value: Option<MeanAndWorst>, factor: f64, digits: usize| match value {
        Some(v) => format!(
            "{:.digits$} ({:.digits$})",
            factor * v.mean,
            factor * v.worst
        ),
        None => "–".to_owned(),
    };
    let mean = |value: Option<MeanAndWorst>| value.map(|v| v.mean);
    for group in groups {
        // Writing into a string cannot fail.
        let _ = write!(
            text,
            "\n{:<26} {:>9} {:>17} {:>6} {:>17} {:>13} {:>15} {:>7} {:>9}",
            group.name(),
            format!("{} ({})", group.walks, group.refused),
            both(group.ate_rms_m, 100.0, 2),
            number(group.ate_asked_m, 100.0, 1),
            both(group.localized_ate_rms_m, 100.0, 2),
            format!(
                "{} ({})",
                number(mean(group.jitter_solved_m), 1e3, 2),
                number(mean(group.jitter_localized_m), 1e3, 1)
            ),
            format!(
                "{}, {}",
                number(mean(group.between_frames_m), 1e3, 2),
                number(mean(group.between_frames_deg), 1.0, 3)
            ),
            number(group.within_95, 100.0, 0),
            number(group.answered(), 100.0, 0),
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::rigs::Rigs;
    use super::super::trial::{Condition, Scanned, Walked};
    use super::*;

    fn run(place: Place, device: Device, condition: Condition) -> Run {
        let scanned = Scanned {
            place,
            seed: 1,
            size: Size::Quick,
        };
        let walked = Walked {
            scanned,
            condition,
            device,
        };
        Run {
            scanner_ate_rms_m: Some(0.01),
            ate_rms_m: Some(0.003),
            exported: 300,
            map_in_view_s: Some(10.0),
            answered_in_view_s: Some(9.8),
            within_95: Some(0.95),
            jitter_ratio: Some(8.0),
            ..Run::of(&walked, Rigs::Calibrated)
        }
    }

    fn right() -> Run {
        run(Place::Stairs, Device::Android, Condition::AsScanned)
    }

    fn refused(run: Run) -> Run {
        Run {
            ate_rms_m: None,
            exported: 0,
            answered_in_view_s: run.map_in_view_s.map(|_| 0.0),
            within_95: None,
            jitter_ratio: None,
            refused: Some("uncertain".to_owned()),
            ..run
        }
    }

    fn verdict(runs: &[Run]) -> Verdict {
        judge(runs, Size::Quick).verdict()
    }

    /// Codes of what is wrong.
    fn problems(runs: &[Run]) -> Vec<String> {
        let judgement = judge(runs, Size::Quick);
        let codes = judgement.problems().map(|f| f.code.to_string());
        codes.collect()
    }

    /// A small error on the whole says "fine" of a walk with a few poses that are metres off, and a trial in which nothing was placed has no error
    /// at all.
    #[test]
    fn a_wrong_pose_fails_the_trial_and_so_does_one_in_which_all_is_refused() {
        assert_eq!(verdict(&[right()]), Verdict::Pass);
        let wrong = Run {
            exported_wrong: 1,
            ..right()
        };
        assert_eq!(verdict(&[right(), wrong]), Verdict::Fail);
        let unusable = Run {
            failed: true,
            ..right()
        };
        assert_eq!(verdict(&[unusable]), Verdict::Warn);
        assert_eq!(verdict(&[right(), refused(right())]), Verdict::Warn);
        let all = [refused(right()), refused(right())];
        assert!(problems(&all).contains(&"all-refused".to_owned()));
        assert_eq!(verdict(&all), Verdict::Fail);
        assert_eq!(judge(&all, Size::TryOut).verdict(), Verdict::Warn);
        let untried = Run {
            scanner_ate_rms_m: None,
            map_in_view_s: None,
            ..refused(right())
        };
        assert_eq!(problems(&[untried]), ["nothing-tried", "refused"]);
    }

    /// On another floor a walk that is refused is answered rightly, and no figure is asked of it.
    #[test]
    fn refusals_on_another_floor_are_right() {
        let above = Run {
            map_in_view_s: None,
            ..refused(run(Place::Stairs, Device::Android, Condition::OtherFloor))
        };
        assert_eq!(verdict(std::slice::from_ref(&above)), Verdict::Pass);
        assert_eq!(verdict(&[above.clone(), right()]), Verdict::Pass);
        assert!(groups(&[above]).is_empty());
    }

    /// Each within ten centimetres: that was a pass.
    #[test]
    fn figures_above_what_is_asked_are_said() {
        let of = |ate_rms_m| Run {
            ate_rms_m: Some(ate_rms_m),
            ..right()
        };
        assert_eq!(problems(&[of(0.008)]), Vec::<String>::new());
        assert_eq!(problems(&[of(0.002), of(0.019)]), ["ate_mean"]);
        assert_eq!(
            problems(&[of(0.002), of(0.002), of(0.002), of(0.021)]),
            ["ate"]
        );
        let found = &groups(&[of(0.002), of(0.019)])[0];
        let ate = found.ate_rms_m.expect("given");
        assert!((ate.mean - 0.0105).abs() < 1e-12 && ate.worst == 0.019);
        assert_eq!(found.ate_asked_m, Some(0.008));

        // Nothing is asked of the mean of phones in large places.
        let far = Run {
            ate_rms_m: Some(0.018),
            ..run(Place::HousePark, Device::Iphone, Condition::AsScanned)
        };
        assert_eq!(problems(&[far]), Vec::<String>::new());
        let late = Run {
            answered_in_view_s: Some(9.0),
            ..right()
        };
        assert_eq!(problems(&[late]), ["answered"]);
        let shaking = Run {
            jitter_ratio: Some(2.0),
            ..right()
        };
        assert_eq!(problems(&[shaking]), ["jitter"]);
    }

    /// Of a few walks nothing is said of covariances; of many, those that are too large are named as well as those that are too small.
    #[test]
    fn covariances_are_judged_over_many_walks() {
        let with = |share: f64, count: usize| {
            let run = Run {
                within_95: Some(share),
                ..right()
            };
            problems(&vec![run; count])
        };
        assert_eq!(with(0.5, ASKED_WALKS - 1), Vec::<String>::new());
        assert_eq!(with(0.95, ASKED_WALKS), Vec::<String>::new());
        assert_eq!(with(0.9, ASKED_WALKS), ["nees"]);
        assert_eq!(with(1.0, ASKED_WALKS), ["nees"]);
    }

    #[test]
    fn places_have_sizes_and_groups_have_lines() {
        let runs = [
            right(),
            run(Place::MediumOffice, Device::Glasses, Condition::AsScanned),
            refused(run(
                Place::LargeOffice,
                Device::Glasses,
                Condition::AsScanned,
            )),
        ];
        let groups = groups(&runs);
        let names: Vec<String> = groups.iter().map(Group::name).collect();
        assert_eq!(
            names,
            [
                "small places, android",
                "medium places, glasses",
                "large places, glasses"
            ]
        );
        let text = table(&groups);
        assert!(
            text.contains("0.30 (0.30)") && text.contains("1 (1)"),
            "{text}"
        );
        assert!(text.contains(" 98"), "{text}");
    }
}
