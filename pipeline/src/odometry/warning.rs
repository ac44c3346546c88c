//! What the reader of a trajectory should know.

use lsfb_types::{Finding, Limit, Verdict};
use serde::{Deserialize, Serialize};

use super::ring_order::AzimuthProblem;
use super::unseen::UnseenStretch;

/// A loop that contradicts the odometry by more is none: twice what no loop is accepted beyond without a person's word, in standard deviations.
const MOST_LOOP_SIGMAS: f64 = 10.0;

/// Where a pose may be farther off than this in one direction, its place is not found, metres.
pub(super) const MAX_SIGMA_M: f64 = 1.0;

/// Scans that are farther apart than this see too little in common for their covariances to be relied on, seconds.
pub(super) const RARE_SCANS_S: f64 = 1.0;

/// Where scans are deskewed by times and an IMU leads, more of a scan than this agrees with the map: 0.84 and more in nine simulated places, 0.44 with
/// an accelerometer of the wrong sign.
pub(super) const USUAL_AGREEMENT: f64 = 0.6;
/// The same over ten seconds, in which somebody may go through a door.
pub(super) const LEAST_AGREEMENT: f64 = 0.5;

/// Half of the pairs of a stretch are off by more: metres. Right ones come to three centimetres at most.
pub(super) const MAX_APART_M: f64 = 0.06;

/// Something the reader of a trajectory should know.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
#[non_exhaustive]
pub enum OdometryWarning {
    /// Scans found no place in the map and have no pose.
    Lost {
        /// How many.
        lost: u64,
        /// Of how many.
        scans: u64,
    },
    /// The trajectory ends before the recording.
    LostAtEnd {
        /// Scans behind the last pose.
        scans: u64,
    },
    /// One scan alone has a pose, which is the world's origin: nothing was measured.
    OnePose {
        /// Scans there are.
        scans: u64,
    },
    /// For much longer than scans are usually apart there is none with a pose.
    LidarGap {
        /// The last before and the first behind it, seconds after the first scan of all.
        from_s: f64,
        /// See `from_s`.
        to_s: f64,
    },
    /// The IMU measured nothing, or the same again and again.
    ImuPause {
        /// From when, seconds after the first scan of all.
        from_s: f64,
        /// Until when.
        to_s: f64,
    },
    /// Loops were closed that contradict one another, or the odometry.
    LoopDisagrees {
        /// How far the worst of them is from where the odometry had it, or still from what was measured, in standard deviations (a norm over six numbers).
        sigmas: f64,
    },
    /// The recording ends within a scan, of which too little is there to find its place.
    Piece {
        /// How much of it is there, by its time.
        share: f64,
    },
    /// Scans do not see all of the motion.
    Unseen {
        /// When, which, and how far it may be off.
        stretch: UnseenStretch,
    },
    /// In a stretch in which scans do not see all of the motion the accelerometer alone has it, and no scan of the walk tells whether that is right.
    AccelerometerUntold {
        /// First and last scan, seconds after the first scan of all.
        from_s: f64,
        /// See `from_s`.
        to_s: f64,
        /// Unit vector of the motion in the world.
        direction_in_world: [f64; 3],
        /// How far poses are off at most if the accelerometer is turned round along it, metres.
        off_m: f64,
    },
    /// Where the recording ends is not known.
    EndUncertain {
        /// Standard deviation of the last pose's place in its worst direction, metres.
        sigma_m: f64,
    },
    /// Somewhere on the way it is not known where the walk is, though it is at the end.
    StretchUncertain {
        /// When it is known worst, seconds after the first scan of all.
        at_s: f64,
        /// Standard deviation of the place there in its worst direction, metres.
        sigma_m: f64,
    },
    /// For ten seconds little of the scans agrees with the map.
    StretchDisagrees {
        /// From when on, seconds after the first scan of all.
        from_s: f64,
        /// Mean share of the keypoints that agree.
        share: f64,
    },
    /// Scans were empty, out of order, or before the first inertial sample.
    Skipped {
        /// How many.
        skipped: u64,
        /// Of how many.
        scans: u64,
    },
    /// Scans are the one before them once more, number by number.
    Repeated {
        /// How many.
        repeated: u64,
        /// Of how many.
        scans: u64,
    },
    /// Scans were used as if the sensor had stood still.
    NotDeskewed {
        /// How many.
        scans: u64,
        /// Of how many.
        of: u64,
        /// Field that should hold the times of the points.
        field: Option<String>,
        /// Of all scans, those that would last too long by the times of their points.
        not_believed: u64,
        /// Why azimuths tell nothing either, where they were to stand for times.
        #[serde(default)]
        azimuths: Option<AzimuthProblem>,
    },
    /// Scans were deskewed by azimuth.
    DeskewedByAzimuth {
        /// How many.
        scans: u64,
        /// Of how many.
        of: u64,
        /// Of the former, those that are ordered ring by ring.
        #[serde(default)]
        ring_by_ring: u64,
        /// Of those in firing order, those of which nothing tells whether they had been deskewed before.
        #[serde(default)]
        unnumbered: u64,
    },
    /// The accelerometer measures in units of gravity.
    AccelerometerInGravities,
    /// Scans are so rare that covariances are not to be relied on.
    RareScans {
        /// Usual time from one registered scan to the next, seconds.
        interval_s: f64,
    },
    /// There is an IMU that cannot be used.
    ImuNotUsed {
        /// Why.
        reason: String,
    },
    /// Gyroscope and scans turn about different axes: the rig has the LiDAR wrongly on the IMU.
    ExtrinsicRotation {
        /// By how much at least, degrees: poses lean on the gyroscope too.
        off_deg: f64,
        /// Standard deviation of that, degrees.
        sigma_deg: f64,
    },
    /// A sensor of the IMU has other axes than the rig.
    ImuAxes {
        /// `gyroscope` or `accelerometer`.
        sensor: String,
        /// What the rig's x, y and z are of its own, as (-x, y, z).
        right: String,
    },
    /// The IMU's stamps are late against the scans', or early.
    ImuClock {
        /// By how much they are late, seconds.
        late_s: f64,
        /// Standard deviation of that, seconds.
        sigma_s: f64,
    },
    /// Scans lie elsewhere on each other than the trajectory has them.
    ScansApart {
        /// Half of the pairs of the worst stretch, a second apart, by more than this, metres.
        off_m: f64,
        /// First and last scan of that stretch, seconds after the first scan of all.
        from_s: f64,
        /// See `from_s`.
        to_s: f64,
    },
    /// Scans share too little with those a second before to tell whether the trajectory has them where they lie on each other.
    ScansUnchecked {
        /// First and last scan, seconds after the first scan of all.
        from_s: f64,
        /// See `from_s`.
        to_s: f64,
    },
    /// Scans and accelerometer measure in different units, or lengths that differ by percents.
    Scale {
        /// Accelerations by the scans as a multiple of those by the accelerometer.
        scale: f64,
        /// Its standard deviation.
        sigma: f64,
    },
    /// Little of the scans agrees with the map.
    LittleAgreement {
        /// Mean share of a scan that does.
        share: f64,
    },
    /// The carrier moved at the start, and its IMU felt nothing.
    BeganUnfelt,
    /// Scans have hardly a point where points are used.
    OutOfRange {
        /// How many of how many, where they are instead, and why that may be.
        what: String,
    },
    /// The world is not level.
    NoImu {
        /// Whether scans were deskewed all the same.
        deskewed: bool,
    },
    /// A part of the recording could not be read.
    Damaged {
        /// Which, and why.
        what: String,
    },
}

impl OdometryWarning {
    /// As every command and page says it.
    pub fn finding(&self) -> Finding {
        let of =
            |code: &'static str, what: String| Finding::new(code, self.verdict(), "odometry", what);
        match self {
            Self::Lost { lost, scans } => of(
                "lost",
                format!("{lost} of {scans} scans could not be registered and have no pose"),
            )
            .value(*lost as f64, ""),
            Self::LostAtEnd { scans } => of(
                "lost-at-end",
                format!("the last {scans} scans could not be registered: the trajectory ends before them"),
            )
            .value(*scans as f64, ""),
            Self::OnePose { scans } => of(
                "one-pose",
                match scans {
                    1 => "there is one scan, and its pose is the origin by definition: no motion was measured".to_owned(),
                    _ => format!(
                        "only one of {scans} scans has a pose, which is the origin by definition: no motion was measured"
                    ),
                },
            )
            .remedy("give a recording in which scans overlap"),
            Self::LidarGap { from_s, to_s } => of(
                "lidar-gap",
                format!(
                    "from {from_s:.1} to {to_s:.1} s no scan has a pose, and the motion comes from the IMU alone: no poses are written there, and later ones may be off by the IMU's drift"
                ),
            )
            .value(to_s - from_s, "s"),
            Self::ImuPause { from_s, to_s } => of(
                "imu-pause",
                format!(
                    "from {from_s:.1} to {to_s:.1} s the IMU sent no samples, or repeated the same one: scans are predicted and deskewed there with its last sample, and may be wrong from there on"
                ),
            )
            .value(to_s - from_s, "s")
            .remedy("check its cable (`lsfb doctor`), or run without the IMU"),
            Self::LoopDisagrees { sigmas } => {
                let finding = of(
                    "loop-disagrees",
                    format!(
                        "a closed loop is {sigmas:.0} standard deviations off: it contradicts the odometry or the other loops and bends the trajectory"
                    ),
                )
                .value(*sigmas, "σ")
                .remedy("look for a false one");
                match finding.verdict {
                    Verdict::Fail => finding.limit(Limit::AtMost(MOST_LOOP_SIGMAS)),
                    _ => finding,
                }
            }
            Self::Piece { share } => of(
                "last-piece",
                format!(
                    "the recording ends within a scan: the available {:.0} % of it could not be registered and are left out",
                    (share * 100.0).ceil()
                ),
            )
            .value(100.0 * share, "%"),
            Self::Unseen { stretch } => {
                let (sigma, unit) = stretch.sigma_with_unit();
                of("unseen-motion", stretch.to_string()).value(sigma, unit)
            }
            Self::AccelerometerUntold {
                from_s,
                to_s,
                direction_in_world: [x, y, z],
                off_m,
            } => of(
                "accelerometer-untold",
                format!(
                    "from {from_s:.1} to {to_s:.1} s the motion along ({x:.2}, {y:.2}, {z:.2}) comes from the accelerometer alone, and no scan of the walk checks that axis: if its sign is wrong, poses are {off_m:.1} m off (included in the covariances)"
                ),
            )
            .value(*off_m, "m")
            .remedy(
                "walk a stretch where scans constrain such motion, or check the IMU's axes",
            ),
            Self::EndUncertain { sigma_m } => of(
                "end-uncertain",
                format!(
                    "the last pose may be {sigma_m:.1} m off (one standard deviation): the scans do not determine where the recording ends"
                ),
            )
            .value(*sigma_m, "m")
            .limit(Limit::AtMost(MAX_SIGMA_M)),
            Self::StretchUncertain { at_s, sigma_m } => of(
                "stretch-uncertain",
                format!(
                    "at {at_s:.1} s the pose may be {sigma_m:.1} m off (one standard deviation), although the end is known"
                ),
            )
            .value(*sigma_m, "m")
            .limit(Limit::AtMost(MAX_SIGMA_M))
            .remedy("do not use the poses in between"),
            Self::Skipped { skipped, scans } => of(
                "skipped",
                format!(
                    "{skipped} of {scans} scans were empty, out of order, or before the first IMU sample"
                ),
            )
            .value(*skipped as f64, ""),
            Self::Repeated { repeated, scans } => of(
                "repeated-scans",
                format!(
                    "{repeated} of {scans} scans are exact copies of the previous one, which no sensor produces: the LiDAR or its driver hung, or files were written twice; the trajectory stands still there whatever the motion was"
                ),
            )
            .value(*repeated as f64, ""),
            Self::NotDeskewed {
                scans,
                of: all,
                field,
                not_believed,
                azimuths,
            } => of(
                "not-deskewed",
                not_deskewed(*scans, *all, field.as_deref(), *not_believed)
                    + &about_azimuths(*azimuths),
            )
            .value(*scans as f64, ""),
            Self::DeskewedByAzimuth {
                scans,
                of: all,
                ring_by_ring,
                unnumbered,
            } => of(
                "deskewed-by-azimuth",
                by_azimuth(*scans, *all, *ring_by_ring, *unnumbered),
            )
            .value(*scans as f64, ""),
            Self::AccelerometerInGravities => of(
                "accelerometer-unit",
                "the accelerometer is in units of gravity: multiplied by 9.80665 m/s²"
                    .to_owned(),
            ),
            Self::RareScans { interval_s } => of(
                "rare-scans",
                format!(
                    "scans are {interval_s:.1} s apart: where few of them saw a surface, one may be registered to the wrong surface, and the covariances do not include that"
                ),
            )
            .value(*interval_s, "s")
            .limit(Limit::AtMost(RARE_SCANS_S)),
            Self::ImuNotUsed { reason } => {
                of("imu-not-used", format!("the IMU is not used: {reason}"))
            }
            Self::ExtrinsicRotation { off_deg, sigma_deg } => of(
                "extrinsic-rotation",
                format!(
                    "gyroscope and scans rotate about different axes: the LiDAR's rotation relative to the IMU is off by at least {off_deg:.1}° ± {sigma_deg:.1}° (one standard deviation), and poses are wrong by it"
                ),
            )
            .value(*off_deg, "°")
            .sigma(*sigma_deg)
            .remedy("calibrate the rig, or run without the IMU"),
            Self::ImuAxes { sensor, right } => of("imu-axes", axes_sentence(sensor, right)).remedy(
                "fix the rotations in the rig file or the IMU's driver, or run without the IMU",
            ),
            Self::ImuClock { late_s, sigma_s } => of(
                "imu-clock",
                format!(
                    "gyroscope and scans agree if the IMU's stamps are {:.0} ± {:.0} ms (one standard deviation) too {}: the path between scans is wrong by it, and the poses of scans may be too",
                    late_s.abs() * 1e3,
                    sigma_s * 1e3,
                    if *late_s > 0.0 { "late" } else { "early" }
                ),
            )
            .value(late_s * 1e3, "ms")
            .sigma(sigma_s * 1e3)
            .remedy("synchronise the clocks, or run without the IMU"),
            Self::ScansApart {
                off_m,
                from_s,
                to_s,
            } => of(
                "scans-apart",
                format!(
                    "from {from_s:.1} to {to_s:.1} s (the worst stretch) scans a second apart disagree with the trajectory by {off_m:.2} m (median): the IMU pulls them away, and the trajectory may be metres off"
                ),
            )
            .value(*off_m, "m")
            .limit(Limit::AtMost(MAX_APART_M))
            .remedy(
                "run without the IMU to see whether an axis, the sign, the unit or the clock of the accelerometer is wrong",
            ),
            Self::ScansUnchecked { from_s, to_s } => of(
                "scans-unchecked",
                format!(
                    "from {from_s:.1} to {to_s:.1} s scans are too few, or overlap too little with those of a second before, to check whether the IMU pulls them away"
                ),
            )
            .value(to_s - from_s, "s"),
            Self::Scale { scale, sigma } => of("scale", scale_sentence(*scale, *sigma))
                .value(*scale, "")
                .sigma(*sigma)
                .remedy(scale_remedy(*scale)),
            Self::LittleAgreement { share } => of(
                "little-agreement",
                format!(
                    "only {:.0} % of a scan agrees with the map on average; with a matching IMU it is 80 % or more: poses may be metres off",
                    share * 100.0
                ),
            )
            .value(100.0 * share, "%")
            .limit(Limit::AtLeast(100.0 * USUAL_AGREEMENT))
            .remedy(
                "run without the IMU to see whether one of its axes or signs is wrong (at rest it measures 9.81 m/s² upwards), or the LiDAR's rotation relative to it",
            ),
            Self::StretchDisagrees { from_s, share } => of(
                "stretch-disagrees",
                format!(
                    "for ten seconds from {from_s:.1} s only {:.0} % of a scan agrees with the map; with a matching IMU it is 80 % or more: poses from there on may be wrong",
                    share * 100.0
                ),
            )
            .value(100.0 * share, "%")
            .limit(Limit::AtLeast(100.0 * LEAST_AGREEMENT))
            .remedy(
                "check whether the IMU or the LiDAR slipped, or most of the scene was moving",
            ),
            Self::BeganUnfelt => of(
                "began-unfelt",
                "at the start the scans moved, but the IMU did not sense it (steady motion): the first second may be decimetres off, and everything after it as well"
                    .to_owned(),
            )
            .remedy("stand still for a second at the start, or begin at walking pace"),
            Self::OutOfRange { what } => of("out-of-range", what.clone()),
            Self::NoImu { deskewed } => {
                let deskewed = match deskewed {
                    true => "scans were deskewed by the motion between them, and ",
                    false => "",
                };
                of(
                    "no-imu",
                    format!("no IMU: {deskewed}the world is not gravity-aligned"),
                )
            }
            Self::Damaged { what } => of("damaged", what.clone()),
        }
    }

    /// What makes poses wrong for certain fails a trajectory; the rest leaves something out of it, or widens it.
    fn verdict(&self) -> Verdict {
        match self {
            Self::OnePose { .. }
            | Self::ExtrinsicRotation { .. }
            | Self::ImuAxes { .. }
            | Self::ImuClock { .. }
            | Self::ScansApart { .. } => Verdict::Fail,
            // Less, and it may be the accelerometer's own scale.
            Self::Scale { scale, .. } if (scale - 1.0).abs() > LARGEST_SCALE_OFF => Verdict::Fail,
            Self::LoopDisagrees { sigmas } if *sigmas > MOST_LOOP_SIGMAS => Verdict::Fail,
            _ => Verdict::Warn,
        }
    }
}

/// What no accelerometer is off by, as a share: beyond, ranges are.
const LARGEST_SCALE_OFF: f64 = 0.05;
/// As far as ranges of a LiDAR in metres may be off: its calibration, or a temperature.
const LARGEST_RANGE_OFF: f64 = 0.2;
/// Factors that units make, as far as one scatters about them, and what they are.
const UNITS: [(f64, &str); 6] = [
    (1000.0, "clouds in millimetres"),
    (100.0, "clouds in centimetres"),
    (39.37, "clouds in inches"),
    (9.807, "an accelerometer in units of gravity"),
    (3.281, "clouds in feet"),
    (0.102, "an accelerometer that was multiplied by 9.81 twice"),
];
/// A factor within this of one of them, as a share, is taken for it.
const NEAR_UNIT: f64 = 0.2;

fn axes_sentence(sensor: &str, right: &str) -> String {
    let why = match (sensor, right) {
        ("accelerometer", "(-x, -y, -z)") => {
            ", which means a wrong sign: at rest it must measure 9.81 m/s² upwards"
        }
        _ => "",
    };
    format!(
        "the {sensor} fits the scans by far best if the rig's axes x, y and z are its own {right}{why}; trajectory and gravity are wrong"
    )
}

/// What a factor is of a unit that was taken for another.
fn unit_of(scale: f64) -> Option<&'static (f64, &'static str)> {
    let mut units = UNITS.iter();
    units.find(|(factor, _)| (scale / factor - 1.0).abs() < NEAR_UNIT)
}

/// Nothing where a unit or a sign explains it.
fn scale_remedy(scale: f64) -> &'static str {
    match (scale - 1.0).abs() < LARGEST_RANGE_OFF {
        true => {
            "measure a known distance with the LiDAR, and check that the accelerometer measures 9.81 m/s² at rest"
        }
        false => "",
    }
}

fn scale_sentence(scale: f64, sigma: f64) -> String {
    let why = match unit_of(scale) {
        _ if scale < 0.0 => {
            "the accelerometer has the wrong sign: at rest it must measure 9.81 m/s² upwards"
                .to_owned()
        }
        Some((_, unit)) => format!("as with {unit}"),
        None if (scale - 1.0).abs() < LARGEST_RANGE_OFF => format!(
            "ranges (and the path) are {:.1} % too {}, or the accelerometer's scale is off",
            100.0 * (scale - 1.0).abs(),
            if scale > 1.0 { "long" } else { "short" }
        ),
        None => "a unit is wrong, or the IMU does not belong to this LiDAR".to_owned(),
    };
    format!(
        "accelerations from the scans are {scale:.3} ± {sigma:.3} times those of the accelerometer: {why}; trajectory and covariances are wrong by that factor"
    )
}

fn not_deskewed(scans: u64, of: u64, field: Option<&str>, not_believed: u64) -> String {
    let these = format!("{scans} of {of} scans");
    match (field, not_believed) {
        (Some(field), 0) => format!(
            "the field `{field}` has no usable point times in {these}: these scans are not deskewed"
        ),
        (None, 0) => {
            format!("the points of {these} have no times: these scans are not deskewed")
        }
        (field, not_believed) => format!(
            "according to the times of their points{}, {not_believed} scans would take longer than the time between scans: {these} are not deskewed",
            field.map_or(String::new(), |f| format!(" (`{f}`)"))
        ),
    }
}

fn about_azimuths(problem: Option<AzimuthProblem>) -> String {
    problem.map_or_else(String::new, |problem| {
        format!(" (not by azimuth either: {})", problem.sentence())
    })
}

fn by_azimuth(scans: u64, of: u64, ring_by_ring: u64, unnumbered: u64) -> String {
    let these = format!("{scans} of {of} scans were deskewed by azimuth, which assumes that");
    let order = match ring_by_ring {
        0 => format!("{these} their points are in firing order"),
        n if n == scans => format!(
            "{these} every ring, stored one after the other, starts with the sensor's revolution"
        ),
        n => format!(
            "{these} their points are in firing order, or, in {n} of them, that every ring starts with the sensor's revolution"
        ),
    };
    if unnumbered == 0 {
        return order;
    }
    let whose = match unnumbered {
        n if n == scans => "their points carry".to_owned(),
        n => format!("points of {n} of them carry"),
    };
    format!(
        "{order}; {whose} no ring numbers, so nothing tells whether they had been deskewed already"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Naively what to do stood in the middle of what was found, where no page, table or program could tell one from the other.
    #[test]
    fn numbers_limits_and_remedies_stand_in_fields_of_their_own() {
        let late = OdometryWarning::ImuClock {
            late_s: -0.045,
            sigma_s: 0.003,
        };
        let late = late.finding();
        assert_eq!(
            (late.code.as_ref(), late.verdict),
            ("imu-clock", Verdict::Fail)
        );
        let close =
            |found: Option<f64>, value: f64| found.is_some_and(|f| (f - value).abs() < 1e-9);
        assert!(close(late.value, -45.0) && close(late.sigma, 3.0) && late.unit == "ms");
        assert!(!late.what.contains("without the IMU"), "{}", late.what);
        assert_eq!(
            late.remedy.as_deref(),
            Some("synchronise the clocks, or run without the IMU")
        );

        let lost = OdometryWarning::EndUncertain { sigma_m: 2.5 };
        assert_eq!(
            lost.finding().crossed_limit().as_deref(),
            Some("at most 1 m")
        );
        let little = OdometryWarning::LittleAgreement { share: 0.44 }.finding();
        assert_eq!(little.crossed_limit().as_deref(), Some("at least 60 %"));
        assert!(close(little.value, 44.0), "{little:?}");
    }

    /// Ten standard deviations are the limit of a failure: of seven it would say that they are within it.
    #[test]
    fn a_limit_that_is_not_crossed_is_not_given() {
        let disagreement = |sigmas| OdometryWarning::LoopDisagrees { sigmas }.finding();
        assert_eq!(disagreement(7.0).crossed_limit(), None);
        assert_eq!(
            disagreement(12.0).crossed_limit().as_deref(),
            Some("at most 10 σ")
        );
    }

    /// What a unit or a sign explains needs no measuring tape.
    #[test]
    fn percents_of_scale_are_to_be_measured() {
        let remedy = |scale| {
            OdometryWarning::Scale { scale, sigma: 0.01 }
                .finding()
                .remedy
        };
        assert!(remedy(1.08).is_some_and(|r| r.contains("known distance")));
        assert_eq!((remedy(1000.0), remedy(-1.0)), (None, None));
    }
}
