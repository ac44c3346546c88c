//! Every refusal is a finding with what to do, and its message is made of it.

use std::path::PathBuf;

use super::*;

fn walk() -> PathBuf {
    PathBuf::from("walk.mcap")
}

fn failed() -> Finding {
    Finding::new("imu-errors", Verdict::Fail, "IMU", "its axes are exchanged")
        .remedy("check the rig file")
}

fn of_walks() -> Vec<Refusal> {
    let path = walk();
    let time = Timestamp::from_nanos(1_500_000_000);
    vec![
        Refusal::NotLocalized {
            path: path.clone(),
            frames: 40,
            localized: 3,
            needed: 5,
        },
        Refusal::MapDisagrees {
            path: path.clone(),
            localized: 20,
            rejected: 17,
            most: 14,
        },
        Refusal::AmbiguousPlace {
            path: path.clone(),
            agreeing: 9,
            rival: 6,
            margin: 2.0,
        },
        Refusal::LooksAlike {
            path: path.clone(),
            matches_here: 900,
            matches_there: 800,
            away_m: 4.0,
            turn_deg: 180.0,
            margin: 1.5,
        },
        Refusal::PointsAbsent {
            path: path.clone(),
            points: 500,
            absent_percent: 48.0,
            limit: 0.07,
        },
        Refusal::FewRecognised {
            path: path.clone(),
            recognised: 2,
            frames: 90,
            needed_share: 0.1,
            moved_m: 0.2,
            points: 12,
            absent_percent: 30.0,
        },
        Refusal::MapPartsDisagree {
            path: path.clone(),
            frames: 90,
            moved_m: 0.31,
            limit_m: 0.1,
        },
        Refusal::ImuContradicts {
            path: path.clone(),
            frames: 90,
            moved_m: 0.31,
            failures: vec![failed(), failed()],
        },
        Refusal::AccelContradicts {
            path: path.clone(),
            axis: 'x',
            felt: [-1.0, 0.0, 0.0],
        },
        Refusal::GyroContradicts {
            axis: 'z',
            images: [0.0, 0.0, -1.0],
        },
        Refusal::TracksContradict {
            share: 0.5,
            limit: 0.2,
        },
        Refusal::FrozenSensor {
            sensor: "gyroscope",
            secs: 3.0,
            of_secs: 10.0,
        },
        Refusal::ImuGap {
            from: Timestamp::from_nanos(0),
            to: time,
            longest_secs: 0.5,
        },
        Refusal::ImuMissing { time },
        Refusal::NoImuTerm {
            path: path.clone(),
            reason: "it has no IMU samples".to_owned(),
        },
        Refusal::NothingCertain {
            path: path.clone(),
            frames: 16,
            limit_m: 0.05,
        },
        Refusal::NothingFollowed {
            frames: 16,
            min_sights: 8,
            limit_m: 0.05,
        },
        Refusal::NoBeginning { frames: 16 },
        Refusal::UnknownCovariance {
            frames: 16,
            problem: lsfb_solver::Error::NotConverged { iterations: 50 },
        },
        Refusal::NotConverged {
            stage: "walk",
            iterations: 50,
        },
        Refusal::FailedMap {
            failures: vec!["cam0: turned by 3°".to_owned()],
        },
        Refusal::FailedAlone {
            path,
            failed: Box::new(failed()),
        },
    ]
}

fn of_maps() -> Vec<Refusal> {
    let (path, time) = (walk(), Timestamp::from_nanos(1_500_000_000));
    vec![
        Refusal::MapsDoNotMeet {
            pairs: 90,
            shared: 30,
            rival: 28,
            sigma_m: 0.1,
            scale_shift_m: 0.2,
        },
        Refusal::SurveysDisagree {
            shift_m: 1.5,
            most_m: 0.1,
        },
        Refusal::SameImages {
            points: 90,
            shared: 100,
        },
        Refusal::MapErrorUnknown { needed: 30 },
        Refusal::MapBudget {
            keyframe: 4,
            time,
            camera: "cam0".to_owned(),
            points: 12,
            needed: 60,
            smallest_mb: 1.25,
        },
        Refusal::too_few_points(3, 12, 30, false),
        Refusal::StartElsewhere {
            path: path.clone(),
            share: 0.2,
            least: 0.5,
        },
        Refusal::NoScan {
            path: path.clone(),
            scans: 100,
            why: None,
        },
        Refusal::EmptyScan { time },
        Refusal::ScanOrder {
            time,
            previous: time,
        },
        Refusal::TooFewScans { scans: 1 },
        Refusal::NoImages {
            path: path.clone(),
            rig: "backpack".to_owned(),
        },
        Refusal::NoKeyframe { path },
        Refusal::FewControlPoints {
            clicked: 2,
            all: 4,
            needed: 3,
        },
        Refusal::ControlPointsOnALine {
            count: 3,
            width_m: 0.01,
            length_m: 8.0,
        },
        Refusal::FewDescriptors {
            count: 10,
            needed: 64,
        },
    ]
}

#[test]
fn every_refusal_says_what_to_do_and_is_made_of_its_finding() {
    let all: Vec<Refusal> = of_walks().into_iter().chain(of_maps()).collect();
    let kinds: std::collections::HashSet<_> = all.iter().map(std::mem::discriminant).collect();
    let variants = include_str!("refusal.rs").matches("#[error(").count();
    assert_eq!(kinds.len(), variants, "a refusal is not tried here");
    for refusal in all {
        let error = Error::from(refusal);
        let found = error.finding().expect("a refusal");
        assert_eq!(found.verdict, Verdict::Fail, "{error}");
        let is_kebab = |c: char| c.is_ascii_lowercase() || c == '-';
        assert!(
            !found.code.is_empty() && found.code.chars().all(is_kebab),
            "{error}"
        );
        let message = error.to_string();
        assert!(message.contains(&found.what), "{message}");
        let remedy = found.remedy.as_deref().expect("what to do");
        assert!(
            message.ends_with(remedy) && !remedy.ends_with(['.', '?']),
            "{message}"
        );
        assert!(
            !found
                .limit
                .is_some_and(|l| l.holds(found.value.unwrap_or(f64::NAN))),
            "{message}"
        );
    }
}

#[test]
fn a_message_reads_as_one_sentence() {
    let said = |refusal: Refusal| Error::from(refusal).to_string();
    let mut of_walks = of_walks().into_iter();
    assert_eq!(
        said(of_walks.next().expect("one")),
        "walk.mcap: 3 of 40 images were localized in the map (at least 5): check that it is the map of this place, and the rig file of this device"
    );
    let absent = of_walks.nth(3).expect("the fifth");
    assert!(
        said(absent).contains(
            "48.0 % of the evidence says that they are absent (at most 7 %); map it again"
        )
    );
}

/// Naively the first walk would be blamed for what another one is refused for, or an unreadable one be called bad data.
#[test]
fn of_another_walk_its_own_path_is_said() {
    let of = |error: Error| Error::OtherWalk {
        path: walk(),
        error: Box::new(error),
    };
    let frozen = of_walks().swap_remove(11);
    let found = of(frozen.into()).finding().expect("a refusal");
    assert_eq!(
        (&*found.code, &*found.subject),
        ("frozen-samples", "walk.mcap, IMU")
    );
    let unread = of(Error::io(&walk())(std::io::Error::other("gone")));
    assert!(unread.finding().is_none());
}
