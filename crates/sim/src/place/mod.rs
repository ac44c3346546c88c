//! The places: Table VI of the paper, the demo's room, and a room for calibration.

mod calibration;
mod dress;
mod fire_door;
mod indoor;
mod night;
mod office;
mod park;
mod route;
mod site;

use lsfb_types::ProgressFn;

use crate::Error;
use crate::config::{Place, SimConfig};
use crate::world::crowd::Stroll;
use crate::world::{Blueprint, ClosedDoor, FloorPlan, LitPlace, World, furnish};
pub use calibration::{CalibrationBoard, TAG_M};
pub(crate) use fire_door::this_side;
pub(crate) use route::{Route, route, there_and_back};
use site::{Area, Site};

impl Place {
    /// Where the origin of this place lies in another of the same seed, metres, if the two are one world as far as both reach: the large office holds
    /// hall, atrium, corridors and stairs.
    pub fn origin_in(self, other: Self) -> Option<[f64; 2]> {
        let within = |part: Self| {
            let area = match part {
                Self::ExhibitionHall => office::EXHIBITION,
                Self::Atrium => office::ATRIUM,
                Self::WideCorridor => office::WIDE,
                Self::NarrowCorridor => office::NARROW,
                Self::Stairs => office::STAIRS,
                _ => return None,
            };
            Some([area.x[0], area.y[0]].map(f64::from))
        };
        match (self, other) {
            _ if self == other => Some([0.0; 2]),
            (part, Self::LargeOffice) => within(part),
            (Self::LargeOffice, part) => within(part).map(|at| at.map(|v| -v)),
            _ => None,
        }
    }

    /// Builds what is configured.
    pub(crate) fn build(config: &SimConfig, progress: ProgressFn) -> Result<World, Error> {
        let (seed, texel_m) = (config.seed, config.texel_m);
        let is_simple = !config.light.baked && config.look.is_plain();
        match config.place {
            Self::Demo if is_simple => return Ok(World::build(seed, texel_m, progress)?),
            Self::Imported => {
                return World::of_file(&config.scene, &config.light, seed, progress);
            }
            _ => {}
        }
        let plan = Self::plan(config);
        match config.light.baked {
            true => World::traced(&plan, seed, texel_m, &config.light, progress),
            false => Ok(World::of(&plan, seed, texel_m, progress)?),
        }
    }

    /// What a place consists of; nothing for imported ones.
    fn plan(config: &SimConfig) -> Blueprint {
        let place = config.place;
        let mut site = Site::new(config.seed, config.months_later.into());
        if config.night {
            night::begin(&mut site);
        }
        let [w, d] = place.size_m().map(|v| v as f32);
        let whole = Area::new([0.0, w], [0.0, d]);
        match place {
            Self::Demo => {
                let (builder, lamps) = furnish(&FloorPlan::new(config.seed), config.seed);
                (site.plan.builder, site.plan.lamps) = (builder, lamps);
            }
            Self::Imported => {}
            Self::Calibration => calibration::room(&mut site),
            Self::OfficePark => park::buildings(&mut site),
            Self::HousePark => park::houses(&mut site),
            Self::MediumOffice => office::medium(&mut site, whole),
            Self::LargeOffice => office::large(&mut site),
            Self::ExhibitionHall => indoor::exhibition(&mut site, whole),
            Self::Atrium => indoor::atrium(&mut site, whole),
            Self::WideCorridor => indoor::wide_corridor(&mut site, whole),
            Self::NarrowCorridor => indoor::narrow_corridor(&mut site, whole),
            Self::Stairs => indoor::stairs(&mut site, whole),
        }
        site.line_passages();
        if config.night {
            night::fall(&mut site);
        }
        if config.fire_door {
            fire_door::close(&mut site, config);
        }
        let people = crowd(place, config.crowd, site.plan.closed.as_ref());
        site.plan.strolls.extend(people);
        if !config.people {
            site.plan.strolls.clear();
        }
        site.plan.look = config.look;
        site.plan
    }
}

impl LitPlace {
    /// A place with its lamps, sky and sun; empty for imported ones.
    pub fn of(config: &SimConfig) -> Self {
        let plan = Place::plan(config);
        Self::new(&plan.builder.surfaces, plan.sky)
    }
}

/// People on the ways that scanner and walks take, each at a pace of their own.
fn crowd(place: Place, count: u32, closed: Option<&ClosedDoor>) -> impl Iterator<Item = Stroll> {
    (0..count).map(move |k| {
        let way = [Route::Scan, Route::Loop][(k % 2) as usize];
        let way = route(place, way);
        let way = match closed {
            Some(door) => this_side(door, way),
            None => way,
        };
        let corners = way.into_iter();
        Stroll {
            corners: corners.map(|corner| corner.map(|v| v as f32)).collect(),
            speed_m_s: 0.5 + 0.13 * (k % 7) as f32,
            start_m: 7.3 * k as f32,
        }
    })
}

#[cfg(test)]
mod tests;
