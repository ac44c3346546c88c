//! From a beginning to the whole walk: frames are added by the IMU's prediction and settled by tracks, then all at once.

use std::ops::Range;

use lsfb_solver::SolveConfig;
use lsfb_types::{Progress, ProgressFn};

use super::LARGEST_CONTRADICTED_SHARE;
use super::sights::Tracks;
use crate::ground_truth::GroundTruthConfig;
use crate::ground_truth::estimate::Estimate;
use crate::ground_truth::inertial::any_motion;
use crate::ground_truth::optimization::{Anchor, Optimized, choose_observations, optimize};
use crate::ground_truth::report::{GroundTruthWarning, local_errors};
use crate::ground_truth::settling::{farthest, is_few, not_at_rest};
use crate::ground_truth::walk::{FrameState, Walk};
use crate::{Error, Refusal};
use lsfb_perception::imu::{ImuBias, NavState, PreintegratedImu, standard_gravity_m_s2};

/// Frames are added for so long at a time, seconds: the IMU alone leads a few centimetres astray.
const STEP_SECS: f64 = 0.5;
/// So much before them is settled together with them, seconds.
const MEMORY_SECS: f64 = 4.0;
/// All is settled again when so many times as many frames are known as when it was last.
const GROWTH: f64 = 1.5;
/// Share of the cost below which a solve on the way ends.
const ON_THE_WAY: f64 = 1e-4;
/// A beginning is sound where it places this many points, and sees them this well.
const FEWEST_POINTS: usize = 15;
const LARGEST_ERROR_PX: f64 = 2.0;

/// A whole walk, settled.
pub(super) struct Settled {
    /// The last solve.
    pub last: Optimized,
    /// What held it.
    pub anchor: Anchor,
    /// Settings of the last solve: of an IMU that is not as good as they say, less is taken for known.
    pub config: GroundTruthConfig,
    /// What still changed when the rounds were done; `None` where observations have settled.
    pub unrest: Option<GroundTruthWarning>,
}

/// States of a stretch of the walk.
#[derive(Clone)]
pub(super) struct Extension<'a> {
    walk: &'a Walk,
    tracks: &'a Tracks,
    /// Frame of the first state.
    first: usize,
    states: Vec<FrameState>,
    /// Frames from the first on that are at rest.
    resting: usize,
}

impl<'a> Extension<'a> {
    pub fn of(walk: &'a Walk, tracks: &'a Tracks, first: usize, states: Vec<FrameState>) -> Self {
        Self {
            walk,
            tracks,
            first,
            states,
            resting: 0,
        }
    }

    /// The same frames with other tracks and states.
    pub fn closed(self, tracks: &'a Tracks, states: &[FrameState]) -> Self {
        Self {
            tracks,
            states: states.to_vec(),
            ..self
        }
    }

    /// With the device at rest in all states so far.
    pub fn at_rest(self) -> Self {
        Self {
            resting: self.states.len(),
            ..self
        }
    }

    /// Settled, where tracks and samples then agree.
    pub fn if_sound(
        mut self,
        config: &GroundTruthConfig,
        progress: ProgressFn<'_>,
    ) -> Result<Option<Self>, Error> {
        let solved = match self.settle_all(config, progress) {
            Err(Error::Solver(_) | Error::Refused(Refusal::NotConverged { .. })) => {
                return Ok(None);
            }
            solved => solved?,
        };
        let points = solved.points.iter().filter(|p| p.is_determined()).count();
        let errors = local_errors(&solved.estimate, &solved.points);
        let frames = self.first..self.end();
        let tracks = self.tracks;
        let contradicted = tracks.contradicted_share(&solved.estimate, frames, config);
        let is_sound = points >= FEWEST_POINTS
            && errors.rms_px <= LARGEST_ERROR_PX
            && contradicted <= LARGEST_CONTRADICTED_SHARE;
        Ok(is_sound.then_some(self))
    }

    /// Adds all frames after and before.
    pub fn extend(
        &mut self,
        config: &GroundTruthConfig,
        progress: ProgressFn<'_>,
    ) -> Result<(), Error> {
        let on_the_way = on_the_way(config);
        let total = self.walk.frames.len() as u64;
        // Solves on the way are many and short: what counts is how many frames are known.
        let known = |done: usize| {
            progress(Progress {
                stage: "motion",
                done: done as u64,
                total,
            })
        };
        let mut settled = self.states.len();
        while self.end() < self.walk.frames.len() {
            let (last, done) = (self.end(), self.states.len());
            self.add_after();
            let oldest = self.frame_before(last, MEMORY_SECS);
            self.settle(oldest..self.end(), &on_the_way, &|_| known(done))?;
            if self.states.len() as f64 >= GROWTH * settled as f64 {
                self.settle_all(&on_the_way, &|_| known(done))?;
                settled = self.states.len();
            }
        }
        while self.first > 0 {
            let done = self.states.len();
            self.add_before();
            self.settle_all(&on_the_way, &|_| known(done))?;
        }
        Ok(())
    }

    /// All frames, settled as far as on the way.
    pub fn roughly(
        &mut self,
        config: &GroundTruthConfig,
        progress: ProgressFn<'_>,
    ) -> Result<Settled, Error> {
        Ok(Settled {
            last: self.settle_all(&on_the_way(config), progress)?,
            anchor: self.anchor(),
            config: config.clone(),
            unrest: None,
        })
    }

    /// Solves all frames until no observation comes or goes any more, in so many rounds at most.
    pub fn finish(
        mut self,
        config: &GroundTruthConfig,
        rounds: usize,
        progress: ProgressFn<'_>,
    ) -> Result<Settled, Error> {
        let mut last = self.settle_all(config, progress)?;
        let mut used = config.clone();
        let mut moved = [0.0; 2];
        let mut at_rest = false;
        for _ in 0..rounds {
            let allowing = used.inertial.allowing(&last.imu_errors);
            let is_allowed = allowing.is_some();
            used.inertial = allowing.unwrap_or(used.inertial);
            let before = last.estimate.clone();
            let changed = self.solve_again(&mut last, &used, is_allowed, progress)?;
            moved = farthest(&before, &last.estimate);
            at_rest = !is_allowed && is_few(changed, &last);
            if at_rest {
                break;
            }
        }
        let unrest = match at_rest {
            true => None,
            false => self.unrest(&last, &used, (rounds, moved)),
        };
        Ok(Settled {
            last,
            anchor: self.anchor(),
            config: used,
            unrest,
        })
    }

    /// Whether the last round was enough shows in what another one would change.
    fn unrest(
        &self,
        last: &Optimized,
        used: &GroundTruthConfig,
        (rounds, moved): (usize, [f64; 2]),
    ) -> Option<GroundTruthWarning> {
        let (mut walk, mut points) = (self.part(&(self.first..self.end())), last.points.clone());
        let changing = choose_observations(&mut walk, &last.estimate, &mut points, used);
        let allowing = used.inertial.allowing(&last.imu_errors);
        let is_settled = allowing.is_none() && is_few(changing, last);
        (!is_settled).then(|| not_at_rest(rounds, changing, moved))
    }

    /// What holds all of the frames.
    fn anchor(&self) -> Anchor {
        Anchor {
            is_known: false,
            resting: self.resting,
        }
    }

    fn end(&self) -> usize {
        self.first + self.states.len()
    }

    /// First known frame that is no longer than this before another.
    fn frame_before(&self, frame: usize, secs: f64) -> usize {
        let time = self.walk.frames[frame - 1].time;
        let known = &self.walk.frames[self.first..frame];
        self.first + known.partition_point(|f| time.secs_since(f.time) > secs)
    }

    /// States of the next frames by the IMU.
    fn add_after(&mut self) {
        let begun = self.walk.frames[self.end() - 1].time;
        loop {
            let end = self.end();
            let (before, frame) = (&self.walk.frames[end - 1], &self.walk.frames[end]);
            let state = self.states[end - 1 - self.first];
            let change = self.between(before.time, frame.time, &state);
            self.states.push(FrameState {
                nav: change.predict(&state.nav, &state.bias, &standard_gravity_m_s2()),
                bias: state.bias,
            });
            let next = self.walk.frames.get(end + 1);
            if next.is_none_or(|f| f.time.secs_since(begun) > STEP_SECS) {
                return;
            }
        }
    }

    /// States of the frames before by the IMU.
    fn add_before(&mut self) {
        let begun = self.walk.frames[self.first].time;
        let mut added = Vec::new();
        let mut state = self.states[0];
        while let Some(before) = self.first.checked_sub(1) {
            let time = self.walk.frames[before].time;
            if !added.is_empty() && begun.secs_since(time) > STEP_SECS {
                break;
            }
            let change = self.between(time, self.walk.frames[self.first].time, &state);
            state = FrameState {
                nav: led_back(&change, &state.nav, &state.bias),
                bias: state.bias,
            };
            added.push(state);
            self.first = before;
        }
        added.reverse();
        self.states.splice(0..0, added);
    }

    fn between(
        &self,
        from: lsfb_types::Timestamp,
        to: lsfb_types::Timestamp,
        state: &FrameState,
    ) -> PreintegratedImu {
        PreintegratedImu::integrate(&self.walk.imu, from, to, state.bias, &self.walk.noise)
            .unwrap_or_else(|_gap| any_motion(state, to.secs_since(from)))
    }

    fn settle_all(
        &mut self,
        config: &GroundTruthConfig,
        progress: ProgressFn<'_>,
    ) -> Result<Optimized, Error> {
        self.settle(self.first..self.end(), config, progress)
    }

    /// Solves some frames; those from the first on twice: points are placed anew by what the first solve finds.
    fn settle(
        &mut self,
        frames: Range<usize>,
        config: &GroundTruthConfig,
        progress: ProgressFn<'_>,
    ) -> Result<Optimized, Error> {
        let (from, to) = (frames.start - self.first, frames.end - self.first);
        let mut walk = self.part(&frames);
        let anchor = Anchor {
            is_known: from > 0,
            resting: self.resting.saturating_sub(from),
        };
        let begin = Estimate::of_states(&walk, self.states[from..to].to_vec());
        let tracks = self.tracks;
        let mut settle_once = |before: &Estimate| {
            let mut points = tracks.locate(before, frames.clone(), config);
            choose_observations(&mut walk, before, &mut points, config);
            optimize(&walk, before, &points, Some(&anchor), config, progress)
        };
        let mut solved = settle_once(&begin)?;
        if from == 0 {
            solved = settle_once(&solved.estimate)?;
        }
        self.states[from..to].copy_from_slice(&solved.estimate.states);
        Ok(solved)
    }

    /// Chooses observations by the last solve and solves again, where some came or went or settings changed; returns how many did.
    fn solve_again(
        &mut self,
        last: &mut Optimized,
        config: &GroundTruthConfig,
        has_other_settings: bool,
        progress: ProgressFn<'_>,
    ) -> Result<usize, Error> {
        let mut walk = self.part(&(self.first..self.end()));
        let changed = choose_observations(&mut walk, &last.estimate, &mut last.points, config);
        if changed > 0 || has_other_settings {
            let (anchor, estimate, points) = (self.anchor(), &last.estimate, &last.points);
            *last = optimize(&walk, estimate, points, Some(&anchor), config, progress)?;
        }
        Ok(changed)
    }

    /// The walk's part with some frames.
    fn part(&self, frames: &Range<usize>) -> Walk {
        let own = &self.walk.frames[frames.clone()];
        let reach_ns = 100_000_000;
        let imu = match (own.first(), own.last()) {
            (Some(first), Some(last)) => {
                let (from, to) = (
                    first.time.plus_nanos(-reach_ns),
                    last.time.plus_nanos(reach_ns),
                );
                let samples = &self.walk.imu;
                let begin = samples.partition_point(|s| s.time < from);
                samples[begin..samples.partition_point(|s| s.time <= to)].to_vec()
            }
            _ => Vec::new(),
        };
        Walk {
            cameras: self.walk.cameras.clone(),
            frames: own.to_vec(),
            imu,
            noise: self.walk.noise.clone(),
            noise_factors: Default::default(),
            point_covariances_m2: self.walk.point_covariances_m2.clone(),
        }
    }
}

fn on_the_way(config: &GroundTruthConfig) -> GroundTruthConfig {
    GroundTruthConfig {
        solve: SolveConfig {
            cost_tolerance: ON_THE_WAY,
            ..config.solve
        },
        ..config.clone()
    }
}

/// FrameState at the first instant, given that at the second.
fn led_back(change: &PreintegratedImu, end: &NavState, bias: &ImuBias) -> NavState {
    let (secs, gravity) = (change.duration_secs, standard_gravity_m_s2());
    let change = change.corrected(bias);
    let rotation = end.world_from_rig.rotation * change.rotation.inverse();
    let velocity_m_s = end.velocity_m_s - gravity * secs - rotation * change.velocity_m_s;
    let position = end.world_from_rig.translation
        - velocity_m_s * secs
        - gravity * (0.5 * secs * secs)
        - rotation * change.position_m;
    NavState {
        world_from_rig: lsfb_geometry::Se3::new(rotation, position),
        velocity_m_s,
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{
        Camera, CameraTiming, ImuNoiseModel, Matrix3, RigCamera, Se3, UnitQuaternion, Vector3,
    };
    use lsfb_types::{ImuSample, Stamped, Timestamp, no_progress};

    use super::super::{Sight, TrackedFrame, TrackedWalk, empty_frame};
    use super::*;
    use crate::ground_truth::settling::ROUNDS;
    use crate::residuals::MovingCamera;

    const FRAMES: usize = 25;
    const FRAME_SECS: f64 = 0.1;

    fn state(secs: f64) -> FrameState {
        let way = |t: f64| {
            let (a, b) = (2.0 * t, 3.0 * t);
            Vector3::new(0.4 * a.sin(), 0.3 * b.sin(), 0.2 * a.cos())
        };
        let h = 1e-5;
        FrameState {
            nav: NavState {
                world_from_rig: Se3::new(UnitQuaternion::identity(), way(secs)),
                velocity_m_s: (way(secs + h) - way(secs - h)) / (2.0 * h),
            },
            bias: ImuBias::default(),
        }
    }

    /// Two cameras carried along a wall by somebody who never turns; readings of the accelerometer are so many times too large.
    fn walk(too_strong: f64) -> TrackedWalk {
        let forward = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let camera = |y_m: f64| RigCamera {
            camera: Camera::pinhole(640, 480, [320.0; 2], [319.5, 239.5]),
            rig_from_camera: Se3::new(
                UnitQuaternion::from_matrix(&forward),
                Vector3::new(0.0, y_m, 0.0),
            ),
            timing: CameraTiming::default(),
            sigmas: Default::default(),
        };
        let cameras = vec![camera(0.05), camera(-0.05)];
        let points = (0..48u32).map(|k| {
            let (column, row) = (f64::from(k % 8) - 3.5, f64::from(k / 8) - 2.5);
            Vector3::new(4.0 + 0.3 * column.sin(), 0.4 * column, 0.4 * row)
        });
        let points: Vec<_> = points.collect();
        let frames = (0..FRAMES).map(|k| {
            let secs = k as f64 * FRAME_SECS;
            let pose = state(secs).nav.world_from_rig;
            let sights = cameras.iter().enumerate().flat_map(|(index, camera)| {
                let camera_from_world = (pose * camera.rig_from_camera).inverse();
                (0..).zip(&points).filter_map(move |(track, point)| {
                    let pixel = camera.camera.project(&(camera_from_world * *point))?;
                    Some(Sight {
                        track,
                        camera: index,
                        pixel,
                    })
                })
            });
            TrackedFrame {
                time: Timestamp::from_secs_f64(secs),
                sights: sights.collect(),
            }
        });
        let frames = frames.collect();
        let sample = |k: i64| {
            let (secs, h) = (k as f64 * 0.005, 1e-3);
            let velocity = |t: f64| state(t).nav.velocity_m_s;
            let acceleration = (velocity(secs + h) - velocity(secs - h)) / (2.0 * h);
            let time = Timestamp::from_secs_f64(secs);
            Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: ImuSample {
                    angular_velocity_rad_s: [0.0; 3],
                    specific_force_m_s2: (too_strong * (acceleration - standard_gravity_m_s2()))
                        .into(),
                },
            }
        };
        TrackedWalk {
            cameras,
            frames,
            imu: (-40..540).map(sample).collect(),
            noise: ImuNoiseModel {
                gyro_noise_density: 1e-3,
                accel_noise_density: 2e-3,
                gyro_bias_walk: 1e-5,
                accel_bias_walk: 1e-4,
            },
            views: Vec::new(),
        }
    }

    /// What is said after so many rounds; and after the last one, if the first sight of each point were still to come.
    fn unrest(too_strong: f64, rounds: usize) -> [Option<GroundTruthWarning>; 2] {
        let tracked = walk(too_strong);
        let tracks = Tracks::of(&tracked);
        let walk = Walk {
            cameras: tracked.cameras.iter().map(MovingCamera::new).collect(),
            frames: tracked.frames.iter().map(|f| empty_frame(f.time)).collect(),
            imu: tracked.imu.clone(),
            noise: tracked.noise.clone(),
            noise_factors: Default::default(),
            point_covariances_m2: Default::default(),
        };
        let states = (0..FRAMES).map(|k| state(k as f64 * FRAME_SECS));
        let extension = Extension::of(&walk, &tracks, 0, states.collect());
        let config = GroundTruthConfig::default();
        let settled = extension.clone().finish(&config, rounds, &no_progress);
        let Settled {
            mut last, unrest, ..
        } = settled.expect("solves");
        for point in &mut last.points {
            point.observations[0].used = false;
        }
        let to_come = extension.unrest(&last, &config, (rounds, [0.0; 2]));
        [unrest, to_come]
    }

    /// Rounds ended without a word, whatever another one would have changed; of a walk that needs none, nothing is said.
    #[test]
    fn what_has_not_settled_is_said_and_what_has_is_not() {
        let [settled, to_come] = unrest(1.0, 0);
        assert_eq!(settled, None);
        assert!(
            matches!(
                to_come,
                Some(GroundTruthWarning::NotAtRest { changing: 20.., .. })
            ),
            "{to_come:?}"
        );
        // An accelerometer that reads too much is allowed for, and that settles too.
        let [settled, _] = unrest(1.2, ROUNDS);
        assert_eq!(settled, None);
    }
}
