//! An IMU: what it speaks, and on which line or bus.

use std::path::PathBuf;

use lsfb_drivers::ImuFamily;
use lsfb_geometry::MAIN_IMU;
use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

/// An IMU on a line or bus of its own.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuLineConfig {
    /// Its name in the recording and in the rig.
    #[serde(default = "ImuLineConfig::default_name")]
    pub name: String,
    /// What it speaks.
    #[serde(default)]
    pub family: ImuFamily,
    /// The serial line, the usbfs node, or the name of the CAN interface.
    pub path: PathBuf,
    /// Speed of a serial line, baud.
    #[serde(default = "ImuLineConfig::default_baud")]
    pub baud: u32,
    /// Samples per second, of units that are told on a serial line.
    #[serde(default = "ImuLineConfig::default_rate")]
    pub rate_hz: u16,
}

lsfb_types::bounds! {
    ImuLineConfig {
        name: any,
        family: any,
        path: any,
        baud: number(Bounds::NOT_NEGATIVE),
        rate_hz: number(Bounds::AT_LEAST_ONE),
    }
}

impl ImuLineConfig {
    fn default_name() -> String {
        MAIN_IMU.to_owned()
    }

    fn default_baud() -> u32 {
        lsfb_drivers::xsens::model::DEFAULT_BAUD
    }

    fn default_rate() -> u16 {
        200
    }
}
