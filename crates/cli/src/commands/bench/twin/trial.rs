//! What a trial consists of: which place is walked through with which device, under which seed and condition, and the settings of
//! the simulation for each.

use std::path::PathBuf;

use lsfb_sim::{Device, Look, PaperMotion, Place, SimConfig};
use serde::{Deserialize, Serialize};

use crate::twin_session::{beside_the_scan, smaller};

/// Age of the place when the walk is made, under [`Condition::SixMonths`].
const MONTHS: u32 = 6;
/// Another floor has other things in it, as the same has later on: by so many months, which no other condition has.
const MONTHS_TO_ANOTHER_FLOOR: u32 = 7;
/// The name of [`Condition::OtherFloor`].
pub const OTHER_FLOOR: &str = "other-floor";
/// People who were not there during the scan, under [`Condition::Crowd`].
const CROWD: u32 = 12;

/// Quality of the JPEG compression that phones' images go through on a walk: it stands for all that lossy video does, and leaves true matches as far
/// apart as those of real images (`docs/twin.md`, "Against real images"). A board is recorded with the device's own.
const PHONE_JPEG_QUALITY: u8 = 40;

/// What has become of the place between scan and walk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Condition {
    /// Nothing but that people walk elsewhere and screens show something else.
    AsScanned,
    /// Half of what people move has been moved about.
    SixMonths,
    /// A dozen people more on the ways.
    Crowd,
    /// Nothing, but the walk is on another floor that is built alike: half of what people move is another there.
    OtherFloor,
    /// It is night, and nobody works there.
    Night,
    /// A door that stood open has been closed.
    FireDoor,
}

impl Condition {
    const ALL: [Self; 6] = [
        Self::AsScanned,
        Self::SixMonths,
        Self::Crowd,
        Self::OtherFloor,
        Self::Night,
        Self::FireDoor,
    ];

    /// Its name on the command line and in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::AsScanned => "as-scanned",
            Self::SixMonths => "six-months",
            Self::Crowd => "crowd",
            Self::OtherFloor => OTHER_FLOOR,
            Self::Night => "night",
            Self::FireDoor => "fire-door",
        }
    }

    /// The condition of a name.
    pub fn named(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|c| c.name() == name);
        found.ok_or_else(|| format!("expected one of {}", Self::ALL.map(Self::name).join(", ")))
    }

    /// Whether a place can come to be so.
    pub fn is_possible_in(self, place: Place) -> bool {
        match self {
            Self::FireDoor => place.has_fire_doors(),
            Self::Night => place.has_nights(),
            Self::AsScanned | Self::SixMonths | Self::Crowd | Self::OtherFloor => true,
        }
    }
}

/// How much of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Size {
    /// Whole routes of scanner and Table VII, full resolution.
    Full,
    /// The same difficulty on shorter ways: parts of the routes, smaller images. Walks still have 30 Hz.
    Quick,
    /// Seconds of either: whether everything runs.
    TryOut,
}

/// What places are lit by, and how they are painted.
#[derive(Clone, Debug)]
pub struct Light {
    /// Folder in which traced light is kept; without, light is simple.
    pub folder: Option<PathBuf>,
    /// How surfaces are painted.
    pub look: Look,
}

impl Light {
    /// Settings with this light and look.
    pub fn on(&self, mut config: SimConfig) -> SimConfig {
        config.look = self.look;
        if let Some(folder) = &self.folder {
            config.light.baked = true;
            config.light.cache.clone_from(folder);
        }
        config
    }
}

/// A scan of one place, and the map that is made of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Scanned {
    pub place: Place,
    pub seed: u64,
    pub size: Size,
}

/// A walk in the map of a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Walked {
    pub scanned: Scanned,
    pub condition: Condition,
    pub device: Device,
}

impl Scanned {
    /// Settings of the scan.
    pub fn config(&self) -> SimConfig {
        self.with(Device::Glasses)
    }

    /// The motion of Table VII that is walked here: another with each seed.
    pub fn motion(&self) -> Option<&'static PaperMotion> {
        let of_place: Vec<_> = PaperMotion::all()
            .iter()
            .filter(|motion| motion.place == self.place)
            .collect();
        let count = of_place.len().max(1) as u64;
        of_place.get((self.seed % count) as usize).copied()
    }

    fn with(&self, device: Device) -> SimConfig {
        let mut config = beside_the_scan(self.place, self.motion(), device, self.seed);
        if device != Device::Glasses {
            config.glasses_cameras.jpeg_quality = PHONE_JPEG_QUALITY;
        }
        let durations_s = match self.size {
            Size::Full => None,
            Size::Quick => Some([36.0, 10.0]),
            Size::TryOut => Some([14.0, 3.0]),
        };
        if let Some([scan_s, walk_s]) = durations_s {
            smaller(&mut config);
            config.scan.duration_s = scan_s;
            config.glasses.duration_s = walk_s;
        }
        config
    }
}

impl Walked {
    /// Settings of the walk; its scan is that of [`Scanned::config`].
    pub fn config(&self) -> SimConfig {
        let mut config = self.scanned.with(self.device);
        match self.condition {
            Condition::AsScanned => {}
            Condition::SixMonths => config.months_later = MONTHS,
            Condition::Crowd => config.crowd = CROWD,
            Condition::OtherFloor => {
                config.months_later = MONTHS_TO_ANOTHER_FLOOR;
                config.floors_up = 1;
            }
            Condition::Night => config.night = true,
            Condition::FireDoor => config.fire_door = true,
        }
        config
    }

    /// How long the walk takes, seconds.
    pub fn duration_s(&self) -> f64 {
        match (self.config().glasses.duration_s, self.scanned.motion()) {
            (0.0, Some(motion)) => motion.duration_s(self.device),
            (set, _) => set,
        }
    }
}

/// Settings of the calibration place, for the backpack and a device.
pub fn calibration(device: Device, seed: u64, size: Size) -> SimConfig {
    let mut config = SimConfig::for_place(Place::Calibration, device);
    config.seed = seed;
    if size != Size::Full {
        smaller(&mut config);
        // In shorter ones the board is hardly tilted while the backpack is held still enough.
        config.scan.duration_s = 72.0;
        config.glasses.duration_s = 30.0;
        for cameras in [&mut config.scan_cameras, &mut config.glasses_cameras] {
            // Before a board one moves slowly.
            (cameras.rate_hz, cameras.motion_blur) = (10, false);
        }
    }
    config
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quick_trial_keeps_what_is_hard() {
        for place in Place::ENVIRONMENTS {
            for device in Device::ALL {
                let of = |size| {
                    let scanned = Scanned {
                        place,
                        seed: 3,
                        size,
                    };
                    let walked = Walked {
                        scanned,
                        condition: Condition::AsScanned,
                        device,
                    };
                    walked.config().check().expect("can be simulated");
                    walked.config()
                };
                let (quick, full) = (of(Size::Quick), of(Size::Full));
                assert_eq!(quick.glasses_cameras.rate_hz, 30);
                assert_eq!(quick.motion, full.motion, "the same motion");
                assert_eq!(quick.off_path_m, full.off_path_m);
                let (q, f) = (&quick.glasses_cameras, &full.glasses_cameras);
                assert!(q.motion_blur && q.auto_exposure);
                assert_eq!((q.readout_ns, q.exposure_ns), (f.readout_ns, f.exposure_ns));
                assert_eq!(q.focal_per_width, f.focal_per_width);
                assert!(full.scan.duration_s == 0.0 && full.glasses.duration_s == 0.0);
            }
        }
    }

    #[test]
    fn a_walk_belongs_to_the_scan_of_its_place() {
        let scanned = Scanned {
            place: Place::Atrium,
            seed: 2,
            size: Size::Quick,
        };
        let scan = scanned.config();
        for device in Device::ALL {
            let walked = Walked {
                scanned,
                condition: Condition::SixMonths,
                device,
            };
            let walk = walked.config();
            assert_eq!((walk.scan, walk.seed), (scan.scan.clone(), scan.seed));
            assert_eq!((walk.months_later, scan.months_later), (MONTHS, 0));
        }
    }

    #[test]
    fn every_condition_can_be_simulated_where_it_is_possible_and_nowhere_else() {
        for place in Place::ENVIRONMENTS {
            for condition in Condition::ALL {
                let size = Size::Quick;
                let scanned = Scanned {
                    place,
                    seed: 2,
                    size,
                };
                let walked = Walked {
                    scanned,
                    condition,
                    device: Device::Iphone,
                };
                let is_possible = condition.is_possible_in(place);
                assert_eq!(
                    walked.config().check().is_ok(),
                    is_possible,
                    "{place:?} {condition:?}"
                );
                assert!(!scanned.config().night && !scanned.config().fire_door);
            }
        }
    }
}
