//! The families of inertial units that have a driver here.

/// What an inertial unit speaks, and on which kind of line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "kebab-case")
)]
pub enum ImuFamily {
    /// Xsens MTData2 on a serial line, with UTC.
    #[default]
    Xsens,
    /// MicroStrain MIP on a serial line, with the time since power-up.
    Microstrain,
    /// SBG on a CAN bus; what it sends is set in the unit beforehand.
    Sbg,
    /// The unit in a Mynt D camera, on USB (feature `hardware`); it sends as soon as it has power.
    MyntD,
}

impl ImuFamily {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Xsens, Self::Microstrain, Self::Sbg, Self::MyntD];

    /// Its name in settings.
    pub const fn key(self) -> &'static str {
        match self {
            Self::Xsens => "xsens",
            Self::Microstrain => "microstrain",
            Self::Sbg => "sbg",
            Self::MyntD => "mynt-d",
        }
    }

    /// Kind of its packets in a recording.
    pub const fn raw_kind(self) -> u16 {
        match self {
            Self::Xsens => 0,
            Self::Microstrain => 1,
            Self::Sbg => 2,
            Self::MyntD => 3,
        }
    }
}
