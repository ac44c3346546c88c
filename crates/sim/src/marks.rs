//! Marks on walls and furniture that somebody clicks in images of the scanner and measures between with a tape, as for Table II of the paper.
//!
//! The clicks are somebody's work and lie beside the recording, as are the coordinates of every other mark by a total station; what the tape says is truth.

use std::fmt::Write as _;

use lsfb_geometry::{Camera, Se3, Vector2, Vector3, so3};

use crate::noise::{below, next_gaussian, stream, unit};
use crate::simulation::Simulation;

/// Marks in a place, at most.
const MARKS: usize = 10;
/// Places that are looked at for them.
const TRIALS: usize = 400;
/// Images in which each is clicked, at most.
const CLICKS: usize = 8;
/// Images in which it must be seen to be chosen.
const LEAST_VIEWS: usize = 5;
/// How well is clicked, pixels in each direction, 1 σ.
const CLICK_SIGMA_PX: f64 = 0.5;
/// How well is measured, metres, 1 σ.
const TAPE_SIGMA_M: f64 = 0.001;
/// How well a total station measures, metres along each axis, 1 σ.
const STATION_SIGMA_M: f64 = 0.003;
/// Where the frame of the total station has the origin of the world, metres, and by how much it is turned, radians.
const STATION_ORIGIN_M: [f64; 3] = [1204.0, 787.0, 112.0];
const STATION_TURN_RAD: f64 = 0.6;
/// Marks are chosen in this range, and clicked up to the larger one, metres.
const CHOSEN_M: std::ops::Range<f64> = 1.0..8.0;
const CLICKED_M: f64 = 10.0;
/// Marks stand at least so far apart, metres: what is measured goes through the place.
const APART_M: f64 = 1.5;
/// Least angle between two views of a mark, radians.
const LEAST_PARALLAX_RAD: f64 = 0.25;
/// A ray that ends so near a mark meets it, metres.
const MET_M: f64 = 0.02;
/// Nobody clicks at the very edge of an image, pixels.
const EDGE_PX: f64 = 4.0;

/// Clicks and distances.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Marks {
    /// Clicks on marks in images of the scanner: lines of `mark,camera,time_ns,u_px,v_px`, as `lsfb map distances` reads them.
    pub clicks: String,
    /// What a tape says of the distances between all of them: a survey, as `lsfb survey` reads it.
    pub survey: String,
    /// Coordinates of every other mark by a total station, in a frame of its own, as `lsfb map --control-points` reads them; empty where there are fewer than
    /// three.
    pub control_points: String,
}

/// A camera at the moment of an image.
struct Shot<'a> {
    name: &'a str,
    camera: &'a Camera,
    time_ns: i64,
    world_from_camera: Se3,
}

/// A mark in an image.
struct Sight<'a> {
    shot: &'a Shot<'a>,
    pixel: Vector2<f64>,
    direction: Vector3<f64>,
}

impl Simulation {
    /// Marks that the scanner's images show from several sides; none where it hardly moves.
    pub fn marks(&self) -> Marks {
        let rig = self.scan();
        let shots: Vec<Shot> = (0..rig.frame_count())
            .flat_map(|frame| {
                let offset_ns = rig.frame_offset_ns(frame);
                let world_from_rig = rig.walk().at(offset_ns as f64 * 1e-9).world_from_rig;
                let time_ns = rig.time(offset_ns).nanos();
                let cameras = rig.rig().cameras.iter();
                cameras.map(move |(name, mounted)| Shot {
                    name,
                    camera: &mounted.camera,
                    time_ns,
                    world_from_camera: world_from_rig * mounted.rig_from_camera,
                })
            })
            .collect();
        let dice = stream(rig.seed(), "marks", 0);
        let mut clicks = String::from("mark,camera,time_ns,u_px,v_px\n");
        let mut places: Vec<Vector3<f64>> = Vec::new();
        for _ in 0..TRIALS {
            if places.len() == MARKS || shots.is_empty() {
                break;
            }
            let shot = &shots[below(&dice, shots.len())];
            let [u, v] = [(); 2].map(|()| unit(dice.bits()));
            let pixel = Vector2::new(
                u * f64::from(shot.camera.width - 1),
                v * f64::from(shot.camera.height - 1),
            );
            let Some(place) = self.surface_at(shot, &pixel) else {
                continue;
            };
            if places.iter().any(|p| (p - place).norm() < APART_M) {
                continue;
            }
            let seen: Vec<Sight> = shots.iter().filter_map(|s| self.sight(s, &place)).collect();
            let step = seen.len().div_ceil(CLICKS).max(1);
            let clicked: Vec<&Sight> = seen.iter().step_by(step).collect();
            let parallax = |s: &&Sight| s.direction.angle(&clicked[0].direction);
            if clicked.len() < LEAST_VIEWS
                || !clicked.iter().any(|s| parallax(s) > LEAST_PARALLAX_RAD)
            {
                continue;
            }
            for sight in clicked {
                let [u, v] = [sight.pixel.x, sight.pixel.y]
                    .map(|at| at + CLICK_SIGMA_PX * next_gaussian(&dice));
                let Shot { name, time_ns, .. } = sight.shot;
                let _ = writeln!(clicks, "m{},{name},{time_ns},{u:.2},{v:.2}", places.len());
            }
            places.push(place);
        }
        let mut survey = format!("sigma distance {TAPE_SIGMA_M}\n");
        for (b, to) in places.iter().enumerate() {
            for (a, from) in places[..b].iter().enumerate() {
                let read_m = (to - from).norm() + TAPE_SIGMA_M * next_gaussian(&dice);
                let _ = writeln!(survey, "distance m{a} m{b} {read_m:.4}");
            }
        }
        Marks {
            clicks,
            survey,
            control_points: control_points(rig.seed(), &places),
        }
    }

    /// What a pixel shows, where that is near enough to be measured and no glass.
    fn surface_at(&self, shot: &Shot, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let ray = shot.world_from_camera.rotation * shot.camera.unproject(pixel)?;
        let origin = shot.world_from_camera.translation;
        let hit = self.world().cast(narrow(&origin), narrow(&ray))?;
        let far_m = f64::from(hit.distance) * ray.norm();
        let chosen = CHOSEN_M.contains(&far_m) && !self.world().is_glass(hit.facet);
        chosen.then(|| origin + ray * f64::from(hit.distance))
    }

    /// A place in an image; `None` where it is outside, too far, or hidden.
    fn sight<'a>(&self, shot: &'a Shot<'a>, place: &Vector3<f64>) -> Option<Sight<'a>> {
        let origin = shot.world_from_camera.translation;
        let along = place - origin;
        let far_m = along.norm();
        if far_m >= CLICKED_M {
            return None;
        }
        let in_camera = shot.world_from_camera.inverse() * *place;
        let pixel = shot.camera.project(&in_camera)?;
        let inside = |at: f64, size: u32| (EDGE_PX..f64::from(size) - 1.0 - EDGE_PX).contains(&at);
        if !inside(pixel.x, shot.camera.width) || !inside(pixel.y, shot.camera.height) {
            return None;
        }
        let direction = along / far_m;
        let hit = self.world().cast(narrow(&origin), narrow(&direction))?;
        let met = (f64::from(hit.distance) - far_m).abs() < MET_M;
        met.then_some(Sight {
            shot,
            pixel,
            direction,
        })
    }
}

fn control_points(seed: u64, places: &[Vector3<f64>]) -> String {
    let chosen = places.iter().enumerate().step_by(2);
    if chosen.len() < 3 {
        return String::new();
    }
    let dice = stream(seed, "control points", 0);
    let turn = so3::exp(&(Vector3::z() * STATION_TURN_RAD));
    let mut text = String::from("mark,x_m,y_m,z_m,sigma_m\n");
    for (number, place) in chosen {
        let noise = [(); 3].map(|()| STATION_SIGMA_M * next_gaussian(&dice));
        let read = turn * place + Vector3::from(STATION_ORIGIN_M) + Vector3::from(noise);
        let _ = writeln!(
            text,
            "m{number},{:.4},{:.4},{:.4},{STATION_SIGMA_M}",
            read.x, read.y, read.z
        );
    }
    text
}

fn narrow(v: &Vector3<f64>) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}
