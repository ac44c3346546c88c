//! Letters of strokes, in typefaces that differ in weight, slant and width.

use super::canvas::Canvas;
use crate::noise::{Dice, uniform};

/// How letters are drawn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Typeface {
    /// Width of a stroke, in heights of a capital.
    weight: f32,
    /// Lean to the right, in heights of a capital.
    slant: f32,
    /// Width compared to the usual.
    width: f32,
}

/// Where a line of writing begins, and where it goes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    /// Left end of the foot of the letters, metres from the picture's corner.
    pub foot: [f32; 2],
    /// Direction of writing, of unit length; letters stand to its left.
    pub along: [f32; 2],
    /// Height of a capital, metres.
    pub height_m: f32,
}

/// Units from a capital's foot to its top, and from one letter to the next.
const CAPITAL: f32 = 6.0;
const ADVANCE: f32 = 5.6;
const NARROW: f32 = 3.2;
/// Width of a unit, in heights of a capital.
const UNIT: f32 = 0.125;

impl Typeface {
    pub(crate) fn draw(rng: &Dice) -> Self {
        Self {
            weight: uniform(rng, 0.09, 0.2),
            slant: uniform(rng, -0.12, 0.22).max(0.0),
            width: uniform(rng, 0.75, 1.15),
        }
    }

    /// Length of a line, metres.
    pub(crate) fn length_m(&self, text: &str, height_m: f32) -> f32 {
        let units: f32 = text.chars().map(advance).sum();
        units * UNIT * self.width * height_m
    }

    /// Writes one line.
    pub(crate) fn write(&self, canvas: &mut Canvas, text: &str, line: &Line, ink: f32) {
        let Line {
            foot,
            along,
            height_m,
        } = *line;
        let up = [-along[1], along[0]];
        let mut begin = 0.0;
        for letter in text.chars() {
            // Thin letters stand in the middle of less room.
            let left = begin + 0.5 * (advance(letter) - ADVANCE);
            let place = |x: u8, y: u8| {
                let y = (f32::from(y) - 2.0) / CAPITAL * height_m;
                let x = (left + f32::from(x)) * UNIT * self.width * height_m + self.slant * y;
                [0, 1].map(|i| foot[i] + x * along[i] + y * up[i])
            };
            for stroke in strokes(letter).split('|') {
                let mut last = None;
                for point in stroke.as_bytes().chunks(2) {
                    let [x, y] = [point[0] - b'0', point[point.len() - 1] - b'0'];
                    let next = place(x, y);
                    if let Some(from) = last {
                        canvas.stroke(from, next, self.weight * height_m, ink);
                    }
                    last = Some(next);
                }
            }
            begin += advance(letter);
        }
    }
}

fn advance(letter: char) -> f32 {
    match letter {
        'i' | 'l' | 'j' | 'I' | '1' | '.' | ':' | ' ' => NARROW,
        _ => ADVANCE,
    }
}

/// The strokes of a letter: points, as digits of x (0–4) and y (0–8, feet at 2, capitals up to 8, small letters up to 6), joined up
/// to the next bar. Nothing for what cannot be written.
fn strokes(letter: char) -> &'static str {
    match letter {
        'A' => "022842|1535",
        'B' => "02083847463505|3544433202",
        'C' => "4738180703123243",
        'D' => "02082846442202",
        'E' => "48080242|0535",
        'F' => "480802|0535",
        'G' => "47381807031232434525",
        'H' => "0208|4248|0545",
        'I' => "2228|1232|1838",
        'J' => "4843321203",
        'K' => "0208|480542",
        'L' => "080242",
        'M' => "0208254842",
        'N' => "02084248",
        'O' => "183847433212030718",
        'P' => "02083847463505",
        'Q' => "183847433212030718|2442",
        'R' => "02083847463505|2542",
        'S' => "473818070615354443321203",
        'T' => "0848|2822",
        'U' => "080312324348",
        'V' => "082248",
        'W' => "0812263248",
        'X' => "0248|0842",
        'Y' => "082548|2522",
        'Z' => "08480242",
        'a' => "16364542|441403123243",
        'b' => "0802|0516364543321203",
        'c' => "4536160503123243",
        'd' => "4842|4536160503123243",
        'e' => "04444536160503123243",
        'f' => "38281712|0636",
        'g' => "4536160503123243|46413010",
        'h' => "0802|0516364542",
        'i' => "2622|2828",
        'j' => "36312010|3838",
        'k' => "0802|460442",
        'l' => "282332",
        'm' => "0206|05162522|25364542",
        'n' => "0206|0516364542",
        'o' => "163645433212030516",
        'p' => "0600|0516364543321203",
        'q' => "4640|4536160503123243",
        'r' => "0602|041636",
        's' => "45361605143443321203",
        't' => "18132232|0636",
        'u' => "0603123243|4642",
        'v' => "062246",
        'w' => "0612253246",
        'x' => "0642|4602",
        'y' => "0622|462210",
        'z' => "06460242",
        '0' => "182837332212030718",
        '1' => "172822|1232",
        '2' => "07183847460242",
        '3' => "084826364543321203",
        '4' => "32380444",
        '5' => "480805354443321203",
        '6' => "38180603123243443505",
        '7' => "084812",
        '8' => "183847463515060718|1504031232434435",
        '9' => "12324447381807061545",
        '-' => "1535",
        '.' => "2222",
        ':' => "2222|2525",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::stream;

    /// Letters once were strokes between points drawn at random: no two signs could be told apart by what they say.
    #[test]
    fn every_letter_looks_like_no_other_and_stays_in_its_room() {
        let face = Typeface {
            weight: 0.1,
            slant: 0.0,
            width: 1.0,
        };
        let letters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-.:";
        let drawn: Vec<Canvas> = letters
            .chars()
            .map(|letter| {
                let mut canvas = Canvas::new([0.12, 0.18], 0.004, 0.0);
                let line = Line {
                    foot: [0.03, 0.055],
                    along: [1.0, 0.0],
                    height_m: 0.1,
                };
                face.write(&mut canvas, &letter.to_string(), &line, 1.0);
                canvas
            })
            .collect();
        for (k, canvas) in drawn.iter().enumerate() {
            assert!(canvas.values.iter().any(|v| *v > 0.5), "{k}: nothing");
            let border = canvas.values.chunks(canvas.width).enumerate();
            for (y, row) in border {
                let is_edge = y == 0 || y + 1 == canvas.height;
                let ends = [row[0], row[row.len() - 1]];
                assert!(ends.iter().all(|v| *v == 0.0), "{k}");
                assert!(!is_edge || row.iter().all(|v| *v == 0.0), "{k}");
            }
            for other in &drawn[..k] {
                let apart: f32 = canvas
                    .values
                    .iter()
                    .zip(&other.values)
                    .map(|(p, q)| (p - q).abs())
                    .sum();
                assert!(apart > 3.0, "{k}: {apart}");
            }
        }
    }

    #[test]
    fn a_line_is_as_long_as_it_says() {
        let face = Typeface::draw(&stream(1, "face", 0));
        let mut canvas = Canvas::new([1.0, 0.1], 0.002, 0.0);
        let line = Line {
            foot: [0.0, 0.03],
            along: [1.0, 0.0],
            height_m: 0.05,
        };
        face.write(&mut canvas, "Room 2.117", &line, 1.0);
        let row = canvas.width;
        let last = (0..row).rev().find(|x| {
            let mut column = canvas.values.iter().skip(*x).step_by(row);
            column.any(|v| *v > 0.0)
        });
        let reached_m = last.expect("something") as f32 * 0.002;
        let said_m = face.length_m("Room 2.117", 0.05);
        assert!((reached_m - said_m).abs() < 0.02, "{reached_m} {said_m}");
    }
}
