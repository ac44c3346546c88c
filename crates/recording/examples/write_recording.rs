//! Writes a recording as a recorder does, device by device: `write_recording RECORDING`. Open it with Foxglove, `ros2 bag play` or
//! `read_recording`.

use std::path::Path;

use lsfb_geometry::{Camera, Rig, RigCamera, Se3};
use lsfb_recording::{Writer, WriterConfig};
use lsfb_types::{Image, ImuSample, Stamped, Timestamp};

const BEGIN: Timestamp = Timestamp::from_nanos(1_772_359_200_000_000_000);
const IMU_PERIOD_NS: i64 = 5_000_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("write_recording RECORDING")?;
    let mut writer = Writer::create(Path::new(&path), &WriterConfig::default())?;

    // The rig comes first: its frames go to `/tf_static`, its lenses to `camera_info` beside each image.
    let mut rig = Rig::empty("example");
    let camera = RigCamera {
        camera: Camera::pinhole(64, 48, [50.0, 50.0], [31.5, 23.5]),
        rig_from_camera: Se3::identity(),
        timing: Default::default(),
        sigmas: Default::default(),
    };
    rig.cameras.insert("cam0".to_owned(), camera);
    writer.attach_rig(&rig)?;

    for n in 0..1000_u32 {
        let time = BEGIN + i64::from(n) * IMU_PERIOD_NS;
        // A device's own counter stands beside each sample; 0 where it has none.
        let stamped = |delay_ns: i64| (time + delay_ns, u64::from(n) + 1);
        let (arrival, device_ticks) = stamped(800_000);
        let sample = ImuSample {
            angular_velocity_rad_s: [0.0, 0.0, 0.1],
            specific_force_m_s2: [0.0, 0.0, 9.81],
        };
        writer.write_imu(
            "imu0",
            &Stamped {
                time,
                arrival,
                device_ticks,
                sample,
            },
        )?;
        if n.is_multiple_of(10) {
            let (arrival, device_ticks) = stamped(12_000_000);
            let sample = Image {
                width: 64,
                height: 48,
                pixels: (0..64 * 48).map(|i| (i + n) as u8).collect(),
                exposure_ns: 4_000_000,
                frame_id: n / 10,
            };
            writer.write_image(
                "cam0",
                &Stamped {
                    time,
                    arrival,
                    device_ticks,
                    sample,
                },
            )?;
        }
    }
    // Without this the file opens all the same, up to the last second.
    writer.finish()?;
    Ok(())
}
