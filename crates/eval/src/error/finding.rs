//! What was found of trajectories and surveys that cannot be judged: the name of the check, the number, and what to do.

use lsfb_types::{Finding, Limit, Verdict};

use super::Error;

/// What to give instead of another trajectory.
const OF_THE_MAP: &str = "give the trajectory that `lsfb map --out-trajectory` wrote with the map";

impl Error {
    /// What was found, where the data is refused; `None` where something could not be read or done at all, or was asked for wrongly.
    pub fn finding(&self) -> Option<Finding> {
        self.of_survey()
            .or_else(|| self.of_motion())
            .or_else(|| self.of_poses())
            .or_else(|| self.of_matches())
    }

    /// Marks, and the rests on them.
    fn of_survey(&self) -> Option<Finding> {
        Some(match self {
            Self::UndeterminedMark { mark } => fail(
                "undetermined-mark",
                format!("mark {mark}"),
                "the distances do not determine its position",
            )
            .remedy("measure another one to it, or one along a line"),
            Self::TwoPlaces { mark, apart_m } => fail(
                "ambiguous-mark",
                format!("mark {mark}"),
                format!("it fits at two positions, {apart_m:.2} m apart"),
            )
            .value(*apart_m, "m")
            .remedy("measure another distance to it"),
            Self::TooFewRests { rests, marks } => fail(
                "few-rests",
                "trajectory",
                format!("it has {rests} rests, but no three of them match three of the {marks} marks"),
            )
            .value(*rests as f64, "")
            .remedy(
                "check that its z axis points up, or allow a larger spread of rests or a larger reach of marks",
            ),
            Self::AmbiguousRests { rests } => fail(
                "ambiguous-rests",
                "trajectory",
                format!("{rests} rests fit the marks in more than one way"),
            )
            .value(*rests as f64, "")
            .remedy("add the order of visits to the survey (visit A B …)"),
            Self::NoInertialSamples {
                poses_span,
                samples_span,
            } => fail(
                "imu-clock",
                "IMU",
                format!("no IMU samples (they span {samples_span}) at the time of the poses ({poses_span})"),
            )
            .remedy("check that both belong to one walk, on one clock"),
            _ => return None,
        })
    }

    /// Two motions that are to be one body's.
    fn of_motion(&self) -> Option<Finding> {
        Some(match self {
            Self::NotOneMotion {
                fit,
                poses,
                needed,
                force_m_s2,
            } => fail(
                "not-one-motion",
                "motion capture",
                format!(
                    "{fit} of {poses} poses fit the IMU samples, whose mean specific force is {force_m_s2:.2} m/s² (9.8 is expected)"
                ),
            )
            .value(*fit as f64, "")
            .limit(Limit::AtLeast(*needed as f64))
            .remedy(
                "check the units (metres, rad/s, m/s²), the IMU's axes and signs, the order of the quaternion components, and that both are on one rigid body",
            ),
            Self::InertialGap { gap_secs } => fail(
                "imu-pause",
                "IMU",
                format!("no IMU samples for {gap_secs:.2} s, so that the motion there is unknown"),
            )
            .value(*gap_secs, "s")
            .remedy("evaluate the parts before and after separately"),
            Self::Unstable { secs } => fail(
                "unstable",
                "motion capture",
                format!("it cannot be joined with the IMU from {secs:.2} s on"),
            )
            .remedy("check the units of both (metres, rad/s, m/s²)"),
            Self::EvenRotation { role } => fail(
                "even-rotation",
                trajectory(role),
                "its rotation is constant or absent and does not determine the clock offset",
            )
            .remedy("rotate the device back and forth"),
            Self::NoCommonTime {
                search_secs,
                around_secs,
                spans,
            } => fail(
                "no-common-time",
                "",
                format!(
                    "they overlap by less than 5 s within {search_secs} s of an offset of {around_secs} s (they span {spans})"
                ),
            )
            .remedy("give the approximate clock offset"),
            Self::NotOneBody { correlation } => fail(
                "not-one-body",
                "",
                format!("the angular rates do not agree at any offset (correlation {correlation:.2})"),
            )
            .value(*correlation, "")
            .remedy("check that both are on one rigid body"),
            Self::TwoOffsets {
                first_secs,
                second_secs,
            } => fail(
                "two-offsets",
                "",
                format!(
                    "the motion is periodic, and offsets of {first_secs:.2} and {second_secs:.2} s fit equally well"
                ),
            )
            .value((second_secs - first_secs).abs(), "s")
            .remedy("reduce the search range, or move irregularly"),
            Self::OneAxis {
                first_deg,
                second_deg,
            } => fail(
                "observability",
                "",
                format!(
                    "the device rotated about one axis only ({first_deg:.2}° about the first, {second_deg:.2}° about the second), which does not determine the transform between the bodies"
                ),
            )
            .value(*second_deg, "°")
            .remedy("rotate it about two"),
            _ => return None,
        })
    }

    /// One trajectory.
    fn of_poses(&self) -> Option<Finding> {
        Some(match self {
            Self::CoarseStamps {
                path,
                poses,
                distinct,
            } => fail(
                "coarse-stamps",
                path.display().to_string(),
                format!("{poses} poses have only {distinct} different stamps"),
            )
            .value(*distinct as f64, "")
            .remedy("write at least millisecond digits"),
            Self::TooFewPoses {
                role,
                poses,
                needed,
            } => fail("few-poses", trajectory(role), format!("{poses} poses"))
                .value(*poses as f64, "")
                .limit(Limit::AtLeast(*needed as f64))
                .remedy("give a longer one"),
            Self::TooLong { role, span_secs } => fail(
                "stamp-unit",
                trajectory(role),
                format!("its stamps span {span_secs:.0} s"),
            )
            .value(*span_secs, "s")
            .remedy("check whether they are in another unit, or one is wrong"),
            Self::Empty { role } => fail("no-poses", trajectory(role), "it has no pose")
                .value(0.0, "")
                .remedy("check the program that wrote it"),
            Self::Reordered {
                role,
                index,
                time_secs,
            } => fail(
                "unsorted-stamps",
                trajectory(role),
                format!("pose {index} (t = {time_secs} s) is older than the previous one"),
            )
            .remedy("sort it by time"),
            Self::Duplicated {
                role,
                count,
                time_secs,
            } => fail(
                "duplicate-stamps",
                trajectory(role),
                format!("{count} stamps occur twice, first at t = {time_secs} s"),
            )
            .value(*count as f64, "")
            .remedy("keep one pose per stamp"),
            Self::NotFinite {
                role,
                index,
                time_secs,
            } => fail(
                "not-finite",
                trajectory(role),
                format!("pose {index} (t = {time_secs} s) is not finite"),
            )
            .remedy("leave it out"),
            Self::TooFar {
                index,
                role,
                time_secs,
                limit_m,
            } => fail(
                "too-far",
                trajectory(role),
                format!(
                    "pose {index}, t = {time_secs} s, is more than {limit_m:e} m from the origin, which is implausible in any unit of length"
                ),
            )
            .remedy("check the columns, and the program that wrote it"),
            Self::NoDuration { time_secs } => fail(
                "no-duration",
                "",
                format!("all matched poses have the same time, t = {time_secs} s"),
            )
            .remedy("give trajectories that move on in time"),
            _ => return None,
        })
    }

    /// What an estimate and the truth share.
    fn of_matches(&self) -> Option<Finding> {
        Some(match self {
            Self::NoMatch {
                max_difference_secs,
                truth_span,
                estimate_span,
                hint,
            } => fail(
                "no-match",
                "",
                format!(
                    "no pose of the estimate is within {max_difference_secs} s of one of the truth: truth spans {truth_span}, estimate {estimate_span}"
                ),
            )
            .remedy(format!(
                "check that they use the same clock, shift the stamps, or raise the allowed difference{hint}"
            )),
            Self::TooFewMatches {
                matched,
                needed,
                purpose,
            } => fail(
                "few-matches",
                "",
                format!("only {matched} poses match, too few for {purpose}"),
            )
            .value(*matched as f64, "")
            .limit(Limit::AtLeast(*needed as f64))
            .remedy("give trajectories of the same walk that overlap more"),
            Self::Degenerate => fail(
                "on-a-line",
                "",
                "the matched positions lie on one line, which does not determine a rotation",
            )
            .remedy("evaluate with origin alignment or none"),
            Self::NoHeading => fail(
                "no-heading",
                "",
                "the matched positions do not move horizontally, which does not determine a heading",
            )
            .remedy("evaluate without alignment"),
            Self::CopiedScans { scans } => fail(
                "copied-scans",
                "walks",
                format!(
                    "two of them share {scans} Wi-Fi scans with the same readings at the same times: comparing a walk with its copy finds every place exactly"
                ),
            )
            .value(*scans as f64, "")
            .remedy("give each walk once"),
            Self::NoKeyframe => fail(
                "start-elsewhere",
                "",
                "no keyframe of the map lies within this trajectory",
            )
            .remedy(OF_THE_MAP),
            Self::AnotherTrajectory { far_cm, far_deg } => fail(
                "start-elsewhere",
                "",
                format!("this is not the trajectory of this map: at its keyframes it differs by up to {far_cm:.1} cm and {far_deg:.2}°"),
            )
            .value(*far_cm, "cm")
            .remedy(OF_THE_MAP),
            Self::Solver(problem) => fail("not-converged", "", problem.to_string())
                .remedy("check units, axes and stamps of what is aligned"),
            _ => return None,
        })
    }
}

fn fail(code: &'static str, subject: impl Into<String>, what: impl Into<String>) -> Finding {
    Finding::new(code, Verdict::Fail, subject, what)
}

fn trajectory(role: &str) -> String {
    format!("{role} trajectory")
}
