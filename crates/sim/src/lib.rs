//! A simulated world with devices that speak the real wire formats.
//!
//! A furnished room opens into a corridor; a backpack scanner and a pair of AR glasses walk through it on smooth
//! motions known exactly. Everything comes from one seed and is the same on any number of threads.
//!
//! - [`Simulation`] holds the [`World`] and two [`RigSim`]: what the sensors of the backpack and of the glasses measure,
//!   asked for one by one.
//! - [`SimSession`] runs the devices that send the same measurements in their wire formats, to a host that cannot tell
//!   them from real ones: a Velodyne over UDP, two Mynt units through camera sockets, an Xsens or a MicroStrain IMU on a
//!   pseudo-terminal, and glasses through the sidecar stream.
//! - [`Simulation::emit_scan`] and [`Simulation::emit_walk`] give the same bytes without sockets, each with the time at which it
//!   arrives over a link that delays, jitters and stalls ([`ClocksConfig`]).
//! - [`Surroundings`] is what a phone measures besides: radio, the magnetic field, pressure, satellites.
//! - [`Playback`] runs the same devices from a recording or a capture file.
//! - The truth is written by [`Simulation::write_truth`] into files of its own. No device sends it.
//!
//! Times are on the simulation's own calendar, from [`EPOCH`] and [`GLASSES_EPOCH`] on, never the host's clock.
//!
//! ```
//! use lsfb_sim::{SimConfig, Simulation};
//! let simulation = Simulation::new(&SimConfig::tiny(), &lsfb_types::no_progress)?;
//! let image = simulation.scan().image(simulation.world(), 0, 3).expect("cam0");
//! assert_eq!(image.sample.width, 160);
//! # Ok::<(), lsfb_sim::Error>(())
//! ```
//!
//! With devices, the host listening first:
//!
//! ```no_run
//! # use std::sync::{Arc, atomic::AtomicU64};
//! use lsfb_sim::{FlowControl, Pace, ScanEndpoints, SimConfig, SimSession, Simulation};
//! let simulation = Arc::new(Simulation::new(&SimConfig::default(), &lsfb_types::no_progress)?);
//! let received = Arc::new(AtomicU64::new(0)); // the host counts the LiDAR's datagrams here
//! let endpoints = ScanEndpoints {
//!     lidar_data: ([127, 0, 0, 1], 2368).into(),
//!     lidar_position: ([127, 0, 0, 1], 8308).into(),
//!     camera_sockets: ["front.sock".into(), "back.sock".into()],
//! };
//! let flow = FlowControl::new(Arc::clone(&received));
//! let session = SimSession::start_scan(&simulation, &endpoints, Pace::Unlimited, Some(flow))?;
//! println!("the IMU is at {:?}", session.imu_path());
//! let sent = session.join(&lsfb_types::no_progress)?;
//! # Ok::<(), lsfb_sim::Error>(())
//! ```

mod ambient;
mod calendar;
mod config;
mod datum;
mod device;
mod error;
mod marks;
mod noise;
mod place;
pub mod preview;
pub mod rigs;
mod sensor;
mod simulation;
mod spline;
mod timing;
mod truth;
mod walk;
pub mod world;

pub use ambient::{
    AccessPoint, AmbientChannel, AmbientMessage, AmbientSample, Beacon, Dipole, GnssEpoch,
    MagneticSensor, MagneticWorld, Network, PositionError, RadioSource, Receiver, Surroundings,
    SurroundingsTruth, Transmitters, TrueDipole, TrueTransmitter, wall_loss_db,
};
pub use calendar::{EPOCH, GLASSES_EPOCH};
pub use config::{
    BarometerConfig, BleConfig, CameraConfig, Device, GnssConfig, ImuConfig, LensKind, LidarConfig,
    LightConfig, Look, MagneticConfig, NmeaSentence, Place, PulseSource, SIMULATED_LIDARS,
    SimConfig, SimulatedImu, WalkConfig, WifiConfig,
};
pub use datum::{DatumConfig, Geodetic};
pub use device::{
    CameraPlan, Emitted, FlowControl, MYNT_UNITS, Pace, Playback, PlaybackEndpoints, ScanEmission,
    ScanEndpoints, SessionReport, SimSession, StopHandle, Turns, WalkEmission,
};
pub use error::Error;
pub use lsfb_drivers::lidar::Returns;
pub use lsfb_drivers::velodyne::Model as LidarModel;
pub use marks::Marks;
pub use place::{CalibrationBoard, TAG_M};
pub use sensor::camera::CameraSim;
pub use sensor::imu::{BiasedSample, GRAVITY_M_S2, at_rest, exact_sample};
pub use sensor::lidar::{FiringCycle, LidarSim, Return};
pub use simulation::{RigSim, Simulation};
pub use timing::{
    ClockConfig, ClockJump, Clocked, ClocksConfig, DeviceClock, Discipline, Link, LinkConfig,
    RigClocks,
};
pub use truth::{TrueBias, Truth};
pub use walk::{Motion, PaperMotion, Walk, Walker};
pub use world::{LightReport, LitPlace, LitSurface, World};
