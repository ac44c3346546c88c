//! Eight rays at a time.

use wide::f32x8;

/// Rays in one packet.
pub const LANES: usize = 8;

/// Where the rays of a packet start, metres in the world.
#[derive(Clone, Copy, Debug)]
pub enum Origin {
    /// All at one point.
    Shared([f32; 3]),
    /// Each at its own.
    Each([f32x8; 3]),
}

/// Eight rays; coherent ones are cheap, any are right.
#[derive(Clone, Copy, Debug)]
pub struct RayPacket {
    /// Where they start.
    pub origin: Origin,
    /// Directions; distances count in their lengths.
    pub direction: [f32x8; 3],
}

impl RayPacket {
    /// Eight rays from one point.
    pub fn from_point(origin: [f32; 3], direction: [f32x8; 3]) -> Self {
        Self {
            origin: Origin::Shared(origin),
            direction,
        }
    }

    /// One ray in every lane.
    pub fn splat(origin: [f32; 3], direction: [f32; 3]) -> Self {
        Self::from_point(origin, direction.map(f32x8::splat))
    }
}

/// What the rays of a packet hit.
#[derive(Clone, Copy, Debug)]
pub struct PacketHit {
    /// Distance along each ray in lengths of its direction; the limit given where nothing was hit.
    pub distance: f32x8,
    /// Index of the facet hit; [`NO_FACET`] where none was.
    pub facet: [u32; LANES],
    /// Who carries that facet: 0 for the building, else a walker's number from 1.
    pub carrier: [u8; LANES],
}

impl PacketHit {
    /// Nothing hit, up to a limit.
    pub(crate) fn nothing(limit: f32x8) -> Self {
        Self {
            distance: limit,
            facet: [NO_FACET; LANES],
            carrier: [0; LANES],
        }
    }
}

/// No facet was hit.
pub const NO_FACET: u32 = u32::MAX;
