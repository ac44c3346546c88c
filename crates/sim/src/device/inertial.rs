//! The backpack's IMU, whatever it speaks.

use std::path::PathBuf;

use lsfb_drivers::microstrain::MipConfig;
use lsfb_drivers::xsens::ImuConfig;
use lsfb_drivers::xsens::wire::OutputSetting;

use super::clock::SimClock;
use super::imu::{ImuDevice, measurement};
use super::mip::{MipDevice, MipStream};
use crate::config::SimulatedImu;
use crate::{BiasedSample, Error, RigSim, Simulation};

/// A unit and its end of the line.
pub(super) enum InertialDevice {
    Xsens(ImuDevice),
    Microstrain(MipDevice),
}

impl InertialDevice {
    /// A unit that samples at a rate.
    pub(super) fn new(family: SimulatedImu, rate_hz: u16) -> Result<Self, Error> {
        Ok(match family {
            SimulatedImu::Xsens => Self::Xsens(ImuDevice::new()?),
            SimulatedImu::Microstrain => Self::Microstrain(MipDevice::new(rate_hz)?),
        })
    }

    /// What the host opens as its serial line.
    pub(super) fn path(&self) -> PathBuf {
        match self {
            Self::Xsens(unit) => unit.path(),
            Self::Microstrain(unit) => unit.path(),
        }
    }

    /// Answers requests until measuring begins. `false`: the session was stopped before.
    pub(super) fn configure(&mut self, rate_hz: u16, clock: &SimClock) -> Result<bool, Error> {
        match self {
            Self::Xsens(unit) => unit.configure(rate_hz, clock),
            Self::Microstrain(unit) => unit.configure(clock),
        }
    }

    /// Sends bytes of the data stream as they are.
    pub(super) fn send(&mut self, bytes: &[u8]) -> Result<(), Error> {
        match self {
            Self::Xsens(unit) => unit.send(bytes),
            Self::Microstrain(unit) => unit.send(bytes),
        }
    }

    /// Waits until the host has read everything, and hangs up.
    pub(super) fn finish(self) -> Result<(), Error> {
        match self {
            Self::Xsens(unit) => unit.finish(),
            Self::Microstrain(unit) => unit.finish(),
        }
    }

    /// Waits for the host, then sends the whole walk. Returns the packets sent.
    pub(super) fn run(self, rig: &RigSim, clock: &SimClock, device: usize) -> Result<u64, Error> {
        match self {
            Self::Xsens(unit) => unit.run(rig, clock, device),
            Self::Microstrain(unit) => unit.run(rig, clock, device),
        }
    }
}

/// What a unit sends once the driver has configured it, sample by sample.
pub(super) enum InertialStream {
    Xsens {
        outputs: Vec<OutputSetting>,
        sent: u64,
    },
    Microstrain(MipStream),
}

impl InertialStream {
    /// The stream of the unit that the settings name.
    pub(super) fn new(simulation: &Simulation) -> Self {
        let rate_hz = simulation.scan().imu_rate_hz() as u16;
        match simulation.config().scan_imu_family {
            SimulatedImu::Xsens => Self::Xsens {
                outputs: ImuConfig {
                    rate_hz,
                    ..ImuConfig::default()
                }
                .outputs(),
                sent: 0,
            },
            SimulatedImu::Microstrain => Self::Microstrain(MipStream::new(MipConfig::format(1))),
        }
    }

    /// Appends the packet of the next sample.
    pub(super) fn push(
        &mut self,
        rig: &RigSim,
        sample: &BiasedSample,
        bytes: &mut Vec<u8>,
    ) -> Result<(), Error> {
        match self {
            Self::Xsens { outputs, sent } => {
                *sent += 1;
                measurement(outputs, rig, sample, *sent - 1, bytes)
            }
            Self::Microstrain(stream) => stream.push(rig, sample, bytes),
        }
    }
}
