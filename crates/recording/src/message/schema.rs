/// A message type: its ROS 2 name and its `ros2msg` text, self-contained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schema {
    /// `package/msg/Type`.
    pub name: &'static str,
    /// The definition, followed by those it depends on.
    pub text: &'static str,
}

macro_rules! dependency {
    ($name:literal, $text:expr) => {
        concat!(
            "================================================================================\nMSG: ",
            $name,
            "\n",
            $text
        )
    };
}

macro_rules! header {
    () => {
        concat!(
            dependency!(
                "std_msgs/Header",
                "builtin_interfaces/Time stamp\nstring frame_id\n"
            ),
            time!()
        )
    };
}

macro_rules! time {
    () => {
        dependency!("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n")
    };
}

macro_rules! vector3_and_quaternion {
    () => {
        concat!(
            dependency!("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
            dependency!(
                "geometry_msgs/Quaternion",
                "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
            )
        )
    };
}

/// Camera images.
pub const IMAGE: Schema = Schema {
    name: "sensor_msgs/msg/Image",
    text: concat!(
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n",
        "uint8[] data\n",
        header!()
    ),
};

/// Inertial samples.
pub const IMU: Schema = Schema {
    name: "sensor_msgs/msg/Imu",
    text: concat!(
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n",
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n",
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
        header!(),
        vector3_and_quaternion!()
    ),
};

/// Device counters.
pub const TIME_REFERENCE: Schema = Schema {
    name: "sensor_msgs/msg/TimeReference",
    text: concat!(
        "std_msgs/Header header\nbuiltin_interfaces/Time time_ref\nstring source\n",
        header!()
    ),
};

/// LiDAR scans.
pub const POINT_CLOUD: Schema = Schema {
    name: "sensor_msgs/msg/PointCloud2",
    text: concat!(
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n",
        "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
        dependency!(
            "sensor_msgs/PointField",
            "string name\nuint32 offset\nuint8 datatype\nuint32 count\n"
        ),
        header!()
    ),
};

/// Camera intrinsics.
pub const CAMERA_INFO: Schema = Schema {
    name: "sensor_msgs/msg/CameraInfo",
    text: concat!(
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n",
        "float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n",
        dependency!(
            "sensor_msgs/RegionOfInterest",
            "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n"
        ),
        header!()
    ),
};

/// Frames of the rig.
pub const TF_MESSAGE: Schema = Schema {
    name: "tf2_msgs/msg/TFMessage",
    text: concat!(
        "geometry_msgs/TransformStamped[] transforms\n",
        dependency!(
            "geometry_msgs/TransformStamped",
            "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
        ),
        dependency!(
            "geometry_msgs/Transform",
            "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
        ),
        header!(),
        vector3_and_quaternion!()
    ),
};

/// LiDAR data packets as received, whatever the sensor: those of one revolution.
pub const LIDAR_PACKETS: Schema = Schema {
    name: "lsfb_msgs/msg/LidarPackets",
    text: concat!(
        include_str!("../../lsfb_msgs/msg/LidarPackets.msg"),
        dependency!(
            "lsfb_msgs/LidarPacket",
            include_str!("../../lsfb_msgs/msg/LidarPacket.msg")
        ),
        header!()
    ),
};

/// Bytes as a device sent them.
pub const RAW_PACKET: Schema = Schema {
    name: "lsfb_msgs/msg/RawPacket",
    text: concat!(include_str!("../../lsfb_msgs/msg/RawPacket.msg"), header!()),
};

/// What the operator says.
pub const REMARK: Schema = Schema {
    name: "lsfb_msgs/msg/Remark",
    text: concat!(include_str!("../../lsfb_msgs/msg/Remark.msg"), header!()),
};

/// What a camera says about a frame.
pub const FRAME_META: Schema = Schema {
    name: "lsfb_msgs/msg/FrameMeta",
    text: concat!(include_str!("../../lsfb_msgs/msg/FrameMeta.msg"), header!()),
};

/// How a device's counter is read.
pub const CLOCK_MODEL: Schema = Schema {
    name: "lsfb_msgs/msg/ClockModel",
    text: concat!(
        include_str!("../../lsfb_msgs/msg/ClockModel.msg"),
        header!()
    ),
};

/// Which images of one trigger there are.
pub const CAMERA_GROUP: Schema = Schema {
    name: "lsfb_msgs/msg/CameraGroup",
    text: concat!(
        include_str!("../../lsfb_msgs/msg/CameraGroup.msg"),
        header!()
    ),
};

/// One quantity of one device at one moment.
pub const HEALTH_VALUE: Schema = Schema {
    name: "lsfb_msgs/msg/HealthValue",
    text: concat!(
        include_str!("../../lsfb_msgs/msg/HealthValue.msg"),
        header!()
    ),
};

/// The magnetic field, raw.
pub const MAGNETIC_FIELD: Schema = Schema {
    name: "sensor_msgs/msg/MagneticField",
    text: concat!(
        "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance\n",
        dependency!("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
        header!()
    ),
};

/// The pressure of the air.
pub const FLUID_PRESSURE: Schema = Schema {
    name: "sensor_msgs/msg/FluidPressure",
    text: concat!(
        "std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance\n",
        header!()
    ),
};

/// Positions by satellites.
pub const NAV_SAT_FIX: Schema = Schema {
    name: "sensor_msgs/msg/NavSatFix",
    text: concat!(
        "uint8 COVARIANCE_TYPE_UNKNOWN=0\nuint8 COVARIANCE_TYPE_APPROXIMATED=1\n",
        "uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2\nuint8 COVARIANCE_TYPE_KNOWN=3\n",
        "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\n",
        "float64 altitude\nfloat64[9] position_covariance\nuint8 position_covariance_type\n",
        dependency!(
            "sensor_msgs/NavSatStatus",
            "int8 STATUS_NO_FIX=-1\nint8 STATUS_FIX=0\nint8 STATUS_SBAS_FIX=1\nint8 STATUS_GBAS_FIX=2\n\
             uint16 SERVICE_GPS=1\nuint16 SERVICE_GLONASS=2\nuint16 SERVICE_COMPASS=4\nuint16 SERVICE_GALILEO=8\n\
             int8 status\nuint16 service\n"
        ),
        header!()
    ),
};

/// One network in a Wi-Fi scan.
pub const WIFI_READING: Schema = Schema {
    name: "lsfb_msgs/msg/WifiReading",
    text: concat!(
        include_str!("../../lsfb_msgs/msg/WifiReading.msg"),
        header!()
    ),
};

/// One advertisement of a Bluetooth beacon.
pub const BLE_ADVERT: Schema = Schema {
    name: "lsfb_msgs/msg/BleAdvert",
    text: concat!(include_str!("../../lsfb_msgs/msg/BleAdvert.msg"), header!()),
};

/// One Wi-Fi scan, whose readings are on a topic of their own.
pub const WIFI_SCAN: Schema = Schema {
    name: "lsfb_msgs/msg/WifiScan",
    text: concat!(include_str!("../../lsfb_msgs/msg/WifiScan.msg"), header!()),
};

/// Three numbers in the axes of a sensor.
pub const VECTOR: Schema = Schema {
    name: "geometry_msgs/msg/Vector3Stamped",
    text: concat!(
        "std_msgs/Header header\ngeometry_msgs/Vector3 vector\n",
        dependency!("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
        header!()
    ),
};

/// How a device is turned, by its own reckoning.
pub const ORIENTATION: Schema = Schema {
    name: "geometry_msgs/msg/QuaternionStamped",
    text: concat!(
        "std_msgs/Header header\ngeometry_msgs/Quaternion quaternion\n",
        dependency!(
            "geometry_msgs/Quaternion",
            "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
        ),
        header!()
    ),
};

/// What a pose is made of.
macro_rules! pose {
    () => {
        concat!(
            dependency!(
                "geometry_msgs/Pose",
                "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
            ),
            dependency!("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
            dependency!(
                "geometry_msgs/Quaternion",
                "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
            ),
            header!()
        )
    };
}

/// Where a device has itself.
pub const POSE: Schema = Schema {
    name: "geometry_msgs/msg/PoseStamped",
    text: concat!("std_msgs/Header header\ngeometry_msgs/Pose pose\n", pose!()),
};

/// The same, and how sure that is.
pub const POSE_WITH_COVARIANCE: Schema = Schema {
    name: "geometry_msgs/msg/PoseWithCovarianceStamped",
    text: concat!(
        "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n",
        dependency!(
            "geometry_msgs/PoseWithCovariance",
            "geometry_msgs/Pose pose\nfloat64[36] covariance\n"
        ),
        pose!()
    ),
};
