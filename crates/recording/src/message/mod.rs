//! The messages of a recording: their CDR bytes, both ways, and their `ros2msg` schemas.
//!
//! Each `encode_*` gives the bytes that ROS 2 would serialise; each `decode_*` checks every length. Topics that carry
//! them are listed in `FORMAT.md`.

mod axes;
mod beacon;
mod frame;
mod image;
mod imu;
mod lidar_packets;
mod lsfb;
mod points;
mod pose;
mod radio;
mod recorder;
mod remark;
mod schema;
mod surroundings;
mod transform;

#[cfg(test)]
mod tests;

pub use axes::{decode_orientation, decode_vector, encode_orientation, encode_vector};
pub use beacon::Beacon;
pub(crate) use frame::{frame_of, in_frame_of};
pub(crate) use image::encode_image_head;
pub use image::{decode_image, encode_camera_info, encode_image};
pub use imu::{
    ImuVariance, TimeReference, decode_imu, decode_time_reference, encode_imu,
    encode_time_reference,
};
pub use lidar_packets::{
    decode_lidar_packets, decode_packets_of, encode_lidar_packets, holds_lidar_packets,
    lidar_packet_types,
};
pub use lsfb::{
    FrameMeta, RawPacket, decode_frame_meta, decode_raw_packet, encode_frame_meta,
    encode_raw_packet,
};
pub use points::{CloudMessage, decode_cloud, encode_points};
pub use pose::{
    PoseReading, decode_poses, encode_pose, encode_pose_with_covariance, holds_edges, holds_path,
    holds_poses,
};
pub use radio::{
    BleAdvert, WifiReading, WifiScan, decode_ble, decode_wifi, decode_wifi_scan, encode_ble,
    encode_wifi, encode_wifi_scan,
};
pub use recorder::{
    CameraGroup, ClockModel, HealthValue, decode_camera_group, decode_clock_model,
    decode_health_value, encode_camera_group, encode_clock_model, encode_health_value,
};
pub use remark::{Remark, decode_remark, encode_remark};
pub use schema::{
    BLE_ADVERT, CAMERA_GROUP, CAMERA_INFO, CLOCK_MODEL, FLUID_PRESSURE, FRAME_META, HEALTH_VALUE,
    IMAGE, IMU, LIDAR_PACKETS, MAGNETIC_FIELD, NAV_SAT_FIX, ORIENTATION, POINT_CLOUD, POSE,
    POSE_WITH_COVARIANCE, RAW_PACKET, REMARK, Schema, TF_MESSAGE, TIME_REFERENCE, VECTOR,
    WIFI_READING, WIFI_SCAN,
};
pub use surroundings::{
    GnssFix, GnssReading, MagneticSample, PressureSample, decode_gnss, decode_magnetic,
    decode_pressure, encode_gnss, encode_magnetic, encode_pressure,
};
pub use transform::{StaticTransform, encode_odometry, encode_static_transforms};

pub use crate::cdr::{CdrError, CdrReader, Header, Layout};
