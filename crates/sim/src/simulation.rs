//! A world, two rigs in it, and what their sensors measure: the offline way to the data, without devices.

use std::sync::Arc;

use lsfb_drivers::lidar::Returns;
use lsfb_geometry::{Matrix3, Rig, Se3, Vector3};
use lsfb_types::{Echo, Image, LidarPoint, LidarScan, ProgressFn, Stamped, Timestamp};

use crate::ambient::{Surroundings, TimeFeed};
use crate::calendar::{EPOCH, GLASSES_EPOCH};
use crate::config::{CameraConfig, ImuConfig, Place, SimConfig};
use crate::noise::hash;
use crate::place::{Route, route, there_and_back, this_side};
use crate::sensor::camera::CameraSim;
use crate::sensor::imu::{self, BiasedSample};
use crate::sensor::lidar::{FiringCycle, LidarSim};
use crate::timing::RigClocks;
use crate::walk::{Gait, Gaze, Passers, Walk, WalkPlan, Walker, off_path};
use crate::world::{FloorPlan, World};
use crate::{Error, rigs};

/// A whole session.
#[derive(Clone, Debug)]
pub struct Simulation {
    config: SimConfig,
    world: Arc<World>,
    scan: RigSim,
    glasses: RigSim,
    surroundings: Surroundings,
}

/// A rig on its walk.
#[derive(Clone, Debug)]
pub struct RigSim {
    rig: Rig,
    /// What its calibration says, where that is not the truth.
    calibrated: Option<Rig>,
    start: Timestamp,
    seed: u64,
    walk: Walk,
    imu: Vec<BiasedSample>,
    imu_rate_hz: u32,
    imu_axes: [Matrix3<f64>; 2],
    readout_ns: u32,
    cameras: Vec<CameraSim>,
    camera_rate_hz: u32,
    lidar: Option<LidarSim>,
    lidar_rpm: u32,
    clocks: RigClocks,
    time_feed: TimeFeed,
}

impl Simulation {
    /// Builds the world and both walks. Takes seconds at the default resolution.
    pub fn new(config: &SimConfig, progress: ProgressFn) -> Result<Self, Error> {
        Self::after(None, config, progress)
    }

    /// The same; the world is that of an earlier simulation where the settings ask for no other.
    pub fn after(
        earlier: Option<&Self>,
        config: &SimConfig,
        progress: ProgressFn,
    ) -> Result<Self, Error> {
        config.check()?;
        let world = match earlier.filter(|earlier| earlier.config.has_world_of(config)) {
            Some(earlier) => Arc::clone(&earlier.world),
            None => Arc::new(Place::build(config, progress)?),
        };
        let [scan_walk, second_walk] = walks(config, &world)?;
        let mut scan = RigSim::new(
            rigs::backpack(config),
            EPOCH,
            scan_walk,
            &config.scan_cameras,
            &config.scan_imu,
            RigClocks::new(&config.clocks, EPOCH, config.seed),
            config.seed,
        )?;
        scan.lidar = scan.rig.lidar().map(|lidar| {
            LidarSim::new(
                lidar.rig_from_lidar,
                &config.lidar,
                hash(config.seed ^ 0x11da),
            )
        });
        scan.lidar_rpm = config.lidar.rpm;
        let mut glasses = RigSim::new(
            rigs::walker(config),
            GLASSES_EPOCH,
            second_walk,
            &config.glasses_cameras,
            &config.glasses_imu,
            RigClocks::new(&config.clocks, GLASSES_EPOCH, hash(config.seed)),
            hash(config.seed ^ 0x61a5),
        )?;
        if config.people && config.paper_motion()?.is_some_and(|m| m.is_occluded()) {
            let passers = Passers::of(&glasses.walk, config.seed);
            let cameras = glasses.cameras.drain(..);
            glasses.cameras = cameras.map(|c| c.with_passers(passers.clone())).collect();
        }
        let surroundings = Surroundings::new(config, &world, &scan.walk);
        scan.time_feed = surroundings.time_feed(&world, &scan.walk);
        Ok(Self {
            config: config.clone(),
            world,
            scan,
            glasses,
            surroundings,
        })
    }

    /// The same, with devices that state the rigs that a calibration found, of backpack and second walk.
    pub fn calibrated(mut self, [scan, walk]: [Option<Rig>; 2]) -> Self {
        (self.scan.calibrated, self.glasses.calibrated) = (scan, walk);
        self
    }

    /// What it was made from.
    pub fn config(&self) -> &SimConfig {
        &self.config
    }

    /// The building.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The backpack.
    pub fn scan(&self) -> &RigSim {
        &self.scan
    }

    /// The glasses.
    pub fn glasses(&self) -> &RigSim {
        &self.glasses
    }

    /// Radio, magnetic field and satellites.
    pub fn surroundings(&self) -> &Surroundings {
        &self.surroundings
    }
}

/// A way around the middle of a scene, on the floor that is under it.
fn around_the_middle(world: &World) -> Vec<[f64; 3]> {
    let [low, high] = world.extent_m();
    let half: [f32; 3] = std::array::from_fn(|i| 0.5 * (high[i] - low[i]));
    let above = [
        low[0] + half[0],
        low[1] + half[1],
        low[2] + half[2].min(1.5),
    ];
    let floor = world
        .cast(above, [0.0, 0.0, -1.0])
        .map_or(low[2], |hit| above[2] - hit.distance);
    (0..16)
        .map(|k| f64::from(k) * std::f64::consts::TAU / 16.0)
        .map(|angle| {
            let [x, y] = [0, 1].map(|i| f64::from(above[i]));
            let [rx, ry] = [0, 1].map(|i| 0.3 * f64::from(half[i]));
            [x + rx * angle.cos(), y + ry * angle.sin(), f64::from(floor)]
        })
        .collect()
}

/// The scanner's walk, and the second one.
pub(crate) fn walks(config: &SimConfig, world: &World) -> Result<[Walk; 2], Error> {
    let place = config.place;
    let way = |kind: Route| match place {
        Place::Imported if config.way_m.len() > 2 => config.way_m.clone(),
        Place::Imported => around_the_middle(world),
        _ => route(place, kind),
    };
    if place == Place::Demo {
        let plan = FloorPlan::new(config.seed);
        return Ok([
            Walk::new(&plan, Walker::Backpack, &config.scan, config.seed),
            Walk::new(&plan, Walker::Glasses, &config.glasses, config.seed),
        ]);
    }
    let on_board = place == Place::Calibration;
    let scan_plan = WalkPlan {
        corners: way(if on_board { Route::Spot } else { Route::Scan }),
        config: config.scan.clone(),
        length_m: on_board.then_some(0.02 * config.scan.duration_s),
        gaze: if on_board { Gaze::Board } else { Gaze::Steady },
        gait: if on_board {
            Gait::STAND
        } else {
            Gait::walk_at(&config.scan)
        },
    };
    let scan = Walk::of(&scan_plan, config.seed);
    let mut second = match config.paper_motion()? {
        Some(motion) => {
            let whole_s = motion.duration_s(config.device);
            let duration_s = match config.glasses.duration_s {
                0.0 => whole_s,
                wanted_s => wanted_s,
            };
            WalkPlan {
                corners: way(motion.route),
                config: crate::WalkConfig {
                    duration_s,
                    ..config.glasses.clone()
                },
                length_m: Some(motion.length_m(config.device) * duration_s / whole_s),
                gaze: motion.gaze,
                gait: motion.gait,
            }
        }
        None if on_board => WalkPlan {
            config: config.glasses.clone(),
            gaze: Gaze::Facing,
            length_m: Some(0.02 * config.glasses.duration_s),
            ..scan_plan
        },
        None => WalkPlan {
            corners: way(Route::Loop),
            config: config.glasses.clone(),
            length_m: None,
            gaze: Gaze::AroundSlow,
            gait: Gait::walk_at(&config.glasses),
        },
    };
    if config.off_path_m > 0.0 && !on_board {
        second.corners = off_the_path(config, world, &scan, &second);
    } else if let Some(door) = world.closed_door() {
        second.corners = this_side(door, second.corners);
    }
    Ok([scan, Walk::of(&second, hash(config.seed ^ 0x3a1c))])
}

/// Beside the scanner's way, in either direction, from where most of the walk is off it: along its route, or, where the scan is shorter than its
/// own, along as much as there is of it.
fn off_the_path(config: &SimConfig, world: &World, scan: &Walk, plan: &WalkPlan) -> Vec<[f64; 3]> {
    let footsteps = off_path::footsteps(scan, config.scan.height_m);
    // Too short a scan goes nowhere, and on the spot there is nothing beside.
    let is_short = config.scan.duration_s > 0.0 || plan.gaze == Gaze::Turning;
    let mut route = match !is_short || footsteps.len() < 3 {
        true => plan.corners.clone(),
        false => there_and_back(&footsteps),
    };
    let draw = hash(config.seed ^ 0x0ff9);
    let begin = (draw >> 8) as usize % route.len().max(1);
    route.rotate_left(begin);
    if draw & 1 == 1 {
        route.reverse();
    }
    if let Some(door) = world.closed_door() {
        route = this_side(door, route);
    }
    let way = off_path::beside(world, &route, &footsteps, config.off_path_m, draw);
    match (world.closed_door(), plan.length_m) {
        // It begins some metres before the door.
        (Some(_), _) => way,
        (None, length_m) => {
            let length_m = length_m.unwrap_or(f64::INFINITY);
            off_path::begun_off_the_path(way, &footsteps, length_m, draw)
        }
    }
}

impl RigSim {
    fn new(
        rig: Rig,
        start: Timestamp,
        walk: Walk,
        cameras: &CameraConfig,
        imu: &ImuConfig,
        clocks: RigClocks,
        seed: u64,
    ) -> Result<Self, Error> {
        let imu_rate_hz = imu.rate_hz;
        let imu_axes =
            [0, 1].map(|triad| imu::axes(imu.scale_error, imu.misalignment_rad, seed, triad));
        let imu = imu::simulate(&walk, imu, seed);
        let camera_rate_hz = cameras.rate_hz;
        let readout_ns = cameras.readout_ns;
        let cameras = rig
            .cameras
            .values()
            .enumerate()
            .map(|(k, camera)| CameraSim::new(camera, cameras, hash(seed ^ hash(k as u64 + 1))))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            rig,
            calibrated: None,
            start,
            seed,
            walk,
            imu,
            imu_rate_hz,
            imu_axes,
            readout_ns,
            cameras,
            camera_rate_hz,
            lidar: None,
            lidar_rpm: 600,
            clocks,
            time_feed: TimeFeed::default(),
        })
    }

    /// The rig as built: the truth about its calibration.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// The rig as its devices state it: as calibrated, where it was, else as built.
    pub fn stated_rig(&self) -> &Rig {
        self.calibrated.as_ref().unwrap_or(&self.rig)
    }

    /// Its motion.
    pub fn walk(&self) -> &Walk {
        &self.walk
    }

    /// Its inertial samples.
    pub fn imu(&self) -> &[BiasedSample] {
        &self.imu
    }

    /// When its recording begins.
    pub fn start(&self) -> Timestamp {
        self.start
    }

    /// The seed of its noise.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// `offset_ns` after the beginning.
    pub fn time(&self, offset_ns: i64) -> Timestamp {
        self.start.plus_nanos(offset_ns)
    }

    /// How the clocks of its devices run.
    pub fn clocks(&self) -> &RigClocks {
        &self.clocks
    }

    /// What gives the LiDAR its time.
    pub(crate) fn time_feed(&self) -> &TimeFeed {
        &self.time_feed
    }

    /// Rate of its IMU, Hz.
    pub fn imu_rate_hz(&self) -> u32 {
        self.imu_rate_hz
    }

    /// What its gyroscope's (0) or accelerometer's (1) axes make of the truth.
    pub(crate) fn imu_axes(&self, triad: usize) -> Matrix3<f64> {
        self.imu_axes[triad]
    }

    /// Time from the first row of its images to the last, nanoseconds.
    pub fn readout_ns(&self) -> u32 {
        self.readout_ns
    }

    /// Number of images that each camera takes.
    pub fn frame_count(&self) -> u32 {
        (self.walk.duration_s() * f64::from(self.camera_rate_hz)) as u32
    }

    /// Middle of the exposure of a frame, nanoseconds after the beginning.
    pub fn frame_offset_ns(&self, frame: u32) -> i64 {
        // Half a period after the second, so that the first exposure lies inside the recording.
        let rate_hz = i64::from(self.camera_rate_hz);
        (2 * i64::from(frame) + 1) * 500_000_000 / rate_hz
    }

    /// The image of camera number `camera` at a frame; `None` where there is no such camera.
    pub fn image(&self, world: &World, camera: usize, frame: u32) -> Option<Stamped<Image>> {
        let offset_ns = self.frame_offset_ns(frame);
        let pose = |time_s: f64| self.walk.at(time_s).world_from_rig;
        let middle_s = offset_ns as f64 * 1e-9;
        let sample = self
            .cameras
            .get(camera)?
            .render(world, &pose, middle_s, frame);
        let time = self.time(offset_ns);
        Some(Stamped {
            time,
            arrival: time,
            device_ticks: offset_ns as u64 / 1000,
            sample,
        })
    }

    /// Number of whole revolutions of the LiDAR.
    pub fn revolution_count(&self) -> u32 {
        (self.walk.duration_s() * f64::from(self.lidar_rpm) / 60.0 + 1e-9) as u32
    }

    /// The LiDAR; `None` without one.
    pub fn lidar(&self) -> Option<&LidarSim> {
        self.lidar.as_ref()
    }

    /// The firing cycles of a revolution; empty without a LiDAR.
    pub fn revolution(&self, world: &World, number: u32) -> Vec<FiringCycle> {
        let Some(lidar) = &self.lidar else {
            return Vec::new();
        };
        let cycle_ns = lidar.cycle_ns();
        let turn_ns = 60_000_000_000 / i64::from(self.lidar_rpm);
        // The encoder rounds to 0.01°: the last 0.005° of a turn already read 0.
        let early_ns = turn_ns / 72_000;
        let cycle_at = |turn: i64| ((turn * turn_ns - early_ns).max(0) + cycle_ns - 1) / cycle_ns;
        let first = cycle_at(number.into());
        let next = cycle_at(i64::from(number) + 1);
        self.fire(world, first as u64, (next - first) as usize)
    }

    /// Firing cycles by number since the beginning; empty without a LiDAR.
    pub fn fire(&self, world: &World, first: u64, count: usize) -> Vec<FiringCycle> {
        self.lidar
            .as_ref()
            .map(|lidar| lidar.fire(world, &self.walk, first, count))
            .unwrap_or_default()
    }

    /// A revolution as a decoder would give it; `None` without a LiDAR or without a return.
    pub fn scan(&self, world: &World, number: u32) -> Option<Stamped<LidarScan>> {
        let lidar = self.lidar.as_ref()?;
        let cycles = self.revolution(world, number);
        let first_ns = cycles.first()?.offset_ns;
        let turn_ns = 60e9 / f64::from(self.lidar_rpm);
        let mut points = Vec::with_capacity(cycles.len() * 32);
        for cycle in &cycles {
            for (channel, first) in cycle.returns.iter().enumerate() {
                let delay_ns = lidar.firing_delay_ns(channel);
                let azimuth_deg =
                    f64::from(cycle.azimuth_centideg) * 0.01 + 360.0 * delay_ns as f64 / turn_ns;
                let direction = lidar.beam_direction(channel, azimuth_deg);
                let second = &cycle.second_returns[channel];
                let other = second.range_count != first.range_count;
                let kind = match lidar.return_mode() {
                    Returns::Strongest => Echo::Strongest,
                    Returns::Last => Echo::Last,
                    Returns::Dual if other => Echo::Last,
                    Returns::Dual => Echo::Both,
                };
                for (echo, kind, is_sent) in [(first, kind, true), (second, Echo::Strongest, other)]
                {
                    if echo.range_count == 0 || !is_sent {
                        continue;
                    }
                    let position: Vector3<f64> =
                        direction * (f64::from(echo.range_count) * lidar.range_unit_m());
                    points.push(LidarPoint {
                        position_m: position.map(|v| v as f32).into(),
                        intensity: echo.reflectivity,
                        ring: lidar.ring(channel),
                        echo: kind,
                        time_offset_ns: (cycle.offset_ns + delay_ns - first_ns) as u32,
                    });
                }
            }
        }
        let time = self.time(first_ns);
        Some(Stamped {
            time,
            arrival: time,
            // As the driver counts: nanoseconds of the hour.
            device_ticks: time.nanos().rem_euclid(3_600_000_000_000) as u64,
            sample: LidarScan { points },
        })
    }

    /// Camera number `camera`; `None` where there is none.
    pub fn camera(&self, camera: usize) -> Option<&CameraSim> {
        self.cameras.get(camera)
    }

    /// Pose of the LiDAR at a time, for comparisons; the rig's where there is no LiDAR.
    pub fn world_from_lidar(&self, offset_s: f64) -> Se3 {
        let rig_from_lidar = self
            .rig
            .lidar()
            .map_or(Se3::identity(), |l| l.rig_from_lidar);
        self.walk.at(offset_s).world_from_rig * rig_from_lidar
    }
}
