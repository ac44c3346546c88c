//! The motions of the paper's Table VII.

use lsfb_types::OutOfBounds;

use super::plan::{FRAME_RATE_HZ, Gait, Gaze};
use crate::Error;
use crate::config::{Device, Place, SimConfig};
use crate::place::Route;

/// One row of Table VII.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperMotion {
    /// Name of the sequence: `O0` … `S2`.
    pub name: &'static str,
    /// Where it takes place.
    pub place: Place,
    /// Number of images, by device.
    pub frames: [u32; 3],
    /// Length of the path, metres, by device.
    pub length_m: [f64; 3],
    pub(crate) route: Route,
    pub(crate) gaze: Gaze,
    pub(crate) gait: Gait,
}

impl PaperMotion {
    /// The row of a name.
    pub fn named(name: &str) -> Option<&'static Self> {
        TABLE.iter().find(|m| m.name.eq_ignore_ascii_case(name))
    }

    /// All rows.
    pub fn all() -> &'static [Self] {
        &TABLE
    }

    /// How long it takes, seconds.
    pub fn duration_s(&self, device: Device) -> f64 {
        f64::from(self.frames[device as usize]) / FRAME_RATE_HZ
    }

    /// Whether somebody steps before the camera now and then.
    pub fn is_occluded(&self) -> bool {
        self.name == "M2"
    }

    /// Length of the path, metres.
    pub fn length_m(&self, device: Device) -> f64 {
        self.length_m[device as usize]
    }
}

impl SimConfig {
    /// [`SimConfig::for_place`] with the second walk of a sequence of Table VII.
    pub fn for_motion(motion: &PaperMotion, device: Device) -> Self {
        let mut config = Self::for_place(motion.place, device);
        config.motion = motion.name.to_owned();
        config
    }

    /// The sequence of Table VII that the second walk follows.
    pub fn paper_motion(&self) -> Result<Option<&'static PaperMotion>, Error> {
        if self.motion.is_empty() {
            return Ok(None);
        }
        let found = PaperMotion::named(&self.motion).filter(|m| m.place == self.place);
        found.map(Some).ok_or_else(|| {
            let bounds = "a sequence of Table VII that belongs to the place";
            OutOfBounds::new("", "motion", &self.motion, &bounds).into()
        })
    }
}

macro_rules! row {
    ($name:literal $place:ident [$($f:literal)*] [$($l:literal)*] $route:ident $gaze:expr, $gait:ident) => {
        PaperMotion {
            name: $name,
            place: Place::$place,
            frames: [$($f),*],
            length_m: [$($l as f64),*],
            route: Route::$route,
            gaze: $gaze,
            gait: Gait::$gait,
        }
    };
}

/// Frames and lengths as printed, but for O1 on the iPhone: 1175 m in 107 s cannot be walked, so 175 m.
static TABLE: [PaperMotion; 25] = [
    row!("O0" OfficePark [10528 9641 4909] [490 464 240] Loop Gaze::Ahead, WALK),
    row!("O1" HousePark [5116 3205 3831] [225 175 147] Loop Gaze::Ahead, WALK),
    row!("O2" HousePark [8363 8447 8119] [382 341 330] Rooms Gaze::Ahead, WALK),
    row!("M0" MediumOffice [4024 3760 3342] [126 124 121] Loop Gaze::Ahead, WALK),
    row!("M1" MediumOffice [5230 4741 3628] [143 138 125] Loop Gaze::AroundSlow, WALK),
    row!("M2" MediumOffice [4749 4315 2752] [141 129 89] Loop Gaze::AroundFast, WALK),
    row!("L0" LargeOffice [12369 11829 7314] [454 478 317] Loop Gaze::Ahead, WALK),
    row!("L1" LargeOffice [15179 13967 9357] [558 579 419] Loop Gaze::Ahead, WALK),
    row!("L2" LargeOffice [16889 17210 14632] [592 635 517] Loop Gaze::AroundSlow, WALK),
    row!("L3" LargeOffice [16517 17012 14483] [604 638 540] Loop Gaze::AroundSlow, WALK),
    row!("E0" ExhibitionHall [2011 1841 1873] [50 51 44] Line Gaze::Ahead, WALK),
    row!("E1" ExhibitionHall [5137 4208 2847] [140 127 86] Loop Gaze::AroundSlow, WALK),
    row!("E2" ExhibitionHall [2412 2518 2052] [13 14 8] Spot Gaze::Turning, STAND),
    row!("A0" Atrium [1260 1245 1486] [31 26 41] Middle Gaze::Left, WALK),
    row!("A1" Atrium [3526 4044 3955] [116 138 130] Loop Gaze::Right, WALK),
    row!("A2" Atrium [2076 2230 3601] [60 67 105] Line Gaze::Ahead, WALK),
    row!("A3" Atrium [2053 4816 2640] [62 166 86] Loop Gaze::AroundSlow, WALK),
    row!("A4" Atrium [1930 2417 2049] [115 142 132] Loop Gaze::Ahead, RUN),
    row!("C0" WideCorridor [1942 2040 2197] [64 63 62] Line Gaze::Ahead, WALK),
    row!("C1" WideCorridor [2443 1960 2859] [66 59 76] Line Gaze::AroundSlow, WALK),
    row!("C2" WideCorridor [2278 1871 2154] [60 63 63] Line Gaze::Left, WALK),
    row!("C3" NarrowCorridor [2001 1827 2441] [64 57 87] Line Gaze::Ahead, WALK),
    row!("S0" Stairs [1620 1912 1971] [39 41 40] Line Gaze::Ahead, WALK),
    row!("S1" Stairs [2346 2976 2520] [52 59 58] Loop Gaze::AroundSlow, WALK),
    row!("S2" Stairs [2533 2448 2186] [54 53 53] Loop Gaze::Left, WALK),
];
