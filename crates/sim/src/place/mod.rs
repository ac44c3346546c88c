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
use crate::world::World;
use crate::world::crowd::Stroll;
pub use calibration::{CalibrationBoard, TAG_M};
pub(crate) use route::{Route, route};
use site::{Area, Site};

impl Place {
    /// Builds what is configured.
    pub(crate) fn build(config: &SimConfig, progress: ProgressFn) -> Result<World, Error> {
        let (place, seed, texel_m) = (config.place, config.seed, config.texel_m);
        let mut site = Site::new(seed, config.months_later.into());
        let [w, d] = place.size_m().map(|v| v as f32);
        let whole = Area::new([0.0, w], [0.0, d]);
        match place {
            Self::Demo => return Ok(World::build(seed, texel_m, progress)?),
            Self::Imported => return World::of_file(&config.scene),
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
        Ok(World::of(&site.plan, seed, texel_m, progress)?)
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
