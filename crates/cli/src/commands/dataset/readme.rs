//! What lies beside the recordings of a dataset for people to read.

/// The licence of a dataset where none is given.
pub const LICENSE: &str = "This dataset is licensed under the Creative Commons Attribution 4.0 International License (SPDX: CC-BY-4.0),
https://creativecommons.org/licenses/by/4.0/legalcode
";

/// How to use a dataset.
pub const README: &str = "A dataset of scans and walks, made by `lsfb dataset make`.

dataset.toml               environments and sequences
calibration/DEVICE.toml    rigs; each recording holds its own as well
map/ENVIRONMENT/scan.mcap  scans, for maps
query/SEQUENCE/walk.mcap   walks, to be localized in the maps, or to be run by SLAM systems
truth/                     true trajectories; absent where they are held back
SHA256SUMS                 hashes; `lsfb dataset check` or `sha256sum --check SHA256SUMS`

Recordings are ROS 2 MCAP files. `lsfb dataset export` writes them as EuRoC, TUM-VI, KITTI, kapture or COLMAP folders.
Addresses and names of access points and beacons are keyed hashes; equal ones are equal in all walks. Images are as they were taken.
Places, walks and sensors are simulated: whoever knows the seed can make the true trajectories again.
";
