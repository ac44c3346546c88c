//! Scans: deskewed to one instant, reduced, gathered into planes, registered to planes.

mod deskew;
mod level;
mod local_map;
mod observability;
mod plane;
mod plane_map;
mod registration;
mod scan_finder;
mod voxels;

pub use deskew::{KNOT_NS, Motion, MotionKnot, RangeWindow, deskew, deskew_rings};
pub use local_map::{LocalMap, LocalMapConfig};
pub use observability::{Direction, Observability, observability};
pub use plane::{Plane, PointSums};
pub use plane_map::PlaneMap;
pub use registration::{Match, PosePrior, Registration, RegistrationConfig, Weighting, register};
pub use scan_finder::ScanFinder;
pub use voxels::{CellMap, cell_key, neighbour_key, voxel_downsample};
