//! Images, and plots over the area of an image: pixels to the right and down.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{Markup, html};

use super::axis::Axis;
use super::plot::{Ink, Layer, Plot, SHADES, plot_height_px, plot_width_px};

/// Width of the plots, pixels of the page.
const WIDTH_PX: u32 = 340;
/// Tallest data area: an image that stands on end is no longer than this.
const TALLEST_PX: u32 = 480;

/// A PNG within the page: a file beside it would be missing wherever the page is sent.
pub fn png(bytes: &[u8], alt: &str) -> Markup {
    let source = format!("data:image/png;base64,{}", STANDARD.encode(bytes));
    html! { img src=(source) alt=(alt); }
}

/// How often something was seen in each cell of an image: `cells` by rows from the upper left. Cells in which nothing was seen are
/// marked.
pub fn coverage(name: &str, cells: &[u32], [columns, rows]: [usize; 2], size_px: [u32; 2]) -> Plot {
    let most = f64::from(cells.iter().copied().max().unwrap_or(0).max(1));
    let cell = [
        f64::from(size_px[0]) / columns.max(1) as f64,
        f64::from(size_px[1]) / rows.max(1) as f64,
    ];
    let boxes = cells.iter().enumerate().map(|(k, count)| {
        let (column, row) = ((k % columns.max(1)) as f64, (k / columns.max(1)) as f64);
        let from = [column * cell[0], row * cell[1]];
        // What was seen once is not dark, what was seen as often as any is.
        let share = (f64::from(*count) / most).sqrt();
        let shade = ((share * f64::from(SHADES)) as u8).min(SHADES - 1);
        let ink = if *count == 0 {
            Ink::Bad
        } else {
            Ink::Shade(shade)
        };
        (from, [from[0] + cell[0], from[1] + cell[1]], ink)
    });
    over_image(
        name,
        size_px,
        vec![Layer::Boxes {
            boxes: boxes.collect(),
        }],
    )
}

/// Arrows from points of an image; `enlarged` times as long as given.
pub fn arrows(
    name: &str,
    arrows: &[([f64; 2], [f64; 2])],
    enlarged: f64,
    size_px: [u32; 2],
) -> Plot {
    let mut layers: Vec<Layer> = arrows
        .iter()
        .map(|(from, by)| {
            let to = [from[0] + enlarged * by[0], from[1] + enlarged * by[1]];
            Layer::line(vec![*from, to], Ink::Series(0))
        })
        .collect();
    layers.push(Layer::dots(
        arrows.iter().map(|(from, _)| *from).collect(),
        Ink::Series(0),
    ));
    over_image(name, size_px, layers)
}

fn over_image(name: &str, size_px: [u32; 2], layers: Vec<Layer>) -> Plot {
    let [width, height] = size_px.map(|side| f64::from(side.max(1)));
    let tall = (f64::from(plot_width_px(WIDTH_PX)) * height / width).round();
    Plot {
        name: name.to_owned(),
        width_px: WIDTH_PX,
        height_px: plot_height_px((tall as u32).clamp(40, TALLEST_PX)),
        x: Axis::linear("x (px)", [0.0, width]),
        y: Axis::linear("y (px)", [height, 0.0]),
        layers,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_without_anything_are_marked() {
        let plot = coverage("corners", &[0, 1, 4, 100], [2, 2], [640, 480]);
        let [Layer::Boxes { boxes }] = plot.layers.as_slice() else {
            panic!("{plot:?}");
        };
        let inks: Vec<Ink> = boxes.iter().map(|b| b.2).collect();
        assert_eq!(
            inks,
            [
                Ink::Bad,
                Ink::Shade(0),
                Ink::Shade(1),
                Ink::Shade(SHADES - 1)
            ]
        );
        assert_eq!(boxes[3].0, [320.0, 240.0]);
        assert_eq!(plot.y.range, [480.0, 0.0]);
    }
}
