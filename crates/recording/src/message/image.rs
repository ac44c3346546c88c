use lsfb_geometry::Camera;
use lsfb_geometry::camera::Lens;
use lsfb_types::{Image, Timestamp};

use crate::cdr::{CdrError, CdrReader, CdrWriter};

/// `sensor_msgs/msg/Image`, `mono8`. Exposure and frame counter travel in the frame meta.
pub fn encode_image(time: Timestamp, frame: &str, image: &Image) -> Vec<u8> {
    let mut bytes = encode_image_head(time, frame, image);
    bytes.extend_from_slice(&image.pixels);
    bytes
}

/// [`encode_image`] up to the pixels, which are the last of it.
pub(crate) fn encode_image_head(time: Timestamp, frame: &str, image: &Image) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(frame.len() + 64);
    w.header(time, frame);
    w.u32(image.height);
    w.u32(image.width);
    w.string("mono8");
    w.u8(0);
    w.u32(image.width);
    w.u32(image.pixels.len() as u32);
    w.finish()
}

/// The grey image of a `sensor_msgs/msg/Image` in `mono8`, `8UC1` or `yuv422_yuy2` (its luma).
pub fn decode_image(bytes: &[u8]) -> Result<Image, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    let height = r.u32("height")?;
    let width = r.u32("width")?;
    let bytes_per_pixel = match r.string("encoding")? {
        "mono8" | "8UC1" => 1,
        "yuv422_yuy2" => 2,
        _ => return Err(CdrError::Value { field: "encoding" }),
    };
    r.u8("is_bigendian")?;
    let step = r.u32("step")? as usize;
    let data = r.byte_sequence("data")?;
    let row_bytes = (width as usize).checked_mul(bytes_per_pixel);
    if row_bytes.is_none_or(|row| row > step) {
        return Err(CdrError::Value { field: "step" });
    }
    if step.checked_mul(height as usize) != Some(data.len()) {
        return Err(CdrError::Value { field: "data" });
    }
    let pixels = if bytes_per_pixel == 1 && step == width as usize {
        data.to_vec()
    } else {
        data.chunks_exact(step.max(1))
            .flat_map(|row| row.iter().step_by(bytes_per_pixel).take(width as usize))
            .copied()
            .collect()
    };
    Ok(Image {
        width,
        height,
        pixels,
        exposure_ns: 0,
        frame_id: 0,
    })
}

/// `sensor_msgs/msg/CameraInfo`: `plumb_bob`, `equidistant` or the name in a rig file, no rectification.
pub fn encode_camera_info(time: Timestamp, frame: &str, camera: &Camera) -> Vec<u8> {
    let [fx, fy] = camera.focal_px();
    let [cx, cy] = camera.principal_px();
    let mut w = CdrWriter::with_capacity(512);
    w.header(time, frame);
    w.u32(camera.height);
    w.u32(camera.width);
    match &camera.lens {
        Lens::PinholeRadtan { distortion, .. } => {
            w.string("plumb_bob");
            w.u32(5);
            w.f64s(distortion);
        }
        Lens::KannalaBrandt { distortion, .. } => {
            w.string("equidistant");
            w.u32(4);
            w.f64s(distortion);
        }
        // No name in ROS: the rig's own, which a reader either knows or refuses.
        lens => {
            let distortion = lens.distortion();
            w.string(lens.model().name());
            w.u32(distortion.len() as u32);
            w.f64s(distortion);
        }
    }
    w.f64s(&[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    w.f64s(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    w.f64s(&[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    // No binning, no region of interest.
    (0..6).for_each(|_| w.u32(0));
    w.u8(0);
    w.finish()
}
