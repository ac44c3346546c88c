//! Estimates that are wrong in ways that their figures do not show, read and judged as `lsfb eval` does: each is named or refused. And right
//! ones, of which nothing is said. `LSFB_FIGURES=1` prints what is said of each.

use std::fmt::Write as _;
use std::path::Path;

use lsfb_eval::{EvalConfig, ReadOptions, evaluate_files, read_trajectory};
use lsfb_geometry::{Quaternion, Se3, UnitQuaternion, Vector3};
use lsfb_types::Verdict;

const RATE_HZ: f64 = 20.0;
const POSES: usize = 1800;
/// Stamps of this century.
const START_SECS: f64 = 1_772_359_200.0;

/// A pose as it will be printed.
#[derive(Clone, Copy, Debug)]
struct Row {
    t: f64,
    p: Vector3<f64>,
    q: UnitQuaternion<f64>,
}

/// Normal numbers, the same for a seed.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }

    fn vector(&mut self, sigma: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| sigma * self.normal())
    }
}

fn turn(axis: Vector3<f64>, angle: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::new(axis * angle)
}

/// Once and a half around a floor, with looks to all sides, steps, stairs in the middle and a rest at the start.
fn pose(seed: u64, t: f64) -> Se3 {
    let own = 0.37 * seed as f64;
    // At rest at first, then on and on.
    let s = (t - 3.0).max(0.0);
    let s = s * s / (s + 2.0);
    let along = 0.105 * s + own;
    let place = Vector3::new(
        9.0 * along.cos() + 1.2 * (3.1 * along + own).sin(),
        6.0 * along.sin() + 0.8 * (2.3 * along).cos(),
        1.5 + 1.0 / (1.0 + (-(s - 40.0) * 0.5).exp()) + 0.03 * (6.0 * s).sin(),
    );
    let rotation = turn(Vector3::z(), along + 1.6 + 0.7 * (0.31 * s).sin())
        * turn(Vector3::y(), 0.25 * (0.53 * s + own).sin())
        * turn(Vector3::x(), 0.12 * (0.71 * s).sin());
    Se3::new(rotation, place)
}

fn row(t: f64, pose: Se3) -> Row {
    Row {
        t: START_SECS + t,
        p: pose.translation,
        q: pose.rotation,
    }
}

fn truth(seed: u64) -> Vec<Row> {
    let times = (0..POSES).map(|i| i as f64 / RATE_HZ);
    times.map(|t| row(t, pose(seed, t))).collect()
}

/// A system's estimate of the walk as it is at other times than its stamps say: drift of some centimetres and a third of a degree, jitter of
/// millimetres, a world of its own.
fn estimated(seed: u64, at: impl Fn(f64) -> f64) -> Vec<Row> {
    let mut noise = Noise(seed + 71);
    let world = Se3::new(
        turn(Vector3::z(), 0.8 + seed as f64),
        Vector3::new(2.0, -3.0, 0.4),
    );
    let (mut drift, mut turned) = (Vector3::zeros(), Vector3::zeros());
    let times = (0..POSES).map(|i| i as f64 / RATE_HZ);
    times
        .map(|t| {
            drift += noise.vector(0.001);
            turned += noise.vector(0.000_1);
            let own = pose(seed, at(t));
            let off = Se3::new(
                UnitQuaternion::new(turned + noise.vector(0.000_7)),
                drift + noise.vector(0.002),
            );
            row(
                t,
                world
                    * Se3::new(
                        off.rotation * own.rotation,
                        own.translation + off.translation,
                    ),
            )
        })
        .collect()
}

fn honest(seed: u64) -> Vec<Row> {
    estimated(seed, |t| t)
}

/// As it is printed: seconds and x, y, z, w.
fn tum(rows: &[Row]) -> String {
    let mut text = String::new();
    for r in rows {
        let q = r.q.quaternion();
        let (p, t) = (r.p, r.t);
        let _ = writeln!(
            text,
            "{t:.6} {:.6} {:.6} {:.6} {:.7} {:.7} {:.7} {:.7}",
            p.x, p.y, p.z, q.i, q.j, q.k, q.w
        );
    }
    text
}

/// The same with something done to each row.
fn each(rows: Vec<Row>, change: impl Fn(usize, &mut Row)) -> String {
    let mut rows = rows;
    for (i, r) in rows.iter_mut().enumerate() {
        change(i, r);
    }
    tum(&rows)
}

/// What is said of an estimate: codes of findings that are no PASS, or why it was refused.
fn said(folder: &Path, seed: u64, text: &str) -> Result<Vec<(String, Verdict, String)>, String> {
    let (truth_path, path) = (folder.join("truth.tum"), folder.join("estimate.txt"));
    std::fs::write(&truth_path, tum(&truth(seed))).expect("written");
    std::fs::write(&path, text).expect("written");
    let read = |path| read_trajectory(path, &ReadOptions::default());
    let truth = read(&truth_path).expect("the truth");
    // As `lsfb eval` asks where nothing is said.
    let usual = EvalConfig::default();
    let config = EvalConfig {
        rpe: Vec::new(),
        rpe_where_possible: usual.rpe.clone(),
        ..usual
    };
    let found = read(&path)
        .and_then(|estimate| evaluate_files(&truth, &estimate, &config))
        .map_err(|e| e.to_string())?;
    let findings = found.findings.into_iter();
    let mut all: Vec<_> = findings
        .filter(|f| f.verdict != Verdict::Pass)
        .map(|f| (f.code.to_string(), f.verdict, f.what))
        .collect();
    all.push((
        "ate".to_owned(),
        Verdict::Pass,
        format!(
            "{:.3} m, {:.2}°",
            found.ate_translation_m.rmse,
            found.ate_rotation_deg.map_or(f64::NAN, |r| r.rmse)
        ),
    ));
    Ok(all)
}

/// What is wrong, the text of the estimate, and which finding is expected: one of several, or `refused`.
type Attack = (&'static str, fn(u64) -> String, &'static [&'static str]);

const RIGHT: &[Attack] = &[
    ("nothing", |s| tum(&honest(s)), &[]),
    (
        "half the rate",
        |s| tum(&honest(s).into_iter().step_by(2).collect::<Vec<_>>()),
        &[],
    ),
    (
        "quaternions of either sign",
        |s| {
            each(honest(s), |i, r| {
                if i % 3 == 0 {
                    r.q = UnitQuaternion::new_unchecked(-r.q.into_inner())
                }
            })
        },
        &[],
    ),
    (
        "far from its origin",
        |s| {
            each(honest(s), |_, r| {
                r.p += Vector3::new(690_000.0, 5_330_000.0, 500.0)
            })
        },
        &[],
    ),
    (
        "another axis is up",
        |s| {
            let up = turn(Vector3::x(), -std::f64::consts::FRAC_PI_2);
            each(honest(s), move |_, r| {
                r.p = up * r.p;
                r.q = up * r.q
            })
        },
        &[],
    ),
    (
        "jitter of a centimetre",
        |s| {
            let mut noise = Noise(s + 5);
            let off: Vec<_> = (0..POSES).map(|_| noise.vector(0.01)).collect();
            each(honest(s), move |i, r| r.p += off[i])
        },
        &[],
    ),
    (
        "drift of a metre",
        |s| {
            each(honest(s), |i, r| {
                r.p += Vector3::new(0.8, 0.5, 0.1) * (i as f64 / POSES as f64).powi(2)
            })
        },
        &[],
    ),
];

const WRONG: &[Attack] = &[
    (
        "lever of 20 cm",
        |s| each(honest(s), |_, r| r.p += r.q * Vector3::new(0.2, 0.0, 0.0)),
        &["lever"],
    ),
    (
        "lever of 30 cm",
        |s| {
            each(honest(s), |_, r| {
                r.p += r.q * Vector3::new(0.06, -0.27, 0.12)
            })
        },
        &["lever"],
    ),
    (
        "lever of 1 m",
        |s| each(honest(s), |_, r| r.p += r.q * Vector3::new(0.6, -0.7, 0.4)),
        &["lever"],
    ),
    (
        "late by 100 ms",
        |s| tum(&estimated(s, |t| t - 0.1)),
        &["clock"],
    ),
    (
        "late by 200 ms",
        |s| tum(&estimated(s, |t| t - 0.2)),
        &["clock"],
    ),
    (
        "early by 100 ms",
        |s| tum(&estimated(s, |t| t + 0.1)),
        &["clock"],
    ),
    (
        "late by half a second",
        |s| tum(&estimated(s, |t| t - 0.5)),
        &["clock"],
    ),
    (
        "late by 2 s",
        |s| tum(&estimated(s, |t| t - 2.0)),
        &["clock"],
    ),
    (
        "late by 8 s",
        |s| tum(&estimated(s, |t| t - 8.0)),
        &["clock", "follows", "orientations"],
    ),
    (
        "clock 0.5 % fast",
        |s| tum(&estimated(s, |t| 1.005 * t)),
        &["clock"],
    ),
    (
        "clock 1 % fast",
        |s| tum(&estimated(s, |t| 1.01 * t)),
        &["clock"],
    ),
    (
        "clock jumps by 0.1 s",
        |s| tum(&estimated(s, |t| if t > 40.0 { t - 0.1 } else { t })),
        &["clock"],
    ),
    (
        "clock jumps by 1 s",
        |s| tum(&estimated(s, |t| if t > 40.0 { t - 1.0 } else { t })),
        &["clock"],
    ),
    (
        "leap seconds",
        |s| each(honest(s), |_, r| r.t += 18.0),
        &["clock", "follows", "coverage", "matches"],
    ),
    (
        "another time zone",
        |s| each(honest(s), |_, r| r.t += 3600.0),
        &["refused"],
    ),
    (
        "stamps from zero",
        |s| each(honest(s), |_, r| r.t -= START_SECS),
        &["refused"],
    ),
    (
        "stamps to a tenth of a second",
        |s| each(honest(s), |_, r| r.t = (10.0 * r.t).round() / 10.0),
        &["duplicate-stamps", "refused"],
    ),
    (
        "stamps to a second",
        |s| each(honest(s), |_, r| r.t = r.t.round()),
        &["duplicate-stamps", "refused"],
    ),
    (
        "stamps in single precision",
        |s| each(honest(s), |_, r| r.t = f64::from(r.t as f32)),
        &["duplicate-stamps", "refused"],
    ),
    (
        "numbers of frames",
        |s| each(honest(s), |i, r| r.t = i as f64),
        &["refused"],
    ),
    (
        "x and y exchanged",
        |s| each(honest(s), |_, r| r.p = Vector3::new(r.p.y, r.p.x, r.p.z)),
        &["mirrored"],
    ),
    (
        "z turned around",
        |s| each(honest(s), |_, r| r.p.z = -r.p.z),
        &["mirrored", "orientations"],
    ),
    (
        "left-handed",
        |s| {
            each(honest(s), |_, r| {
                r.p.y = -r.p.y;
                let q = r.q.into_inner();
                r.q = UnitQuaternion::new_unchecked(Quaternion::new(q.w, -q.i, q.j, -q.k));
            })
        },
        &["mirrored"],
    ),
    (
        "in feet",
        |s| each(honest(s), |_, r| r.p /= 0.3048),
        &["scale", "unit"],
    ),
    (
        "in inches",
        |s| each(honest(s), |_, r| r.p /= 0.0254),
        &["scale", "unit"],
    ),
    (
        "in yards",
        |s| each(honest(s), |_, r| r.p /= 0.9144),
        &["scale", "unit"],
    ),
    (
        "in centimetres",
        |s| each(honest(s), |_, r| r.p *= 100.0),
        &["unit"],
    ),
    (
        "in millimetres",
        |s| each(honest(s), |_, r| r.p *= 1000.0),
        &["unit"],
    ),
    (
        "in kilometres",
        |s| each(honest(s), |_, r| r.p /= 1000.0),
        &["unit"],
    ),
    (
        "6 % too large",
        |s| each(honest(s), |_, r| r.p *= 1.06),
        &["scale"],
    ),
    (
        "z in centimetres",
        |s| each(honest(s), |_, r| r.p.z *= 100.0),
        &["axes", "follows"],
    ),
    (
        "y 10 % too long",
        |s| each(honest(s), |_, r| r.p.y *= 1.1),
        &["axes"],
    ),
    ("no z", |s| each(honest(s), |_, r| r.p.z = 0.0), &["axes"]),
    (
        "degrees of longitude and latitude",
        |s| {
            each(honest(s), |_, r| {
                r.p.x = 11.5 + r.p.x / 74_000.0;
                r.p.y = 48.1 + r.p.y / 111_000.0;
            })
        },
        &["unit", "scale", "axes", "follows"],
    ),
    (
        "w first",
        |s| {
            each(honest(s), |_, r| {
                let q = r.q.into_inner();
                r.q = UnitQuaternion::new_unchecked(Quaternion::new(q.k, q.w, q.i, q.j));
            })
        },
        &["orientations"],
    ),
    (
        "quaternions of the inverse",
        |s| each(honest(s), |_, r| r.q = r.q.inverse()),
        &["orientations"],
    ),
    (
        "poses of the world in the camera",
        |s| {
            each(honest(s), |_, r| {
                let inverse = Se3::new(r.q, r.p).inverse();
                (r.p, r.q) = (inverse.translation, inverse.rotation);
            })
        },
        &["inverse"],
    ),
    (
        "no rotation",
        |s| each(honest(s), |_, r| r.q = UnitQuaternion::identity()),
        &["orientations"],
    ),
    (
        "rotations of anything",
        |s| {
            each(honest(s), |i, r| {
                r.q = turn(Vector3::new(1.0, 0.3, -2.0), 0.7 * i as f64)
            })
        },
        &["orientations"],
    ),
    (
        "heading alone",
        |s| {
            each(honest(s), |_, r| {
                r.q = turn(Vector3::z(), r.q.euler_angles().2)
            })
        },
        &["orientations"],
    ),
    (
        "a camera's axes",
        |s| {
            let camera = UnitQuaternion::new_normalize(Quaternion::new(0.5, -0.5, 0.5, -0.5));
            each(honest(s), move |_, r| r.q *= camera)
        },
        &["orientations"],
    ),
    (
        "north, east, down",
        |s| {
            let world = UnitQuaternion::new_normalize(Quaternion::new(0.0, 1.0, 1.0, 0.0));
            let body = turn(Vector3::x(), std::f64::consts::PI);
            each(honest(s), move |_, r| {
                r.p = world * r.p;
                r.q = world * r.q * body
            })
        },
        &["orientations"],
    ),
    (
        "mounted 3° off",
        |s| each(honest(s), |_, r| r.q *= turn(Vector3::x(), 0.052)),
        &["orientations"],
    ),
    (
        "angles in degrees",
        |s| {
            let mut text = String::new();
            for r in honest(s) {
                let (roll, pitch, yaw) = r.q.euler_angles();
                let _ = writeln!(
                    text,
                    "{:.6} {:.6} {:.6} {:.6} {:.4} {:.4} {:.4} 0",
                    r.t,
                    r.p.x,
                    r.p.y,
                    r.p.z,
                    roll.to_degrees(),
                    pitch.to_degrees(),
                    yaw.to_degrees()
                );
            }
            text
        },
        &["refused"],
    ),
    (
        "angles in radians",
        |s| {
            let mut text = String::new();
            for r in honest(s) {
                let (roll, pitch, yaw) = r.q.euler_angles();
                let _ = writeln!(
                    text,
                    "{:.6} {:.6} {:.6} {:.6} {:.4} {:.4} {:.4} 1",
                    r.t, r.p.x, r.p.y, r.p.z, roll, pitch, yaw
                );
            }
            text
        },
        &["refused", "orientations"],
    ),
    (
        "quaternions of length 1.4",
        |s| {
            tum(&honest(s))
                .lines()
                .map(|line| {
                    let mut words: Vec<String> = line.split(' ').map(str::to_owned).collect();
                    for word in &mut words[4..] {
                        *word = format!("{}", 1.4 * word.parse::<f64>().expect("a number"));
                    }
                    words.join(" ") + "\n"
                })
                .collect()
        },
        &["refused", "quaternions"],
    ),
    ("the truth", |s| tum(&truth(s)), &["same"]),
    (
        "the truth in another world",
        |s| {
            each(truth(s), |_, r| {
                r.p = turn(Vector3::z(), 1.0) * r.p;
                r.q = turn(Vector3::z(), 1.0) * r.q
            })
        },
        &["same"],
    ),
    (
        "the truth to a millimetre",
        |s| {
            each(truth(s), |_, r| {
                r.p = r.p.map(|v| (1000.0 * v).round() / 1000.0)
            })
        },
        &["same"],
    ),
    (
        "the truth in every other pose",
        |s| {
            let (own, all) = (honest(s), truth(s));
            let world = turn(Vector3::z(), -(0.8 + s as f64));
            let rows: Vec<Row> = own
                .iter()
                .zip(&all)
                .enumerate()
                .map(|(i, (o, t))| {
                    if i % 2 == 0 {
                        *t
                    } else {
                        Row {
                            p: world * (o.p - Vector3::new(2.0, -3.0, 0.4)),
                            q: world * o.q,
                            ..*o
                        }
                    }
                })
                .collect();
            tum(&rows)
        },
        &["same"],
    ),
    (
        "the truth's orientations",
        |s| {
            let all = truth(s);
            each(honest(s), move |i, r| r.q = all[i].q)
        },
        &["same-orientations", "orientations"],
    ),
    (
        "the truth, a frame late",
        |s| {
            let all = truth(s);
            each(truth(s), move |i, r| {
                let before = all[i.saturating_sub(1)];
                (r.p, r.q) = (before.p, before.q)
            })
        },
        &["same", "clock"],
    ),
    (
        "the second half lost",
        |s| tum(&honest(s)[..POSES / 2]),
        &["coverage"],
    ),
    (
        "the first third lost",
        |s| tum(&honest(s)[POSES / 3..]),
        &["coverage"],
    ),
    (
        "the second half stands still",
        |s| {
            let rows = honest(s);
            let last = rows[POSES / 2];
            each(rows, move |i, r| {
                if i > POSES / 2 {
                    (r.p, r.q) = (last.p, last.q)
                }
            })
        },
        &["held"],
    ),
    (
        "twenty seconds stand still",
        |s| {
            let rows = honest(s);
            let last = rows[800];
            each(rows, move |i, r| {
                if (800..1200).contains(&i) {
                    (r.p, r.q) = (last.p, last.q)
                }
            })
        },
        &["held"],
    ),
    (
        "each pose held for five",
        |s| {
            let rows = honest(s);
            let all = rows.clone();
            each(rows, move |i, r| {
                let held = all[i - i % 5];
                (r.p, r.q) = (held.p, held.q)
            })
        },
        &["held", "clock"],
    ),
    (
        "every fifth pose at the origin",
        |s| {
            each(honest(s), |i, r| {
                if i % 5 == 0 {
                    (r.p, r.q) = (Vector3::zeros(), UnitQuaternion::identity())
                }
            })
        },
        &["follows", "held"],
    ),
    (
        "one pose in a hundred 10 m off",
        |s| {
            each(honest(s), |i, r| {
                if i % 100 == 50 {
                    r.p.x += 10.0
                }
            })
        },
        &["outliers"],
    ),
    (
        "one pose 1 km off",
        |s| {
            each(honest(s), |i, r| {
                if i == 700 {
                    r.p.y += 1000.0
                }
            })
        },
        &["outliers", "follows"],
    ),
    (
        "a metre beside for 5 s",
        |s| {
            each(honest(s), |i, r| {
                if (900..1000).contains(&i) {
                    r.p += Vector3::new(0.8, 0.6, 0.0)
                }
            })
        },
        &["outliers"],
    ),
    (
        "a number that is none",
        |s| tum(&honest(s)).replacen(" 1.", " nan", 1),
        &["refused"],
    ),
    (
        "another walk",
        |s| tum(&honest(s + 11)),
        &["follows", "orientations"],
    ),
    (
        "backwards",
        |s| {
            let rows = honest(s);
            let all = rows.clone();
            each(rows, move |i, r| {
                let other = all[POSES - 1 - i];
                (r.p, r.q) = (other.p, other.q)
            })
        },
        &["follows", "orientations"],
    ),
    (
        "at one place",
        |s| each(honest(s), |_, r| r.p = Vector3::new(1.0, 2.0, 3.0)),
        &["follows", "refused"],
    ),
    (
        "straight on",
        |s| {
            each(honest(s), |i, r| {
                r.p = Vector3::new(0.05 * i as f64, 0.0, 1.5)
            })
        },
        &["follows", "refused"],
    ),
    (
        "smoothed over the last second",
        |s| {
            let all = honest(s);
            let rows = all.clone();
            each(rows, move |i, r| {
                let part = &all[i.saturating_sub(20)..=i];
                r.p = part.iter().map(|r| r.p).sum::<Vector3<f64>>() / part.len() as f64
            })
        },
        &["clock"],
    ),
    (
        "not in order",
        |s| {
            let mut rows = honest(s);
            rows.swap(100, 900);
            tum(&rows)
        },
        &["unsorted-stamps"],
    ),
    (
        "two runs in one file",
        |s| tum(&honest(s)) + &each(honest(s), |_, r| r.p = turn(Vector3::z(), 1.0) * r.p),
        &["duplicate-stamps"],
    ),
    (
        "rotations twice as far",
        |s| each(honest(s), |_, r| r.q = r.q * r.q),
        &["orientations"],
    ),
    (
        "rotations late by half a second",
        |s| {
            let all = honest(s);
            let rows = all.clone();
            each(rows, move |i, r| r.q = all[i.saturating_sub(10)].q)
        },
        &["late-orientations"],
    ),
];

#[test]
fn what_is_wrong_is_named_and_what_is_right_is_not() {
    let folder = tempfile::tempdir().expect("folder");
    let is_shown = std::env::var_os("LSFB_FIGURES").is_some();
    let mut silent = Vec::new();
    for (attacks, is_right) in [(RIGHT, true), (WRONG, false)] {
        for (name, text, expected) in attacks {
            for seed in [1, 2, 3] {
                let said = said(folder.path(), seed, &text(seed));
                let codes: Vec<&str> = match &said {
                    Ok(findings) => findings
                        .iter()
                        .filter(|(_, verdict, _)| *verdict != Verdict::Pass)
                        .map(|(code, _, _)| code.as_str())
                        .collect(),
                    Err(_) => vec!["refused"],
                };
                if is_shown {
                    println!("{name} [{seed}] {codes:?} {said:?}");
                }
                let is_met = match is_right {
                    true => codes.is_empty(),
                    false => codes.iter().any(|code| expected.contains(code)),
                };
                if !is_met {
                    silent.push(format!("{name}, seed {seed}: {said:?}"));
                }
            }
        }
    }
    assert!(
        silent.is_empty(),
        "{}:\n{}",
        silent.len(),
        silent.join("\n")
    );
}
