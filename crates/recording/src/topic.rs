//! Names of topics, in one place for writer and reader.

/// Frames of the rig.
pub(crate) const TF_STATIC: &str = "/tf_static";
/// Where the rig is, by the odometry that ran while it was recorded: its frame in [`ODOM_FRAME`], at the stamps of the clouds.
pub const TF: &str = "/tf";
/// Frame in which the live odometry gives the rig's pose: it drifts, and begins anew with each recording.
pub const ODOM_FRAME: &str = "odom";
/// Ties the rig to the frame that Rerun looks from, on a topic of its own: ROS would take it for a second parent.
pub(crate) const RERUN_TF_STATIC: &str = "/rerun/tf_static";
/// Rerun's own name for the root of its entities.
pub(crate) const RERUN_ROOT_FRAME: &str = "tf#/";
/// Frame of the rig.
pub(crate) const RIG_FRAME: &str = "rig";

/// Source of the main LiDAR's position packets, which have a topic of their own.
pub const LIDAR_POSITION: &str = "lidar/position";

/// Source of the position packets of the LiDAR named `lidar`.
pub fn lidar_position(lidar: &str) -> String {
    format!("{lidar}/position")
}

/// Data packets of the LiDAR named `lidar`.
pub(crate) fn lidar_packets(lidar: &str) -> String {
    format!("/{lidar}/packets")
}

/// Its scans.
pub(crate) fn lidar_points(lidar: &str) -> String {
    format!("/{lidar}/points")
}

/// Its own clock at each scan.
pub(crate) fn lidar_time_ref(lidar: &str) -> String {
    format!("/{lidar}/time_ref")
}

/// What the operator says while recording.
pub const REMARKS: &str = "/operator/remarks";
/// What the recorder says about the devices and the disk: one topic per quantity behind this.
pub const HEALTH: &str = "/health/";
/// Which images of each trigger there are.
pub const CAMERA_GROUPS: &str = "/sync/groups";
/// Behind the topic of a sidecar whose clock is not UTC: its own stamp of each message, nanoseconds.
pub const DEVICE_TIME: &str = "/device_time";
/// How each device's clock is read: one topic per device behind this.
pub const CLOCK_MODELS: &str = "/sync/clock/";

pub(crate) fn image(camera: &str) -> String {
    format!("/{camera}/image")
}

pub(crate) fn frame_meta(image_topic: &str) -> String {
    companion(image_topic, "/image", "frame_meta")
}

pub(crate) fn camera_info(image_topic: &str) -> String {
    companion(image_topic, "/image", "camera_info")
}

/// The camera's name in an image topic: its last but one segment.
pub(crate) fn camera_of(image_topic: &str) -> Option<&str> {
    image_topic
        .strip_suffix("/image")?
        .rsplit('/')
        .next()
        .filter(|name| !name.is_empty())
}

/// The device of a sidecar's topic: `glasses` of `/sidecar/glasses/imu`.
pub(crate) fn sidecar_of(topic: &str) -> Option<&str> {
    let (device, _) = topic.strip_prefix("/sidecar/")?.split_once('/')?;
    Some(device)
}

pub(crate) fn imu(imu: &str) -> String {
    format!("/{imu}/data_raw")
}

/// Topic of an IMU's counter: `/imu0/time_ref` for `/imu0/data_raw`, `/sidecar/x/time_ref` for `/sidecar/x/imu`.
pub(crate) fn imu_time_ref(imu_topic: &str) -> String {
    match imu_topic.rsplit_once('/') {
        Some((prefix, _)) => format!("{prefix}/time_ref"),
        None => format!("{imu_topic}/time_ref"),
    }
}

/// Raw bytes: `/raw/<source>`, but `/<lidar>/position` for position packets.
pub(crate) fn raw(source: &str) -> String {
    if source.ends_with("/position") {
        format!("/{source}")
    } else {
        format!("/raw/{source}")
    }
}

fn companion(topic: &str, suffix: &str, name: &str) -> String {
    format!("{}/{name}", topic.strip_suffix(suffix).unwrap_or(topic))
}
