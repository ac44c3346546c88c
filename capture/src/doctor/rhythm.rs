//! How steadily messages came.

use lsfb_types::Timestamp;

/// Intervals from which a median says what a period is.
const ENOUGH: usize = 5;
/// Share of the intervals of a regular stream that are whole multiples of its period: what is lost leaves a multiple.
const REGULAR_SHARE: f64 = 0.8;

/// How steadily messages came.
pub(super) struct Rhythm<'a> {
    times: &'a [Timestamp],
    /// Mean of the intervals, seconds.
    pub period_secs: f64,
    /// Median of the intervals, which single silences do not move, seconds.
    pub median_secs: f64,
    /// Whether most intervals are multiples of the median: only then is that the sensor's own period.
    pub is_regular: bool,
    pub longest_secs: f64,
    /// When the longest silence began.
    pub longest_at: Timestamp,
}

impl<'a> Rhythm<'a> {
    /// Between the first and the last message of any sensor: one that stopped early is silent until the end.
    pub(super) fn of(times: &'a [Timestamp], start: Timestamp, end: Timestamp) -> Self {
        let span = times
            .last()
            .zip(times.first())
            .map_or(0.0, |(last, first)| last.secs_since(*first));
        let period_secs = if times.len() > 1 && span > 0.0 {
            span / (times.len() - 1) as f64
        } else {
            end.secs_since(start).max(1e-3)
        };
        let mut longest_secs = 0.0;
        let mut longest_at = start;
        let mut last = start;
        for time in times.iter().chain([&end]) {
            let silence = time.secs_since(last);
            if silence > longest_secs {
                (longest_secs, longest_at) = (silence, last);
            }
            last = *time;
        }
        let mut rhythm = Self {
            times,
            period_secs,
            median_secs: period_secs,
            is_regular: false,
            longest_secs,
            longest_at,
        };
        let mut intervals: Vec<f64> = rhythm.intervals().collect();
        if intervals.len() >= ENOUGH {
            intervals.sort_by(f64::total_cmp);
            rhythm.median_secs = intervals[intervals.len() / 2];
            let periods = intervals.iter().map(|i| i / rhythm.median_secs);
            let whole = periods.filter(|p| p.round() >= 1.0 && (p - p.round()).abs() < 0.1);
            rhythm.is_regular = whole.count() as f64 >= REGULAR_SHARE * intervals.len() as f64;
        }
        rhythm
    }

    fn intervals(&self) -> impl Iterator<Item = f64> {
        let pairs = self.times.iter().zip(self.times.iter().skip(1));
        pairs.map(|(a, b)| b.secs_since(*a))
    }

    /// Silences of so many periods.
    pub(super) fn silences(&self, periods: f64) -> usize {
        let limit = periods * self.period_secs;
        self.intervals().filter(|i| *i >= limit).count()
    }
}
