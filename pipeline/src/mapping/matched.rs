//! Matches of two keyframes as residuals that share them: a long walk has millions, and no copy of each is made.

use std::sync::Arc;

use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};

use crate::lidar_features::Correspondences;
use crate::residuals::{LidarEdge, LidarPlane};

/// The [`LidarPlane`] of a match. Blocks: `world_from_rig` of m, then of n.
pub(super) struct MatchedPlane {
    pub found: Arc<Correspondences>,
    pub number: u32,
    pub sigma_m: f64,
}

/// The [`LidarEdge`] of a match, likewise.
pub(super) struct MatchedEdge {
    pub found: Arc<Correspondences>,
    pub number: u32,
    pub sigma_m: f64,
}

impl MatchedPlane {
    fn plane(&self) -> Result<LidarPlane, Undefined> {
        let found = self.found.planes.get(self.number as usize);
        let found = found.ok_or(Undefined)?;
        Ok(LidarPlane {
            point_in_n: found.point_in_n,
            point_in_m: found.plane_in_m.point,
            normal_in_m: found.plane_in_m.normal,
            sigma_m: self.sigma_m,
        })
    }
}

impl MatchedEdge {
    fn edge(&self) -> Result<LidarEdge, Undefined> {
        let found = self.found.edges.get(self.number as usize);
        let found = found.ok_or(Undefined)?;
        Ok(LidarEdge {
            point_in_n: found.point_in_n,
            point_in_m: found.edge_in_m.point,
            direction_in_m: found.edge_in_m.direction,
            sigma_m: self.sigma_m,
        })
    }
}

macro_rules! as_residual {
    ($matched:ident, $of:ident, $dimension:literal) => {
        impl Residual for $matched {
            fn dimension(&self) -> usize {
                $dimension
            }

            fn blocks(&self) -> &[Shape] {
                const {
                    &[
                        Shape::of::<lsfb_geometry::Se3>(),
                        Shape::of::<lsfb_geometry::Se3>(),
                    ]
                }
            }

            fn evaluate(
                &self,
                parameters: &Parameters<'_>,
                out: &mut Linearization<'_>,
            ) -> Result<(), Undefined> {
                self.$of()?.evaluate(parameters, out)
            }
        }
    };
}

as_residual!(MatchedPlane, plane, 1);
as_residual!(MatchedEdge, edge, 3);
