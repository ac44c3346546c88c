//! Places in true light: what their materials and lamps are in lux and cd/m², and the light that follows, computed or read.

use std::path::PathBuf;

use lsfb_types::ProgressFn;

use super::builder::Surface;
use super::crowd::Stroll;
use super::facet::{Facet, Outline};
use super::irradiance::{
    Baked, Baking, Found, Optics, PointLight, Probes, Scene, Spot, SunDisc, bake, key, path, read,
    write,
};
use super::light::{LightGrid, Sky};
use super::material::Material;
use super::skin::LightMaps;
use super::substance::Substance;
use super::vector::{cross, norm};
use crate::Error;
use crate::config::LightConfig;

/// Illuminance under which a white surface is white at the nominal exposure, lux: a well lit office (EN 12464-1 asks for 500 on desks).
pub(crate) const NOMINAL_LX: f32 = 500.0;
/// Luminance of windows in daylight, seen from outside: a share of the sky mirrored, little from within, cd/m².
const WINDOW_FROM_OUTSIDE_CD_M2: f32 = 500.0;
/// Edge of what a crowd may reach beyond its ways, metres.
const AROUND_WAYS_M: f32 = 3.0;

/// What computing the light of a place came to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LightReport {
    /// Points at which light is held.
    pub points: usize,
    /// The file it was read from or written to.
    pub file: Option<PathBuf>,
    /// Whether it was read, not computed.
    pub read: bool,
    /// What was wrong with the file that was there; the light was computed again.
    pub damaged: Option<String>,
}

/// Light of a world, beyond what each facet has.
#[derive(Clone, Debug)]
pub(super) struct Lit {
    pub probes: Probes,
    /// Of all facets: share of a mirror's reflection.
    pub gloss: Vec<f32>,
    /// Of the facets that do not move: whether they shine by themselves.
    pub shines: Vec<bool>,
    pub sun: Option<SunDisc>,
    pub report: LightReport,
}

impl Lit {
    /// Square root of the light on a small surface in the air, 1 being nominal.
    pub(super) fn around(&self, point: [f32; 3], normal: [f32; 3]) -> f32 {
        let lux = self.probes.at(point, normal).unwrap_or(NOMINAL_LX);
        (lux / NOMINAL_LX).sqrt()
    }
}

/// A place as light sees it, for whoever wants to check it: its surfaces and lamps, and the illuminance at any point of it.
pub struct LitPlace {
    surfaces: Vec<(Facet, Optics)>,
    sun: Option<SunDisc>,
    scene: Scene,
}

/// A surface of a [`LitPlace`].
#[derive(Clone, Debug, PartialEq)]
pub struct LitSurface {
    /// Three or four, counter-clockwise from the visible side, metres.
    pub vertices: Vec<[f32; 3]>,
    /// Share of the light that is scattered, 0–1.
    pub albedo: f32,
    /// Its own luminance before it, cd/m².
    pub luminance_cd_m2: f32,
    /// Whether one sees through it. A pane consists of two of them, back to back.
    pub glass: bool,
}

impl LitPlace {
    pub(crate) fn new(surfaces: &[Surface], sky: Sky) -> Self {
        let surfaces = optics_of(surfaces, sky);
        let (sun, void) = shining(sky);
        Self {
            scene: Scene::new(&surfaces, sun, void),
            surfaces,
            sun,
        }
    }

    /// All surfaces that do not move.
    pub fn surfaces(&self) -> impl Iterator<Item = LitSurface> {
        self.surfaces.iter().map(|(facet, optics)| LitSurface {
            vertices: facet.vertices(),
            albedo: optics.albedo,
            luminance_cd_m2: optics.luminance_cd_m2,
            glass: optics.glass,
        })
    }

    /// Where the sun is (a unit vector towards it), and the illuminance of what faces it, lux; `None` where there is none.
    pub fn sun(&self) -> Option<([f32; 3], f32)> {
        self.sun.map(|sun| (sun.direction, sun.illuminance_lx))
    }

    /// Illuminance of a surface at `point` that faces along the unit vector `normal`, lux, as the mean of so many paths.
    pub fn illuminance_lx(&self, point: [f32; 3], normal: [f32; 3], paths: u32, seed: u64) -> f32 {
        let spot = Spot { point, normal };
        self.scene.illuminance_lx(&spot, paths as usize, seed)
    }
}

/// What lights a place besides its surfaces.
#[derive(Clone, Debug, Default)]
pub(super) struct Lights {
    pub sun: Option<SunDisc>,
    /// Luminance of what no surface closes off, cd/m².
    pub void_cd_m2: f32,
    pub points: Vec<PointLight>,
}

/// The light of a place: of the `count` first of its surfaces, which do not move, and in the air around people's ways.
pub(super) fn light(
    surfaces: &[Surface],
    count: usize,
    (sky, strolls): (Sky, &[Stroll]),
    config: &LightConfig,
    seed: u64,
    progress: ProgressFn,
) -> Result<(LightMaps, Lit), Error> {
    let optics = optics_of(&surfaces[..count], sky);
    let (sun, void_cd_m2) = shining(sky);
    let lights = Lights {
        sun,
        void_cd_m2,
        points: Vec::new(),
    };
    let gloss = surfaces.iter().map(|s| s.material.gloss).collect();
    trace(
        (&optics, gloss),
        &lights,
        ways(strolls),
        config,
        seed,
        progress,
    )
}

/// The light of surfaces, and in the air of a box on the floor; or what was kept of it. `gloss` is that of all facets, those that move too.
pub(super) fn trace(
    (optics, gloss): (&[(Facet, Optics)], Vec<f32>),
    lights: &Lights,
    walked: Option<[[f32; 3]; 2]>,
    config: &LightConfig,
    seed: u64,
    progress: ProgressFn,
) -> Result<(LightMaps, Lit), Error> {
    let count = optics.len();
    let baking = Baking {
        spacing_m: match config.spacing_m {
            0.0 => spacing_m(optics),
            wanted_m => wanted_m as f32,
        },
        paths: config.paths as usize,
        seed,
    };
    let (sun, void_cd_m2) = (lights.sun, lights.void_cd_m2);
    let key = key(optics, (sun, &lights.points), void_cd_m2, &baking, walked);
    let file = (!config.cache.as_os_str().is_empty()).then(|| path(&config.cache, &key));
    let found = match &file {
        Some(file) => read(file, &key),
        None => Found::Nothing,
    };
    let (known, damaged) = match found {
        Found::Light(light) if light.grids.len() == count => (Some(light), None),
        Found::Light(_) => (None, Some("it belongs to another place".to_owned())),
        Found::Nothing => (None, None),
        Found::Damaged(problem) => (None, Some(problem)),
    };
    let is_read = known.is_some();
    let baked = match known {
        Some(light) => light,
        None => {
            let scene = Scene::new(optics, sun, void_cd_m2).with_points(lights.points.clone());
            let light = Baked {
                grids: bake(&scene, optics, &baking, progress)?,
                probes: walked
                    .map(|area| Probes::bake(&scene, area, seed))
                    .unwrap_or_default(),
            };
            if let Some(file) = &file {
                write(file, &key, &light)?;
            }
            light
        }
    };
    let mut maps = LightMaps::default();
    for (grid, (_, optics)) in baked.grids.iter().zip(optics) {
        let relative = LightGrid {
            values: grid.values.iter().map(|lx| lx / NOMINAL_LX).collect(),
            ..*grid
        };
        maps.push(&relative, exitance_lx(optics) / NOMINAL_LX);
    }
    let report = LightReport {
        points: baked.grids.iter().map(|grid| grid.values.len()).sum(),
        file,
        read: is_read,
        damaged,
    };
    let lit = Lit {
        probes: baked.probes,
        gloss,
        shines: optics.iter().map(|o| o.1.luminance_cd_m2 > 0.0).collect(),
        sun,
        report,
    };
    Ok((maps, lit))
}

/// Illuminance under which a surface would be as bright as it shines, lux.
fn exitance_lx(optics: &Optics) -> f32 {
    std::f32::consts::PI * optics.luminance_cd_m2 / optics.albedo.max(0.02)
}

fn optics_of(surfaces: &[Surface], sky: Sky) -> Vec<(Facet, Optics)> {
    let outside = sky.sun().is_some();
    let optics = |material: &Material, is_leaf: bool| Optics {
        albedo: material.tone.clamp(0.02, 0.95),
        luminance_cd_m2: match material.substance {
            Substance::Glass if outside && material.luminance_cd_m2 > 0.0 => {
                WINDOW_FROM_OUTSIDE_CD_M2
            }
            _ => material.luminance_cd_m2,
        },
        glass: material.glass,
        backdrop: material.is_backdrop(),
        leaf: is_leaf && material.substance == Substance::Leaves,
    };
    let is_leaf = |facet: &Facet| facet.outline() == Outline::Triangle;
    let with = |s: &Surface| (s.facet, optics(&s.material, is_leaf(&s.facet)));
    surfaces.iter().map(with).collect()
}

/// The sun, and the luminance of the sky where no backdrop is.
fn shining(sky: Sky) -> (Option<SunDisc>, f32) {
    let sun = match sky {
        Sky::Covered => return (None, 0.0),
        Sky::Night => return (None, Material::NIGHT_SKY.luminance_cd_m2),
        Sky::Day(sun) => sun,
    };
    // IES RP-21, "Calculation of Daylight Availability", clear sky: 128 klx outside the atmosphere, extinction 0.21 for each air mass.
    let air_mass = 1.0 / sun.direction[2].max(0.05);
    let disc = SunDisc {
        direction: sun.direction,
        illuminance_lx: 128_000.0 * (-0.21 * air_mass).exp(),
    };
    (Some(disc), Material::SKY.luminance_cd_m2)
}

/// Distance between the points at which light is computed: contact shadows of chairs where a place is small enough, of furniture elsewhere.
fn spacing_m(surfaces: &[(Facet, Optics)]) -> f32 {
    let near = surfaces.iter().filter(|(_, optics)| !optics.backdrop);
    let area_m2: f32 = near
        .map(|(facet, _)| norm(cross(facet.edge_a, facet.edge_b)))
        .sum();
    match area_m2 {
        ..1500.0 => 0.05,
        1500.0..4000.0 => 0.075,
        _ => 0.1,
    }
}

/// The box on the floors that people walk in; `None` where nobody does.
fn ways(strolls: &[Stroll]) -> Option<[[f32; 3]; 2]> {
    let corners = strolls.iter().flat_map(|s| &s.corners);
    let mut ends = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    for corner in corners {
        for i in 0..3 {
            let around = if i < 2 { AROUND_WAYS_M } else { 0.0 };
            ends[0][i] = ends[0][i].min(corner[i] - around);
            ends[1][i] = ends[1][i].max(corner[i] + around);
        }
    }
    (ends[0][0] <= ends[1][0]).then_some(ends)
}

#[cfg(test)]
mod tests {
    use lsfb_types::no_progress;
    use wide::f32x8;

    use super::*;
    use crate::world::builder::{Faces, Placement};
    use crate::world::{Blueprint, LANES, RayPacket, World};

    /// A polished floor below a lamp, nothing else.
    fn floor_and_lamp() -> Blueprint {
        let mut blueprint = Blueprint::default();
        let out = &mut blueprint.builder;
        let (along, across) = ([8.0, 0.0, 0.0], [0.0, 8.0, 0.0]);
        out.quad([-4.0, -4.0, 0.0], along, across, Material::VINYL);
        let (low, high) = ([-0.15, -0.15, 2.4], [0.15, 0.15, 2.5]);
        let here = Placement::new([0.0; 3], 0.0);
        out.cuboid(&here, low, high, Faces::All, Material::LAMP);
        blueprint
    }

    fn traced(config: &LightConfig) -> World {
        World::traced(&floor_and_lamp(), 2, 0.05, config, &no_progress).expect("lit")
    }

    fn quick() -> LightConfig {
        LightConfig {
            baked: true,
            spacing_m: 0.2,
            paths: 16,
            ..LightConfig::default()
        }
    }

    /// The brightest place of the floor along y = 0, as seen from an eye above it.
    fn highlight_x(world: &World, eye: [f32; 3]) -> f32 {
        let moment = world.moment(0.0, [100.0, 100.0]);
        let mut best = (0.0, 0.0);
        for k in 0..400 {
            let x = -2.0 + 0.01 * k as f32;
            let to = [x - eye[0], -eye[1], -eye[2]];
            let length = norm(to);
            let rays = RayPacket::from_point(eye, to.map(|v| f32x8::splat(v / length)));
            let value = world.see(&rays, 0.002, &moment)[LANES - 1].value;
            if value > best.0 {
                best = (value, x);
            }
        }
        best.1
    }

    #[test]
    fn highlights_move_with_the_viewer() {
        let world = traced(&quick());
        for x in [-1.2_f32, 0.0, 0.9] {
            let found = highlight_x(&world, [x, 0.0, 1.5]);
            // Where the way from the eye to the lamp's image below the floor goes through it.
            let expected = x + (0.0 - x) * 1.5 / (1.5 + 2.4);
            assert!((found - expected).abs() < 0.13, "{found} {expected}");
        }
    }

    #[test]
    fn light_that_was_kept_is_read_and_damaged_light_is_made_again() {
        let folder = tempfile::tempdir().expect("folder");
        let config = LightConfig {
            cache: folder.path().join("light"),
            ..quick()
        };
        let at = |world: &World| {
            (0..world.facets().len())
                .map(|k| world.illuminance_lx(k, [0.3, 0.6]))
                .collect::<Vec<_>>()
        };
        let first = traced(&config);
        let report = first.light_report().expect("traced");
        assert!(!report.read && report.damaged.is_none());
        let file = report.file.clone().expect("kept");
        let second = traced(&config);
        assert!(second.light_report().expect("traced").read);
        assert_eq!(at(&first), at(&second));
        let mut bytes = std::fs::read(&file).expect("there");
        bytes[200] ^= 1;
        std::fs::write(&file, bytes).expect("written");
        let third = traced(&config);
        let report = third.light_report().expect("traced");
        assert!(!report.read && report.damaged.is_some());
        assert_eq!(at(&first), at(&third));
        assert!(traced(&config).light_report().expect("traced").read);
    }
}
