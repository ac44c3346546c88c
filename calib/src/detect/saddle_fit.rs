//! The corner as the middle of four sectors as lens and pixels show them:
//! `mean + amplitude · edge(g · (p − c)) · edge(h · (p − c))`, with the corner `c` and a vector across either edge, as long as the edge is
//! steep. `edge` is tanh, blurred by the lens, and its mean over the pixel. Edges are bent as the board's lines are (`super::bent_edges`).
//!
//! A window in which gradients are perpendicular to the way to the corner (`super::refine`) holds a dozen pixels where a gap is three pixels
//! wide, and where they have their centres pulls the corner by 0.2 px, most on boards that are seen small and aslant. That is alike in all
//! views of a kind: focal lengths came out wrong by 0.2 %, four times what they were said to be certain of.
//!
//! Means over pixels matter: an edge that is sharper than a pixel and runs along its rows shows in one row alone, whose brightness says where
//! the edge is if the pixel's width is known. By values at the pixels' centres any steepness fits there, and undamped steps do not end.

use lsfb_geometry::Vector2;
use lsfb_solver::gauss_newton::{NormalEquations, minimise_damped};
use lsfb_types::Image;
use nalgebra::SVector;

/// Corner, the two vectors across the edges, mean and amplitude.
const UNKNOWNS: usize = 8;
type Sectors = SVector<f64, UNKNOWNS>;

/// Steps tried; four are usual.
const MAX_TRIALS: u32 = 10;
/// What is farther from the start is another corner, pixels.
const FARTHEST_PX: f64 = 1.5;
/// Share of a window's contrast that sectors may leave: of corners as boards have them a tenth is left at most.
const MOST_UNEXPLAINED: f64 = 0.25;
/// Steepness of an edge before the pixels take their means, 1/px: that of a lens which blurs by a third of a pixel.
const SHARP_PER_PX: f64 = 2.5;
/// Weight of that, as if pixels had noise of three grey levels and steepness were that give or take 0.3/px: a sharp edge that runs between
/// rows of pixels does not show how steep it is.
const SHARP_WEIGHT: f64 = 100.0;

/// A pixel of the window: where it is from the middle, its brightness and its weight.
struct Sample {
    from_middle: Vector2<f64>,
    brightness: f64,
    weight: f64,
}

/// The corner nearest to `start`, of what is seen within `radius_px`, with edges that run nearly along `edges` and are bent by `bends`, 1/px;
/// `None` where sectors do not explain what is seen.
pub(super) fn fit(
    image: &Image,
    start: &Vector2<f64>,
    edges: &[Vector2<f64>; 2],
    bends: &[Vector2<f64>; 2],
    radius_px: f64,
) -> Option<Vector2<f64>> {
    let window = window(image, start, radius_px);
    let guess = guess(&window, edges)?;
    let (found, cost) = minimise_damped(
        guess,
        MAX_TRIALS,
        |sectors| terms(&window, sectors, bends),
        |sectors| cost(&window, sectors, bends),
    );
    let from_start = found.fixed_rows::<2>(0).into_owned();
    let is_this_one = from_start.norm() < FARTHEST_PX;
    (is_this_one && cost < MOST_UNEXPLAINED * contrast(&window)).then(|| start + from_start)
}

/// The pixels of a round window that are on the image, of less and less weight towards the window's border.
fn window(image: &Image, middle: &Vector2<f64>, radius_px: f64) -> Vec<Sample> {
    let (width, height) = (i64::from(image.width), i64::from(image.height));
    let low = middle.map(|v| ((v - radius_px).ceil() as i64).max(0));
    let high = middle.map(|v| (v + radius_px).floor() as i64);
    let mut samples = Vec::new();
    for y in low.y..=high.y.min(height - 1) {
        for x in low.x..=high.x.min(width - 1) {
            let from_middle = Vector2::new(x as f64, y as f64) - middle;
            let weight = 1.0 - from_middle.norm_squared() / (radius_px * radius_px);
            if weight > 0.0 {
                samples.push(Sample {
                    from_middle,
                    brightness: f64::from(image.pixels[(y * width + x) as usize]),
                    weight,
                });
            }
        }
    }
    samples
}

/// Sharp edges along `edges`, with the mean and amplitude that fit them best; `None` where they do not determine these.
fn guess(window: &[Sample], edges: &[Vector2<f64>; 2]) -> Option<Sectors> {
    let [g, h] = edges.map(|along| Vector2::new(-along.y, along.x) * SHARP_PER_PX);
    let mut terms = NormalEquations::<2>::default();
    for sample in window {
        let product = g.dot(&sample.from_middle).tanh() * h.dot(&sample.from_middle).tanh();
        let by = Vector2::new(1.0, product);
        terms.add(-sample.brightness, &by, sample.weight);
    }
    let [mean, amplitude]: [f64; 2] = terms.step()?.into();
    Some(SVector::from([
        0.0, 0.0, g.x, g.y, h.x, h.y, mean, amplitude,
    ]))
}

/// Sum of the squares of what a window differs from its mean.
fn contrast(window: &[Sample]) -> f64 {
    let all: f64 = window.iter().map(|s| s.weight).sum();
    let mean = window.iter().map(|s| s.weight * s.brightness).sum::<f64>() / all.max(1e-9);
    let square = |s: &Sample| s.weight * (s.brightness - mean) * (s.brightness - mean);
    window.iter().map(square).sum()
}

/// A vector across an edge, as long as the edge is steep, 1/px, and the vector by which it is bent, 1/px.
struct Edge {
    across: Vector2<f64>,
    steepness: f64,
    bend: Vector2<f64>,
}

/// Mean of `tanh` over a pixel, and its derivatives by the pixel's distance from the edge and by steepness.
struct Mean {
    value: f64,
    by_distance: f64,
    by_steepness: f64,
}

impl Edge {
    fn new(across: Vector2<f64>, bend: Vector2<f64>) -> Self {
        Self {
            steepness: across.norm().max(1e-3),
            across,
            bend,
        }
    }

    /// Distance from the edge times its steepness.
    fn distance(&self, from_corner: &Vector2<f64>) -> f64 {
        let along = self.along(from_corner);
        self.across.dot(from_corner) - 0.5 * self.bend.dot(&self.across) * along * along
    }

    /// Distance along the edge, pixels.
    fn along(&self, from_corner: &Vector2<f64>) -> f64 {
        self.across.perp(from_corner) / self.steepness
    }

    /// Derivatives of the distance by what is passed and by the vector across.
    fn distance_by(&self, from_corner: &Vector2<f64>) -> [Vector2<f64>; 2] {
        let turned = Vector2::new(from_corner.y, -from_corner.x) / self.steepness;
        let forward = Vector2::new(-self.across.y, self.across.x) / self.steepness;
        let along = self.along(from_corner);
        let bent = self.bend.dot(&self.across);
        let by_across = self.bend * (0.5 * along * along) + turned * (bent * along)
            - self.across * (bent * along * along / (self.steepness * self.steepness));
        [
            self.across - forward * (bent * along),
            from_corner - by_across,
        ]
    }

    /// Over a stretch across the edge that is a pixel long: for edges along rows and columns the pixel's own mean, for others as wide a
    /// blur.
    fn mean(&self, from_corner: &Vector2<f64>) -> Mean {
        let middle = self.distance(from_corner);
        let steepness = self.steepness;
        let [upper, lower] = [0.5, -0.5].map(|half| middle + half * steepness);
        let [(high, more), (low, less)] = [upper, lower].map(tanh_and_excess);
        // The integral of tanh is ln cosh: |x| + ln(1 + exp(−2|x|)) less a constant.
        let value = (upper.abs() - lower.abs() + (more / less).ln()) / steepness;
        Mean {
            value,
            by_distance: (high - low) / steepness,
            by_steepness: (0.5 * (high + low) - value) / steepness,
        }
    }
}

/// `tanh`, and `1 + exp(−2|x|)`.
fn tanh_and_excess(x: f64) -> (f64, f64) {
    let far = (-2.0 * x.abs()).exp();
    let tanh = ((1.0 - far) / (1.0 + far)).copysign(x);
    (tanh, 1.0 + far)
}

fn edges(sectors: &Sectors, bends: &[Vector2<f64>; 2]) -> [Edge; 2] {
    [0, 1].map(|k| {
        let across = Vector2::new(sectors[2 * k + 2], sectors[2 * k + 3]);
        Edge::new(across, bends[k])
    })
}

/// Sum of the squared errors, and of what the steepnesses differ by from those of sharp edges.
fn cost(window: &[Sample], sectors: &Sectors, bends: &[Vector2<f64>; 2]) -> f64 {
    let corner = Vector2::new(sectors[0], sectors[1]);
    let [g, h] = edges(sectors, bends);
    let squares = window.iter().map(|sample| {
        let from = sample.from_middle - corner;
        let product = g.mean(&from).value * h.mean(&from).value;
        let error = sectors[6] + sectors[7] * product - sample.brightness;
        sample.weight * error * error
    });
    let squares: f64 = squares.sum();
    let steep = [g, h].map(|edge| (edge.steepness - SHARP_PER_PX).powi(2));
    squares + SHARP_WEIGHT * steep.iter().sum::<f64>()
}

fn terms(
    window: &[Sample],
    sectors: &Sectors,
    bends: &[Vector2<f64>; 2],
) -> NormalEquations<UNKNOWNS> {
    let corner = Vector2::new(sectors[0], sectors[1]);
    let [g, h] = edges(sectors, bends);
    let (mean, amplitude) = (sectors[6], sectors[7]);
    let mut terms = NormalEquations::default();
    for sample in window {
        let from = sample.from_middle - corner;
        let (s, t) = (g.mean(&from), h.mean(&from));
        let (of_s, of_t) = (amplitude * t.value, amplitude * s.value);
        let [g_by_from, g_by_across] = g.distance_by(&from);
        let [h_by_from, h_by_across] = h.distance_by(&from);
        let by_corner = -(g_by_from * (of_s * s.by_distance) + h_by_from * (of_t * t.by_distance));
        let by_edge = |edge: &Edge, mean: &Mean, by_across: Vector2<f64>, of: f64| {
            (by_across * mean.by_distance + edge.across * (mean.by_steepness / edge.steepness)) * of
        };
        let by_g = by_edge(&g, &s, g_by_across, of_s);
        let by_h = by_edge(&h, &t, h_by_across, of_t);
        let product = s.value * t.value;
        let by = [
            by_corner.x,
            by_corner.y,
            by_g.x,
            by_g.y,
            by_h.x,
            by_h.y,
            1.0,
            product,
        ];
        let error = mean + amplitude * product - sample.brightness;
        terms.add(error, &SVector::from(by), sample.weight);
    }
    for (first, edge) in [(2, &g), (4, &h)] {
        let mut by = Sectors::zeros();
        by.fixed_rows_mut::<2>(first)
            .copy_from(&(edge.across / edge.steepness));
        terms.add(edge.steepness - SHARP_PER_PX, &by, SHARP_WEIGHT);
    }
    terms
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_means_of_an_edge_over_pixels_have_the_derivatives_that_they_say() {
        let from = Vector2::new(0.31, -0.42);
        let across = Vector2::new(1.7, 1.1);
        let mean = |across: Vector2<f64>| Edge::new(across, Vector2::zeros()).mean(&from);
        let here = mean(across);
        // By Simpson's rule over the pixel's width.
        let steps = 200;
        let weighted = (0..=steps).map(|k| {
            let share = f64::from(k) / f64::from(steps) - 0.5;
            let weight = match k {
                0 => 1.0,
                _ if k == steps => 1.0,
                _ => 2.0 + 2.0 * f64::from(k % 2),
            };
            weight * (across.dot(&from) + share * across.norm()).tanh()
        });
        let integral = weighted.sum::<f64>() / f64::from(3 * steps);
        assert!((here.value - integral).abs() < 1e-9, "{}", here.value);
        let step = 1e-6;
        for k in 0..2 {
            let mut moved = across;
            moved[k] += step;
            let numeric = (mean(moved).value - here.value) / step;
            let said = from[k] * here.by_distance + across[k] / across.norm() * here.by_steepness;
            assert!((numeric - said).abs() < 1e-5, "{numeric} {said}");
        }
    }
    #[test]
    fn the_distance_from_a_bent_edge_has_the_derivatives_that_it_says() {
        let (from, across) = (Vector2::new(2.1, -3.4), Vector2::new(1.7, 1.1));
        let distance = |from: Vector2<f64>, across: Vector2<f64>| {
            Edge::new(across, Vector2::new(0.004, 0.007)).distance(&from)
        };
        let [by_from, by_across] = Edge::new(across, Vector2::new(0.004, 0.007)).distance_by(&from);
        let step = 1e-6;
        for k in 0..2 {
            let mut moved = Vector2::zeros();
            moved[k] = step;
            let numeric = [
                distance(from + moved, across) - distance(from - moved, across),
                distance(from, across + moved) - distance(from, across - moved),
            ];
            for (numeric, said) in numeric.into_iter().zip([by_from[k], by_across[k]]) {
                assert!(
                    (numeric / (2.0 * step) - said).abs() < 1e-8,
                    "{numeric} {said}"
                );
            }
        }
        // A point of the circle that touches the edge lies on it, to the third order.
        let (along, inwards) = (Vector2::new(0.8, 0.6), Vector2::new(-0.6, 0.8));
        let radius_px: f64 = 200.0;
        let angle: f64 = 4.0 / radius_px;
        let on_it = along * (radius_px * angle.sin()) + inwards * (radius_px * (1.0 - angle.cos()));
        let edge = Edge::new(inwards * 2.5, inwards / radius_px);
        assert!(edge.distance(&on_it).abs() < 1e-4);
        assert!(edge.distance(&(along * 4.0)) < -0.09);
    }
}
