//! What surfaces are made of, as far as radio waves and magnets notice.

/// What a surface is made of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Substance {
    /// Plasterboard, panels, plastics, what is not known.
    #[default]
    Board,
    /// Wood and chipboard.
    Wood,
    /// Masonry.
    Brick,
    /// Concrete with its reinforcement, stone floors.
    Concrete,
    /// Panes.
    Glass,
    /// Steel: frames, cabinets, ducts.
    Metal,
    /// Cloth, paper, people.
    Soft,
    /// Leaves and twigs.
    Leaves,
    /// No surface at all: the sky behind a place.
    Sky,
}

impl Substance {
    /// What a wave of this frequency loses on its way through a large piece, decibel: of the order that ITU-R P.2040 and
    /// P.1238 give for walls of usual thickness.
    pub fn loss_db(self, frequency_mhz: f64) -> f64 {
        let [at_2400, at_5500] = match self {
            Self::Board => [3.0, 4.5],
            Self::Wood => [4.0, 6.0],
            Self::Brick => [8.0, 13.0],
            Self::Concrete => [13.0, 21.0],
            Self::Glass => [2.0, 3.0],
            Self::Metal => [18.0, 23.0],
            Self::Soft => [1.0, 2.0],
            Self::Leaves => [0.5, 1.0],
            Self::Sky => [0.0, 0.0],
        };
        let share = ((frequency_mhz - 2400.0) / 3100.0).clamp(0.0, 1.0);
        at_2400 + share * (at_5500 - at_2400)
    }

    /// How much steel there is in it, 0 to 1.
    pub(crate) fn steel(self) -> f32 {
        match self {
            Self::Metal => 1.0,
            Self::Concrete => 0.25,
            _ => 0.0,
        }
    }
}
