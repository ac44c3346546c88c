//! The line below a cloud of arrivals, and how well it is known.
//!
//! Arrivals above the clock's line are taken for a Poisson process: near the line, `density` of them per unit of time and
//! delay. Then the probability of a line below all of them is proportional to `exp(density · span · height)`, where the
//! height is that of the line over the middle of the span: the highest such line is the hull segment over the middle (Zhang,
//! Liu, Xia, INFOCOM 2002), and around it lies a distribution that gives a mean and an honest standard deviation.

/// Skew of a quartz beyond this is a wrong fit.
pub(super) const LARGEST_SKEW: f64 = 200e-6;
/// Steps of the integration over the height.
const HEIGHTS: u32 = 160;
/// Heights that matter, in units of the distribution's width.
const DEPTH: f64 = 14.0;
/// The density at the line is that of this many nearest arrivals …
const NEAR: usize = 30;
/// … followed down from that of this many, where delays thin out towards the shortest …
const WIDER: usize = 120;
/// … to the few that carry the line.
const CARRYING: f64 = 3.0;
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
    let density = density(arrivals, &highest, span);
    // p(x) ∝ exp(−density · span · x) · (width of the slopes that fit), x below the highest line.
    let scale = 1.0 / (density * span);
    let (mut total, mut height, mut height2) = (0.0, 0.0, 0.0);
    let (mut slope, mut slope2, mut both) = (0.0, 0.0, 0.0);
    for step in 0..=HEIGHTS {
        let below = DEPTH * scale * f64::from(step) / f64::from(HEIGHTS);
        let y = highest.offset_secs - below;
        let Some(slopes) = slopes(hull, middle, y) else {
            continue;
        };
        let width = slopes.high - slopes.low;
        let weight = (-below / scale).exp() * width.max(f64::MIN_POSITIVE);
        let mean = (slopes.high + slopes.low) / 2.0;
        total += weight;
        height -= weight * below;
        height2 += weight * below * below;
        slope += weight * mean;
        slope2 += weight * (mean * mean + width * width / 12.0);
        both -= weight * below * mean;
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

/// Arrivals per second of time and second of delay, just above the line.
fn density(arrivals: &[Arrival], line: &Line, span: f64) -> f64 {
    let mut above: Vec<f64> = arrivals
        .iter()
        .map(|p| (p.offset_secs - line.at(p.secs)).max(0.0))
        .collect();
    let mut height_of = |count: usize| -> f64 {
        let at = count.min(above.len()).saturating_sub(1);
        if above.is_empty() {
            return 1.0;
        }
        let (_, height, _) = above.select_nth_unstable_by(at, f64::total_cmp);
        height.max(1e-9)
    };
    let (near, wider) = (height_of(NEAR), height_of(WIDER));
    let near_count = arrivals.len().min(NEAR) as f64;
    // Two of them are on the line because it was laid through them.
    let density = (near_count - 2.0).max(1.0) / (span * near);
    if arrivals.len() < WIDER || wider <= near {
        return density;
    }
    // Their number grows like height^power: 1 where delays are spread evenly from the shortest on.
    let power = ((WIDER as f64 / NEAR as f64).ln() / (wider / near).ln()).clamp(1.0, 4.0);
    density * (CARRYING / NEAR as f64).powf(1.0 - 1.0 / power)
}
