//! Where a simulation takes place.

use serde::{Deserialize, Serialize};

/// Where a simulation takes place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Place {
    /// A furnished room of 20 m² that opens into a corridor.
    #[default]
    Demo,
    /// A room with an AprilGrid.
    Calibration,
    /// Large office buildings and a plaza, 100 × 100 m (sequence O0).
    OfficePark,
    /// Houses with small rooms and passages, and a plaza, 100 × 100 m (O1, O2).
    HousePark,
    /// A medium office, 15 × 35 m (M0–M2).
    MediumOffice,
    /// A large office, 135 × 30 m, that holds the following ones (L0–L3).
    LargeOffice,
    /// An exhibition hall with screens whose content changes, 20 × 30 m (E0–E2).
    ExhibitionHall,
    /// An atrium 15 m high, 15 × 60 m (A0–A4).
    Atrium,
    /// A wide corridor, 4 × 40 m (C0–C2).
    WideCorridor,
    /// A narrow corridor without texture, 2 × 30 m (C3).
    NarrowCorridor,
    /// Wide stairs over two floors, 10 × 20 m (S0–S2).
    Stairs,
    /// A scene of the user's.
    Imported,
}

impl Place {
    /// The nine environments of Table VI.
    pub const ENVIRONMENTS: [Self; 9] = [
        Self::OfficePark,
        Self::HousePark,
        Self::MediumOffice,
        Self::LargeOffice,
        Self::ExhibitionHall,
        Self::Atrium,
        Self::WideCorridor,
        Self::NarrowCorridor,
        Self::Stairs,
    ];

    /// Its name in settings and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Demo => "demo",
            Self::Calibration => "calibration",
            Self::OfficePark => "office-park",
            Self::HousePark => "house-park",
            Self::MediumOffice => "medium-office",
            Self::LargeOffice => "large-office",
            Self::ExhibitionHall => "exhibition-hall",
            Self::Atrium => "atrium",
            Self::WideCorridor => "wide-corridor",
            Self::NarrowCorridor => "narrow-corridor",
            Self::Stairs => "stairs",
            Self::Imported => "imported",
        }
    }

    /// The place of a name.
    pub fn named(name: &str) -> Option<Self> {
        [Self::Demo, Self::Calibration, Self::Imported]
            .into_iter()
            .chain(Self::ENVIRONMENTS)
            .find(|p| p.name() == name)
    }

    /// Extent along x and y, metres; of an imported scene, no more than a guess.
    pub const fn size_m(self) -> [f64; 2] {
        match self {
            Self::Demo => [11.0, 7.0],
            Self::Calibration => [6.0, 5.0],
            Self::OfficePark | Self::HousePark => [100.0, 100.0],
            Self::MediumOffice => [15.0, 35.0],
            Self::LargeOffice => [135.0, 30.0],
            Self::ExhibitionHall => [20.0, 30.0],
            Self::Atrium => [60.0, 15.0],
            Self::WideCorridor => [40.0, 4.0],
            Self::NarrowCorridor => [30.0, 2.0],
            Self::Stairs => [10.0, 20.0],
            Self::Imported => [10.0, 10.0],
        }
    }

    /// Whether it can be night here.
    pub const fn has_nights(self) -> bool {
        !matches!(self, Self::Demo | Self::Calibration | Self::Imported)
    }

    /// Whether there are doors here that stand open, and could be closed.
    pub const fn has_fire_doors(self) -> bool {
        matches!(
            self,
            Self::LargeOffice | Self::HousePark | Self::WideCorridor | Self::NarrowCorridor
        )
    }

    /// Whether satellites are seen here.
    pub const fn is_outdoors(self) -> bool {
        matches!(self, Self::OfficePark | Self::HousePark)
    }
}
