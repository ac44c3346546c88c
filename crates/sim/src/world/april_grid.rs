//! The AprilGrid that camera calibration looks at: six by six tags of family 36h11, as Kalibr prints it.
//!
//! Tag 0 is at the lower left, numbers grow to the right and then upwards. A tag is ten cells wide, two of them a black
//! border on either side; tags are 0.3 of their edge apart, with a black square where the gaps cross.

use super::canvas::Canvas;

/// Tags along either edge of the board.
pub const TAGS: usize = 6;
/// Gap between two tags, in edges of a tag.
pub const GAP: f32 = 0.3;
/// Cells along the edge of a tag, border included.
const CELLS: usize = 10;
const BORDER_CELLS: usize = 2;
const BLACK: f32 = 0.05;
const WHITE: f32 = 0.88;

/// Codes 0–35 of the family 36h11 (Olson 2011; Wang and Olson 2016): six rows of six bits from the top left, the most
/// significant first, 1 for white.
const CODES: [u64; TAGS * TAGS] = [
    0xd5d628584,
    0xd97f18b49,
    0xdd280910e,
    0xe479e9c98,
    0xebcbca822,
    0xf31dab3ac,
    0x056a5d085,
    0x10652e1d4,
    0x22b1dfead,
    0x265ad0472,
    0x34fe91b86,
    0x3ff962cd5,
    0x43a25329a,
    0x474b4385f,
    0x4e9d243e9,
    0x5246149ae,
    0x5997f5538,
    0x683bb6c4c,
    0x6be4a7211,
    0x7e3158eea,
    0x81da494af,
    0x858339a74,
    0x8cd51a5fe,
    0x9f21cc2d7,
    0xa2cabc89c,
    0xadc58d9eb,
    0xb16e7dfb0,
    0xb8c05eb3a,
    0xd25ef139d,
    0xd607e1962,
    0xe4aba3076,
    0x2dde6a3da,
    0x43d40c678,
    0x5620be351,
    0x64c47fa65,
    0x686d7002a,
];

/// Edge of the printed grid, from the outer edge of the first black square to that of the last, metres.
pub fn edge_m(tag_m: f32) -> f32 {
    (TAGS as f32 + (TAGS + 1) as f32 * GAP) * tag_m
}

/// Where the corners of tag `id` lie, from the lower left corner of the grid, metres: lower left, lower right, upper
/// right, upper left.
pub fn corners_m(id: usize, tag_m: f32) -> [[f32; 2]; 4] {
    let low = [id % TAGS, id / TAGS].map(|k| (GAP + k as f32 * (1.0 + GAP)) * tag_m);
    [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
        .map(|[x, y]| [low[0] + x * tag_m, low[1] + y * tag_m])
}

/// Width of the white margin around a grid, metres, of tags of this size: whole cells, as its texels fit into these.
pub fn margin_m(tag_m: f32) -> f32 {
    7.0 * tag_m / CELLS as f32
}

/// Edge of the texels that the grid is printed with, metres, of tags of this size. Eight fit into a cell, and cells into gaps and
/// margin: all edges lie between texels, and do so in the three levels that are halved from them. Elsewhere interpolation moves
/// an edge by up to a hundredth of a texel or two, not the same from tag to tag.
pub(super) fn texel_m(tag_m: f32) -> f32 {
    // A little more, so that rounding adds none to a whole number of them.
    1.000_01 * tag_m / (8 * CELLS) as f32
}

/// Paints the grid in the middle of a canvas.
pub(super) fn paint(canvas: &mut Canvas, tag_m: f32) {
    let size = canvas.size_m();
    let edge = edge_m(tag_m);
    let origin = size.map(|s| 0.5 * (s - edge));
    canvas.values.fill(WHITE);
    canvas.is_measured = true;
    let mut square = |x: f32, y: f32, edge: f32, tone: f32| {
        let low = [origin[0] + x, origin[1] + y];
        canvas.rectangle(low, [low[0] + edge, low[1] + edge], tone);
    };
    for row in 0..=TAGS {
        for column in 0..=TAGS {
            let at = |k: usize| k as f32 * (1.0 + GAP) * tag_m;
            square(at(column), at(row), GAP * tag_m, BLACK);
        }
    }
    let cell = tag_m / CELLS as f32;
    for (id, code) in CODES.iter().enumerate() {
        let [x, y] = corners_m(id, tag_m)[0];
        square(x, y, tag_m, BLACK);
        for bit in (0..36).filter(|bit| code >> (35 - bit) & 1 == 1) {
            let (column, row) = (bit % 6 + BORDER_CELLS, 7 - bit / 6);
            square(x + column as f32 * cell, y + row as f32 * cell, cell, WHITE);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_differ_by_eleven_bits_in_every_turn() {
        let turned = |code: u64| {
            let bit = |r: usize, c: usize| code >> (35 - (6 * r + c)) & 1;
            (0..36).fold(0, |sum, k| sum << 1 | bit(5 - k % 6, k / 6))
        };
        for (i, &a) in CODES.iter().enumerate() {
            for (j, &b) in CODES.iter().enumerate() {
                let mut other = b;
                for turn in 0..4 {
                    let same = i == j && turn == 0;
                    assert!(same || (a ^ other).count_ones() >= 11, "{i} {j} {turn}");
                    other = turned(other);
                }
            }
        }
    }
}
