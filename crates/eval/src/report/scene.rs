//! Map and trajectories in space.

use lsfb_geometry::Trajectory;
use lsfb_report::{Path, Scene};
use maud::{Markup, html};

use super::{Report, break_secs};

/// Nothing where there is neither map nor trajectory.
pub(super) fn in_space(report: &Report) -> Markup {
    let mut paths = Vec::new();
    for (place, track) in report.tracks.iter().enumerate() {
        let series = track.series.unwrap_or(place);
        let path = |trajectory, is_truth| Path {
            name: track.name.clone(),
            series,
            is_truth,
            pieces: pieces(trajectory),
        };
        paths.push(path(&track.estimate, false));
        paths.extend(track.truth.iter().map(|truth| path(truth, true)));
    }
    let points = report.map_points.iter().map(|p| (*p).into());
    let scene = Scene {
        points: points.collect(),
        paths,
    };
    html! {
        @if let Some(drawn) = scene.draw() {
            section { h2 { "3D view" } (drawn) }
        }
    }
}

/// Places of a trajectory, apart where nothing is known for a while.
fn pieces(trajectory: &Trajectory) -> Vec<Vec<[f64; 3]>> {
    let poses = trajectory.poses();
    let longest_secs = break_secs(poses);
    let pieces = poses.chunk_by(|a, b| b.time.secs_since(a.time) <= longest_secs);
    let place = |piece: &[lsfb_geometry::StampedPose]| {
        let places = piece.iter().map(|p| p.world_from_rig.translation.into());
        places.collect()
    };
    pieces.map(place).collect()
}
