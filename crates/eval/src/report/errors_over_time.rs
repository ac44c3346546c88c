//! Errors pose by pose, along the seconds since each trajectory's start.

use plotters::series::LineSeries;

use super::chart::{self, Axis, Frame, stroke};
use super::number::ticks;
use super::{Track, theme};
use crate::error::Error;
use crate::evaluation::PoseError;

/// Which error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Translation,
    Rotation,
}

/// A stamp and a value: a break is where the next pose comes much later than usual.
const BREAK_SECS: f64 = 1.0;

/// `None` where no trajectory has errors.
pub(super) fn draw(tracks: &[Track], part: Part) -> Result<Option<String>, Error> {
    let value = |e: &PoseError| match part {
        Part::Translation => 100.0 * e.translation_m,
        Part::Rotation => e.rotation_deg,
    };
    let series: Vec<Vec<(f64, f64)>> = tracks.iter().map(|t| places(&t.errors, value)).collect();
    let largest = |of: fn(&(f64, f64)) -> f64| series.iter().flatten().map(of).reduce(f64::max);
    let (Some(last_secs), Some(most)) = (largest(|p| p.0), largest(|p| p.1)) else {
        return Ok(None);
    };
    let (end, top) = (last_secs.max(1e-3), (1.08 * most).max(1e-6));
    let frame = Frame {
        name: match part {
            Part::Translation => "translation error over time",
            Part::Rotation => "rotation error over time",
        },
        width: 560,
        height: 260,
        x: Axis {
            label: "time since start (s)".to_owned(),
            range: 0.0..end,
            ticks: ticks(0.0, end, 7),
        },
        y: Axis {
            label: match part {
                Part::Translation => "error (cm)",
                Part::Rotation => "error (°)",
            }
            .to_owned(),
            range: 0.0..top,
            ticks: ticks(0.0, top, 5),
        },
    };
    chart::draw(frame, |chart| {
        for (i, places) in series.iter().enumerate() {
            for piece in places.chunk_by(|a, b| b.0 - a.0 <= BREAK_SECS.max(end / 50.0)) {
                let line = LineSeries::new(piece.iter().copied(), stroke(theme::track(i), 1.6));
                chart.draw_series(line).map_err(|e| e.to_string())?;
            }
        }
        Ok(())
    })
    .map(Some)
}

fn places(errors: &[PoseError], value: impl Fn(&PoseError) -> f64) -> Vec<(f64, f64)> {
    let Some(first) = errors.first() else {
        return Vec::new();
    };
    errors
        .iter()
        .map(|e| (e.time.secs_since(first.time), value(e)))
        .filter(|(_, v)| v.is_finite())
        .collect()
}
