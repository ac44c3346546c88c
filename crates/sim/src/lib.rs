//! A simulated world with devices that speak the real wire formats.
//!
//! A furnished room opens into a corridor; a backpack scanner and a pair of AR glasses walk through it on smooth
//! motions known exactly. Everything comes from one seed and is the same on any number of threads.
//!
//! ```
//! use lsfb_sim::{SimConfig, Simulation};
//! let simulation = Simulation::new(&SimConfig::tiny(), &lsfb_types::no_progress)?;
//! let image = simulation.scan().image(simulation.world(), 0, 3).expect("cam0");
//! assert_eq!(image.sample.width, 160);
//! # Ok::<(), lsfb_sim::Error>(())
//! ```

mod config;
mod device;
mod error;
mod noise;
pub mod rigs;
mod sensor;
mod simulation;
mod spline;
mod truth;
mod walk;
pub mod world;

pub use config::{CameraConfig, ImuConfig, LidarConfig, SimConfig, WalkConfig};
pub use device::{
    FlowControl, GlassesEndpoint, MYNT_UNITS, Pace, ScanEndpoints, SessionReport, SimSession,
    StopHandle,
};
pub use error::Error;
pub use sensor::camera::CameraSim;
pub use sensor::imu::{BiasedSample, GRAVITY_M_S2, exact_sample};
pub use sensor::lidar::{
    CYCLE_NS, CYCLES_PER_PACKET, FiringCycle, LASERS, LidarSim, RANGE_UNIT_M, Return,
    beam_direction, firing_delay_ns, ring,
};
pub use simulation::{EPOCH, GLASSES_EPOCH, RigSim, Simulation};
pub use truth::{TrueBias, Truth};
pub use walk::{Motion, Walk, Walker};
pub use world::World;
