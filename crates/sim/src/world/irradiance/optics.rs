//! What surfaces do to light.

/// What a surface does to light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Optics {
    /// Share of the light that is scattered, equally in all directions, 0–1.
    pub albedo: f32,
    /// Its own luminance, the same in all directions before it, cd/m².
    pub luminance_cd_m2: f32,
    /// Whether one sees through it.
    pub glass: bool,
    /// Whether it is so far away that nothing lights it and nothing is shaded by it.
    pub backdrop: bool,
    /// Whether it is one of many small sheets among each other, none of which is looked at closely: leaves.
    pub leaf: bool,
}
