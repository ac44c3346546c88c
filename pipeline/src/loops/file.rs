//! The list of loops as a text file that a person edits and gives back.

use std::fmt::Write as _;
use std::path::Path;

use lsfb_geometry::{Quaternion, Se3, UnitQuaternion, Vector3};
use lsfb_types::Timestamp;

use super::{Loop, LoopDecision, LoopRejection, LoopScores, Loops, MeasuredLoop};
use crate::Error;
use crate::odometry::OdometryResult;

const HEAD: &str = "\
# Loops of a walk. The first word of a line is its verdict: change it to `accept` or `reject` and give the file back with --loops.
# Only loops that were measured (whose pose is there) can be accepted. `-` stands for what was not looked at.
# verdict earlier_s later_s appearance overlap rival_overlap plane_rms_m odometry_sigmas \
tx_m ty_m tz_m qx qy qz qw rotation_sigma_rad translation_sigma_m reason
";
const COLUMNS: usize = 18;
/// What a quaternion's norm may be off by before it is made 1: what was written is read back bit by bit.
const ROUNDING: f64 = 1e-12;

impl Loops {
    /// As a text file: see `docs/odometry.md`.
    pub fn to_text(&self) -> String {
        let mut text = HEAD.to_owned();
        for l in &self.all {
            let (decision, reason) = match l.decision {
                LoopDecision::Accepted => ("accept", "-"),
                LoopDecision::Rejected(why) => ("reject", why.name()),
            };
            // Writing into a string cannot fail.
            let _ = write!(text, "{decision} {} {}", l.earlier, l.later);
            let s = &l.scores;
            for score in [
                s.appearance,
                s.overlap,
                s.rival_overlap,
                s.plane_rms_m,
                s.odometry_sigmas,
            ] {
                match score {
                    Some(score) => _ = write!(text, " {score}"),
                    None => text += " -",
                }
            }
            match &l.measured {
                Some(m) => {
                    let t = &m.earlier_from_later.translation;
                    let q = m.earlier_from_later.rotation.quaternion();
                    let _ = write!(
                        text,
                        " {} {} {} {} {} {} {} {} {}",
                        t.x,
                        t.y,
                        t.z,
                        q.i,
                        q.j,
                        q.k,
                        q.w,
                        m.rotation_sigma_rad,
                        m.translation_sigma_m
                    );
                }
                None => text += &" -".repeat(9),
            }
            let _ = writeln!(text, " {reason}");
        }
        text
    }

    /// Reads what [`Loops::to_text`] wrote and a person may have edited, for the walk that it was written of.
    pub fn read(path: &Path, walk: &OdometryResult) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path).map_err(Error::io(path))?;
        let mut loops = Self::default();
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let read = parse(line, walk).map_err(|reason| Error::LoopLine {
                path: path.to_owned(),
                line: index + 1,
                reason,
            });
            loops.all.push(read?);
        }
        Ok(loops)
    }
}

fn parse(line: &str, walk: &OdometryResult) -> Result<Loop, String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let count = words.len();
    let words: [&str; COLUMNS] = words
        .try_into()
        .map_err(|_| format!("{count} columns, but expected {COLUMNS}"))?;
    let [decision, earlier, later, .., reason] = words;
    let number = |k: usize| -> Result<Option<f64>, String> {
        match words[k] {
            "-" => Ok(None),
            word => match word.parse::<f64>() {
                Ok(value) if value.is_finite() => Ok(Some(value)),
                _ => Err(format!("{word:?} is not a number")),
            },
        }
    };
    let (earlier, later) = (scan_at(earlier, walk)?, scan_at(later, walk)?);
    if earlier >= later {
        return Err("the earlier scan is not before the later one".to_owned());
    }
    let measured = measured(&[8, 9, 10, 11, 12, 13, 14, 15, 16].map(number))?;
    let decision = match decision {
        "accept" if measured.is_none() => {
            return Err(
                "this loop was not measured, and cannot be accepted: give its pose and standard deviations".to_owned(),
            );
        }
        "accept" => LoopDecision::Accepted,
        "reject" => {
            let known = LoopRejection::ALL.into_iter().find(|r| r.name() == reason);
            LoopDecision::Rejected(known.unwrap_or(LoopRejection::ByHand))
        }
        other => return Err(format!("{other:?} is neither `accept` nor `reject`")),
    };
    Ok(Loop {
        earlier,
        later,
        decision,
        scores: LoopScores {
            appearance: number(3)?,
            overlap: number(4)?,
            rival_overlap: number(5)?,
            plane_rms_m: number(6)?,
            odometry_sigmas: number(7)?,
        },
        measured,
    })
}

/// The scan with that time, to the nanosecond.
fn scan_at(word: &str, walk: &OdometryResult) -> Result<Timestamp, String> {
    let times = walk.scan_poses.iter().map(|s| s.pose.time);
    let mut same = times.filter(|time| time.to_string() == word);
    same.next().ok_or_else(|| {
        format!("no scan of this walk has a pose at {word} s: was the file made from another walk, or with other settings?")
    })
}

/// A pose and its standard deviations: nine numbers, or none at all.
fn measured(numbers: &[Result<Option<f64>, String>; 9]) -> Result<Option<MeasuredLoop>, String> {
    let mut values = [0.0; 9];
    let mut absent = 0;
    for (value, number) in values.iter_mut().zip(numbers) {
        match number.clone()? {
            Some(number) => *value = number,
            None => absent += 1,
        }
    }
    if absent == 9 {
        return Ok(None);
    }
    let [
        x,
        y,
        z,
        qx,
        qy,
        qz,
        qw,
        rotation_sigma_rad,
        translation_sigma_m,
    ] = values;
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    let norm = quaternion.norm();
    if absent > 0 || !(norm > 0.5 && norm < 2.0) {
        return Err(
            "its pose is invalid: expected three coordinates and a unit quaternion".to_owned(),
        );
    }
    if !(rotation_sigma_rad > 0.0 && translation_sigma_m > 0.0) {
        return Err("its standard deviations must be more than 0".to_owned());
    }
    let rotation = if (norm - 1.0).abs() < ROUNDING {
        UnitQuaternion::new_unchecked(quaternion)
    } else {
        UnitQuaternion::new_normalize(quaternion)
    };
    Ok(Some(MeasuredLoop {
        earlier_from_later: Se3::new(rotation, Vector3::new(x, y, z)),
        rotation_sigma_rad,
        translation_sigma_m,
    }))
}
