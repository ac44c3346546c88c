//! Loops while one walks: those that [`find_loops`](super::find_loops) would accept of the scans so far.
//!
//! Nothing is closed: the odometry goes on as it was. Who watches is told that a place was recognised, and how far the map is off there.

use lsfb_geometry::{RigLidar, Se3};
use lsfb_types::no_progress;
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::assessment::Assessor;
use super::descriptor::Descriptor;
use super::graph::fitting;
use super::keyframes::{self, Keyframe, SUBMAP_SPACING_M, Scans};
use super::search::{Confirmed, Found, Search};
use super::{Loop, Measured};
use crate::Error;
use crate::odometry::{DeskewedCloud, OdometryConfig, OdometryStep, ScanPose};

/// A place that the walk has come back to.
#[derive(Clone, Debug, PartialEq)]
pub struct OnlineLoop {
    /// The two scans, and by what they were judged.
    pub found: Loop,
    /// Where the odometry has the rig at the earlier visit.
    pub world_from_earlier: Se3,
    /// The same at the later one.
    pub world_from_later: Se3,
    /// How far the odometry is off between the two, metres.
    pub off_m: f64,
}

/// Looks for loops as scans come. It is slower than they are where much looks alike: give it a thread of its own.
#[derive(Debug)]
pub struct OnlineLoops {
    config: OdometryConfig,
    lidar: RigLidar,
    /// One thread: the odometry must not wait for what is computed here.
    pool: ThreadPool,
    /// Way from the first scan, and where it leads on from, metres.
    path_m: f64,
    last: Option<Se3>,
    /// The scans that are kept: keyframes, and what submaps are made of.
    poses: Vec<ScanPose>,
    clouds: Vec<DeskewedCloud>,
    paths_m: Vec<f64>,
    keyframes: Vec<Keyframe>,
    descriptors: Vec<Descriptor>,
    found: Found,
    /// Loops that were confirmed and have been looked at since.
    told: Vec<usize>,
}

impl OnlineLoops {
    /// For a walk with this LiDAR.
    pub fn new(config: &OdometryConfig, lidar: &RigLidar) -> Result<Self, Error> {
        config.check_bounds("odometry")?;
        let pool = ThreadPoolBuilder::new().num_threads(1).build();
        Ok(Self {
            config: config.clone(),
            lidar: lidar.clone(),
            pool: pool.map_err(|error| Error::Threads {
                message: error.to_string(),
            })?,
            path_m: 0.0,
            last: None,
            poses: Vec::new(),
            clouds: Vec::new(),
            paths_m: Vec::new(),
            keyframes: Vec::new(),
            descriptors: Vec::new(),
            found: Found::new(&[]),
            told: Vec::new(),
        })
    }

    /// Takes what a scan gave, and gives the loops that it leads to: those that another one confirms by now, and that fit all others.
    pub fn push(&mut self, step: &OdometryStep) -> Result<Vec<OnlineLoop>, Error> {
        if step.begins_again() {
            self.begin_again();
        }
        let mut loops = Vec::new();
        for step in step.placed() {
            if self.keep(step) {
                loops.extend(self.look()?);
            }
        }
        Ok(loops)
    }

    /// Forgets the walk: it began otherwise than was thought.
    pub fn begin_again(&mut self) {
        (self.path_m, self.last) = (0.0, None);
        self.poses.clear();
        self.clouds.clear();
        self.paths_m.clear();
        self.keyframes.clear();
        self.descriptors.clear();
        self.found = Found::new(&[]);
        self.told.clear();
    }

    /// How many scans are kept: one in half a metre.
    pub fn kept(&self) -> usize {
        self.clouds.len()
    }

    /// Keeps a scan, if there is need of it; whether it is a keyframe.
    fn keep(&mut self, step: &OdometryStep) -> bool {
        let world_from_rig = step.world_from_rig;
        let moved_m = |last: Se3| (world_from_rig.translation - last.translation).norm();
        self.path_m += self.last.map_or(0.0, moved_m);
        self.last = Some(world_from_rig);
        let is_keyframe = keyframes::is_apart(self.keyframes.last(), &world_from_rig);
        let is_apart = |last: &f64| self.path_m - last >= SUBMAP_SPACING_M;
        if !is_keyframe && !self.paths_m.last().is_none_or(is_apart) {
            return false;
        }
        let cloud = DeskewedCloud::of(step);
        if is_keyframe {
            self.descriptors
                .push(Descriptor::of(&cloud, &world_from_rig, &self.lidar));
            self.keyframes.push(Keyframe {
                scan: self.clouds.len(),
                time: step.time,
                world_from_rig,
                covariance: step.covariance,
                path_m: self.path_m,
            });
            self.found.ways.go_on(&self.keyframes);
        }
        self.clouds.push(cloud);
        self.paths_m.push(self.path_m);
        self.poses.push(ScanPose::of(step));
        is_keyframe
    }

    /// Looks from the last keyframe.
    fn look(&mut self) -> Result<Vec<OnlineLoop>, Error> {
        let search = Search {
            keyframes: &self.keyframes,
            descriptors: &self.descriptors,
            assessor: Assessor {
                scans: Scans {
                    poses: &self.poses,
                    clouds: &self.clouds,
                    paths_m: &self.paths_m,
                    lidar: &self.lidar,
                },
                config: &self.config,
            },
        };
        let (found, pool) = (&mut self.found, &self.pool);
        let later = self.keyframes.len() - 1;
        pool.install(|| search.look_from(later, found));
        let confirmed = self.found.measured.iter();
        let confirmed: Vec<(Measured, usize)> = confirmed
            .filter(|(.., confirmed)| *confirmed == Confirmed::Yes)
            .map(|(measured, number, _)| (*measured, *number))
            .collect();
        if confirmed.len() == self.told.len() {
            return Ok(Vec::new());
        }
        let measured: Vec<Measured> = confirmed.iter().map(|(measured, _)| *measured).collect();
        let fits = self
            .pool
            .install(|| fitting(&self.keyframes, &measured, &no_progress))?;
        let mut loops = Vec::new();
        for ((measured, number), fits) in confirmed.iter().zip(fits) {
            if self.told.contains(number) {
                continue;
            }
            self.told.push(*number);
            let found = self.found.loops.all.get(*number).filter(|_| fits);
            loops.extend(found.map(|found| self.told_of(measured, found)));
        }
        Ok(loops)
    }

    fn told_of(&self, measured: &Measured, found: &Loop) -> OnlineLoop {
        let pose = |keyframe: usize| self.keyframes[keyframe].world_from_rig;
        let (earlier, later) = (pose(measured.earlier), pose(measured.later));
        let by_loop = earlier * measured.loop_.earlier_from_later;
        OnlineLoop {
            found: found.clone(),
            world_from_earlier: earlier,
            world_from_later: later,
            off_m: (by_loop.translation - later.translation).norm(),
        }
    }
}
