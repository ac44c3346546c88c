//! Which transform takes the estimate's world to the truth's.

use lsfb_geometry::align::{Alignment, Scale, umeyama};
use lsfb_geometry::{Se3, UnitQuaternion, Vector3};

use crate::Error;
use crate::association::PosePair;

/// What may be taken away before errors are measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AlignmentMode {
    /// Nothing: both share one world.
    None,
    /// The rotation and translation that bring the matched positions closest.
    #[default]
    Se3,
    /// As `Se3`, with one scale: for a monocular estimate.
    Sim3,
    /// The rotation about the vertical axis z and the translation that bring the matched positions closest: for an estimate and
    /// a truth that both know gravity.
    Yaw,
    /// The transform that makes the first matched poses equal.
    Origin,
    /// A transform known beforehand, `truth_from_estimate`.
    Given(Se3),
}

impl AlignmentMode {
    /// Those that can be asked for by name: all but [`AlignmentMode::Given`].
    pub const NAMED: [Self; 5] = [Self::None, Self::Se3, Self::Sim3, Self::Yaw, Self::Origin];

    /// Its name on the command line.
    pub const fn key(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Se3 => "se3",
            Self::Sim3 => "sim3",
            Self::Yaw => "yaw",
            Self::Origin => "origin",
            Self::Given(_) => "given",
        }
    }

    /// As a reader knows it.
    pub fn label(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Se3 => "SE(3)",
            Self::Sim3 => "Sim(3)",
            Self::Yaw => "yaw",
            Self::Origin => "origin",
            Self::Given(_) => "given",
        }
    }

    /// Numbers that it takes from the matched poses.
    pub(crate) fn parameters(self) -> usize {
        match self {
            Self::None | Self::Given(_) => 0,
            Self::Yaw => 4,
            Self::Se3 | Self::Origin => 6,
            Self::Sim3 => 7,
        }
    }
}

/// The alignment of matched poses, as a transform of the estimate.
pub fn align(pairs: &[PosePair], mode: AlignmentMode) -> Result<Alignment, Error> {
    match mode {
        AlignmentMode::None => Ok(rigid(Se3::identity())),
        AlignmentMode::Given(truth_from_estimate) => Ok(rigid(truth_from_estimate)),
        AlignmentMode::Se3 => fit(pairs, Scale::Fixed),
        AlignmentMode::Sim3 => fit(pairs, Scale::Free),
        AlignmentMode::Yaw => yaw(pairs),
        AlignmentMode::Origin => {
            let first = pairs.first().ok_or(Error::TooFewMatches {
                matched: 0,
                needed: 1,
                purpose: "origin alignment",
            })?;
            Ok(rigid(
                first.truth.world_from_rig * first.estimate.world_from_rig.inverse(),
            ))
        }
    }
}

/// `pose` of the estimate in the world of the truth.
pub fn apply(alignment: &Alignment, pose: &Se3) -> Se3 {
    Se3::new(
        alignment.target_from_source.rotation * pose.rotation,
        alignment.apply(&pose.translation),
    )
}

fn rigid(target_from_source: Se3) -> Alignment {
    Alignment {
        target_from_source,
        scale: 1.0,
    }
}

/// The angle that turns the horizontal parts of the centred positions onto each other, in closed form.
fn yaw(pairs: &[PosePair]) -> Result<Alignment, Error> {
    check_count(pairs)?;
    let mean = |of: fn(&PosePair) -> Vector3<f64>| {
        pairs.iter().map(of).sum::<Vector3<f64>>() / pairs.len() as f64
    };
    let mean_truth = mean(|p| p.truth.world_from_rig.translation);
    let mean_estimate = mean(|p| p.estimate.world_from_rig.translation);
    let (mut along, mut across, mut size) = (0.0, 0.0, 0.0);
    for pair in pairs {
        let t = pair.truth.world_from_rig.translation - mean_truth;
        let e = pair.estimate.world_from_rig.translation - mean_estimate;
        along += e.x * t.x + e.y * t.y;
        across += e.x * t.y - e.y * t.x;
        size += t.norm_squared() + e.norm_squared();
    }
    if !(along.hypot(across) > 1e-12 * size) {
        return Err(Error::NoHeading);
    }
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), across.atan2(along));
    Ok(rigid(Se3::new(
        rotation,
        mean_truth - rotation * mean_estimate,
    )))
}

fn check_count(pairs: &[PosePair]) -> Result<(), Error> {
    if pairs.len() < 3 {
        return Err(Error::TooFewMatches {
            matched: pairs.len(),
            needed: 3,
            purpose: "alignment",
        });
    }
    Ok(())
}

fn fit(pairs: &[PosePair], scale: Scale) -> Result<Alignment, Error> {
    check_count(pairs)?;
    let positions = |of: fn(&PosePair) -> Vector3<f64>| pairs.iter().map(of).collect::<Vec<_>>();
    umeyama(
        &positions(|p| p.estimate.world_from_rig.translation),
        &positions(|p| p.truth.world_from_rig.translation),
        scale,
    )
    .ok_or(Error::Degenerate)
}
