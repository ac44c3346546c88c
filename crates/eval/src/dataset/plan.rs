//! The plan of a dataset: environments, motions in them, and each motion once with each device.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The plan as it stands in the program.
const PAPER: &str = include_str!("plan.toml");

/// What a sequence is recorded with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Device {
    /// An Android phone.
    Android,
    /// An iPhone.
    Iphone,
    /// AR glasses.
    Glasses,
}

impl Device {
    /// All of them, in the order of the tables.
    pub const ALL: [Self; 3] = [Self::Android, Self::Iphone, Self::Glasses];

    /// Its name in sequences and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Android => "android",
            Self::Iphone => "iphone",
            Self::Glasses => "glasses",
        }
    }
}

/// How one moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Gait {
    /// On the spot.
    Stand,
    /// As people walk.
    Walk,
    /// As people run.
    Run,
}

/// Where one looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Gaze {
    /// Where one goes.
    Ahead,
    /// Around, slowly.
    Around,
    /// Around, fast.
    AroundFast,
    /// To one side of where one goes.
    Sideways,
}

impl fmt::Display for Gait {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Stand => "stand",
            Self::Walk => "walk",
            Self::Run => "run",
        })
    }
}

impl fmt::Display for Gaze {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ahead => "ahead",
            Self::Around => "around",
            Self::AroundFast => "around-fast",
            Self::Sideways => "sideways",
        })
    }
}

/// A row of Table VI.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Environment {
    /// Its name in files.
    pub name: String,
    /// Its name in tables.
    pub title: String,
    /// Extent along x and y, metres.
    pub size_m: [f64; 2],
    /// Whether access points and beacons are heard in it.
    pub radio: bool,
    /// What it is.
    pub description: String,
}

/// One value for each device.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PerDevice<T> {
    /// The Android phone's.
    pub android: T,
    /// The iPhone's.
    pub iphone: T,
    /// The glasses'.
    pub glasses: T,
}

impl<T: Copy> PerDevice<T> {
    /// A device's.
    pub fn of(&self, device: Device) -> T {
        match device {
            Device::Android => self.android,
            Device::Iphone => self.iphone,
            Device::Glasses => self.glasses,
        }
    }
}

/// A row of Table VII.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motion {
    /// `O0` … `S2`.
    pub name: String,
    /// Name of its environment.
    pub environment: String,
    /// How one moves.
    pub gait: Gait,
    /// Where one looks.
    pub gaze: Gaze,
    /// Number of images of a camera.
    pub frames: PerDevice<u32>,
    /// Length of the path, metres.
    pub length_m: PerDevice<f64>,
    /// What it is.
    pub description: String,
}

/// Environments and motions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetPlan {
    /// Images per second of all devices.
    pub rate_hz: f64,
    /// Table VI.
    #[serde(rename = "environment")]
    pub environments: Vec<Environment>,
    /// Table VII.
    #[serde(rename = "motion")]
    pub motions: Vec<Motion>,
}

/// One motion with one device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannedSequence<'a> {
    /// `C3-android`.
    pub name: String,
    /// The motion.
    pub motion: &'a Motion,
    /// The device.
    pub device: Device,
    /// Number of images of a camera.
    pub frames: u32,
    /// Length of the path, metres.
    pub length_m: f64,
    /// How long it takes, seconds.
    pub duration_s: f64,
}

impl DatasetPlan {
    /// The 75 sequences of Tables VI and VII, as TOML.
    pub fn paper_toml() -> &'static str {
        PAPER
    }

    /// The 75 sequences of Tables VI and VII.
    pub fn paper() -> Result<Self, toml::de::Error> {
        toml::from_str(PAPER)
    }

    /// Every motion with every device, in the order of the plan.
    pub fn sequences(&self) -> Vec<PlannedSequence<'_>> {
        let motions = self.motions.iter();
        let of = |motion, device| self.sequence(motion, device);
        motions
            .flat_map(|motion| Device::ALL.map(|device| of(motion, device)))
            .collect()
    }

    fn sequence<'a>(&self, motion: &'a Motion, device: Device) -> PlannedSequence<'a> {
        let frames = motion.frames.of(device);
        PlannedSequence {
            name: format!("{}-{}", motion.name, device.name()),
            motion,
            device,
            frames,
            length_m: motion.length_m.of(device),
            duration_s: f64::from(frames) / self.rate_hz,
        }
    }
}
