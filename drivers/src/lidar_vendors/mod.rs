//! The LiDARs, by vendor: a folder, its `mod` and a line in the list. `any_lidar` makes one decoder of them.

pub mod hesai;
pub mod velodyne;

/// Gives the list to a macro. A line: how the vendor is called, and its module. Where packets do not tell, the first counts.
macro_rules! each_lidar {
    ($with:ident) => {
        $with! {
            Velodyne velodyne,
            Hesai hesai,
        }
    };
}

pub(crate) use each_lidar;
