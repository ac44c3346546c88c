//! Errors pose by pose, along the seconds since each trajectory's start.

use lsfb_report::{Axis, Ink, Layer, Plot};
use maud::Markup;

use super::{Track, longest_joined_secs};
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
pub(super) fn draw(tracks: &[Track], part: Part) -> Option<Markup> {
    let length = Length::of(tracks);
    let value = |e: &PoseError| match part {
        Part::Translation => Some(length.of_metres(e.translation_m)),
        Part::Rotation => e.rotation_deg,
    };
    let series: Vec<Vec<[f64; 2]>> = tracks.iter().map(|t| places(&t.errors, value)).collect();
    let largest = |axis: usize| series.iter().flatten().map(|p| p[axis]).reduce(f64::max);
    let (last_secs, most) = (largest(0)?, largest(1)?);
    let (end, top) = (last_secs.max(1e-3), (1.08 * most).max(1e-6));
    let joined_secs = longest_joined_secs(end);
    let lines = series.iter().enumerate().flat_map(|(i, places)| {
        let pieces = places.chunk_by(|a, b| b[0] - a[0] <= joined_secs);
        pieces.map(move |piece| Layer::line(piece.to_vec(), Ink::Series(i)))
    });
    let plot = Plot {
        name: match part {
            Part::Translation => "translation error over time".to_owned(),
            Part::Rotation => "rotation error over time".to_owned(),
        },
        width_px: 560,
        height_px: 260,
        x: Axis::linear("time since start (s)", [0.0, end]),
        y: Axis::linear(
            match part {
                Part::Translation => format!("error ({})", length.unit()),
                Part::Rotation => "error (°)".to_owned(),
            },
            [0.0, top],
        ),
        layers: lines.collect(),
    };
    Some(plot.draw())
}

fn places(errors: &[PoseError], value: impl Fn(&PoseError) -> Option<f64>) -> Vec<[f64; 2]> {
    let Some(first) = errors.first() else {
        return Vec::new();
    };
    errors
        .iter()
        .filter_map(|e| Some([e.time.secs_since(first.time), value(e)?]))
        .filter(|[_, v]| v.is_finite())
        .collect()
}
