//! Matches of two keyframes as residuals that share them: a long walk has millions, and no copy of each is made.

use std::sync::Arc;

use lsfb_geometry::Se3;
use lsfb_solver::{Linearization, Parameters, Residual, ResidualSet, Shape, Undefined};

use crate::lidar_features::Correspondences;

/// The residuals of matched planes, by their numbers. Blocks: `world_from_rig` of m, then of n.
pub(super) struct MatchedPlanes {
    pub found: Arc<Correspondences>,
    pub sigma_m: f64,
}

/// The residuals of matched edges, likewise.
pub(super) struct MatchedEdges {
    pub found: Arc<Correspondences>,
    pub sigma_m: f64,
}

macro_rules! as_residuals {
    ($matched:ident, $of:ident, $dimension:literal) => {
        impl ResidualSet for $matched {
            fn dimension(&self) -> usize {
                $dimension
            }

            fn blocks(&self) -> &[Shape] {
                const { &[Shape::of::<Se3>(), Shape::of::<Se3>()] }
            }

            fn evaluate(
                &self,
                number: u32,
                parameters: &Parameters<'_>,
                out: &mut Linearization<'_>,
            ) -> Result<(), Undefined> {
                let found = self.found.$of.get(number as usize).ok_or(Undefined)?;
                found.residual(self.sigma_m).evaluate(parameters, out)
            }
        }
    };
}

as_residuals!(MatchedPlanes, planes, 1);
as_residuals!(MatchedEdges, edges, 3);
