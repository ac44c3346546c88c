//! The places: Table VI of the paper, the demo's room, and a room for calibration.

mod calibration;
mod dress;
mod indoor;
mod office;
mod park;
mod route;
mod site;

use lsfb_types::ProgressFn;

use crate::Error;
use crate::config::{Place, SimConfig};
use crate::world::crowd::Stroll;
use crate::world::{Blueprint, LitPlace, World};
pub use calibration::{CalibrationBoard, TAG_M};
pub(crate) use route::{Route, route};
use site::{Area, Site};

impl Place {
    /// Builds what is configured.
    pub(crate) fn build(config: &SimConfig, progress: ProgressFn) -> Result<World, Error> {
        let (seed, texel_m) = (config.seed, config.texel_m);
        match config.place {
            Self::Demo => return Ok(World::build(seed, texel_m, progress)?),
            Self::Imported => return World::of_file(&config.scene),
            _ => {}
        }
        let plan = Self::plan(config);
        match config.light.baked {
            true => World::traced(&plan, seed, texel_m, &config.light, progress),
            false => Ok(World::of(&plan, seed, texel_m, progress)?),
        }
    }

    /// What a place consists of; nothing for the demo's and imported ones.
    fn plan(config: &SimConfig) -> Blueprint {
        let place = config.place;
        let mut site = Site::new(config.seed, config.months_later.into());
        let [w, d] = place.size_m().map(|v| v as f32);
        let whole = Area::new([0.0, w], [0.0, d]);
        match place {
            Self::Demo | Self::Imported => {}
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
        site.plan.strolls.extend(crowd(place, config.crowd));
        if !config.people {
            site.plan.strolls.clear();
        }
        site.plan.look = config.look;
        site.plan
    }
}

impl LitPlace {
    /// A place with its lamps, sky and sun; empty for the demo's place and imported ones.
    pub fn of(config: &SimConfig) -> Self {
        let plan = Place::plan(config);
        Self::new(&plan.builder.surfaces, plan.sun)
    }
}

/// People on the ways that scanner and walks take, each at a pace of their own.
fn crowd(place: Place, count: u32) -> impl Iterator<Item = Stroll> {
    (0..count).map(move |k| {
        let way = [Route::Scan, Route::Loop][(k % 2) as usize];
        let corners = route(place, way).into_iter();
        Stroll {
            corners: corners.map(|corner| corner.map(|v| v as f32)).collect(),
            speed_m_s: 0.5 + 0.13 * (k % 7) as f32,
            start_m: 7.3 * k as f32,
        }
    })
}

#[cfg(test)]
mod tests;
