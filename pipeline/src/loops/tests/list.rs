//! The list that a person edits.

use super::*;

fn result() -> OdometryResult {
    let stops = stops(&[[0.0, -0.5], [4.0, -0.5]], 0.5, 0.0);
    walk(
        &seen(&office(), &stops),
        &stops,
        |_| Vector6::zeros(),
        &Vector6::repeat(0.01),
    )
}

fn loops(walk: &OdometryResult) -> Loops {
    let time = |k: usize| walk.scan_poses[k].pose.time;
    let scores = LoopScores {
        appearance: Some(0.1 + 0.2),
        overlap: Some(0.9),
        rival_overlap: Some(0.0),
        plane_rms_m: Some(0.0123),
        odometry_sigmas: Some(1.5),
    };
    let measured = MeasuredLoop {
        earlier_from_later: Se3::exp(&Vector6::new(0.1, 0.2, 0.3, 1.0 / 3.0, -0.7, 0.1)),
        rotation_sigma_rad: 0.001,
        translation_sigma_m: 0.01,
    };
    let of = |k: usize, decision: LoopDecision, measured: Option<MeasuredLoop>| Loop {
        earlier: time(0),
        later: time(k),
        decision,
        scores,
        measured,
    };
    let rejected = |why| LoopDecision::Rejected(why);
    Loops {
        all: vec![
            of(3, LoopDecision::Accepted, Some(measured)),
            of(4, rejected(LoopRejection::Ambiguous), Some(measured)),
            of(5, rejected(LoopRejection::ContradictsOdometry), None),
        ],
    }
}

fn read(text: &str, walk: &OdometryResult) -> Result<Loops, String> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("loops.txt");
    std::fs::write(&path, text).expect("a file");
    Loops::read(&path, walk).map_err(|e| e.to_string())
}

#[test]
fn what_was_written_is_read_back_bit_by_bit() {
    let walk = result();
    let loops = loops(&walk);
    assert_eq!(read(&loops.to_text(), &walk), Ok(loops));
}

#[test]
fn a_person_accepts_and_rejects() {
    let walk = result();
    let text = loops(&walk).to_text();
    let swapped = text
        .replace("\naccept ", "\nXX ")
        .replacen("\nreject ", "\naccept ", 1);
    let edited = read(&swapped.replace("\nXX ", "\nreject "), &walk).expect("a list");
    assert_eq!(
        edited.all[0].decision,
        LoopDecision::Rejected(LoopRejection::ByHand)
    );
    assert_eq!(edited.all[1].decision, LoopDecision::Accepted);
    assert_eq!(edited.accepted().count(), 1);
}

#[test]
fn what_makes_no_sense_is_refused_with_its_line() {
    let walk = result();
    let text = loops(&walk).to_text();
    let first = walk.scan_poses[3].pose.time.to_string();
    for (edited, words) in [
        (text.replace("\nreject ", "\naccept "), "was not measured"),
        (text.replace(&first, "99.000000000"), "no scan of this walk"),
        (text.replace("accept 0", "maybe 0"), "neither"),
        (text.replace("0.9", "NaN"), "is not a number"),
        (text.replace(" ambiguous", ""), "17 columns"),
        (text.replace("0.01 -", "-0.01 -"), "more than 0"),
    ] {
        let refused = read(&edited, &walk).expect_err(words);
        assert!(
            refused.contains(words) && refused.contains("loops.txt:"),
            "{refused}"
        );
    }
}
