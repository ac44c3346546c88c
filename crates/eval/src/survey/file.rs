//! A survey as a text file.

use std::collections::BTreeMap;
use std::path::Path;

use lsfb_geometry::Vector3;

use crate::Error;

/// As good as a laser rangefinder's datasheet, and the paper's value.
const DEFAULT_SIGMA_M: f64 = 0.001;
/// A survey is written by hand.
const MAX_BYTES: u64 = 1 << 20;
/// Marks beyond which nobody measures by hand.
const MAX_MARKS: usize = 500;

/// Which way a tape lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TapeKind {
    /// Along x, to the right: both marks have one y.
    Horizontal,
    /// Along y, upwards: both marks have one x.
    Vertical,
    /// Any way.
    Free,
}

/// One measured distance.
#[derive(Clone, Debug, PartialEq)]
pub struct Tape {
    /// Which way it lies.
    pub kind: TapeKind,
    /// The marks at its ends.
    pub ends: [String; 2],
    /// What was read, metres.
    pub distance_m: f64,
    /// Its standard deviation, metres.
    pub sigma_m: f64,
}

/// What was measured on the floor.
#[derive(Clone, Debug, PartialEq)]
pub struct Survey {
    /// Distances, in the order of the file.
    pub tapes: Vec<Tape>,
    /// Standard deviation of a mark off its horizontal or vertical line, metres.
    pub line_sigma_m: f64,
    /// Marks in the order in which the device rested on them; empty where it is not known.
    pub visits: Vec<String>,
    /// Points of a map, metres of its world.
    pub points: BTreeMap<String, Vector3<f64>>,
}

/// Reads a survey.
pub fn read_survey(path: &Path) -> Result<Survey, Error> {
    let io = |source| Error::Io {
        path: path.to_owned(),
        source,
    };
    let size = std::fs::metadata(path).map_err(io)?.len();
    if size > MAX_BYTES {
        return Err(Error::NotASurvey {
            path: path.to_owned(),
            what: format!("{size} bytes; a survey is a small text file"),
        });
    }
    let text = std::fs::read_to_string(path).map_err(io)?;
    parse(&text).map_err(|problem| match problem.line {
        0 => Error::NotASurvey {
            path: path.to_owned(),
            what: problem.what,
        },
        line => Error::BadLine {
            path: path.to_owned(),
            line,
            what: problem.what,
        },
    })
}

#[derive(Debug)]
struct Problem {
    /// Counted from one; zero for the whole file.
    line: usize,
    what: String,
}

fn parse(text: &str) -> Result<Survey, Problem> {
    let mut survey = Survey {
        tapes: Vec::new(),
        line_sigma_m: DEFAULT_SIGMA_M,
        visits: Vec::new(),
        points: BTreeMap::new(),
    };
    let mut tape_sigma_m = DEFAULT_SIGMA_M;
    for (index, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let bad = |what: String| Problem {
            line: index + 1,
            what,
        };
        let words: Vec<&str> = line
            .split('#')
            .next()
            .unwrap_or_default()
            .split_whitespace()
            .collect();
        match words.as_slice() {
            [] => {}
            ["sigma", which @ ("distance" | "line"), value] => {
                let sigma_m = positive(value).map_err(bad)?;
                match *which {
                    "line" => survey.line_sigma_m = sigma_m,
                    _ => tape_sigma_m = sigma_m,
                }
            }
            [
                kind @ ("horizontal" | "vertical" | "distance"),
                a,
                b,
                length,
                rest @ ..,
            ] if rest.len() <= 1 => {
                if a == b {
                    return Err(bad(format!("a distance from {a} to itself")));
                }
                let sigma_m = rest.first().map(|value| positive(value)).transpose();
                survey.tapes.push(Tape {
                    kind: match *kind {
                        "horizontal" => TapeKind::Horizontal,
                        "vertical" => TapeKind::Vertical,
                        _ => TapeKind::Free,
                    },
                    ends: [(*a).to_owned(), (*b).to_owned()],
                    distance_m: positive(length).map_err(bad)?,
                    sigma_m: sigma_m.map_err(bad)?.unwrap_or(tape_sigma_m),
                });
            }
            ["visit", marks @ ..] if !marks.is_empty() => {
                survey.visits.extend(marks.iter().map(|m| (*m).to_owned()));
            }
            ["point", name, x, y, z] => {
                let place =
                    [x, y, z].map(|value| value.parse::<f64>().ok().filter(|v| v.is_finite()));
                let [Some(x), Some(y), Some(z)] = place else {
                    return Err(bad(format!(
                        "point {name} has a coordinate that is not a number"
                    )));
                };
                let before = survey
                    .points
                    .insert((*name).to_owned(), Vector3::new(x, y, z));
                if before.is_some() {
                    return Err(bad(format!("point {name} occurs twice")));
                }
            }
            _ => {
                return Err(bad(format!(
                    "'{}' is not a statement; expected horizontal|vertical|distance A B metres [σ], \
                     sigma distance|line σ, visit A B …, or point A x y z",
                    line.trim().chars().take(60).collect::<String>()
                )));
            }
        }
    }
    let whole = |what: String| Problem { line: 0, what };
    if survey.tapes.is_empty() {
        return Err(whole("it has no distances".to_owned()));
    }
    let marks = survey.marks();
    if marks.len() > MAX_MARKS {
        return Err(whole(format!(
            "{} marks, but at most {MAX_MARKS} are supported",
            marks.len()
        )));
    }
    Ok(survey)
}

impl Survey {
    /// Names of the marks, in the order in which distances name them first.
    pub fn marks(&self) -> Vec<&str> {
        let mut seen = std::collections::BTreeSet::new();
        let ends = self.tapes.iter().flat_map(|tape| &tape.ends);
        ends.map(String::as_str)
            .filter(|name| seen.insert(*name))
            .collect()
    }
}

fn positive(text: &str) -> Result<f64, String> {
    let value: Option<f64> = text
        .parse()
        .ok()
        .filter(|v: &f64| *v > 0.0 && v.is_finite());
    value.ok_or_else(|| format!("'{text}' is not a length above zero, in metres"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statements_are_read() {
        let survey = parse(
            "# a survey\nsigma distance 0.002\nhorizontal p1 p2 1.2\ndistance p1 q1 3 0.005 # by tape\nsigma line 0.003\n\
             vertical p1 q1 2.4\nvisit p1 p2\nvisit q1\npoint a 1 -2 0.5\n",
        )
        .expect("valid");
        assert_eq!(survey.marks(), ["p1", "p2", "q1"]);
        let kinds: Vec<TapeKind> = survey.tapes.iter().map(|t| t.kind).collect();
        assert_eq!(
            kinds,
            [TapeKind::Horizontal, TapeKind::Free, TapeKind::Vertical]
        );
        let sigmas: Vec<f64> = survey.tapes.iter().map(|t| t.sigma_m).collect();
        assert_eq!(sigmas, [0.002, 0.005, 0.002]);
        assert_eq!((survey.line_sigma_m, survey.visits.len()), (0.003, 3));
        assert_eq!(survey.points["a"], Vector3::new(1.0, -2.0, 0.5));
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, line, part) in [
            ("", 0, "no distance"),
            ("horizontal p1 p2\n", 1, "is not a statement"),
            ("\nhorizontal p1 p2 1,2\n", 2, "'1,2' is not a length"),
            ("distance p1 p2 -1\n", 1, "'-1' is not a length"),
            ("distance p1 p2 nan\n", 1, "'nan' is not a length"),
            ("distance p1 p1 1\n", 1, "to itself"),
            ("distance p1 p2 1 0\n", 1, "'0' is not a length"),
            ("point a 1 2 x\n", 1, "not a number"),
            ("point a 1 2 3\npoint a 1 2 3\n", 2, "twice"),
        ] {
            let problem = parse(text).expect_err(text);
            assert_eq!(problem.line, line, "{text}");
            assert!(problem.what.contains(part), "{}", problem.what);
        }
    }
}
