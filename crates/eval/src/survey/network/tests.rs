use lsfb_types::Verdict;

use super::*;

fn tape(kind: TapeKind, a: &str, b: &str, distance_m: f64, sigma_m: f64) -> Tape {
    Tape {
        kind,
        ends: [a.to_owned(), b.to_owned()],
        distance_m,
        sigma_m,
    }
}

fn survey(tapes: Vec<Tape>) -> Survey {
    Survey {
        tapes,
        line_sigma_m: 0.001,
        visits: Vec::new(),
        points: Default::default(),
    }
}

/// Numbers of a Gauss–Newton adjustment with numeric Jacobians in NumPy 2.
#[test]
fn a_small_network_is_as_numpy_has_it() {
    use TapeKind::{Free, Horizontal, Vertical};
    let found = solve_survey(&survey(vec![
        tape(Horizontal, "p1", "p2", 1.2003, 0.001),
        tape(Horizontal, "p2", "p3", 1.1992, 0.001),
        tape(Horizontal, "p1", "p3", 2.4009, 0.001),
        tape(Horizontal, "q1", "q2", 1.2011, 0.001),
        tape(Vertical, "p1", "q1", 2.4004, 0.001),
        tape(Vertical, "p2", "q2", 2.3991, 0.001),
        tape(Free, "p1", "q2", 2.6838, 0.002),
    ]))
    .expect("determined");
    for (name, x_m, y_m, sigma_x_m, sigma_y_m) in [
        ("p1", 0.0, 0.0, 0.0, 0.0),
        ("p2", 1.20083999, 2.61737353e-4, 0.00073489, 0.00072382),
        ("p3", 2.40046999, 1.30903850e-4, 0.00079688, 0.00079434),
        ("q1", -7.49953139e-5, 2.40007724, 0.00084785, 0.00083284),
        ("q2", 1.20094998, 2.39975447, 0.00093561, 0.00088003),
    ] {
        let mark = found.marks.iter().find(|m| m.name == name).expect(name);
        assert!(
            (mark.x_m - x_m).abs() < 2e-8 && (mark.y_m - y_m).abs() < 2e-8,
            "{mark:?}"
        );
        assert!((mark.sigma_x_m - sigma_x_m).abs() < 2e-8, "{mark:?}");
        assert!((mark.sigma_y_m - sigma_y_m).abs() < 2e-8, "{mark:?}");
    }
    let redundancy = [
        0.45994438, 0.47608584, 0.36498477, 0.36902191, 0.36498477, 0.36902102, 0.28115254,
        0.30638995, 0.30638089, 0.28115357, 0.32119973, 0.28486866, 0.81481198,
    ];
    let w = [
        0.7962575,
        0.37933514,
        0.71176968,
        -0.21537381,
        -0.71176968,
        0.21548987,
        -0.14141801,
        -0.58312512,
        -0.58309734,
        -0.14143677,
        0.69296696,
        0.20607602,
        -0.17338669,
    ];
    assert_eq!(found.observations.len(), 13);
    for (report, (redundancy, w)) in found.observations.iter().zip(redundancy.iter().zip(w)) {
        assert!((report.redundancy - redundancy).abs() < 1e-5, "{report:?}");
        assert!((report.w.expect("checked") - w).abs() < 2e-4, "{report:?}");
    }
    assert_eq!(found.degrees_of_freedom, 5);
    assert!((found.sigma0.expect("checked") - 0.48469077).abs() < 1e-6);
    assert!(
        found.findings.iter().all(|f| f.verdict == Verdict::Pass),
        "{:?}",
        found.findings
    );
}

/// Fifteen marks as in the paper: ten in a row, five above, neighbours and neighbours but one measured.
fn paper(noise_m: impl Fn(usize) -> f64) -> Survey {
    let mut tapes = Vec::new();
    let mut add = |kind, a: &str, b: &str, distance_m: f64| {
        let distance_m = distance_m + noise_m(tapes.len());
        tapes.push(tape(kind, a, b, distance_m, 0.001));
    };
    for (row, count) in [("p", 10), ("q", 5)] {
        for i in 1..count {
            for j in i + 1..=(i + 3).min(count) {
                let (a, b) = (format!("{row}{i}"), format!("{row}{j}"));
                add(TapeKind::Horizontal, &a, &b, 1.8 * (j - i) as f64);
            }
        }
    }
    for i in 1..=5 {
        add(TapeKind::Vertical, &format!("p{i}"), &format!("q{i}"), 4.2);
    }
    survey(tapes)
}

fn noise(i: usize) -> f64 {
    0.0015 * (((i as f64 + 1.0) * 12.9898).sin() * 43_758.545).fract()
}

#[test]
fn the_papers_marks_are_found_to_a_millimetre() {
    let found = solve_survey(&paper(noise)).expect("determined");
    assert_eq!(found.marks.len(), 15);
    for mark in &found.marks {
        let number: f64 = mark.name[1..].parse().expect("a number");
        let y_m = if mark.name.starts_with('p') { 0.0 } else { 4.2 };
        assert!((mark.x_m - 1.8 * (number - 1.0)).abs() < 0.003, "{mark:?}");
        assert!((mark.y_m - y_m).abs() < 0.004, "{mark:?}");
    }
    let sum: f64 = found.observations.iter().map(|o| o.redundancy).sum();
    assert!((sum - found.degrees_of_freedom as f64).abs() < 1e-6);
    assert!(found.observations.iter().all(|o| !o.left_out));
}

/// Least squares spreads a wrong reading over its neighbours: the largest residual alone may be of a good one.
#[test]
fn every_wrong_reading_is_named() {
    let good = paper(noise);
    let count = good.tapes.len();
    for wrong in 0..count {
        let mut survey = good.clone();
        survey.tapes[wrong].distance_m += 0.05;
        let [a, b] = survey.tapes[wrong].ends.clone();
        let found = solve_survey(&survey).expect("determined");
        let named = found
            .findings
            .iter()
            .find(|f| f.code == "blunder")
            .expect("named");
        assert!(
            named.subject == format!("{a}–{b}") || named.what.contains(&format!("{a}–{b}")),
            "{named:?}"
        );
        if named.verdict == Verdict::Warn {
            let left_out: Vec<&str> = found
                .observations
                .iter()
                .filter(|o| o.left_out)
                .map(|o| o.what.as_str())
                .collect();
            assert_eq!(left_out, [format!("{a}–{b}")]);
            assert!(
                named.what.contains("off by about +5") || named.what.contains("off by about +4"),
                "{named:?}"
            );
        }
    }
}

#[test]
fn what_nothing_checks_is_said() {
    use TapeKind::{Horizontal, Vertical};
    let found = solve_survey(&survey(vec![
        tape(Horizontal, "a", "b", 2.0, 0.001),
        tape(Vertical, "a", "c", 3.0, 0.001),
    ]))
    .expect("determined");
    assert!(found.sigma0.is_none() && found.degrees_of_freedom == 0);
    let codes: Vec<&str> = found.findings.iter().map(|f| f.code.as_ref()).collect();
    assert_eq!(codes, ["unchecked", "fit"]);
    let text = serde_json::to_string(&found).expect("serializable");
    assert!(!text.contains("null"), "{text}");
    let stray = solve_survey(&survey(vec![
        tape(Horizontal, "a", "b", 2.0, 0.001),
        tape(TapeKind::Free, "b", "c", 3.0, 0.001),
    ]))
    .expect_err("c may be anywhere around b")
    .to_string();
    assert!(stray.contains("mark c"), "{stray}");
}

#[test]
fn tapes_alone_make_a_network() {
    let places: [(&str, f64, f64); 5] = [
        ("a", 0.0, 0.0),
        ("b", 4.0, 0.0),
        ("c", 3.5, 2.5),
        ("d", 0.5, 3.0),
        ("e", 2.0, -1.5),
    ];
    let mut tapes = Vec::new();
    for (i, (a, ax, ay)) in places.iter().enumerate() {
        for (b, bx, by) in &places[i + 1..] {
            let distance_m = (ax - bx).hypot(ay - by) + noise(tapes.len());
            tapes.push(tape(TapeKind::Free, a, b, distance_m, 0.001));
        }
    }
    let found = solve_survey(&survey(tapes.clone())).expect("determined");
    for (name, x, y) in places {
        let place = found.place(name).expect(name);
        // The side is free: c was taken for the left one.
        assert!(
            (place.x - x).abs() < 0.003 && (place.y.abs() - f64::abs(y)).abs() < 0.003,
            "{name} {place}"
        );
    }
    let [c, e] = ["c", "e"].map(|name| found.place(name).expect(name));
    assert!(c.y * e.y < 0.0);
    // e by two distances only may lie on either side.
    let few: Vec<Tape> = tapes
        .into_iter()
        .filter(|t| !t.ends.contains(&"e".to_owned()) || t.ends[0] == "a" || t.ends[0] == "b")
        .collect();
    let refused = solve_survey(&survey(few))
        .expect_err("two places")
        .to_string();
    assert!(
        refused.contains("mark e: it fits at two positions"),
        "{refused}"
    );
}

/// Two blunders of thirty-eight: both named, one after the other.
#[test]
fn two_wrong_readings_are_both_named() {
    let mut survey = paper(noise);
    survey.tapes[4].distance_m += 0.1;
    survey.tapes[20].distance_m -= 0.04;
    let found = solve_survey(&survey).expect("determined");
    let left_out = found.observations.iter().filter(|o| o.left_out).count();
    assert_eq!(left_out, 2, "{:?}", found.findings);
}
