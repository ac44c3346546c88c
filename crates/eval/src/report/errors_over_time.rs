//! Errors pose by pose, along the seconds since each trajectory's start.

use plotters::series::LineSeries;

use super::chart::{self, Axis, Frame, break_secs, stroke};
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

/// Unit of translation errors: centimetres, unless they exceed a few metres.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Length {
    Centimetres,
    Metres,
}

impl Length {
    /// For all trajectories of a page.
    pub(super) fn of(tracks: &[Track]) -> Self {
        let far = |e: &PoseError| e.translation_m > 2.0;
        if tracks.iter().flat_map(|t| &t.errors).any(far) {
            Self::Metres
        } else {
            Self::Centimetres
        }
    }

    pub(super) fn of_metres(self, metres: f64) -> f64 {
        match self {
            Self::Centimetres => 100.0 * metres,
            Self::Metres => metres,
        }
    }

    pub(super) fn unit(self) -> &'static str {
        match self {
            Self::Centimetres => "cm",
            Self::Metres => "m",
        }
    }
}

/// `None` where no trajectory has errors.
pub(super) fn draw(tracks: &[Track], part: Part) -> Result<Option<String>, Error> {
    let length = Length::of(tracks);
    let value = |e: &PoseError| match part {
        Part::Translation => length.of_metres(e.translation_m),
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
                Part::Translation => format!("error ({})", length.unit()),
                Part::Rotation => "error (°)".to_owned(),
            },
            range: 0.0..top,
            ticks: ticks(0.0, top, 5),
        },
    };
    chart::draw(frame, |chart| {
        for (i, places) in series.iter().enumerate() {
            for piece in places.chunk_by(|a, b| b.0 - a.0 <= break_secs(end)) {
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
