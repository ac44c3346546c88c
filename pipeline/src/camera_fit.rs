//! Whether intrinsics can belong to images of a size.

use lsfb_geometry::Camera;

/// A principal point lies this near the centre, as a share of the side. Lenses are decentred by some per cent; the intrinsics of
/// images twice as large, the commonest mistake, miss the centre by half of the side, those of images a half larger by a quarter.
const MAX_OFFSET: f64 = 0.15;

/// Whether the principal point is where a lens can have it.
pub(crate) fn principal_point_fits(camera: &Camera) -> bool {
    let sides = [camera.width, camera.height].map(f64::from);
    let offsets = camera.principal_px().into_iter().zip(sides);
    offsets
        .map(|(principal, side)| (principal + 0.5) / side - 0.5)
        .all(|offset| offset.abs() <= MAX_OFFSET)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intrinsics_of_images_of_another_size_do_not_fit() {
        // A real lens: 10 px off the middle of 360.
        let camera = |width, height| Camera::pinhole(width, height, [495.6, 495.5], [269.5, 169.2]);
        assert!(principal_point_fits(&camera(540, 360)));
        for (width, height) in [
            (270, 180),
            (1080, 720),
            (360, 240),
            (810, 540),
            (360, 540),
            (0, 0),
        ] {
            assert!(
                !principal_point_fits(&camera(width, height)),
                "{width} × {height}"
            );
        }
    }
}
