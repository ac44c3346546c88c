//! What the viewer shows at first: the world on the left, images and inertial samples on the right.

use re_sdk::blueprint::{
    Blueprint, ContainerLike, Grid, Horizontal, Spatial2DView, Spatial3DView, TimeSeriesView,
    Vertical,
};

use crate::ViewInputs;
use crate::walk::camera_names;

pub(crate) fn blueprint(inputs: &ViewInputs<'_>) -> Blueprint {
    let world: ContainerLike = Spatial3DView::new("world").with_origin("/world").into();
    let mut images: Vec<ContainerLike> = Vec::new();
    for walk in &inputs.walks {
        for name in camera_names(&walk.rig, walk.recording) {
            let origin = format!("/world/{}/rig/{name}", walk.name);
            images.push(
                Spatial2DView::new(format!("{} {name}", walk.name))
                    .with_origin(origin)
                    .into(),
            );
        }
    }
    let mut rows: Vec<ContainerLike> = Vec::new();
    let mut shares = Vec::new();
    if !images.is_empty() {
        rows.push(Grid::new(images).into());
        shares.push(2.0);
    }
    for walk in inputs
        .walks
        .iter()
        .filter(|walk| walk.recording.imu().is_ok())
    {
        for (unit, name) in [("gyro_rad_s", "rad/s"), ("accel_m_s2", "m/s²")] {
            let origin = format!("/imu/{}/{unit}", walk.name);
            let title = format!("{} {name}", walk.name);
            rows.push(TimeSeriesView::new(title).with_origin(origin).into());
            shares.push(1.0);
        }
    }
    if rows.is_empty() {
        return Blueprint::new(Horizontal::new([world]));
    }
    let right = Vertical::new(rows).with_row_shares(shares).into();
    Blueprint::new(Horizontal::new([world, right]).with_column_shares([2.0, 1.0]))
}
