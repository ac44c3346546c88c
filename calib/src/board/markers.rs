//! Tags and markers: which of their cells are white, and where a ChArUco board has them.

use serde::{Deserialize, Serialize};

use super::{aruco, tag36h11};

/// Markers with numbers, as OpenCV predefines them. Its dictionaries of 50, 100, 250 and 1000 markers begin alike, so that
/// the size needs not be said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MarkerDictionary {
    /// 4 × 4 bits.
    #[serde(rename = "4x4")]
    Aruco4x4,
    /// 5 × 5 bits.
    #[serde(rename = "5x5")]
    Aruco5x5,
    /// 6 × 6 bits.
    #[serde(rename = "6x6")]
    Aruco6x6,
}

impl MarkerDictionary {
    /// Its name: `4x4`, `5x5` or `6x6`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Aruco4x4 => "4x4",
            Self::Aruco5x5 => "5x5",
            Self::Aruco6x6 => "6x6",
        }
    }

    /// The dictionary of a name.
    pub fn named(name: &str) -> Option<Self> {
        let all = [Self::Aruco4x4, Self::Aruco5x5, Self::Aruco6x6];
        all.into_iter().find(|d| d.name() == name)
    }

    /// Bits along the edge of a code.
    pub(crate) fn edge_bits(self) -> usize {
        match self {
            Self::Aruco4x4 => 4,
            Self::Aruco5x5 => 5,
            Self::Aruco6x6 => 6,
        }
    }

    pub(crate) fn codes(self) -> &'static [u64] {
        match self {
            Self::Aruco4x4 => &aruco::CODES_4X4,
            Self::Aruco5x5 => &aruco::CODES_5X5,
            Self::Aruco6x6 => &aruco::CODES_6X6,
        }
    }

    /// Less than half of what any two codes differ by.
    pub(crate) fn forgiven(self) -> u32 {
        match self {
            Self::Aruco4x4 => 1,
            Self::Aruco5x5 => 2,
            Self::Aruco6x6 => 3,
        }
    }

    /// Whether the cell of a marker's code is white, by column and row from its upper left.
    pub(crate) fn is_white(self, marker: usize, column: usize, row: usize) -> bool {
        let bits = self.edge_bits();
        let code = self.codes().get(marker).copied().unwrap_or_default();
        code >> (bits * bits - 1 - (row * bits + column)) & 1 == 1
    }
}

/// Markers known of each dictionary.
pub const MARKERS: u32 = 250;

/// Tags in the family 36h11.
pub const TAGS_36H11: u32 = 587;

/// Bits along the edge of a tag of Kalibr's grid: two of border, six of code, two of border.
pub(crate) const EDGE_BITS: usize = 10;
pub(crate) const BORDER_BITS: usize = 2;
pub(crate) const CODE_BITS: usize = EDGE_BITS - 2 * BORDER_BITS;

/// Codes of the family 36h11 by number.
pub(crate) fn tag_codes() -> &'static [u64] {
    &tag36h11::CODES
}

/// The cells of a tag by rows from its upper left, white is `true`: border, code, border.
pub fn tag_cells(number: usize) -> [[bool; EDGE_BITS]; EDGE_BITS] {
    let code = tag36h11::CODES.get(number).copied().unwrap_or_default();
    let mut cells = [[false; EDGE_BITS]; EDGE_BITS];
    for k in 0..CODE_BITS * CODE_BITS {
        let bit = CODE_BITS * CODE_BITS - 1 - k;
        let place = |n: usize| BORDER_BITS + CODE_BITS - 1 - n;
        cells[place(k / CODE_BITS)][place(k % CODE_BITS)] = code >> bit & 1 == 1;
    }
    cells
}

/// The square of a marker of a ChArUco board, column and row: white ones by rows, the upper left square of the board is black.
pub(crate) fn charuco_square(marker: usize, columns: usize) -> (i32, i32) {
    // Two rows together have as many white squares as columns.
    let (pair, rest) = (marker / columns, marker % columns);
    let in_first = columns / 2;
    let (x, y) = if rest < in_first {
        (2 * rest + 1, 2 * pair)
    } else {
        (2 * (rest - in_first), 2 * pair + 1)
    };
    (x as i32, y as i32)
}
