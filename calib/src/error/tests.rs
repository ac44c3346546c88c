//! Every refusal is a finding with what to do, and its message is made of it.

use std::collections::HashSet;
use std::mem::discriminant;

use lsfb_types::{Finding, Verdict};

use super::*;

fn cam0() -> String {
    "cam0".to_owned()
}

fn of_cameras() -> Vec<Error> {
    vec![
        Error::TargetNotSeen {
            camera: cam0(),
            found: 2,
            images: 40,
            needed: 4,
            target: "april grid".to_owned(),
        },
        Error::CopiedImages {
            camera: cam0(),
            found: 40,
            different: 1,
            needed: 4,
        },
        Error::OtherTarget {
            camera: cam0(),
            target: "april grid".to_owned(),
            images: 40,
            instead: SeenInstead::Mirrored { images: 38 },
        },
        Error::DoesNotFit {
            camera: cam0(),
            rms_px: 8.0,
            target: "april grid".to_owned(),
            model: "radtan",
        },
        Error::AnotherModelFits {
            camera: cam0(),
            model: "radtan",
            rms_px: 8.0,
            other: "kannala-brandt",
            other_rms_px: 0.1,
        },
        Error::Undetermined {
            camera: cam0(),
            parameters: "fx (σ 90 px)".to_owned(),
            advice: "tilt the board",
        },
        Error::SameImages {
            first: cam0(),
            second: "cam1".to_owned(),
        },
        Error::BoardNotSeen {
            found: 0,
            scans: 8,
            needed: 3,
            width_m: 0.8,
            height_m: 0.6,
        },
        Error::OneSided {
            tilt_deg: 3.0,
            needed_deg: 20.0,
            direction: "x".to_owned(),
            advice: "turn the board about its other axis".to_owned(),
        },
        Error::Solver(lsfb_solver::Error::NotConverged { iterations: 50 }),
    ]
}

fn of_reasons() -> Vec<Error> {
    let unit = |problem| Error::Unit {
        what: cam0(),
        problem,
    };
    vec![
        unit(WrongUnit::Stamps {
            step: 33,
            unit: "milliseconds",
        }),
        unit(WrongUnit::NoStamps { step: 0 }),
        unit(WrongUnit::Degrees { rate_rad_s: 90.0 }),
        PoorMotion::NothingSeen.into(),
        PoorMotion::OneAxis.into(),
        PoorMotion::FewTurns {
            axes: vec![("x", 0.01), ("z", 0.02)],
            needed_rad_s: 0.2,
        }
        .into(),
        BadImu::Gravity {
            mean_m_s2: 1.0,
            gravity_m_s2: 9.81,
            is_in_g: true,
        }
        .into(),
        BadImu::LeftHanded { camera: cam0() }.into(),
        BadImu::OtherAxes { camera: cam0() }.into(),
        NoRest::NoSample.into(),
        NoRest::BadSample { index: 3 }.into(),
        NoRest::Short {
            length_s: 10.0,
            needed_s: 60.0,
        }
        .into(),
        NoRest::Missing {
            missing: 10.0,
            all: 100.0,
        }
        .into(),
        NoRest::Repeated {
            repeated: 10,
            all: 100,
        }
        .into(),
        NoRest::Moved { after_s: 3.0 }.into(),
        WrongSize::OtherScale {
            camera: cam0(),
            factor: 1.2,
            edges: "tags of 60 mm".to_owned(),
        }
        .into(),
        WrongSize::Measured {
            pattern: PatternExcess {
                share: 0.02,
                sigma: 0.001,
                edges: "tags of 60 mm".to_owned(),
            },
            also: None,
        }
        .into(),
        WrongSize::Exchanged {
            longer_axis: 'x',
            exchanged: 7,
            poses: 8,
            plate_m: [0.6, 0.8],
        }
        .into(),
    ]
}

fn of_pairs() -> Vec<JoinProblem> {
    vec![
        JoinProblem::FewInstants {
            shared: 0,
            needed: 4,
        },
        JoinProblem::OppositeEnds,
        JoinProblem::ShiftedPairs { by: 1 },
        JoinProblem::Exchanged {
            exchanged: 12,
            shared: 30,
            first_instant: 18,
            last_instant: 29,
        },
        JoinProblem::MissTogether {
            rms_px: f64::INFINITY,
        },
        JoinProblem::Swapped,
        JoinProblem::Misplaced {
            turn_rad: 0.1,
            shift_m: 0.2,
        },
        JoinProblem::NoSample,
        JoinProblem::BadSample { time_s: 1.0 },
        JoinProblem::RepeatedStamps {
            repeated: 10,
            all: 100,
        },
        JoinProblem::FewSamples {
            samples: 1,
            length_s: 30.0,
            within_s: 0.5,
            needed: 10,
        },
        JoinProblem::FewRates {
            pairs: 1,
            length_s: 30.0,
            needed: 10,
        },
        JoinProblem::ClocksDrift {
            first_half_s: 0.0,
            second_half_s: 0.1,
        },
        JoinProblem::FarOffset {
            offset_s: -2.0,
            largest_s: 0.5,
        },
        JoinProblem::InDegrees,
        JoinProblem::TurnApart {
            within_s: 0.5,
            agreement: 0.2,
        },
        JoinProblem::RollingShutter {
            known_s: 0.0,
            found_s: 0.02,
        },
        JoinProblem::MissAlongMotion {
            alone_px: 0.1,
            together_px: 9.0,
        },
        JoinProblem::NotSeen { images: 40 },
        JoinProblem::NoSameNumber {
            images: 8,
            clouds: 8,
        },
        JoinProblem::NoSameTime {
            scans: 8,
            seen: 7,
            images: 8,
        },
        JoinProblem::AlwaysMoving { scans: 8, seen: 8 },
        JoinProblem::PointsOnALine,
        JoinProblem::NoTransformFits {
            found: 2,
            scans: 8,
            needed: 3,
        },
        JoinProblem::FewPoses { left: 2, needed: 3 },
        JoinProblem::WeightsUnsettled,
        JoinProblem::MiddlesApart {
            rms_m: 0.2,
            also: None,
        },
        JoinProblem::NoCamera,
        JoinProblem::NoScans,
        JoinProblem::ShortScans {
            length_s: 3.0,
            needed_s: 10.0,
        },
        JoinProblem::ScansUnregistered,
    ]
}

/// What was given is wrong, not what was measured.
fn of_input() -> Vec<JoinProblem> {
    vec![
        JoinProblem::NamedTwice,
        JoinProblem::SameSensor,
        JoinProblem::NoChain,
        JoinProblem::NoTransform,
        JoinProblem::GivenTwice,
        JoinProblem::NoLidar,
    ]
}

fn joined(cause: JoinProblem) -> Error {
    Error::NotJoined {
        first: cam0(),
        second: "the IMU".to_owned(),
        cause,
    }
}

fn check(error: &Error, found: &Finding) {
    assert_eq!(found.verdict, Verdict::Fail, "{error}");
    let is_kebab = |c: char| c.is_ascii_lowercase() || c == '-';
    assert!(found.code.chars().all(is_kebab), "{error}");
    let message = error.to_string();
    assert!(message.contains(&found.what), "{message}");
    let remedy = found.remedy.as_deref().expect("what to do");
    assert!(message.ends_with(remedy), "{message}");
    let value = found.value.unwrap_or(f64::NAN);
    assert!(!found.limit.is_some_and(|l| l.holds(value)), "{message}");
    // The cause below is said already: whoever prints the chain does not say it twice.
    let cause = std::error::Error::source(error).map(ToString::to_string);
    assert!(
        cause.is_none_or(|cause| message.contains(&cause)),
        "{message}"
    );
}

#[test]
fn every_refusal_says_what_to_do_and_is_made_of_its_finding() {
    let pairs = of_pairs();
    let kinds: HashSet<_> = pairs.iter().chain(&of_input()).map(discriminant).collect();
    let variants = include_str!("join.rs").matches("#[error(").count();
    assert_eq!(kinds.len(), variants, "a cause is not tried here");
    let reasons = include_str!("reasons.rs");
    let reasons = &reasons[reasons.find("pub enum WrongUnit").expect("the first")..];
    assert_eq!(of_reasons().len(), reasons.matches("#[error(").count());
    let all = of_cameras().into_iter().chain(of_reasons());
    for error in all.chain(pairs.into_iter().map(joined)) {
        check(&error, &error.finding().expect("a refusal"));
    }
}

#[test]
fn what_was_given_wrongly_is_no_judgement() {
    for error in of_input().into_iter().map(joined) {
        assert!(error.finding().is_none(), "{error}");
        assert!(
            error.to_string().starts_with("cam0 and the IMU: "),
            "{error}"
        );
    }
    let unknown = Error::Solver(lsfb_solver::Error::UnknownBlock {
        block: 1,
        blocks: 1,
    });
    assert!(unknown.finding().is_none());
    assert!(unknown.to_string().starts_with("solving failed: block 1"));
}

#[test]
fn a_message_reads_as_one_sentence() {
    let said: Vec<String> = of_cameras().iter().map(ToString::to_string).collect();
    assert_eq!(
        said[0],
        "cam0: the target was found in 2 of 40 images (at least 4): check the target's kind and size (april grid), the focus, and that the whole board is lit"
    );
    assert_eq!(
        said[6],
        "cam0 and cam1: they show the same images: give each its own folder or topic"
    );
}
