//! What two maps that meet may say against being joined: images that are in both, and surveys that put them elsewhere.

use std::collections::BTreeSet;

use lsfb_geometry::{Se3, Vector3};

use super::{HdMap, Pair};
use crate::hd_map::SiteFrame;
use crate::{Error, Refusal};

/// So many points with an observation in both maps are no coincidence: pixels are real numbers, or one of a hundred thousand.
const SAME_POINTS: usize = 5;

/// Refuses maps of the same images: each observation would count twice, and points seem better known than they are by √2. Images are
/// known by their stamps and by the pixels of the points that the maps share: images without times have the same stamps.
pub(super) fn expect_other_images(
    first: &HdMap,
    second: &HdMap,
    shared: &[Pair],
) -> Result<(), Error> {
    let seen = |map: &HdMap, point: u32| -> BTreeSet<(Option<i64>, [u32; 2])> {
        let observations = map.observations(point);
        observations
            .map(|o| {
                let time = map.keyframe(o.keyframe).map(|k| k.time.nanos());
                (time, o.pixel.map(f32::to_bits))
            })
            .collect()
    };
    let same = shared
        .iter()
        .filter(|p| !seen(first, p.first).is_disjoint(&seen(second, p.second)));
    let points = same.count();
    match points >= SAME_POINTS {
        true => Err(Refusal::SameImages {
            points,
            shared: shared.len(),
        }
        .into()),
        false => Ok(()),
    }
}

/// The surveyed frame of both together: that of the first, which the result's is. Where both are surveyed, `first_from_second` must put
/// the second within `most_m` of where its own survey has it.
pub(super) fn common_site(
    first: &HdMap,
    second: &HdMap,
    first_from_second: &Se3,
    most_m: f64,
) -> Result<Option<SiteFrame>, Error> {
    let (mut site, other) = match (first.site(), second.site()) {
        (None, Some(_)) => return Err(Error::SurveyedSecond),
        (site, None) => return Ok(site.cloned()),
        (Some(site), Some(other)) => (site.clone(), other),
    };
    let [to_first, to_second] = [&site, other].map(|s| Vector3::from(s.origin_m));
    let shifts = second.keyframes().map(|k| {
        let place = k.world_from_rig.translation;
        (*first_from_second * place + to_first - (place + to_second)).norm()
    });
    let shift_m = shifts.fold(0.0, f64::max);
    if shift_m > most_m {
        return Err(Refusal::SurveysDisagree { shift_m, most_m }.into());
    }
    for name in &other.control_points {
        if !site.control_points.contains(name) {
            site.control_points.push(name.clone());
        }
    }
    Ok(Some(site))
}
