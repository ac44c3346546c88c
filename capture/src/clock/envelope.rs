//! The line below a cloud of arrivals, and how well it is known.
//!
//! Arrivals above the clock's line are taken for a Poisson process whose density grows with some power of the height above
//! it. Where the power is zero (delays spread evenly from the shortest on) the probability of a line below all arrivals is
//! proportional to `exp(density · span · height)`, the height being that of the line over the middle of the span: the most
//! probable line is the hull segment over the middle (Zhang, Liu, Xia, INFOCOM 2002). What lies below it makes a
//! distribution with a mean and an honest standard deviation; the power is found from the arrivals nearest to the line.

/// Skew of a quartz beyond this is a wrong fit.
pub(super) const LARGEST_SKEW: f64 = 200e-6;
/// Steps of the integration over the height.
const HEIGHTS: u32 = 160;
/// Heights that matter, in units of the mean distance of two arrivals seen from the side …
const DEPTH: f64 = 14.0;
/// … or as a share of the layer that is looked at.
const DEPTH_SHARE: f64 = 0.6;
/// Arrivals in the layer above the line by which the spread of the shortest delays is judged.
const LAYER: usize = 150;
/// Their number grows like height^power: 1 where delays are spread evenly from the shortest on, 2 behind two queues. Which
/// it is the arrivals tell; what they leave open widens the distribution.
const POWERS: [f64; 4] = [1.0, 1.5, 2.0, 3.0];
/// How likely each is beforehand.
const PRIOR: [f64; 4] = [0.85, 0.05, 0.05, 0.05];
/// Nothing is known better than stamps and counters tell it.
const FLOOR_SECS: f64 = 0.5e-6;

/// An arrival: device time after some origin, and host less device time after some offset. Seconds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrival {
    pub secs: f64,
    pub offset_secs: f64,
}

/// The line and its uncertainty, at the time where offset and skew are independent of each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub secs: f64,
    pub offset_secs: f64,
    pub skew: f64,
    pub sigma_secs: f64,
    pub sigma_skew: f64,
}

impl Line {
    pub fn at(&self, secs: f64) -> f64 {
        self.offset_secs + self.skew * (secs - self.secs)
    }
}

/// Fits the line below `arrivals`. `hull` is their lower convex hull. `None` where no line of a believable skew fits.
pub(super) fn fit(hull: &[Arrival], arrivals: &[Arrival]) -> Option<Line> {
    let (first, last) = (hull.first()?, hull.last()?);
    let span = last.secs - first.secs;
    if !(span > 0.0) {
        return None;
    }
    let middle = first.secs + span / 2.0;
    let highest = highest_line(hull, middle)?;
    let layer = Layer::above(arrivals, &highest);
    let spacing = layer.height / layer.heights.len().max(1) as f64;
    let depth = (DEPTH * spacing).max(DEPTH_SHARE * layer.height);
    let (mut total, mut height, mut height2) = (0.0, 0.0, 0.0);
    let (mut slope, mut slope2, mut both) = (0.0, 0.0, 0.0);
    // Finer near the highest line, where most of the probability is: `below` grows like step².
    let share_of = |step: u32| f64::from(step) / f64::from(HEIGHTS);
    let below_of = |step: u32| depth * share_of(step).powi(2);
    let likelihoods: Vec<[f64; 4]> = (0..=HEIGHTS)
        .map(|step| layer.log_likelihoods(below_of(step)))
        .collect();
    let best = likelihoods
        .iter()
        .flatten()
        .copied()
        .fold(f64::MIN, f64::max);
    for (step, likelihoods) in (0..=HEIGHTS).zip(&likelihoods) {
        let below = below_of(step);
        let Some(slopes) = slopes(hull, middle, highest.offset_secs - below) else {
            continue;
        };
        let width = slopes.high - slopes.low;
        let mean = (slopes.high + slopes.low) / 2.0;
        for ((log, power), prior) in likelihoods.iter().zip(POWERS).zip(PRIOR) {
            let weight = prior
                * (log - best).exp()
                * width.max(f64::MIN_POSITIVE)
                * share_of(step).max(1e-6);
            total += weight;
            height -= weight * below;
            height2 += weight * below * below;
            slope += weight * mean;
            // Evenly spread over the slopes that fit; where few arrivals are near the line, the extremes are less likely.
            slope2 += weight * (mean * mean + (width / power).powi(2) / 12.0);
            both -= weight * below * mean;
        }
    }
    if !(total > 0.0) {
        return None;
    }
    let (height, slope) = (height / total, slope / total);
    let height_variance = (height2 / total - height * height).max(0.0);
    let slope_variance = (slope2 / total - slope * slope).max(0.0);
    let covariance = both / total - height * slope;
    let (shift, explained) = if slope_variance > 0.0 {
        (
            -covariance / slope_variance,
            covariance * covariance / slope_variance,
        )
    } else {
        (0.0, 0.0)
    };
    let line = Line {
        secs: middle + shift,
        offset_secs: highest.offset_secs + height + slope * shift,
        skew: slope,
        sigma_secs: (height_variance - explained)
            .max(0.0)
            .sqrt()
            .max(FLOOR_SECS),
        sigma_skew: slope_variance.sqrt().max(FLOOR_SECS / span),
    };
    line.offset_secs.is_finite().then_some(line)
}

/// The line through the hull over the middle, or the nearest of a believable skew below it.
fn highest_line(hull: &[Arrival], middle: f64) -> Option<Line> {
    let end = hull.partition_point(|p| p.secs <= middle);
    let (from, to) = (
        hull.get(end.saturating_sub(1))?,
        hull.get(end.min(hull.len() - 1))?,
    );
    let run = to.secs - from.secs;
    let skew = if run > 0.0 {
        ((to.offset_secs - from.offset_secs) / run).clamp(-LARGEST_SKEW, LARGEST_SKEW)
    } else {
        0.0
    };
    // Where the skew was limited the line has to go down until it is below all arrivals.
    let offset_secs = hull
        .iter()
        .map(|p| p.offset_secs - skew * (p.secs - middle))
        .fold(f64::INFINITY, f64::min);
    offset_secs.is_finite().then_some(Line {
        secs: middle,
        offset_secs,
        skew,
        sigma_secs: 0.0,
        sigma_skew: 0.0,
    })
}

struct Slopes {
    low: f64,
    high: f64,
}

/// Slopes with which a line through `y` over the middle stays below the hull.
fn slopes(hull: &[Arrival], middle: f64, y: f64) -> Option<Slopes> {
    let mut slopes = Slopes {
        low: -LARGEST_SKEW,
        high: LARGEST_SKEW,
    };
    for point in hull {
        let run = point.secs - middle;
        let slope = (point.offset_secs - y) / run;
        if run > 0.0 {
            slopes.high = slopes.high.min(slope);
        } else if run < 0.0 {
            slopes.low = slopes.low.max(slope);
        }
    }
    // Equal but for rounding: the highest line itself.
    (slopes.high > slopes.low - 1e-12).then(|| Slopes {
        low: slopes.low.min(slopes.high),
        high: slopes.high,
    })
}

/// The arrivals nearest to a line.
struct Layer {
    /// Distances from the line, without those of the two that carry it, seconds.
    heights: Vec<f64>,
    /// The largest of them.
    height: f64,
}

impl Layer {
    fn above(arrivals: &[Arrival], line: &Line) -> Self {
        let mut heights: Vec<f64> = arrivals
            .iter()
            .map(|p| (p.offset_secs - line.at(p.secs)).max(1e-9))
            .collect();
        let last = (LAYER + 2).min(heights.len()).saturating_sub(1);
        if !heights.is_empty() {
            heights.select_nth_unstable_by(last, f64::total_cmp);
            heights.truncate(last + 1);
            heights.sort_by(f64::total_cmp);
        }
        let carrying = 2.min(heights.len().saturating_sub(1));
        heights.drain(..carrying);
        let height = heights.last().copied().unwrap_or(1e-9);
        Self { heights, height }
    }

    /// How well the distances fit a line that lies lower by `below`, for each power.
    fn log_likelihoods(&self, below: f64) -> [f64; 4] {
        let top = self.height + below;
        let count = self.heights.len() as f64;
        let logs: f64 = self.heights.iter().map(|h| (top / (h + below)).ln()).sum();
        POWERS.map(|power| count * (power.ln() - top.ln()) - (power - 1.0) * logs)
    }
}
