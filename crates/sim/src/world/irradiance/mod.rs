//! Light as it is in a real place: how much of it arrives at every point of every surface, from lamps, sky and sun, straight and by way of other
//! surfaces.
//!
//! Units are those of light as people and cameras see it: illuminance in lux, luminance in cd/m².

mod emitters;
mod lattice;
mod optics;
mod probes;
mod scene;
mod store;
mod straight;
mod tracer;

pub(crate) use lattice::{Baking, bake};
pub(crate) use optics::Optics;
pub(crate) use probes::Probes;
pub(crate) use scene::{PointLight, Scene, SunDisc};
pub(crate) use store::{Baked, Found, key, path, read, write};
pub(crate) use tracer::Spot;

#[cfg(test)]
mod tests;
