//! One row of a file.

use lsfb_geometry::{Matrix3, Matrix6, Quaternion, Se3, UnitQuaternion, Vector3, so3};

use super::columns::{Columns, FrameColumns};
use super::layout::Content;
use super::text::shown;

/// By how much a row's matrix may miss being a rotation (KITTI prints seven digits).
const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

/// What a row says, its stamp as it is written.
#[derive(Clone, Debug)]
pub(super) struct Row<'a> {
    /// `None` where the format has none.
    pub stamp: Option<&'a str>,
    /// kapture's device.
    pub device: Option<&'a str>,
    /// Without rotation where the file has positions only.
    pub world_from_rig: Se3,
    /// Length of the quaternion as it is written; one where there is none.
    pub quaternion_length: f64,
    /// In the tangent of the pose; `None` where the file has none.
    pub covariance: Option<Box<Matrix6<f64>>>,
}

/// A rotation, and how long its quaternion was.
type Turn = (UnitQuaternion<f64>, f64);

impl Row<'_> {
    /// Of a row that says the pose of the world in the body.
    fn inverted(self) -> Self {
        Self {
            world_from_rig: self.world_from_rig.inverse(),
            ..self
        }
    }
}

/// `None` for a row that is whole and says no pose: kapture leaves out what is not known.
pub(super) fn parse<'a>(content: Content, columns: &[&'a str]) -> Result<Option<Row<'a>>, String> {
    let row = |stamp, (rotation, quaternion_length): Turn, translation| Row {
        stamp,
        device: None,
        world_from_rig: Se3::new(rotation, translation),
        quaternion_length,
        covariance: None,
    };
    Ok(Some(match content {
        Content::Columns(at) if is_without_pose(columns, at) => return Ok(None),
        Content::Columns(at) => {
            let place = Vector3::from(numbers(columns, at.position)?);
            row(
                Some(column(columns, at.time)?),
                quaternion(columns, at)?,
                place,
            )
        }
        Content::WithCovariance => {
            let at = Columns::TUM;
            let place = Vector3::from(numbers(columns, at.position)?);
            let row = row(
                Some(column(columns, at.time)?),
                quaternion(columns, at)?,
                place,
            );
            let covariance: [f64; 36] = numbers(columns, std::array::from_fn(|i| 8 + i))?;
            let covariance = covariance_in_tangent(&covariance, &row.world_from_rig)?;
            Row {
                covariance: Some(Box::new(covariance)),
                ..row
            }
        }
        Content::Matrix => {
            let upper: [f64; 12] = numbers(columns, std::array::from_fn(|i| i))?;
            if columns.len() == 16 {
                let last: [f64; 4] = numbers(columns, [12, 13, 14, 15])?;
                if last != [0.0, 0.0, 0.0, 1.0] {
                    return Err("the last row of the matrix is not 0 0 0 1".to_owned());
                }
            }
            let pose = from_matrix_rows(&upper)?;
            row(None, (pose.rotation, 1.0), pose.translation)
        }
        Content::Colmap => {
            let [qw, qx, qy, qz, x, y, z] = numbers(columns, std::array::from_fn(|i| 1 + i))?;
            let stamp = stamp_in_name(column(columns, 9)?)?;
            row(
                Some(stamp),
                rotation(qw, qx, qy, qz)?,
                Vector3::new(x, y, z),
            )
            .inverted()
        }
        Content::Kapture => {
            if columns.iter().skip(2).any(|c| c.is_empty()) {
                return Ok(None);
            }
            let [qw, qx, qy, qz, x, y, z] = numbers(columns, std::array::from_fn(|i| 2 + i))?;
            let stamp = column(columns, 0)?;
            Row {
                device: Some(column(columns, 1)?),
                ..row(
                    Some(stamp),
                    rotation(qw, qx, qy, qz)?,
                    Vector3::new(x, y, z),
                )
                .inverted()
            }
        }
    }))
}

/// Whether all fields of the pose are empty, as in tables that list frames without one.
fn is_without_pose(columns: &[&str], at: Columns) -> bool {
    let rotation = at.rotation_xyzw.iter().flatten();
    let mut fields = at.position.iter().chain(rotation);
    fields.all(|index| columns.get(*index).is_some_and(|field| field.is_empty()))
}

/// How well the frame of a row matched a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Frame {
    /// A whole number; some programs print it with a point.
    pub matches: f64,
    /// Whether the program vouches for its pose.
    pub is_localized: bool,
}

/// An empty field is no match.
pub(super) fn frame(at: FrameColumns, columns: &[&str]) -> Result<Frame, String> {
    let matches = column(columns, at.matches)?;
    let localized = at
        .localized
        .map(|index| column(columns, index))
        .transpose()?;
    let count = match matches.is_empty() {
        true => Some(0.0),
        false => matches
            .parse()
            .ok()
            .filter(|m: &f64| *m >= 0.0 && m.is_finite()),
    };
    Ok(Frame {
        matches: count.ok_or_else(|| format!("'{}' is not a number of matches", shown(matches)))?,
        is_localized: match localized {
            None | Some("1" | "true" | "True") => true,
            Some("0" | "false" | "False") => false,
            Some(other) => {
                return Err(format!("'{}' is neither 0 nor 1 (localized)", shown(other)));
            }
        },
    })
}

/// A covariance of x y z and of rotations about the world's axes, row by row, as one of `[rotation, translation]` in the body.
pub(super) fn covariance_in_tangent(
    values: &[f64; 36],
    world_from_rig: &Se3,
) -> Result<Matrix6<f64>, String> {
    let given = Matrix6::from_row_slice(values);
    let size = given.abs().max();
    if !size.is_finite() || (given - given.transpose()).abs().max() > 1e-6 * size {
        return Err("the covariance is not symmetric".to_owned());
    }
    let back = world_from_rig.rotation.inverse().to_rotation_matrix();
    let mut turn = Matrix6::zeros();
    turn.fixed_view_mut::<3, 3>(0, 3).copy_from(back.matrix());
    turn.fixed_view_mut::<3, 3>(3, 0).copy_from(back.matrix());
    Ok(turn * given * turn.transpose())
}

/// A covariance of `[rotation, translation]` in the tangent of a pose, as one of x y z and of rotations about the world's axes, which is
/// how ROS publishes it: the inverse of what reading does.
pub fn covariance_in_world(covariance: &Matrix6<f64>, world_from_rig: &Se3) -> Matrix6<f64> {
    let rotation = world_from_rig.rotation_matrix();
    let mut to_world = Matrix6::zeros();
    to_world.fixed_view_mut::<3, 3>(0, 3).copy_from(&rotation);
    to_world.fixed_view_mut::<3, 3>(3, 0).copy_from(&rotation);
    let in_world = to_world * covariance * to_world.transpose();
    // Symmetric to the last bit.
    (in_world + in_world.transpose()) * 0.5
}

/// The number at the end of a file's name: `cam0/1403636579.763555.png`.
fn stamp_in_name(name: &str) -> Result<&str, String> {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let is_digit = |c: char| c.is_ascii_digit() || c == '.';
    let start = stem.trim_end_matches(is_digit).len();
    let stamp = stem[start..].trim_start_matches('.');
    match stamp.is_empty() {
        true => Err(format!("'{}' does not end with a stamp", shown(name))),
        false => Ok(stamp),
    }
}

fn column<'a>(columns: &[&'a str], index: usize) -> Result<&'a str, String> {
    let found = columns.get(index).copied();
    found.ok_or_else(|| format!("{} columns, expected {}", columns.len(), index + 1))
}

fn numbers<const N: usize>(columns: &[&str], at: [usize; N]) -> Result<[f64; N], String> {
    let mut values = [0.0; N];
    for (value, index) in values.iter_mut().zip(at) {
        let text = column(columns, index)?;
        let number: Option<f64> = text.parse().ok().filter(|v: &f64| v.is_finite());
        *value = number.ok_or_else(|| format!("'{}' is not a finite number", shown(text)))?;
    }
    Ok(values)
}

fn quaternion(columns: &[&str], at: Columns) -> Result<Turn, String> {
    let Some(at) = at.rotation_xyzw else {
        return Ok((UnitQuaternion::identity(), 1.0));
    };
    let [x, y, z, w] = numbers(columns, at)?;
    rotation(w, x, y, z)
}

fn rotation(w: f64, x: f64, y: f64, z: f64) -> Result<Turn, String> {
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    // Files print as few as four digits, and some programs none too exactly: normalise, but refuse what is no rotation.
    if (0.5..2.0).contains(&norm) {
        Ok((UnitQuaternion::new_normalize(quaternion), norm))
    } else {
        Err(format!("quaternion with norm {norm}; expected 1"))
    }
}

fn from_matrix_rows(row: &[f64; 12]) -> Result<Se3, String> {
    let matrix = Matrix3::new(
        row[0], row[1], row[2], row[4], row[5], row[6], row[8], row[9], row[10],
    );
    let rotation = so3::from_rounded(&matrix, ORTHONORMAL_TOLERANCE).ok_or_else(|| {
        let off = (matrix * matrix.transpose() - Matrix3::identity()).norm();
        format!("the first three columns are not a rotation (off by {off:.1e})")
    })?;
    Ok(Se3::new(rotation, Vector3::new(row[3], row[7], row[11])))
}
