//! Somebody who steps close before the camera, stays a moment, and leaves to the other side.

use lsfb_geometry::Vector3;

use super::{Walk, smooth_step};
use crate::noise::{stream, uniform};
use crate::world::crowd::Passer;

/// Time from one to the next, seconds, and how much earlier or later it may be.
const EVERY_S: [f64; 2] = [13.0, 4.0];
/// How long somebody is there, seconds.
const STAY_S: f64 = 3.0;
/// Share of that time for coming, and for leaving.
const STEP_SHARE: f64 = 0.38;
/// How far before the camera they stand, and how far to the side they come from, metres.
const AHEAD_M: f64 = 0.38;
const ASIDE_M: f64 = 1.4;
/// Height of the camera above their feet, metres: somebody tall, whose shoulders are before it.
const SHOULDERS_M: f64 = 1.36;

/// When, and which way the camera looks then.
#[derive(Clone, Debug, Default)]
pub(crate) struct Passers {
    visits: Vec<Visit>,
}

#[derive(Clone, Copy, Debug)]
struct Visit {
    from_s: f64,
    /// Unit vector along which the camera looks in the middle of the visit.
    ahead: [f64; 2],
    /// 1 from the left, −1 from the right.
    side: f64,
}

impl Passers {
    /// Visits all along a walk.
    pub(crate) fn of(walk: &Walk, seed: u64) -> Self {
        let rng = stream(seed, "passers", 0);
        let [every, vary] = EVERY_S;
        let mut visits = Vec::new();
        let mut from_s = 0.6 * every;
        while from_s + STAY_S < walk.duration_s() {
            let pose = walk.at(from_s + 0.5 * STAY_S).world_from_rig;
            let ahead = pose.rotation * Vector3::x();
            let length = ahead.x.hypot(ahead.y).max(1e-6);
            visits.push(Visit {
                from_s,
                ahead: [ahead.x / length, ahead.y / length],
                side: if uniform(&rng, -1.0, 1.0) < 0.0 {
                    -1.0
                } else {
                    1.0
                },
            });
            from_s += every + vary * f64::from(uniform(&rng, -1.0, 1.0));
        }
        Self { visits }
    }

    /// Who stands before a camera at a place.
    pub(crate) fn at(&self, time_s: f64, camera: &Vector3<f64>) -> Option<Passer> {
        let visit = self
            .visits
            .iter()
            .find(|v| (v.from_s..v.from_s + STAY_S).contains(&time_s))?;
        let share = (time_s - visit.from_s) / STAY_S;
        let come = smooth_step(share / STEP_SHARE);
        let gone = smooth_step((share - 1.0 + STEP_SHARE) / STEP_SHARE);
        let aside_m = visit.side * ASIDE_M * (1.0 - come - gone);
        let [x, y] = visit.ahead;
        Some(Passer {
            feet: [
                camera.x + AHEAD_M * x - aside_m * y,
                camera.y + AHEAD_M * y + aside_m * x,
                camera.z - SHOULDERS_M,
            ]
            .map(|v| v as f32),
            heading: [x as f32, y as f32],
        })
    }
}

#[cfg(test)]
mod tests {
    use wide::f32x8;

    use crate::world::RayPacket;
    use crate::{Device, PaperMotion, SimConfig, Simulation};
    use lsfb_geometry::Vector3;
    use lsfb_types::no_progress;

    #[test]
    fn on_m2_alone_somebody_hides_most_of_the_view_now_and_then() {
        for (name, hidden) in [("M1", 0..1), ("M2", 15..90)] {
            let motion = PaperMotion::named(name).expect("a sequence");
            let mut config = SimConfig::for_motion(motion, Device::Android);
            config.texel_m = 0.1;
            let simulation = Simulation::new(&config, &no_progress).expect("valid");
            let (world, rig) = (simulation.world(), simulation.glasses());
            let camera = &rig.rig().cameras["cam0"];
            let mut mostly = 0;
            let seconds = rig.walk().duration_s() as u32;
            for half in 0..2 * seconds {
                let time_s = 0.5 * f64::from(half);
                let world_from_rig = rig.walk().at(time_s).world_from_rig;
                let eye = world_from_rig * camera.rig_from_camera;
                let place = world_from_rig.translation;
                let passer = rig.camera(0).expect("camera").passer(time_s, &place);
                let walker = [place.x as f32, place.y as f32];
                let moment = world.moment_with(time_s, walker, passer);
                // Across the whole image, 67 by 53 degrees.
                let rays = (0..8).flat_map(|j| (0..8).map(move |i| [i, j]));
                let near = rays.filter(|[i, j]| {
                    let at = |k: &i32, half: f64| half * (f64::from(*k) - 3.5) / 3.5;
                    let ray = eye.rotation * Vector3::new(at(i, 0.66), at(j, 0.5), 1.0).normalize();
                    let rays = RayPacket::splat(
                        eye.translation.map(|v| v as f32).into(),
                        ray.map(|v| v as f32).into(),
                    );
                    let hit = world.cast_at(&rays, f32x8::splat(100.0), &moment);
                    hit.carrier[0] > 0 && hit.distance.to_array()[0] < 0.75
                });
                mostly += i32::from(near.count() > 38);
            }
            // Per thousand of the time.
            let share = 1000 * mostly / (2 * seconds as i32);
            assert!(hidden.contains(&share), "{name}: {share}");
        }
    }
}
