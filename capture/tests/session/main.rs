//! Whole sessions against devices that speak the real wire formats.

#![allow(
    clippy::unwrap_used,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

mod endings;
mod files;
mod glasses;
mod hostile;
mod lidars;
mod live;
mod load;
mod mock;
mod output;
mod phones;
mod pushed;
mod segments;
mod several;
mod silent;
mod stale;
mod steps;
mod whole;

use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use lsfb_capture::{
    CameraUnitConfig, CaptureReport, DevicesConfig, Ending, ImuFamily, ImuLineConfig,
    LidarNetConfig, Overflow, RecorderConfig, ReplayConfig, Session, StreamReport, Tapped,
    replay_recording,
};
use lsfb_drivers::mynt_s::wire::DeviceInfo;
use lsfb_recording::message::{self, Remark, decode_remark};
use lsfb_recording::{Channel, LIDAR_POSITION, REMARKS, Recording, Writer, WriterConfig};
use lsfb_types::{Packet, Timestamp, no_progress, until};
use mock::{CAMERA_PERIOD_NS, Farewell, IMU_PERIOD_NS, START_NS};

const LOOPBACK: SocketAddr =
    SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 0);

fn unit(path: &Path, names: [&str; 2]) -> CameraUnitConfig {
    CameraUnitConfig::stereo(path.to_owned(), names.map(str::to_owned))
}

fn line(path: &Path) -> ImuLineConfig {
    ImuLineConfig {
        name: "imu0".to_owned(),
        family: ImuFamily::Xsens,
        path: path.to_owned(),
        baud: 921_600,
        rate_hz: 200,
    }
}

/// One on free ports of this machine.
fn lidar() -> LidarNetConfig {
    LidarNetConfig {
        data: LOOPBACK,
        position: LOOPBACK,
        ..LidarNetConfig::default()
    }
}

/// The tests record megabytes: whatever room there is will do.
fn anywhere() -> DevicesConfig {
    DevicesConfig {
        recorder: RecorderConfig {
            least_space_secs: 0.0,
            ..RecorderConfig::default()
        },
        ..DevicesConfig::default()
    }
}

/// A session with an IMU, to which phones connect.
fn imu_and_phones(imu: &Path, folder: &Path) -> Session {
    let config = DevicesConfig {
        imus: vec![line(imu)],
        sidecar: Some(mock::sidecar(folder)),
        ..anywhere()
    };
    Session::open(&config).unwrap()
}

fn stream<'a>(report: &'a CaptureReport, name: &str) -> &'a StreamReport {
    report
        .streams
        .iter()
        .find(|stream| stream.name == name)
        .unwrap()
}

fn run(session: Session, out: &Path) -> CaptureReport {
    session.run(out, &no_progress).unwrap()
}
