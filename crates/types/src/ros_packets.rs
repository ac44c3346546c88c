//! Types of messages in which ROS drivers publish the data packets of a LiDAR.

/// Such a type: a header, the number of packets, and of each its stamp, an array, and perhaps how much of it is the packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RosPackets {
    /// Its name in ROS 2.
    pub name: &'static str,
    /// Length of the array, bytes.
    pub array_bytes: usize,
    /// Whether a 32-bit number behind the array says how much of it is the packet.
    pub has_size: bool,
}

impl RosPackets {
    /// All that are read, whichever file they are in.
    pub const ALL: [Self; 2] = [
        Self {
            name: "velodyne_msgs/msg/VelodyneScan",
            array_bytes: 1206,
            has_size: false,
        },
        Self {
            name: "pandar_msgs/msg/PandarScan",
            array_bytes: 1500,
            has_size: true,
        },
    ];

    /// The type of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|known| known.name == name)
    }
}
