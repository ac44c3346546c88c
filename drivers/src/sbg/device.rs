//! Opening the bus.

use std::time::Duration;

use lsfb_types::Packet;

use super::model::id;
use crate::Error;
use crate::transport::PacketSource;
use crate::transport::can::{CanConfig, CanSource};

/// Which bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SbgConfig {
    /// Network interface of the CAN adapter.
    pub interface: String,
}

impl Default for SbgConfig {
    /// The name that the udev rule gives.
    fn default() -> Self {
        Self {
            interface: "can_imu".to_owned(),
        }
    }
}

/// A unit on a bus: yields frames for [`super::Decoder`]. What it sends is set in the unit beforehand.
#[derive(Debug)]
pub struct SbgImu {
    bus: CanSource,
}

impl SbgImu {
    /// Opens the bus for the unit's messages and for errors of the bus.
    pub fn open(config: &SbgConfig) -> Result<Self, Error> {
        let bus = CanSource::open(&CanConfig {
            interface: config.interface.clone(),
            ids: id::ALL.to_vec(),
        })?;
        Ok(Self { bus })
    }

    /// Frames that the kernel dropped because nobody took them, known as of the last frame received.
    pub fn kernel_drops(&self) -> u64 {
        self.bus.kernel_drops()
    }
}

impl PacketSource for SbgImu {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        self.bus.recv(timeout)
    }
}
