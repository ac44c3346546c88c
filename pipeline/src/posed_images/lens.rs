//! Cameras in COLMAP's words, which kapture and nerfstudio use as well. Their pixel (0, 0) is the corner of the first pixel, not its centre.

use lsfb_geometry::Camera;
use lsfb_geometry::camera::Lens;

/// From our pixels to those of the formats here.
const HALF_PIXEL: f64 = 0.5;

/// A camera by its model and parameters; what is wrong where it is none.
pub(super) fn camera(model: &str, size: [u32; 2], values: &[f64]) -> Result<Camera, String> {
    let (focals, distorted) = match model {
        "SIMPLE_PINHOLE" => (1, 0),
        "PINHOLE" => (2, 0),
        "SIMPLE_RADIAL" | "SIMPLE_RADIAL_FISHEYE" => (1, 1),
        "RADIAL" | "RADIAL_FISHEYE" => (1, 2),
        "OPENCV" | "OPENCV_FISHEYE" => (2, 4),
        "FULL_OPENCV" => (2, 8),
        "FOV" => (2, 1),
        other => {
            return Err(format!(
                "camera model {other} is not known: undistort the images to PINHOLE"
            ));
        }
    };
    let expected = focals + 2 + distorted;
    if values.len() != expected {
        return Err(format!(
            "{} parameters for {model}, expected {expected}",
            values.len()
        ));
    }
    let (focal, rest) = values.split_at(focals);
    let (principal, d) = rest.split_at(2);
    let focal_px = [focal[0], focal[focals - 1]];
    if !(values.iter().all(|v| v.is_finite()) && focal_px.iter().all(|f| *f > 0.0)) {
        return Err("a focal length is not above zero, or a parameter is no number".to_owned());
    }
    let principal_px = [principal[0] - HALF_PIXEL, principal[1] - HALF_PIXEL];
    let at = |k: usize| d.get(k).copied().unwrap_or(0.0);
    let lens = match model {
        "OPENCV_FISHEYE" | "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE" => Lens::KannalaBrandt {
            focal_px,
            principal_px,
            distortion: [at(0), at(1), at(2), at(3)],
        },
        "FOV" => Lens::FieldOfView {
            focal_px,
            principal_px,
            distortion: [at(0)],
        },
        "FULL_OPENCV" if d[5..].iter().any(|k| *k != 0.0) => {
            return Err("distortion with k4 to k6 is not known: undistort the images".to_owned());
        }
        // k1 k2 p1 p2 k3, the latter three only of the OPENCV models.
        _ => Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion: [at(0), at(1), at(2), at(3), at(4)],
        },
    };
    let [width, height] = size;
    Ok(Camera {
        width,
        height,
        lens,
    })
}
